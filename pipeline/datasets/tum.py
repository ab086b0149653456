"""TUM RGB-D: `rgb.txt` and `depth.txt` name the images by time, `groundtruth.txt` gives the camera's path."""

from __future__ import annotations

import math
import os
import re
from dataclasses import replace
from decimal import Decimal
from functools import lru_cache
from pathlib import Path, PurePath

import numpy as np

from pipeline.datasets.base import DatasetFormat
from pipeline.datasets.cameras import (
    CAMERA_SUFFIXES,
    Stated,
    is_small,
    or_note,
    pose_from_quaternion,
    stated_in_files,
)
from pipeline.datasets.files import as_floats, name_inside, numbered_lines, readable
from pipeline.datasets.images import picture_size
from pipeline.datasets.pairing import role_of, stem_of
from pipeline.datasets.recording import DepthRule, Listed, Recording
from pipeline.datasets.settings import Settings, camera_notes, unit_notes
from pipeline.datasets.stamps import ROUNDING, WITHIN, match_times, nearest
from pipeline.geometry.camera import rotations
from pipeline.language.counted import counted
from pipeline.system.errors import require

CAMERAS = {
    "freiburg1": (517.3, 516.5, 318.6, 255.3),
    "freiburg2": (520.9, 521.0, 325.1, 249.7),
    "freiburg3": (535.4, 539.2, 320.1, 247.6),
}
"""Intrinsics of the dataset's three cameras, for 640x480."""
DEFAULT_CAMERA = (525.0, 525.0, 319.5, 239.5)

_TIME = re.compile(r"[0-9]+(\.[0-9]+)?")
"""Seconds with as many digits as a script prints."""


class TumDataset(Recording):
    """Frames of the lines of rgb.txt in order of time; the id is the time stamp as written.

    Colour and depth belong together where they lie within 20 ms, the nearest first and each image once; a colour
    image that is left without depth is a broken frame. The pose is the nearest line of groundtruth.txt within 20
    ms. The intrinsics are those of a camera file, else of the camera that the folder's name tells (freiburg1, 2 or
    3), else the default of the format. Where these and the depth's unit stand in no file, a note says so. The world
    axes of the motion capture are not declared.
    """

    format = "tum"
    again = r"assoc\w*\.txt"
    rule = DepthRule(5000.0, "TUM's")

    def __init__(self, root: Path, settings: Settings) -> None:
        super().__init__(root, settings)
        self._colors, self._depths = self._lists(root)
        self.frame_ids = tuple(self._colors)
        self._pose_notes: list[str] = []
        self._poses_in = self._camera_path_file(root)
        what = f"no camera pose, {self._poses_in.name}: "
        self._path = or_note(self._pose_notes, what, _camera_path, self._poses_in)
        self._stated = self._camera_beside(root, settings)
        self._say_camera(root, settings)

    def _camera_beside(self, root: Path, settings: Settings) -> Stated:
        """What the camera files in the folder say, of the words of their names."""
        names = [name for name in readable(root)[1] if role_of(stem_of(name))[0] == "camera" and is_small(root / name)]
        known = settings.intrinsics is not None
        stated = stated_in_files((root / n for n in names if n.lower().endswith(CAMERA_SUFFIXES)), known)
        if stated.units_per_metre is not None:
            # The format's own unit is for folders that state none.
            self.notes = tuple(note for note in self.notes if note not in unit_notes(settings, 5000.0, self.rule.whose))
        return stated

    def _lists(self, root: Path) -> tuple[dict[str, str], dict[str, str]]:
        """Names of colour and of depth images by the time stamp of the colour as written."""
        colors, depths = self._entries(root / "rgb.txt"), self._entries(root / "depth.txt")
        matched = match_times(*(np.array([float(stamp) for stamp in entries]) for entries in (colors, depths)))
        require(
            matched,
            "no colour image has a depth image within 20 ms",
            got=f"times from {next(iter(colors))} in rgb.txt and from {next(iter(depths))} in depth.txt",
            path=root / "depth.txt",
        )
        stamps, names = tuple(colors), tuple(depths.values())
        return colors, {stamps[i]: names[j] for i, j in matched.items()}

    def _entries(self, source: Path) -> dict[str, str]:
        """Names of a list of images by time stamp as written, in order of time."""
        # As decimals, since two stamps may differ only in digits that a float does not hold.
        found: dict[Decimal, tuple[str, str]] = {}
        repeated: list[int] = []
        for number, line in numbered_lines(source):
            stamp, *rest = line.split(maxsplit=1)
            require(
                _TIME.fullmatch(stamp) and math.isfinite(float(stamp)) and rest,
                f"line {number} is malformed",
                got=repr(line[:60]),
                expected="timestamp path",
                path=source,
            )
            name = name_inside(rest[0], source, number)
            if found.setdefault(Decimal(stamp), (stamp, name)) != (stamp, name):
                repeated.append(number)
        self._say_repeated(source, repeated)
        require(found, "a list without a line", expected="timestamp path", path=source)
        return dict(found[time] for time in sorted(found))

    def _say_repeated(self, source: Path, lines: list[int]) -> None:
        if lines:
            which = f"{counted(len(lines), 'line')}, such as line {lines[0]}"
            self.notes += (f"{source.name}: {which}, left out: another picture with the same time stamp",)

    def _camera_path_file(self, root: Path) -> Path:
        return root / "groundtruth.txt"

    def _say_camera(self, root: Path, settings: Settings) -> None:
        """Take the camera that the folder's name tells, where no file does, and say so."""
        if self._stated.K is not None:
            return
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
            at = nearest(path[:, 0], float(frame_id), WITHIN + ROUNDING)
            if at is None:
                notes.append(f"no camera pose: {self._poses_in.name} has none within 20 ms")
            else:
                pose = or_note(notes, f"no camera pose, {self._poses_in.name}: ", self._pose, path[at, 1:])
        return Listed(self.root / color, self.root / self._depths[frame_id], self._stated, pose)

    def _pose(self, values: np.ndarray) -> np.ndarray:
        return pose_from_quaternion(values)


_NUMBER = re.compile("[0-9]+")


@lru_cache(maxsize=1024)
def _role(name: str) -> str | None:
    return role_of(name.replace("/", "_"))[0]


ASSOCIATIONS = ("associations.txt", "association.txt", "associate.txt", "assoc.txt")
ICL_PATH = ".gt.freiburg"
ICL_CAMERA = (481.2, 480.0, 319.5, 239.5)
"""Of https://www.doc.ic.ac.uk/~ahanda/VaFRIC/iclnuim.html for 640x480; its -480 is of pictures that run upwards."""
REFLECTED = np.diag([1.0, -1.0, 1.0, 1.0])


class AssociatedDataset(TumDataset):
    """Frames of the lines of `associations.txt`, "stamp picture stamp picture", of which a word in the names tells the
    depth; otherwise as TUM.

    With a camera path `*.gt.freiburg` it is a sequence of ICL-NUIM. Its makers' renderer has y up, in the world and in
    the camera, and the pictures of the format of TUM are stored from the top down: such poses are reflected in y.
    """

    def _lists(self, root: Path) -> tuple[dict[str, str], dict[str, str]]:
        source = root / next(name for name in ASSOCIATIONS if (root / name).is_file())
        colors: dict[str, str] = {}
        depths: dict[str, str] = {}
        repeated: list[int] = []
        for number, line in numbered_lines(source):
            words = line.split()
            sound = len(words) == 4 and all(_TIME.fullmatch(stamp) for stamp in words[::2])
            expected = "stamp picture stamp picture"
            require(sound, f"line {number} is malformed", got=repr(line[:60]), expected=expected, path=source)
            names = [name_inside(name, source, number) for name in words[1::2]]
            # Most names differ in their numbers alone.
            roles = [_role(_NUMBER.sub("0", name)) for name in names]
            require(
                roles.count("depth") == 1,
                f"line {number} does not tell which picture is depth",
                got=" and ".join(names)[:80],
                expected="the word depth in one of both names",
                path=source,
            )
            at = roles.index("depth")
            stamp = words[2 * (1 - at)]
            if stamp in colors:
                repeated.append(number)
                continue
            colors[stamp], depths[stamp] = names[1 - at], names[at]
        self._say_repeated(source, repeated)
        require(colors, "a list without a line", expected="stamp picture stamp picture", path=source)
        return colors, depths

    def _camera_path_file(self, root: Path) -> Path:
        return next((root / name for name in readable(root)[1] if name.endswith(ICL_PATH)), root / "groundtruth.txt")

    def _say_camera(self, root: Path, settings: Settings) -> None:
        self._reflected = False
        if not self._poses_in.name.endswith(ICL_PATH):
            return super()._say_camera(root, settings)
        self.documented, self.rule = ICL_CAMERA, DepthRule(5000.0, "ICL-NUIM's")
        K = self._stated.K
        self.notes = unit_notes(settings, 5000.0, self.rule.whose) if self._stated.units_per_metre is None else ()
        if K is None and picture_size(root / next(iter(self._colors.values()))) == (640, 480):
            self.notes += camera_notes(settings, ICL_CAMERA, "ICL-NUIM's for pictures stored from the top down")
        if self._path is not None and len(self._path):
            # A camera with y up that is held upright in a world with y up: the renderer's, and no picture's.
            self._reflected = bool(np.mean(rotations(self._path[:, 4:])[:, 1, 1]) > 0)
            how = "reflected in y, as its renderer has y up" if self._reflected else "taken as they stand"
            self.notes += (f"poses are those of {self._poses_in.name}, {how}",)
        if self._reflected and K is not None and K[1, 1] < 0 and settings.intrinsics is None:
            file = PurePath(self._stated.path or "").name
            self._stated = replace(self._stated, K=K @ REFLECTED[:3, :3])
            self.notes += (f"fy {K[1, 1]:g} of {file} is of y up in the camera: {-K[1, 1]:g} with the poses reflected",)
        return None

    def _pose(self, values: np.ndarray) -> np.ndarray:
        T = pose_from_quaternion(values)
        return REFLECTED @ T @ REFLECTED if self._reflected else T


def _camera_path(path: Path) -> np.ndarray:
    """(N, 8) rows timestamp tx ty tz qx qy qz qw in order of time; none without the file."""
    lines = numbered_lines(path) if path.is_file() else []
    rows = [as_floats(line.replace(",", " ").split(), 8, path, f"line {n}") for n, line in lines]
    table = np.stack(rows) if rows else np.empty((0, 8))
    require(np.isfinite(table[:, 0]).all(), "a time stamp with inf or NaN")
    return table[np.argsort(table[:, 0], kind="stable")]


ASSOCIATED = DatasetFormat(
    "tum",
    "tum: associations.txt with stamp, colour, stamp, depth a line (ICL-NUIM)",
    lambda root: any(os.path.isfile(root / name) for name in ASSOCIATIONS),
    AssociatedDataset,
)
FORMAT = DatasetFormat(
    "tum",
    "tum: rgb.txt and depth.txt",
    lambda root: os.path.isfile(root / "rgb.txt") and os.path.isfile(root / "depth.txt"),
    TumDataset,
)
