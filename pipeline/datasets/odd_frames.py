"""Odd frames of a recording: missing depth, and jumps of pose and depth against what is usual in the recording.

Each value is compared with the median and the median absolute deviation of its scene, so that slow and fast recordings
have a scale of their own. Colour is never decoded.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Iterable, Mapping, Sequence
from types import MappingProxyType

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from pipeline.datasets.base import Dataset, load_depth, load_pose, scenes_of
from pipeline.datasets.cameras import or_note
from pipeline.datasets.frame_reports import spread
from pipeline.system.frozen import dataclass

MOST_POSES, MOST_DEPTHS = 100_000, 2_000
"""So many frames are asked for their pose and for their depth, which must be decoded; evenly spread over more."""
GRID = 24, 32
"""Depth is compared at so many rows and columns."""
NEIGHBOURS = 5
"""Depth of frames farther apart than so many places is not compared: it changes without a fault."""
LEAST_COMMON = 0.1
"""Share of them that two frames must both have depth at."""
DEVIATIONS = 9.0
"""An odd value is so many median absolute deviations above the median."""
AROUND = 5
"""So many frames on either side tell a jump from fast motion that goes on."""
MANY_TIMES = 2.0
"""What is odd is above the median by at least so many times the median: few or irregular frames have no deviation."""
LEAST_OWN = 8
"""A scene of fewer values is compared with all scenes."""
LEAST_IN_ALL = 6
"""Of fewer values none is sudden: nothing tells what is usual."""


@dataclass(frozen=True)
class OddFrame:
    """Oddness of a frame; None where it was not looked at, cannot be read, or has nothing to be compared with."""

    id: str
    depth_missing: float | None  # Share of the pixels without depth, 0..1
    oddness: float | None  # From 1 on it is odd
    reasons: tuple[str, ...] = ()  # In words, the oddest first; empty below 1


@dataclass(frozen=True)
class Measure:
    """A value by which a frame may be odd."""

    words: str  # With places for the value and for "before" or "around"
    least: float  # An odd value is at least so far above the median
    sudden: bool = True  # Whether it is odd only where it is above the median of the frames around, too


MEASURES = (
    Measure("pose jumps {:.1f} m from the frames {}", 0.1),
    Measure("view turns {:.0f}° from the frames {}", 10.0),
    Measure("depth changes by {:.1f} m at the median from the frames {}", 0.2),
    Measure("no depth in {:.0%}", 0.2, sudden=False),
)


@dataclass(frozen=True)
class DepthSample:
    """What is compared of a depth map."""

    grid: np.ndarray  # (N,) float32, metres, of `GRID` rows and columns
    missing: float  # Share of the pixels without depth, 0..1

    @classmethod
    def of(cls, depth: np.ndarray) -> DepthSample:
        """Sample a depth map, (H, W) float32, metres."""
        rows, columns = (np.linspace(0, size - 1, n).astype(int) for n, size in zip(GRID, depth.shape, strict=True))
        return cls(depth[np.ix_(rows, columns)].ravel(), 1 - np.count_nonzero(depth) / depth.size)


def odd_frames(
    dataset: Dataset,
    most_poses: int = MOST_POSES,
    most_depths: int = MOST_DEPTHS,
    progress: Callable[[int, int], None] = lambda done, total: None,
    known: Mapping[int, DepthSample] = MappingProxyType({}),
) -> tuple[OddFrame, ...]:
    """Oddness of each frame of a dataset, in its order. `progress` takes the depth maps read so far, and of how many;
    `known`: by index, those that were read already.

    A frame is compared with the two before it in its scene, and the nearer of them counts: after a single odd frame the
    next one is like the one before it.
    """
    ids = dataset.frame_ids
    poses: dict[int, np.ndarray | None] = {}
    grids: dict[int, np.ndarray | None] = {}
    missing, chosen = np.full(len(ids), np.nan), spread(len(ids), most_depths)
    near = len(ids) <= NEIGHBOURS * len(chosen)
    for k in spread(len(ids), most_poses):
        poses[k] = or_note([], "", load_pose, dataset, ids[k])
        progress(0, len(chosen))
    for done, k in enumerate(chosen):
        sample = known.get(k)
        if sample is None and (depth := or_note([], "", load_depth, dataset, ids[k])) is not None:
            sample = DepthSample.of(depth)
        if sample is not None:
            missing[k] = sample.missing
            if near:
                grids[k] = sample.grid
        progress(done + 1, len(chosen))
    scenes: defaultdict[str, list[int]] = defaultdict(list)
    for k, scene in enumerate(scenes_of(dataset)):
        scenes[scene].append(k)
    places = tuple(scenes.values())
    changes = ((poses, _distances), (poses, _turns), (grids, _depth_changes))
    values = np.stack([*(_changes(found, apart, places, len(ids)) for found, apart in changes), missing])
    scores = np.stack([_scores(row, m, places) for row, m in zip(values, MEASURES, strict=True)])
    first = {k for own in places for k in own[:2]}
    return tuple(
        _odd_frame(frame_id, values[:, k], scores[:, k], "around" if k in first else "before")
        for k, frame_id in enumerate(ids)
    )


def _changes(
    found: Mapping[int, np.ndarray | None],
    apart: Callable[[np.ndarray, np.ndarray], np.ndarray],
    scenes: Iterable[Sequence[int]],
    count: int,
) -> np.ndarray:
    """Distance of each frame from the nearer of the two known ones before it, (count,); the first two of a scene from
    those around them."""
    out = np.full(count, np.nan)
    for places in scenes:
        known = [k for k in places if found.get(k) is not None]
        if len(known) > 1:
            stack = np.array([found[k] for k in known])
            one, two = apart(stack[:-1], stack[1:]), apart(stack[:-2], stack[2:])
            out[known[2:]] = np.fmin(one[1:], two)
            out[known[0]], out[known[1]] = np.fmin.reduce([*one[:1], *two[:1]]), np.fmin.reduce(one[:2])
    return out


def _distances(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return np.linalg.norm(a[:, :3, 3] - b[:, :3, 3], axis=1)


def _turns(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    cosines = (np.einsum("kij,kij->k", a[:, :3, :3], b[:, :3, :3]) - 1) / 2
    return np.rad2deg(np.arccos(np.clip(cosines, -1, 1)))


def _depth_changes(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Median change over the grid, metres; NaN where too little is seen by both."""
    change = np.where((a > 0) & (b > 0), np.abs(a - b), np.nan)
    enough = np.isfinite(change).mean(axis=1) >= LEAST_COMMON
    out = np.full(len(change), np.nan)
    out[enough] = np.nanmedian(change[enough], axis=1)
    return out


def _scores(values: np.ndarray, measure: Measure, scenes: Iterable[Sequence[int]]) -> np.ndarray:
    """Excess over what is usual in the scene, by the excess that is odd, (count,); over all scenes for few values."""
    out = np.full(len(values), np.nan)
    everywhere = _usual(values[np.isfinite(values)])
    if measure.sudden and np.isfinite(values).sum() < LEAST_IN_ALL:
        return out
    for places in scenes:
        known = [k for k in places if np.isfinite(values[k])]
        own = values[known]
        median, deviation = _usual(own) if len(known) >= LEAST_OWN else everywhere
        least = np.maximum(DEVIATIONS * deviation, measure.least)
        if measure.sudden and known:
            around = sliding_window_view(np.pad(own, AROUND, "symmetric"), 2 * AROUND + 1)
            median = np.maximum(median, np.median(around, axis=1))
            least = np.maximum(least, MANY_TIMES * median)
        out[known] = (own - median) / least
    return out


def _usual(known: np.ndarray) -> tuple[float, float]:
    """Median and median absolute deviation."""
    median = float(np.median(known)) if len(known) else np.nan
    return median, float(np.median(np.abs(known - median))) if len(known) else 0.0


def _odd_frame(frame_id: str, values: np.ndarray, scores: np.ndarray, where: str) -> OddFrame:
    order = sorted(np.flatnonzero(scores >= 1), key=lambda m: -scores[m])
    return OddFrame(
        frame_id,
        None if np.isnan(values[-1]) else float(values[-1]),
        float(np.nanmax(scores)) if np.isfinite(scores).any() else None,
        tuple(MEASURES[m].words.format(values[m], where) for m in order),
    )
