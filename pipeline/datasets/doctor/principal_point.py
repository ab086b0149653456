"""What a principal point itself says: cameras have it near the middle of their pictures."""

from __future__ import annotations

import numpy as np

from pipeline.datasets.doctor.causes import AS_READ, Cause, causes
from pipeline.datasets.doctor.trying import Opinion
from pipeline.geometry.landing import Views

ODD, EVEN = 0.08, 0.04
"""One so far off the middle is rare, by shares of the width, and one so near to it common."""


def center_by_middle(K: np.ndarray, size: tuple[int, int]) -> tuple[Opinion | None, Cause]:
    """An opinion on it, None where it tells nothing, and the cause: two numbers swapped, or those of another size.

    Parameters
    ----------
    K : (3, 3) float64
    size : (int, int)
        Height and width, pixels.
    """
    middle = np.array([(size[1] - 1) / 2, (size[0] - 1) / 2])

    def off(center: np.ndarray) -> float:
        return float(np.abs(center - middle).max() / size[1])

    nothing = np.zeros((0, 4, 4))
    views = Views(np.zeros((0, *size)), K[None], nothing, nothing, nothing, nothing, nothing)
    told = off(K[:2, 2])
    text = f"it is {told * size[1]:.0f} pixels off the middle of the picture"
    evidence = {"off_middle": round(told * size[1], 1)}
    if told <= EVEN:
        return Opinion("principal point", "fine", text, evidence=evidence), AS_READ
    if told <= ODD:
        return None, AS_READ
    for cause in causes(views):
        then = off(cause.applied(views).K[0, :2, 2])
        if cause.about == "principal point" and "middle" not in cause.words and then <= EVEN:
            key = "off_middle_swapped" if "swapped" in cause.words else "off_middle_resized"
            evidence |= {key: round(then * size[1], 1)}
            text = f"{text}, and {then * size[1]:.0f} with {cause.words}"
            return Opinion("principal point", "wrong", text, evidence=evidence), cause
    return None, AS_READ
