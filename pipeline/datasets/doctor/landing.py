"""Opinions by landing on poses, time, depth scale, focal length and principal point, as a single explanation."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from pipeline.datasets.doctor.search import (
    AS_READ,
    FINE,
    KIND,
    MAP,
    MIDDLE,
    OTHER_SIDES,
    PICTURES,
    SWAPPED,
    Cause,
    Hypothesis,
    PosedViews,
    Range,
    other_centers,
)
from pipeline.datasets.doctor.seen import Seen
from pipeline.datasets.doctor.suspicions import UNITS, Opinion, RegionAgreement, only_unit, withdrawn
from pipeline.datasets.settings import FILE_NAME
from pipeline.geometry.camera import STANDARD
from pipeline.language.counted import counted

LEAST_PAIRS = 2
LEAST_SCORE = 0.26
"""Below this nothing explains the views."""
LEAST_GAIN = 0.03
"""A mend must bring so much more of the points to land, region by region."""
SHARP, NEAR_UNIT = 0.25, 0.45
"""How far a number that is wrong may be off, as a share, to be mended; and a scale, where one known unit is as near.
The ranges are wide: in all that was planted on public recordings the numbers themselves were right to 4 %."""
OFF_UNIT = 0.06
"""A scale is a known unit's where it is no farther from it, as a share; and what was read is right."""
FINE_SCALE, FINE_FOCAL = 0.3, 0.12
"""How far one that was read may be off to be called fine."""
NEAR_TOLD = 0.04
"""A number so near to the one that was read is not worth mending."""
SAME_CENTER = 0.02
"""Principal points closer than this share of the width are one."""
NEAR_SURE = 2.0
"""The place by which poses are late is told where those beside it are worse by so many standard errors."""


BY_LANDING = ("poses", "time", "depth scale", "focal length", "principal point")
OTHER_FRAMES = ": are the poses of other frames?"
TEXT_TELLS = "text in a picture tells whether it is mirrored"


class OfLanding:
    """Landing test: five subjects, a single explanation."""

    def __init__(self) -> None:
        self.first: PosedViews | None = None  # Of the frames with what was mended before

    def search(self, seen: Seen, known: Sequence[Opinion] = ()) -> PosedViews:
        """Search for the explanation of these frames, given earlier opinions; the first is kept."""
        if self.first is not None and self.first.seen is seen:
            return self.first
        laid = any(opinion.about == MAP and opinion.state != "unknown" for opinion in known)
        found = PosedViews(seen, (KIND, PICTURES) if laid else (KIND, PICTURES, MAP))
        self.first = self.first or found
        return found

    def opinions(self, seen: Seen, known: Sequence[Opinion]) -> list[Opinion]:
        search = self.search(seen, known)
        pairs = len(search.fine.pairs)
        if pairs >= LEAST_PAIRS and search.at(search.best) >= LEAST_SCORE:
            found = [_poses(search), _time(search), _scale(search, seen.units), _focal(search), _center(search)]
            others = dict.fromkeys(c.about for c in search.causes if c.about not in ("", *BY_LANDING))
            return [*(_caused(about, search) for about in others), *_with_intrinsics(found, search.best, search)]
        if pairs >= LEAST_PAIRS:
            best = f"at best {search.at(search.best):.0%} of the points land"
            why = f"nothing that was tried makes {pairs} pairs agree ({best}){OTHER_FRAMES}"
        elif len(search.coarse.pairs):
            why = "nothing can tell: no two posed frames of those that were looked at show the same surface"
        else:
            why = "nothing can tell: no two frames of a scene have poses"
        found = [Opinion(about, "unknown", why) for about in (PICTURES, *BY_LANDING)]
        found[0] = replace(found[0], text=f"{why}; {TEXT_TELLS}")
        shown = center_by_middle(search.coarse.K[0], search.coarse.size)
        found[-1] = shown[0] or found[-1]
        return _with_intrinsics(found, Hypothesis(cause=shown[1]), search)

    def measured(self, seen: Seen, mended: Seen) -> tuple[RegionAgreement, ...]:
        search = self.search(seen)
        if len(search.fine.pairs) < LEAST_PAIRS:
            # A principal point of one picture has nothing else that speaks for it.
            return ()
        return (RegionAgreement(*search.of_regions(mended), LEAST_GAIN),)


def _against(
    search: PosedViews, left: Callable[[Hypothesis], bool], otherwise: Hypothesis
) -> tuple[str, dict[str, float]]:
    """Comparison of the best explanation with the best alternative leaving the subject unchanged."""
    others = [h for h in search.explanations if left(h) and h != search.best] or [otherwise]
    best, second = search.at(search.best), max(map(search.at, others))
    evidence = {"lands": round(best, 4), "otherwise": round(second, 4), "pairs": float(len(search.fine.pairs))}
    return f"{best:.0%} of the points land on the depth (within {FINE:.1%}) and colour of another frame", evidence


def _either(about: str, search: PosedViews, others: Sequence[Hypothesis]) -> Opinion:
    """Abstention between explanations with the same landing."""
    words = " or ".join(dict.fromkeys(h.words for h in (search.best, *others[:2])))
    return Opinion(about, "unknown", f"what was read does not land; it does with {words}, and nothing tells which")


def _poses(search: PosedViews) -> Opinion:
    cause = search.best.cause
    best = cause.mend.get("poses", STANDARD)

    def differ(h: Hypothesis) -> bool:
        return h.cause.mend.get("poses", STANDARD) != best

    lands, evidence = _against(search, differ, Hypothesis())
    text = f"{lands} with {best}, {evidence['otherwise']:.0%} with any other convention"
    equals = search.as_good(differ)
    if equals and cause.about == "poses":
        return _either("poses", search, equals)
    if equals:
        names = ", ".join(dict.fromkeys((best, *(h.cause.mend["poses"] for h in equals))))
        return Opinion("poses", "unknown", f"too little motion between the frames to tell {names} apart")
    if cause.about != "poses":
        return Opinion("poses", "fine", text, evidence=evidence)
    return Opinion("poses", "wrong", text, dict(cause.mend), f'--poses "{best}"', evidence)


def _caused(about: str, search: PosedViews) -> Opinion:
    """Opinion on a subject with causes alone."""
    best = search.best

    def own(h: Hypothesis) -> bool:
        return h.cause.about == about

    equals = search.as_good(lambda h: own(h) != own(best) or (own(h) and h.cause != best.cause))
    lands, evidence = _against(search, lambda h: own(h) != own(best), Hypothesis())
    if not own(best):
        if equals:
            return Opinion(
                about, "unknown", f"too little motion between the frames: it lands as well where {_words(equals)}"
            )
        return Opinion(about, "fine", f"{lands}, {evidence['otherwise']:.0%} where it is otherwise", evidence=evidence)
    if equals:
        return _either(about, search, equals)
    mend = dict(best.cause.mend)
    if "depth_scale" in mend:
        mend["depth_scale"] = float(f"{mend['depth_scale'] * best.scale:.4g}")
    text = f"{lands} where {best.cause.words}, else {evidence['otherwise']:.0%}"
    option = ", ".join(f"{key} = {_quoted(value)}" for key, value in mend.items()) + f" in {FILE_NAME}"
    if about != PICTURES:
        return Opinion(about, "wrong", text, mend, option, evidence)
    # Poses of a left-handed world land as pictures that are mirrored do: a person must look.
    why = RegionAgreement(*search.of_regions(search.seen.mended(mend)), LEAST_GAIN).refusal
    opinion = Opinion(about, "wrong", text, mend, option, evidence)
    if why is not None:
        return withdrawn(opinion, why)
    option = f"{option}, where text in the pictures is mirrored; else the poses are of a left-handed world"
    return replace(opinion, mend={}, option=option)


def _words(hypotheses: Sequence[Hypothesis]) -> str:
    return " or ".join(dict.fromkeys(h.words for h in hypotheses[:2]))


def _quoted(value: Any) -> str:
    return f'"{value}"' if isinstance(value, str) else f"{value:g}"


def _time(search: PosedViews) -> Opinion:
    late, best = search.late, search.best
    if not late:
        return Opinion("time", "unknown", "no three frames of a scene have poses, and neighbours with others")
    if best.cause.about != "time":
        if search.as_good(lambda h: h.cause.about == "time") and not search.as_good(lambda h: h == Hypothesis()):
            return _either("time", search, search.as_good(lambda h: h.cause.about == "time"))
        worse = [abs(shift) for shift, h in late.items() if search.beats(best, replace(best, cause=h.cause))]
        if not worse:
            why = "too few frames, or too close together, to tell the poses of neighbours"
            return Opinion("time", "unknown", why)
        text = f"the poses of frames {counted(min(worse), 'place')} earlier or later land worse"
        return Opinion("time", "fine", text, evidence={"told_from": float(min(worse))})
    if equals := search.as_good(lambda h: h.cause.about != "time"):
        return _either("time", search, equals)
    (shift,) = (shift for shift, h in late.items() if h.cause == best.cause)
    near = [s for s, h in late.items() if not search.beats(best, replace(best, cause=h.cause), NEAR_SURE)]
    gain = search.at(best) - search.at(Hypothesis())
    when = f"{counted(abs(shift), 'place')} {'later' if shift > 0 else 'earlier'}"
    text = f"with the poses of frames {when}, {gain:.0%} more of the points land"
    evidence = {"shift": float(shift), "gain": round(gain, 4)}
    if len(near) > 1:
        text = f"{text}, and nearly as many with {' or '.join(f'{s:+d}' for s in sorted(near) if s != shift)} places"
        return Opinion("time", "wrong", text, evidence=evidence)
    return Opinion("time", "wrong", text, {"pose_shift": shift}, f"pose_shift = {shift}", evidence)


def _between(found: Range) -> str:
    high = "any larger number" if np.isinf(found.high) else f"{found.high:.3g}"
    return f"from {found.low:.3g} to {high} times"


def _scale(search: PosedViews, units: float | None) -> Opinion:
    def left(h: Hypothesis) -> bool:
        return abs(np.log(h.scale)) < OFF_UNIT

    if "depth_scale" in search.best.cause.mend:
        return Opinion("depth scale", "unknown", f"{search.best.cause.words}: its unit comes with that")
    found = search.range_of("scale", "focal")
    otherwise = replace(search.best, scale=1.25) if left(search.best) else replace(search.best, scale=1.0)
    lands, evidence = _against(search, lambda h: left(h) != left(search.best), otherwise)
    evidence |= {"value": found.value, "low": found.low, "high": min(found.high, 1e9)}
    if found.holds(1.0) or left(search.best):
        if found.sharp <= FINE_SCALE:
            return Opinion("depth scale", "fine", f"{lands}; {_between(found)} it would do", evidence=evidence)
        text = f"the frames are too close together: {_between(found)} the depth as read lands as well"
        return Opinion("depth scale", "unknown", text, evidence=evidence)
    if equals := search.as_good(left):
        return _either("depth scale", search, equals)
    unit = None if units is None else _known_unit(units, found)
    if units is None or (unit is None and found.sharp > SHARP):
        text = f"the depth as read does not land; {_between(found)} it would, which is no one unit"
        return Opinion("depth scale", "unknown", text, evidence=evidence)
    right = unit or float(f"{units / found.value:.4g}")
    what = f": {UNITS[unit]}" if unit in UNITS else ""
    text = f"{lands} where depth is {units / right:.3g} times as far as read, else {evidence['otherwise']:.0%}{what}"
    return Opinion("depth scale", "wrong", text, {"depth_scale": right}, f"--depth-scale {right:g}", evidence)


def _known_unit(units: float, found: Range) -> float | None:
    """Known unit nearest to the scale; None without a match."""
    near = [unit for unit in UNITS if abs(np.log(units / unit / found.value)) < OFF_UNIT]
    sure = found.sharp <= SHARP or (found.sharp <= NEAR_UNIT and only_unit(units, found.low, found.high))
    return near[0] if near and sure else None


def _focal(search: PosedViews) -> Opinion:
    by_cause = _by_cause(search.best, search)

    def left(h: Hypothesis) -> bool:
        return abs(h.focal * _by_cause(h, search) - 1) < NEAR_TOLD

    inner = search.range_of("focal", "scale")
    found = Range(inner.value * by_cause, inner.low * by_cause, inner.high * by_cause)
    otherwise = replace(search.best, focal=1.25 if left(search.best) else 1 / by_cause)
    lands, evidence = _against(search, lambda h: left(h) != left(search.best), otherwise)
    evidence |= {"value": found.value, "low": found.low, "high": min(found.high, 1e9)}
    if found.sharp > (FINE_FOCAL if found.holds(1.0) else SHARP):
        start = "the frames turn too little" if found.holds(1.0) else "it is wrong, but the frames turn too little"
        text = f"{start}: {_between(found)} the focal length as read lands as well"
        return Opinion("focal length", "unknown", text, evidence=evidence)
    if found.holds(1.0) or left(search.best):
        return Opinion("focal length", "fine", f"{lands}; {_between(found)} it would do", evidence=evidence)
    if equals := search.as_good(left):
        return _either("focal length", search, equals)
    text = f"{lands} where it is {found.value:.3g} times as long, else {evidence['otherwise']:.0%}"
    return Opinion("focal length", "wrong", text, evidence=evidence)


def _by_cause(h: Hypothesis, search: PosedViews) -> float:
    """Focal length under the hypothesis' cause, relative to the file's."""
    four = h.cause.mend.get("intrinsics")
    return 1.0 if four is None else float(four[0] / search.coarse.K[0, 0, 0])


def _center(search: PosedViews) -> Opinion:
    size, best, as_read = search.fine.size, search.best, search.coarse.K[0, :2, 2]

    def center(h: Hypothesis) -> np.ndarray:
        four = h.cause.mend.get("intrinsics")
        return as_read if four is None else np.array(four[2:])

    def apart(h: Hypothesis, other: np.ndarray) -> bool:
        return float(np.abs(center(h) - other).max()) > SAME_CENTER * size[1]

    equals = search.as_good(lambda h: apart(h, center(best)))
    if equals:
        by_middle, _ = center_by_middle(search.fine.K[0], size)
        if by_middle is not None and (by_middle.state == "wrong" or not apart(best, as_read)):
            return by_middle
        return Opinion("principal point", "unknown", "it lands as well with another principal point")
    middle = [Hypothesis(cause=cause) for cause in search.causes if cause.words == MIDDLE]
    otherwise = Hypothesis() if apart(best, as_read) or not middle else middle[0]
    lands, evidence = _against(search, lambda h: apart(h, center(best)), otherwise)
    text = f"{lands}, {evidence['otherwise']:.0%} with another principal point"
    if not apart(best, as_read):
        return Opinion("principal point", "fine", text, evidence=evidence)
    return Opinion("principal point", "wrong", f"{text}: {best.cause.words}", evidence=evidence)


def _with_intrinsics(found: list[Opinion], best: Hypothesis, search: PosedViews) -> list[Opinion]:
    """Opinions with joint intrinsics for focal length and principal point."""
    *_, focal, center = found
    K, views = search.seen.intrinsics, search.coarse
    mend, option = {}, "mend it where it stands: frames have intrinsics of their own, or a declared registration"
    if K is not None:
        if center.state == "wrong" and best.cause.about != "principal point":
            best = replace(best, cause=center_by_middle(K, views.size)[1])
        true = best.intrinsics(search.views(best.cause, coarse=True).K[0])
        same = best.cause.words in (SWAPPED, MIDDLE) or best.cause.words.startswith(OTHER_SIDES)
        of_size = not same and center.state == "wrong"
        fx, fy = (true if focal.state == "wrong" or of_size else K)[[0, 1], [0, 1]]
        cx, cy = (true if center.state == "wrong" else K)[:2, 2]
        four = tuple(round(float(n), 3) for n in (fx, fy, cx, cy))
        mend, option = {"intrinsics": four}, f"--intrinsics {','.join(f'{n:g}' for n in four)}"
    of_camera = (replace(o, mend=mend, option=option) if o.state == "wrong" else o for o in (focal, center))
    return [*found[:-2], *of_camera]


ODD, EVEN = 0.08, 0.04
"""One so far off the middle is rare, by shares of the width, and one so near to it common."""


def center_by_middle(K: np.ndarray, size: tuple[int, int]) -> tuple[Opinion | None, Cause]:
    """Opinion on the principal point, None without evidence, and the cause: swapped numbers or another image size. `K`
    (3, 3) float64; `size` (int, int): Height and width, pixels."""
    middle = np.array([(size[1] - 1) / 2, (size[0] - 1) / 2])
    off = float(np.abs(K[:2, 2] - middle).max())
    text, evidence = f"it is {off:.0f} pixels off the middle of the picture", {"off_middle": round(off, 1)}
    if off <= EVEN * size[1]:
        return Opinion("principal point", "fine", text, evidence=evidence), AS_READ
    for cause in other_centers(K, size) if off > ODD * size[1] else ():
        then = float(np.abs(np.array(cause.mend["intrinsics"][2:]) - middle).max())
        if cause.words != MIDDLE and then <= EVEN * size[1]:
            evidence |= {f"off_middle_{'swapped' if cause.words == SWAPPED else 'resized'}": round(then, 1)}
            text = f"{text}, and {then:.0f} with {cause.words}"
            return Opinion("principal point", "wrong", text, evidence=evidence), cause
    return None, AS_READ
