"""Disk cache of detections and masks, keyed by picture, models with thresholds, names or box."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import xxhash

from pipeline.geometry.frame import Frame
from pipeline.proposals.base import Detector, Proposals, detect_expression, lists_things, reads_annotations
from pipeline.proposals.segmenter import Segmenter, takes_points
from pipeline.system.paths import cache_folder
from pipeline.system.recent import Recent
from pipeline.system.whole_files import keep_whole

_IN_MEMORY = 8
_VERSION = "2"
"""Part of every key: a change of what detectors make of a network's output must change it."""


class CachedDetector:
    """A detector with a disk cache.

    A damaged or unreadable cache file is a miss, never an error; a folder that
    cannot be written only means that nothing is kept.
    """

    def __init__(self, detector: Detector, folder: Path | None = None) -> None:
        self.detector = detector
        self.name, self.exact, self.vocabulary = detector.name, detector.exact, detector.vocabulary
        self.reads_annotations, self.lists_things = reads_annotations(detector), lists_things(detector)
        self.folder = (folder or cache_folder()) / "proposals"
        self._recent: Recent[str, Proposals] = Recent(_IN_MEMORY)

    def fingerprint(self) -> str:
        return self.detector.fingerprint()

    def detect(self, frame: Frame, labels: Sequence[str] | None) -> Proposals:
        return self._kept(self.key(frame, labels), lambda: self.detector.detect(frame, labels))

    def detect_expression(self, frame: Frame, text: str) -> Proposals:
        """Detections of a whole expression; see `pipeline.proposals.base.detect_expression`."""
        return self._kept(
            self.key(frame, ["", "expression", text]), lambda: detect_expression(self.detector, frame, text)
        )

    def key(self, frame: Frame, labels: Sequence[str] | None) -> str:
        """Cache key of a run on a frame."""
        if labels is None:
            # What a detector of any names looks for where it is asked for none is no part of its fingerprint.
            labels = getattr(self.detector, "default_labels", None)
        # The order counts: names that do not fit into one caption together are asked for in several.
        asked = ("everything",) if labels is None else ("names", *labels)
        parts = [_VERSION, frame.content_hash, self.fingerprint(), *asked]
        return xxhash.xxh3_128_hexdigest("\x1f".join(parts).encode())

    def _kept(self, key: str, run: Callable[[], Proposals]) -> Proposals:
        def find() -> Proposals:
            found = _load(self.folder / f"{key}.npz")
            if found is None:  # An empty result is a result.
                found = run()
                keep_whole(self.folder / f"{key}.npz", partial(_store, proposals=found))
            return found

        return self._recent.get(key, find)


def _store(file: Any, proposals: Proposals) -> None:
    masks = proposals.masks
    np.savez_compressed(
        file,
        boxes=proposals.boxes,
        scores=proposals.scores,
        label_index=proposals.label_index,
        labels=np.array(proposals.labels, dtype=np.str_),
        ids=proposals.ids,
        mask_shape=np.array((0, 0, 0) if masks is None else masks.shape),
        has_masks=np.array(masks is not None),
        masks=np.zeros(0, np.uint8) if masks is None else np.packbits(masks),
        has_mask=np.ones(len(proposals), bool) if proposals.has_mask is None else proposals.has_mask,
        segmented=np.zeros(len(proposals), bool) if proposals.segmented is None else proposals.segmented,
    )


def _load(path: Path) -> Proposals | None:
    try:
        with np.load(path, allow_pickle=False) as data:
            return Proposals(
                data["boxes"],
                data["scores"],
                data["label_index"],
                tuple(str(s) for s in data["labels"]),
                _unpacked(data["masks"], data["mask_shape"]) if bool(data["has_masks"]) else None,
                data["ids"],
                data["has_mask"],
                data["segmented"],
            )
    except Exception:  # A file may be missing; damaged ones fail in zipfile, zlib, tokenize or NumPy, each in its way.
        return None


def _unpacked(bits: np.ndarray, shape: Sequence[int]) -> np.ndarray:
    shape = tuple(int(n) for n in shape)
    return np.unpackbits(bits, count=int(np.prod(shape))).reshape(shape).astype(np.bool_)


_MASK_VERSION = "1"


class CachedSegmenter:
    """A disk cache for a segmenter with masks independent of other boxes and labels.

    A damaged or unreadable cache file is a miss, never an error; a folder that
    cannot be written only means that nothing is kept.

    Parameters
    ----------
    folder : Path, optional
        Default: the folder of all caches.
    """

    independent = True

    def __init__(self, segmenter: Segmenter, folder: Path | None = None) -> None:
        self.segmenter, self.name = segmenter, segmenter.name
        self.takes_points = takes_points(segmenter)
        self.folder = (folder or cache_folder()) / "masks"

    def fingerprint(self) -> str:
        return self.segmenter.fingerprint()

    def segment(self, frame: Frame, boxes: np.ndarray, labels: Sequence[str]) -> tuple[np.ndarray, np.ndarray]:
        shape = (frame.height, frame.width)
        boxes = np.ascontiguousarray(boxes, np.float32)
        paths = [self.path(frame, box) for box in boxes]
        known = [_load_mask(path, shape) for path in paths]
        missing = [i for i, mask in enumerate(known) if mask is None]
        if missing:
            made, has_mask = self.segmenter.segment(frame, boxes[missing], [str(labels[i]) for i in missing])
            for i, mask, has in zip(missing, made, has_mask, strict=True):
                known[i] = kept = mask & has
                shape_and_bits = {"shape": np.array(kept.shape), "bits": np.packbits(kept)}
                keep_whole(paths[i], partial(np.savez_compressed, **shape_and_bits))
        masks = np.array(known, np.bool_).reshape(-1, *shape)
        return masks, np.asarray(masks.any(axis=(1, 2)))

    def path(self, frame: Frame, box: np.ndarray) -> Path:
        """Cache path of the mask of a box ((4,) float32)."""
        parts = [_MASK_VERSION, frame.content_hash, self.fingerprint(), box.tobytes().hex()]
        key = xxhash.xxh3_128_hexdigest("\x1f".join(parts).encode())
        return self.folder / key[:2] / f"{key}.npz"


def _load_mask(path: Path, shape: tuple[int, int]) -> np.ndarray | None:
    try:
        with np.load(path, allow_pickle=False) as data:
            return _unpacked(data["bits"], shape) if tuple(data["shape"]) == shape else None
    except Exception:  # As above.
        return None
