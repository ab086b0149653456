"""Sizes of objects against what their class can be, and against their own kind in the dataset."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path

import numpy as np

from pipeline.labels.check.findings import Finding
from pipeline.labels.check.stream import Rows
from pipeline.labels.check.view import FrameView
from pipeline.language.naming import normal_form, same_class

TABLE = Path(__file__).with_name("object_sizes.json")
LEAST_EXAMPLES = 8
DEVIATIONS = 6.0
LEAST_FACTOR = 2.0
"""An object unlike its kind is at least so many times larger or smaller than the median."""
MAD_SIGMA = 1.4826
"""Standard deviations in one median absolute deviation of a normal distribution."""
HARDLY_OCCLUDED = 0.05

_BINS, _LOWEST, _HIGHEST = 600, np.log(1e-3), np.log(1e2)
_STEP = (_HIGHEST - _LOWEST) / _BINS


@dataclass
class SizeSurvey:
    """How long the objects of each class are: histograms of the logarithm, so that memory grows with classes alone."""

    counts: dict[str, np.ndarray] = field(default_factory=dict)

    def add(self, rows: Rows) -> None:
        """Count the objects of a frame that are seen whole and well."""
        longest, _ = lengths(rows)
        good = np.isfinite(longest) & (longest > 0) & seen_whole(rows)
        for label, length in zip(rows["label"][good], longest[good], strict=True):
            if label is not None:
                bins = self.counts.setdefault(label, np.zeros(_BINS, np.int64))
                bins[int(np.clip((np.log(length) - _LOWEST) / _STEP, 0, _BINS - 1))] += 1

    def spread(self, label: str) -> tuple[float, float, int]:
        """Median and robust deviation of the logarithm, and of how many; to one step of 2 %."""
        bins = self.counts.get(label)
        n = 0 if bins is None else int(bins.sum())
        if bins is None or not n:
            return float("nan"), float("nan"), 0
        center = _LOWEST + (np.arange(_BINS) + 0.5) * _STEP
        median = float(center[np.searchsorted(np.cumsum(bins), n / 2)])
        away = np.abs(center - median)
        order = np.argsort(away)
        deviation = float(away[order][np.searchsorted(np.cumsum(bins[order]), n / 2)])
        return median, max(MAD_SIGMA * deviation, 2 * _STEP), n


def lengths(rows: Rows) -> tuple[np.ndarray, np.ndarray]:
    """Longest edges in metres of the lifted box and of the dataset's own; two (N,) with NaN where there is none."""
    return rows["size"].max(axis=1), rows["exact_size"].max(axis=1)


def seen_whole(rows: Rows) -> np.ndarray:
    """(N,) bool: nothing hides or cuts the object, and its box was cleaned."""
    return ~rows["touches_border"] & (rows["occluded"] < HARDLY_OCCLUDED) & ~rows["fallback"]


@lru_cache(maxsize=1)
def size_table() -> dict[str, tuple[float, float]]:
    """Shortest and longest that the longest edge of a class can be, metres, by name."""
    content = json.loads(TABLE.read_text(encoding="utf-8"))
    return {name: (float(low), float(high)) for name, (low, high) in content["longest_edge_m"].items()}


@lru_cache(maxsize=65536)
def size_range(label: str) -> tuple[float, float] | None:
    """The range of a class, by any of its names; None where the table lacks it."""
    table = size_table()
    form = normal_form(label)
    if form in table:
        return table[form]
    ranges = [bounds for name, bounds in table.items() if same_class(label, name)]
    return (min(r[0] for r in ranges), max(r[1] for r in ranges)) if ranges else None


def check_sizes(view: FrameView, survey: SizeSurvey) -> Iterator[Finding]:
    """Objects that are too large or too small."""
    rows = view.objects
    if not len(rows):
        return
    lifted, exact = lengths(rows)
    whole = seen_whole(rows)
    own_pixels = np.isin(rows["mask_source"].astype(str), ["annotation", "detector"]) & ~rows["fallback"]
    for k, label in enumerate(view.labels):
        found = _against_table(label, lifted[k], exact[k], bool(whole[k]), bool(own_pixels[k]))
        found = found or _against_kind(label, lifted[k], bool(whole[k]), survey)
        if found:
            message, figures, error = found
            yield view.finding(
                "object/implausible-size",
                (view.ids[k],),
                f"{view.named(k)} {message}",
                figures,
                "error" if error else "warning",
            )


Verdict = tuple[str, dict[str, float | int | str], bool]


def _against_table(label: str, lifted: float, exact: float, whole: bool, own_pixels: bool) -> Verdict | None:
    bounds = size_range(label)
    if bounds is None:
        return None
    low, high = bounds
    longest = np.fmax(lifted, exact)
    figures: dict[str, float | int | str] = {"longest_edge": float(longest), "least": low, "most": high}
    if longest > high:
        # A box around pixels that are not all the object's own proves little.
        return f"is {longest:.2f} m long; its class is at most {high:g} m", figures, exact > high or own_pixels
    shortest = exact if np.isfinite(exact) else lifted
    if shortest < low and (whole or np.isfinite(exact)):
        figures["longest_edge"] = float(shortest)
        return f"is {shortest:.3f} m long; its class is at least {low:g} m", figures, False
    return None


def _against_kind(label: str, lifted: float, whole: bool, survey: SizeSurvey) -> Verdict | None:
    median, deviation, n = survey.spread(label)
    if n < LEAST_EXAMPLES or not lifted > 0:
        return None
    away = float(np.log(lifted)) - median
    far = abs(away) > max(DEVIATIONS * deviation, np.log(LEAST_FACTOR))
    if not far or (away < 0 and not whole):
        return None
    figures: dict[str, float | int | str] = {
        "longest_edge": float(lifted),
        "median": float(np.exp(median)),
        "deviations": away / deviation,
        "examples": n,
    }
    return f"is {lifted:.2f} m long; the median of {n} is {np.exp(median):.2f} m", figures, False
