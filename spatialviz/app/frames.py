"""Frames that several clients may look at: loaded once, a few kept, with small pictures of the rest."""

from __future__ import annotations

import threading
import time
from collections import OrderedDict
from collections.abc import Callable, Iterable
from concurrent.futures import Future
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TypeAlias
from weakref import WeakValueDictionary

import cv2
import numpy as np

from pipeline.answering.agreement.frames import SecondDetections, second_detections
from pipeline.answering.objects import PreparedFrame, SceneObject, all_objects, prepare_frame
from pipeline.answering.opening import Pipeline
from pipeline.datasets import Dataset
from pipeline.datasets.settings import Vector
from pipeline.datasets.up import with_frame_up
from pipeline.system.errors import InputError
from spatialviz.app.cloud import Cloud, cloud_of
from spatialviz.app.images import IMAGES, jpeg

KEPT_FRAMES = 8
"""The frames used last, of 15 to 25 MB each at 640x480; those that a page shows are kept beside."""
AHEAD = 6
"""Frames that wait to be made ready; a newer wish takes the place of the oldest."""
YIELD_SECONDS = 0.01
THUMB_WIDTH = 160
Key: TypeAlias = tuple[str, str]
"""Source and frame."""


@dataclass(frozen=True)
class ToldUp:
    """A surface that somebody says is level: its pixel, and up there in the camera frame."""

    frame_id: str
    pixel: tuple[int, int]
    up: Vector

    @property
    def words(self) -> str:
        """The same for `--level-at`."""
        return f"{self.frame_id}:{self.pixel[0]},{self.pixel[1]}"


@dataclass(frozen=True)
class LoadedFrame:
    """A frame with all its objects.

    Attributes
    ----------
    context : PreparedFrame
    objects : tuple of SceneObject
        Everything the detector finds in it; empty without a detector.
    problem : str
        Why a detector could not be asked about this frame.
    beside : SecondDetections or None
        What a second detector finds in it.
    told : ToldUp or None
        What was said of up since the program began.
    """

    context: PreparedFrame
    objects: tuple[SceneObject, ...]
    problem: str = ""
    beside: SecondDetections | None = None
    told: ToldUp | None = None
    _thumbs: dict[bytes, bytes] = field(default_factory=dict, repr=False, compare=False)

    def thumb(self, bbox: np.ndarray) -> str:
        """Where the page finds a small picture of an object, made when it is first needed."""
        where = bbox.tobytes()
        if where not in self._thumbs:
            self._thumbs[where] = object_thumb(self.context.frame.rgb, bbox)
        return IMAGES.url(self._thumbs[where], "jpg") if self._thumbs[where] else ""

    @cached_property
    def cloud(self) -> Cloud:
        """Its points, made when they are first needed."""
        return cloud_of(self.context)


class _Making:
    """A frame that is being made, by whoever asked first."""

    def __init__(self, opened: Pipeline) -> None:
        self.opened = opened
        self.frame: Future[LoadedFrame] = Future()
        self.wanted = False
        """A page waits for it."""


class FrameStore:
    """Loads frames of named sources and keeps the latest few; what is likely to be opened next it makes ready ahead.

    Parameters
    ----------
    sources : dict of str to Pipeline
    busy : callable
        Whether a page is being answered: nothing is made ahead meanwhile.
    """

    def __init__(self, sources: dict[str, Pipeline], busy: Callable[[], bool] = lambda: False) -> None:
        self.sources, self._busy = sources, busy
        self._loaded: OrderedDict[Key, LoadedFrame] = OrderedDict()
        self._shown: WeakValueDictionary[Key, LoadedFrame] = WeakValueDictionary()
        self._making: dict[Key, _Making] = {}
        self._ahead: OrderedDict[Key, Callable[[LoadedFrame], object] | None] = OrderedDict()
        self._ahead_runs = False
        self._thumbs: dict[Key, bytes | str] = {}
        self._lock = threading.Lock()
        self.told: dict[str, ToldUp] = {}
        """By source what was said last of its up."""
        self._untold: dict[str, Dataset] = {}

    def load(self, source: str, frame_id: str) -> LoadedFrame:
        """The frame, from memory where it is there.

        Raises
        ------
        InputError
            For a broken frame.
        """
        return self._load((source, frame_id), wanted=True)

    def prepare(
        self, source: str, frame_ids: Iterable[str], then: Callable[[LoadedFrame], object] | None = None
    ) -> None:
        """Make frames ready that may be opened next, the likeliest first, on one thread and while no page waits."""
        with self._lock:
            for frame_id in frame_ids:
                self._ahead[source, frame_id] = self._ahead.pop((source, frame_id), None) or then
            while len(self._ahead) > AHEAD:
                self._ahead.popitem(last=False)
            if self._ahead_runs or not self._ahead:
                return
            self._ahead_runs = True
        threading.Thread(target=self._make_ahead, daemon=True, name="ahead").start()

    def _make_ahead(self) -> None:
        while True:
            with self._lock:
                self._ahead_runs = bool(self._ahead)
                if not self._ahead_runs:
                    return
                key, then = self._ahead.popitem(last=False)
            # Whoever opens it is told what is wrong with it.
            with suppress(InputError, KeyError):
                loaded = self._load(key, wanted=False)
                self._give_way()
                _ = loaded.cloud
                if then is not None:
                    then(loaded)

    def _load(self, key: Key, wanted: bool) -> LoadedFrame:
        with self._lock:
            kept = self._loaded.get(key) or self._shown.get(key)
            if kept is not None:
                self._keep(key, kept)
                return kept
            making = self._making.get(key)
            mine = making is None
            if making is None:
                making = self._making[key] = _Making(self.sources[key[0]])
            making.wanted |= wanted
        if mine:
            try:
                making.frame.set_result(self._made(key, making))
            except BaseException as error:
                making.frame.set_exception(error)
            with self._lock:
                # What was said of up meanwhile may have made it old.
                if self._making.get(key) is making:
                    del self._making[key]
                    if making.frame.exception() is None:
                        self._keep(key, making.frame.result())
        return making.frame.result()

    def _keep(self, key: Key, loaded: LoadedFrame) -> None:
        self._loaded[key] = self._shown[key] = loaded
        self._loaded.move_to_end(key)
        while len(self._loaded) > KEPT_FRAMES:
            self._loaded.popitem(last=False)

    def _made(self, key: Key, making: _Making) -> LoadedFrame:
        opened = making.opened
        self._give_way(making)
        raw = opened.dataset.load(key[1])
        self._give_way(making)
        context = prepare_frame(opened.dataset, raw, opened.config.lift)
        self._give_way(making)
        objects: tuple[SceneObject, ...] = ()
        problem, second = "", None
        if opened.detector is not None:
            try:
                objects = all_objects(context, opened.detector)
                self._give_way(making)
                second = second_detections(opened, context, objects)
            except InputError as error:
                problem = str(error)
        self._thumbs[key] = jpeg(_small(context.frame.rgb))
        return LoadedFrame(context, objects, problem, second, self.told.get(key[0]))

    def _give_way(self, making: _Making | None = None) -> None:
        """What nobody waits for waits itself while a page is being answered."""
        while (making is None or not making.wanted) and self._busy():
            time.sleep(YIELD_SECONDS)

    def tell_up(self, source: str, told: ToldUp | None) -> None:
        """Take what is said of a source's up, for all clients; None takes back all that was said."""
        with self._lock:
            opened = self.sources[source]
            if told is None:
                self.told.pop(source, None)
                dataset = self._untold.pop(source, opened.dataset)
            else:
                self.told[source] = told
                self._untold.setdefault(source, opened.dataset)
                dataset = with_frame_up(opened.dataset, told.frame_id, told.up)
            self.sources[source] = replace(opened, dataset=dataset)
            for known in (self._loaded, self._shown, self._making):
                for key in [key for key in list(known) if key[0] == source]:
                    known.pop(key, None)

    def thumb(self, source: str, frame_id: str) -> tuple[str, str]:
        """(where the page finds a small picture, ""), or ("", reason) for a broken frame."""
        key = (source, frame_id)
        if key not in self._thumbs:
            try:
                self._thumbs[key] = jpeg(_small(self.sources[source].dataset.load(frame_id).rgb))
            except InputError as error:
                self._thumbs[key] = str(error)
        kept = self._thumbs[key]
        return ("", kept) if isinstance(kept, str) else (IMAGES.url(kept, "jpg"), "")


def _small(rgb: np.ndarray) -> np.ndarray:
    height = max(1, round(rgb.shape[0] * THUMB_WIDTH / rgb.shape[1]))
    return cv2.resize(rgb, (THUMB_WIDTH, height), interpolation=cv2.INTER_AREA)


def object_thumb(rgb: np.ndarray, bbox: np.ndarray, pixels: int = 68) -> bytes:
    """A square picture around an object as JPEG; empty where it lies outside the picture."""
    height, width = rgb.shape[:2]
    x0, y0, x1, y1 = (float(v) for v in bbox)
    half = max(x1 - x0, y1 - y0) * 0.58 + 2
    cx, cy = (x0 + x1) / 2, (y0 + y1) / 2
    left, top = int(max(cx - half, 0)), int(max(cy - half, 0))
    right, bottom = int(min(cx + half + 1, width)), int(min(cy + half + 1, height))
    crop = rgb[top:bottom, left:right]
    if not crop.size:
        return b""
    scale = pixels / max(crop.shape[:2])
    size = (max(1, round(crop.shape[1] * scale)), max(1, round(crop.shape[0] * scale)))
    return jpeg(cv2.resize(crop, size, interpolation=cv2.INTER_AREA), 78)
