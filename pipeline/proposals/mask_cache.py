"""A segmenter's masks kept on disk, box by box, by content: picture, models, box."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import xxhash

from pipeline.geometry.frame import Frame
from pipeline.proposals.segmenter import Segmenter
from pipeline.system.paths import cache_folder

_VERSION = "1"


class CachedSegmenter:
    """A segmenter that looks into the cache first, for one whose masks do not depend on the other boxes or the labels.

    A damaged or unreadable cache file is a miss, never an error; a folder that
    cannot be written only means that nothing is kept.

    Parameters
    ----------
    segmenter : Segmenter
    folder : Path, optional
        Default: the folder of all caches.
    """

    independent = True

    def __init__(self, segmenter: Segmenter, folder: Path | None = None) -> None:
        self.segmenter = segmenter
        self.folder = (folder or cache_folder()) / "masks"

    @property
    def name(self) -> str:
        return self.segmenter.name

    def fingerprint(self) -> str:
        return self.segmenter.fingerprint()

    def segment(self, frame: Frame, boxes: np.ndarray, labels: Sequence[str]) -> tuple[np.ndarray, np.ndarray]:
        shape = (frame.height, frame.width)
        boxes = np.ascontiguousarray(boxes, np.float32)
        paths = [self.path(frame, box) for box in boxes]
        masks = np.zeros((len(boxes), *shape), np.bool_)
        missing = []
        for i, path in enumerate(paths):
            known = _load(path, shape)
            if known is None:
                missing.append(i)
            else:
                masks[i] = known
        if missing:
            made, has_mask = self.segmenter.segment(frame, boxes[missing], [str(labels[i]) for i in missing])
            for i, mask, has in zip(missing, made, has_mask, strict=True):
                masks[i] = mask & has
                _store(paths[i], masks[i])
        return masks, np.asarray(masks.any(axis=(1, 2)))

    def path(self, frame: Frame, box: np.ndarray) -> Path:
        """Where the mask of a box ((4,) float32) is kept."""
        parts = [_VERSION, frame.content_hash, self.fingerprint(), box.tobytes().hex()]
        key = xxhash.xxh3_128_hexdigest("\x1f".join(parts).encode())
        return self.folder / key[:2] / f"{key}.npz"


def _store(path: Path, mask: np.ndarray) -> None:
    temporary: Path | None = None
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.NamedTemporaryFile(dir=path.parent, suffix=".tmp", delete=False) as file:
            temporary = Path(file.name)
            np.savez_compressed(file, shape=np.array(mask.shape), bits=np.packbits(mask))
        os.replace(temporary, path)
    except OSError:
        if temporary is not None:
            temporary.unlink(missing_ok=True)


def _load(path: Path, shape: tuple[int, int]) -> np.ndarray | None:
    if not path.is_file():
        return None
    try:
        with np.load(path, allow_pickle=False) as data:
            if tuple(data["shape"]) != shape:
                return None
            return np.unpackbits(data["bits"], count=shape[0] * shape[1]).reshape(shape).astype(np.bool_)
    except Exception:  # Damaged bytes fail in zipfile, zlib, tokenize or NumPy, each with its own class.
        return None
