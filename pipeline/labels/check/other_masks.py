"""Masks that other views of the same object contradict.

Each frame's objects are carried to it from the other frames of the scene that share most of them, as if it had no masks
of its own. A mask that differs from what was carried is probably wrong, the more so the surer that is. Frames are taken
scene by scene; memory is that of one scene's masks and a few pictures.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import field
from pathlib import Path

import numpy as np

from pipeline.datasets.base import Dataset, load_picture
from pipeline.geometry.masks import MaskCrop
from pipeline.labels.check.other_views import is_number
from pipeline.labels.check.view import RULES, Figure, Finding, FrameView
from pipeline.labels.reading import Labels
from pipeline.scenes.map_files import map_path, read_map
from pipeline.scenes.propagation import LabelledObject, LabelledView, ProposedMask, propagate
from pipeline.scenes.views import PosedView
from pipeline.system.errors import InputError, needed, require
from pipeline.system.frozen import dataclass
from pipeline.system.recent import Recent

MOST_SOURCES = 6
"""Frames whose masks are carried to another one."""
LEAST_SOURCES = 2
"""Of two views that differ none is the wrong one."""
CONTRADICTED = 0.3
"""Least difference, 1 - IoU times the confidence of what was carried, for a finding: of sound masks 1 % have it in
rendered rooms, of masks that were shifted, grown, halved or merged 80 %."""


@dataclass(frozen=True, eq=False)
class MaskedFrame:
    """Masks of a frame's objects with an instance."""

    id: str
    size: tuple[int, int]  # Height and width, pixels
    masks: tuple[LabelledObject, ...]
    labels: tuple[str, ...]  # Of `masks`


@dataclass
class OtherMasks:
    """Comparison of masks with those that other frames give; frames of a scene come in one after the other."""

    dataset: Dataset
    maps: Path | None = None  # Folder of the scenes' maps, whose poses are used where they are at hand
    scene: str = ""
    frames: list[MaskedFrame] = field(default_factory=list)
    views: Recent[str, LabelledView | None] = field(default_factory=lambda: Recent(MOST_SOURCES + 2))

    def add(self, view: FrameView) -> Iterator[Finding]:
        """Take a frame in; finds what is wrong in the scene before, where another one begins."""
        instances = view.objects["instance"]
        masks = {k: crop for k, crop in enumerate(view.crops) if isinstance(crop, MaskCrop) and crop.area}
        known = [k for k in masks if is_number(instances[k])]
        if not view.usable or not known or view.id is None:
            return
        scene = str(view.tables["frames"]["scene"][0])
        if scene != self.scene:
            yield from self.findings()
            self.scene = scene
        own = tuple(LabelledObject(int(instances[k]), int(view.ids[k]), masks[k]) for k in known)
        self.frames.append(MaskedFrame(view.id, view.size, own, tuple(view.labels[k] for k in known)))

    def findings(self) -> Iterator[Finding]:
        """Find masks of the scene's frames that other frames contradict."""
        frames, self.frames = self.frames, []
        if len(frames) <= LEAST_SOURCES:
            return
        poses = self._poses()
        ids = sorted({o.object_id for f in frames for o in f.masks})
        shows = np.array([np.isin(ids, [o.object_id for o in f.masks]) for f in frames], np.int32)
        for k, frame in enumerate(frames):
            shared = shows @ shows[k]
            shared[k] = 0
            order = np.lexsort((np.abs(np.arange(len(frames)) - k), -shared))[:MOST_SOURCES]
            near = [frames[i] for i in order.tolist() if shared[i]]
            sources = [view for f in near if len(near) >= LEAST_SOURCES and (view := self._view(f, poses)) is not None]
            target = self._view(frame, poses) if len(sources) >= LEAST_SOURCES else None
            if target is not None:
                carried = {found.object_id: found for found in propagate(sources, target.view)}
                for entry, label in zip(frame.masks, frame.labels, strict=True):
                    yield from _compared(frame, entry, label, carried.get(entry.object_id))

    def _poses(self) -> Mapping[str, np.ndarray]:
        """Poses that the scene's map uses, where it can be read: they may be refined ones."""
        with suppress(InputError):
            return {} if self.maps is None else read_map(map_path(self.maps, self.scene)).poses
        return {}

    def _view(self, frame: MaskedFrame, poses: Mapping[str, np.ndarray]) -> LabelledView | None:
        """View of a frame; None for a broken one, one without a pose, or of another size than its labels."""

        def made() -> LabelledView | None:
            with suppress(InputError):
                view = PosedView.of(load_picture(self.dataset, frame.id), poses.get(frame.id))
                return LabelledView(view, frame.masks) if view.size == frame.size else None
            return None

        return self.views.get(frame.id, made)


def other_masks(labels: Labels, dataset: Dataset | None) -> OtherMasks:
    """Start a comparison of the masks of labels, for one check, under the poses of the map that they were made with.

    InputError without the dataset, for a first picture of another size than its labels, or for labels without objects
    that are numbered alike in three frames of a scene.
    """
    require(
        comparable(labels),
        "masks are compared by what three frames show of one object, and these labels number none so",
        expected="labels of posed frames made with `label --map MAP`, after `map DATASET --out MAP`",
        path=labels.root,
    )
    dataset = needed(dataset, "masks are compared by the pictures' depth: the dataset is needed")
    first = labels.frames.slice(0, 1).to_pylist()[0]
    size = found = first["height"], first["width"]
    with suppress(InputError):
        # A broken frame is left out, as later ones are.
        found = load_picture(dataset, first["frame"]).rgb.shape[:2]
    require(
        found == size,
        f"the picture of frame {first['frame']} is not of the labels' size",
        got=found,
        expected=size,
        path=dataset.root,
    )
    maps = labels.manifest.config.get("map")
    return OtherMasks(dataset, Path(str(maps)) if maps else None)


def comparable(labels: Labels) -> bool:
    """Tell labels with objects that are numbered alike in three frames of a scene."""
    scenes = dict(zip(*(labels.frames.column(name).to_pylist() for name in ("frame", "scene")), strict=True))
    rows = zip(*(labels.objects.column(name).to_pylist() for name in ("frame", "instance")), strict=True)
    count = Counter((scenes.get(frame), instance) for frame, instance in rows if is_number(instance))
    return max(count.values(), default=0) > LEAST_SOURCES


def _compared(frame: MaskedFrame, entry: LabelledObject, label: str, carried: ProposedMask | None) -> Iterator[Finding]:
    if carried is None or len(carried.sightings) < LEAST_SOURCES:
        return
    own, other = entry.mask.of_picture(frame.size), carried.mask.of_picture(frame.size)
    agree = float(np.count_nonzero(own & other) / np.count_nonzero(own | other))
    doubt = (1 - agree) * carried.confidence
    if doubt < CONTRADICTED:
        return
    views, most = len(carried.sightings), carried.sightings[0]
    figures: dict[str, Figure] = {"doubt": round(doubt, 3), "agreement": round(agree, 3), "views": views}
    figures |= {"confidence": round(carried.confidence, 3), "other": most.frame_id}
    message = (
        f"the mask of {label} {entry.number} agrees to {agree:.0%} with what {views} other views show of it, most "
        f"{most.frame_id}, as object {most.number}"
    )
    yield Finding("object/other-masks", RULES["object/other-masks"], frame.id, (entry.number,), message, figures)
