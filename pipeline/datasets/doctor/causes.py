"""What may be wrong with a camera, a unit or poses, and the views as they would be then: the list that is tried."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from pipeline.geometry.landing import Views
from pipeline.geometry.pose_convention import CONVENTIONS, STANDARD, standard_poses

RESIZED = (0.5, 2.0, 1 / 3, 3.0, 0.25, 4.0, 2 / 3, 1.5)
"""Sizes of a picture whose camera is told, by the size of those that are read."""
NEAR_MIDDLE = 0.06
"""A principal point is of such a size where it is then so near to the middle, by the width."""


@dataclass(frozen=True)
class Cause:
    """One thing that may be wrong and is no number.

    Attributes
    ----------
    about : str
        What it is of, one of `trying.SUBJECTS`; "" where nothing is wrong.
    words : str
        What is true then.
    mend : dict
        What `write_settings` is to keep then; without what follows from the intrinsics.
    applied : callable
        The views as they are read, to those that are true then.
    """

    about: str
    words: str
    mend: Mapping[str, Any] = field(default_factory=dict, compare=False)
    applied: Callable[[Views], Views] = field(default=lambda views: views, compare=False, repr=False)


AS_READ = Cause("", "")


def causes(views: Views) -> tuple[Cause, ...]:
    """All that are tried of views, but for the time of their poses."""
    size = views.size
    middle = np.array([(size[1] - 1) / 2, (size[0] - 1) / 2])
    found = [
        Cause("principal point", "cx and cy swapped", applied=lambda v: _centred(v, v.K[:, 1::-1, 2])),
        Cause("principal point", "principal point in the middle", applied=lambda v: _centred(v, middle)),
    ]
    told = views.K[0, :2, 2]
    for by in RESIZED:
        if np.abs(told / by - middle).max() < NEAR_MIDDLE * size[1]:
            words = f"intrinsics of a picture {by:.2g} times as large"
            found.append(Cause("principal point", words, applied=lambda v, by=by: _resized(v, by)))
    for name in CONVENTIONS:
        if name != STANDARD:
            moved = lambda v, name=name: replace(v, poses=standard_poses(v.poses, name))  # noqa: E731
            found.append(Cause("poses", f"poses are {name}", {"poses": name}, moved))
    return AS_READ, *found


def late(shift: int, poses: np.ndarray) -> Cause:
    """Poses that are those of frames some places on ((F, 4, 4), NaN where there is none)."""
    when = f"poses are of frames {abs(shift)} places {'later' if shift > 0 else 'earlier'}"
    return Cause("time", when, {"pose_shift": shift}, lambda views: replace(views, poses=poses))


def _centred(views: Views, center: np.ndarray) -> Views:
    K = views.K.copy()
    K[:, :2, 2] = center
    return replace(views, K=K)


def _resized(views: Views, by: float) -> Views:
    K = views.K.copy()
    K[:, :2] /= by
    return replace(views, K=K)
