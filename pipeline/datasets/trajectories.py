"""Camera paths in one file, a line a frame: 4x4 matrices, positions with quaternions, CSV with named columns."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from pipeline.datasets.cameras import named_numbers, pose_from_matrix, pose_from_quaternion
from pipeline.datasets.files import as_floats, numbered_lines, read_bytes
from pipeline.datasets.stamps import ROUNDING, WITHIN, as_seconds, nearest
from pipeline.system.errors import InputError, require
from pipeline.system.frozen import dataclass

NAMES = re.compile(
    r"(camera_?|cam_?|key_?frame_?|gt_?|est_?|estimated_?)?(traj(ectory)?|odom(etry)?|ground_?truth|poses?|path|arkit_?poses?)"
    r"(_?(gt|tum|c2w|camera))?\.(txt|csv|tum|log)|.*\.gt\.freiburg|.*\.freiburg|.*\.tum",
    re.IGNORECASE,
)
"""What a camera path beside a recording may be called."""
MATRIX_SIZES = (12, 16)
MOST_COLUMNS, LONGEST_NAME = 100, 60
"""Of a CSV: so many are looked at, and characters of their names."""
_COLUMNS = {
    "time": r"time.*|t|stamp|ts|seconds",
    "frame": r"frame.*|index|idx|id|image_?id",
    **{axis: rf"((p|t|pos|position|translation)(_.*)?_?)?{axis}" for axis in "xyz"},
    **{f"q{axis}": rf"(q|quat|quaternion|rot|rotation|orientation)(_.*)?_?{axis}" for axis in "xyzw"},
}
"""Names of the columns of a CSV, by what they hold."""
_SPLIT = re.compile(r"[,;\t]")


@dataclass(frozen=True)
class Trajectory:
    """The lines of a camera path, not yet checked to be poses: camera-to-world, metres."""

    path: Path
    rows: tuple[np.ndarray, ...]  # (7,) tx ty tz qx qy qz qw, or (12,) or (16,) a matrix row by row, each
    frames: tuple[str, ...] = ()  # The frame numbers that a column holds, without leading zeros
    times: np.ndarray | None = None  # (N,) float64 or None: Seconds, or whole numbers of frames

    def pose(self, row: int) -> np.ndarray:
        """T_world_camera (4, 4) of a row; InputError where it is no rigid pose."""
        values = self.rows[row]
        if len(values) == 7:
            return pose_from_quaternion(values)
        return pose_from_matrix(
            np.vstack([values[:12].reshape(3, 4), values[12:] if len(values) == 16 else [0, 0, 0, 1]])
        )

    def rows_of(self, numbers: Sequence[str]) -> list[int | None]:
        """Row of each frame, of the number or time in its name: by the column of frames, by time within 20 ms, by order
        where there are as many, else by the line's place from the first frame's on. InputError where none fits."""
        if self.frames:
            found = {frame: row for row, frame in enumerate(self.frames)}
            rows = [found.get(number) for number in numbers]
            if any(row is not None for row in rows):
                return rows
        if self.times is not None and all(re.fullmatch(r"[0-9]+(\.[0-9]+)?", number) for number in numbers):
            times, wanted = as_seconds(self.times), as_seconds(np.array([float(number) for number in numbers]))
            rows = [nearest(times, float(time), WITHIN + ROUNDING) for time in wanted]
            if any(row is not None for row in rows):
                return rows
        if len(self.rows) == len(numbers):
            return list(range(len(self.rows)))
        if all(number.isdecimal() for number in numbers) and max(map(int, numbers)) < len(self.rows):
            return [int(number) for number in numbers]
        raise InputError(f"{len(self.rows)} poses for {len(numbers)} frames", path=self.path)


def path_in(path: Path) -> Trajectory | None:
    """Read the camera path in a file of named numbers: matrices under the numbers of frames, such as "0007"; None where
    it holds fewer than two.

    Raises
    ------
    InputError
        The file cannot be read.
    """
    named = [(key.rpartition(".")[2], values) for key, values in named_numbers(path) if values.size in MATRIX_SIZES]
    found = {numbers[-1]: values for key, values in named if (numbers := re.findall("[0-9]+", key))}
    frames = tuple(number.lstrip("0") or "0" for number in found)
    return Trajectory(path, tuple(found.values()), frames) if len(set(frames)) == len(named) > 1 else None


def read_trajectory(path: Path) -> Trajectory:
    """Read a camera path.

    Raises
    ------
    InputError
        A line that is no pose, or lines of different kinds.
    """
    lines = numbered_lines(path)
    require(lines, "a camera path without a line", path=path)
    # EuRoC writes the names of its columns as a comment.
    first = read_bytes(path, "text").decode("utf-8-sig").split("\n")[0].lstrip("# ")
    words = [word.strip() for word in _SPLIT.split(first, MOST_COLUMNS)]
    head = [re.sub(r"[ \[].*", "", word[:LONGEST_NAME]).lower() for word in words]
    if len(head) >= 7 and sum(bool(re.fullmatch("[a-z_0-9]*[a-z][a-z_0-9]*", word)) for word in head) >= 7:
        return _by_names(path, head, lines[1:] if first.strip() == lines[0][1] else lines)
    rows = [as_floats(text.replace(",", " ").split(), _count(lines[0][1]), path, f"line {n}") for n, text in lines]
    count = len(rows[0])
    if count in (7, *MATRIX_SIZES):
        return Trajectory(path, tuple(rows))
    require(
        count - 1 in (7, *MATRIX_SIZES),
        "lines that are no poses",
        got=f"{count} numbers",
        expected="[time] tx ty tz qx qy qz qw, or the 12 or 16 numbers of a matrix",
        path=path,
    )
    times = np.array([row[0] for row in rows])
    frames = tuple(f"{time:.0f}" for time in times) if np.array_equal(times, np.round(times)) else ()
    return Trajectory(path, tuple(row[1:] for row in rows), frames, times)


def _count(line: str) -> int:
    return len(line.replace(",", " ").split())


def _by_names(path: Path, head: list[str], lines: Sequence[tuple[int, str]]) -> Trajectory:
    at = {what: [k for k, name in enumerate(head) if re.fullmatch(names, name)] for what, names in _COLUMNS.items()}
    wanted = [key for key in _COLUMNS if key not in ("time", "frame")]
    missing = [key for key in wanted if len(at[key]) != 1]
    require(
        not missing, "not one column each of a pose", got=", ".join(head)[:80], expected=", ".join(wanted), path=path
    )
    table = [(n, [word.strip() for word in _SPLIT.split(text)]) for n, text in lines]
    for n, words in table:
        require(len(words) == len(head), f"line {n}: a wrong count", got=len(words), expected=len(head), path=path)
    rows = [as_floats([words[at[key][0]] for key in wanted], 7, path, f"line {n}") for n, words in table]
    frame, time = (next(iter(at[key]), None) for key in ("frame", "time"))
    frames = () if frame is None else tuple(words[frame].lstrip("0") or "0" for _, words in table)
    times = None if time is None else np.array([as_floats(w[time], 1, path, f"line {n}")[0] for n, w in table])
    return Trajectory(path, tuple(rows), frames, times)
