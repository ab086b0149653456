"""TUM RGB-D: `rgb.txt` and `depth.txt` name the images by time, `groundtruth.txt` gives the camera's path."""

from __future__ import annotations

import math
import os
import re
from decimal import Decimal
from pathlib import Path

import numpy as np

from pipeline.datasets.base import DatasetFormat
from pipeline.datasets.cameras import nearest, or_note, pose_from_quaternion
from pipeline.datasets.files import as_floats, name_inside, numbered_lines
from pipeline.datasets.recording import DepthRule, Listed, Recording
from pipeline.datasets.settings import Settings, camera_notes
from pipeline.system.errors import require

WITHIN = 0.02
"""Seconds by which two entries of one frame may differ."""

CAMERAS = {
    "freiburg1": (517.3, 516.5, 318.6, 255.3),
    "freiburg2": (520.9, 521.0, 325.1, 249.7),
    "freiburg3": (535.4, 539.2, 320.1, 247.6),
}
"""Intrinsics of the dataset's three cameras, for 640x480."""
DEFAULT_CAMERA = (525.0, 525.0, 319.5, 239.5)

_ROUNDING = 1e-6
_TIME = re.compile(r"[0-9]+(\.[0-9]+)?")
"""Seconds with as many digits as a script prints."""


class TumDataset(Recording):
    """Frames of the lines of rgb.txt in order of time; the id is the time stamp as written.

    Colour and depth belong together where they lie within 20 ms, the nearest first and each image once; a colour image
    that is left without depth is a broken frame. The pose is the nearest line of groundtruth.txt within 20 ms. The
    intrinsics are those of the camera that the folder's name tells (freiburg1, 2 or 3), else the default of the format.
    These and the depth's unit stand in no file, which a note says. The world axes of the motion capture are not
    declared.
    """

    format = "tum"
    rule = DepthRule(5000.0, "TUM's")

    def __init__(self, root: Path, settings: Settings) -> None:
        super().__init__(root, settings)
        colors, depths = _entries(root, "rgb.txt"), _entries(root, "depth.txt")
        matched = match_times(*(np.array([float(stamp) for stamp in entries]) for entries in (colors, depths)))
        require(
            matched,
            "no colour image has a depth image within 20 ms",
            got=f"times from {next(iter(colors))} in rgb.txt and from {next(iter(depths))} in depth.txt",
            path=root / "depth.txt",
        )
        self._colors = colors
        stamps, names = tuple(colors), tuple(depths.values())
        self._depths = {stamps[i]: names[j] for i, j in matched.items()}
        self.frame_ids = tuple(self._colors)
        self._pose_notes: list[str] = []
        self._path = or_note(
            self._pose_notes, "no camera pose, groundtruth.txt: ", _camera_path, root / "groundtruth.txt"
        )
        found = re.search("freiburg[123]", root.resolve().name.lower())
        self.documented = CAMERAS[found[0]] if found else DEFAULT_CAMERA
        whose = f"{found[0]}'s by the folder's name" if found else "TUM's default"
        self.notes += camera_notes(settings, self.documented, whose)

    def _listed(self, frame_id: str, notes: list[str]) -> Listed:
        color = self._found(self._colors, frame_id)
        require(frame_id in self._depths, f"no depth image within 20 ms of {frame_id}", path=self.root / "depth.txt")
        notes += self._pose_notes
        pose, path = None, self._path
        if path is not None and len(path):
            at = nearest(path[:, 0], float(frame_id), WITHIN + _ROUNDING)
            if at is None:
                notes.append("no camera pose: groundtruth.txt has none within 20 ms")
            else:
                pose = or_note(notes, "no camera pose, groundtruth.txt: ", pose_from_quaternion, path[at, 1:])
        return Listed(self.root / color, self.root / self._depths[frame_id], pose=pose)


def _entries(root: Path, name: str) -> dict[str, str]:
    """Names of a list of images by time stamp as written, in order of time."""
    source = root / name
    # As decimals, since two stamps may differ only in digits that a float does not hold.
    found: dict[Decimal, tuple[str, str]] = {}
    for number, line in numbered_lines(source):
        stamp, *rest = line.split(maxsplit=1)
        require(
            _TIME.fullmatch(stamp) and math.isfinite(float(stamp)) and rest,
            f"line {number} is malformed",
            got=repr(line[:60]),
            expected="timestamp path",
            path=source,
        )
        require(Decimal(stamp) not in found, f"line {number} repeats a time stamp", got=stamp[:60], path=source)
        found[Decimal(stamp)] = stamp, name_inside(rest[0], source, number)
    require(found, "a list without a line", expected="timestamp path", path=source)
    return dict(found[time] for time in sorted(found))


def match_times(a: np.ndarray, b: np.ndarray) -> dict[int, int]:
    """Matches of two sorted lists of times within 20 ms, nearest first, each time used once. The greedy rule is that of
    the dataset's own associate.py."""
    low = np.searchsorted(b, a - WITHIN - _ROUNDING, side="left")
    high = np.searchsorted(b, a + WITHIN + _ROUNDING, side="right")
    count = high - low
    first = np.repeat(np.arange(len(a)), count)
    second = np.arange(count.sum()) - np.repeat(np.cumsum(count) - count, count) + np.repeat(low, count)
    found: dict[int, int] = {}
    taken: set[int] = set()
    for k in np.argsort(np.abs(a[first] - b[second]), kind="stable").tolist():
        i, j = int(first[k]), int(second[k])
        if i not in found and j not in taken:
            found[i] = j
            taken.add(j)
    return found


def _camera_path(path: Path) -> np.ndarray:
    """(N, 8) rows timestamp tx ty tz qx qy qz qw in order of time; none without the file."""
    lines = numbered_lines(path) if path.is_file() else []
    rows = [as_floats(line.replace(",", " ").split(), 8, path, f"line {n}") for n, line in lines]
    table = np.stack(rows) if rows else np.empty((0, 8))
    require(np.isfinite(table[:, 0]).all(), "a time stamp with inf or NaN")
    return table[np.argsort(table[:, 0], kind="stable")]


FORMAT = DatasetFormat(
    "tum",
    "tum: rgb.txt and depth.txt",
    lambda root: os.path.isfile(root / "rgb.txt") and os.path.isfile(root / "depth.txt"),
    TumDataset,
)
