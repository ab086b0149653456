"""Masks: bool crops in memory, COCO's run-length code in files, and the one codec between them.

A code is read without trust and decoded no further than to the mask's box.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from pydantic import ConfigDict

from pipeline.system.errors import InputError, require

_LONGEST = 7
"""Characters of a number at most: their 35 bits are more than any picture has pixels, and no sum of them overflows."""


@dataclass(frozen=True, slots=True)
class RunLength:
    """A mask in COCO's run-length code.

    Attributes
    ----------
    size : (int, int)
        Height and width, pixels.
    counts : str or tuple of int
        Compressed, or the lengths themselves.
    """

    __pydantic_config__ = ConfigDict(extra="forbid")

    size: tuple[int, int]
    counts: str | tuple[int, ...]

    @staticmethod
    def of(mask: np.ndarray) -> RunLength:
        """The compressed code of a mask ((H, W) bool)."""
        return RunLength((int(mask.shape[0]), int(mask.shape[1])), encode_run_length(np.ascontiguousarray(mask)))

    def crop(self, shape: tuple[int, int], where: str, path: Path | None = None) -> MaskCrop:
        """The mask; InputError where it is not of a picture of that shape, before memory for it is asked for."""
        require(self.size == shape, f"{where}: the mask has another size", got=self.size, expected=shape, path=path)
        return decode_crop(self.size, self.counts, where, path)

    def decoded(self, shape: tuple[int, int], where: str, path: Path | None = None) -> np.ndarray:
        """(H, W) bool; errors as of `crop`."""
        return self.crop(shape, where, path).of_picture(shape)


def run_lengths(code: str) -> np.ndarray | str:
    """(M,) int64 run lengths of a compressed code, or in words why it is none.

    They go column by column, from zeros to ones and back. Each number takes 5 bits a character from the lowest; from
    the fourth on it is the difference to the one two places before (`rleToString` of the COCO API).
    """
    raw = np.frombuffer(code.encode("utf-8", "surrogatepass"), np.uint8).astype(np.int64) - 48
    if not len(raw):
        return "it is empty"
    if raw.min() < 0 or raw.max() > 63:
        return "it has characters that no run-length code has"
    last = (raw & 32) == 0
    if not last[-1]:
        return "it breaks off within a number"
    ends = np.flatnonzero(last)
    starts = np.concatenate([[0], ends[:-1] + 1])
    length = ends - starts + 1
    if length.max() > _LONGEST:
        return "it has a number that is too long"
    digit = np.arange(len(raw)) - np.repeat(starts, length)
    value = np.add.reduceat((raw & 31) << (5 * digit), starts)
    value -= np.where(raw[ends] & 16, np.int64(1) << (5 * length), 0)
    value[1::2], value[2::2] = np.cumsum(value[1::2]), np.cumsum(value[2::2])
    if value.min() < 0:
        return "it has a run of negative length"
    return value


def decode_run_length(size: Sequence[int], counts: str | Sequence[int], where: str = "mask") -> np.ndarray:
    """(H, W) bool from COCO run-length encoding, compressed or not.

    Raises
    ------
    InputError
        The run lengths do not fill the mask, or are none.
    """
    return decode_crop(size, counts, where).of_picture(size)


def decode_crop(
    size: Sequence[int], counts: str | Sequence[int], where: str = "mask", path: Path | None = None
) -> MaskCrop:
    """The mask that `decode_run_length` gives, without the empty picture around it; a fraction of the work."""
    height, width = int(size[0]), int(size[1])
    pixels = height * width
    if isinstance(counts, str):
        runs = run_lengths(counts)
    elif min(counts, default=0) < 0 or max(counts, default=0) > pixels:
        runs = "one of them cannot be"
    else:
        runs = np.array(counts, np.int64)
    if isinstance(runs, str) or runs.sum() != pixels:
        raise InputError(
            f"{where}: the run lengths do not fill the mask",
            got=runs if isinstance(runs, str) else int(runs.sum()),
            expected=f"{pixels} pixels",
            path=path,
        )
    ends = np.cumsum(runs)[1::2]
    starts = ends - runs[1::2]
    starts, ends = starts[ends > starts], ends[ends > starts]
    if not len(starts):
        return MaskCrop(0, 0, np.zeros((0, 0), np.bool_))
    x0, x1 = int(starts[0]) // height, int(ends[-1] - 1) // height + 1
    edges = np.empty(2 * len(starts) + 1, np.int64)
    edges[:-1:2], edges[1::2], edges[-1] = starts, ends, x1 * height
    filled = np.zeros(len(edges), np.bool_)
    filled[1::2] = True
    columns = np.repeat(filled, np.diff(edges, prepend=x0 * height)).reshape(x1 - x0, height)
    rows = np.flatnonzero(columns.any(axis=0))
    y0, y1 = int(rows[0]), int(rows[-1]) + 1
    return MaskCrop(x0, y0, np.ascontiguousarray(columns[:, y0:y1].T))


def encode_run_length(mask: np.ndarray) -> str:
    """COCO's compressed run-length code of a mask ((H, W) bool)."""
    from pycocotools import mask as coco

    # The code runs down columns; OpenCV transposes several times faster than a strided copy.
    code: Any = coco.encode(cv2.transpose(mask.view(np.uint8)).T)
    return code["counts"].decode("ascii")


@dataclass(frozen=True)
class MaskCrop:
    """The part of a picture's mask that is not empty.

    Attributes
    ----------
    x, y : int
        Its upper left pixel in the picture.
    mask : (h, w) bool
    """

    x: int
    y: int
    mask: np.ndarray

    @property
    def box(self) -> tuple[int, int, int, int]:
        """x0, y0, x1, y1 of the mask, exclusive right and bottom edges; empty where the mask is."""
        x0, y0, x1, y1 = mask_box(self.mask)
        return self.x + x0, self.y + y0, self.x + x1, self.y + y1

    @property
    def area(self) -> int:
        """Pixels that are set."""
        return int(self.mask.sum())

    def of_picture(self, size: Sequence[int]) -> np.ndarray:
        """The mask of the whole picture, (H, W) bool."""
        picture = np.zeros((int(size[0]), int(size[1])), np.bool_)
        self.paint(picture)
        return picture

    def paint(self, picture: np.ndarray) -> None:
        """Set its pixels in an empty mask of the whole picture, (H, W) bool."""
        h, w = self.mask.shape
        picture[self.y : self.y + h, self.x : self.x + w] = self.mask


def mask_box(mask: np.ndarray) -> tuple[int, int, int, int]:
    """x0, y0, x1, y1 of a mask ((H, W) bool), exclusive right and bottom edges; zeros for an empty one."""
    x, y, w, h = cv2.boundingRect(mask.view(np.uint8))
    return x, y, x + w, y + h


def outlines(mask: np.ndarray) -> list[np.ndarray]:
    """(N, 2) float64 each: closed outer outlines of a mask's parts ((H, W) bool) through the middles of its pixels."""
    found, _ = cv2.findContours(np.ascontiguousarray(mask).view(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_TC89_L1)
    return [line.reshape(-1, 2) + 0.5 for line in found if len(line) > 2]


def fill_polygons(size: tuple[int, int], polygons: Sequence[np.ndarray]) -> np.ndarray:
    """(H, W) bool: the pixels inside any of the polygons, (N, 2) x, y within the picture, as the COCO API has them."""
    from pycocotools import mask as coco

    encoded: Any = coco.merge(coco.frPyObjects([p.ravel().tolist() for p in polygons], *size))
    return coco.decode(encoded).astype(np.bool_)
