"""Suspicions, opinions and their fixes; each fix is measured, then kept or withdrawn.

What is looked for is a list of `Suspicion`. Each in turn says what it thinks of its subjects, on the frames as they are
with what was mended before. Where it has a mend, the frames are read with it, and what speaks for it is measured again,
region by region of the picture. It is withdrawn where regions get worse, or where the mended frames ask for another.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Literal, Protocol

import numpy as np

from pipeline.datasets.doctor.seen import Seen

State = Literal["fine", "wrong", "unknown"]
SUBJECTS = ("poses", "depth scale", "focal length", "principal point", "registration", "time", "up")
"""In the order in which they are told."""
GAINING = 0.7
"""So many of the regions must gain by a mend."""
NO_CHANGE = 0.02
MOST_LOSS = 0.08
"""A region that changes by less is as good, and none may lose more."""


@dataclass(frozen=True)
class Opinion:
    """Opinion on a subject."""

    about: str  # One of `SUBJECTS`
    state: State
    text: str  # One sentence with its evidence
    mend: dict[str, Any] = field(default_factory=dict)
    """What `write_settings` is to keep: intrinsics, depth_scale, poses, pose_shift, registration, up."""
    option: str | None = None  # The same as a person tells it
    evidence: dict[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class RegionAgreement:
    """Agreement of frames before and after a fix, region by region."""

    before: np.ndarray
    after: np.ndarray  # (R,) float64: 0..1; NaN where a region says nothing
    least: float  # So much must be gained on average

    @property
    def refusal(self) -> str | None:
        """Reason against the fix, or None."""
        gains = (self.after - self.before)[np.isfinite(self.before) & np.isfinite(self.after)]
        if not len(gains):
            return "no region of the picture shows what it does"
        lost = int((gains < -MOST_LOSS).sum())
        if lost:
            return f"{lost} of {len(gains)} regions of the picture agree less with it"
        gaining = int((gains > NO_CHANGE).sum())
        if gaining < GAINING * len(gains) or gains.mean() < self.least:
            return f"{gaining} of {len(gains)} regions of the picture agree better with it"
        return None


class Suspicion(Protocol):
    """A possible fault of a recording."""

    def opinions(self, seen: Seen, known: Sequence[Opinion]) -> list[Opinion]:
        """Opinions on the subjects, with fixes; `known` are earlier opinions."""
        ...

    def measured(self, seen: Seen, mended: Seen) -> tuple[RegionAgreement, ...]:
        """Measured agreement before and after the fix."""
        ...


def diagnosed(seen: Seen, suspicions: Sequence[Suspicion]) -> tuple[list[Opinion], Seen]:
    """Opinions on each subject in order of suspicions, and the frames with fixes."""
    known: list[Opinion] = []
    for suspicion in suspicions:
        found = suspicion.opinions(seen, known)
        if mend := mends_of(found):
            mended = seen.mended(mend)
            why = next((why for one in suspicion.measured(seen, mended) if (why := one.refusal)), None)
            if why is None and mends_of(suspicion.opinions(mended, known)):
                why = "with it, another one is asked for"
            found = found if why is None else [withdrawn(opinion, why) for opinion in found]
            seen = mended if why is None else seen
        known = [o for o in known if o.about not in {one.about for one in found}] + found
    order = [*SUBJECTS, *(opinion.about for opinion in known)]
    return sorted(known, key=lambda opinion: order.index(opinion.about)), seen


def mends_of(opinions: Sequence[Opinion]) -> dict[str, Any]:
    """Fixes of all opinions."""
    return {key: value for opinion in opinions for key, value in opinion.mend.items()}


def withdrawn(opinion: Opinion, why: str) -> Opinion:
    """Opinion without the fix, after a failed trial."""
    if not opinion.mend:
        return opinion
    text = f"{opinion.text}; tried and withdrawn: {why}"
    return replace(opinion, state="unknown", text=text, mend={}, option=None)
