"""Search for the warp between a depth and a colour camera that puts outlines of depth on edges of colour."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from pipeline.geometry.outlines import NEAR_PX, Outlines, mean_known
from pipeline.geometry.registration import Registration

FOCALS = (0.76, 0.8, 0.84, 0.88, 0.92, 0.96, 1.0, 1.04, 1.08, 1.13, 1.18, 1.24, 1.3)
SHIFTS_M = (-0.06, -0.03, 0.0, 0.03, 0.06)
"""Where the search begins: focal lengths of the colour camera by the depth camera's, and shifts, metres."""
MOST_FOCAL, MOST_M, MOST_CENTER = 1.4, 0.12, 0.1
"""And its bound: a focal length so many times as long or short, metres aside, and a principal point that is off by a
share of the width."""
EVERY = 3
"""Of the outlines, where the search begins."""
BEGUN = 6
"""So many of the beginnings are followed."""
LOOKING = ((2.0, 3 * NEAR_PX, EVERY), (1.0, 2 * NEAR_PX, EVERY))
SETTLING = ((0.5, NEAR_PX, 1), (0.25, NEAR_PX, 1), (0.12, NEAR_PX, 1))
"""Steps in hundredths and centimetres, the tolerance at each, pixels, and how many of the outlines are left out."""


@dataclass(frozen=True)
class WarpEstimate:
    """A warp found by the search."""

    warp: Registration
    bounded: bool  # It lies at the bound of what is searched, so that it is none


def estimate_warp(
    outlines: Outlines, regions: np.ndarray | None = None, near: Registration | None = None
) -> WarpEstimate:
    """Estimate the warp with most outlines of depth on edges of colour, region by region; one for all frames.

    Of `regions`, (R,) bool, all count by default; the search starts at no warp and `near`, by default everywhere.
    """
    identity = Registration.none(outlines.camera)
    own = {(near, every): outlines.near(identity, near, every) for _, near, every in (*LOOKING, *SETTLING)}

    def gain(warp: Registration, tolerance: float, every: int) -> float:
        # What leaves the picture is taken to lie as it did.
        gained = np.nan_to_num(outlines.near(warp, tolerance, every) - own[tolerance, every])
        by_region = outlines.by_region(gained, every)
        return mean_known(by_region if regions is None else by_region[regions])

    starts = [
        replace(identity, fx=identity.fx * f, fy=identity.fy * f, tx=tx, ty=ty)
        for f in FOCALS
        for tx in SHIFTS_M
        for ty in SHIFTS_M[1:-1]
    ]
    begun = [identity, near] if near else sorted(starts, key=lambda warp: -gain(warp, *LOOKING[0][1:]))[:BEGUN]
    climbed = [_climbed(warp, gain, LOOKING) for warp in begun]
    best = _climbed(max(climbed, key=lambda warp: gain(warp, *LOOKING[-1][1:])), gain, SETTLING)
    center = max(abs(best.cx - identity.cx), abs(best.cy - identity.cy)) / outlines.away.shape[3]
    focal = abs(np.log(best.fx / identity.fx)) / np.log(MOST_FOCAL)
    aside = max(abs(best.tx), abs(best.ty)) / MOST_M
    return WarpEstimate(best, bool(max(focal, aside, center / MOST_CENTER) >= 1))


def _climbed(
    best: Registration,
    gain: Callable[[Registration, float, int], float],
    levels: Sequence[tuple[float, float, int]],
) -> Registration:
    """Climb to the nearest optimum, by steps and tolerances that become finer."""
    for step, tolerance, every in levels:
        share, metres, pixels = 0.01 * step, 0.01 * step, 4.0 * step
        value = gain(best, tolerance, every)
        for _ in range(8):
            near = [
                *(replace(best, fx=best.fx * (1 + way * share), fy=best.fy * (1 + way * share)) for way in (-1, 1)),
                *(replace(best, tx=best.tx + way * metres) for way in (-1, 1)),
                *(replace(best, ty=best.ty + way * metres) for way in (-1, 1)),
                *(best.moved(way * pixels, 0) for way in (-1, 1)),
                *(best.moved(0, way * pixels) for way in (-1, 1)),
                *(replace(best.moved(way * pixels, 0), tx=best.tx - way * metres) for way in (-1, 1)),
                *(replace(best.moved(0, way * pixels), ty=best.ty - way * metres) for way in (-1, 1)),
            ]
            found, k = max((gain(warp, tolerance, every), k) for k, warp in enumerate(near))
            if found <= value + 1e-4:
                break
            value, best = found, near[k]
    return best
