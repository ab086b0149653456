"""Frames that several clients may look at: loaded once, a few kept, with clouds; pictures of any frame and thing."""

from __future__ import annotations

import asyncio
import hashlib
import re
import shlex
import threading
import time
from collections import OrderedDict
from collections.abc import Callable, Hashable, Iterable, Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import TypeAlias
from weakref import WeakValueDictionary

import cv2
import numpy as np

from pipeline.answering.agreement.frames import SecondDetections, second_detections
from pipeline.answering.objects import PreparedFrame, SceneObject, all_objects, prepare_frame
from pipeline.answering.opening import Pipeline
from pipeline.datasets import Dataset
from pipeline.datasets.base import load_picture, scene_of
from pipeline.datasets.camera_plan import CameraPlan, camera_plan
from pipeline.datasets.plausible import depth_doubt
from pipeline.datasets.settings import Vector
from pipeline.datasets.up import with_frame_up
from pipeline.geometry.cloud import Cloud, cloud_of
from pipeline.geometry.frame import Frame
from pipeline.system.errors import InputError
from pipeline.system.recent import Recent
from spatialviz.app import memory

KEPT_FRAMES = 8
"""The frames used last, of 15 to 25 MB each at 640x480; those that a page shows are kept beside."""
AHEAD = 6
"""Frames that wait to be made ready; a newer wish takes the place of the oldest."""
YIELD_SECONDS = 0.01
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
    doubt : str
        What speaks against its depth, with the command that looks into it; empty where nothing does.
    """

    context: PreparedFrame
    objects: tuple[SceneObject, ...]
    problem: str = ""
    beside: SecondDetections | None = None
    told: ToldUp | None = None
    doubt: str = ""
    _thumbs: dict[bytes, bytes] = field(default_factory=dict, repr=False, compare=False)
    _painted: WeakValueDictionary[Hashable, np.ndarray] = field(
        default_factory=WeakValueDictionary, repr=False, compare=False
    )

    def thumb(self, bbox: np.ndarray) -> str:
        """Where the page finds a small picture of an object, made when it is first needed."""
        where = bbox.tobytes()
        if where not in self._thumbs:
            self._thumbs[where] = object_thumb(self.context.frame.rgb, bbox)
        return IMAGES.url(self._thumbs[where], "jpg") if self._thumbs[where] else ""

    @cached_property
    def cloud(self) -> Cloud:
        """Its points, made when they are first needed."""
        return cloud_of(self.context.frame, self.context.viewer)

    def painted(self, key: Hashable, colors: Callable[[], np.ndarray]) -> np.ndarray:
        """(N, 3) uint8 of its points in colours ((H, W, 3)) of a key: one array for all who show them."""
        found = self._painted.get(key)
        if found is None:
            found = self._painted[key] = self.cloud.painted(colors())
        return found


def _doubt(frame: Frame, root: Path) -> str:
    """What speaks against the depth of a frame of the dataset in `root`, with the command that looks into it."""
    found, command = depth_doubt(frame), "`spatialviz doctor"
    return "" if found is None else found.text.replace(command, f"{command} {shlex.quote(str(root))}")


@dataclass(eq=False)
class _Making:
    """A frame that is being made, by whoever asked first; `wanted` where a page waits for it."""

    opened: Pipeline
    frame: Future[LoadedFrame] = field(default_factory=Future)
    wanted: bool = False


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

    def kept(self, source: str, frame_id: str) -> LoadedFrame | None:
        """The frame where it is in memory; None where it would have to be loaded."""
        with self._lock:
            return self._loaded.get((source, frame_id)) or self._shown.get((source, frame_id))

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
        # No daemon: one that is ended in the midst of decoding a picture takes the program down with it.
        threading.Thread(target=self._make_ahead, daemon=False, name="ahead").start()

    def _make_ahead(self) -> None:
        while threading.main_thread().is_alive():
            with self._lock:
                self._ahead_runs = bool(self._ahead)
                if not self._ahead_runs:
                    break
                key, then = self._ahead.popitem(last=False)
            # Whoever opens it is told what is wrong with it.
            with suppress(InputError, KeyError):
                loaded = self._load(key, wanted=False)
                self._give_way()
                _ = loaded.cloud
                if then is not None:
                    then(loaded)
        # Frames were let go for those that came.
        memory.trim()

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
        objects, problem, second = tuple[SceneObject, ...](), "", None
        if opened.detector is not None:
            try:
                objects = all_objects(context, opened.detector)
                self._give_way(making)
                second = second_detections(opened, context, objects)
            except InputError as error:
                problem = str(error)
        doubt = _doubt(context.frame, opened.dataset.root)
        return LoadedFrame(context, objects, problem, second, self.told.get(key[0]), doubt)

    def _give_way(self, making: _Making | None = None) -> None:
        """What nobody waits for waits itself while a page is being answered."""
        while (making is None or not making.wanted) and self._busy() and threading.main_thread().is_alive():
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


def _resized(rgb: np.ndarray, width: float, height: float) -> np.ndarray:
    return cv2.resize(rgb, (max(1, round(width)), max(1, round(height))), interpolation=cv2.INTER_AREA)


def object_thumb(rgb: np.ndarray, bbox: np.ndarray, pixels: int = 68) -> bytes:
    """A square picture around an object as JPEG; empty where it lies outside the picture."""
    low, high = np.asarray(bbox, np.float64).reshape(2, 2)
    half, center = (high - low).max() * 0.58 + 2, (low + high) / 2
    left, top = np.maximum(center - half, 0).astype(int)
    right, bottom = np.minimum(center + half + 1, rgb.shape[1::-1]).astype(int)
    crop = rgb[top:bottom, left:right]
    if not crop.size:
        return b""
    scale = pixels / max(crop.shape[:2])
    return jpeg(_resized(crop, crop.shape[1] * scale, crop.shape[0] * scale), 78)


KEPT_BYTES = 96 * 2**20
"""The pictures used last are kept up to so much; one that is gone is made again with the next drawing."""


class Images:
    """Encoded pictures by a name that is made from their bytes."""

    def __init__(self) -> None:
        self._kept: OrderedDict[str, bytes] = OrderedDict()
        self._bytes = 0
        self._lock = threading.Lock()

    def url(self, data: bytes, kind: str) -> str:
        """Keep a picture, and say where the page finds it; `kind` is "jpg" or "png"."""
        name = f"{hashlib.sha256(data).hexdigest()[:32]}.{kind}"
        with self._lock:
            if name not in self._kept:
                self._bytes += len(data)
                self._kept[name] = data
            self._kept.move_to_end(name)
            while self._bytes > KEPT_BYTES and len(self._kept) > 1:
                self._bytes -= len(self._kept.popitem(last=False)[1])
        return f"/app/image/{name}"

    def get(self, name: str) -> bytes | None:
        """The picture of a name."""
        with self._lock:
            return self._kept.get(name)


IMAGES = Images()
"""Of this program. A name says nothing of what it shows, and nobody finds one without having the picture."""


def jpeg(rgb: np.ndarray, quality: int = 82) -> bytes:
    """A picture ((H, W, 3) uint8, RGB), encoded."""
    return cv2.imencode(".jpg", np.ascontiguousarray(rgb[..., ::-1]), [cv2.IMWRITE_JPEG_QUALITY, quality])[1].tobytes()


def jpeg_url(rgb: np.ndarray, quality: int = 82) -> str:
    """Where the page finds a picture ((H, W, 3) uint8, RGB)."""
    return IMAGES.url(jpeg(rgb, quality), "jpg")


def png_url(bgra: np.ndarray) -> str:
    """Where the page finds a picture with transparency ((H, W, 4) uint8, BGRA)."""
    return IMAGES.url(cv2.imencode(".png", bgra, [cv2.IMWRITE_PNG_COMPRESSION, 1])[1].tobytes(), "png")


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
            return jpeg(_resized(rgb, width, rgb.shape[0] * width / rgb.shape[1]))
        return b""

    def plan(self, source: str, frame_id: str, then: Callable[[CameraPlan | None], object]) -> None:
        """Find where the cameras of a frame's scene stand, and tell."""
        dataset = self._sources[source].dataset
        key = (source, scene_of(dataset, frame_id))
        self._behind.submit(lambda: then(self._plans.get(key, lambda: (camera_plan(dataset, frame_id),))[0]))
