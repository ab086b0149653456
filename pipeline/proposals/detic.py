"""Detic by ONNX Runtime: public exports with a frozen vocabulary (LVIS, or ImageNet-21k).

Input: RGB 0..255, (1, 3, h, w), the shorter side 800 and the longer at most 1333. Outputs: boxes (n, 4) in input
pixels, scores (n,), class numbers (n,), and masks (n, 1, 28, 28) of probabilities, after the suppression of rivals
within each class. Files: `axinc-ai/ailia-models`, object_detection/detic. The files hold no class names, so these are
read from a file beside them.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from pipeline.geometry.frame import Frame
from pipeline.language.naming import Synonyms
from pipeline.proposals.base import Proposals, no_proposals
from pipeline.proposals.class_names import (
    metadata_names,
    names_hash,
    read_class_names,
)
from pipeline.proposals.contracts import DETIC_CONTRACTS, detic_tensors
from pipeline.proposals.mismatch import fitting
from pipeline.proposals.network import NetworkDetector, pillow_resized
from pipeline.system.errors import InputError, needed, require
from pipeline.system.onnx_session import run_session

VERSION = "1"
MIN_SCORE = 0.02
"""The paper's, which is Detic's own SCORE_THRESH_TEST. A file may have been exported with a higher one."""
SHORTEST, LONGEST = 800, 1333
NAME_FILES = ("{stem}.names.txt", "{stem}.txt", "{stem}.names.json", "imagenet_21k_class_names.txt", "lvis_v1_val.json")
"""Where class names are looked for beside the model."""


class DeticDetector(NetworkDetector):
    """Detic with the exported vocabulary."""

    name = "detic"
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
        found = detic_tensors(self._session)
        self._input, self._outputs = fitting(found, "a Detic model", self._session, self.path, DETIC_CONTRACTS)
        inside = None if names is not None else metadata_names(self._session)
        self.vocabulary = inside or read_class_names(find_names(self.path) if names is None else Path(names))

    def fingerprint(self) -> str:
        return (
            f"detic:{VERSION}:{self._hash}:{self.min_score}:{self._synonyms_hash}:{names_hash(self.vocabulary or ())}"
        )

    def detect(self, frame: Frame, labels: Sequence[str] | None) -> Proposals:
        """Detections of the named classes, best first; `ids` are output rows."""
        names = self.vocabulary or ()
        wanted = self._wanted(labels)
        boxes, scores, classes, masks = self._once(frame, self._forward)
        index_of = {name: k for k, name in enumerate(wanted)}
        which = np.array([index_of.get(names[int(c)], -1) for c in classes], np.int64)
        chosen = np.flatnonzero((which >= 0) & (scores >= self.min_score))
        chosen = chosen[np.argsort(-scores[chosen], kind="stable")]
        pasted = paste_masks(masks[chosen], boxes[chosen], frame.height, frame.width)
        solid = pasted.any(axis=(1, 2))
        chosen = chosen[solid]
        if not len(chosen):
            return no_proposals(frame.height, frame.width)
        found = np.clip(scores[chosen], 0, 1).astype(np.float32)
        return Proposals(boxes[chosen], found, which[chosen], tuple(wanted), pasted[solid], chosen)

    def _forward(self, frame: Frame) -> list[np.ndarray]:
        """Boxes (n, 4) in pixels of the frame, scores (n,), classes (n,), masks (n, 28, 28)."""
        free = resized_shape(frame.height, frame.width)
        sides = self._input.shape[2:]
        height, width = (s if isinstance(s, int) else f for s, f in zip(sides, free, strict=True))
        image = pillow_resized(frame.rgb, height, width)
        tensor = np.ascontiguousarray(image.transpose(2, 0, 1)[None], np.float32)
        boxes, scores, classes, masks = run_session(self._session, self._outputs, {self._input.name: tensor}, self.path)
        count = len(scores)
        vocabulary = len(self.vocabulary or ())
        if (
            boxes.shape != (count, 4)
            or scores.ndim != 1
            or classes.shape != (count,)
            or masks.shape[:2] != (count, 1)
            or masks.ndim != 4
        ):
            shapes = ", ".join(str(list(v.shape)) for v in (boxes, scores, classes, masks))
            raise InputError(
                "the model's outputs do not fit one another",
                got=shapes,
                expected="[n, 4], [n], [n], [n, 1, 28, 28]",
                path=self.path,
            )
        classes = classes.astype(np.int64)
        require(
            not count or 0 <= classes.min() <= classes.max() < vocabulary,
            "the class names are not those of the model",
            got=f"{vocabulary} names",
            expected=lambda: f"more than {int(classes.max())}",
            path=self.path,
        )
        scale = np.array([frame.width / width, frame.height / height] * 2, np.float32)
        limits = np.array([frame.width, frame.height] * 2, np.float32)
        boxes = np.clip(boxes * scale, 0, limits).astype(np.float32)
        return [boxes, scores, classes, masks[:, 0]]


def find_names(model: Path) -> Path:
    """Class name file of a model."""
    candidates = [model.with_name(n.format(stem=model.stem)) for n in NAME_FILES]
    return needed(
        next((p for p in candidates if p.is_file()), None),
        "the class names of the Detic model are not known",
        expected=f"{candidates[0].name} beside it, or --model-config FILE",
        cause="one name a line, or the categories of LVIS's annotations",
        path=model,
    )


def resized_shape(height: int, width: int) -> tuple[int, int]:
    """Height and width with the shorter side 800, and the longer at most 1333, rounded as in Detic's code. That is
    detectron2's `ResizeShortestEdge`, which differs from transformers' by a pixel."""
    scale = SHORTEST / min(height, width)
    # In two steps, as there: one alone rounds otherwise at a half.
    high, wide = (float(SHORTEST), scale * width) if height < width else (scale * height, float(SHORTEST))
    less = min(LONGEST / max(high, wide), 1.0)
    return max(int(high * less + 0.5), 1), max(int(wide * less + 0.5), 1)


MASK_THRESHOLD = 0.5


def paste_masks(
    masks: np.ndarray, boxes: np.ndarray, height: int, width: int, threshold: float = MASK_THRESHOLD
) -> np.ndarray:
    """(N, height, width) bool: where the mask in each box is at least the threshold.

    What `paste_masks_in_image` of detectron2 computes: the mask is sampled bilinearly at the centre of each pixel,
    pixel centres to pixel centres, and is zero outside (grid_sample with align_corners=False). The bilinear weights
    are a product of one along each axis, so two matrix products do it. Outside its box a mask of probabilities
    stays below a half, so that only the box needs looking at.

    `masks` (N, h, w) float: Probabilities; `boxes` (N, 4) float: x0, y0, x1, y1 in pixels, within the picture.
    """
    pasted = np.zeros((len(masks), height, width), np.bool_)
    for k, (x0, y0, x1, y1) in enumerate(boxes.astype(np.float64)):
        left, top = max(int(np.floor(x0)), 0), max(int(np.floor(y0)), 0)
        right, bottom = min(int(np.ceil(x1)), width), min(int(np.ceil(y1)), height)
        if right <= left or bottom <= top or x1 <= x0 or y1 <= y0:
            continue
        rows = _weights(np.arange(top, bottom), y0, y1, masks.shape[1])
        columns = _weights(np.arange(left, right), x0, x1, masks.shape[2])
        pasted[k, top:bottom, left:right] = rows @ masks[k].astype(np.float64) @ columns.T >= threshold
    return pasted


def _weights(pixels: np.ndarray, low: float, high: float, cells: int) -> np.ndarray:
    """Weights (P, cells) of a mask's cells at pixel centres along an axis of a box."""
    position = (pixels + 0.5 - low) / (high - low) * cells - 0.5
    return np.maximum(1 - np.abs(position[:, None] - np.arange(cells)), 0)
