"""Recordings with one error planted in what is read of them, and what `doctor` says of each.

    python -m tests.benchmarks.doctor_cases [--held-out] [--seed N]

The recordings are public ones (SPATIALVIZ_SHARED, default ../shared; those that are absent are left out) and rooms
that are rendered for it. Of each, runs of frames are taken, and in each of them depth is read with another unit,
intrinsics are longer or shorter or have cx and cy swapped, or poses are of another convention. A case is

right     the error is named, its mend undoes it (units, focal lengths and centres within a few per cent), and nothing
          else of unit, camera and poses is called wrong; where nothing is planted, nothing is
abstains  nothing is called wrong, and of what is planted it is said that it cannot be told
wrong     all else

The factors and runs of `--held-out` are drawn at random from a seed; nothing was adjusted to them.
"""

from __future__ import annotations

import argparse
import os
import tempfile
import time
from collections import defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from pipeline.datasets import open_dataset
from pipeline.datasets.base import InMemoryDataset, scene_of
from pipeline.datasets.doctor.examine import Examination, examine_frames
from pipeline.datasets.synthetic import render_dataset
from pipeline.geometry.camera import Camera
from pipeline.geometry.frame import Frame
from pipeline.geometry.pose_convention import CONVENTIONS, STANDARD, as_convention
from pipeline.system.errors import InputError

REAL = Path(os.environ.get("SPATIALVIZ_SHARED", "../shared")) / "data" / "real"
RECORDINGS = {
    "7-scenes": ("7scenes-redkitchen", {}),
    "dining room": ("slambook-diningroom", {"intrinsics": (518.0, 519.0, 325.5, 253.5), "depth_scale": 1000.0}),
    "redwood": ("open3d-testdata", {}),
    "ycbv": ("ycbv-bop", {}),
}
SUBJECTS = ("poses", "depth scale", "focal length", "principal point")
UNITS = 1000.0
SCALE_WITHIN, FOCAL_WITHIN, CENTER_WITHIN = 0.1, 0.08, 0.03
FIXED = (
    *(("depth scale", factor) for factor in (5.0, 0.2, 8.0, 0.125, 2.0)),
    *(("focal length", factor) for factor in (1.25, 0.8, 1.6)),
    ("principal point", "swapped"),
    *(("poses", name) for name in CONVENTIONS if name != STANDARD),
)


@dataclass(frozen=True)
class Planted:
    """One error: what it is in, and the factor or the name by which what is read differs from the truth."""

    about: str
    by: float | str

    def read(self, frame: Frame) -> Frame:
        """The frame as it is read with the error."""
        camera = frame.camera
        if self.about == "depth scale":
            return replace(frame, depth=frame.depth * np.float32(self.by))
        if self.about == "focal length":
            return replace(frame, camera=replace(camera, K=camera.K * np.array([self.by, self.by, 1])[:, None]
                                                 + _center(camera, 1 - float(self.by))))  # fmt: skip
        if self.about == "principal point":
            K = camera.K.copy()
            K[:2, 2] = K[1::-1, 2]
            return replace(frame, camera=replace(camera, K=K))
        if self.about == "poses" and camera.T_world_camera is not None:
            T = as_convention(camera.T_world_camera, str(self.by))
            return replace(frame, camera=replace(camera, T_world_camera=T))
        return frame

    def mended(self, found: Examination, frames: Sequence[Frame]) -> bool:
        """Whether what is said to mend it does."""
        opinion = found.of(self.about)
        if self.about == "depth scale":
            return abs(opinion.mend["depth_scale"] / (UNITS * float(self.by)) - 1) < SCALE_WITHIN
        if self.about == "poses":
            return opinion.mend["poses"] == self.by
        fx, _, cx, cy = opinion.mend["intrinsics"]
        truth = frames[0].camera
        if self.about == "focal length":
            return abs(fx / truth.fx - 1) < FOCAL_WITHIN
        return max(abs(cx - truth.cx), abs(cy - truth.cy)) < CENTER_WITHIN * truth.width


def _center(camera: Camera, share: float) -> np.ndarray:
    out = np.zeros((3, 3))
    out[:2, 2] = share * camera.K[:2, 2]
    return out


NOTHING = Planted("nothing", "")


@dataclass(frozen=True)
class Judged:
    """A case and what became of it."""

    recording: str
    frames: tuple[str, ...]
    planted: Planted
    outcome: str
    seconds: float
    wall: float
    overlap: bool
    said: str
    registration: str


def judge(recording: str, frames: Sequence[Frame], planted: Planted) -> Judged:
    """Plant an error and see what is said."""
    started = time.process_time(), time.perf_counter()
    try:
        dataset = InMemoryDataset(planted.read(frame) for frame in frames)
    except InputError as error:
        return Judged(recording, tuple(f.id for f in frames), planted, "refused", 0.0, 0.0, True, str(error), "")
    found = examine_frames(dataset, [dataset.load(i) for i in dataset.frame_ids], UNITS)
    seconds, wall = time.process_time() - started[0], time.perf_counter() - started[1]
    wrong = {about for about in SUBJECTS if found.of(about).state == "wrong"}
    if planted is NOTHING:
        outcome = "wrong" if wrong else "right"
    elif wrong:
        outcome = "right" if wrong == {planted.about} and planted.mended(found, frames) else "wrong"
    else:
        outcome = "abstains" if found.of(planted.about).state == "unknown" else "wrong"
    said = " | ".join(f"{o.about}: {o.state} {o.option or ''}" for o in found.opinions if o.about in SUBJECTS)
    ids = tuple(frame.id for frame in frames)
    return Judged(
        recording, ids, planted, outcome, seconds, wall, found.pairs > 0, said, found.of("registration").state
    )


def recordings(rooms: Path, held_out: bool, only: Sequence[str] = ()) -> Iterator[tuple[str, list[list[Frame]]]]:
    """By name, the frames of each scene."""
    if not only or "rendered" in only:
        render_dataset(rooms, rooms=3, views=4, seed=4711 if held_out else 77)
    for name, (folder, told) in {**RECORDINGS, "rendered": (str(rooms), {})}.items():
        path = Path(folder) if name == "rendered" else REAL / folder
        if not path.is_dir() or (only and name not in only):
            continue
        dataset = open_dataset(path, **told)
        scenes: defaultdict[str, list[Frame]] = defaultdict(list)
        for frame_id in dataset.frame_ids:
            frame = dataset.load(frame_id)
            scenes[scene_of(dataset, frame_id)].append(replace(frame, annotations=()))
        yield name, list(scenes.values())


def cases(held_out: bool, seed: int, repeats: int = 3, only: Sequence[str] = ()) -> Iterator[Judged]:
    """Every error on every recording; or random ones on random runs of frames."""
    rng = np.random.default_rng(seed)
    with tempfile.TemporaryDirectory() as folder:
        for name, scenes in recordings(Path(folder) / "rooms", held_out, only):
            every = [frame for frames in scenes for frame in frames]
            if not held_out:
                yield from (judge(name, every, planted) for planted in (NOTHING, *(Planted(*one) for one in FIXED)))
                continue
            for _ in range(repeats):
                for planted in (NOTHING, *drawn(rng)):
                    yield judge(name, run_of(rng, scenes), planted)


def drawn(rng: np.random.Generator) -> list[Planted]:
    """One error of each kind, with a factor of its own."""
    ways = rng.choice([-1, 1], size=2)
    return [
        Planted("depth scale", float(rng.uniform(1.4, 7.0) ** ways[0])),
        Planted("focal length", float(rng.uniform(1.15, 1.9) ** ways[1])),
        Planted("principal point", "swapped"),
        Planted("poses", str(rng.choice([name for name in CONVENTIONS if name != STANDARD]))),
    ]


def run_of(rng: np.random.Generator, scenes: Sequence[list[Frame]]) -> list[Frame]:
    """Some frames of some scene, at least two."""
    frames = scenes[int(rng.integers(len(scenes)))]
    count = int(rng.integers(2, len(frames) + 1))
    return [frames[k] for k in sorted(rng.permutation(len(frames))[:count])]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--held-out", action="store_true")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--all", action="store_true", help="print every case")
    parser.add_argument("--only", nargs="*", default=[], help="recordings by name")
    given = parser.parse_args()
    tally: defaultdict[str, defaultdict[str, int]] = defaultdict(lambda: defaultdict(int))
    slowest, longest, alarms = 0.0, 0.0, 0
    for one in cases(given.held_out, given.seed, given.repeats, given.only):
        tally[one.recording][one.outcome] += 1
        tally["all"][one.outcome] += 1
        kind = "overlapping" if one.overlap else "apart"
        if one.planted is not NOTHING:
            tally[kind][one.outcome] += 1
            tally[one.planted.about][one.outcome] += 1
        slowest, longest = max(slowest, one.seconds), max(longest, one.wall)
        alarms += one.registration == "wrong" and one.recording != "7-scenes"
        if given.all or one.outcome in ("wrong", "refused"):
            by = one.planted.by if isinstance(one.planted.by, str) else f"{one.planted.by:.3f}"
            case = f"{one.recording} {len(one.frames)} {one.planted.about} {by} {one.seconds:.1f}s"
            print(f"{one.outcome:8} {case}: {one.said}")
    columns = ("right", "abstains", "wrong", "refused")
    print(f"{'':16}" + "".join(f"{c:>10}" for c in columns))
    for name, counts in tally.items():
        print(f"{name:16}" + "".join(f"{counts[c]:>10}" for c in columns))
    print(
        f"slowest {slowest:.1f} s of processor time, {longest:.1f} s by the clock; "
        f"false alarms of registration {alarms}"
    )


if __name__ == "__main__":
    main()
