"""Box detectors described by a TOML file, without code."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from pipeline.geometry.frame import Frame
from pipeline.geometry.picture_input import InputPlacement, checked_input, checked_outputs, place_picture
from pipeline.language.naming import Synonyms
from pipeline.proposals.base import Proposals, class_wise
from pipeline.proposals.box_config import BoxCandidates, decode, find_box_model, output_names, read_box_model
from pipeline.proposals.class_names import metadata_names, names_hash
from pipeline.proposals.network import MAX_PER_NAME, NetworkDetector, proposals_of
from pipeline.system.errors import InputError, in_file, needed
from pipeline.system.onnx_session import run_session

OPTION = "--detector boxes"
VERSION = "1"


class BoxDetector(NetworkDetector):
    """A box detector described by a TOML file."""

    name = "boxes"

    def __init__(
        self,
        path: str | Path,
        *,
        config: str | Path | None = None,
        synonyms: Synonyms | None = None,
        min_score: float | None = None,
    ) -> None:
        super().__init__(path, 0.0, synonyms)
        self.config_path = Path(config) if config is not None else find_box_model(self.path)
        self.config = read_box_model(self.config_path)
        self.min_score = self.config.output.min_score if min_score is None else min_score
        self.vocabulary = self.config.names or needed(
            metadata_names(self._session),
            "the class names of the detector are not known",
            expected="names or names_file",
            path=self.config_path,
        )
        picture = self.config.input
        self._input, (height, width) = checked_input(self._session, picture, picture.extra, self.config_path)
        if height is None or width is None:
            raise InputError(
                "the model takes any size", expected="size = [HEIGHT, WIDTH] under [input]", path=self.config_path
            )
        self._sides = height, width
        self._outputs = output_names(self.config.output)
        checked_outputs(self._session, self._outputs, self.config_path)

    def fingerprint(self) -> str:
        described = self.config.model_dump_json(exclude={"names", "names_file"})
        parts = (VERSION, self._hash, described, names_hash(self.vocabulary or ()), self._synonyms_hash)
        return f"boxes:{self.min_score}:{':'.join(parts)}"

    def detect(self, frame: Frame, labels: Sequence[str] | None) -> Proposals:
        """Detections of the named classes, best first; `ids` are output rows."""
        wanted = self._wanted(labels)
        candidates, placement = self._once(frame, self._forward)
        score, which = self._best(candidates.scores, wanted)
        chosen = np.flatnonzero(score >= max(self.min_score, 1e-6))
        boxes = self._in_picture(candidates.boxes[chosen], placement, frame)
        nms_iou = self.config.output.nms_iou if self.config.output.nms else 1.0
        kept = class_wise(boxes, score[chosen], which[chosen], MAX_PER_NAME, nms_iou=nms_iou)
        chosen = chosen[kept]
        return proposals_of(boxes[kept], score[chosen], which[chosen], wanted, chosen)

    def _in_picture(self, boxes: np.ndarray, placement: InputPlacement, frame: Frame) -> np.ndarray:
        units = self.config.output.units
        if units == "share":
            boxes = boxes * ([placement.width, placement.height] * 2)
        if units != "picture":
            boxes = placement.to_picture(boxes)
        return np.clip(np.nan_to_num(boxes), 0, [frame.width, frame.height] * 2)

    def _forward(self, frame: Frame) -> tuple[BoxCandidates, InputPlacement]:
        tensor, placement = place_picture(frame.rgb, *self._sides, self.config.input)
        numbers = {
            "height": frame.height,
            "width": frame.width,
            "input_height": placement.height,
            "input_width": placement.width,
            "scale_y": placement.scale_y,
            "scale_x": placement.scale_x,
        }
        extra = {n: np.array([[numbers[w] for w in words]], np.float32) for n, words in self.config.input.extra.items()}
        values = run_session(self._session, self._outputs, {self._input: tensor, **extra}, self.path)
        outputs = dict(zip(self._outputs, values, strict=True))
        with in_file(self.config_path):
            return decode(outputs, self.config.output, len(self.vocabulary or ()), self._sides), placement
