"""What a search says of a recording, subject by subject: fine, wrong with what mends it, or that nothing can tell."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Literal

import numpy as np

from pipeline.datasets.doctor.hypotheses import Hypothesis
from pipeline.datasets.doctor.search import FINE, LEAST_PAIRS, LEAST_SCORE, Range, Search
from pipeline.geometry.pose_convention import STANDARD
from pipeline.language.class_sizes import SizeFactor

State = Literal["fine", "wrong", "unknown"]
SUBJECTS = ("poses", "depth scale", "focal length", "principal point", "registration", "time", "up")
"""In the order in which they are told."""

UNITS = {
    1.0: "metres", 39.3701: "inches", 100.0: "centimetres", 256.0: "1/256 m, as in KITTI", 500.0: "1/500 m",
    1000.0: "millimetres", 4000.0: "1/4000 m", 5000.0: "1/5000 m, as in TUM RGB-D",
    8000.0: "millimetres rotated by three bits, as in SUN RGB-D", 10000.0: "tenths of a millimetre",
    1e6: "micrometres",
}  # fmt: skip
"""Depth units in a metre that recordings are known to have."""
SHARP, NEAR_UNIT = 0.25, 0.45
"""How far a number that is wrong may be off, as a share, to be mended; and a scale, where one known unit is as near.
The ranges are wide: in all that was planted on public recordings the numbers themselves were right to 4 %."""
OFF_UNIT = 0.06
"""A scale is a known unit's where it is no farther from it, as a share."""
FINE_SCALE, FINE_FOCAL = 0.3, 0.12
"""How far one that was read may be off to be called fine."""
NEAR_TOLD = 0.04
"""A number so near to the one that was read is not worth mending."""
SAME_CENTER = 0.02
"""Principal points closer than this share of the width are one."""
ODD_CENTER, EVEN_CENTER = 0.08, 0.04
"""A principal point so far off the middle is rare, by shares of the width, and one so near to it common."""


@dataclass(frozen=True)
class Opinion:
    """What is thought of one thing.

    Attributes
    ----------
    about : str
        One of `SUBJECTS`.
    state : str
    text : str
        One sentence with its evidence.
    mend : dict
        What `write_settings` is to keep: intrinsics, depth_scale, poses, pose_shift, registration, up.
    option : str or None
        The same as a person tells it.
    evidence : dict of str to float
    """

    about: str
    state: State
    text: str
    mend: dict[str, Any] = field(default_factory=dict)
    option: str | None = None
    evidence: dict[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class Ranked:
    """A hypothesis that was tried.

    Attributes
    ----------
    hypothesis : Hypothesis
    score : float
        Share of the points that land.
    as_good : bool
        Whether the best is not surely better.
    """

    hypothesis: Hypothesis
    score: float
    as_good: bool

    @property
    def words(self) -> str:
        """What it says is wrong."""
        h = self.hypothesis
        parts = [
            f"depth {h.scale:.3g} times as far" if abs(h.scale - 1) > 1e-6 else "",
            f"focal length {h.focal:.3g} times as long" if abs(h.focal - 1) > 1e-6 else "",
            {"swapped": "cx and cy swapped", "middle": "principal point in the middle"}.get(h.center, ""),
            f"poses are {h.poses}" if h.poses != STANDARD else "",
        ]
        return ", ".join(part for part in parts if part) or "all as read"


def ranked(search: Search) -> tuple[Ranked, ...]:
    """What was tried, the best first: the best, what was read, and the best of each family."""
    if not len(search.fine.pairs):
        return ()
    tried = dict.fromkeys((search.best, Hypothesis(), *search.looked_around))
    found = [Ranked(h, search.at(h), h == search.best or not search.beats(search.best, h)) for h in tried]
    return tuple(sorted(found, key=lambda one: (one.hypothesis != search.best, -one.score)))


def landing_opinions(search: Search, K: np.ndarray | None, units: float | None) -> list[Opinion]:
    """Of poses, scale, focal length and principal point.

    Parameters
    ----------
    K : (3, 3) float64 or None
        Intrinsics as read, None where they differ from frame to frame.
    units : float or None
        Depth units in a metre as read.
    """
    subjects = SUBJECTS[:4]
    pairs = len(search.fine.pairs)
    if pairs < LEAST_PAIRS:
        why = "no two posed frames of those that were looked at show the same surface"
        if not len(search.coarse.pairs):
            why = "no two frames of a scene have poses"
        found = [Opinion(about, "unknown", f"nothing can tell: {why}") for about in subjects]
    elif (score := search.at(search.best)) < LEAST_SCORE:
        why = f"nothing that was tried makes the depth of {pairs} pairs agree (at best {score:.0%} of the points land)"
        found = [Opinion(about, "unknown", f"{why}: are the poses of other frames?") for about in subjects]
    else:
        found = [_poses(search), _scale(search, units), _focal(search)]
        return _with_intrinsics([*found, _center(search)], search.best, K, search.fine.size)
    middle = _center_by_middle(search.fine.K[0], search.fine.size) or found[3]
    return _with_intrinsics([*found[:3], middle], Hypothesis(), K, search.fine.size)


def _landing(search: Search, other: Hypothesis) -> tuple[str, dict[str, float]]:
    """How the best compares with another, as told."""
    best, second = search.at(search.best), search.at(other)
    told = {"lands": round(best, 4), "otherwise": round(second, 4), "pairs": float(len(search.fine.pairs))}
    return f"{best:.0%} of the points land on the depth (within {FINE:.1%}) and colour of another frame", told


def _poses(search: Search) -> Opinion:
    best = search.best
    rivals = search.rivals(lambda h: h.poses != best.poses)
    if rivals:
        names = ", ".join(dict.fromkeys((best.poses, *(h.poses for h in rivals))))
        return Opinion("poses", "unknown", f"too little motion between the frames to tell {names} apart")
    told = [h for h in search.looked_around if h.poses != best.poses]
    lands, evidence = _landing(search, max(map(search.refined, told), key=search.at))
    text = f"{lands} with {best.poses}, {evidence['otherwise']:.0%} with any other convention"
    if best.poses == STANDARD:
        return Opinion("poses", "fine", text, evidence=evidence)
    line = f'--poses "{best.poses}"'
    return Opinion("poses", "wrong", text, {"poses": best.poses}, line, evidence)


def _between(found: Range) -> str:
    high = "any larger number" if np.isinf(found.high) else f"{found.high:.3g}"
    return f"from {found.low:.3g} to {high} times"


def _scale(search: Search, units: float | None) -> Opinion:
    found = search.range_of("scale", "focal")
    lands, evidence = _landing(search, replace(search.best, scale=1.0 if abs(found.value - 1) > 0.01 else 1.25))
    evidence |= {"value": found.value, "low": found.low, "high": min(found.high, 1e9)}
    if found.holds(1.0):
        if found.sharp <= FINE_SCALE:
            return Opinion("depth scale", "fine", f"{lands}; {_between(found)} it would do", evidence=evidence)
        text = f"the frames are too close together: {_between(found)} the depth as read lands as well"
        return Opinion("depth scale", "unknown", text, evidence=evidence)
    known = None if units is None else _known_unit(units, found)
    if units is None or (known is None and found.sharp > SHARP):
        text = f"the depth as read does not land; {_between(found)} it would, which is no one unit"
        return Opinion("depth scale", "unknown", text, evidence=evidence)
    right = known or float(f"{units / found.value:.4g}")
    what = f": {UNITS[known]}" if known in UNITS else ""
    text = f"{lands} where depth is {units / right:.3g} times as far as read, else {evidence['otherwise']:.0%}{what}"
    return Opinion("depth scale", "wrong", text, {"depth_scale": right}, f"--depth-scale {right:g}", evidence)


def _only_unit(units: float, found: Range) -> float | None:
    """The only unit, of those known, that a scale allows; None where there is none, or several."""
    allowed = [unit for unit in UNITS if found.holds(units / unit)]
    return allowed[0] if len(allowed) == 1 else None


def _known_unit(units: float, found: Range) -> float | None:
    """The unit, of those known, that the scale is; None where it is none."""
    near = [unit for unit in UNITS if abs(np.log(units / unit / found.value)) < OFF_UNIT]
    sure = found.sharp <= SHARP or (found.sharp <= NEAR_UNIT and _only_unit(units, found))
    return near[0] if near and sure else None


def scale_by_sizes(found: Sequence[SizeFactor], units: float | None) -> Opinion | None:
    """What things of known classes say of the unit of depth, by the factors of frames; None where it is no one unit."""
    low, high = max(f.low for f in found), min(f.high for f in found)
    if low > high or units is None:
        return None
    unit = _only_unit(units, Range(1 / float(np.sqrt(low * high)), 1 / high, 1 / low))
    if unit is None:
        return None
    things = sum(f.things for f in found)
    fitting = sum(f.fitting for f in found)
    text = f"{fitting} of {things} things of known classes have the size of their class, nearly all with {UNITS[unit]}"
    evidence = {"things": float(things), "fitting": float(fitting), "low": 1 / high, "high": 1 / low}
    return Opinion("depth scale", "wrong", text, {"depth_scale": unit}, f"--depth-scale {unit:g}", evidence)


def _focal(search: Search) -> Opinion:
    found = search.range_of("focal", "scale")
    lands, evidence = _landing(search, replace(search.best, focal=1.0 if abs(found.value - 1) > 0.01 else 1.25))
    evidence |= {"value": found.value, "low": found.low, "high": min(found.high, 1e9)}
    if found.sharp > (FINE_FOCAL if found.holds(1.0) else SHARP):
        start = "the frames turn too little" if found.holds(1.0) else "it is wrong, but the frames turn too little"
        text = f"{start}: {_between(found)} the focal length as read lands as well"
        return Opinion("focal length", "unknown", text, evidence=evidence)
    if found.holds(1.0) or abs(found.value - 1) < NEAR_TOLD:
        return Opinion("focal length", "fine", f"{lands}; {_between(found)} it would do", evidence=evidence)
    text = f"{lands} where it is {found.value:.3g} times as long, else {evidence['otherwise']:.0%}"
    return Opinion("focal length", "wrong", text, evidence=evidence)


def _center(search: Search) -> Opinion:
    size = search.fine.size
    best = search.best
    shown = search.fine.K[0]

    def apart(one: Hypothesis, other: Hypothesis) -> float:
        return float(np.abs((one.intrinsics(shown, size) - other.intrinsics(shown, size))[:2, 2]).max() / size[1])

    rivals = search.rivals(lambda h: apart(h, best) > SAME_CENTER)
    others = [h for h in search.looked_around if apart(h, best) > SAME_CENTER]
    by_middle = _center_by_middle(shown, size)
    if rivals:
        if by_middle is not None and by_middle.state == "wrong":
            return by_middle
        if by_middle is not None and best.center == "told":
            return by_middle
        return Opinion("principal point", "unknown", "it lands as well with another principal point")
    second = max(map(search.refined, others), key=search.at) if others else replace(best, shift=(40.0, 0.0))
    lands, evidence = _landing(search, second)
    text = f"{lands}, {evidence['otherwise']:.0%} with another principal point"
    if apart(best, replace(best, center="told")) <= SAME_CENTER:
        return Opinion("principal point", "fine", text, evidence=evidence)
    what = "where cx and cy are swapped" if best.center == "swapped" else "where it is the middle of the picture"
    return Opinion("principal point", "wrong", f"{text}: {what}", evidence=evidence)


def _center_by_middle(K: np.ndarray, size: tuple[int, int]) -> Opinion | None:
    """What the principal point itself says: cameras have it near the middle of their pictures."""
    middle = np.array([(size[1] - 1) / 2, (size[0] - 1) / 2])
    told, swapped = (np.abs(c - middle).max() / size[1] for c in (K[:2, 2], K[1::-1, 2]))
    evidence = {"off_middle": round(float(told * size[1]), 1), "off_middle_swapped": round(float(swapped * size[1]), 1)}
    off = f"it is {evidence['off_middle']:.0f} pixels off the middle of the picture"
    if told <= EVEN_CENTER:
        return Opinion("principal point", "fine", off, evidence=evidence)
    if told > ODD_CENTER and swapped <= EVEN_CENTER:
        text = f"{off}, and {evidence['off_middle_swapped']:.0f} with cx and cy swapped"
        return Opinion("principal point", "wrong", text, evidence=evidence)
    return None


def _with_intrinsics(
    found: list[Opinion], best: Hypothesis, K: np.ndarray | None, size: tuple[int, int]
) -> list[Opinion]:
    """The opinions with the intrinsics that those on focal length and principal point ask for, both in one."""
    *_, focal, center = found
    if center.state == "wrong" and best.center == "told":
        best = replace(best, center="swapped")
    truth = Hypothesis(
        focal=best.focal if focal.state == "wrong" else 1.0, center=best.center if center.state == "wrong" else "told"
    )
    mend, option = {}, "mend it where it stands: frames have intrinsics of their own, or a declared registration"
    if K is not None:
        right = truth.intrinsics(K, size)
        four = tuple(round(float(n), 3) for n in (right[0, 0], right[1, 1], right[0, 2], right[1, 2]))
        mend, option = {"intrinsics": four}, f"--intrinsics {','.join(f'{n:g}' for n in four)}"
    of_camera = (replace(o, mend=mend, option=option) if o.state == "wrong" else o for o in (focal, center))
    return [*found[:2], *of_camera]
