"""What tests of the relation network share."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scenes import frame_of, upright

from pipeline.geometry import Frame, LiftedObject, Quality, ViewerAxes, extents
from pipeline.geometry.lifting import fit_box


def lifted(points: np.ndarray, viewer: ViewerAxes, mode: Any = "gravity") -> LiftedObject:
    points = points.astype(np.float32)
    box, confidence = fit_box(points, viewer, mode)
    lo, hi = extents(points, box, viewer)
    quality = Quality(len(points), len(points), 1.0, 0.0, False, 2.0, False, "annotation")
    return LiftedObject(points, box, confidence, lo, hi, None, quality)


def random_rows(seed: int, count: int = 6) -> np.ndarray:
    rng = np.random.default_rng(seed)
    lo = rng.uniform((-2, -1, 1), (2, 1, 4), (count, 3))
    return np.concatenate([lo, lo + rng.uniform(0.0, 1.0, (count, 3))], axis=1)


# The scorer.


@pytest.fixture(scope="module")
def scene() -> Frame:
    boxes = [upright((x, 0.9, z), (0.3, 0.3, 0.3)) for x, z in ((-0.6, 2), (0.6, 2), (0, 3.2))]
    return frame_of(boxes, ["a", "b", "c"])
