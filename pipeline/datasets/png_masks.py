"""Masks of PNG files in the form that most are written in, unpacked no further than to their pixels."""

from __future__ import annotations

import struct
import zlib

import numpy as np

from pipeline.geometry.masks import MaskCrop

_HEADER = struct.Struct(">I4s2I5B")
_SIGNATURE_BYTES, _CHUNK_BYTES = 8, 12
_NONE, _SUB = 0, 1
"""Filters of rows (PNG 1.2, section 6): the bytes themselves, or the difference to the byte on the left."""


def mask_of_png(data: bytes) -> tuple[tuple[int, int], MaskCrop] | None:
    """Size (height, width) of a mask and its pixels above 0, from a PNG whose chunks are whole.

    Grey of 1 or 8 bits, not interlaced, of rows filtered by `none` or `sub` alone, with no chunk but the three that
    every PNG has: None for any other, and for what does not inflate to just its rows. A decoder of all PNGs says then
    what it is.
    """
    length, kind, width, height, depth, color, packing, filtering, interlaced = _HEADER.unpack_from(
        data.ljust(_SIGNATURE_BYTES + _HEADER.size), _SIGNATURE_BYTES
    )
    if (length, kind, color, packing, filtering, interlaced) != (13, b"IHDR", 0, 0, 0, 0) or depth not in (1, 8):
        return None
    parts, at = [], _SIGNATURE_BYTES + _CHUNK_BYTES + length
    while (kind := data[at + 4 : at + 8]) == b"IDAT":
        end = at + _CHUNK_BYTES + int.from_bytes(data[at : at + 4], "big")
        parts.append(data[at + 8 : end - 4])
        at = end
    stride = 1 + -(-width * depth // 8)
    if kind != b"IEND" or not width * height:
        return None
    stream = zlib.decompressobj()
    try:
        # One byte more than there may be: the stream's own checksum is looked at behind its last byte.
        raw = stream.decompress(b"".join(parts), height * stride + 1)
    except zlib.error:
        return None
    if len(raw) != height * stride or not stream.eof or stream.unused_data:
        return None
    rows = np.frombuffer(raw, np.uint8).reshape(height, stride)
    filters, packed = rows[:, 0], rows[:, 1:]
    if filters.max() > _SUB:
        return None
    # A row of zeros is one of no pixels by either filter.
    filled = np.flatnonzero(packed.max(axis=1))
    if not len(filled):
        return (height, width), MaskCrop(0, 0, np.zeros((0, 0), np.bool_))
    top, bottom = int(filled[0]), int(filled[-1]) + 1
    packed, filters = packed[top:bottom], filters[top:bottom]
    if filters.any():
        summed = np.add.accumulate(packed, axis=1, dtype=np.uint8)
        packed = np.where(filters[:, None] == _SUB, summed, packed)
    filled = np.flatnonzero(packed.max(axis=0))
    left, right = int(filled[0]), int(filled[-1]) + 1
    packed = packed[:, left:right]
    if depth == 8:
        return (height, width), MaskCrop(left, top, packed > 0)
    pixels = np.unpackbits(packed, axis=1)[:, : width - 8 * left].view(np.bool_)
    found = MaskCrop.of(pixels)
    return (height, width), MaskCrop(8 * left + found.x, top + found.y, found.mask)
