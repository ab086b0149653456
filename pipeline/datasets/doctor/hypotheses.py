"""An explanation of a recording: cause, scale of depth and of focal length relative to the files."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pipeline.datasets.doctor.causes import AS_READ, Cause
from pipeline.geometry.landing import Landing, Views, land

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
    """Score 0..1 of each block of each pair, (P * B,).

    NaN where a pair has no pose.
    """
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
