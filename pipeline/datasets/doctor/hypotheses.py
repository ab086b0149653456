"""One explanation of a recording: by what depth, focal length, principal point and poses differ from what was read."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pipeline.geometry.landing import Landing, Views, land
from pipeline.geometry.pose_convention import CONVENTIONS, STANDARD, standard_poses

CENTERS = ("told", "swapped", "middle")
"""The principal point as read; its two numbers the other way round; the middle of the picture."""
SURE = 4.0
LEAST_LEAD = 0.006
"""One hypothesis is better than another where its lead over the blocks is so many standard errors, and so much."""
LEAST_MET = 0.1
"""Where fewer of the lifted points meet a surface, the others count as not landing."""


@dataclass(frozen=True)
class Hypothesis:
    """What is true, relative to what was read.

    Attributes
    ----------
    scale : float
        True depth by depth as read.
    focal : float
        True focal length by the one read.
    center : str
        One of `CENTERS`.
    poses : str
        What the pose files mean, one of `CONVENTIONS`.
    shift : (float, float)
        Added to that principal point, pixels.
    """

    scale: float = 1.0
    focal: float = 1.0
    center: str = "told"
    poses: str = STANDARD
    shift: tuple[float, float] = (0.0, 0.0)

    def intrinsics(self, K: np.ndarray, size: tuple[int, int]) -> np.ndarray:
        """(..., 3, 3) intrinsics under it, of those that were read, for pictures of (height, width)."""
        out = np.array(K, np.float64)
        out[..., 0, 0] *= self.focal
        out[..., 1, 1] *= self.focal
        if self.center == "swapped":
            out[..., 0, 2], out[..., 1, 2] = K[..., 1, 2], K[..., 0, 2]
        elif self.center == "middle":
            out[..., 0, 2], out[..., 1, 2] = (size[1] - 1) / 2, (size[0] - 1) / 2
        out[..., :2, 2] += self.shift
        return out

    def landing(self, views: Views, tolerance: float, colour: bool = False) -> Landing:
        """Where the points of views land under it; see `land`."""
        K, poses = self.intrinsics(views.K, views.size), standard_poses(views.poses, self.poses)
        return land(views, K, poses, self.scale, tolerance, colour)

    @property
    def family(self) -> tuple[str, str]:
        """What is not a number in it."""
        return self.center, self.poses


def families() -> tuple[Hypothesis, ...]:
    """One hypothesis of each family that is tried: one thing wrong, or none."""
    return (
        Hypothesis(),
        *(Hypothesis(center=center) for center in CENTERS[1:]),
        *(Hypothesis(poses=poses) for poses in CONVENTIONS if poses != STANDARD),
    )


def score(landing: Landing) -> float:
    """0..1: the share of the points that meet a surface and land on it."""
    met = max(float(landing.met.sum()), LEAST_MET * float(landing.lifted.sum()), 1.0)
    return float(landing.landed.sum()) / met


def by_block(landing: Landing) -> np.ndarray:
    """(P * B,) the same for each block of each pair."""
    met = np.maximum(landing.met, np.maximum(LEAST_MET * landing.lifted, 1.0))
    return (landing.landed / met).ravel()


def surely_positive(lead: np.ndarray) -> bool:
    """Whether what one hypothesis has before another in each block ((N,)) is more than chance."""
    error = lead.std(ddof=1) / np.sqrt(len(lead)) if len(lead) > 1 else np.inf
    return bool(lead.mean() > max(SURE * error, LEAST_LEAD))
