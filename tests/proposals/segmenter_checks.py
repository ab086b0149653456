"""What tests of segmenters share."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from pycocotools import mask as coco
from scenes import frame_of, upright

from pipeline.geometry import Frame
from pipeline.proposals import Proposals


def iou(a: np.ndarray, b: np.ndarray) -> float:
    return float((a & b).sum() / max((a | b).sum(), 1))


def boxes_of(frame: Frame) -> np.ndarray:
    return np.stack([a.bbox for a in frame.annotations])


def masks_of(frame: Frame) -> list[np.ndarray]:
    masks = [a.mask for a in frame.annotations if a.mask is not None]
    assert len(masks) == len(frame.annotations)
    return masks


def bare(frame: Frame) -> Frame:
    """The frame with boxes only."""
    return replace(frame, annotations=tuple(replace(a, mask=None, box=None) for a in frame.annotations))


@lru_cache(maxsize=1)
def scene() -> Frame:
    """Three boxes on a floor, of random colours in every pixel: only the depth tells them apart."""
    things = [upright((x, 1.0, 1.9 + 0.2 * k), (0.35, 0.4, 0.3), 25 * k) for k, x in enumerate((-0.65, 0.0, 0.65))]
    return frame_of(things, ["mug", "laptop", "mug"], pitch=25)


class Boxes:
    """A detector that is not exact and gives boxes only."""

    name = "boxes"
    exact = False
    vocabulary = None

    def __init__(self, boxes: np.ndarray) -> None:
        self.boxes = boxes.astype(np.float32)

    def fingerprint(self) -> str:
        return "boxes:1"

    def detect(self, frame: Frame, labels: Sequence[str] | None) -> Proposals:
        n = len(self.boxes)
        scores = np.linspace(0.2, 0.9, n).astype(np.float32)
        return Proposals(self.boxes, scores, np.zeros(n, np.int64), ("mug",), None, np.arange(n))


# Recorded masks.


def run_lengths(mask: np.ndarray) -> dict[str, Any]:
    encoded: Any = coco.encode(np.asfortranarray(mask.astype(np.uint8)))
    return {"size": list(mask.shape), "counts": encoded["counts"].decode()}


def coco_file(folder: Path, frame: Frame, name: str = "scene/0.jpg", **change: Any) -> Path:
    annotations = []
    for k, a in enumerate(frame.annotations):
        assert a.mask is not None
        x0, y0, x1, y1 = a.bbox.tolist()
        annotations.append(
            {
                "id": k,
                "image_id": 7,
                "category_id": 1 + (a.label == "laptop"),
                "bbox": [x0, y0, x1 - x0, y1 - y0],
                "segmentation": run_lengths(a.mask),
                "iscrowd": 0,
            }
        )
    content = {
        "info": {},
        "images": [{"id": 7, "file_name": name}, {"id": 8, "file_name": "other.jpg"}],
        "annotations": annotations,
        "categories": [{"id": 1, "name": "mug"}, {"id": 2, "name": "laptop"}],
    } | change
    path = folder / "masks.json"
    path.write_text(json.dumps(content))
    return path
