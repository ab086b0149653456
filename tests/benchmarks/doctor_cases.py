"""Recordings with one error planted in what is read of them, and what `doctor` says of each.

    PYTHONPATH=tests python -m benchmarks.doctor_cases [--held-out] [--seed N] [--only NAME ...] [--all]

The recordings are public ones (SPATIALVIZ_SHARED, default ../shared; those that are absent are left out) and scenes
that are rendered for it (doctor_scenes.py). What is planted, and what counts as right: doctor_plants.py.
The factors of `--held-out` are drawn at random from a seed, in scenes of other seeds; nothing was adjusted to them.
"""

from __future__ import annotations

import argparse
import os
import pickle
import time
from collections import defaultdict
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from benchmarks.doctor_plants import OUTCOMES, Judged, Planted, judge
from benchmarks.doctor_scenes import SCENES, Rendered

from pipeline.datasets import open_dataset
from pipeline.datasets.base import load_picture
from pipeline.geometry import CONVENTIONS, STANDARD, Frame

REAL = Path(os.environ.get("SPATIALVIZ_SHARED", "../shared")) / "data" / "real"
RECORDINGS: dict[str, tuple[str, dict[str, Any]]] = {
    "7-scenes": ("7scenes-redkitchen", {}),
    "dining room": ("slambook-diningroom", {"intrinsics": (518.0, 519.0, 325.5, 253.5), "depth_scale": 1000.0}),
    "redwood": ("open3d-testdata", {}),
    "ycbv": ("ycbv-bop", {}),
    "table-top pictures": ("flat-pairs-tabletop", {"depth_scale": 1000.0}),
}
UNALIGNED = ("7-scenes",)
"""Colour and depth of these are of two cameras as they are published."""
SEEDS, HELD_OUT = (1, 2), (101, 102)
NOTHING = Planted("")
OTHERS = [name for name in CONVENTIONS if name != STANDARD]
POSED = (
    *(Planted("depth scale", factor) for factor in (5.0, 0.2, 8.0, 0.125, 2.0, 1.25)),
    *(Planted("focal length", factor) for factor in (1.25, 0.8, 1.6)),
    *(Planted("picture size", factor) for factor in (0.5, 2.0)),
    Planted("principal point", "swapped"),
    Planted("principal point", (45.0, -30.0)),
    *(Planted("poses", name) for name in OTHERS),
)
WARPS = ((1.0, 12.0, -4.0, 0.0, 0.0), (0.9, 2.0, 0.0, 0.03, 0.0), (1.12, 0.0, 3.0, -0.025, 0.004))
PICTURES = (
    Planted("principal point", "swapped"),
    *(Planted("picture size", factor) for factor in (0.5, 2.0)),
    *(Planted("registration", warp) for warp in WARPS),
)
TIMES = tuple(Planted("time", k) for k in (-6, -3, -1, 2, 3, 5))
UPS = (Planted("up", (0.0, 1.0, 0.0)), Planted("up", (0.0, 0.0, -1.0)))


def drawn(rng: np.random.Generator) -> tuple[Planted, ...]:
    """One error of each kind, with a number of its own."""

    def by(low: float, high: float) -> float:
        return float(rng.uniform(low, high) ** rng.choice((-1, 1)))

    aside = float(rng.choice((-1, 1)) * rng.uniform(0.02, 0.05))
    warp = (by(1.05, 1.2), *rng.uniform(-8, 8, 2), aside, rng.normal(0, 0.005))
    return (
        Planted("depth scale", by(1.4, 7.0)),
        Planted("focal length", by(1.15, 1.9)),
        Planted("picture size", float(rng.choice((0.5, 2.0)))),
        Planted("principal point", "swapped"),
        Planted("principal point", tuple(float(rng.choice((-1, 1)) * n) for n in rng.uniform(30, 60, 2))),
        Planted("poses", str(rng.choice(OTHERS))),
        Planted("registration", tuple(float(n) for n in warp)),
        Planted("time", int(rng.choice((-1, 1)) * rng.integers(1, 9))),
        Planted("up", ((0.0, 1.0, 0.0), (1.0, 0.0, 0.0), (0.0, -1.0, 0.0))[int(rng.integers(3))]),
    )


Recorded = tuple[str, list[Frame], list[Rendered]]


def recordings(seeds: Sequence[int], keep: Path, only: Sequence[str]) -> Iterator[Recorded]:
    """Name and frames of each; and for those that are rendered, what else is known of them."""
    for kind, render in SCENES.items():
        for seed in seeds:
            if only and kind not in only:
                continue
            path = keep / f"{kind}-{seed}.pickle"
            if not path.is_file():
                keep.mkdir(parents=True, exist_ok=True)
                path.write_bytes(pickle.dumps(render(seed)))
            rendered = pickle.loads(path.read_bytes())
            yield f"{kind} {seed}", [one.frame for one in rendered], rendered
    for name, (folder, told) in RECORDINGS.items():
        if (not only or name in only) and (REAL / folder).is_dir():
            dataset = open_dataset(REAL / folder, **told)
            yield name, [load_picture(dataset, i) for i in dataset.frame_ids], []


def planted_in(frames: Sequence[Frame], rng: np.random.Generator | None) -> tuple[Planted, ...]:
    """What is planted in a recording: fixed errors, or drawn ones of the same kinds."""
    posed = frames[0].camera.T_world_camera is not None
    known = (*POSED, *PICTURES[3:], *TIMES, *UPS) if posed else PICTURES
    if len(frames) < 20:
        known = tuple(p for p in known if p.about != "time")
    if frames[0].camera.up is None:
        known = tuple(p for p in known if p.about != "up")
    if rng is None:
        return known
    kinds = {(p.about, p.by == "swapped") for p in known}
    return tuple(p for p in drawn(rng) if (p.about, p.by == "swapped") in kinds)


def cases(held_out: bool, seed: int, keep: Path, only: Sequence[str] = (), repeats: int = 1) -> Iterator[Judged]:
    """Nothing, and every error, in every recording."""
    rng = np.random.default_rng(seed) if held_out else None
    for name, frames, rendered in recordings(HELD_OUT if held_out else SEEDS, keep, only):
        passed = ("registration",) if name in UNALIGNED else ()
        yield judge(name, frames, NOTHING, passed=passed)
        if rendered:
            # The depth camera's own depth, as of colour: its warp is none that was inverted.
            read = [one.unaligned for one in rendered]
            yield judge(name, frames, Planted("registration", "unaligned"), read)
        for _ in range(repeats):
            for planted in planted_in(frames, rng):
                if not (passed and planted.about == "registration"):
                    yield judge(name, frames, planted, passed=passed)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--held-out", action="store_true")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--repeats", type=int, default=1)
    parser.add_argument("--all", action="store_true", help="print every case")
    parser.add_argument("--only", nargs="*", default=[], help="recordings by name")
    parser.add_argument(
        "--keep",
        type=Path,
        default=Path("~/.cache/spatialviz-doctor-cases").expanduser(),
        help="where rendered scenes are kept",
    )
    given = parser.parse_args()
    tally: defaultdict[str, defaultdict[str, int]] = defaultdict(lambda: defaultdict(int))
    started, last, slowest = time.perf_counter(), time.process_time(), 0.0
    for one in cases(given.held_out, given.seed, given.keep, given.only, given.repeats):
        spent, last = time.process_time() - last, time.process_time()
        slowest = max(slowest, spent)
        what = one.planted.about or "nothing"
        for key in (what, one.recording, "planted" if one.planted.about else "honest"):
            tally[key][one.outcome] += 1
        if given.all or one.outcome in ("wrong mend", "false alarm", "missed"):
            print(f"{one.outcome:11} {one.recording}, {what} {one.planted.by} ({spent:.1f} s): {one.said}", flush=True)
    print(f"{'':20}" + "".join(f"{column:>12}" for column in OUTCOMES))
    for name, counts in sorted(tally.items()):
        print(f"{name:20}" + "".join(f"{counts[column] or '':>12}" for column in OUTCOMES))
    print(f"slowest {slowest:.1f} s of processor time; {time.perf_counter() - started:.0f} s in all")


if __name__ == "__main__":
    main()
