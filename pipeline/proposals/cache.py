"""Detections kept on disk, by content: picture, detector with its model and thresholds, names."""

from __future__ import annotations

import os
import tempfile
from collections import OrderedDict
from collections.abc import Callable, Sequence
from pathlib import Path
from threading import Lock

import numpy as np
import xxhash

from pipeline.geometry.frame import Frame
from pipeline.proposals.base import Detector, Proposals, detect_expression, reads_annotations
from pipeline.system.paths import cache_folder

_IN_MEMORY = 8
_VERSION = "2"
"""Part of every key: a change of what detectors make of a network's output must change it."""


class CachedDetector:
    """A detector that looks into the cache first.

    A damaged or unreadable cache file is a miss, never an error; a folder that
    cannot be written only means that nothing is kept.
    """

    def __init__(self, detector: Detector, folder: Path | None = None) -> None:
        self.detector = detector
        self.folder = (folder or cache_folder()) / "proposals"
        self._recent: OrderedDict[str, Proposals] = OrderedDict()
        self._lock = Lock()

    @property
    def name(self) -> str:
        return self.detector.name

    @property
    def vocabulary(self) -> tuple[str, ...] | None:
        return self.detector.vocabulary

    @property
    def exact(self) -> bool:
        return self.detector.exact

    @property
    def reads_annotations(self) -> bool:
        return reads_annotations(self.detector)

    def fingerprint(self) -> str:
        return self.detector.fingerprint()

    def detect(self, frame: Frame, labels: Sequence[str] | None) -> Proposals:
        return self._kept(self.key(frame, labels), lambda: self.detector.detect(frame, labels))

    def detect_expression(self, frame: Frame, text: str) -> Proposals:
        """What the detector finds of a whole expression, see `pipeline.proposals.base.detect_expression`."""
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
        found = self._recent.get(key)
        if found is None:  # An empty result is a result.
            found = _load(self.folder / f"{key}.npz")
        if found is None:
            found = run()
            _store(self.folder / f"{key}.npz", found)
        with self._lock:
            self._recent[key] = found
            self._recent.move_to_end(key)
            while len(self._recent) > _IN_MEMORY:
                self._recent.popitem(last=False)
        return found


def _store(path: Path, proposals: Proposals) -> None:
    shape = (0, 0, 0) if proposals.masks is None else proposals.masks.shape
    packed = np.zeros(0, np.uint8) if proposals.masks is None else np.packbits(proposals.masks)
    temporary: Path | None = None
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.NamedTemporaryFile(dir=path.parent, suffix=".tmp", delete=False) as file:
            temporary = Path(file.name)
            np.savez_compressed(
                file,
                boxes=proposals.boxes,
                scores=proposals.scores,
                label_index=proposals.label_index,
                labels=np.array(proposals.labels, dtype=np.str_),
                ids=proposals.ids,
                mask_shape=np.array(shape),
                has_masks=np.array(proposals.masks is not None),
                masks=packed,
                has_mask=np.ones(len(proposals), bool) if proposals.has_mask is None else proposals.has_mask,
                segmented=np.zeros(len(proposals), bool) if proposals.segmented is None else proposals.segmented,
            )
        os.replace(temporary, path)
    except OSError:
        if temporary is not None:
            temporary.unlink(missing_ok=True)


def _load(path: Path) -> Proposals | None:
    if not path.is_file():
        return None
    try:
        with np.load(path, allow_pickle=False) as data:
            shape = tuple(int(n) for n in data["mask_shape"])
            masks = None
            if bool(data["has_masks"]):
                masks = np.unpackbits(data["masks"], count=int(np.prod(shape))).reshape(shape).astype(np.bool_)
            return Proposals(
                data["boxes"],
                data["scores"],
                data["label_index"],
                tuple(str(s) for s in data["labels"]),
                masks,
                data["ids"],
                data["has_mask"],
                data["segmented"],
            )
    except Exception:  # Damaged bytes fail in zipfile, zlib, tokenize or NumPy, each with its own class.
        return None
