"""Addresses of pictures: of any picture, frames by number, thumbnails of a run's answers."""

from __future__ import annotations

import asyncio
import re
from collections.abc import Mapping
from functools import lru_cache
from typing import Any

import numpy as np

from pipeline.answering.frame_store import BackgroundPictures, LoadedFrame
from pipeline.evaluation.run_figures import Drawn, RunFigures
from pipeline.geometry.palette import ON_DARK, RGB
from pipeline.pictures.marks import Outline, Stroke, answer_crop
from pipeline.system.encoded_pictures import jpeg, png
from pipeline.system.errors import InputError
from spatialviz.app.kept_pictures import IMAGES


def jpeg_url(rgb: np.ndarray, quality: int = 82) -> str:
    """Address of a picture ((H, W, 3) uint8, RGB)."""
    return IMAGES.url(jpeg(rgb, quality), "jpg")


def png_url(bgra: np.ndarray) -> str:
    """Address of a picture with transparency ((H, W, 4) uint8, BGRA)."""
    return IMAGES.url(png(bgra), "png")


def thumb_url(loaded: LoadedFrame, bbox: np.ndarray) -> str:
    """Address of an object's thumbnail; "" outside the frame."""
    data = loaded.thumb(bbox)
    return IMAGES.url(data, "jpg") if data else ""


WIDTH = 480
"""Pixels of a frame's picture."""
ADDRESS = re.compile(r"/app/frame/([0-9]{1,3})/([0-9]{1,9})/([0-9]{1,4})\.jpg")


class FramePictures(BackgroundPictures):
    """Pictures of all pipelines of a server, open to any page."""

    async def get(self, path: str) -> bytes | None:
        """Frame's picture as JPEG; None for an unknown frame or width, or a broken frame."""
        found = ADDRESS.fullmatch(path)
        source, number, width = (0, 0, 0) if found is None else map(int, found.groups())
        if width != WIDTH or source >= len(self._sources):
            return None
        name = list(self._sources)[source]
        ids = self._sources[name].dataset.frame_ids
        return None if number >= len(ids) else await asyncio.wrap_future(self.picture(name, ids[number], width)) or None


STROKES: dict[Drawn, tuple[RGB, Stroke]] = {
    "answered target": (ON_DARK["target"], "thick"),
    "wrong target": (ON_DARK["target"], "thick"),
    "answered reference": (ON_DARK["reference"], "thin"),
    "labelled": (ON_DARK["truth"], "dashed"),
    "second run": (ON_DARK["edited"], "dashed"),
}
"""Line of each box, as in the legend."""
PICTURES = 3000
"""Size of the address cache."""


class RunPictures:
    """Thumbnails of a run."""

    def __init__(self, figures: RunFigures) -> None:
        self._figures = figures
        self._kept: dict[int, str] = {}

    def url(self, number: int, row: Mapping[str, Any], make: bool = False) -> str:
        """Address of a row's picture; "" if not made yet, without `make`, or for a broken frame."""
        kept = self._kept.get(number)
        if kept is not None and (not kept or IMAGES.get(kept.rpartition("/")[2]) is not None):
            return kept
        if not make:
            return ""
        self._kept[number] = found = self._made(number, row)
        while len(self._kept) > PICTURES:
            del self._kept[next(iter(self._kept))]
        return found

    def _made(self, number: int, row: Mapping[str, Any]) -> str:
        outlines = [
            Outline(box, *STROKES[what], what == "wrong target") for what, box in self._figures.boxes(number, row)
        ]
        try:
            return jpeg_url(answer_crop(self._figures.colors(row["frame"]), outlines), 80)
        except InputError:
            return ""


@lru_cache(maxsize=8)
def pictures_of(figures: RunFigures) -> RunPictures:
    """Pictures of a run, shared by all clients."""
    return RunPictures(figures)
