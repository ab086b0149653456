"""Files of a single scan of the Active Vision Dataset, checked, in metres.

https://www.cs.unc.edu/~ammirato/active_vision_dataset_website
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from pipeline.datasets.cameras import inverse, rigid
from pipeline.datasets.files import as_floats, numbered_lines, read_json, read_mat
from pipeline.geometry.camera import intrinsics
from pipeline.geometry.frame import Annotation
from pipeline.system.errors import require

DEFAULT_SIZE = (1920, 1080)
"""Width and height of the dataset's own images: the pixels that its boxes speak of where no camera file says more."""
RGB, REGISTERED_DEPTH = "01", "03"
"""How the names of the colour image and of the depth image registered to it end."""
SMALLEST_SIDE = 1.0
"""A box that is thinner than this inside the image, in pixels, shows nothing."""
LEVEL = 0.5
"""How clearly the cameras must agree on which way is up, -1..1. A level camera agrees by 1."""


@dataclass(frozen=True)
class AvdCamera:
    """Camera of a `cameras.txt`."""

    K: np.ndarray  # (3, 3) float64: Pixels of an image of this size
    width: int
    height: int
    fisheye: tuple[float, ...]  # OpenCV's four fisheye coefficients. They are never read as Brown's k1 k2 p1 p2
    others: int = 0  # How many more cameras the file lists

    def resized(self, width: int, height: int) -> np.ndarray:
        """Intrinsics K (3, 3) for another image size; pixel centres are integers."""
        x, y = width / self.width, height / self.height
        K = self.K
        return intrinsics(K[0, 0] * x, K[1, 1] * y, (K[0, 2] + 0.5) * x - 0.5, (K[1, 2] + 0.5) * y - 0.5)


@dataclass(frozen=True)
class AvdPoses:
    """Poses of an `image_structs.mat`."""

    registered: Mapping[str, tuple[np.ndarray, np.ndarray]]
    """mapping of str to (R, t): World-to-camera (3, 3) and (3,) by image name without its ending, in the
    reconstruction's own unit."""
    metres: float  # Metres in one such unit
    up: np.ndarray | None  # (3,) float64 or None: Against gravity in the world; None where the cameras do not tell

    def pose(self, stem: str) -> np.ndarray:
        """T_world_camera (4, 4), metres: the camera's centre is -R^T t times the scale."""
        require(stem in self.registered, "the image is not registered")
        R, t = self.registered[stem]
        return inverse(rigid(R, t * self.metres))


def image_stem(name: Any) -> str | None:
    """The 15 digits of the name of a colour image such as "000110000010101.jpg"; None for any other name."""
    match = re.fullmatch(r"([0-9]{13}" + RGB + r")\.(?:jpe?g|png)", name, re.ASCII) if isinstance(name, str) else None
    return match[1] if match else None


def read_camera(path: Path) -> AvdCamera:
    """The first camera of a `cameras.txt`: id, model, width, height, fx fy cx cy, d1 d2 d3 d4."""
    lines = numbered_lines(path)
    require(lines, "no camera is listed", path=path)
    number, line = lines[0]
    words = line.split()
    require(
        len(words) in (8, 12),
        f"line {number}: a wrong count",
        got=f"{len(words)} words",
        expected="id model width height fx fy cx cy d1 d2 d3 d4",
        path=path,
    )
    values = as_floats(words[2:], len(words) - 2, path, f"line {number}")
    width, height, fx, fy, cx, cy = values[:6].tolist()
    whole = np.isfinite(values).all() and width == int(width) and height == int(height)
    require(
        whole and min(width, height, fx, fy) > 0,
        f"line {number}: no camera has these numbers",
        got=line[:100],
        path=path,
    )
    return AvdCamera(intrinsics(fx, fy, cx, cy), int(width), int(height), tuple(values[6:].tolist()), len(lines) - 1)


def read_names(path: Path) -> dict[int, str]:
    """The instances of an `instance_id_map.txt` by number: `name id` a line."""
    names: dict[int, str] = {}
    for number, line in numbered_lines(path):
        words = line.rsplit(maxsplit=1)
        require(
            len(words) == 2 and re.fullmatch(r"[0-9]{1,9}", words[1], re.ASCII),
            f"line {number} must be a name and a number",
            got=repr(line[:60]),
            path=path,
        )
        require(int(words[1]) not in names, f"line {number}: an instance is listed twice", got=words[1], path=path)
        names[int(words[1])] = words[0]
    return names


def read_annotations(path: Path) -> dict[str, Mapping[str, Any]]:
    """Entries of an `annotations.json` by image name without ending. Keys that are no names of colour images are left
    out, and so never become part of a path."""
    table: dict[str, Mapping[str, Any]] = {}
    for name, entry in read_json(path).items():
        stem = image_stem(name)
        if stem is not None:
            table[stem] = entry if isinstance(entry, Mapping) else {}
    return table


def instances_of(entry: Mapping[str, Any]) -> set[int]:
    """Instances annotated in an image."""
    boxes = entry.get("bounding_boxes")
    rows = boxes if isinstance(boxes, list) else []
    return {row[4] for row in rows if _is_box(row)}


def label_of(instance: int, names: Mapping[int, str]) -> str:
    """Name of an instance, else "instance_NUMBER"."""
    return names.get(instance) or f"instance_{instance}"


def read_boxes(
    entry: Mapping[str, Any],
    names: Mapping[int, str],
    annotated: tuple[int, int],
    size: tuple[int, int],
    notes: list[str],
) -> tuple[Annotation, ...]:
    """Annotated instances of an image, in pixels of the image. `annotated, size` (width, height): Of the image that the
    boxes speak of, and of the one that is there."""
    rows = entry.get("bounding_boxes", [])
    if not isinstance(rows, list):
        notes.append("no annotations, bounding_boxes is no list")
        return ()
    scale = np.array([size[0] / annotated[0], size[1] / annotated[1]] * 2)
    limits = np.array([size[0], size[1]] * 2, np.float64)
    found: list[Annotation] = []
    for index, row in enumerate(rows):
        if not _is_box(row):
            notes.append(f"annotation {index}: not xmin, ymin, xmax, ymax, instance, difficulty")
            continue
        instance = row[4]
        label = label_of(instance, names)
        bbox = np.array(row[:4], np.float64) * scale
        clipped = np.clip(bbox, 0, limits)
        if min(clipped[2] - clipped[0], clipped[3] - clipped[1]) < min(SMALLEST_SIDE, *scale[:2]):
            notes.append(f"annotation {index} ({label}): an empty box is left out, {row[:4]}")
            continue
        if (clipped != bbox).any():
            notes.append(f"annotation {index} ({label}): the box is clipped to the image, {row[:4]}")
        if names and instance not in names:
            notes.append(f"annotation {index}: instance {instance} has no name")
        difficulty = row[5] if len(row) == 6 else None
        found.append(Annotation(index, label, clipped, instance=instance, difficulty=difficulty))
    return tuple(found)


def read_poses(path: Path) -> AvdPoses:
    """Poses of a scan, and the up direction of the world.

    The height axis of that world is y; which of its ends is up differs from reconstruction to reconstruction. The
    robot's cameras are level within a few degrees, so that it is the end that agrees, over all images, with the
    opposite of the camera's own y: the mean of R[1, 1] has its sign.
    """
    table = read_mat(path, "image_structs", "scale")
    structs, scale = np.asarray(table.get("image_structs")), np.asarray(table.get("scale", ()))
    fields = set(structs.dtype.names or ())
    require({"image_name", "R", "t"} <= fields, "no image_structs with image_name, R and t", path=path)
    require(
        scale.size == 1 and scale.dtype.kind in "fiu" and 0 < scale.item() < np.inf,
        "scale must be one positive number",
        got=str(scale.ravel()[:3].tolist()),
        path=path,
    )
    registered: dict[str, tuple[np.ndarray, np.ndarray]] = {}
    for record in structs.ravel():
        stem = image_stem(_text(record["image_name"]))
        R, t = _floats(record["R"], 9), _floats(record["t"], 3)
        if stem is not None and R is not None and t is not None:
            registered[stem] = R.reshape(3, 3), t
    lean = float(np.mean([R[1, 1] for R, _ in registered.values()])) if registered else 0.0
    up = None if not abs(lean) >= LEVEL else np.array([0.0, -np.sign(lean), 0.0])
    return AvdPoses(registered, scale.item() / 1000, up)


def _floats(value: Any, count: int) -> np.ndarray | None:
    array = np.asarray(value)
    if array.size != count or array.dtype.kind not in "fiu" or not np.isfinite(array).all():
        return None
    return np.ascontiguousarray(array, np.float64).ravel()


def _text(value: Any) -> str:
    array = np.asarray(value)
    return str(array.ravel()[0]) if array.size == 1 and array.dtype.kind == "U" else ""


def _is_box(row: Any) -> bool:
    """Four numbers, an instance and perhaps a difficulty; JSON has true, NaN and endless numbers too."""
    if not isinstance(row, list) or len(row) not in (5, 6):
        return False
    kinds = all(type(v) in (int, float) for v in row[:4]) and all(type(v) is int for v in row[4:])
    return kinds and all(abs(v) < 1e9 for v in row)
