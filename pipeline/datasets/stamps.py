"""Times of pictures and poses, and what belongs together by them."""

from __future__ import annotations

import numpy as np

from pipeline.system.errors import require

WITHIN = 0.02
"""Seconds by which two entries of one frame may differ."""
ROUNDING = 1e-6
MOST_PAIRS = 2_000_000
"""Pairs of two lists that may belong together: of an hour at 60 Hz there are half a million."""
_UNITS = ((1e17, 1e-9), (1e14, 1e-6), (1e11, 1e-3))
"""From which size on whole numbers are nanoseconds, microseconds and milliseconds since 1970, with their seconds."""


def as_seconds(stamps: np.ndarray) -> np.ndarray:
    """Times (N,) in seconds, of numbers that may be milli-, micro- or nanoseconds since 1970, told by their size."""
    largest = float(np.max(stamps, initial=0.0))
    return stamps * next((unit for size, unit in _UNITS if largest > size), 1.0)


def nearest(times: np.ndarray, time: float, within: float) -> int | None:
    """Index of the nearest of many times, seconds; None where none is near enough."""
    found = int(np.abs(times - time).argmin()) if len(times) else -1
    return found if found >= 0 and abs(float(times[found]) - time) <= within else None


def match_times(a: np.ndarray, b: np.ndarray) -> dict[int, int]:
    """Matches of two sorted lists of times within 20 ms, nearest first, each time used once. The greedy rule is that of
    the dataset's own associate.py; InputError where the times lie too densely for it."""
    low = np.searchsorted(b, a - WITHIN - ROUNDING, side="left")
    high = np.searchsorted(b, a + WITHIN + ROUNDING, side="right")
    count = high - low
    require(count.sum() <= MOST_PAIRS, f"{count.sum()} pairs of times lie within 20 ms", cause="are they seconds?")
    first = np.repeat(np.arange(len(a)), count)
    second = np.arange(count.sum()) - np.repeat(np.cumsum(count) - count, count) + np.repeat(low, count)
    found: dict[int, int] = {}
    taken: set[int] = set()
    for k in np.argsort(np.abs(a[first] - b[second]), kind="stable").tolist():
        i, j = int(first[k]), int(second[k])
        if i not in found and j not in taken:
            found[i] = j
            taken.add(j)
    return found
