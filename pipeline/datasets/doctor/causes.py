"""Candidate causes other than numbers: pose conventions and principal points.

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
