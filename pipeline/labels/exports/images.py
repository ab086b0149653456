"""The pictures of an export: their names, and copying them from the dataset."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2

from pipeline.datasets import Dataset
from pipeline.system.errors import InputError

JPEG_QUALITY = 95


def image_name(frame_index: int, folder: str = "images", suffix: str = "jpg") -> str:
    """The name of a frame's picture below the export's folder, whether it is copied or not."""
    return f"{folder}/{frame_index:06d}.{suffix}"


@dataclass(frozen=True)
class ImageCopy:
    """Copies pictures of the dataset that was labelled."""

    dataset: Dataset

    def write(self, frame: Mapping[str, Any], path: Path) -> None:
        """Write one frame's colour image, as JPEG of quality 95 or, by the suffix of `path`, as PNG.

        Raises
        ------
        InputError
            The dataset lacks the frame, or has another picture under its name.
        """
        loaded = self.dataset.load(frame["frame"])
        if frame["rgb_hash"] is not None and loaded.content_hash != frame["rgb_hash"]:
            raise InputError(
                f"frame {frame['frame']}: another picture than the one that was labelled",
                cause="has the dataset changed, or is it another one?",
                path=self.dataset.root,
            )
        path.parent.mkdir(exist_ok=True)
        quality = [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY] if path.suffix == ".jpg" else []
        done, data = cv2.imencode(path.suffix, cv2.cvtColor(loaded.rgb, cv2.COLOR_RGB2BGR), quality)
        if not done:
            raise InputError(f"frame {frame['frame']}: the picture cannot be encoded as {path.suffix}")
        path.write_bytes(data.tobytes())
