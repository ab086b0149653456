"""Principal point check against the middle of the picture."""

from __future__ import annotations

import numpy as np

from pipeline.datasets.doctor.causes import AS_READ, MIDDLE, SWAPPED, Cause, other_centers
from pipeline.datasets.doctor.trying import Opinion

ODD, EVEN = 0.08, 0.04
"""One so far off the middle is rare, by shares of the width, and one so near to it common."""


def center_by_middle(K: np.ndarray, size: tuple[int, int]) -> tuple[Opinion | None, Cause]:
    """Opinion on the principal point, None without evidence, and the cause: swapped numbers or another image size.

    `K` (3, 3) float64; `size` (int, int): Height and width, pixels.
    """
    middle = np.array([(size[1] - 1) / 2, (size[0] - 1) / 2])
    told = float(np.abs(K[:2, 2] - middle).max())
    text, evidence = f"it is {told:.0f} pixels off the middle of the picture", {"off_middle": round(told, 1)}
    if told <= EVEN * size[1]:
        return Opinion("principal point", "fine", text, evidence=evidence), AS_READ
    for cause in other_centers(K, size) if told > ODD * size[1] else ():
        then = float(np.abs(np.array(cause.mend["intrinsics"][2:]) - middle).max())
        if cause.words != MIDDLE and then <= EVEN * size[1]:
            evidence |= {f"off_middle_{'swapped' if cause.words == SWAPPED else 'resized'}": round(then, 1)}
            text = f"{text}, and {then:.0f} with {cause.words}"
            return Opinion("principal point", "wrong", text, evidence=evidence), cause
    return None, AS_READ
