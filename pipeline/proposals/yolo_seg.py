"""Instance segmentation in the Ultralytics `-seg` export contract, by ONNX Runtime.

Input: RGB / 255, letterboxed with grey 114, (1, 3, H, W). Outputs: (1, 4+C+32, N) rows of cx, cy, w, h in input pixels,
C class probabilities and 32 mask coefficients; (1, 32, H/4, W/4) mask prototypes. A mask is sigmoid(coefficients @
prototypes), cropped to its box.

Exports with the suppression inside (nms=True, or the end-to-end models) give (1, N, 6+32) rows of x0, y0, x1, y1,
score, class number and coefficients instead.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np

from pipeline.geometry.frame import Frame
from pipeline.geometry.picture_input import InputPlacement, PictureInput, place_picture
from pipeline.language.naming import Synonyms
from pipeline.proposals.base import MAX_CANDIDATES, Proposals, no_proposals, suppress
from pipeline.proposals.class_names import metadata_names, names_hash, read_class_names
from pipeline.proposals.contracts import MASK_COEFFICIENTS, YOLO_SEG_CONTRACTS, yolo_seg_tensors
from pipeline.proposals.mismatch import fitting
from pipeline.proposals.network import NetworkDetector
from pipeline.system.errors import InputError, needed, require
from pipeline.system.frozen import dataclass
from pipeline.system.onnx_session import run_session

MIN_SCORE = 0.15
SCORE_FLOOR = 0.05
"""Rows whose best class is below this, or below the minimum score, are dropped at once."""


@dataclass(frozen=True)
class _Raw:
    """Rows of a forward pass above the score floor of any class."""

    boxes: np.ndarray
    classes: np.ndarray
    coefficients: np.ndarray
    prototypes: np.ndarray
    placement: InputPlacement
    rows: np.ndarray
    cell: tuple[float, float]
    """Prototype cells per input pixel, down and across."""


class YoloSegDetector(NetworkDetector):
    """YOLOv8-seg, YOLO11-seg, YOLOE-seg and YOLO-World-seg files with a baked-in vocabulary."""

    name = "yolo-seg"
    default_score = MIN_SCORE

    def __init__(
        self,
        path: str | Path,
        *,
        names: str | Path | None = None,
        synonyms: Synonyms | None = None,
        min_score: float | None = None,
    ) -> None:
        super().__init__(path, min_score, synonyms)
        found = yolo_seg_tensors(self._session)
        found = fitting(found, "a yolo-seg model", self._session, self.path, YOLO_SEG_CONTRACTS)
        self._input, self._outputs, self._suppressed, classes = found
        given = read_class_names(Path(names)) if names is not None else metadata_names(self._session)
        self._named_outside = names is not None
        self.vocabulary: tuple[str, ...] | None = _checked_names(given, classes, self.path)

    def fingerprint(self) -> str:
        # The synonyms decide which of the model's classes a name asks for.
        names = f":{names_hash(self.vocabulary or ())}" if self._named_outside else ""
        return f"yolo-seg:{self._hash}:{self.min_score}:{self._synonyms_hash}{names}"

    def detect(self, frame: Frame, labels: Sequence[str] | None) -> Proposals:
        wanted = self._wanted(labels)
        raw = self._once(frame, self._forward)
        score, which = self._best(raw.classes, wanted)
        order = np.argsort(-score, kind="stable")
        order = order[score[order] >= self.min_score][:MAX_CANDIDATES]
        order = order[suppress(raw.boxes[order])]
        if not len(order):
            return no_proposals(frame.height, frame.width)
        inside = np.clip(raw.placement.to_picture(raw.boxes[order]), 0, [frame.width, frame.height] * 2)
        boxes = inside.astype(np.float32)
        masks = _masks(raw, order, boxes, frame.height, frame.width)
        solid = masks.any(axis=(1, 2))
        return Proposals(
            boxes[solid],
            np.clip(score[order][solid], 0, 1).astype(np.float32),
            which[order][solid],
            tuple(wanted),
            masks[solid],
            raw.rows[order[solid]],
        )

    def _forward(self, frame: Frame) -> _Raw:
        _, _, height, width = self._input.shape
        height = height if isinstance(height, int) else _multiple_of_32(frame.height)
        width = width if isinstance(width, int) else _multiple_of_32(frame.width)
        tensor, placement = place_picture(frame.rgb, height, width, PictureInput())
        rows, prototypes = run_session(self._session, self._outputs, {self._input.name: tensor}, self.path)
        if prototypes.ndim != 4 or prototypes.shape[:2] != (1, MASK_COEFFICIENTS) or rows.ndim != 3 or len(rows) != 1:
            raise self._odd_outputs(rows, prototypes)
        boxes, classes, coefficients = self._parts(rows, prototypes)
        index = np.flatnonzero(classes.max(axis=1, initial=0) >= min(self.min_score, SCORE_FLOOR))
        cell = prototypes.shape[2] / height, prototypes.shape[3] / width
        raw = _Raw(boxes[index], classes[index], coefficients[index], prototypes[0], placement, index, cell)
        require(
            all(np.isfinite(v).all() for v in (raw.boxes, raw.classes, raw.coefficients, prototypes)),
            "the model's outputs are not finite",
            cause="half-precision files overflow on some processors: try the full-precision one",
            path=self.path,
        )
        return raw

    def _parts(self, rows: np.ndarray, prototypes: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Boxes (N, 4) as x0, y0, x1, y1 in input pixels, probabilities (N, C), coefficients (N, 32)."""
        classes = len(self.vocabulary or ())
        if self._suppressed:
            table = rows[0]
            if table.shape[1] != 6 + MASK_COEFFICIENTS:
                raise self._odd_outputs(rows, prototypes)
            number = np.rint(table[:, 5]).astype(np.int64)
            scores = np.zeros((len(table), classes), np.float32)
            # Lists are filled up with rows of score 0; their class means nothing.
            real = np.flatnonzero((table[:, 4] > 0) & (number >= 0) & (number < classes))
            scores[real, number[real]] = table[real, 4]
            return table[:, :4], scores, table[:, 6:]
        table = rows[0].T
        if table.shape[1] != 4 + classes + MASK_COEFFICIENTS:
            raise self._odd_outputs(rows, prototypes)
        center, size = table[:, :2], table[:, 2:4]
        boxes = np.concatenate([center - size / 2, center + size / 2], axis=1)
        return boxes, table[:, 4:-MASK_COEFFICIENTS], table[:, -MASK_COEFFICIENTS:]

    def _odd_outputs(self, rows: np.ndarray, prototypes: np.ndarray) -> InputError:
        return InputError(
            "the model's outputs are not those of a yolo-seg model",
            got=f"{list(rows.shape)}, {list(prototypes.shape)} for {len(self.vocabulary or ())} class names",
            expected="[1, 4+C+32, N] or [1, N, 38], [1, 32, H/4, W/4]",
            path=self.path,
        )


def _multiple_of_32(pixels: int) -> int:
    return max(32, round(pixels / 32) * 32)


def _masks(raw: _Raw, order: np.ndarray, boxes: np.ndarray, height: int, width: int) -> np.ndarray:
    """Masks (N, H, W) bool of chosen rows, each inside its box ((N, 4), picture pixels)."""
    channels, proto_h, proto_w = raw.prototypes.shape
    logits = (raw.coefficients[order] @ raw.prototypes.reshape(channels, -1)).reshape(-1, proto_h, proto_w)
    placement = raw.placement
    # Prototypes cover the whole input, padding included, mostly at a quarter of its size.
    down, across = raw.cell
    masks = np.zeros((len(order), height, width), np.bool_)
    for k, (x0, y0, x1, y1) in enumerate(boxes):
        left, top = int(np.floor(x0)), int(np.floor(y0))
        right, bottom = min(int(np.ceil(x1)), width), min(int(np.ceil(y1)), height)
        if right <= left or bottom <= top:
            continue
        xs = (((np.arange(left, right) + 0.5) * placement.scale_x + placement.left) * across - 0.5).astype(np.float32)
        ys = (((np.arange(top, bottom) + 0.5) * placement.scale_y + placement.top) * down - 0.5).astype(np.float32)
        grid_x, grid_y = np.meshgrid(xs, ys)
        smooth = cv2.remap(
            np.ascontiguousarray(logits[k]), grid_x, grid_y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE
        )
        masks[k, top:bottom, left:right] = smooth > 0
    return masks


def _checked_names(names: tuple[str, ...] | None, classes: int | None, path: Path) -> tuple[str, ...]:
    names = needed(
        names,
        "the model's metadata hold no class names",
        expected=f"`names` with {classes if classes is not None else 'all'} entries, or --model-config FILE",
        cause="was the file exported without metadata?",
        path=path,
    )
    require(
        classes is None or len(names) == classes,
        "the class names are not those of the model",
        got=len(names),
        expected=classes,
        path=path,
    )
    return names
