"""Small pictures of any frame, and the cameras of a scene: made when asked for, behind whatever else is done."""

from __future__ import annotations

import asyncio
import re
from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress

import cv2

from pipeline.answering.opening import Pipeline
from pipeline.datasets.base import load_picture, scene_of
from pipeline.datasets.camera_plan import CameraPlan, camera_plan
from pipeline.system.errors import InputError
from pipeline.system.recent import Recent
from spatialviz.app.frames import jpeg

WIDTHS = (160, 480, 960)
"""In pixels: of a strip, of a grid, of a frame that is passed by."""
ADDRESS = re.compile(r"/app/frame/([0-9]{1,3})/([0-9]{1,9})/([0-9]{1,4})\.jpg")
KEPT_PICTURES, KEPT_PLANS = 600, 16


class FramePictures:
    """Those of all sources of a server; any page may ask for any of them.

    Parameters
    ----------
    sources : mapping of str to Pipeline
    """

    def __init__(self, sources: Mapping[str, Pipeline]) -> None:
        self._sources = sources
        self._behind = ThreadPoolExecutor(2, "pictures")
        self._pictures: Recent[tuple[str, str, int], bytes] = Recent(KEPT_PICTURES)
        self._plans: Recent[tuple[str, str], tuple[CameraPlan | None]] = Recent(KEPT_PLANS)

    def url(self, source: str, frame_id: str, width: int = WIDTHS[0]) -> str:
        """Where a page finds the picture of a frame."""
        number = self._sources[source].dataset.frame_ids.index(frame_id)
        return f"/app/frame/{list(self._sources).index(source)}/{number}/{width}.jpg"

    async def get(self, path: str) -> bytes | None:
        """The picture of such an address as JPEG; None for what is no frame or no width of ours, or a broken frame."""
        found = ADDRESS.fullmatch(path)
        source, number, width = (0, 0, 0) if found is None else map(int, found.groups())
        if width not in WIDTHS or source >= len(self._sources):
            return None
        name = list(self._sources)[source]
        ids = self._sources[name].dataset.frame_ids
        if number >= len(ids):
            return None
        key = (name, ids[number], width)
        made = self._behind.submit(lambda: self._pictures.get(key, lambda: self._draw(*key)))
        return await asyncio.wrap_future(made) or None

    def _draw(self, source: str, frame_id: str, width: int) -> bytes:
        with suppress(InputError):
            rgb = load_picture(self._sources[source].dataset, frame_id).rgb
            height = max(1, round(rgb.shape[0] * width / rgb.shape[1]))
            return jpeg(cv2.resize(rgb, (width, height), interpolation=cv2.INTER_AREA))
        return b""

    def plan(self, source: str, frame_id: str, then: Callable[[CameraPlan | None], object]) -> None:
        """Find where the cameras of a frame's scene stand, and tell."""
        dataset = self._sources[source].dataset
        key = (source, scene_of(dataset, frame_id))
        self._behind.submit(lambda: then(self._plans.get(key, lambda: (camera_plan(dataset, frame_id),))[0]))
