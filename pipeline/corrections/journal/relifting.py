"""Objects whose pixels or box people set, lifted and judged as the labeller does it."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace
from functools import cached_property, lru_cache
from typing import Any

import numpy as np
import xxhash

from pipeline.answering.objects import PreparedFrame, SceneObject, pixels_inside, prepare_frame
from pipeline.corrections.journal.effective_frame import Setting
from pipeline.corrections.journal.field_refs import box_of
from pipeline.corrections.journal.frame_rows import FrameRows, Pairs, Row
from pipeline.datasets import Dataset
from pipeline.geometry.camera import UpSource
from pipeline.geometry.lifting import LiftedObject, lift
from pipeline.geometry.masks import decode_run_length, mask_box
from pipeline.labels.labelling import label_objects
from pipeline.labels.profiles import NONE, open_second_opinion
from pipeline.proposals.annotations import box_mask
from pipeline.relations.model import OnnxScorer
from pipeline.system.arrow import pa

Relift = Callable[[FrameRows, Mapping[int, Row], Mapping[int, Any], Iterable[int]], tuple[dict[int, Row], Pairs]]
"""Lifts and judges the objects of a frame anew, from the dataset: of its automatic rows, all standing objects, the 3D
boxes (JSON values) that people set, and the objects whose 2D box is not to follow from their mask."""
LabelledUp = tuple[tuple[float, ...], UpSource]
FRAMES_LOADED = 4
"""Frames that stay loaded: who corrects one goes on correcting it."""


def labelled_ups(frames: pa.Table) -> dict[str, LabelledUp]:
    """Up vectors of the table `frames`, by frame."""
    columns = (frames.column(name).to_pylist() for name in ("frame", "up", "up_source"))
    return {name: (tuple(up), source or "assumed") for name, up, source in zip(*columns, strict=True) if up and any(up)}


class Relifter:
    """Lifting of objects of one dataset's frames; see `Relift`.

    `ups` are the up vectors (camera frame) at labelling: corrections are judged in the same level frame.
    """

    def __init__(self, dataset: Dataset, setting: Setting, ups: Mapping[str, LabelledUp]) -> None:
        self.dataset, self.setting, self.ups = dataset, setting, ups
        # The lifted objects of a frame go with it.
        self._loaded = lru_cache(maxsize=FRAMES_LOADED)(lambda frame: (self._load(frame), dict[Any, LiftedObject]()))

    def context(self, frame: str) -> PreparedFrame:
        """Frame of the dataset, ready to lift from; raises as `Dataset.load`."""
        return self._loaded(frame)[0]

    def _load(self, frame: str) -> PreparedFrame:
        loaded = self.dataset.load(frame)
        if frame in self.ups:
            up, source = self.ups[frame]
            loaded = replace(loaded, camera=loaded.camera.with_up(np.array(up), source))
        return prepare_frame(self.dataset, loaded, self.setting.config.lift)

    @cached_property
    def network(self) -> OnnxScorer | None:
        """Second opinion of the labels, opened when first asked."""
        name = self.setting.config.second_opinion
        return None if name == NONE else open_second_opinion(name)

    def lifted(self, frame: str, row: Row, box: Any) -> SceneObject:
        """Object from its effective row and a person's 3D box."""
        return self._object(self.context(frame), row, box, human_bbox=True)

    def __call__(
        self, auto: FrameRows, rows: Mapping[int, Row], boxes: Mapping[int, Any], human_bbox: Iterable[int]
    ) -> tuple[dict[int, Row], Pairs]:
        context = self.context(auto.frame)
        numbers, kept = sorted(rows), set(human_bbox)
        objects = [self._object(context, rows[n], boxes.get(n), n in kept) for n in numbers]
        labels = label_objects(
            context,
            objects,
            self.setting.config,
            frame_index=auto.index,
            scene=auto.row["scene"],
            exact=self.setting.exact,
            network=self.network,
            numbers=numbers,
        )
        columns = labels.objects
        found = {n: {name: values[k] for name, values in columns.items()} for k, n in enumerate(numbers)}
        return found, Pairs.of_columns(numbers, labels.relations)

    def _object(self, context: PreparedFrame, row: Row, box: Any, human_bbox: bool) -> SceneObject:
        """Object from its mask, else the pixels in its 3D box, else its 2D box."""
        frame, source = context.frame, row["mask_source"]
        bbox = np.array(row["bbox"], np.float32)
        if row["mask"] is not None and source != "box":
            mask = decode_run_length((frame.height, frame.width), row["mask"], f"object {row['object']}")
        else:
            mask = box_mask(bbox, frame.height, frame.width)
            if source == "box3d" and box is not None:
                within = pixels_inside(box_of(box), mask, frame)
                mask, source = (within, "box3d") if within.any() else (mask, "box")
        lifted = self._lift(context, mask, source)
        if box is not None:
            lifted = lifted.moved_to(box_of(box), context.viewer)
        if source == "human" and not human_bbox and mask.any():
            bbox = np.array(mask_box(mask), np.float32)
        return SceneObject(row["object"], row["label"], row["score"], bbox, mask, lifted)

    def _lift(self, context: PreparedFrame, mask: np.ndarray, source: Any) -> LiftedObject:
        known = self._loaded(context.frame.id)[1]
        key = xxhash.xxh3_128_hexdigest(np.ascontiguousarray(mask).data), str(source)
        if key not in known:
            (known[key],) = lift(
                context.frame.depth, context.frame.camera, [mask], context.viewer, config=context.config,
                mask_source=source, edges=context.edges,
            )  # fmt: skip
        return known[key]
