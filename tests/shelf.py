"""A frame of known things for detectors made of annotations, and detections as rows that compare."""

from __future__ import annotations

from typing import Any

import numpy as np

from pipeline.geometry import Annotation, Camera, Frame, intrinsics
from pipeline.proposals import Proposals

NAMES = ("mug", "laptop", "book", "lamp", "chair")
H, W = 240, 320
V, U = np.mgrid[:H, :W]
CAMERA = Camera(intrinsics(280, 280, (W - 1) / 2, (H - 1) / 2), W, H)
RGB = np.zeros((H, W, 3), np.uint8)
DEPTH = np.full((H, W), 2.0, np.float32)


def shelf(name: str, rows: int = 4, columns: int = 5, masks: bool = True) -> Frame:
    """Twenty discs of five classes in rows, none touching another."""
    found = []
    for k in range(rows * columns):
        x, y = 32 + 64 * (k % columns), 30 + 60 * (k // columns)
        mask = (U - x) ** 2 + (V - y) ** 2 <= 18**2
        bbox = np.array([x - 18, y - 18, x + 19, y + 19], np.float32)
        found.append(Annotation(k, NAMES[k % len(NAMES)], bbox, mask if masks else None))
    return Frame(name, RGB, DEPTH, CAMERA, tuple(found))


SHELF = shelf("scene/0")


def rows_of(found: Proposals) -> list[tuple[Any, ...]]:
    assert found.masks is not None
    return [
        (int(found.ids[i]), found.label(i), float(found.scores[i]), found.boxes[i].tobytes(), found.masks[i].tobytes())
        for i in range(len(found))
    ]
