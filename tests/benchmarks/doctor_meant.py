"""What `doctor` says of recordings, and of single frames, whose pictures or depth maps mean something else.

    PYTHONPATH=tests python -m benchmarks.doctor_meant [--seeds N ...] [--alone] [--only NAME ...] [--all]

Recordings and rendered scenes are those of doctor_cases.py. With `--alone` every frame is a recording of its own,
without a pose. Pictures are cropped where the principal point must be off the middle.
"""

from __future__ import annotations

import argparse
from collections import defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from benchmarks.doctor_cases import NOTHING, UNALIGNED, recordings
from benchmarks.doctor_plants import OUTCOMES, Judged, Planted, judge

from pipeline.geometry import Camera, Frame

MEANT = (
    *(Planted("depth kind", kind) for kind in ("distance", "inverse")),
    *(Planted("depth map", turn) for turn in ("180", "left-right", "top-bottom")),
    *(Planted("missing depth", value) for value in (65.535, 10.0)),
)
POSED = (*(Planted("pictures", way) for way in ("left-right", "top-bottom")), Planted("principal point", "other side"))
SQUARE = tuple(Planted("depth map", turn) for turn in ("90", "270"))
FOCALS = tuple(Planted("focal length", factor) for factor in (0.8, 1.25, 1.6))
LEAST_MISSING = 0.02
FRAMES = 2
"""So many of a recording are looked at alone."""


def cropped(frame: Frame, columns: int, rows: int, width: int, height: int) -> Frame:
    """A part of a frame, without annotations."""
    K = frame.camera.K.copy()
    K[:2, 2] -= [columns, rows]
    part = np.s_[rows : rows + height, columns : columns + width]
    camera = replace(frame.camera, K=K, width=width, height=height)
    return replace(frame, rgb=frame.rgb[part].copy(), depth=frame.depth[part].copy(), camera=camera, annotations=())


def planted(frames: Sequence[Frame], posed: bool) -> Iterator[tuple[Planted, list[Frame]]]:
    """Nothing and every error, with the true frames that it is planted in."""
    height, width = frames[0].depth.shape
    side, whole = min(height, width), list(frames)
    missing = np.mean([np.mean(frame.depth == 0) for frame in frames]) >= LEAST_MISSING
    off = [cropped(f, width // 6, height // 8, width - width // 6, height - height // 8) for f in frames]
    square = [cropped(f, (width - side) // 2, (height - side) // 2, side, side) for f in frames]
    for case in (NOTHING, *MEANT, *(POSED if posed else FOCALS)):
        if case.about != "missing depth" or missing:
            yield case, off if case.by == "other side" else whole
    for case in SQUARE:
        yield case, square


def cases(seeds: Sequence[int], keep: Path, only: Sequence[str], alone: bool) -> Iterator[Judged]:
    """Every error in every recording, or in every frame of it."""
    for name, frames, _ in recordings(seeds, keep, only):
        passed = ("registration",) if name in UNALIGNED else ()
        if alone:
            for frame in frames[:: max(1, len(frames) // FRAMES)][:FRAMES]:
                camera = Camera(frame.camera.K, frame.width, frame.height)
                one = [replace(frame, camera=camera, annotations=())]
                for case, truth in planted(one, posed=False):
                    yield judge(f"{name} {frame.id}", truth, case, passed=passed)
        else:
            for case, truth in planted(frames, frames[0].camera.T_world_camera is not None):
                yield judge(name, truth, case, passed=passed)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, nargs="*", default=[1, 2])
    parser.add_argument("--alone", action="store_true", help="single frames")
    parser.add_argument("--all", action="store_true", help="print every case")
    parser.add_argument("--only", nargs="*", default=[], help="recordings by name")
    parser.add_argument("--keep", type=Path, default=Path("~/.cache/spatialviz-doctor-cases").expanduser())
    given = parser.parse_args()
    tally: defaultdict[str, defaultdict[str, int]] = defaultdict(lambda: defaultdict(int))
    for one in cases(given.seeds, given.keep, given.only, given.alone):
        what = f"{one.planted.about or 'nothing'} {one.planted.by}"
        tally[what][one.outcome] += 1
        tally["planted" if one.planted.about else "honest"][one.outcome] += 1
        if given.all or one.outcome in ("wrong mend", "false alarm", "missed"):
            print(f"{one.outcome:11} {one.recording}, {what}: {one.said}", flush=True)
    print(f"{'':24}" + "".join(f"{column:>12}" for column in OUTCOMES))
    for name, counts in sorted(tally.items()):
        print(f"{name:24}" + "".join(f"{counts[column] or '':>12}" for column in OUTCOMES))


if __name__ == "__main__":
    main()
