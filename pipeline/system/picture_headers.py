"""How many pixels a picture will have, by its first bytes: nothing is decoded."""

from __future__ import annotations

import re
import struct
from typing import Any

import numpy as np

_PNM = re.compile(rb"P[1-6](?:\s|#[^\n]*\n)+(\d{1,9})(?:\s|#[^\n]*\n)+(\d{1,9})")
_TIFF_SIZE = {256: 0, 257: 1}
"""Tags ImageWidth and ImageLength (TIFF 6.0, section 3)."""


def header_size(data: bytes) -> tuple[int, int] | None:
    """(width, height) that a decoder would make of an encoded picture; None where no header tells it.

    PNG, JPEG, TIFF, OpenEXR, WebP, BMP and PNM.
    """
    try:
        reader = next((read for magic, read in _READERS.items() if data.startswith(magic)), None)
        return None if reader is None else reader(data)
    except (struct.error, IndexError, ValueError):  # Cut off within the header.
        return None


def _png(data: bytes) -> tuple[int, int] | None:
    return struct.unpack(">II", data[16:24]) if data[12:16] == b"IHDR" else None


def _jpeg(data: bytes) -> tuple[int, int] | None:
    """The first start-of-frame segment (ITU T.81, B.2.2)."""
    at = 2
    while data[at] == 0xFF:
        marker = data[at + 1]
        if 0xC0 <= marker <= 0xCF and marker not in (0xC4, 0xC8, 0xCC):
            height, width = struct.unpack(">HH", data[at + 5 : at + 9])
            return width, height
        alone = marker in (0x01, 0xFF) or 0xD0 <= marker <= 0xD8
        at += (1 if marker == 0xFF else 2) if alone else 2 + int.from_bytes(data[at + 2 : at + 4], "big")
    return None


def _tiff(data: bytes) -> tuple[int, int] | None:
    """Of the first picture in the file, which is the one that is decoded."""
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
    """The largest data window of the header, or of several headers: what is decoded (OpenEXR file layout)."""
    found = re.finditer(rb"dataWindow\0box2i\0....", data[: 1 << 20], re.DOTALL)
    windows = [struct.unpack_from("<4i", data, window.end()) for window in found]
    sizes = [(x1 - x0 + 1, y1 - y0 + 1) for x0, y0, x1, y1 in windows]
    return max(sizes, key=lambda size: size[0] * size[1], default=None)


def _webp(data: bytes) -> tuple[int, int] | None:
    """RFC 9649, section 2: the canvas of an extended file, else the size of its lossy or lossless picture."""
    kind = data[12:16]
    if data[8:12] != b"WEBP":
        return None
    if kind == b"VP8X":
        return 1 + int.from_bytes(data[24:27], "little"), 1 + int.from_bytes(data[27:30], "little")
    if kind == b"VP8L":
        bits = int.from_bytes(data[21:25], "little")
        return 1 + (bits & 0x3FFF), 1 + (bits >> 14 & 0x3FFF)
    width, height = struct.unpack("<HH", data[26:30])
    return width & 0x3FFF, height & 0x3FFF


def _bmp(data: bytes) -> tuple[int, int] | None:
    width, height = struct.unpack("<ii", data[18:26])
    return abs(width), abs(height)


def _pnm(data: bytes) -> tuple[int, int] | None:
    found = _PNM.match(data)
    return None if found is None else (int(found[1]), int(found[2]))


def array_shape(file: Any) -> tuple[int, ...]:
    """The shape of an NPY that begins here; ValueError where it is none."""
    # Version 3.0 differs from 2.0 in the encoding of field names alone.
    first = np.lib.format.read_magic(file) == (1, 0)
    read = np.lib.format.read_array_header_1_0 if first else np.lib.format.read_array_header_2_0
    return read(file)[0]


_READERS = {
    b"\x89PNG\r\n\x1a\n": _png,
    b"\xff\xd8": _jpeg,
    b"II*\0": _tiff,
    b"MM\0*": _tiff,
    b"\x76\x2f\x31\x01": _exr,
    b"RIFF": _webp,
    b"BM": _bmp,
    **{b"P%d" % kind: _pnm for kind in range(1, 7)},
}
