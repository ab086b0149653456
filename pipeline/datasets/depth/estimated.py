"""Depth estimated by a network in place of, or without, measured depth."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import xxhash

from pipeline.datasets.base import ChangedFrames, Dataset, dataset_notes, readable_frames
from pipeline.datasets.depth.estimator import DepthEstimate, DepthModel
from pipeline.datasets.settings import INTRINSICS
from pipeline.geometry.frame import Frame
from pipeline.system.errors import InputError, in_file
from pipeline.system.paths import cache_folder
from pipeline.system.whole_files import keep_whole


class EstimatedDepth(ChangedFrames):
    """A dataset with estimated depth, kept on disk by the picture, the network and the camera."""

    def __init__(self, inner: Dataset, model: DepthModel, browse: bool) -> None:
        super().__init__(inner)
        self.model, self.browse = model, browse
        measured = () if inner.format == "pictures" else ("depth is estimated: none that a sensor measured is used",)
        self.notes = (*dataset_notes(inner), *measured)
        if not browse and not model.contract.gives_focal:
            for frame in readable_frames(inner.load, inner.frame_ids[:1]):
                self._known(frame)

    def changed(self, frame: Frame) -> Frame:
        """Frame with estimated depth."""
        camera, K = frame.camera, self._known(frame)
        made_up = K is None and not self.model.contract.gives_focal
        found = self._estimate(frame, camera.K if made_up else K)
        untold, notes = (INTRINSICS,) if made_up else (), frame.notes
        if made_up:
            notes = (*notes, f"nothing can be measured, sizes are made up: {INTRINSICS}")
        focal = "is made up" if made_up else "by the network" if K is None else "of the camera"
        name, file = self.model.name, self.model.path.name
        camera = replace(camera, K=camera.K if found.K is None else found.K, untold=untold)
        by_focal = self.model.contract.output.canonical_focal is not None
        metres = "metres by the focal length" if by_focal else "metres as it learnt them"
        source = f"estimated by {name} ({file}): {metres}, focal length {focal}"
        notes = (*notes, f"depth is {source}")
        with in_file(self.model.path):
            return replace(frame, depth=found.depth, camera=camera, depth_source=source, notes=notes)

    def _known(self, frame: Frame) -> np.ndarray | None:
        """Camera known without the network; InputError where unknown."""
        if INTRINSICS not in frame.camera.untold:
            return frame.camera.K
        if not self.browse and not self.model.contract.gives_focal:
            raise InputError(
                "the focal length is not known",
                expected=INTRINSICS,
                cause=f"{self.model.name} does not give one, and the picture states none in its EXIF",
                path=self.root,
            )
        return None

    def _estimate(self, frame: Frame, K: np.ndarray | None) -> DepthEstimate:
        """Depth estimate, from disk where cached."""
        parts = (frame.content_hash, self.model.fingerprint, "" if K is None else K.tobytes().hex())
        key = xxhash.xxh3_128_hexdigest("\x1f".join(parts).encode())
        path = cache_folder() / "depth" / key[:2] / f"{key}.npz"
        found = _load(path)
        if found is None or found.depth.shape != frame.depth.shape:
            found = self.model.estimate(frame.rgb, K)
            keep_whole(path, partial(_store, found=found))
        return found


def _store(file: Any, found: DepthEstimate) -> None:
    np.savez_compressed(file, depth=found.depth, K=np.zeros(0) if found.K is None else found.K)


def _load(path: Path) -> DepthEstimate | None:
    try:
        with np.load(path, allow_pickle=False) as data:
            return DepthEstimate(data["depth"], data["K"] if data["K"].size else None)
    except Exception:  # A file may be missing; damaged ones fail in zipfile, zlib, tokenize or NumPy, each in its way.
        return None
