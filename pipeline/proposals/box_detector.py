"""Detectors of boxes that need no code: what their tensors are stands in a TOML file."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from pipeline.geometry.frame import Frame
from pipeline.language.naming import Synonyms
from pipeline.proposals.base import Proposals, class_wise
from pipeline.proposals.box_config import BoxInput, Candidates, decode, find_box_model, output_names, read_box_model
from pipeline.proposals.class_names import metadata_names, names_hash
from pipeline.proposals.network import MAX_PER_NAME, NetworkDetector, proposals_of
from pipeline.system.errors import InputError, needed, require
from pipeline.system.onnx_session import run_session, signature

OPTION = "--detector boxes"
VERSION = "1"


class BoxDetector(NetworkDetector):
    """A detector of boxes, as its TOML file describes it.

    Parameters
    ----------
    path : Path
        The ONNX file.
    config : Path, optional
        The TOML file, see `pipeline.proposals.box_config`; by default the one beside the model.
    min_score : float, optional
        Detections below it are dropped; by default as the TOML file says.

    Raises
    ------
    InputError
        Where the TOML file is wrong, or the model has no such tensors.
    """

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
        self.vocabulary = self.config.names or self._names_inside()
        self._input, self._sides = self._checked_input()
        self._outputs = self._checked_outputs()

    def fingerprint(self) -> str:
        described = self.config.model_dump_json(exclude={"names", "names_file"})
        parts = (VERSION, self._hash, described, names_hash(self.vocabulary or ()), self._synonyms_hash)
        return f"boxes:{self.min_score}:{':'.join(parts)}"

    def detect(self, frame: Frame, labels: Sequence[str] | None) -> Proposals:
        """Detections of the classes that the names mean, the better first; `ids` are rows of the network's answer."""
        wanted = self._wanted(labels)
        candidates, placement = self._once(frame, self._forward)
        score, which = self._best(candidates.scores, wanted)
        chosen = np.flatnonzero(score >= max(self.min_score, 1e-6))
        boxes = self._in_picture(candidates.boxes[chosen], placement, frame)
        nms_iou = self.config.output.nms_iou if self.config.output.nms else 1.0
        kept = class_wise(boxes, score[chosen], which[chosen], MAX_PER_NAME, nms_iou=nms_iou)
        chosen = chosen[kept]
        return proposals_of(boxes[kept], score[chosen], which[chosen], wanted, chosen)

    def _in_picture(self, boxes: np.ndarray, placement: Placement, frame: Frame) -> np.ndarray:
        units = self.config.output.units
        if units == "share":
            boxes = boxes * ([placement.width, placement.height] * 2)
        if units != "picture":
            boxes = placement.to_picture(boxes)
        return np.clip(np.nan_to_num(boxes), 0, [frame.width, frame.height] * 2)

    def _forward(self, frame: Frame) -> tuple[Candidates, Placement]:
        tensor, placement = place_picture(frame.rgb, *self._sides, self.config.input)
        numbers = {
            "height": frame.height, "width": frame.width,
            "input_height": placement.height, "input_width": placement.width,
            "scale_y": placement.scale_y, "scale_x": placement.scale_x,
        }  # fmt: skip
        extra = {n: np.array([[numbers[w] for w in words]], np.float32) for n, words in self.config.input.extra.items()}
        values = run_session(self._session, self._outputs, {self._input: tensor, **extra}, self.path)
        outputs = dict(zip(self._outputs, values, strict=True))
        try:
            return decode(outputs, self.config.output, len(self.vocabulary or ()), self._sides), placement
        except InputError as error:
            raise InputError(str(error), path=self.config_path) from error

    def _names_inside(self) -> tuple[str, ...]:
        return needed(
            metadata_names(self._session),
            "the class names of the detector are not known",
            expected="names or names_file",
            path=self.config_path,
        )

    def _checked_input(self) -> tuple[str, tuple[int, int]]:
        """The picture's input and the size of it."""
        config = self.config.input
        shapes = {i.name: tuple(i.shape) for i in self._session.get_inputs()}
        unknown = [n for n in (config.name, *config.extra) if n is not None and n not in shapes]
        rest = [n for n in shapes if n not in config.extra]
        if unknown or len(rest) != 1 or (config.name is not None and rest != [config.name]):
            given = ", ".join([*([config.name] if config.name else []), *config.extra]) or "one input"
            raise InputError(
                "the model has other inputs than the TOML file says",
                got=signature(self._session)[:240],
                expected=given,
                cause="inputs besides the picture are named under [input.extra]" if len(rest) > 1 else None,
                path=self.config_path,
            )
        shape = shapes[rest[0]]
        channels, sides = (shape[1:2], shape[2:]) if config.layout == "NCHW" else (shape[3:], shape[1:3])
        given_sides = config.size or (None, None)
        if len(shape) != 4 or (isinstance(channels[0], int) and channels[0] != 3):
            other = "NHWC" if config.layout == "NCHW" else "NCHW"
            raise InputError(
                f"the input {rest[0]} is not {config.layout}",
                got=list(shape),
                expected="3 channels",
                cause=f'is it layout = "{other}"?',
                path=self.config_path,
            )
        found = []
        for declared, given in zip(sides, given_sides, strict=True):
            if not isinstance(declared, int) and given is None:
                raise InputError(
                    "the model takes any size", expected="size = [HEIGHT, WIDTH] under [input]", path=self.config_path
                )
            require(
                not isinstance(declared, int) or given is None or given == declared,
                "the model takes another size",
                got=list(given_sides),
                expected=list(sides),
                path=self.config_path,
            )
            found.append(declared if isinstance(declared, int) else given)
        return rest[0], (found[0], found[1])

    def _checked_outputs(self) -> list[str]:
        known = [o.name for o in self._session.get_outputs()]
        wanted = output_names(self.config.output)
        missing = [n for n in wanted if n not in known]
        if missing:
            raise InputError(f"the model has no output {missing[0]}", got=", ".join(known)[:240], path=self.config_path)
        return wanted


@dataclass(frozen=True)
class Placement:
    """Where the picture is in the input.

    Attributes
    ----------
    scale_x, scale_y : float
        Input pixels per picture pixel.
    left, top : int
        Input pixels before the picture.
    height, width : int
        Of the input, pixels.
    """

    scale_x: float
    scale_y: float
    left: int
    top: int
    height: int
    width: int

    def to_picture(self, boxes: np.ndarray) -> np.ndarray:
        """(N, 4) boxes in input pixels as boxes in picture pixels."""
        return (boxes - [self.left, self.top] * 2) / ([self.scale_x, self.scale_y] * 2)


def place_picture(rgb: np.ndarray, height: int, width: int, config: BoxInput) -> tuple[np.ndarray, Placement]:
    """The network's input.

    Returns
    -------
    tensor : (1, 3, height, width) or (1, height, width, 3) float32
    placement : Placement
    """
    h, w = rgb.shape[:2]
    inner_h, inner_w = height, width
    if config.fit != "stretch":
        scale = min(height / h, width / w)
        inner_h, inner_w = min(max(round(h * scale), 1), height), min(max(round(w * scale), 1), width)
    left = top = 0
    if config.fit == "letterbox":
        # Of an odd rest the smaller half comes first, as in Ultralytics' own letterbox.
        left, top = round((width - inner_w) / 2 - 0.1), round((height - inner_h) / 2 - 0.1)
    interpolation = cv2.INTER_CUBIC if config.interpolation == "cubic" else cv2.INTER_LINEAR
    resized = rgb if (h, w) == (inner_h, inner_w) else cv2.resize(rgb, (inner_w, inner_h), interpolation=interpolation)
    image = np.full((height, width, 3), config.pad, np.uint8)
    image[top : top + inner_h, left : left + inner_w] = resized
    if config.colour == "BGR":
        image = image[..., ::-1]
    scaled = image.astype(np.float32) * np.float32(config.scale)
    values = (scaled - np.array(config.mean, np.float32)) / np.array(config.std, np.float32)
    if config.layout == "NCHW":
        values = values.transpose(2, 0, 1)
    return np.ascontiguousarray(values[None]), Placement(inner_w / w, inner_h / h, left, top, height, width)
