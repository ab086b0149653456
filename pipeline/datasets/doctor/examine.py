"""Examination of a recording: choice of frames, judgement of every subject, fixes."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Callable, Sequence
from dataclasses import asdict, field, replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from pipeline.datasets.base import Dataset, dataset_notes, load_picture, readable_frames, scene_of
from pipeline.datasets.doctor.alone import kind, laid, nothing, square
from pipeline.datasets.doctor.landing import OfLanding
from pipeline.datasets.doctor.search import PosedViews
from pipeline.datasets.doctor.seen import Seen
from pipeline.datasets.doctor.suspicions import SUSPICIONS, Opinion, Suspicion, diagnosed
from pipeline.datasets.opening import open_dataset
from pipeline.datasets.settings import FILE_NAME, GivenUp, Settings, read_settings, write_settings
from pipeline.geometry.camera import composed
from pipeline.geometry.frame import Frame
from pipeline.geometry.registration import Outlines, Registration
from pipeline.system.errors import require
from pipeline.system.frozen import dataclass

MOST_FRAMES, MOST_SCENES = 12, 4
LONGEST_GAP = 300
"""Frames of one scene that are compared are at most about so many apart."""
TRIED_UNITS = (1000.0, 5000.0, 1.0, 10000.0, 39.3701, 100.0)
"""Where the depth as read is refused, these units are tried, so that there is something to compare."""


@dataclass(frozen=True)
class Ranked:
    """A tried hypothesis."""

    words: str  # What it says is wrong
    score: float  # Share of the points that land
    as_good: bool  # Whether the best is not surely better


@dataclass(frozen=True)
class Examination:
    """Findings on a recording.

    Attributes
    ----------
    frames : tuple of str
        Those that were looked at.
    pairs : int
        Pairs of them that overlap.
    opinions : tuple of Opinion
        One of each subject that was judged.
    hypotheses : tuple of Ranked
        What was tried for unit, camera and poses, the best first; empty where no two posed frames overlap.
    as_read, mended : tuple of Frame
        The frames as they were read, and with what mends them.
    notes : tuple of str
        What the reader took for granted, and the files beside the pictures that it did not use.
    """

    root: Path
    frames: tuple[str, ...]
    pairs: int
    opinions: tuple[Opinion, ...]
    hypotheses: tuple[Ranked, ...] = ()
    as_read: tuple[Frame, ...] = field(default=(), repr=False)
    mended: tuple[Frame, ...] = field(default=(), repr=False)
    notes: tuple[str, ...] = ()

    @property
    def mends(self) -> dict[str, Any]:
        """Settings for `write_settings`."""
        return {key: value for opinion in self.opinions for key, value in opinion.mend.items()}

    @property
    def wrong(self) -> tuple[Opinion, ...]:
        """Opinions with state "wrong"."""
        return tuple(opinion for opinion in self.opinions if opinion.state == "wrong")

    def of(self, about: str) -> Opinion:
        """The opinion on a subject."""
        return next(opinion for opinion in self.opinions if opinion.about == about)

    def record(self) -> dict[str, Any]:
        """Findings as JSON, for `spatialviz doctor --json`."""
        tried = [
            {"hypothesis": one.words, "score": round(one.score, 4), "as_good": one.as_good} for one in self.hypotheses
        ]
        opinions = [asdict(opinion) for opinion in self.opinions]
        return {
            "dataset": str(self.root),
            "frames": list(self.frames),
            "pairs": self.pairs,
            "notes": list(self.notes),
            "opinions": opinions,
            "hypotheses": tried,
            "settings": self.mends,
        }


Tell = Callable[[str, int, int], None]
"""Takes progress: what is done, how much of it is, and of how much."""


def untold(what: str, done: int, total: int) -> None:
    """Tell nobody of progress."""


def examine(path: str | Path, tell: Tell = untold, **camera: Any) -> Examination:
    """Examine a recording for faults, without writing.

    Parameters
    ----------
    tell : callable
        Takes progress.
    camera : dict
        What `open_dataset` takes of it, from `intrinsics` to `registration`.

    Raises
    ------
    InputError
        It cannot be opened, or none of the frames that were looked at can be read.
    """
    tell("opening the recording", 0, 0)
    dataset, options = open_dataset(path, **camera), dict(camera)
    frames = chosen_frames(dataset, tell)
    notes: tuple[Opinion, ...] = ()
    for unit in TRIED_UNITS if not frames else ():
        options["depth_scale"] = unit
        dataset = open_dataset(path, **options)
        if frames := chosen_frames(dataset):
            break
    if not frames:
        open_dataset(path, **camera).load(dataset.frame_ids[0])  # Says what is wrong with it.
    require(frames, "none of the frames that were looked at can be read", path=dataset.root)
    settings = read_settings(dataset.root).overridden(**{k: camera.get(k) for k in ("registration", "poses")})
    units = getattr(dataset, "depth_units", None)
    found = examine_frames(dataset, frames, units and units(frames[0].id), settings, tell)
    retried = options.get("depth_scale") != camera.get("depth_scale") and "depth_scale" not in found.mends
    if retried and found.of("depth scale").state != "wrong":
        unit = options["depth_scale"]
        text = f"as read, no depth is that of a room; with {unit:g} units in a metre it is"
        mended = Opinion("depth scale", "wrong", text, {"depth_scale": unit}, f"--depth-scale {unit:g}")
        notes = tuple(mended if o.about == mended.about else o for o in found.opinions)
    return replace(found, opinions=notes or found.opinions, notes=dataset_notes(dataset))


def chosen_frames(dataset: Dataset, tell: Tell = untold) -> list[Frame]:
    """Choose frames of some scenes, near and far apart; broken frames are left out."""
    scenes: defaultdict[str, list[str]] = defaultdict(list)
    for frame_id in dataset.frame_ids:
        scenes[scene_of(dataset, frame_id)].append(frame_id)
    many = sorted(scenes.values(), key=lambda ids: len(ids) < 2)
    picked = [many[k] for k in np.unique(np.linspace(0, len(many) - 1, min(MOST_SCENES, len(many))).astype(int))]
    each = MOST_FRAMES // len(picked)
    ids = [ids[k] for ids in picked for k in _spread(len(ids), each)]
    found = []
    for k, frame_id in enumerate(ids):
        tell("reading frames", k, len(ids))
        found += readable_frames(lambda one: load_picture(dataset, one), [frame_id])
    return found


def _spread(count: int, wanted: int) -> list[int]:
    """Indices of `wanted` of `count` frames: all, or two runs with growing gaps."""
    if count <= wanted:
        return list(range(count))
    half = max(wanted // 2, 1)
    gaps = np.unique(np.geomspace(1, min(count / 2 - 1, LONGEST_GAP), half).astype(int))[: half - 1]
    starts = (0, count // 2)
    found = {start + gap for start in starts for gap in (0, *gaps.tolist()) if start + gap < count}
    missing = (int(k) for k in np.linspace(0, count - 1, wanted))
    for k in missing:
        if len(found) >= wanted:
            break
        found.add(k)
    return sorted(found)


BEFORE = (Suspicion(lambda seen, known: nothing(seen)), Suspicion(lambda seen, known: laid(seen)))
"""What must be right before poses can be judged."""
AFTER = (Suspicion(kind), Suspicion(square))
"""What single frames tell where landing does not."""


def examine_frames(
    dataset: Dataset,
    frames: Sequence[Frame],
    units: float | None,
    settings: Settings | None = None,
    tell: Tell = untold,
) -> Examination:
    """Examine frames in memory. `units`: depth units in a metre as read, None where unknown."""
    settings = settings or Settings()
    size = Counter(frame.depth.shape for frame in frames).most_common(1)[0][0]
    seen = Seen(dataset, tuple(frame for frame in frames if frame.depth.shape == size), units, settings)
    landing = OfLanding()
    every = (*BEFORE, Suspicion(landing.opinions, landing.measured), *AFTER, *SUSPICIONS)
    opinions, mended = diagnosed(seen, every, lambda done: tell("looking for faults", done, len(every)))
    search = landing.first or landing.search(seen)
    kept = tuple(_as_kept(opinion, settings) for opinion in opinions)
    ids = tuple(frame.id for frame in seen.frames)
    return Examination(dataset.root, ids, len(search.fine.pairs), kept, _ranked(search), seen.frames, mended.frames)


def _ranked(search: PosedViews) -> tuple[Ranked, ...]:
    """Tried hypotheses, best first: the best, the recording as read, and the best of each cause."""
    if not len(search.fine.pairs):
        return ()
    best = search.best
    tried = [h for h in search.explanations if h != best]
    rows = [Ranked(h.words, search.at(h), h == best or not search.beats(best, h)) for h in (best, *tried)]
    return (rows[0], *sorted(rows[1:], key=lambda one: -one.score))


def _as_kept(opinion: Opinion, settings: Settings) -> Opinion:
    """Opinion with the fix relative to declared settings."""
    mend = dict(opinion.mend)
    if "pose_shift" in mend:
        mend["pose_shift"] += settings.pose_shift or 0
        return replace(opinion, mend=mend, option=f"pose_shift = {mend['pose_shift']} in {FILE_NAME}")
    if declared := next((key for key in mend if key in settings.meant), None):
        return replace(opinion, mend={}, option=f"of {declared} as it is declared, {settings.meant[declared]}")
    if "registration" in mend and settings.registration:
        both = Registration(*mend["registration"]).after(Registration(*settings.registration))
        numbers = tuple(round(float(n), 4) for n in (both.fx, both.fy, both.cx, both.cy, *both.t))
        return replace(
            opinion, mend={"registration": numbers}, option=f"--registration {','.join(f'{n:g}' for n in numbers)}"
        )
    if "poses" in mend and settings.poses:
        both = composed(settings.poses, mend["poses"])
        if both is None:
            return replace(opinion, mend={}, option=f"of the poses as they are declared, {settings.poses}")
        return replace(opinion, mend={"poses": both}, option=f'--poses "{both}"')
    return opinion


def apply(found: Examination) -> Path | None:
    """Write the fixes into the recording's `spatialviz.toml`, atomically; None without fixes.

    Raises
    ------
    InputError
        The folder cannot be written.
    """
    mends = dict(found.mends)
    if not mends:
        return None
    up = mends.pop("up", None)
    given = {key: mends.pop(key, None) for key in ("intrinsics", "depth_scale")}
    return write_settings(found.root, **given, up=None if up is None else GivenUp.parse(up), **mends)


ON_EDGE, OFF_EDGE = (40, 220, 90), (255, 50, 60)
"""RGB of outlines that lie on an edge of colour, and of those that do not."""
MOST_SHOWN = 4
FADED = 0.55


def overlay(found: Examination, most: int = MOST_SHOWN) -> np.ndarray:
    """Draw examined frames with depth outlines: left as read, right with the fixes applied.

    Where nothing is mended, the right is as the left.

    Returns
    -------
    (H, W, 3) uint8
        RGB; outlines of depth are green where they lie on edges of colour, else red.

    Examples
    --------
    >>> from pipeline.datasets import demo_path, examine, overlay
    >>> picture = overlay(examine(demo_path()), most=1)  # doctest: +SKIP
    >>> picture.shape  # doctest: +SKIP
    (480, 1280, 3)
    """
    mended = {frame.id: frame for frame in found.mended}
    shown = [frame for frame in found.as_read if frame.id in mended]
    shown = [shown[k] for k in np.unique(np.linspace(0, len(shown) - 1, min(most, len(shown))).astype(int))]
    return np.concatenate([np.concatenate([outlined(f), outlined(mended[f.id])], axis=1) for f in shown])


def outlined(frame: Frame) -> np.ndarray:
    """Faded colour (H, W, 3) uint8 of a frame with depth outlines."""
    out = cv2.addWeighted(frame.rgb, FADED, np.full_like(frame.rgb, 255), 1 - FADED, 0)
    found = Outlines.of([frame])
    near = found.near(Registration.none(frame.camera))
    size = max(1, round(frame.width / 640))
    for u, v, on in zip(found.u, found.v, near > 0.5, strict=True):
        cv2.circle(out, (int(u), int(v)), size, ON_EDGE if on else OFF_EDGE, -1)
    return out
