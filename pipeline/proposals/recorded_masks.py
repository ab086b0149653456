"""Masks of other programs, fitted to boxes: COCO JSON, a recording of detections, or PNG files.

COCO: `images` [{id, file_name}] and `annotations` [{image_id, segmentation, bbox?, category_id?}], run-length encoded
(compressed or not) or polygons; an image is a frame's by its file name or its id. A recording: what
`--detector recorded` reads. PNG: `<frame id>.png`, 8 or 16 bit, where each value above 0 is one segment, or
`<frame id>/*.png`, one segment each, where pixels above 0 are its.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import BaseModel, FiniteFloat

from pipeline.datasets.frame_names import fit
from pipeline.geometry.frame import Frame
from pipeline.geometry.masks import RunLength, mask_box
from pipeline.language.naming import Synonyms
from pipeline.proposals.coco_files import CocoCategory, CocoImage, filled
from pipeline.proposals.recorded import RecordedDetector
from pipeline.proposals.segmenter import DetectorSegmenter, Segmenter, Segments, segment_from
from pipeline.system.errors import FrameUnusable, InputError, as_input_error, needed, require
from pipeline.system.reading import checked
from pipeline.system.safe_files import read_json, read_picture


class CocoAnnotation(BaseModel):
    """A segment of a COCO file."""

    image_id: int
    segmentation: RunLength | list[list[FiniteFloat]]
    bbox: tuple[FiniteFloat, FiniteFloat, FiniteFloat, FiniteFloat] | None = None
    category_id: int | None = None


class CocoFile(BaseModel):
    """A COCO file with masks."""

    images: list[CocoImage]
    annotations: list[CocoAnnotation]
    categories: list[CocoCategory] = []


def open_recorded_masks(path: str | Path, synonyms: Synonyms | None = None) -> Segmenter:
    """Open a segmenter for a file or folder of masks."""
    path = Path(path)
    require(path.exists(), "there are no recorded masks", path=path)
    if path.is_dir():
        if any(path.glob("*.npz")):
            return DetectorSegmenter(RecordedDetector(path), synonyms)
        require(
            next(path.rglob("*.png"), None) is not None,
            "the folder holds no masks",
            expected="PNG files named after the frames",
            path=path,
        )
        return PngMasks(path)
    with as_input_error("the recorded masks are not JSON", OSError, ValueError, got=str, path=path):
        content: Any = read_json(path)
    if isinstance(content, dict) and "frames" in content:
        return DetectorSegmenter(RecordedDetector(path), synonyms)
    wrong = "the masks follow neither COCO nor the format of recordings at {}"
    return CocoMasks(path, checked(CocoFile.model_validate, content, wrong, path), synonyms)


class CocoMasks:
    """The segments of a COCO file."""

    name = "recorded"

    def __init__(self, path: Path, content: CocoFile, synonyms: Synonyms | None = None) -> None:
        self.path = path
        self.synonyms = synonyms
        self._images = content.images
        self._names = {c.id: c.name for c in content.categories}
        self._annotations: dict[int, list[CocoAnnotation]] = {}
        for annotation in content.annotations:
            self._annotations.setdefault(annotation.image_id, []).append(annotation)

    def fingerprint(self) -> str:
        return _fingerprint("coco", self.path)

    def segment(self, frame: Frame, boxes: np.ndarray, labels: Sequence[str]) -> tuple[np.ndarray, np.ndarray]:
        """Masks (N, H, W) bool of best box overlap (at least 0.5), names first, and found (N,) bool."""
        shape = (frame.height, frame.width)
        image = self._image(frame)
        size = (image.height or shape[0], image.width or shape[1])
        require(
            size == shape,
            f"frame {frame.id}: the masks of {image.file_name!r} have another size",
            got=size,
            expected=shape,
            path=self.path,
        )
        found = self._annotations.get(image.id, [])
        decoded: dict[int, np.ndarray] = {}

        def mask(i: int) -> np.ndarray:
            if i not in decoded:
                decoded[i] = self._decode(found[i], shape, f"frame {frame.id}, segment {i}")
            return decoded[i]

        rectangles = np.zeros((len(found), 4))
        for i, annotation in enumerate(found):
            if annotation.bbox is None:
                rectangles[i] = mask_box(mask(i))
            else:
                x, y, w, h = annotation.bbox
                rectangles[i] = (x, y, x + w, y + h)
        names = tuple(None if a.category_id is None else self._names.get(a.category_id) for a in found)
        return segment_from(Segments(rectangles, names, mask), boxes, labels, shape, self.synonyms)

    def _image(self, frame: Frame) -> CocoImage:
        """Best-matching image by `pipeline.datasets.frame_names.fit`, by name, else by id."""
        for pictures in ([i.file_name for i in self._images], [i.id for i in self._images]):
            fits = [fit(frame.id, picture) for picture in pictures]
            best = max(fits, default=0)
            found = [image for image, k in zip(self._images, fits, strict=True) if best and k == best]
            names = " and ".join(repr(image.file_name) for image in found[:2])
            several = f"several images may be frame {frame.id}: {names}"
            require(len(found) <= 1, several, path=self.path, error=FrameUnusable)
            if found:
                return found[0]
        raise FrameUnusable(f"there are no recorded masks for frame {frame.id}", path=self.path)

    def _decode(self, annotation: CocoAnnotation, shape: tuple[int, int], where: str) -> np.ndarray:
        content = annotation.segmentation
        if isinstance(content, RunLength):
            return content.decoded(shape, where, self.path)
        return filled(content, shape, where, self.path)


class PngMasks:
    """The segments of a folder of PNG files."""

    name = "recorded"

    def __init__(self, path: Path) -> None:
        self.path = path

    def fingerprint(self) -> str:
        return _fingerprint("png", self.path)

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


def _fingerprint(kind: str, path: Path) -> str:
    return f"recorded-masks:{kind}:{path.resolve()}:{path.stat().st_mtime_ns}"
