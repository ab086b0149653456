"""Pixels of a picture by its first bytes: nothing is decoded."""

from __future__ import annotations

import io
import math
import re
import struct
from importlib import import_module
from typing import Any

import numpy as np

_PLUGINS = {
    b"\x89PNG": "Png",
    b"\xff\xd8": "Jpeg",
    b"RIFF": "WebP",
    b"BM": "Bmp",
    **{b"P%d" % kind: "Ppm" for kind in range(1, 7)},
}
"""Pillow's readers by the first bytes."""
_TIFF_SIZE = {256: 0, 257: 1}
"""Tags ImageWidth and ImageLength (TIFF 6.0, section 3)."""


def header_size(data: bytes) -> tuple[int, int] | None:
    """(width, height) of an encoded picture: PNG, JPEG, WebP, BMP, PNM, TIFF, OpenEXR; None without a sound header."""
    try:
        if data[:4] in (b"II*\0", b"MM\0*"):
            return _tiff(data)
        if data[:4] == b"\x76\x2f\x31\x01":
            return _exr(data)
        if data[:2] == b"\xff\xd8" and (size := _jpeg(data)) is not None:
            return size
        name = next(name for magic, name in _PLUGINS.items() if data.startswith(magic))
        # By its class itself: `Image.open` has a limit of its own.
        module = import_module(f"PIL.{name}ImagePlugin")
        return getattr(module, f"{name}ImageFile")(io.BytesIO(data)).size
    except Exception:  # No such format, or cut off or damaged within the header, with errors of each reader.
        return None


def _jpeg(data: bytes) -> tuple[int, int] | None:
    """Size of a common JPEG, of 8 bits in one or three channels (ITU T.81, annex B); None of others: Pillow, 10 ms to
    load, reads them."""
    at = 2
    while data[at] == 0xFF and 0xC0 <= data[at + 1] < 0xFF and not 0xD0 <= data[at + 1] <= 0xDA:
        length, bits, height, width, channels = struct.unpack_from(">HBHHB", data, at + 2)
        if data[at + 1] in (0xC0, 0xC1, 0xC2):
            return (width, height) if bits == 8 and channels in (1, 3) and width and height else None
        at += 2 + length
    return None


def _tiff(data: bytes) -> tuple[int, int]:
    """Size of the first picture, as decoded; Pillow refuses floats in several channels."""
    order = "<" if data[:2] == b"II" else ">"
    (at,) = struct.unpack(f"{order}I", data[4:8])
    (count,) = struct.unpack_from(f"{order}H", data, at)
    size = [0, 0]
    for k in range(count):
        tag, kind = struct.unpack_from(f"{order}HH", data, at + 2 + 12 * k)
        if tag in _TIFF_SIZE:
            (size[_TIFF_SIZE[tag]],) = struct.unpack_from(order + ("H" if kind == 3 else "I"), data, at + 10 + 12 * k)
    return size[0], size[1]


def _exr(data: bytes) -> tuple[int, int] | None:
    """Largest data window of the header, or of several headers, as decoded (OpenEXR file layout)."""
    found = re.finditer(rb"dataWindow\0box2i\0....", data[: 1 << 20], re.DOTALL)
    windows = [struct.unpack_from("<4i", data, window.end()) for window in found]
    sizes = [(x1 - x0 + 1, y1 - y0 + 1) for x0, y0, x1, y1 in windows]
    return max(sizes, key=lambda size: size[0] * size[1], default=None)


def array_header(file: Any) -> tuple[tuple[int, ...], int]:
    """Shape of an NPY from this place of a file, and its bytes; ValueError for anything else."""
    # Version 3.0 differs from 2.0 in the encoding of field names alone.
    first = np.lib.format.read_magic(file) == (1, 0)
    read = np.lib.format.read_array_header_1_0 if first else np.lib.format.read_array_header_2_0
    shape, _, dtype = read(file)
    return shape, math.prod(shape) * dtype.itemsize
