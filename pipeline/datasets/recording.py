"""Base of recording readers: a layout lists files and facts of each frame, and decoding is common."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TypeVar

import cv2
import numpy as np

from pipeline.datasets.base import unknown_id
from pipeline.datasets.cameras import NOTHING, Stated
from pipeline.datasets.files import Blob
from pipeline.datasets.images import (
    END_OF_RANGE,
    exif_focal,
    picture_size,
    read_color,
    read_depth,
    read_stored,
    valid_pixels,
)
from pipeline.datasets.settings import DEPTH_SCALE, FILE_NAME, INTRINSICS, TURNS, Settings, unit_notes
from pipeline.datasets.turned import turn_to
from pipeline.geometry.camera import Camera, intrinsics, standard_poses
from pipeline.geometry.frame import Annotation, Frame
from pipeline.geometry.registration import Registration, registered
from pipeline.system.errors import InputError, in_file, needed, require
from pipeline.system.frozen import dataclass

Value = TypeVar("Value")
SAME_SHAPE = 0.02
"""Colour and depth are of one camera where their aspect ratios differ by less than this share.
ScanNet's own, 1296x968 and 640x480, differ by 0.4 %."""
WITH_HEADER = (".png", ".jpg", ".jpeg", ".pgm", ".ppm")
MOST_LENGTHS = 1000.0
"""A focal length is longer than a picture's longest side by no more, and no shorter."""
LONGEST_ALONE = 1600
"""A picture without depth is made so long at most: networks look at less, and points cost time."""
NEAREST_CUT_M = 4.0
"""Depth is cut no nearer; a wall that is seen head on may stand at any distance."""
FLOATS = f"floating-point depth is taken for metres: {DEPTH_SCALE} tells another unit"
FARTHEST_MEDIAN_M = 100.0
"""Floats of a larger median are not taken for metres."""
BROWSED_MEDIAN_M = 2.0
"""The median depth that is shown where nothing tells the unit."""


@dataclass(frozen=True)
class DepthRule:
    """Storage of depth in a format, where files are silent."""

    units_per_metre: float | None = None
    """The format's own unit. None: only a file or a person can tell; floats are metres."""
    whose: str = ""  # Whose unit that is, for the note: "ScanNet's"
    nothing: int | None = None  # A stored value, besides 0, that means nothing was measured
    rotated: int = 0  # By how many bits the stored values are rotated to the left
    farthest: float = np.inf  # Depth beyond is left out, metres


Annotate = Callable[[tuple[int, int], list[str]], tuple[Annotation, ...]]
"""The annotations of a frame of (height, width) pixels; what is odd goes to the list of notes."""


@dataclass(frozen=True)
class Listed:
    """Files and facts of a frame, not decoded."""

    color: Blob
    depth: Blob | None  # None where it is estimated of the colour
    stated: Stated = NOTHING  # What files say of its camera
    pose: np.ndarray | None = None  # (4, 4) float64 or None: T_world_camera, metres
    annotate: Annotate | None = None
    up: np.ndarray | None = None  # (3,) float64 or None: What the dataset declares, camera frame
    valid: Blob | None = None  # What is 0 where the depth does not count


class Recording:
    """Base class of file readers; subclasses set `frame_ids` and implement `_listed`."""

    format = ""
    rule = DepthRule()
    many_masks = False
    """Whether the annotations of a frame are many pictures, which `again` names and nobody reads to look through."""
    again = ""
    """Pattern of files of the format that say what others say, by their paths: they need not be read."""
    one_size = False
    """Whether colour has the size of the depth, and is never resized to it."""
    documented: tuple[float, float, float, float] | None = None
    """(fx, fy, cx, cy) or None: The format's own camera for 640x480, where no file states one."""
    camera_file = ""
    """What a camera file of the format is called, for a message: "camera-intrinsics.txt or "."""
    frame_ids: tuple[str, ...] = ()
    class_names: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()

    def __init__(self, root: Path, settings: Settings) -> None:
        self.root = root
        self._settings = settings
        if self.rule.units_per_metre is not None:
            self.notes = unit_notes(settings, self.rule.units_per_metre, self.rule.whose)

    def load(self, frame_id: str) -> Frame:
        """Decode a frame; see `Dataset.load`."""
        return self._decoded(frame_id)

    def load_picture(self, frame_id: str) -> Frame:
        """Decode a frame without annotations."""
        return self._decoded(frame_id, annotated=False)

    def load_pose(self, frame_id: str) -> np.ndarray | None:
        """Pose T_world_camera (4, 4) of a frame, without decoding."""
        if self._settings.registration is not None:
            # A warp moves the pose.
            return self.load_picture(frame_id).camera.T_world_camera
        return self._standard(self._listed(frame_id, []).pose)

    def load_depth(self, frame_id: str) -> np.ndarray | None:
        """Measured depth of a frame, without colour; see `base.load_depth`."""
        found = self._listed(frame_id, [])
        if found.depth is None:
            return None
        metres, unknown = self._measured(found, found.depth)
        return np.where(metres > 0, np.float32(np.nan), metres) if unknown else metres

    def peek(self, frame_id: str) -> tuple[int, int]:
        """Width and height of a frame by the headers of its files, 0 where only decoding tells them.

        Raises
        ------
        InputError
            A file is missing, or is no picture by its header.
        """
        found, size = self._listed(frame_id, []), (0, 0)
        for blob in (found.color, found.depth):
            if isinstance(blob, Path):
                require(blob.is_file(), f"{blob.name} is missing", path=blob)
                if blob.suffix.lower() in WITH_HEADER:
                    size = needed(picture_size(blob), "the picture cannot be read", cause="by its header", path=blob)
        return size

    def depth_units(self, frame_id: str) -> float:
        """Depth units in a metre by which a frame is read."""
        stated = self._listed(frame_id, []).stated.units_per_metre
        return self._settings.depth_scale or stated or self.rule.units_per_metre or 1.0

    def look_through(self, frame_id: str) -> list[Path]:
        """Read what stands beside the pictures of a frame, and name these, which are not decoded."""
        found = self._listed(frame_id, [])
        if found.annotate is not None and not self.many_masks:
            found.annotate((1, 1), [])
        return [blob for blob in (found.color, found.depth, found.valid) if isinstance(blob, Path)]

    def _listed(self, frame_id: str, notes: list[str]) -> Listed:
        """Files and facts of a frame (subclasses); remarks are appended to `notes`."""
        raise NotImplementedError

    def _decoded(self, frame_id: str, annotated: bool = True) -> Frame:
        notes: list[str] = []
        found = self._listed(frame_id, notes)
        # A picture whose camera is known as it is stored stays as it is stored.
        rgb = read_color(found.color, upright=found.depth is None and found.stated.K is None)
        if self._settings.color_turned is not None:
            rgb = np.ascontiguousarray(np.rot90(rgb, TURNS[self._settings.color_turned]))
        metres, unknown = self._metres(found, rgb, notes)
        whole, size = (rgb.shape[0], rgb.shape[1]), (metres.shape[0], metres.shape[1])
        if whole != size:
            rgb = self._resized(rgb, metres, found, notes, frame_id == self.frame_ids[0])
        K = self._intrinsics(found, size, whole, notes)
        if K is None and self._settings.browse:
            # Any camera shows the picture; that it is none is kept with it.
            K, unknown = _centred(size[1], size), (INTRINSICS, *unknown)
        annotations = found.annotate(size, notes) if annotated and found.annotate is not None else ()
        camera = self._camera_of(K, size, found, unknown)
        if unknown and not self._settings.estimated:
            notes.append(f"nothing can be measured, sizes are made up: {' and '.join(unknown)}")
        if self._settings.registration is not None:
            metres, camera = registered(metres, camera, Registration(*self._settings.registration))
        with in_file(found.depth or found.color):
            return Frame(frame_id, rgb, metres, camera, annotations, tuple(notes))

    def _camera_of(
        self, K: np.ndarray | None, size: tuple[int, int], found: Listed, unknown: tuple[str, ...]
    ) -> Camera:
        """Checked camera of a frame; errors name the file that states it."""
        height, width = size
        path = found.stated.path or found.color
        K = needed(K, "the camera is not known", expected=INTRINSICS, path=path)
        with in_file(path):
            camera = Camera(K, width, height, self._standard(found.pose), untold=unknown)
        require(
            (-0.5 * width <= camera.cx <= 1.5 * width and -0.5 * height <= camera.cy <= 1.5 * height),
            f"the principal point is far outside the {width}x{height} image",
            got=f"cx={camera.cx:g}, cy={camera.cy:g}",
            cause="are these the intrinsics of another image size?",
            path=path,
        )
        longest = max(width, height)
        require(
            all(longest / MOST_LENGTHS < focal < longest * MOST_LENGTHS for focal in (camera.fx, camera.fy)),
            f"no focal length of a {width}x{height} image",
            got=f"fx={camera.fx:g}, fy={camera.fy:g}",
            path=path,
        )
        return camera if found.up is None else camera.with_up(found.up, "declared")

    def _standard(self, pose: np.ndarray | None) -> np.ndarray | None:
        """Pose by the convention of the settings."""
        convention = self._settings.poses
        return pose if pose is None or convention is None else standard_poses(pose, convention)

    def _intrinsics(
        self, found: Listed, size: tuple[int, int], whole: tuple[int, int], notes: list[str]
    ) -> np.ndarray | None:
        """Intrinsics (3, 3) by the settings, a file, the format or the picture's EXIF; None where nothing says them.
        `size` and `whole` (height, width): Of the frame, and of the colour before it was resized."""
        (height, width), (tall, wide) = size, whole
        given, stated = self._settings.intrinsics, found.stated
        if given is not None:
            stated = Stated(intrinsics(*given), (wide, tall) if found.depth is None else (width, height))
        K = stated.scaled((width, height), (wide, tall))
        if K is None and self.documented is not None and (size == (480, 640) or not self._settings.browse):
            require(
                size == (480, 640),
                f"the camera is not known: {self.rule.whose.removesuffix(' own')} own intrinsics are for 640x480",
                got=f"{width}x{height}",
                expected=f"{self.camera_file}{INTRINSICS}",
                path=found.color,
            )
            K = intrinsics(*self.documented)
        focal = exif_focal(found.color, height, width) if K is None and self._settings.estimated else None
        if focal is None:
            return K
        notes.append(f"the focal length is that of the picture's EXIF, {focal[1]:g} mm as of 35 mm film")
        return _centred(focal[0], size)

    def _metres(self, found: Listed, rgb: np.ndarray, notes: list[str]) -> tuple[np.ndarray, tuple[str, ...]]:
        """Depth (H, W) float32 metres, and the option for the unit where unknown. A stand-in of one metre where it is
        to be estimated, smaller than a large picture that nothing is drawn on."""
        if found.depth is None:
            shrink = 1.0 if found.annotate is not None else min(1.0, LONGEST_ALONE / max(rgb.shape[:2]))
            return np.ones((round(rgb.shape[0] * shrink), round(rgb.shape[1] * shrink)), np.float32), ()
        return self._measured(found, found.depth, notes)

    def _measured(
        self, found: Listed, depth: Blob, notes: list[str] | None = None
    ) -> tuple[np.ndarray, tuple[str, ...]]:
        """Measured depth as `_metres`."""
        rule, unknown = self.rule, ()
        units = self._settings.depth_scale or found.stated.units_per_metre or rule.units_per_metre
        if units is None and self._settings.browse:
            stored = read_stored(depth)
            if stored.dtype.kind != "f":
                units = float(np.median(stored[stored > 0])) / BROWSED_MEDIAN_M if stored.any() else 1.0
                unknown = (DEPTH_SCALE,)
        metres = read_depth(depth, units, rule.nothing, rule.rotated, notes)
        if units is None and (median := beyond_metres(metres)):
            require(
                self._settings.browse,
                "floating-point depth that cannot be metres",
                got=f"a median of {median:.4g}",
                expected=DEPTH_SCALE,
                cause="a wrong unit? 1000 for millimetres, the ZED SDK's own",
                path=depth,
            )
            metres *= np.float32(BROWSED_MEDIAN_M / median)
            unknown = (DEPTH_SCALE,)
        if found.valid is not None:
            metres[~valid_pixels(found.valid, metres.shape)] = 0
        if np.isfinite(rule.farthest):
            metres[metres > rule.farthest] = 0
        elif notes is not None and (share := _cut_off(metres)):
            notes.append(f"{share:.0%} of the pixels lie at {metres.max():g} m, the farthest: is depth cut there?")
        return metres, unknown

    def _resized(self, rgb: np.ndarray, metres: np.ndarray, found: Listed, notes: list[str], first: bool) -> np.ndarray:
        """Colour resized to the depth's size; InputError for another aspect ratio."""
        (height, width), whole = metres.shape, rgb.shape[:2]
        measured = found.depth is not None
        off = abs(whole[1] * height / (whole[0] * width) - 1)
        if measured and off > SAME_SHAPE and abs(whole[0] * height / (whole[1] * width) - 1) <= SAME_SHAPE:
            ways = " or ".join(f'"{turn}"' for turn in TURNS)
            turn = f'"{told}"' if (told := turn_to(rgb, metres)) else f"{ways}, which the outlines do not tell"
            raise InputError(
                "colour and depth are turned against one another by 90 degrees",
                got=f"colour {whole[1]}x{whole[0]}, depth {width}x{height}",
                expected=f"color_turned = {turn} in {FILE_NAME}",
                cause="phones store depth as the sensor lies; the intrinsics are then those of the turned picture",
                path=found.depth,
            )
        require(
            not measured or (off <= SAME_SHAPE and not self.one_size),
            "colour and depth differ in size",
            got=f"depth {width}x{height}",
            expected=f"{whole[1]}x{whole[0]} as {found.color.name}",
            cause="is this the raw depth and not the one registered to the colour image?",
            path=found.depth,
        )
        if first or not measured:
            target = "the depth's {} everywhere" if measured else "{} before its depth is estimated"
            notes.append(f"colour of {whole[1]}x{whole[0]} is resized to {target.format(f'{width}x{height}')}")
        # OpenCV's average over areas becomes nearest-neighbour where the image grows.
        return cv2.resize(rgb, (width, height), interpolation=cv2.INTER_AREA if whole[0] > height else cv2.INTER_LINEAR)

    def _ask_for(self, seen: str, stated: Stated, floats: bool = False) -> None:
        """Raise InputError for a camera or a unit that nothing tells, unless frames are only browsed. `floats`: Depth
        is stored as floats, which are taken for metres."""
        given = self._settings
        camera = all(known is None for known in (given.intrinsics, self.documented, stated.K))
        unit = all(k is None for k in (given.depth_scale, self.rule.units_per_metre, stated.units_per_metre))
        if unit and floats and FLOATS not in self.notes:
            self.notes += (FLOATS,)
        named = ((INTRINSICS, "a camera", camera), (DEPTH_SCALE, "the depth's unit", unit and not floats))
        missing = [(option, name) for option, name, lacks in named if lacks]
        if not missing or given.browse:
            return
        options, names = zip(*missing, strict=True)
        several = len(missing) > 1
        raise InputError(
            f"{seen}; {' and '.join(names)} {'are' if several else 'is'} missing",
            expected=" and ".join(options) + (f", in one {INTRINSICS},UNITS_PER_METRE" if several else ""),
            cause=f"{'1000 for millimetres; ' if DEPTH_SCALE in options else ''}or kept in {FILE_NAME} beside the data",
            path=self.root,
        )

    def _found(self, table: Mapping[str, Value], frame_id: str) -> Value:
        """Entry of a frame in a table of all frames; InputError for an unknown frame."""
        if frame_id not in table:
            raise unknown_id(self.frame_ids, frame_id, self.root)
        return table[frame_id]


def beyond_metres(depth: np.ndarray) -> float:
    """The median of depth (H, W), where it is too far for metres; else 0."""
    sparse = depth[::4, ::4]
    median = float(np.median(sparse[sparse > 0])) if (sparse > 0).any() else 0.0
    return median if median > FARTHEST_MEDIAN_M else 0.0


def _cut_off(metres: np.ndarray) -> float:
    """Share of the pixels of depth (H, W) at its farthest, where that is a round distance that many have; else 0."""
    farthest = float(np.max(metres, initial=0.0))
    if farthest < NEAREST_CUT_M or abs(farthest - round(farthest)) > 1e-4:
        return 0.0
    share = float(np.mean(metres >= farthest - 1e-4))
    return share if share > END_OF_RANGE else 0.0


def _centred(focal: float, size: tuple[int, ...]) -> np.ndarray:
    """Intrinsics (3, 3) with the principal point in the middle of a picture of (height, width)."""
    return intrinsics(focal, focal, (size[1] - 1) / 2, (size[0] - 1) / 2)
