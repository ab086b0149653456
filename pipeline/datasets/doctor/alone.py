"""Opinions by frames on their own: values that mean nothing, how depth maps lie over colour, what depth is, and focal
length by planes that are square."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import cv2
import numpy as np

from pipeline.datasets.doctor.landing import OTHER_FRAMES
from pipeline.datasets.doctor.planes import KINDS, flatness, square_focals
from pipeline.datasets.doctor.search import KIND, MAP, WHERE_MEANT, meanings, surely_positive
from pipeline.datasets.doctor.seen import Seen
from pipeline.datasets.doctor.suspicions import Opinion
from pipeline.datasets.settings import FILE_NAME
from pipeline.geometry.registration import LEAST_IN_REGION, REGIONS, Registration
from pipeline.language.counted import counted

NOTHING = "missing depth"
LEAST_SHARE = 0.01
"""A value at an end of the range means nothing only where so many of a frame's pixels have it."""
GAP = 1.5
"""It is so many times as far as all others, or they as it is."""
INSIDE = 0.001
"""So many of the others may be beyond the gap."""
OFTEN, COMMON = 0.05, 5
"""Or as many of the pixels have it, and so many times as many as any other value,"""
SAME_SURFACE, MOST_JOINED = 0.05, 0.3
"""and of the pixels around few have nearly the same depth: a wall seen head on goes on."""
LEAST_ALIKE = 2
"""Frames that must share a value which is no limit of what is stored."""
FARTHEST_M = 20.0
LIMITS = {float(2**bits - k) for bits in (8, 10, 11, 12, 13, 14, 15, 16) for k in (0, 1, 2)} | {1.0}
"""Stored values that stand for nothing in many recorders: the largest of so many bits, and the smallest."""


def nothing(seen: Seen) -> list[Opinion]:
    """Find a value, alone at an end of the range, that counts as surface."""
    shares: dict[float, list[float]] = {}
    for frame in seen.frames:
        for value, share in _ends(frame.depth):
            shares.setdefault(value, []).append(share)
    if not shares:
        return [Opinion(NOTHING, "fine", "no value that stands out at an end of the range counts as depth")]
    told = {value for value, known in shares.items() if len(known) >= LEAST_ALIKE or _limit(value, seen.units)}
    value = max(told or shares, key=lambda v: sum(shares[v]))
    share = sum(shares[value]) / len(seen.frames)
    stored = float(f"{value * (seen.units or 1.0):.6g}")
    where = f"{counted(len(shares[value]), 'frame')} of {len(seen.frames)}"
    text = f"{share:.0%} of the pixels have the value {stored:g} ({value:.4g} m), which stands out in {where}"
    evidence, option = {"share": round(share, 4)}, f"depth_nothing = {stored:g} in {FILE_NAME}"
    if not told:
        text = f"{text}: a wall seen head on, or no surface ({option})?"
        return [Opinion(NOTHING, "unknown", text, evidence=evidence)]
    return [Opinion(NOTHING, "wrong", f"{text}: it counts as surface", {"depth_nothing": stored}, option, evidence)]


def _limit(value: float, units: float | None) -> bool:
    stored = value * (units or 1.0)
    return value > FARTHEST_M or (units is not None and round(stored) in LIMITS and abs(stored - round(stored)) < 1e-3)


def _ends(depth: np.ndarray) -> list[tuple[float, float]]:
    """Values at the ends of the range of depth (H, W) that are no surface's, and their shares of the pixels."""
    values, counts = np.unique(depth[depth > 0], return_counts=True)
    found = []
    for k in np.flatnonzero(counts >= LEAST_SHARE * depth.size):
        value, own = float(values[k]), np.abs(depth - values[k]) <= 1e-5 * values[k]
        others = depth[(depth > 0) & ~own]
        near, far = np.quantile(others, (INSIDE, 1 - INSIDE)) if len(others) else (0.0, np.inf)
        if not near < value < far and (value > GAP * far or value < near / GAP or _crowded(depth, own, counts)):
            found.append((value, float(own.mean())))
    return found


def _crowded(depth: np.ndarray, own: np.ndarray, counts: np.ndarray) -> bool:
    """Test whether pixels (H, W) share a value more often than any other is shared, and border on no surface of it."""
    around = (cv2.dilate(own.astype(np.uint8), np.ones((3, 3), np.uint8)) > 0) & ~own & (depth > 0)
    value = depth[own][0]
    joined = np.abs(depth[around] / value - 1) < SAME_SURFACE
    rest = np.delete(counts, counts.argmax())
    return own.mean() >= OFTEN and own.sum() >= COMMON * max(rest, default=0) and joined.mean() < MOST_JOINED


LEAST_LAID, LEAST_FURTHER, LAID_SURE = 0.07, 0.05, 1.5
"""Outlines must lie so much more on edges of colour than by chance, and than with the map laid otherwise, by so many
standard errors. Of 180 frames whose map was laid wrongly none had more than .051."""


def laid(seen: Seen) -> list[Opinion]:
    """Compare outlines of depth, as the map lies and turned or mirrored, with edges of colour."""
    causes = meanings(seen, MAP)
    above = [_above_chance(one) for one in (seen, *(seen.mended(cause.mend) for cause in causes))]
    mean = [float(np.nanmean(one)) if np.isfinite(one).any() else 0.0 for one in above]
    best = int(np.argmax(mean))
    others = [k for k in range(len(mean)) if k != best]
    second = max(mean[k] for k in others)
    evidence = {"edges": round(mean[0], 4), "edges_otherwise": round(max(mean[1:]), 4)}
    sure = all(surely_positive(above[best] - above[k], LAID_SURE) for k in others)
    if mean[best] < LEAST_LAID or mean[best] - second < LEAST_FURTHER or not sure:
        text = "edges of colour do not show how depth maps lie over it"
        return [Opinion(MAP, "unknown", text, evidence=evidence)]
    own, other = max(mean[0], 0.0), max(second, 0.0)
    if best == 0:
        text = f"its outlines lie on edges of colour, {own:.0%} more than by chance; turned or mirrored {other:.0%}"
        return [Opinion(MAP, "fine", text, evidence=evidence)]
    cause = causes[best - 1]
    text = f"{cause.words}: {mean[best]:.0%} of outlines lie on edges of colour above chance then, as read {own:.0%}"
    ((key, value),) = cause.mend.items()
    return [Opinion(MAP, "wrong", text, dict(cause.mend), f'{key} = "{value}" in {FILE_NAME}', evidence)]


def _above_chance(seen: Seen) -> np.ndarray:
    """Share above chance of outlines on edges, of each region of each frame, (F * R,); NaN for too few."""
    outlines, regions = seen.outlines, REGIONS[0] * REGIONS[1]
    value = outlines.above_chance(Registration.none(outlines.camera))
    known = np.isfinite(value)
    group, size = (outlines.frame * regions + outlines.region)[known], len(outlines.away) * regions
    count = np.bincount(group, minlength=size)
    return np.where(count >= LEAST_IN_REGION, np.bincount(group, value[known], size) / np.maximum(count, 1), np.nan)


LEAST_WINDOWS, LEAST_FLATTER = 3, 0.05
"""Half pictures that must say so, and how much more of them must be plane."""


def kind(seen: Seen, known: Sequence[Opinion]) -> list[Opinion]:
    """Compare how much of each half picture is one plane under each kind of depth, where landing tells nothing."""
    before = next((opinion for opinion in known if opinion.about == KIND), None)
    if before is not None and before.state != "unknown":
        return []
    flat = np.concatenate([flatness(frame) for frame in seen.frames])
    flat = flat[np.isfinite(flat[:, 0])]
    if len(flat) < LEAST_WINDOWS:
        return [Opinion(KIND, "unknown", "too few planes are seen that a wrong kind of depth would bend")]
    mean = dict(zip(KINDS, flat.mean(axis=0), strict=True))
    best = max(KINDS, key=lambda name: mean[name])
    lead = {other: flat[:, KINDS.index(best)] - flat[:, k] for k, other in enumerate(KINDS) if other != best}
    surely = [other for other, by in lead.items() if surely_positive(by) and by.mean() >= LEAST_FLATTER]
    evidence = {f"flat_{name}": round(float(share), 4) for name, share in mean.items()}
    seen_in = f"of {counted(len(flat), 'half picture')} {mean[best]:.0%} is one plane"
    if best == KINDS[0] or KINDS[0] not in surely:
        if len(surely) < len(lead):
            text = f"too few planes to tell what depth is: {seen_in}"
            return [Opinion(KIND, "unknown", text, evidence=evidence)]
        others = " and ".join(f"{mean[other]:.0%} if it were {other}" for other in lead)
        return [Opinion(KIND, "fine", f"planes are not bent: {seen_in}, {others}", evidence=evidence)]
    if len(surely) < len(lead):
        either = " or ".join((best, *set(lead) - set(surely)))
        text = f"planes are bent, {seen_in} as {either}, {mean[KINDS[0]]:.0%} as read"
        return [Opinion(KIND, "wrong", text, evidence=evidence), *_not_by_poses(known, "depth is of another kind")]
    words = WHERE_MEANT[KIND, "depth_is"][best]
    text = f"planes are bent: {seen_in} where {words}, {mean[KINDS[0]]:.0%} as read"
    mend = {} if best == "inverse" else {"depth_is": best}
    text = text if mend else f"{text}; nothing tells its unit"
    opinion = Opinion(KIND, "wrong", text, mend, f'depth_is = "{best}" in {FILE_NAME}', evidence)
    return [opinion, *_not_by_poses(known, words)]


def _not_by_poses(known: Sequence[Opinion], words: str) -> list[Opinion]:
    """Opinions that blamed the poses for what another fault explains, with that fault in place of them."""
    blamed = (opinion for opinion in known if opinion.text.endswith(OTHER_FRAMES))
    return [replace(o, text=f"{o.text.removesuffix(OTHER_FRAMES)}; {words}") for o in blamed]


PAIRED, TOLD_SD = 2, 0.12
"""Pairs of planes that must agree in one frame, and how well a pair must tell."""
AGREE, LEAST_OFF, SQUARE = 0.08, 0.18, 0.06
"""As logarithms: pairs agree within this, a focal length is called wrong from this on, and fine up to this."""


def square(seen: Seen, known: Sequence[Opinion]) -> list[Opinion]:
    """Compare angles of planes with right angles, where landing tells nothing of the focal length."""
    decided = any(o.about == "focal length" and o.state != "unknown" for o in known)
    # Planes that are still bent meet at no angle.
    if decided or any(o.about == KIND and o.state == "wrong" and not o.mend for o in known):
        return []
    tellings = [told[told[:, 1] < TOLD_SD] for told in map(square_focals, seen.frames)]
    told = np.concatenate(tellings)
    if len(told) < PAIRED or max(map(len, tellings)) < PAIRED:
        return []
    middle = float(np.median(told[:, 0]))
    agreeing = np.abs(told[:, 0] - middle) < AGREE
    frames = sum(len(of) >= PAIRED and bool((np.abs(of[:, 0] - middle) < AGREE).all()) for of in tellings)
    evidence = {"factor": round(float(np.exp(middle)), 3), "pairs": float(len(told))}
    if agreeing.mean() < 0.8 or not frames:
        return []
    angles = f"{counted(len(told), 'pair')} of planes meet at {np.median(told[:, 2]):.0f} degrees"
    if abs(middle) <= SQUARE:
        return [Opinion("focal length", "fine", f"walls and floor are square: {angles}", evidence=evidence)]
    if abs(middle) < LEAST_OFF:
        return []
    factor = evidence["factor"]
    text = f"walls and floor are not square: {angles}; they are with about {factor:.2g} times the focal length"
    option = "--intrinsics of this camera and this size of picture"
    others = [opinion for opinion in known if opinion.about != "focal length"]
    wrong = Opinion("focal length", "wrong", text, {}, option, evidence)
    return [wrong, *_not_by_poses(others, "the focal length is another")]
