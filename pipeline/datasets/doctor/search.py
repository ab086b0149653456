"""Search for the hypothesis with the best landing of posed views, and equally good ones."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import field, replace
from functools import cache, cached_property
from typing import Any

import numpy as np

from pipeline.datasets.doctor.seen import Landing, Seen, Views, detail_of, land
from pipeline.datasets.meant import LEFT_RIGHT
from pipeline.geometry.camera import CONVENTIONS, STANDARD
from pipeline.language.counted import counted
from pipeline.system.frozen import dataclass

RESIZED = (0.5, 2.0, 1 / 3, 3.0, 0.25, 4.0, 2 / 3, 1.5)
"""Sizes of a picture whose camera is told, by the size of those that are read."""
NEAR_MIDDLE = 0.06
"""A principal point is of such a size where it is then so near to the middle, by the width."""
SWAPPED, MIDDLE = "cx and cy swapped", "principal point in the middle"
OTHER_SIDES = "principal point counted from the other side"
LEAST_OFF = 0.01
"""A principal point nearer to the middle, by the width, is the same from either side."""


@dataclass(frozen=True)
class Cause:
    """A candidate fault and the settings to fix it."""

    about: str  # What it is of, one of `suspicions.SUBJECTS`; "" where nothing is wrong
    words: str  # What is true then
    mend: Mapping[str, Any] = field(default_factory=dict, compare=False)  # What `Seen.mended` takes


AS_READ = Cause("", "")


KIND, MAP, PICTURES = "depth kind", "depth map", "pictures"
"""Subjects of what pictures and depth maps mean."""
WHERE_MEANT = {
    (KIND, "depth_is"): {
        "distance": "depth is the distance to the camera and not along its axis",
        "inverse": "depth is inverse",
    },
    (MAP, "depth_turned"): {
        **{turn: f"depth maps are turned by {turn} degrees against colour" for turn in ("90", "180", "270")},
        "left-right": "depth maps are mirrored left to right against colour",
        "top-bottom": "depth maps are upside down against colour",
    },
    (PICTURES, "mirrored"): {
        "left-right": "colour and depth are mirrored left to right",
        "top-bottom": "colour and depth are mirrored top to bottom",
    },
}
"""By subject and setting its values, and what is true with each."""
INVERSE_MEDIAN_M = 2.0
"""Inverse depth is first looked at in such a unit that it has this median."""


def causes(seen: Seen, meant: Sequence[str] = (KIND, MAP, PICTURES)) -> tuple[Cause, ...]:
    """Candidate causes for frames, except pose time shifts; of what pictures mean those of some subjects."""
    K, (height, width) = seen.intrinsics, seen.frames[0].depth.shape
    found = [] if K is None else other_centers(K, (height, width))
    found += [cause for subject in meant for cause in meanings(seen, subject)]
    found += [Cause("poses", f"poses are {name}", {"poses": name}) for name in CONVENTIONS if name != STANDARD]
    return AS_READ, *found


def other_centers(K: np.ndarray, size: tuple[int, int]) -> list[Cause]:
    """Other readings of (3, 3) intrinsics by principal point, for pictures of (height, width)."""
    fx, fy, cx, cy = K[0, 0], K[1, 1], K[0, 2], K[1, 2]
    middle = (size[1] - 1) / 2, (size[0] - 1) / 2
    found = [(SWAPPED, (fx, fy, cy, cx)), (MIDDLE, (fx, fy, *middle))]
    across, down = (abs(c - m) > LEAST_OFF * size[1] for c, m in zip((cx, cy), middle, strict=True))
    sides = [(across, down), *(((True, False), (False, True)) if across and down else ())] if across or down else []
    for x, y in sides:
        from_side = (size[1] - 1 - cx if x else cx, size[0] - 1 - cy if y else cy)
        found.append(
            (OTHER_SIDES + ("" if (x, y) == (across, down) else (" across" if x else " down")), (fx, fy, *from_side))
        )
    for by in RESIZED:
        if max(abs(cx / by - middle[0]), abs(cy / by - middle[1])) < NEAR_MIDDLE * size[1]:
            found.append((f"intrinsics of a picture {by:.2g} times as large", (fx / by, fy / by, cx / by, cy / by)))
    return [Cause("principal point", words, {"intrinsics": tuple(map(float, four))}) for words, four in found]


def meanings(seen: Seen, subject: str) -> list[Cause]:
    """Causes of what pictures and depth maps may mean, of one subject."""
    height, width = seen.frames[0].depth.shape
    found = []
    for (about, key), values in WHERE_MEANT.items():
        for value, words in values.items() if about == subject else ():
            mend: dict[str, Any] = {key: value}
            if value == "inverse" and seen.units is not None:
                mend["depth_scale"] = seen.units * INVERSE_MEDIAN_M * seen.median_depth
            if value not in ("90", "270") or height == width:
                found.append(Cause(about, words, mend))
    return found


def late(shift: int) -> Cause:
    """Cause of poses shifted by `shift` places."""
    when = f"poses are of frames {counted(abs(shift), 'place')} {'later' if shift > 0 else 'earlier'}"
    return Cause("time", when, {"pose_shift": shift})


SURE = 4.0
LEAST_LEAD = 0.006
"""One hypothesis is better than another where its lead over the blocks is so many standard errors, and so much."""
LEAST_MET = 0.1
"""Where fewer of the lifted points meet a surface, the others count as not landing."""


@dataclass(frozen=True)
class Hypothesis:
    """A hypothesis relative to the recording as read."""

    scale: float = 1.0  # True depth by depth as read
    focal: float = 1.0  # True focal length by the one read, or by the cause's
    cause: Cause = AS_READ  # What else is wrong

    def intrinsics(self, K: np.ndarray) -> np.ndarray:
        """Intrinsics (..., 3, 3) under the hypothesis."""
        out = np.array(K, np.float64)
        out[..., [0, 1], [0, 1]] *= self.focal
        return out

    def landing(self, views: Views, tolerance: float, colour: bool = False) -> Landing:
        """Landing of points of views under the hypothesis; see `land`."""
        return land(views, self.intrinsics(views.K), views.poses, self.scale, tolerance, colour)

    @property
    def words(self) -> str:
        """Fault in words."""
        parts = [
            f"depth {self.scale:.3g} times as far" if abs(self.scale - 1) > 1e-6 else "",
            f"focal length {self.focal:.3g} times as long" if abs(self.focal - 1) > 1e-6 else "",
            self.cause.words,
        ]
        return ", ".join(part for part in parts if part) or "all as read"

    @property
    def deviations(self) -> float:
        """Complexity: number of faults, then magnitude."""
        numbers = [abs(np.log(self.scale)), abs(np.log(self.focal))]
        return sum(n > 1e-9 for n in numbers) + (self.cause != AS_READ) + min(sum(numbers), 9.0) / 10


def score(landing: Landing) -> float:
    """Share of points landing on a surface, 0..1, among points meeting a surface."""
    met = max(float(landing.met.sum()), LEAST_MET * float(landing.lifted.sum()), 1.0)
    return float(landing.landed.sum()) / met


def by_block(landing: Landing, views: Views) -> np.ndarray:
    """Score 0..1 of each block of each pair, (P * B,). NaN where a pair has no pose."""
    met = np.maximum(landing.met, np.maximum(LEAST_MET * landing.lifted, 1.0))
    return np.where(posed(views.poses, views.pairs)[:, None], landing.landed / met, np.nan).ravel()


def posed(poses: np.ndarray, pairs: np.ndarray) -> np.ndarray:
    """(P,) bool: whether both views of each pair have poses ((F, 4, 4), NaN where missing)."""
    known = np.isfinite(poses[:, 0, 0])
    return known[pairs[:, 0]] & known[pairs[:, 1]]


def surely_positive(lead: np.ndarray, sure: float = SURE) -> bool:
    """Test whether a lead per block ((N,), NaN unknown) exceeds chance."""
    lead = lead[np.isfinite(lead)]
    error = lead.std(ddof=1) / np.sqrt(len(lead)) if len(lead) > 1 else np.inf
    return bool(len(lead) and lead.mean() > max(sure * error, LEAST_LEAD))


COARSE, MEDIUM, FINE = 0.08, 0.03, 0.012
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

    def __init__(self, seen: Seen, meant: Sequence[str] = (KIND, MAP, PICTURES)) -> None:
        frames, scenes = seen.frames, seen.scenes
        self.seen = seen
        posed = [frame.camera.T_world_camera is not None for frame in frames]
        many = range(len(frames))
        pairs = [(a, b) for a in many for b in many if a != b and scenes[a] == scenes[b] and posed[a] and posed[b]]
        array = np.array(pairs, np.int64).reshape(-1, 2)
        self.coarse, self._fine = (views_of(seen, array, grid) for grid in (COARSE_GRID, FINE_GRID))
        self._fine = replace(self._fine, detail=np.stack([detail_of(f.rgb) for f in frames]))
        self.causes = causes(seen, meant)
        self.views = cache(self._views)
        self.refined = cache(self._climbed)
        self._landed = cache(self._land)

    def _views(self, cause: Cause, coarse: bool = False) -> Views:
        """Views of the frames under a cause."""
        like = self.coarse if coarse else self.fine
        if cause == AS_READ:
            return like
        if coarse:
            return views_like(like, self.seen, self.seen.mended(cause.mend))
        # Depth maps are large: each is kept once.
        known = self.views(cause, coarse=True)
        detail = like.detail
        if detail is not None and (way := cause.mend.get("mirrored")):
            detail = np.flip(detail, axis=2 if way == LEFT_RIGHT else 1)
        return replace(known, pairs=like.pairs, u=like.u, v=like.v, z=known.depth[:, like.v, like.u], detail=detail)

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
            adjacent = [s for s in (best - 1, best + 1) if s and s not in found and abs(s) <= FARTHEST]
            tried = len(found)
            add(adjacent)
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

    def _climbed(self, start: Hypothesis, names: tuple[str, ...] = ("scale", "focal")) -> Hypothesis:
        """Local optimum of a hypothesis over the given numbers."""
        best = start
        for tolerance, steps in ((MEDIUM, (0.2, 0.1, 0.05)), (FINE, (0.04, 0.02, 0.01, 0.005))):
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
        lead, found = self._landed(hypothesis, tolerance)
        if np.isfinite(lead).all():
            return found
        lead = lead - self._landed(Hypothesis(), tolerance)[0]
        return self.at(Hypothesis(), tolerance) + (float(np.nanmean(lead)) if np.isfinite(lead).any() else -1.0)

    def beats(self, one: Hypothesis, other: Hypothesis, sure: float = SURE) -> bool:
        """Test whether the first hypothesis surely beats the other, block by block."""
        return surely_positive(self._landed(one, FINE)[0] - self._landed(other, FINE)[0], sure)

    def _land(self, hypothesis: Hypothesis, tolerance: float) -> tuple[np.ndarray, float]:
        """Score of each block, and of all."""
        views = self.views(hypothesis.cause)
        landing = hypothesis.landing(views, tolerance, colour=tolerance == FINE)
        return by_block(landing, views), score(landing)

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
    if all(a.depth is b.depth for a, b in zip(frames, seen.frames, strict=True)):
        views = replace(views, depth=like.depth)
    changed = any(a.rgb is not b.rgb for a, b in zip(frames, seen.frames, strict=True))
    detail = np.stack([detail_of(f.rgb) for f in frames]) if changed and like.detail is not None else like.detail
    return replace(views, u=like.u, v=like.v, z=views.depth[:, like.v, like.u], detail=detail)
