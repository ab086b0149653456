"""COLMAP's binary models, `cameras.bin` and `images.bin`, as the words of its text models.

https://colmap.github.io/format.html, `scripts/python/read_write_model.py` of COLMAP.
"""

from __future__ import annotations

import struct
from pathlib import Path

from pipeline.datasets.files import CUT_OFF, read_bytes
from pipeline.system.errors import as_input_error, require

MODELS = (
    ("SIMPLE_PINHOLE", 3),
    ("PINHOLE", 4),
    ("SIMPLE_RADIAL", 4),
    ("RADIAL", 5),
    ("OPENCV", 8),
    ("OPENCV_FISHEYE", 8),
    ("FULL_OPENCV", 12),
    ("FOV", 5),
    ("SIMPLE_RADIAL_FISHEYE", 4),
    ("RADIAL_FISHEYE", 5),
    ("THIN_PRISM_FISHEYE", 12),
    ("RAD_TAN_THIN_PRISM_FISHEYE", 16),
)
"""Camera models by number, each with how many numbers it has."""
POINT = 24
"""Bytes of a point of a picture: two doubles and a 64-bit number."""
LONGEST_NAME = 4096


def read_cameras(path: Path) -> dict[str, list[str]]:
    """The words of each camera of `cameras.bin` by number: model, width, height, and the model's numbers."""
    data, found = read_bytes(path), {}
    with as_input_error("a COLMAP model that cannot be read", struct.error, got=str, cause=CUT_OFF, path=path):
        (count,), at = struct.unpack_from("<Q", data), 8
        for _ in range(count):
            number, model, width, height = struct.unpack_from("<iiQQ", data, at)
            require(0 <= model < len(MODELS), "an unknown camera model", got=model, path=path)
            name, size = MODELS[model]
            values = struct.unpack_from(f"<{size}d", data, at + 24)
            at += 24 + 8 * size
            found[str(number)] = [name, str(width), str(height), *map(repr, values)]
    return found


def read_images(path: Path) -> list[list[str]]:
    """The words of each picture of `images.bin`: number, qw qx qy qz, tx ty tz, camera, name."""
    data, found = read_bytes(path), []
    with as_input_error("a COLMAP model that cannot be read", struct.error, got=str, cause=CUT_OFF, path=path):
        (count,), at = struct.unpack_from("<Q", data), 8
        for _ in range(count):
            number, *pose, camera = struct.unpack_from("<i7di", data, at)
            end = data.find(b"\0", at + 64, at + 64 + LONGEST_NAME)
            require(end >= 0, "a picture whose name does not end", cause=CUT_OFF, path=path)
            name = data[at + 64 : end].decode(errors="replace")
            (points,) = struct.unpack_from("<Q", data, end + 1)
            at = end + 9 + POINT * points
            require(
                at <= len(data), "a COLMAP model that is cut off", got=f"{len(data)} bytes", cause=CUT_OFF, path=path
            )
            found.append([str(number), *map(repr, pose), str(camera), name])
    return found
