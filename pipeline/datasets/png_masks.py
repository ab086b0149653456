"""Masks of PNG files, decoded no further than the rows that hold pixels."""

from __future__ import annotations

import struct
import zlib

import cv2
import numpy as np

from pipeline.geometry.masks import MaskCrop, PictureMask

_SIGNATURE, _HEADER = b"\x89PNG\r\n\x1a\n", struct.Struct(">2I5B")
_CHANNELS = {0: 1, 2: 3, 4: 2, 6: 4}
"""Channels by the type of colour, but for palettes, whose number 0 may be any colour (PNG 1.2, section 4)."""
_SUB = 1
"""The last filter of rows that reads its own row alone."""


def mask_of_png(data: bytes) -> PictureMask | None:
    """Mask of the pixels above 0 in any channel but alpha, from a PNG of whole chunks.

    None for a palette, an interlaced picture, one with chunks that are not in every PNG, and for what does not inflate
    to just its rows: a decoder of whole files says then what it is.
    """
    if data[8:16] != b"\0\0\0\rIHDR" or len(data) < 45:
        return None
    width, height, depth, color, *methods = _HEADER.unpack_from(data, 16)
    parts, at = [], 33
    while (kind := data[at + 4 : at + 8]) == b"IDAT":
        end = at + 12 + int.from_bytes(data[at : at + 4], "big")
        parts.append(data[at + 8 : end - 4])
        at = end
    if kind != b"IEND" or color not in _CHANNELS or any(methods) or not width * height:
        return None
    stride = 1 + -(-width * depth * _CHANNELS[color] // 8)
    stream = zlib.decompressobj()
    try:
        # One byte more than there may be: the stream's checksum is read behind its last byte.
        raw = stream.decompress(b"".join(parts), height * stride + 1)
    except zlib.error:
        return None
    if len(raw) != height * stride or not stream.eof or stream.unused_data:
        return None
    rows = np.frombuffer(raw, np.uint8).reshape(height, stride)
    filters = rows[:, 0]
    filtered = filters.any()
    if filtered:
        rows = rows.copy()
        filters, rows[:, 0] = filters.copy(), 0
    # Eight bytes are looked at together: without the filters, few are not 0.
    whole = rows.reshape(-1)
    words = whole[: len(whole) & ~7].view(np.uint64)
    told = 8 * np.flatnonzero(words)
    if whole[8 * len(words) :].any():
        told = np.append(told, 8 * len(words))
    if not len(told):
        return PictureMask((height, width), MaskCrop.tight(0, 0, np.zeros((0, 0), np.bool_)))
    # Above the first byte that is not 0 every filter gives zeros, and below the last from a row on that reads no other.
    top, bottom = int(told[0]) // stride, min((int(told[-1]) + 7) // stride + 1, height)
    if color == 0 and depth in (1, 8) and (not filtered or filters.max() <= _SUB):
        crop = _own_rows(filters[top:bottom], rows[top:bottom, 1:], width, depth)
    else:
        alone = filters[bottom:] <= _SUB
        bottom += int(alone.argmax()) if alone.any() else len(alone)
        header = _HEADER.pack(width, bottom - top, depth, color, *methods)
        body = zlib.compress(raw[top * stride : bottom * stride], 0)
        small = _SIGNATURE + _chunk(b"IHDR", header) + _chunk(b"IDAT", body) + _chunk(b"IEND", b"")
        pixels = cv2.imdecode(np.frombuffer(small, np.uint8), cv2.IMREAD_UNCHANGED)
        if pixels is None:
            return None
        crop = MaskCrop.of(above_zero(pixels))
    return PictureMask((height, width), MaskCrop.tight(crop.x, top + crop.y, crop.mask))


def above_zero(pixels: np.ndarray) -> np.ndarray:
    """Pixels of a decoded picture above 0 in any channel but alpha, (H, W) bool."""
    return np.any(pixels[..., :3] > 0, axis=2) if pixels.ndim == 3 else pixels > 0


def _own_rows(filters: np.ndarray, packed: np.ndarray, width: int, depth: int) -> MaskCrop:
    """Mask of rows of grey, (H, bytes) uint8, whose filters, (H,), are `none` or `sub`."""
    if filters.any():
        packed = np.where(filters[:, None] == _SUB, np.add.accumulate(packed, axis=1, dtype=np.uint8), packed)
    filled = np.flatnonzero(packed.max(axis=0))
    left, right = int(filled[0]), int(filled[-1]) + 1
    packed = packed[:, left:right]
    pixels = packed > 0
    if depth == 1:
        left *= 8
        pixels = np.unpackbits(packed, axis=1)[:, : width - left].view(np.bool_)
    crop = MaskCrop.of(pixels)
    return MaskCrop.tight(left + crop.x, crop.y, crop.mask)


def _chunk(kind: bytes, content: bytes) -> bytes:
    return struct.pack(">I", len(content)) + kind + content + struct.pack(">I", zlib.crc32(content, zlib.crc32(kind)))
