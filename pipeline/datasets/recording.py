"""Base of recording readers: a layout lists files and facts of each frame, and decoding is common."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TypeVar

import cv2
import numpy as np

from pipeline.datasets.base import load_picture, unknown_id
from pipeline.datasets.camera_files import NOTHING, Stated
from pipeline.datasets.cameras import differ_in_size, known_intrinsics, make_camera, make_frame, one_file
from pipeline.datasets.files import Blob
from pipeline.datasets.images import exif_focal, read_color, read_depth, read_stored
from pipeline.datasets.pairing import Pair
from pipeline.datasets.settings import DEPTH_SCALE, FILE_NAME, INTRINSICS, Settings, unit_notes
from pipeline.geometry.camera import intrinsics
from pipeline.geometry.frame import Annotation, Frame
from pipeline.geometry.pose_convention import standard_poses
from pipeline.geometry.registration import Registration, registered
from pipeline.system.errors import InputError

Value = TypeVar("Value")
SAME_SHAPE = 0.02
"""Colour and depth are of one camera where their aspect ratios differ by less than this share.
ScanNet's own, 1296x968 and 640x480, differ by 0.4 %."""
LONGEST_ALONE = 1600
"""A picture without depth is made so long at most: networks look at less, and points cost time."""
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
    documented: tuple[float, float, float, float] | None = None
    """(fx, fy, cx, cy) or None: The format's own camera for 640x480, where `stated` has none."""


class Recording:
    """Base class of file readers; subclasses set `frame_ids` and implement `_listed`."""

    format = ""
    rule = DepthRule()
    camera_file = ""
    """What a camera file of the format is called, for a message: "camera-intrinsics.txt or "."""
    frame_ids: tuple[str, ...] = ()
    class_names: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()
    untold: tuple[str, ...] = ()
    """Options that would tell what nothing tells; frames can then only be looked at."""

    def __init__(self, root: Path, settings: Settings) -> None:
        self.root = root
        self._settings = settings
        if self.rule.units_per_metre is not None:
            self.notes = unit_notes(settings, self.rule.units_per_metre, self.rule.whose)

    def load(self, frame_id: str) -> Frame:
        """Decode a frame; see `Dataset.load`."""
        return self._decoded(frame_id)

    def load_pose(self, frame_id: str) -> np.ndarray | None:
        """Pose T_world_camera (4, 4) of a frame, without decoding."""
        told = self._settings
        if told.registration is not None or type(self)._listed is Recording._listed:
            # A warp moves the pose; some formats read a frame in a way of their own.
            return load_picture(self, frame_id).camera.T_world_camera
        pose = self._listed(frame_id, []).pose
        return pose if pose is None or told.poses is None else standard_poses(pose, told.poses)

    def _listed(self, frame_id: str, notes: list[str]) -> Listed:
        """Files and facts of a frame (subclasses); remarks are appended to `notes`."""
        raise NotImplementedError

    def _decoded(self, frame_id: str, annotated: bool = True) -> Frame:
        notes: list[str] = []
        found = self._listed(frame_id, notes)
        # A picture whose camera is known as it is stored stays as it is stored.
        rgb = read_color(found.color, upright=found.depth is None and found.stated.K is None)
        metres, untold = self._metres(found, rgb)
        whole = rgb.shape[:2]
        if whole != metres.shape:
            rgb = _resized(rgb, metres, found, notes, frame_id == self.frame_ids[0])
        size = (metres.shape[1], metres.shape[0])
        told = self._settings.intrinsics
        alone = found.depth is None and whole != metres.shape
        stated = found.stated if told is None else NOTHING
        if told is not None and alone:
            stated = Stated(intrinsics(*told), (whole[1], whole[0]))
        K = stated.scaled(size, (whole[1], whole[0]))
        if K is None and found.documented is not None and self._settings.intrinsics is None:
            whose = self.rule.whose.removesuffix(" own")
            K = known_intrinsics(found.documented, whose, metres.shape, self.camera_file, found.color)
        if K is None and self._settings.estimated and self._settings.intrinsics is None:
            K = _exif_intrinsics(found.color, metres.shape, notes)
        annotations = found.annotate(metres.shape, notes) if annotated and found.annotate is not None else ()
        source, depth = found.stated.path or found.color, found.depth or found.color
        return self._frame(
            frame_id, (rgb, metres), K, found.pose, source, depth, annotations, notes, found.up, untold, fits=alone
        )

    def _metres(self, found: Listed, rgb: np.ndarray) -> tuple[np.ndarray, tuple[str, ...]]:
        """Depth (H, W) float32 metres, and the option for the unit where unknown. A stand-in of one metre where it is
        to be estimated, smaller than a large picture that nothing is drawn on."""
        if found.depth is None:
            shrink = 1.0 if found.annotate is not None else min(1.0, LONGEST_ALONE / max(rgb.shape[:2]))
            return np.ones((round(rgb.shape[0] * shrink), round(rgb.shape[1] * shrink)), np.float32), ()
        rule = self.rule
        units = self._settings.depth_scale or found.stated.units_per_metre or rule.units_per_metre
        if units is None and self._settings.browse:
            stored = read_stored(found.depth)
            if stored.dtype.kind != "f":
                units = float(np.median(stored[stored > 0])) / BROWSED_MEDIAN_M if stored.any() else 1.0
                return read_depth(found.depth, units, rule.nothing, rule.rotated), (DEPTH_SCALE,)
        return read_depth(found.depth, units, rule.nothing, rule.rotated), ()

    def _ask_for(self, seen: str, camera: bool, unit: bool) -> None:
        """Raise InputError for a missing camera or unit; while browsing, record the options instead."""
        missing = [option for option, lacks in ((INTRINSICS, camera), (DEPTH_SCALE, unit)) if lacks]
        if not missing:
            return
        are = "is" if len(missing) == 1 else "are"
        what = " and ".join(name for name, lacks in (("a camera", camera), ("the depth's unit", unit)) if lacks)
        if self._settings.browse:
            self.untold = tuple(missing)
            return
        raise InputError(
            f"{seen}; {what} {are} missing",
            expected=" and ".join(missing) + (f", in one {INTRINSICS},UNITS_PER_METRE" if len(missing) > 1 else ""),
            cause=f"{'1000 for millimetres; ' if unit else ''}or kept in {FILE_NAME} beside the data",
            path=self.root,
        )

    def _found(self, table: Mapping[str, Value], frame_id: str) -> Value:
        """Entry of a frame in a table of all frames; InputError for an unknown frame."""
        if frame_id not in table:
            raise unknown_id(self.frame_ids, frame_id, self.root)
        return table[frame_id]

    def _frame(
        self,
        frame_id: str,
        pair: tuple[np.ndarray, np.ndarray],
        K: np.ndarray | None,
        pose: np.ndarray | None,
        source: Blob,
        depth_path: Blob,
        annotations: tuple[Annotation, ...] = (),
        notes: Sequence[str] = (),
        up: np.ndarray | None = None,
        untold: tuple[str, ...] = (),
        fits: bool = False,
    ) -> Frame:
        """Assemble a Frame; errors in intrinsics name `source`, `up` ((3,), camera frame) is declared. Where K `fits`,
        it is made for this size of whatever intrinsics were told."""
        settings = replace(self._settings, intrinsics=None) if fits else self._settings
        camera = make_camera(K, pair[1].shape, pose, settings, source, untold)
        if camera.untold and not self._settings.estimated:
            notes = [*notes, f"nothing can be measured, sizes are made up: {' and '.join(camera.untold)}"]
        if up is not None:
            camera = camera.with_up(up, "declared")
        if self._settings.registration is not None:
            metres, camera = registered(pair[1], camera, Registration(*self._settings.registration))
            pair = pair[0], metres
        return make_frame(frame_id, pair, camera, depth_path, annotations, tuple(notes))


def _resized(rgb: np.ndarray, metres: np.ndarray, found: Listed, notes: list[str], first: bool) -> np.ndarray:
    """Colour resized to the depth's size; InputError for another aspect ratio."""
    (height, width), whole = metres.shape, rgb.shape[:2]
    if found.depth is not None and abs(whole[1] * height / (whole[0] * width) - 1) > SAME_SHAPE:
        raise differ_in_size(rgb, metres, found.color, found.depth)
    if first or found.depth is None:
        what = "everywhere" if found.depth is not None else "before its depth is estimated"
        of_depth = "" if found.depth is None else "the depth's "
        notes.append(f"colour of {whole[1]}x{whole[0]} is resized to {of_depth}{width}x{height} {what}")
    # OpenCV's average over areas becomes nearest-neighbour where the image grows.
    return cv2.resize(rgb, (width, height), interpolation=cv2.INTER_AREA if whole[0] > height else cv2.INTER_LINEAR)


def _exif_intrinsics(path: Blob, size: tuple[int, ...], notes: list[str]) -> np.ndarray | None:
    """Intrinsics (3, 3) by the focal length in the picture's EXIF, with a note; else None."""
    found = exif_focal(path, size[0], size[1])
    if found is None:
        return None
    notes.append(f"the focal length is that of the picture's EXIF, {found[1]:g} mm as of 35 mm film")
    return intrinsics(found[0], found[0], (size[1] - 1) / 2, (size[0] - 1) / 2)


def files_of(pair: Pair, root: Path, color: Path | None = None, depth: Path | None = None) -> tuple[Path, Path]:
    """Both files of a frame; InputError for a missing file, naming the expected `color` or `depth`."""
    present = pair.color or pair.depth or root
    return (
        one_file([pair.color] if pair.color else [], "colour", color or present),
        one_file([pair.depth] if pair.depth else [], "depth", depth or present),
    )
