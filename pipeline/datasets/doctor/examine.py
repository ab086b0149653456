"""Examining a recording: its frames chosen and read, every subject judged, and what would mend it."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from pipeline.datasets.base import Dataset, load_picture, readable_frames, scene_of
from pipeline.datasets.doctor.opinions import SUBJECTS, Opinion, Ranked, landing_opinions, ranked, scale_by_sizes
from pipeline.datasets.doctor.registering import registration_opinion
from pipeline.datasets.doctor.search import Search
from pipeline.datasets.doctor.timing import time_opinion
from pipeline.datasets.doctor.upright import up_opinion
from pipeline.datasets.opening import open_dataset
from pipeline.datasets.plausible import annotated_sizes
from pipeline.datasets.settings import GivenUp, Settings, read_settings, write_settings
from pipeline.geometry.camera import intrinsics
from pipeline.geometry.frame import Frame
from pipeline.geometry.landing import Views, detail_of
from pipeline.geometry.pose_convention import STANDARD, standard_poses
from pipeline.system.errors import InputError, require

MOST_FRAMES, MOST_SCENES = 12, 4
LONGEST_GAP = 300
"""Frames of one scene that are compared are at most about so many apart."""
ANNOTATED_FRAMES = 4
COARSE_GRID, FINE_GRID = (8, 10), (20, 26)
TRIED_UNITS = (1000.0, 5000.0, 1.0, 10000.0, 39.3701, 100.0)
"""Where the depth as read is refused, these units are tried, so that there is something to compare."""


@dataclass(frozen=True)
class Examination:
    """What was found.

    Attributes
    ----------
    root : Path
    frames : tuple of str
        Those that were looked at.
    pairs : int
        Pairs of them that overlap.
    opinions : tuple of Opinion
        One of each subject that was judged.
    hypotheses : tuple of Ranked
        What was tried for unit, camera and poses, the best first; empty where no two posed frames overlap.
    """

    root: Path
    frames: tuple[str, ...]
    pairs: int
    opinions: tuple[Opinion, ...]
    hypotheses: tuple[Ranked, ...] = ()

    @property
    def mends(self) -> dict[str, Any]:
        """What `write_settings` is to keep."""
        return {key: value for opinion in self.opinions for key, value in opinion.mend.items()}

    @property
    def wrong(self) -> tuple[Opinion, ...]:
        """What is wrong."""
        return tuple(opinion for opinion in self.opinions if opinion.state == "wrong")

    def of(self, about: str) -> Opinion:
        """The opinion on a subject."""
        return next(opinion for opinion in self.opinions if opinion.about == about)

    def record(self) -> dict[str, Any]:
        """What `spatialviz doctor --json` prints."""
        tried = [
            {"hypothesis": one.words, "score": round(one.score, 4), "as_good": one.as_good} for one in self.hypotheses
        ]
        opinions = [asdict(opinion) for opinion in self.opinions]
        return {
            "dataset": str(self.root), "frames": list(self.frames), "pairs": self.pairs, "opinions": opinions,
            "hypotheses": tried, "settings": self.mends,
        }  # fmt: skip


def examine(path: str | Path, **camera: Any) -> Examination:
    """Look for what is wrong with a recording; nothing is written.

    Parameters
    ----------
    path : str or Path
    camera : dict
        What `open_dataset` takes of it, from `intrinsics` to `registration`.

    Raises
    ------
    InputError
        It cannot be opened, or none of the frames that were looked at can be read.
    """
    dataset, told = open_dataset(path, **camera), dict(camera)
    frames = chosen_frames(dataset)
    notes: tuple[Opinion, ...] = ()
    for unit in TRIED_UNITS if not frames else ():
        told["depth_scale"] = unit
        dataset = open_dataset(path, **told)
        if frames := chosen_frames(dataset):
            break
    if not frames:
        open_dataset(path, **camera).load(dataset.frame_ids[0])  # Says what is wrong with it.
    require(frames, "none of the frames that were looked at can be read", path=dataset.root)
    settings = read_settings(dataset.root).overridden(registration=camera.get("registration"))
    found = examine_frames(dataset, frames, _units(path, told, frames[0]), settings)
    if told.get("depth_scale") != camera.get("depth_scale") and found.of("depth scale").state != "wrong":
        unit = told["depth_scale"]
        text = f"as read, no depth is that of a room; with {unit:g} units in a metre it is"
        mended = Opinion("depth scale", "wrong", text, {"depth_scale": unit}, f"--depth-scale {unit:g}")
        notes = tuple(mended if o.about == mended.about else o for o in found.opinions)
    return replace(found, opinions=notes or found.opinions)


def _units(path: str | Path, told: dict[str, Any], frame: Frame) -> float | None:
    """Depth units in a metre as a reader takes them, found by telling it others; None where it takes no telling."""
    for unit in TRIED_UNITS:
        try:
            other = open_dataset(path, **{**told, "depth_scale": unit}).load(frame.id).depth
        except InputError:
            continue
        both = (other > 0) & (frame.depth > 0)
        ratio = float(np.median(other[both] / frame.depth[both])) if other.shape == frame.depth.shape else 1.0
        return None if told.get("depth_scale") != unit and abs(ratio - 1) < 1e-6 and unit != 1000.0 else unit * ratio
    return None


def chosen_frames(dataset: Dataset) -> list[Frame]:
    """Some frames of some scenes, spread so that near and far ones are among them; broken ones are left out."""
    scenes: defaultdict[str, list[str]] = defaultdict(list)
    for frame_id in dataset.frame_ids:
        scenes[scene_of(dataset, frame_id)].append(frame_id)
    many = sorted(scenes.values(), key=lambda ids: len(ids) < 2)
    picked = [many[k] for k in np.unique(np.linspace(0, len(many) - 1, min(MOST_SCENES, len(many))).astype(int))]
    each = MOST_FRAMES // len(picked)
    ids = [ids[k] for ids in picked for k in _spread(len(ids), each)]
    return list(readable_frames(lambda frame_id: load_picture(dataset, frame_id), ids))


def _spread(count: int, wanted: int) -> list[int]:
    """Indices of `wanted` of `count` frames: all, or two runs whose gaps grow."""
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


def examine_frames(
    dataset: Dataset, frames: Sequence[Frame], units: float | None, settings: Settings | None = None
) -> Examination:
    """The same of frames that are at hand.

    Parameters
    ----------
    units : float or None
        Depth units in a metre as read, None where unknown.
    """
    size = Counter(frame.depth.shape for frame in frames).most_common(1)[0][0]
    frames = [frame for frame in frames if frame.depth.shape == size]
    cameras = [frame.camera for frame in frames]
    scenes = [scene_of(dataset, frame.id) for frame in frames]
    posed = [camera.T_world_camera is not None for camera in cameras]
    pairs = [
        (a, b)
        for a in range(len(frames))
        for b in range(len(frames))
        if a != b and scenes[a] == scenes[b] and posed[a] and posed[b]
    ]
    views = [
        Views.of([f.depth for f in frames], cameras, np.array(pairs, np.int64).reshape(-1, 2), grid)
        for grid in (COARSE_GRID, FINE_GRID)
    ]
    search = Search(views[0], replace(views[1], detail=np.stack([detail_of(f.rgb) for f in frames])))
    # With a declared registration the cameras are those of the colour; the setting is of the depth.
    alike = all(np.allclose(c.K, cameras[0].K) for c in cameras) and not (settings and settings.registration)
    K = cameras[0].K if alike else None
    opinions = landing_opinions(search, K, units)
    opinions = [_by_sizes(dataset, frames, units) or o if _undecided_scale(o) else o for o in opinions]
    mends = {key: value for o in opinions for key, value in o.mend.items()}
    mended = _mended(frames, mends, units)
    opinions += [registration_opinion(mended, settings), up_opinion(dataset, mended)]
    shifted = (settings and settings.pose_shift) or 0
    opinions.append(time_opinion(dataset, mended, mends.get("poses", STANDARD), shifted))
    opinions.sort(key=lambda opinion: SUBJECTS.index(opinion.about))
    return Examination(
        dataset.root, tuple(f.id for f in frames), len(search.fine.pairs), tuple(opinions), ranked(search)
    )


def _undecided_scale(opinion: Opinion) -> bool:
    return opinion.about == "depth scale" and opinion.state == "unknown"


def _by_sizes(dataset: Dataset, frames: Sequence[Frame], units: float | None) -> Opinion | None:
    """What annotated things of known classes say of the scale, where they say the same in most frames."""
    if not dataset.class_names:
        return None
    seen = list(readable_frames(dataset.load, [frame.id for frame in frames[:ANNOTATED_FRAMES]]))
    found = [factor for frame in seen if (factor := annotated_sizes(frame)) is not None]
    return scale_by_sizes(found, units) if 2 * len(found) > len(seen) else None


def _mended(frames: Sequence[Frame], mends: dict[str, Any], units: float | None) -> list[Frame]:
    """The frames as they are read with what mends them; as they are where that gives no depth of a room."""
    scale = units / mends["depth_scale"] if units is not None and "depth_scale" in mends else 1.0
    found = []
    for frame in frames:
        camera, T = frame.camera, frame.camera.T_world_camera
        K = intrinsics(*mends["intrinsics"]) if "intrinsics" in mends else camera.K
        pose = None if T is None else standard_poses(T, mends.get("poses", STANDARD))
        with suppress(InputError):
            depth = frame.depth * np.float32(scale)
            found.append(replace(frame, depth=depth, camera=replace(camera, K=K, T_world_camera=pose)))
    return found or list(frames)


def apply(found: Examination) -> Path | None:
    """Keep what mends a recording in its `spatialviz.toml`, whole or not at all; None where there is nothing to mend.

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
