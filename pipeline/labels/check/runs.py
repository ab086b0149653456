"""COCO's compressed run-length code of masks, read without trust.

`pycocotools` writes where the code says, whatever its size; so every code is
read here first, and only a sound one is handed on.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from pipeline.geometry.masks import run_lengths


@dataclass(frozen=True)
class MaskRuns:
    """A mask as its code says.

    Attributes
    ----------
    area : int
        Pixels.
    bbox : (4,) float64
        x0, y0, x1, y1, edges exclusive; zeros for an empty mask.
    """

    area: int
    bbox: np.ndarray


def read_runs(code: str, height: int, width: int) -> MaskRuns | str:
    """Area and extents of a mask, or in words why its code is none of that size."""
    counts = run_lengths(code)
    if isinstance(counts, str):
        return counts
    if counts.sum() != height * width:
        return f"it is of {int(counts.sum())} pixels, and the frame has {height * width}"
    edges = np.cumsum(counts)
    start, stop = edges[0::2][: len(counts) // 2], edges[1::2]
    full = stop > start
    start, stop = start[full], stop[full]
    if not len(start):
        return MaskRuns(0, np.zeros(4))
    first, final = start // height, (stop - 1) // height
    # A run over more than one column touches the bottom of one and the top of the next.
    spans = final > first
    top = np.where(spans, 0, start % height).min()
    bottom = np.where(spans, height - 1, (stop - 1) % height).max()
    bbox = np.array([first.min(), top, final.max() + 1, bottom + 1], np.float64)
    return MaskRuns(int((stop - start).sum()), bbox)


def runs_object(code: str, height: int, width: int) -> Any:
    """A code that `read_runs` accepts, as pycocotools takes it."""
    return {"size": [height, width], "counts": code.encode("ascii")}
