"""Masks: bool crops in memory, COCO's run-length code in files, and the one codec between them.

Codes are untrusted input, and decoded no further than to the mask's box.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import cached_property
from pathlib import Path
from typing import Any, ClassVar, TypeVar

import cv2
import numpy as np

from pipeline.system.errors import InputError, require
from pipeline.system.frozen import dataclass

_LONGEST = 7
"""Characters of a number at most: their 35 bits are more than any picture has pixels, and no sum of them overflows."""


@dataclass(frozen=True, slots=True)
class RunLength:
    """A mask in COCO's run-length code."""

    __pydantic_config__: ClassVar[dict[str, str]] = {"extra": "forbid"}

    size: tuple[int, int]  # Height and width, pixels
    counts: str | tuple[int, ...]  # Compressed, or the lengths themselves

    @staticmethod
    def of(mask: np.ndarray) -> RunLength:
        """Encode a mask, (H, W) bool."""
        return RunLength((int(mask.shape[0]), int(mask.shape[1])), encode_run_length(np.ascontiguousarray(mask)))

    def crop(self, shape: tuple[int, int], where: str, path: Path | None = None) -> MaskCrop:
        """Decode the mask; InputError for a picture of another shape, before memory is asked for."""
        require(self.size == shape, f"{where}: the mask has another size", got=self.size, expected=shape, path=path)
        return decode_crop(self.size, self.counts, where, path)

    def decoded(self, shape: tuple[int, int], where: str, path: Path | None = None) -> np.ndarray:
        """Decode the mask to (H, W) bool; errors as of `crop`."""
        return self.crop(shape, where, path).of_picture(shape)


def run_lengths(code: str) -> np.ndarray | str:
    """Run lengths of a compressed code, (M,) int64, or the code's fault in words.

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
    """Decode COCO run lengths, compressed or not, to (H, W) bool; InputError where they do not fill the mask."""
    return decode_crop(size, counts, where).of_picture(size)


def decode_crop(
    size: Sequence[int], counts: str | Sequence[int], where: str = "mask", path: Path | None = None
) -> MaskCrop:
    """Decode only the non-empty part of the mask of `decode_run_length`; a fraction of the work."""
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
        return MaskCrop.tight(0, 0, np.zeros((0, 0), np.bool_))
    x0, x1 = int(starts[0]) // height, int(ends[-1] - 1) // height + 1
    edges = np.empty(2 * len(starts) + 1, np.int64)
    edges[:-1:2], edges[1::2], edges[-1] = starts, ends, x1 * height
    filled = np.zeros(len(edges), np.bool_)
    filled[1::2] = True
    columns = np.repeat(filled, np.diff(edges, prepend=x0 * height)).reshape(x1 - x0, height)
    rows = np.flatnonzero(columns.any(axis=0))
    y0, y1 = int(rows[0]), int(rows[-1]) + 1
    return MaskCrop.tight(x0, y0, np.ascontiguousarray(columns[:, y0:y1].T))


def encode_run_length(mask: np.ndarray) -> str:
    """Encode a mask, (H, W) bool, in COCO's compressed run-length code.

    >>> import numpy as np
    >>> from pipeline.geometry import decode_run_length, encode_run_length
    >>> code = encode_run_length(np.array([[False, True], [False, True]]))
    >>> code, decode_run_length((2, 2), code).tolist()
    ('22', [[False, True], [False, True]])
    """
    return encode_crops(mask.shape, [MaskCrop.of(mask)])[0]


def encode_crops(size: Sequence[int], crops: Sequence[MaskCrop]) -> list[str]:
    """Encode masks of a picture of (height, width) as `encode_run_length` does, from their crops alone."""
    runs = [_runs(size, crop) for crop in crops]
    counts = np.concatenate([np.zeros(0, np.int64), *runs])
    ends = np.cumsum([len(own) for own in runs], dtype=np.int64)
    starts = np.concatenate([[0], ends])[:-1]
    first = np.repeat(starts, ends - starts)
    # From the fourth on, a number is the difference to the one two places before.
    at = np.flatnonzero(np.arange(len(counts)) - first > 2)
    numbers = counts.copy()
    numbers[at] -= counts[at - 2]
    # As many characters of five bits as hold the number and its sign.
    digits = 1 + (np.where(numbers < 0, ~numbers, numbers)[:, None] >> _SIGN_BITS > 0).sum(axis=1)
    code = (numbers[:, None] >> _DIGIT_BITS) & 31
    code += 48 + 32 * (np.arange(_LONGEST) < digits[:, None] - 1)
    text = code[np.arange(_LONGEST) < digits[:, None]].astype(np.uint8).tobytes().decode("ascii")
    cuts = np.concatenate([[0], np.cumsum(digits)])
    return [text[start:end] for start, end in zip(cuts[starts].tolist(), cuts[ends].tolist(), strict=True)]


_DIGIT_BITS = 5 * np.arange(_LONGEST)
_SIGN_BITS = 5 * np.arange(1, _LONGEST) - 1


def _runs(size: Sequence[int], crop: MaskCrop) -> np.ndarray:
    """Lengths of the runs of a mask, (M,) int64, column by column, from zeros to ones and back."""
    height, pixels = int(size[0]), int(size[0]) * int(size[1])
    h, w = crop.mask.shape
    # Columns one after the other, each with a zero behind it, so that its runs end with it.
    flat = np.zeros(1 + w * (h + 1), np.bool_)
    flat[1:].reshape(w, h + 1)[:, :h] = crop.mask.T
    edges = np.flatnonzero(flat[1:] != flat[:-1])
    column = edges // (h + 1)
    # `h + 1` places a column here, `height` there.
    edges += column * (height - h - 1) + (crop.x * height + crop.y)
    if h == height:
        # A run goes on where the next column begins.
        ends, starts = edges[1:-1:2], edges[2::2]
        edges = np.delete(edges, 1 + 2 * np.flatnonzero(ends == starts)[:, None] + [0, 1])
    bounds = np.concatenate([[0], edges, [pixels]])
    runs = bounds[1:] - bounds[:-1]
    # A mask that ends with ones has no run of zeros behind them.
    return runs if runs[-1] or not len(edges) else runs[:-1]


@dataclass(frozen=True)
class MaskCrop:
    """The non-empty part of a picture's mask."""

    x: int  # Upper left pixel in the picture
    y: int
    mask: np.ndarray  # (h, w) bool

    @staticmethod
    def of(mask: np.ndarray) -> MaskCrop:
        """Cut the non-empty part out of a mask, (H, W) bool; a view."""
        x0, y0, x1, y1 = mask_box(mask)
        return MaskCrop.tight(x0, y0, mask[y0:y1, x0:x1])

    @staticmethod
    def tight(x: int, y: int, mask: np.ndarray) -> MaskCrop:
        """Hold a crop with set pixels in its outermost rows and columns, or without any: its box is known."""
        crop = MaskCrop(x, y, mask)
        crop.__dict__["box"] = x, y, x + mask.shape[1], y + mask.shape[0]
        return crop

    @cached_property
    def box(self) -> tuple[int, int, int, int]:
        """Box of the mask, x0, y0, x1, y1, with exclusive right and bottom edges; empty for an empty mask."""
        x0, y0, x1, y1 = mask_box(self.mask)
        return self.x + x0, self.y + y0, self.x + x1, self.y + y1

    @property
    def area(self) -> int:
        """Number of set pixels."""
        return int(self.mask.sum())

    def of_picture(self, size: Sequence[int]) -> np.ndarray:
        """Mask of the whole picture, (H, W) bool."""
        picture = np.zeros((int(size[0]), int(size[1])), np.bool_)
        self.paint(picture)
        return picture

    def paint(self, picture: np.ndarray) -> None:
        """Set the crop's pixels in an empty mask of the whole picture, (H, W) bool."""
        h, w = self.mask.shape
        picture[self.y : self.y + h, self.x : self.x + w] = self.mask


def mask_box(mask: np.ndarray) -> tuple[int, int, int, int]:
    """Box of a mask, (H, W) bool: x0, y0, x1, y1, exclusive right and bottom edges; zeros for an empty mask."""
    if not mask.size:
        return 0, 0, 0, 0
    first = int(mask.argmax()) // mask.shape[1]
    x, y, w, h = cv2.boundingRect(mask[first:].view(np.uint8))
    return (x, first + y, x + w, first + y + h) if w else (0, 0, 0, 0)


def topmost(size: Sequence[int], crops: Sequence[MaskCrop]) -> np.ndarray:
    """Index of each pixel's mask, (H, W) int32, -1 for none; of masks that overlap the smaller lies on top."""
    out = np.full((size[0], size[1]), -1, np.int32)
    for k in sorted(range(len(crops)), key=lambda k: -crops[k].area):
        crop = crops[k]
        h, w = crop.mask.shape
        out[crop.y : crop.y + h, crop.x : crop.x + w][crop.mask] = k
    return out


@dataclass(frozen=True, eq=False)
class PictureMask:
    """A mask of a picture, held by its crop."""

    size: tuple[int, int]  # Height and width, pixels
    crop: MaskCrop

    @staticmethod
    def of(mask: np.ndarray) -> PictureMask:
        """Hold a mask, (H, W) bool."""
        found = PictureMask((int(mask.shape[0]), int(mask.shape[1])), MaskCrop.of(mask))
        found.__dict__["whole"] = mask
        return found

    @cached_property
    def whole(self) -> np.ndarray:
        """Mask of the whole picture, (H, W) bool, painted when it is first asked for."""
        return self.crop.of_picture(self.size)


Holder = TypeVar("Holder")


class LazyMask:
    """Attribute `mask` of what holds a `PictureMask` instead: most masks are never looked at as a whole."""

    def __get__(self, holder: Any, _: type | None = None) -> Any:
        if holder is None:
            return None
        mask = holder.__dict__["mask"] = holder.__dict__["_held"].whole
        return mask

    @staticmethod
    def of(holder: object) -> PictureMask | None:
        """What an object holds instead of its mask, if it does."""
        return holder.__dict__.get("_held")

    @staticmethod
    def held_by(holder: Holder, mask: PictureMask) -> Holder:
        """Let a new object with a `LazyMask` hold a mask by its crop."""
        holder.__dict__.pop("mask")
        holder.__dict__["_held"] = mask
        return holder


class MaskStack:
    """(N, H, W) bool masks of a picture of `size`, held by their crops.

    It stands where one array of all would be a copy that nobody reads: masks are taken from it as from an array.
    """

    dtype, ndim = np.dtype(np.bool_), 3

    def __init__(self, size: tuple[int, int], masks: Sequence[PictureMask]) -> None:
        self.shape = len(masks), *size
        self.masks = masks

    def __len__(self) -> int:
        return len(self.masks)

    def __getitem__(self, index: Any) -> Any:
        if isinstance(index, (int, np.integer)):
            return self.masks[int(index)].whole
        if isinstance(index, np.ndarray) and index.ndim == 1:
            return MaskStack(self.shape[1:], [self.masks[k] for k in np.arange(len(self))[index].tolist()])
        return self.copy()[index]

    def __iter__(self) -> Iterator[np.ndarray]:
        return (mask.whole for mask in self.masks)

    def __getattr__(self, name: str) -> Any:
        # What else an array has is asked of one.
        if name.startswith("__") or name in ("masks", "shape"):
            raise AttributeError(name)
        return getattr(self.copy(), name)

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> np.ndarray:
        return self.copy() if dtype is None else self.copy().astype(dtype)

    def copy(self) -> np.ndarray:
        """One array of all."""
        return np.array([mask.whole for mask in self.masks], np.bool_).reshape(self.shape)


def outlines(mask: np.ndarray) -> list[np.ndarray]:
    """Closed outer outlines of a mask's parts, (N, 2) float64 each, through the middles of pixels."""
    found, _ = cv2.findContours(np.ascontiguousarray(mask).view(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_TC89_L1)
    return [line.reshape(-1, 2) + 0.5 for line in found if len(line) > 2]


def fill_polygons(size: tuple[int, int], polygons: Sequence[np.ndarray]) -> np.ndarray:
    """Fill polygons, (N, 2) x, y within the picture, as the COCO API does: (H, W) bool."""
    from pycocotools import mask as coco

    encoded: Any = coco.merge(coco.frPyObjects([p.ravel().tolist() for p in polygons], *size))
    return coco.decode(encoded).astype(np.bool_)
