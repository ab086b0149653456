"""Plausible lengths of the longest edge by class, thin classes, and the factor by which named things are too long."""

from __future__ import annotations

import json
from collections.abc import Sequence
from functools import lru_cache
from pathlib import Path

import numpy as np

from pipeline.language.naming import normal_form, same_class
from pipeline.system.frozen import dataclass

TABLE = Path(__file__).with_name("object_sizes.json")
LEAST_UNFIT, MOST_FIT, LEAST_MENDED = 3, 0.6, 0.9
"""Sizes are wrong where so many things do not fit their classes, no more than this share does, and some factor makes
so many fit. Of 40 frames with right depth all things fitted; at five times it a sixth, at a fifth of it half."""


@lru_cache(maxsize=1)
def size_table() -> dict[str, tuple[float, float]]:
    """Shortest and longest plausible longest edge of each class, metres, by name."""
    longest = json.loads(TABLE.read_text(encoding="utf-8"))["longest_edge_m"]
    return {name: (float(low), float(high)) for name, (low, high) in longest.items()}


@lru_cache(maxsize=65536)
def size_range(label: str) -> tuple[float, float] | None:
    """Range of a class's longest edge, metres, by any of its names; None outside the table.

    >>> from pipeline.language import size_range
    >>> low, high = size_range("mug")
    >>> low < 0.1 < high
    True
    """
    form, table = normal_form(label), size_table()
    ranges = [table[form]] if form in table else [bounds for name, bounds in table.items() if same_class(label, name)]
    return (min(r[0] for r in ranges), max(r[1] for r in ranges)) if ranges else None


@lru_cache(maxsize=65536)
def is_thin(label: str) -> bool:
    """Tell classes whose things may be much less deep than half their width, by any of their names.

    >>> from pipeline.language import is_thin
    >>> is_thin("whiteboard"), is_thin("mug")
    (True, False)
    """
    form = normal_form(label)
    return form in thin_classes() or any(same_class(label, name) for name in thin_classes())


@lru_cache(maxsize=1)
def thin_classes() -> frozenset[str]:
    return frozenset(json.loads(TABLE.read_text(encoding="utf-8"))["thin"])


@dataclass(frozen=True)
class SizeFactor:
    """Factor by which the named things of a frame are too long."""

    # Divided by anything between, most things have sizes of their classes (5 where all is five times too long)
    low: float
    high: float
    things: int  # Things of known classes
    fitting: int  # Things that fit their classes as they are

    @property
    def middle(self) -> float:
        return float(np.sqrt(self.low * self.high))


def size_factor(labels: Sequence[str], lengths: Sequence[float] | np.ndarray) -> SizeFactor | None:
    """Factor by which all named things are too long or too short; None where all fit, or no factor suits all.

    `lengths` are longest edges, metres; those that are not finite and positive, and unknown classes, do not count.
    """
    pairs = [(size_range(label), length) for label, length in zip(labels, lengths, strict=True)]
    known = np.array([(size / r[1], size / r[0]) for r, size in pairs if r and np.isfinite(size) and size > 0])
    if not len(known):
        return None
    low, high = known.T
    fitting = int(((low <= 1) & (high >= 1)).sum())
    # Where most intervals overlap, one of them begins.
    counts = ((low[None] <= low[:, None]) & (high[None] >= low[:, None])).sum(axis=1)
    start = low[int(counts.argmax())]
    end = high[(low <= start) & (high >= start)].min()
    if (
        len(known) - fitting < LEAST_UNFIT
        or fitting > MOST_FIT * len(known)
        or counts.max() < LEAST_MENDED * len(known)
    ):
        return None
    return SizeFactor(float(start), float(end), len(known), fitting)
