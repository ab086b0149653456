"""Instance segmentation in the Ultralytics `-seg` export contract, by ONNX Runtime.

Input: RGB / 255, letterboxed with grey 114, (1, 3, H, W). Outputs: (1, 4+C+32, N)
rows of cx, cy, w, h in input pixels, C class probabilities and 32 mask
coefficients; (1, 32, H/4, W/4) mask prototypes. A mask is
sigmoid(coefficients @ prototypes), cropped to its box.
"""

from __future__ import annotations

import ast
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import xxhash

from pipeline.errors import InputError
from pipeline.frame import Frame
from pipeline.naming import Synonyms, default_synonyms, match
from pipeline.proposals.base import Proposals, no_proposals, unknown_class
from pipeline.proposals.letterbox import Letterbox, letterbox
from pipeline.proposals.onnx_session import file_hash, open_session, signature
from pipeline.proposals.selection import suppress

MASK_COEFFICIENTS = 32
MAX_CANDIDATES = 1000
"""Rows that go into non-maximum suppression at most, best first."""
CONTRACT = "images [1, 3, H, W] -> [1, 4+C+32, N], [1, 32, H/4, W/4] (an Ultralytics -seg export)"


@dataclass(frozen=True)
class _Raw:
    """All rows of one forward pass above the score floor of any class."""

    boxes: np.ndarray
    classes: np.ndarray
    coefficients: np.ndarray
    prototypes: np.ndarray
    placement: Letterbox
    rows: np.ndarray


class YoloSegDetector:
    """YOLOv8-seg, YOLO11-seg, YOLOE-seg and YOLO-World-seg files with a baked-in vocabulary.

    Parameters
    ----------
    path : Path
        The ONNX file. Its class names are read from its metadata.
    min_score : float
        Detections below it are dropped.

    Raises
    ------
    InputError
        Where the file does not follow the contract.
    """

    name = "yolo-seg"
    exact = False

    def __init__(self, path: str | Path, *, synonyms: Synonyms | None = None, min_score: float = 0.15) -> None:
        self.path = Path(path)
        self.synonyms = synonyms
        self.min_score = min_score
        self._session = open_session(self.path)
        self._input, self._outputs, classes = _check_contract(self._session, self.path)
        self.vocabulary: tuple[str, ...] | None = _class_names(self._session, classes, self.path)
        self._last: tuple[str, _Raw] | None = None

    @cached_property
    def _hash(self) -> str:
        return file_hash(self.path)

    @cached_property
    def _synonyms_hash(self) -> str:
        table = self.synonyms or default_synonyms()
        content = (sorted(sorted(group) for group in table.groups), sorted(table.exceptions))
        return xxhash.xxh3_64_hexdigest(repr(content).encode())

    def fingerprint(self) -> str:
        # The synonyms decide which of the model's classes a name asks for.
        return f"yolo-seg:{self._hash}:{self.min_score}:{self._synonyms_hash}"

    def detect(self, frame: Frame, labels: Sequence[str] | None) -> Proposals:
        names = self.vocabulary or ()
        wanted = list(names)
        if labels is not None:
            wanted = []
            for label in labels:
                matched = match(label, names, self.synonyms)
                if not matched:
                    raise unknown_class(label, names, f"the model {self.path.name}")
                wanted += [n for n in matched if n not in wanted]
        raw = self._forward(frame)
        columns = np.array([names.index(n) for n in wanted], np.int64)
        scores = raw.classes[:, columns]
        best = scores.argmax(axis=1)
        score = scores[np.arange(len(scores)), best] if len(scores) else np.zeros(0, np.float32)
        order = np.argsort(-score, kind="stable")
        order = order[score[order] >= self.min_score][:MAX_CANDIDATES]
        order = order[suppress(raw.boxes[order])]
        if not len(order):
            return no_proposals(frame.height, frame.width)
        boxes = raw.placement.to_picture(raw.boxes[order], frame.height, frame.width)
        masks = _masks(raw, order, boxes, frame.height, frame.width)
        solid = masks.any(axis=(1, 2))
        return Proposals(
            boxes[solid],
            np.clip(score[order][solid], 0, 1).astype(np.float32),
            best[order][solid].astype(np.int64),
            tuple(wanted),
            masks[solid],
            raw.rows[order[solid]],
        )

    def _forward(self, frame: Frame) -> _Raw:
        """The network is run once for a picture, however many names are asked for in turn."""
        if self._last is not None and self._last[0] == frame.content_hash:
            return self._last[1]
        _, _, height, width = self._input.shape
        height = height if isinstance(height, int) else _multiple_of_32(frame.height)
        width = width if isinstance(width, int) else _multiple_of_32(frame.width)
        image, placement = letterbox(frame.rgb, height, width)
        tensor = np.ascontiguousarray(image.transpose(2, 0, 1)[None], dtype=np.float32) / np.float32(255)
        if "float16" in self._input.type:
            tensor = tensor.astype(np.float16)
        outputs = self._session.run(self._outputs, {self._input.name: tensor})
        rows, prototypes = (np.asarray(o, dtype=np.float32) for o in outputs)
        rows = rows[0].T
        classes = rows[:, 4:-MASK_COEFFICIENTS]
        index = np.flatnonzero(classes.max(axis=1) >= min(self.min_score, 0.05))
        rows, classes = rows[index], classes[index]
        center, size = rows[:, :2], rows[:, 2:4]
        boxes = np.concatenate([center - size / 2, center + size / 2], axis=1)
        raw = _Raw(boxes, classes, rows[:, -MASK_COEFFICIENTS:], prototypes[0], placement, index)
        self._last = (frame.content_hash, raw)
        return raw


def _multiple_of_32(pixels: int) -> int:
    return max(32, round(pixels / 32) * 32)


def _masks(raw: _Raw, order: np.ndarray, boxes: np.ndarray, height: int, width: int) -> np.ndarray:
    """(N, H, W) bool masks of the chosen rows, each inside its box ((N, 4), picture pixels)."""
    channels, proto_h, proto_w = raw.prototypes.shape
    logits = (raw.coefficients[order] @ raw.prototypes.reshape(channels, -1)).reshape(-1, proto_h, proto_w)
    place = raw.placement
    # Prototypes cover the whole input, padding included, at a quarter of its size.
    step = place.scale / 4
    masks = np.zeros((len(order), height, width), np.bool_)
    for k, (x0, y0, x1, y1) in enumerate(boxes):
        left, top = int(np.floor(x0)), int(np.floor(y0))
        right, bottom = min(int(np.ceil(x1)), width), min(int(np.ceil(y1)), height)
        if right <= left or bottom <= top:
            continue
        xs = ((np.arange(left, right) + 0.5) * step + place.left / 4 - 0.5).astype(np.float32)
        ys = ((np.arange(top, bottom) + 0.5) * step + place.top / 4 - 0.5).astype(np.float32)
        grid_x, grid_y = np.meshgrid(xs, ys)
        smooth = cv2.remap(
            np.ascontiguousarray(logits[k]), grid_x, grid_y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE
        )
        masks[k, top:bottom, left:right] = smooth > 0
    return masks


def _check_contract(session: Any, path: Path) -> tuple[Any, list[str], int]:
    inputs, outputs = session.get_inputs(), session.get_outputs()
    fits = len(inputs) == 1 and len(inputs[0].shape) == 4 and inputs[0].shape[1] == 3
    rows = next((o for o in outputs if len(o.shape) == 3), None)
    prototypes = next((o for o in outputs if len(o.shape) == 4 and o.shape[1] == MASK_COEFFICIENTS), None)
    classes = 0
    if rows is not None and isinstance(rows.shape[1], int):
        classes = rows.shape[1] - 4 - MASK_COEFFICIENTS
    if not fits or rows is None or prototypes is None or classes < 1:
        raise InputError(
            "the ONNX file is not a yolo-seg model",
            got=signature(session)[:240],
            expected=CONTRACT,
            cause="is this a file for another --detector?",
            path=path,
        )
    return inputs[0], [rows.name, prototypes.name], classes


def _class_names(session: Any, classes: int, path: Path) -> tuple[str, ...]:
    text = session.get_modelmeta().custom_metadata_map.get("names", "")
    try:
        names = ast.literal_eval(text)
    except (ValueError, SyntaxError):
        names = None
    if isinstance(names, dict):
        names = [names.get(i) for i in range(classes)]
    if not isinstance(names, list) or len(names) != classes or not all(isinstance(n, str) for n in names):
        raise InputError(
            "the model's metadata hold no class names",
            got=repr(text[:60]),
            expected=f"`names` with {classes} entries",
            cause="was the file exported without metadata?",
            path=path,
        )
    return tuple(str(n) for n in names)
