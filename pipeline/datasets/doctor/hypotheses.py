"""Explanations of a recording: candidate causes, and scales of depth and focal length relative to the files.

A cause is what is kept where it is true. Frames are read with it (`Seen.mended`), and their views compared with those
that were read, so that what is tried is what is mended. Another one, such as pictures that are mirrored, is one more
entry here, and its key one more line there.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from pipeline.datasets.doctor.seen import Seen
from pipeline.geometry.landing import Landing, Views, land
from pipeline.geometry.pose_convention import CONVENTIONS, STANDARD
from pipeline.language.counted import counted

RESIZED = (0.5, 2.0, 1 / 3, 3.0, 0.25, 4.0, 2 / 3, 1.5)
"""Sizes of a picture whose camera is told, by the size of those that are read."""
NEAR_MIDDLE = 0.06
"""A principal point is of such a size where it is then so near to the middle, by the width."""
SWAPPED, MIDDLE = "cx and cy swapped", "principal point in the middle"


@dataclass(frozen=True)
class Cause:
    """A candidate fault and the settings to fix it."""

    about: str  # What it is of, one of `trying.SUBJECTS`; "" where nothing is wrong
    words: str  # What is true then
    mend: Mapping[str, Any] = field(default_factory=dict, compare=False)  # What `Seen.mended` takes


AS_READ = Cause("", "")


def causes(seen: Seen) -> tuple[Cause, ...]:
    """Candidate causes for frames, except pose time shifts."""
    K, (height, width) = seen.intrinsics, seen.frames[0].depth.shape
    found = [] if K is None else other_centers(K, (height, width))
    found += [Cause("poses", f"poses are {name}", {"poses": name}) for name in CONVENTIONS if name != STANDARD]
    return AS_READ, *found


def other_centers(K: np.ndarray, size: tuple[int, int]) -> list[Cause]:
    """Other readings of (3, 3) intrinsics by principal point, for pictures of (height, width)."""
    fx, fy, cx, cy = K[0, 0], K[1, 1], K[0, 2], K[1, 2]
    middle = (size[1] - 1) / 2, (size[0] - 1) / 2
    found = [(SWAPPED, (fx, fy, cy, cx)), (MIDDLE, (fx, fy, *middle))]
    for by in RESIZED:
        if max(abs(cx / by - middle[0]), abs(cy / by - middle[1])) < NEAR_MIDDLE * size[1]:
            found.append((f"intrinsics of a picture {by:.2g} times as large", (fx / by, fy / by, cx / by, cy / by)))
    return [Cause("principal point", words, {"intrinsics": tuple(map(float, four))}) for words, four in found]


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
