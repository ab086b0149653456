"""Suspicions besides landing: depth unit by sizes of things, registration by outlines, up by level planes."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Sequence
from dataclasses import field, replace
from typing import Any, Literal

import numpy as np

from pipeline.datasets.base import readable_frames
from pipeline.datasets.doctor.seen import Seen
from pipeline.datasets.plausible import annotated_sizes
from pipeline.datasets.up import Voter, vote
from pipeline.geometry.level_plane import decided, up_hypotheses
from pipeline.geometry.registration import (
    REGIONS,
    WIDE,
    Outlines,
    Registration,
    WarpEstimate,
    estimate_warp,
    mean_known,
)
from pipeline.system.frozen import dataclass

State = Literal["fine", "wrong", "unknown"]
SUBJECTS = (
    *("missing depth", "depth map", "depth kind", "pictures", "poses", "depth scale"),
    *("focal length", "principal point", "registration", "time", "up"),
)
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


@dataclass(frozen=True)
class Suspicion:
    """A possible fault of a recording. Each in turn says what it thinks of its subjects, on the frames as they are with
    what was mended before. A mend is withdrawn where regions of the picture get worse, or where the mended frames ask
    for another."""

    opinions: Callable[[Seen, Sequence[Opinion]], list[Opinion]]  # With fixes; given the earlier opinions
    measured: Callable[[Seen, Seen], tuple[RegionAgreement, ...]] = lambda seen, mended: ()
    """Agreement of the frames as they were and with a fix."""


def diagnosed(
    seen: Seen, suspicions: Sequence[Suspicion], tell: Callable[[int], None] = lambda done: None
) -> tuple[list[Opinion], Seen]:
    """Opinions on each subject in order of suspicions, and the frames with fixes. `tell` takes how many were told."""
    known: list[Opinion] = []
    for done, suspicion in enumerate(suspicions):
        tell(done)
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


UNITS = {
    1.0: "metres",
    39.3701: "inches",
    100.0: "centimetres",
    256.0: "1/256 m, as in KITTI",
    500.0: "1/500 m",
    1000.0: "millimetres",
    4000.0: "1/4000 m",
    5000.0: "1/5000 m, as in TUM RGB-D",
    8000.0: "millimetres rotated by three bits, as in SUN RGB-D",
    10000.0: "tenths of a millimetre",
    1e6: "micrometres",
}
"""By depth units in a metre."""
LOOKED_AT = 4
"""Frames whose annotations are read."""


def only_unit(units: float, low: float, high: float) -> float | None:
    """Single known unit with a scale in the range; None for none or several."""
    allowed = [unit for unit in UNITS if low <= units / unit <= high]
    return allowed[0] if len(allowed) == 1 else None


def _sizes(seen: Seen, known: Sequence[Opinion]) -> list[Opinion]:
    """Compare annotated things of known classes with their class sizes."""
    landed = next(opinion for opinion in known if opinion.about == "depth scale")
    if landed.state != "unknown" or not seen.dataset.class_names or seen.units is None:
        return []
    wanted = [frame.id for frame in seen.frames[:LOOKED_AT]]
    annotated = {frame.id: frame.annotations for frame in readable_frames(seen.dataset.load, wanted)}
    frames = [frame for frame in seen.frames if frame.id in annotated]
    factors = [annotated_sizes(replace(frame, annotations=annotated[frame.id])) for frame in frames]
    found = [factor for factor in factors if factor is not None]
    if 2 * len(found) <= len(frames):
        return []
    low, high = max(f.low for f in found), min(f.high for f in found)
    unit = only_unit(seen.units, 1 / high, 1 / low) if low <= high else None
    if unit is None:
        return []
    things, fitting = sum(f.things for f in found), sum(f.fitting for f in found)
    text = f"{fitting} of {things} things of known classes have the size of their class, nearly all with {UNITS[unit]}"
    evidence = {"things": float(things), "fitting": float(fitting), "low": 1 / high, "high": 1 / low}
    return [Opinion("depth scale", "wrong", text, {"depth_scale": unit}, f"--depth-scale {unit:g}", evidence)]


LEAST_FRAMES = 2
LEAST_REGIONS = REGIONS[0] * REGIONS[1] // 2 + 1
"""In fewer regions of the picture outlines say nothing of the whole: a robot's arms at its border are no witness."""
LEAST_GAIN, LEAST_GAIN_ABOVE = 0.1, 0.07
"""The warp must bring so much more of the outlines onto edges, and more than chance does."""
GAINING_FRAMES = 0.8
LEAST_PEAK, REGION_PEAK = 0.06, 0.12
"""What is registered falls by so much when one picture is moved by a few pixels; and in a region alone."""
LEAST_ELSEWHERE = 0.02
"""And what is found without a row or column of regions must bring so much more of theirs onto edges."""
KEPT = 0.03
"""What a region that is registered as it is may lose by a warp."""
WORTH_PX = 3.0
"""Where the warp moves what is seen by less, at a width of 640, it is not worth declaring."""


def _outlines_measured(seen: Seen, mended: Seen) -> tuple[RegionAgreement, ...]:
    own, other = ((o, Registration.none(o.camera)) for o in (seen.outlines, mended.outlines))
    plain = [o.by_region(o.near(none)) for o, none in (own, other)]
    above = [o.by_region(o.above_chance(none)) for o, none in (own, other)]
    peaked = np.nan_to_num(above[0]) > REGION_PEAK
    # A region that is registered as it is may lose nothing to speak of.
    kept = np.where(peaked & (plain[1] - plain[0] < -KEPT), plain[0] - 2 * MOST_LOSS, plain[1])
    return RegionAgreement(plain[0], kept, LEAST_GAIN), RegionAgreement(above[0], above[1], LEAST_GAIN_ABOVE)


def _registration(seen: Seen) -> Opinion:
    outlines = seen.outlines
    identity = Registration.none(outlines.camera)
    near = outlines.near(identity)
    own = outlines.by_region(near)
    frames = int(np.isfinite(outlines.by_frame(near)).sum())
    regions = int(np.isfinite(own).sum())
    if frames < LEAST_FRAMES or regions < LEAST_REGIONS:
        text = f"outlines of depth in {regions} of {own.size} regions of the picture, {frames} frames: too few to tell"
        return Opinion("registration", "unknown", text)
    peak = mean_known(outlines.by_region(outlines.above_chance(identity)))
    fitted = estimate_warp(outlines)
    gain = np.nan_to_num(outlines.near(fitted.warp) - near)
    gained, off = mean_known(outlines.by_region(gain)), displacement(fitted.warp, outlines)
    by_frame = outlines.by_frame(gain)
    edges = mean_known(own)
    evidence = {"edges": round(edges, 4), "edges_warped": round(edges + gained, 4), "border_px": round(off, 1)}
    gaining = float(np.mean(by_frame[np.isfinite(by_frame)] > 0))
    if gained >= LEAST_GAIN and gaining >= GAINING_FRAMES and off >= WORTH_PX:
        what = "outlines of depth miss edges of colour"
        if fitted.bounded:
            text = f"{what}; the search for a colour camera of its own ended at its bound"
            return Opinion("registration", "unknown", text, evidence=evidence)
        if not _holds_elsewhere(outlines, fitted):
            text = f"{what}, those of one part of the picture by another warp than the rest"
            return Opinion("registration", "unknown", text, evidence=evidence)
        warp = fitted.warp
        numbers = tuple(round(float(n), 4) for n in (warp.fx, warp.fy, warp.cx, warp.cy, warp.tx, warp.ty, warp.tz))
        text = (
            f"{what} ({evidence['edges']:.0%} agree, {evidence['edges_warped']:.0%} "
            f"with a colour camera of its own): off by {off:.0f} pixels"
        )
        line = f"--registration {','.join(f'{n:g}' for n in numbers)}"
        return Opinion("registration", "wrong", text, {"registration": numbers}, line, evidence)
    if peak < LEAST_PEAK:
        return Opinion("registration", "unknown", "edges of colour are everywhere or nowhere", evidence=evidence)
    already = ", by the warp that is declared" if seen.settings.registration else ""
    text = f"{evidence['edges']:.0%} of the outlines of depth lie on edges of colour{already}; no warp does much better"
    return Opinion("registration", "fine", text, evidence=evidence)


def _holds_elsewhere(outlines: Outlines, fitted: WarpEstimate) -> bool:
    """Cross-validate a warp on each row and column of regions left out of the fit."""
    near = outlines.near(Registration.none(outlines.camera))
    grid = np.arange(REGIONS[0] * REGIONS[1]).reshape(REGIONS)
    for left_out in (*grid, *grid.T):
        warp = estimate_warp(outlines, ~np.isin(grid.ravel(), left_out), fitted.warp).warp
        gain = outlines.by_region(np.nan_to_num(outlines.near(warp) - near))[left_out]
        if np.isfinite(gain).any() and mean_known(gain) < LEAST_ELSEWHERE:
            return False
    return True


def displacement(warp: Registration, outlines: Outlines) -> float:
    """Displacement of outlines by a warp, 0.9 quantile, pixels at a width of 640."""
    columns, rows, _ = warp.pixels(outlines.u, outlines.v, outlines.z, outlines.camera)
    moved = np.hypot(columns - outlines.u, rows - outlines.v)
    return float(np.quantile(moved, 0.9) * WIDE / outlines.away.shape[3])


AXIS_DEG = 6.0
"""A world whose axis is no farther off the vote has that axis up."""
WRONG_DEG = 20.0
LEAST_NEARER = 0.1
"""A mend must bring the declared up so much nearer to the level planes of each frame, 1 being on them."""
AXES = {f"{sign}{name}": np.eye(3)[k] * (1 if sign == "+" else -1) for k, name in enumerate("xyz") for sign in "+-"}


def _up(seen: Seen, known: Sequence[Opinion]) -> Opinion:
    agreed, axis = _agreed(seen)
    if all(frame.camera.up is None for frame in seen.frames):
        return Opinion("up", "unknown" if agreed is None else "fine", agreed or "nothing declares it or shows it")
    offs = _off(seen)
    offs = offs[np.isfinite(offs)]
    if len(offs) < min(2, len(seen.frames)):
        return Opinion("up", "unknown", f"{len(offs)} of {len(seen.frames)} frames show a level plane that could tell")
    off = float(np.median(offs))
    text = f"the up that is declared is {off:.0f} degrees off the level planes of {len(offs)} frames"
    evidence = {"degrees": round(off, 1), "frames": float(len(offs))}
    if off <= WRONG_DEG:
        return Opinion("up", "fine", text, evidence=evidence)
    trusted = any(o.about == "poses" and (o.state == "fine" or o.mend) for o in known)
    if seen.world_up and not trusted:
        return Opinion("up", "unknown", f"{text}; nothing shows that the poses hold, which carry it", evidence=evidence)
    if axis is None:
        return Opinion("up", "unknown", f"{text}; --up X,Y,Z or --level-at U,V tells another", evidence=evidence)
    return Opinion("up", "wrong", f"{text}; {agreed}", {"up": axis}, f"--up {axis}", evidence)


def _off(seen: Seen) -> np.ndarray:
    """Angles (F,) in degrees between declared up and level planes, NaN where unknown."""
    found = np.full(len(seen.frames), np.nan)
    for k, frame in enumerate(seen.frames):
        own = None if frame.camera.up is None else decided(up_hypotheses(frame.depth, frame.camera))
        if own is not None and frame.camera.up is not None:
            found[k] = _degrees(own.up, frame.camera.up)
    return found


def _agreed(seen: Seen) -> tuple[str | None, str | None]:
    """Agreed up of each scene's posed frames, in words, and "world:X,Y,Z" for a common axis."""
    scenes: defaultdict[str, list[Voter]] = defaultdict(list)
    for frame, scene in zip(seen.frames, seen.scenes, strict=True):
        pose = frame.camera.T_world_camera
        if pose is not None:
            scenes[scene].append((frame.id, pose[:3, :3], up_hypotheses(frame.depth, frame.camera)))
    ups = [counted.up for scene, voters in scenes.items() if (counted := vote(scene, voters)).up is not None]
    if not ups:
        return None, None
    mean = np.mean(ups, axis=0)
    name, axis = min(AXES.items(), key=lambda item: _degrees(item[1], mean))
    if any(_degrees(axis, up) > AXIS_DEG for up in ups):
        return "the level planes of the frames agree on an up that is no axis of the world", None
    numbers = ",".join(f"{n:g}" for n in axis + 0.0)
    return f"the level planes of the frames say that up is the world's {name}", f"world:{numbers}"


def _degrees(a: np.ndarray, b: np.ndarray) -> float:
    return float(np.rad2deg(np.arccos(np.clip(a @ b / np.linalg.norm(a) / np.linalg.norm(b), -1, 1))))


SUSPICIONS = (
    # With its mend the same sizes are looked at again: none may speak for another unit.
    Suspicion(_sizes),
    Suspicion(lambda seen, known: [_registration(seen)], _outlines_measured),
    Suspicion(
        lambda seen, known: [_up(seen, known)],
        lambda seen, mended: (RegionAgreement(1 - _off(seen) / 180, 1 - _off(mended) / 180, LEAST_NEARER),),
    ),
)
"""What is looked for after landing, in an order in which none explains another: what landing leaves of the unit, the
registration of what is mended so far, and up, which mended poses carry."""
