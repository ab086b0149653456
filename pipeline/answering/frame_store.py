"""Frames shared by several viewers: objects, points and colours, loaded once, a few kept, the next prepared."""

from __future__ import annotations

import shlex
import threading
import time
from collections import OrderedDict
from collections.abc import Callable, Collection, Hashable, Iterable, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import suppress
from dataclasses import field, replace
from functools import cached_property
from pathlib import Path
from typing import TypeAlias
from weakref import WeakValueDictionary

import numpy as np

from pipeline.answering.objects import PreparedFrame, SceneObject, all_objects, prepare_frame
from pipeline.answering.pipeline import Pipeline
from pipeline.datasets import Dataset
from pipeline.datasets.base import load_picture
from pipeline.datasets.frame_reports import CameraPlan, camera_plan
from pipeline.datasets.odd_frames import OddFrame, odd_frames
from pipeline.datasets.plausible import depth_doubt
from pipeline.datasets.settings import Vector
from pipeline.datasets.timeline import Timeline, timeline_of
from pipeline.datasets.up import with_frame_up
from pipeline.geometry.cleaning import Pixel
from pipeline.geometry.cloud import Cloud, cloud_of
from pipeline.geometry.frame import Frame
from pipeline.geometry.palette import DROPPED, ON_DARK, Role, depth_colors, instance_colors
from pipeline.system.encoded_pictures import jpeg, resized, thumbnail
from pipeline.system.errors import InputError
from pipeline.system.freed_memory import trim
from pipeline.system.frozen import dataclass
from pipeline.system.recent import Recent

KEPT_BYTES, FEWEST_KEPT = 128 * 2**20, 3
"""Of the frames used last, of 15 to 35 MB each at 640x480: so many, but the one that is looked at and its neighbours
stay however large they are. Those that somebody holds are kept beside."""
PIXEL_BYTES = 40
"""Of a frame, its cloud and its depth edges, beside the masks."""
AHEAD = 6
"""Frames that wait to be made ready; a newer wish takes the place of the oldest."""
YIELD_SECONDS = 0.01
Key: TypeAlias = tuple[str, str]
"""Source and frame."""


@dataclass(frozen=True)
class UpHint:
    """Level surface pointed out by a person: its pixel, and up there in the camera frame."""

    frame_id: str
    pixel: tuple[int, int]
    up: Vector

    @property
    def words(self) -> str:
        """Pixel for `--level-at`."""
        return f"{self.frame_id}:{self.pixel[0]},{self.pixel[1]}"


@dataclass(frozen=True)
class LoadedFrame:
    """Frame with all its objects."""

    context: PreparedFrame
    objects: tuple[SceneObject, ...]  # Everything the detector finds in it; empty without a detector
    problem: str = ""  # Why a detector could not be asked about this frame
    up_hint: UpHint | None = None  # What was said of up since the program began
    doubt: str = ""  # What speaks against its depth, with the command that looks into it; empty where nothing does
    _thumbs: dict[bytes, bytes] = field(default_factory=dict, repr=False, compare=False)
    photos: Recent[Hashable, bytes] = field(default_factory=lambda: Recent(4), repr=False, compare=False)
    """Its last pictures as JPEG, by their colours: they go with it."""
    _painted: WeakValueDictionary[Hashable, np.ndarray] = field(
        default_factory=WeakValueDictionary, repr=False, compare=False
    )

    def thumb(self, bbox: np.ndarray) -> bytes:
        """Small picture of an object as JPEG, made on first use; empty outside the frame."""
        where = bbox.tobytes()
        if where not in self._thumbs:
            self._thumbs[where] = thumbnail(self.context.frame.rgb, bbox)
        return self._thumbs[where]

    @property
    def nbytes(self) -> int:
        """Approximate memory, bytes."""
        masks = len(self.context.frame.annotations) + len(self.objects)
        return self.context.frame.depth.size * (PIXEL_BYTES + masks)

    @cached_property
    def cloud(self) -> Cloud:
        """Points, made on first use."""
        return cloud_of(self.context.frame, self.context.viewer)

    def painted(self, key: Hashable, colors: Callable[[], np.ndarray]) -> np.ndarray:
        """(N, 3) uint8: points in colours ((H, W, 3)) of a key, a single array shared by all viewers."""
        found = self._painted.get(key)
        if found is None:
            found = self._painted[key] = self.cloud.painted(colors())
        return found


def _doubt(frame: Frame, root: Path) -> str:
    """Doubt about the depth of a frame of the dataset in `root`, with the command to examine it."""
    found, command = depth_doubt(frame), "`spatialviz doctor"
    return "" if found is None else found.text.replace(command, f"{command} {shlex.quote(str(root))}")


@dataclass(eq=False)
class _Making:
    """Frame in the making, by its first caller; `wanted` while somebody waits."""

    opened: Pipeline
    frame: Future[LoadedFrame] = field(default_factory=Future)
    wanted: bool = False


class FrameStore:
    """Store of frames of named pipelines: keeps the latest few, and prepares likely next ones.

    Parameters
    ----------
    busy : callable
        Whether somebody is being answered: nothing is made ahead meanwhile.
    """

    def __init__(self, sources: dict[str, Pipeline], busy: Callable[[], bool] = lambda: False) -> None:
        self.sources, self._busy = sources, busy
        self._loaded: OrderedDict[Key, LoadedFrame] = OrderedDict()
        self._shown: WeakValueDictionary[Key, LoadedFrame] = WeakValueDictionary()
        self._making: dict[Key, _Making] = {}
        self._ahead: OrderedDict[Key, Callable[[LoadedFrame], object] | None] = OrderedDict()
        self._ahead_runs = False
        self._lock = threading.Lock()
        self._beside = ThreadPoolExecutor(1, "cloud")
        self.up_hints: dict[str, UpHint] = {}
        """By source what was said last of its up."""
        self._untold: dict[str, Dataset] = {}

    def load(self, source: str, frame_id: str) -> LoadedFrame:
        """Load a frame, from memory if kept; InputError for a broken frame.

        Raises
        ------
        InputError
            For a broken frame.
        """
        return self._load((source, frame_id), wanted=True)

    def kept(self, source: str, frame_id: str) -> LoadedFrame | None:
        """Frame in memory; None if not loaded."""
        with self._lock:
            return self._loaded.get((source, frame_id)) or self._shown.get((source, frame_id))

    def prepare(
        self, source: str, frame_ids: Iterable[str], then: Callable[[LoadedFrame], object] | None = None
    ) -> None:
        """Prepare likely next frames, the likeliest first, on a single thread and while nobody waits."""
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
                self.give_way()
                _ = loaded.cloud
                if then is not None:
                    then(loaded)
        # Frames were let go for those that came.
        trim()

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
        while len(self._loaded) > FEWEST_KEPT and sum(x.nbytes for x in self._loaded.values()) > KEPT_BYTES:
            self._loaded.popitem(last=False)

    def let_go(self) -> None:
        """Drop all frames but those in use."""
        with self._lock:
            self._loaded.clear()

    def _made(self, key: Key, making: _Making) -> LoadedFrame:
        opened = making.opened
        self.give_way(making)
        raw = opened.dataset.load(key[1])
        self.give_way(making)
        context = prepare_frame(opened.dataset, raw, opened.config.lift)
        self.give_way(making)
        # Whoever waits is shown its points, made beside its objects.
        cloud = self._beside.submit(cloud_of, context.frame, context.viewer) if making.wanted else None
        objects, problem = tuple[SceneObject, ...](), ""
        if opened.detector is not None:
            try:
                objects = all_objects(context, opened.detector)
            except InputError as error:
                problem = str(error)
        doubt = _doubt(context.frame, opened.dataset.root)
        loaded = LoadedFrame(context, objects, problem, self.up_hints.get(key[0]), doubt)
        if cloud is not None:
            loaded.__dict__["cloud"] = cloud.result()
        return loaded

    def give_way(self, making: _Making | None = None) -> None:
        """Pause unawaited work while somebody is being answered."""
        while (making is None or not making.wanted) and self._busy() and threading.main_thread().is_alive():
            time.sleep(YIELD_SECONDS)

    def set_up_hint(self, source: str, hint: UpHint | None) -> None:
        """Set up of a pipeline, for every later load; None takes back all."""
        with self._lock:
            opened = self.sources[source]
            if hint is None:
                self.up_hints.pop(source, None)
                dataset = self._untold.pop(source, opened.dataset)
            else:
                self.up_hints[source] = hint
                self._untold.setdefault(source, opened.dataset)
                dataset = with_frame_up(opened.dataset, hint.frame_id, hint.up)
            self.sources[source] = replace(opened, dataset=dataset)
            for known in (self._loaded, self._shown, self._making):
                for key in [key for key in list(known) if key[0] == source]:
                    known.pop(key, None)


KEPT_PICTURES = 600


class BackgroundPictures:
    """Thumbnails of frames, plans of cameras and odd frames, of several pipelines: made on own threads, a few kept.

    `pause` is called between the frames of long work.
    """

    def __init__(self, sources: Mapping[str, Pipeline], pause: Callable[[], object] = lambda: None) -> None:
        self._sources, self._pause = sources, pause
        self._behind = ThreadPoolExecutor(2, "pictures")
        self._pictures: Recent[tuple[str, str, int], bytes] = Recent(KEPT_PICTURES)
        self._timelines: dict[str, Timeline] = {}
        self._odd: dict[str, Future[tuple[OddFrame, ...]]] = {}

    def picture(self, source: str, frame_id: str, width: int) -> Future[bytes]:
        """Thumbnail of a frame as JPEG of a width in pixels; empty for a broken frame."""
        key = source, frame_id, width
        return self._behind.submit(lambda: self._pictures.get(key, lambda: self._draw(*key)))

    def _draw(self, source: str, frame_id: str, width: int) -> bytes:
        with suppress(InputError):
            return jpeg(resized(load_picture(self._sources[source].dataset, frame_id).rgb, width))
        return b""

    def plan(
        self, source: str, frame_id: str, then: Callable[[CameraPlan | None], object], also: Collection[str] = ()
    ) -> None:
        """Find the cameras of a frame's scene, as `camera_plan`, and call back."""
        dataset = self._sources[source].dataset
        self._behind.submit(lambda: then(camera_plan(dataset, frame_id, also=also)))

    def timeline(self, source: str) -> Timeline:
        """Timeline of a source, made on first use."""
        if source not in self._timelines:
            self._timelines[source] = timeline_of(self._sources[source].dataset)
        return self._timelines[source]

    def odd(self, source: str, then: Callable[[tuple[OddFrame, ...]], object]) -> None:
        """Find the odd frames of a source, once, and call back."""
        made = Future[tuple[OddFrame, ...]]()
        kept = self._odd.setdefault(source, made)
        if kept is made:
            # No daemon, as in `FrameStore.prepare`, and no pool, whose end would wait for the last frame.
            threading.Thread(target=self._find_odd, args=(source, made), daemon=False, name="odd").start()
        kept.add_done_callback(lambda found: then(found.result()))

    def _find_odd(self, source: str, made: Future[tuple[OddFrame, ...]]) -> None:
        def go_on(*_: int) -> None:
            self._pause()
            if not threading.main_thread().is_alive():
                raise SystemExit

        made.set_result(odd_frames(self._sources[source].dataset, progress=go_on))
        trim()


def frame_colors(
    mode: str,
    frame: Frame,
    objects: Sequence[SceneObject],
    roles: Mapping[int, Role],
    dark: bool,
) -> np.ndarray:
    """(H, W, 3) uint8 colours of a frame's pixels.

    `mode`: "rgb", "objects" (masks in colours, the larger below), "depth" or "evidence" (what was cleaned away, and
    why); `objects`: without any, "objects" and "evidence" are the picture itself; `roles`: mapping of int to Role:
    places in `objects` that have the colour of a role.
    """
    if mode == "depth":
        return depth_colors(frame.depth)
    if mode == "rgb" or not objects:
        return frame.rgb
    # Of each sum of three bytes, and below of each byte, once.
    greys = (np.arange(3 * 256) / 3 * 0.55 + (20 if dark else 110)).astype(np.uint8)
    red, green, blue = np.moveaxis(frame.rgb, 2, 0)
    sums = np.add(red, green, dtype=np.uint16) + blue
    image = np.repeat(greys[sums][..., None], 3, axis=2)
    order = sorted(range(len(objects)), key=lambda i: -int(objects[i].lifted.quality.mask_pixels))
    if mode == "objects":
        calm, pixels = instance_colors(len(objects)), image.reshape(-1, 3)
        for i in order:
            color = np.array(ON_DARK[roles[i]] if i in roles else calm[i])
            tinted = (np.arange(256)[:, None] * 0.35 + color * 0.65).astype(np.uint8)
            at = np.flatnonzero(objects[i].mask)
            pixels[at] = tinted[pixels[at], np.arange(3)]
        return image
    for i in order:
        evidence = objects[i].lifted.evidence
        if evidence is None:
            continue
        h, w = evidence.codes.shape
        window = image[evidence.y0 : evidence.y0 + h, evidence.x0 : evidence.x0 + w]
        source = frame.rgb[evidence.y0 : evidence.y0 + h, evidence.x0 : evidence.x0 + w]
        kept = evidence.codes == Pixel.KEPT
        window[kept] = source[kept]
        for reason, color in DROPPED.items():
            window[evidence.codes == reason] = color
    return image
