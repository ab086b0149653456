"""Cameras and poses from files, checked; and a dataset with its poses shifted.

Makers write the same few numbers into JSON, YAML, INI, MATLAB, NPZ and plain text under a dozen names. Every file is
read into one flat table of names and numbers, and the names that are known are looked up in it.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import replace
from pathlib import Path, PurePath
from typing import Any, TypeVar

import numpy as np

from pipeline.datasets.base import ChangedFrames, Dataset, load_picture, load_pose, scene_of
from pipeline.datasets.files import read_bytes, read_mat, shortened
from pipeline.datasets.images import Blob
from pipeline.geometry.camera import intrinsics, rotations
from pipeline.geometry.frame import Frame
from pipeline.system import safe_files
from pipeline.system.errors import InputError, as_input_error, require
from pipeline.system.frozen import dataclass

CAMERA_SUFFIXES = (".json", ".yml", ".yaml", ".txt", ".toml", ".ini", ".cfg", ".mat", ".npy", ".npz", ".pincam", ".csv")
LARGEST_BYTES = 64 * 1024
"""A camera file has some hundred bytes; a larger text is not searched to find out. MATLAB files carry more beside."""
CENTRED = 0.15
"""A principal point this share of the picture's size off its middle belongs to a picture of another size."""

_MATRICES = re.compile(r"(cam(era)?_?)?k|(.*_)?intrinsics?(_?mat(rix)?|_?params?)?|camera_?mat(rix)?|cam_?mat", re.I)
_NUMBERS = (
    ("fx", "fl_x", "focal_x", "focal_length_x", "focallengthx", "fu", "f_x"),
    ("fy", "fl_y", "focal_y", "focal_length_y", "focallengthy", "fv", "f_y"),
    ("cx", "ppx", "c_x", "principal_x", "principal_point_x", "principalpointx", "x0", "u0", "x_offset", "offset_x"),
    ("cy", "ppy", "c_y", "principal_y", "principal_point_y", "principalpointy", "y0", "v0", "y_offset", "offset_y"),
)
_MAT_NAMES = ("intrinsic_matrix", "intrinsics", "K", "cam_K", "camera_matrix", "factor_depth", "depth_scale")
"""Variables of a MATLAB file that are read; others may be large."""
_SIZES = (
    ("width", "w", "image_width", "imagewidth", "img_width", "res_x", "cols"),
    ("height", "h", "image_height", "imageheight", "img_height", "res_y", "rows"),
)
_UNITS = (
    "factor_depth",
    "depth_scale",
    "depthscale",
    "depth_factor",
    "depthmapfactor",
    "depth_map_factor",
    "png_depth_scale",
    "depth_units",
    "depth_unit",
    "units_per_metre",
    "scale",
)
"""Names of the depth's unit, written either way; "scale" speaks of it beside a camera's other numbers."""

_WORDS = {"mm": 1000.0, "millimetre": 1000.0, "millimeter": 1000.0, "millimetres": 1000.0, "millimeters": 1000.0}
"""Names of a unit of depth, by how many make a metre."""


@dataclass(frozen=True)
class Stated:
    """Camera facts from files; None where missing."""

    K: np.ndarray | None = None  # (3, 3) float64 or None
    size: tuple[int, int] | None = None  # (width, height) or None: Of the pictures that K is for, pixels
    units_per_metre: float | None = None
    path: Blob | None = None  # The file that says it
    named: bool = False  # Whether K was read by the names of its numbers

    def scaled(self, size: tuple[int, int], other: tuple[int, int]) -> np.ndarray | None:
        """Intrinsics K for a picture of `size` (width, height), with colour of size `other` before resizing. A file
        that names no size is taken to speak of whichever of both has its middle at the principal point."""
        if self.K is None:
            return None
        known = self.size
        if known is None:
            cx, cy = self.K[:2, 2]
            middle = {s: max(abs(cx / s[0] - 0.5), abs(cy / s[1] - 0.5)) for s in (size, other)}
            fit = [s for s, off in middle.items() if off < CENTRED]
            # Where neither has it, the camera's own check tells.
            known = fit[0] if fit else size
        sx, sy = size[0] / known[0], size[1] / known[1]
        require(
            abs(sx / sy - 1) < 0.02,
            "the camera file is for another image size",
            got=f"{known[0]}x{known[1]}",
            expected=f"{size[0]}x{size[1]} as the images",
            path=self.path,
        )
        if sx == sy == 1:
            return self.K
        # Pixels count from their centres, so that a picture's corner is at -0.5.
        K = self.K.copy()
        K[:2, 2] += 0.5
        K[0] *= sx
        K[1] *= sy
        K[:2, 2] -= 0.5
        return K


NOTHING = Stated()


def is_small(path: Path) -> bool:
    """Test whether a file is no larger than a camera file may be."""
    return path.is_file() and path.stat().st_size <= LARGEST_BYTES


def read_stated(path: Blob) -> Stated:
    """Read the camera facts of a file; InputError where it is of several cameras that differ."""
    table = dict(named_numbers(path))
    cameras = {where: K for where in _places(table) if (K := stated_in(_inside(table, where)).K) is not None}
    several = [where for where, K in cameras.items() if not np.allclose(K, next(iter(cameras.values())), atol=0.5)]
    require(
        not several,
        "a file of several cameras",
        got=lambda: ", ".join(where or "the file itself" for where in cameras)[:120],
        expected="--intrinsics fx,fy,cx,cy of the one that depth is stored for",
        path=path,
    )
    return stated_in(table, path)


def _places(table: Mapping[str, np.ndarray]) -> list[str]:
    """Places of numbers in a table: names without their last part, and without the "data" of a matrix."""
    return list(dict.fromkeys(name.removesuffix(".data").rpartition(".")[0] for name in table))


def _inside(table: Mapping[str, np.ndarray], where: str) -> dict[str, np.ndarray]:
    start = f"{where}." if where else ""
    own = {name.removeprefix(start): numbers for name, numbers in table.items() if name.startswith(start)}
    return {name: numbers for name, numbers in own.items() if "." not in name.removesuffix(".data")}


def stated_in(table: Mapping[str, np.ndarray], path: Blob | None = None) -> Stated:
    """Camera facts in a flat table of numbers by dotted name."""
    last = {}
    for name, numbers in table.items():
        parts = name.lower().split(".")
        # "camera_matrix.data" is the matrix, "camera_matrix.rows" is no picture's height.
        key = parts[-2] if parts[-1] == "data" and len(parts) > 1 else parts[-1]
        if not (key in ("rows", "cols") and len(parts) > 1):
            last.setdefault(key, numbers)
    four = [_first(last, names) for names in _NUMBERS]
    width, height = (_first(last, names) for names in _SIZES)
    size = _size(width, height)
    numbers = [f for f in four if f is not None]
    K = intrinsics(*numbers) if len(numbers) == 4 else None
    for key, found in last.items():
        if K is None and _MATRICES.fullmatch(key):
            K = _matrix(found)
    if K is None and "" in table:
        # A file of bare numbers: a matrix, fx fy cx cy, or with the picture's size before them.
        bare = table[""]
        K = _matrix(bare[2:] if bare.size == 6 else bare)
        if K is not None and bare.size == 6:
            size = _size(float(bare[0]), float(bare[1]))
    names = _UNITS if K is not None else _UNITS[:-1]
    units = next((unit for name in names if (unit := _units(_first(last, (name,)))) is not None), None)
    return Stated(K, size, units, path, K is not None and "" not in table)


def stated_in_files(paths: Iterable[Path], known: bool = False) -> Stated:
    """First value of each camera fact over several files; files without any are skipped."""
    found: list[Stated] = []
    units: float | None = None
    for path in paths:
        stated = or_note([], "", read_stated, path) or NOTHING
        if stated.K is None and stated.units_per_metre is None:
            safe_files.without_use(path)
        units = units or stated.units_per_metre
        found += [stated] if stated.K is not None else []
    if not found:
        return Stated(units_per_metre=units)
    for other in () if known else found[1:]:
        matrices = [np.asarray(stated.K) for stated in (other, found[0])]
        same = other.size != found[0].size or np.allclose(*matrices, atol=0.01)
        require(
            same,
            "two camera files disagree",
            got=f"{PurePath(found[0].path or '').name} and {PurePath(other.path or '').name}",
            expected="--intrinsics fx,fy,cx,cy",
            path=other.path,
        )
    return Stated(found[0].K, found[0].size, units, found[0].path)


def _units(value: float | None) -> float | None:
    """Units per metre of a depth scale, written either way; None where ambiguous."""
    if value is None or not np.isfinite(value):
        return None
    return value if value >= 100 else 1 / value if 0 < value <= 0.01 else None


def _size(width: float | None, height: float | None) -> tuple[int, int] | None:
    """A picture's size in whole pixels; None where the numbers are none."""
    if width is None or height is None or not (0.5 < width < 1e6 and 0.5 < height < 1e6):
        return None
    return round(width), round(height)


def _first(table: Mapping[str, np.ndarray], names: Iterable[str]) -> float | None:
    found = (table[name] for name in names if name in table)
    return next((float(numbers[0]) for numbers in found if numbers.size == 1), None)


def _matrix(numbers: np.ndarray) -> np.ndarray | None:
    """Intrinsics (3, 3) of 4, 9, 12 or 16 numbers, row- or column-major; else None."""
    if numbers.size == 4:
        fx, fy, cx, cy = numbers.tolist()
        # A negative fy, as ICL-NUIM's, is a camera's, which is told where it is used.
        return intrinsics(fx, fy, cx, cy) if min(fx, abs(fy)) > 1 else None
    if numbers.size not in (9, 12, 16):
        return None
    M = numbers.reshape({9: (3, 3), 12: (3, 4), 16: (4, 4)}[numbers.size])[:3, :3]
    # The principal point is never 0, so that the last row tells how the matrix was written.
    for K in (M, M.T):
        if np.isfinite(K).all() and K[2].tolist() == [0, 0, 1] and min(K[0, 0], K[1, 1]) > 1 and K[1, 0] == 0:
            return K.astype(np.float64)
    return None


def named_numbers(path: Blob) -> Iterator[tuple[str, np.ndarray]]:
    """Numbers and lists of at most 16 of a camera file, by dotted name; InputError where it cannot be read."""
    suffix = PurePath(path.name).suffix.lower()
    if suffix == ".mat":
        tables = read_mat(path, *_MAT_NAMES)
        for name, value in tables.items():
            if isinstance(value, np.ndarray) and value.dtype.kind in "uif":
                yield name, value.astype(np.float64).ravel()
        return
    data = read_bytes(path)
    require(len(data) <= LARGEST_BYTES, "too large for a camera file", got=f"{len(data)} bytes", path=path)
    if suffix in (".npy", ".npz"):
        # Damaged archives raise a dozen kinds of error.
        with as_input_error("an array that cannot be read", Exception, got=shortened, path=path):
            loaded: Any = safe_files.load_arrays(data, path)
            arrays = {"": loaded} if isinstance(loaded, np.ndarray) else dict(loaded)
        yield from ((k, v.astype(np.float64).ravel()) for k, v in arrays.items() if v.dtype.kind in "uif")
        return
    with as_input_error("malformed", ValueError, got=lambda error: str(error)[:80], path=path):
        text = data.decode("utf-8-sig")
        yield from flat_numbers(safe_files.parse_json(text, path)) if suffix == ".json" else _text_numbers(text)


def flat_numbers(value: Any, name: str = "") -> Iterator[tuple[str, np.ndarray]]:
    """Numbers and lists of numbers in a JSON value, by dotted name."""
    if isinstance(value, Mapping):
        for key, inside in value.items():
            yield from flat_numbers(inside, f"{name}.{key}" if name else str(key))
    elif isinstance(value, str):
        if name.rpartition(".")[2].lower() in _UNITS[:-1] and value.strip().lower() in _WORDS:
            yield name, np.array([_WORDS[value.strip().lower()]])
    elif not isinstance(value, bool | None):
        try:
            numbers = np.asarray(value, dtype=np.float64).ravel()
        except (TypeError, ValueError, OverflowError):
            # A list of objects, such as one a frame.
            return
        if 0 < numbers.size <= 16:
            yield name, numbers


_NUMBER = r"[-+]?(?:[0-9]+(?:\.[0-9]*)?|\.[0-9]+)(?:[eE][-+]?[0-9]+)?"
_LINE = re.compile(
    rf"^[ \t-]*[\"']?(?P<name>[A-Za-z][\w.]*)[\"']?[ \t]*[:=][ \t]*(?:!!\S+[ \t]*)?"
    rf"(?P<value>\[[^\]A-Za-df-z]{{0,2000}}\]|{_NUMBER}(?=\s|,|$))?",
    re.MULTILINE,
)
"""A line `name: number`, `name = [numbers, ...]`, or `name:` above indented ones: YAML, TOML, INI and OpenCV's own."""


def _text_numbers(text: str) -> Iterator[tuple[str, np.ndarray]]:
    words = " ".join(line.split("#")[0] for line in text.splitlines()).replace(",", " ").split()
    if words and all(re.fullmatch(_NUMBER, word) for word in words):
        yield "", np.array(words, np.float64)
        return
    above = ""
    for match in _LINE.finditer(text):
        if match["value"] is None:
            above = above if match[0][:1] in " \t-" else match["name"]
            continue
        numbers = np.array(re.findall(_NUMBER, match["value"]), np.float64)
        if 0 < numbers.size <= 16:
            yield f"{above}.{match['name']}" if match[0][:1] in " \t" and above else match["name"], numbers


Value = TypeVar("Value")
ROUNDING = 1e-2
"""How far from a rotation a printed rotation matrix may be through rounding alone."""


FARTHEST_M = 1e9
"""Of a camera; coordinates of maps have up to 1e7 metres."""


def nearest_rotation(R: np.ndarray) -> np.ndarray:
    """Nearest rotations to rounded matrices, by SVD (orthogonal Procrustes). `R` (..., 3, 3) float."""
    R = np.asarray(R, dtype=np.float64)
    require(np.isfinite(R).all(), "a rotation with inf or NaN")
    deviation, least = float(np.abs(R @ R.swapaxes(-1, -2) - np.eye(3)).max()), float(np.linalg.det(R).min())
    require(
        deviation < ROUNDING and least >= 0,
        "not a rotation",
        got=lambda: f"det {least:.3g}, {deviation:.2g} from orthonormal",
        cause="is the matrix scaled or left-handed?",
    )
    U, _, Vt = np.linalg.svd(R)
    return U @ Vt


def rigid(R: np.ndarray, t: np.ndarray) -> np.ndarray:
    """The (..., 4, 4) float64 transforms of (rounded) rotations (..., 3, 3) and translations (..., 3), metres."""
    t = np.asarray(t, dtype=np.float64)
    require(np.isfinite(t).all(), "a position with inf or NaN")
    require(np.abs(t).max() < FARTHEST_M, "a position far from any place on Earth", got=t.tolist())
    T = np.zeros((*t.shape[:-1], 4, 4))
    T[..., :3, :3] = nearest_rotation(R)
    T[..., :3, 3] = t
    T[..., 3, 3] = 1
    return T


def inverse(T: np.ndarray) -> np.ndarray:
    """The inverse of a rigid (4, 4) transform."""
    out = np.eye(4)
    out[:3, :3] = T[:3, :3].T
    out[:3, 3] = -T[:3, :3].T @ T[:3, 3]
    return out


def pose_from_matrix(T: np.ndarray) -> np.ndarray:
    """A checked (4, 4) T_world_camera from a 4x4 matrix as printed in a file."""
    require(np.isfinite(T).all(), "inf or NaN, the tracker was lost")
    require(np.abs(T[3] - (0, 0, 0, 1)).max() <= 1e-6, "the last row is not 0 0 0 1", got=T[3].tolist())
    return rigid(T[:3, :3], T[:3, 3])


def pose_from_quaternion(values: np.ndarray) -> np.ndarray:
    """T_world_camera (4, 4) from tx ty tz qx qy qz qw (7,), metres. The quaternion may be rounded."""
    require(np.isfinite(values).all(), "inf or NaN, the tracker was lost")
    length = float(np.linalg.norm(values[3:]))
    require(abs(length - 1) <= ROUNDING, "the quaternion does not have length 1", got=f"{length:.3g}")
    return rigid(rotations(values[3:] / length), values[:3])


def one_file(candidates: list[Path], what: str, where: Path) -> Path:
    """Single file among several candidates."""
    require(candidates, f"the {what} file is missing", path=where)
    require(
        len(candidates) <= 1, f"more than one {what} file", got=", ".join(path.name for path in candidates), path=where
    )
    return candidates[0]


def or_note(notes: list[str], what: str, read: Callable[..., Value], *given: Any) -> Value | None:
    """Call `read` on the arguments; where unusable, None and a note beginning with `what`."""
    try:
        return read(*given)
    except InputError as error:
        notes.append(f"{what}{error.what}")
        return None


class ShiftedPoses(ChangedFrames):
    """A dataset with the poses of frames `shift` places later in the scene; see `Settings.pose_shift`."""

    def __init__(self, inner: Dataset, shift: int) -> None:
        super().__init__(inner)
        self.shift = shift
        scenes: dict[str, list[str]] = {}
        for frame_id in inner.frame_ids:
            scenes.setdefault(scene_of(inner, frame_id), []).append(frame_id)
        self._others = {
            frame_id: ids[k + shift] if 0 <= k + shift < len(ids) else None
            for ids in scenes.values()
            for k, frame_id in enumerate(ids)
        }

    def load_pose(self, frame_id: str) -> np.ndarray | None:
        """See `base.load_pose`."""
        other = self._others[frame_id]
        return None if other is None else load_pose(self.inner, other)

    def changed(self, frame: Frame) -> Frame:
        """Frame with the pose of the shifted frame, and the declared up of this pose."""
        own, other = frame.camera, self._others[frame.id]
        notes, pose, up, source = frame.notes, None, None, None
        if other is None:
            notes = (*notes, f"no camera pose: there is no frame {self.shift:+d} places on, where it would be")
        else:
            that = load_picture(self.inner, other).camera
            pose, up, source = that.T_world_camera, that.up, that.up_source
        if "declared" not in (own.up_source, source):
            up, source = own.up, own.up_source
        return replace(frame, camera=replace(own, T_world_camera=pose, up=up, up_source=source), notes=notes)
