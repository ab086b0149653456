"""Masks for boxes: segmenters, a detector with a segmenter, and segments of other programs assigned to boxes."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cached_property
from pathlib import Path
from time import perf_counter
from typing import Protocol, runtime_checkable

import numpy as np

from pipeline.geometry.boxes import iou_2d
from pipeline.geometry.frame import Frame
from pipeline.geometry.masks import mask_box
from pipeline.language.naming import Synonyms, match
from pipeline.proposals.annotations import box_mask
from pipeline.proposals.base import Detector, Proposals, detect_expression
from pipeline.system.contents import contents_hash
from pipeline.system.errors import FrameUnusable, InputError, needed, require
from pipeline.system.frozen import dataclass
from pipeline.system.safe_files import read_picture

BEST = 50
"""Of a detector that is not exact, at most so many boxes of a run get a mask, the best first."""


@runtime_checkable
class Segmenter(Protocol):
    """Makes masks from boxes.

    One whose mask of a box does not depend on the other boxes says so by an
    attribute `independent`, and may then be given guesses at the same thing.

    Attributes
    ----------
    name : str
        As on the command line.

    Examples
    --------
    >>> from pipeline.datasets import demo_path, open_dataset
    >>> from pipeline.proposals import make_segmenter
    >>> frame = open_dataset(demo_path()).load("000001/000000")
    >>> masks, has_mask = make_segmenter("depth").segment(frame, frame.annotations[0].bbox[None], ["laptop"])
    >>> masks.shape, has_mask
    ((1, 480, 640), array([ True]))
    """

    @property
    def name(self) -> str: ...

    def fingerprint(self) -> str:
        """Cache key of the masks, besides frame and boxes."""
        ...

    def segment(self, frame: Frame, boxes: np.ndarray, labels: Sequence[str]) -> tuple[np.ndarray, np.ndarray]:
        """Masks of the things in boxes.

        Parameters
        ----------
        boxes : (N, 4) float32
            x0, y0, x1, y1 in pixels. They are things of their own, not guesses at the same one: a segmenter may
            give each pixel to one of them.
        labels : sequence of str
            A class name for each box.

        Returns
        -------
        masks : (N, H, W) bool
        has_mask : (N,) bool
            False where the segmenter has nothing to say; the mask there does not count.
        """
        ...


def takes_points(segmenter: Segmenter | None) -> bool:
    """True for a segmenter that makes masks from points."""
    return bool(getattr(segmenter, "takes_points", False))


def mask_at(segmenter: Segmenter, frame: Frame, points: np.ndarray) -> np.ndarray:
    """(H, W) bool: the things at points (N, 2), x, y in pixels."""
    masks, has_mask = segmenter.segment(frame, np.tile(points, 2).astype(np.float32), [""] * len(points))
    return np.asarray((masks & has_mask[:, None, None]).any(axis=0))


class Segmented:
    """A detector with masks from a segmenter for proposals without masks.

    The boxes of an exact detector are segmented together, all of the frame, so that a mask does not depend on what
    was asked for. Those of any other may be guesses at one and the same thing: each is segmented by itself, unless
    the segmenter treats boxes independently anyway.
    """

    def __init__(self, detector: Detector, segmenter: Segmenter) -> None:
        self.detector, self.segmenter = detector, segmenter
        self.name, self.exact = f"{detector.name}+{segmenter.name}", detector.exact
        self.seconds = 0.0
        """What the segmenter has taken so far."""
        self._last: tuple[Frame, dict[int, np.ndarray]] | None = None

    @property
    def vocabulary(self) -> tuple[str, ...] | None:
        return self.detector.vocabulary

    def fingerprint(self) -> str:
        return f"{self.detector.fingerprint()}|{self.segmenter.fingerprint()}"

    def detect(self, frame: Frame, labels: Sequence[str] | None) -> Proposals:
        found = self.detector.detect(frame, labels)
        bare = _without_mask(found)
        if not bare.any():
            return found
        made = self._of_all(frame) if self.exact else self._one_by_one(frame, found, np.flatnonzero(bare))
        shape = (frame.height, frame.width)
        masks = np.zeros((len(found), *shape), np.bool_) if found.masks is None else found.masks.copy()
        segmented = np.zeros(len(found), np.bool_)
        for i in np.flatnonzero(bare):
            mask = made.get(int(found.ids[i]) if self.exact else int(i))
            segmented[i] = mask is not None
            masks[i] = box_mask(found.boxes[i], *shape) if mask is None else mask
        return replace(found, masks=masks, has_mask=~bare | segmented, segmented=segmented)

    def detect_expression(self, frame: Frame, text: str) -> Proposals:
        """Detections of a whole expression, boxes only."""
        return detect_expression(self.detector, frame, text)

    def _of_all(self, frame: Frame) -> dict[int, np.ndarray]:
        """Masks of a frame's exact boxes by id, kept for the next question."""
        if self._last is None or self._last[0].rgb is not frame.rgb or self._last[0].depth is not frame.depth:
            everything = self.detector.detect(frame, None)
            bare = np.flatnonzero(_without_mask(everything))
            made = self._segment(frame, everything, bare)
            self._last = frame, {int(everything.ids[i]): mask for i, mask in made.items()}
        return self._last[1]

    def _one_by_one(self, frame: Frame, found: Proposals, bare: np.ndarray) -> dict[int, np.ndarray]:
        best = bare[np.argsort(-found.scores[bare], kind="stable")][:BEST]
        if getattr(self.segmenter, "independent", False):
            return self._segment(frame, found, best)
        made: dict[int, np.ndarray] = {}
        for i in best:
            made |= self._segment(frame, found, np.array([i]))
        return made

    def _segment(self, frame: Frame, found: Proposals, which: np.ndarray) -> dict[int, np.ndarray]:
        """Masks by index in `found`; boxes without a mask are left out."""
        labels = [found.label(int(i)) for i in which]
        start = perf_counter()
        masks, has_mask = self.segmenter.segment(frame, found.boxes[which], labels)
        self.seconds += perf_counter() - start
        expected = (len(which), frame.height, frame.width)
        require(
            masks.shape == expected and masks.dtype == np.bool_ and has_mask.shape == expected[:1],
            f"the segmenter {self.segmenter.name!r} must give masks bool (N, H, W) and has_mask (N,)",
            got=f"{masks.dtype} {masks.shape}, {has_mask.shape}",
            expected=f"N, H, W = {expected}",
        )
        return {int(i): m for i, m, has in zip(which, masks, has_mask, strict=True) if has and m.any()}


def _without_mask(found: Proposals) -> np.ndarray:
    """Proposals with only a box, (N,) bool."""
    if found.masks is None:
        return np.ones(len(found), np.bool_)
    return np.zeros(len(found), np.bool_) if found.has_mask is None else ~found.has_mask


class DetectorSegmenter:
    """Segmenter by a detector's masks of best box overlap."""

    def __init__(self, detector: Detector, synonyms: Synonyms | None = None) -> None:
        self.detector, self.name, self.synonyms = detector, detector.name, synonyms

    def fingerprint(self) -> str:
        return f"masks:{self.detector.fingerprint()}"

    def segment(self, frame: Frame, boxes: np.ndarray, labels: Sequence[str]) -> tuple[np.ndarray, np.ndarray]:
        """Masks (N, H, W) bool of best box overlap (at least 0.5), names first, and found (N,) bool."""
        found = self.detector.detect(frame, None)
        masks = found.masks
        if masks is None:
            found, masks = found.take(np.zeros(0, np.int64)), np.zeros((0, frame.height, frame.width), np.bool_)
        elif found.has_mask is not None:
            found, masks = found.take(found.has_mask), masks[found.has_mask]
        names = tuple(found.label(i) for i in range(len(found)))
        segments = Segments(found.boxes, names, lambda i: masks[i])
        return segment_from(segments, boxes, labels, (frame.height, frame.width), self.synonyms)


MIN_IOU = 0.5
"""A segment whose bounding box overlaps a box less than this is not its segment."""


@dataclass(frozen=True)
class Segments:
    """Unassigned masks of a frame."""

    boxes: np.ndarray  # (S, 4) float: Bounding boxes, x0, y0, x1, y1 in pixels
    labels: tuple[str | None, ...]  # Their class names, where known
    mask: Callable[[int], np.ndarray]  # The (H, W) bool mask of segment number i; only those that are needed are made


def assign(
    boxes: np.ndarray, labels: Sequence[str], segments: Segments, synonyms: Synonyms | None = None
) -> np.ndarray:
    """Assign segments to boxes, each at most once, maximising total overlap.

    A segment of the box's own class name goes before one of another or no
    name. Equal overlaps are decided by the share of the segment's box inside the box.

    Returns (N,) int64: Numbers of segments; -1 where none overlaps enough.
    """
    from scipy.optimize import linear_sum_assignment

    chosen = np.full(len(boxes), -1, np.int64)
    if not len(boxes) or not len(segments.boxes):
        return chosen
    overlap = iou_2d(boxes, segments.boxes)
    value = overlap + 1e-3 * share_inside(segments.boxes, boxes).T
    value += 2.0 * _same_name(labels, segments.labels, synonyms)
    value = np.where(overlap >= MIN_IOU, value, 0.0)
    row, column = linear_sum_assignment(value, maximize=True)
    fits = value[row, column] > 0
    chosen[row[fits]] = column[fits]
    return chosen


def segment_from(
    segments: Segments, boxes: np.ndarray, labels: Sequence[str], shape: tuple[int, int], synonyms: Synonyms | None
) -> tuple[np.ndarray, np.ndarray]:
    """Masks (N, H, W) and has_mask (N,) of boxes, as of `Segmenter.segment`."""
    chosen = assign(np.asarray(boxes, np.float64).reshape(-1, 4), labels, segments, synonyms)
    masks, has_mask = np.zeros((len(chosen), *shape), np.bool_), np.zeros(len(chosen), np.bool_)
    for i in np.flatnonzero(chosen >= 0):
        masks[i] = segments.mask(int(chosen[i]))
        has_mask[i] = masks[i].any()
    return masks, has_mask


def share_inside(inner: np.ndarray, outer: np.ndarray) -> np.ndarray:
    """Share of each of `inner` inside each of `outer`, (S, N)."""
    low = np.maximum(inner[:, None, :2], outer[None, :, :2])
    high = np.minimum(inner[:, None, 2:], outer[None, :, 2:])
    shared = np.maximum(high - low, 0).prod(axis=2)
    area = np.maximum(inner[:, 2:] - inner[:, :2], 0).prod(axis=1)
    return np.divide(shared, area[:, None], out=np.zeros_like(shared), where=area[:, None] > 0)


def _same_name(labels: Sequence[str], names: Sequence[str | None], synonyms: Synonyms | None) -> np.ndarray:
    """Name matches (N, S) bool of boxes and segments."""
    known = tuple(dict.fromkeys(n for n in names if n))
    meant = {label: set(match(label, known, synonyms)) for label in dict.fromkeys(labels)}
    return np.array([[name in meant[label] for name in names] for label in labels], np.bool_).reshape(
        len(labels), len(names)
    )


class PngMasks:
    """Segments of PNG files: `<frame id>.png`, 8 or 16 bit, where each value above 0 is one segment, or
    `<frame id>/*.png`, one segment each, where pixels above 0 are its."""

    name = "recorded"

    def __init__(self, path: Path) -> None:
        self.path = path

    @cached_property
    def _contents(self) -> str:
        return contents_hash(self.path)

    def fingerprint(self) -> str:
        return f"recorded-masks:png:{self._contents}"

    def segment(self, frame: Frame, boxes: np.ndarray, labels: Sequence[str]) -> tuple[np.ndarray, np.ndarray]:
        """Masks (N, H, W) bool of best box overlap (at least 0.5), and found (N,) bool."""
        segments = self._of_frame(frame)
        return segment_from(segments, boxes, labels, (frame.height, frame.width), None)

    def _of_frame(self, frame: Frame) -> Segments:
        file, folder = self.path / f"{frame.id}.png", self.path / frame.id
        require(
            file.resolve().is_relative_to(self.path.resolve()),
            f"frame {frame.id}: its masks would lie outside the folder",
            path=self.path,
            error=FrameUnusable,
        )
        if file.is_file():
            from scipy.ndimage import find_objects

            values = _read_png(file, frame)
            found = [(v, window) for v, window in enumerate(find_objects(values.astype(np.int32)), start=1) if window]
            rectangles = [(x.start, y.start, x.stop, y.stop) for _, (y, x) in found]
            numbers = [v for v, _ in found]
            return Segments(
                np.array(rectangles, np.float64).reshape(-1, 4), (None,) * len(found), lambda i: values == numbers[i]
            )
        files = sorted(folder.glob("*.png")) if folder.is_dir() else []
        require(files, f"there are no recorded masks for frame {frame.id}", path=file, error=FrameUnusable)
        masks = [_read_png(f, frame) > 0 for f in files]
        return Segments(np.stack([mask_box(m) for m in masks]), (None,) * len(masks), lambda i: masks[i])


def _read_png(file: Path, frame: Frame) -> np.ndarray:
    unreadable = f"frame {frame.id}: the mask file cannot be read"
    try:
        image = needed(read_picture(file), unreadable, path=file, error=FrameUnusable)
    except (OSError, InputError) as error:
        raise FrameUnusable(str(error)) from error
    require(
        image.ndim == 2 and image.dtype in (np.uint8, np.uint16),
        f"frame {frame.id}: a mask file must have one channel of 8 or 16 bits",
        got=f"{image.dtype} {image.shape}",
        path=file,
        error=FrameUnusable,
    )
    require(
        image.shape == (frame.height, frame.width),
        f"frame {frame.id}: the mask has another size",
        got=image.shape,
        expected=(frame.height, frame.width),
        path=file,
        error=FrameUnusable,
    )
    return image
