"""Search for the hypothesis with the best landing of posed views, and equally good ones."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from pipeline.datasets.doctor.hypotheses import (
    AS_READ,
    LEAST_MET,
    SURE,
    Cause,
    Hypothesis,
    by_block,
    causes,
    late,
    posed,
    score,
    surely_positive,
)
from pipeline.datasets.doctor.seen import Seen
from pipeline.geometry.landing import Views, detail_of

COARSE, MIDDLE, FINE = 0.08, 0.03, 0.012
"""Relative depth at which a point counts half: while looking around, while refining, and when deciding."""
SCALES = tuple(float(s) for s in np.geomspace(1 / 32, 32, 27))
FOCALS = (0.4, 0.5, 0.63, 0.8, 1.25, 1.6, 2.0, 2.5)
SHIFTS = (-1, 1, -2, 2, -3, 3, -4, 4, -6, 6, -8, 8, -11, 11)
FARTHEST = 14
"""Places by which poses are taken to be late or early; beside the best, more are tried, up to so many."""
COARSE_GRID, FINE_GRID = (8, 10), (20, 26)
NEAREST_PAIRS, MOST_PAIRS = 12, 32
"""Pairs of frames that are compared: those that overlap most, and as many more of all that overlap."""
LEAST_OVERLAP = 0.075
REFINED = 4


@dataclass(frozen=True)
class Range:
    """Plausible range of a number of the best hypothesis."""

    value: float
    low: float
    high: float  # Between these the views land as well; 0 or infinity where nothing tells

    def holds(self, other: float) -> bool:
        return self.low <= other <= self.high

    @property
    def sharp(self) -> float:
        """Relative uncertainty."""
        return max(self.high / self.value, self.value / max(self.low, 1e-9)) - 1


class PosedViews:
    """Posed views of equal size, and explanations of them."""

    def __init__(self, seen: Seen) -> None:
        frames, scenes = seen.frames, seen.scenes
        self.seen = seen
        posed = [frame.camera.T_world_camera is not None for frame in frames]
        many = range(len(frames))
        pairs = [(a, b) for a in many for b in many if a != b and scenes[a] == scenes[b] and posed[a] and posed[b]]
        array = np.array(pairs, np.int64).reshape(-1, 2)
        self.coarse, self._fine = (views_of(seen, array, grid) for grid in (COARSE_GRID, FINE_GRID))
        self._fine = replace(self._fine, detail=np.stack([detail_of(f.rgb) for f in frames]))
        self.causes = causes(seen)
        self._blocks: dict[tuple[Hypothesis, float], np.ndarray] = {}
        self._scores: dict[tuple[Hypothesis, float], float] = {}
        self._refined: dict[tuple[Hypothesis, tuple[str, ...]], Hypothesis] = {}
        self._views: dict[tuple[Cause, bool], Views] = {}

    def views(self, cause: Cause, coarse: bool = False) -> Views:
        """Views of the frames under a cause."""
        key = cause, coarse
        if key not in self._views:
            like = self.coarse if coarse else self.fine
            self._views[key] = like if cause == AS_READ else views_like(like, self.seen, self.seen.mended(cause.mend))
        return self._views[key]

    # What explains the views

    @cached_property
    def looked_around(self) -> tuple[Hypothesis, ...]:
        """The best of each cause but time, the best first."""
        found = []
        for cause in self.causes:
            views = self.views(cause, coarse=True)
            tried = [Hypothesis(scale, 1.0, cause) for scale in SCALES]
            if cause == AS_READ:
                tried += [replace(h, focal=focal) for h in tried for focal in FOCALS]
            scored = [(score(h.landing(views, COARSE)), h) for h in tried]
            found.append(max(scored, key=lambda one: one[0]))
        return tuple(h for _, h in sorted(found, key=lambda scored: -scored[0]))

    @cached_property
    def fine(self) -> Views:
        """Views with pairs overlapping under any of the best explanations."""
        best = np.zeros(len(self._fine.pairs))
        for hypothesis in (*self.looked_around[:2], Hypothesis()):
            landing = hypothesis.landing(self.views(hypothesis.cause, coarse=True), COARSE)
            share = landing.landed.sum(axis=1) / np.maximum(landing.lifted.sum(axis=1), 1)
            best = np.maximum(best, share)
        order = np.argsort(-best, kind="stable")
        order = order[best[order] > LEAST_OVERLAP]
        rest = order[NEAREST_PAIRS:]
        spread = np.linspace(0, len(rest) - 1, min(len(rest), MOST_PAIRS - NEAREST_PAIRS)).astype(int)
        return self._fine.of_pairs(self._fine.pairs[np.sort(np.concatenate([order[:NEAREST_PAIRS], rest[spread]]))])

    @cached_property
    def late(self) -> dict[int, Hypothesis]:
        """Hypotheses by pose shift, in places."""
        found: dict[int, Hypothesis] = {}

        def add(shifts: Sequence[int]) -> None:
            for shift in shifts:
                cause = late(shift)
                known = posed(self.views(cause).poses, self.fine.pairs)
                if 3 * np.count_nonzero(known) > len(known):
                    found[shift] = Hypothesis(cause=cause)

        add(SHIFTS)
        while found:
            best = max(found, key=lambda shift: self.at(found[shift]))
            beside = [s for s in (best - 1, best + 1) if s and s not in found and abs(s) <= FARTHEST]
            tried = len(found)
            add(beside)
            if len(found) == tried:
                break
        return found

    @cached_property
    def best(self) -> Hypothesis:
        """Best explanation, the simplest among equals."""
        best = max(self.explanations, key=self.at)
        simpler = sorted(self.explanations, key=lambda h: h.deviations)
        return next((h for h in simpler if not self.beats(best, h)), best)

    @cached_property
    def explanations(self) -> tuple[Hypothesis, ...]:
        """Explanations compared: as read, numbers alone and together, causes alone and with numbers."""
        plain = Hypothesis()
        starts = [*self.looked_around[:REFINED], Hypothesis(self.looked_around[0].scale)]
        refined = [self.refined(h) for h in starts]
        best = max(refined, key=self.at)
        by_number = [
            self.refined(replace(plain, **{name: getattr(start, name)}), (name,))
            for name in ("scale", "focal")
            for start in (plain, best)
        ]
        of_causes = [Hypothesis(cause=cause) for cause in self.causes]
        mixed = [replace(best, cause=AS_READ), replace(best, scale=1.0), replace(best, focal=1.0)]
        timed = sorted(self.late.values(), key=self.at)[-1:]
        return tuple(dict.fromkeys((plain, *by_number, *of_causes, *timed, *mixed, *refined)))

    def refined(self, start: Hypothesis, names: tuple[str, ...] = ("scale", "focal")) -> Hypothesis:
        """Local optimum of a hypothesis over the given numbers."""
        if (start, names) not in self._refined:
            self._refined[start, names] = self._climbed(start, names)
        return self._refined[start, names]

    def _climbed(self, start: Hypothesis, names: tuple[str, ...]) -> Hypothesis:
        best = start
        for tolerance, steps in ((MIDDLE, (0.2, 0.1, 0.05)), (FINE, (0.04, 0.02, 0.01, 0.005))):
            value = self.at(best, tolerance)
            for step in steps:
                for _ in range(6):
                    near = [
                        replace(best, **{name: getattr(best, name) * (1 + step) ** way})
                        for name in names
                        for way in (-1, 1)
                    ]
                    found, hypothesis = max(((self.at(h, tolerance), h) for h in near), key=lambda one: one[0])
                    if found <= value:
                        break
                    value, best = found, hypothesis
        return best

    # How well

    def at(self, hypothesis: Hypothesis, tolerance: float = FINE) -> float:
        """Score of a hypothesis, by default at the deciding tolerance. Where some poses are missing, what it has before
        the views as read on the other pairs counts."""
        lead = self._of_blocks(hypothesis, tolerance)
        if np.isfinite(lead).all():
            return self._scores[hypothesis, tolerance]
        lead = lead - self._of_blocks(Hypothesis(), tolerance)
        return self.at(Hypothesis(), tolerance) + (float(np.nanmean(lead)) if np.isfinite(lead).any() else -1.0)

    def beats(self, one: Hypothesis, other: Hypothesis, sure: float = SURE) -> bool:
        """Test whether the first hypothesis surely beats the other, block by block."""
        return surely_positive(self._of_blocks(one) - self._of_blocks(other), sure)

    def _of_blocks(self, hypothesis: Hypothesis, tolerance: float = FINE) -> np.ndarray:
        key = hypothesis, tolerance
        if key not in self._blocks:
            views = self.views(hypothesis.cause)
            landing = hypothesis.landing(views, tolerance, colour=tolerance == FINE)
            self._blocks[key], self._scores[key] = by_block(landing, views), score(landing)
        return self._blocks[key]

    def range_of(self, name: str, other: str) -> Range:
        """Range of a number of the best hypothesis, with another number free."""
        value = getattr(self.best, name)
        ends = []
        for way in (-1, 1):
            end = 0.0 if way < 0 else float("inf")
            for share in (0.03, 0.06, 0.1, 0.16, 0.25, 0.4, 0.6, 1.0):
                moved = self.refined(replace(self.best, **{name: value * (1 + share) ** way}), (other,))
                if self.beats(self.best, moved):
                    end = getattr(moved, name)
                    break
            ends.append(end)
        return Range(value, ends[0], ends[1])

    def as_good(self, differs: Callable[[Hypothesis], bool]) -> tuple[Hypothesis, ...]:
        """Explanations passing the test and not surely beaten by the best."""
        return tuple(h for h in self.explanations if differs(h) and not self.beats(self.best, h))

    def of_regions(self, mended: Seen) -> tuple[np.ndarray, np.ndarray]:
        """Landing shares (B,) per block of the pictures, as read and with fixes."""
        other = views_like(self.fine, self.seen, mended)
        pairs = other.pairs[posed(other.poses, other.pairs)]
        if not len(pairs):
            return np.full(1, np.nan), np.full(1, np.nan)
        found = []
        for views in (self.fine, other):
            landing = Hypothesis().landing(views.of_pairs(pairs), FINE, colour=True)
            met = np.maximum(landing.met.sum(axis=0), LEAST_MET * landing.lifted.sum(axis=0))
            found.append(np.where(met > 0, landing.landed.sum(axis=0) / np.maximum(met, 1), np.nan))
        return found[0], found[1]


def views_of(seen: Seen, pairs: np.ndarray, grid: tuple[int, int]) -> Views:
    """Views of frames with pairs and points; missing poses are NaN."""
    cameras = [frame.camera for frame in seen.frames]
    missing = np.array([camera.T_world_camera is None for camera in cameras])
    views = Views.of([frame.depth for frame in seen.frames], cameras, pairs, grid)
    return replace(views, poses=np.where(missing[:, None, None], np.nan, views.poses))


def views_like(like: Views, seen: Seen, mended: Seen) -> Views:
    """Views of the fixed frames, with the same pairs and points; unreadable frames have no pose."""
    by_id = {frame.id: frame for frame in mended.frames}
    frames = [by_id.get(f.id, replace(f, camera=replace(f.camera, T_world_camera=None))) for f in seen.frames]
    views = views_of(replace(mended, frames=tuple(frames)), like.pairs, (1, 1))
    changed = any(a.rgb is not b.rgb for a, b in zip(frames, seen.frames, strict=True))
    detail = np.stack([detail_of(f.rgb) for f in frames]) if changed and like.detail is not None else like.detail
    return replace(views, u=like.u, v=like.v, z=views.depth[:, like.v, like.u], detail=detail)
