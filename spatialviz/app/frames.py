"""Frames that several clients may look at: loaded once, a few kept, with small pictures of the rest."""

from __future__ import annotations

import threading
from collections import OrderedDict
from dataclasses import dataclass, field, replace
from functools import cached_property

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

KEPT_FRAMES = 4
THUMB_WIDTH = 160


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


class FrameStore:
    """Loads frames of named sources and keeps the latest few."""

    def __init__(self, sources: dict[str, Pipeline]) -> None:
        self.sources = sources
        self._loaded: OrderedDict[tuple[str, str], LoadedFrame] = OrderedDict()
        self._thumbs: dict[tuple[str, str], bytes | str] = {}
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
        key = (source, frame_id)
        with self._lock:
            if key in self._loaded:
                self._loaded.move_to_end(key)
                return self._loaded[key]
        opened = self.sources[source]
        context = prepare_frame(opened.dataset, opened.dataset.load(frame_id), opened.config.lift)
        objects: tuple[SceneObject, ...] = ()
        problem, second = "", None
        if opened.detector is not None:
            try:
                objects = all_objects(context, opened.detector)
                second = second_detections(opened, context, objects)
            except InputError as error:
                problem = str(error)
        loaded = LoadedFrame(context, objects, problem, second, self.told.get(source))
        with self._lock:
            self._loaded[key] = loaded
            while len(self._loaded) > KEPT_FRAMES:
                self._loaded.popitem(last=False)
        self._thumbs[key] = jpeg(_small(context.frame.rgb))
        return loaded

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
            for key in [key for key in self._loaded if key[0] == source]:
                del self._loaded[key]

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
