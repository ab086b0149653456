"""User settings of a recording, kept in `spatialviz.toml` next to the data."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import field, replace
from pathlib import Path
from typing import Any, Literal

from pipeline.geometry.camera import UpSource, check_convention
from pipeline.geometry.registration import Registration
from pipeline.system.errors import InputError, as_input_error, in_file, require
from pipeline.system.frozen import dataclass
from pipeline.system.reading import parse_toml
from pipeline.system.safe_files import read_text
from pipeline.system.whole_files import write_whole

FILE_NAME = "spatialviz.toml"
KEYS = (
    *("name", "intrinsics", "depth_scale", "depth_is", "depth_turned", "depth_nothing", "mirrored", "color_turned"),
    *("poses", "pose_shift", "registration", "world_up", "up", "frame_up"),
)
MEANT = {
    "depth_is": ("z", "distance", "inverse"),
    "mirrored": ("left-right", "top-bottom"),
    "depth_turned": ("90", "180", "270", "left-right", "top-bottom"),
}
"""What may be declared of pictures and depth maps, by the setting's name; see `Settings`."""
TURNS = {"clockwise": 3, "counter-clockwise": 1}
"""Turns of a colour picture by 90 degrees, as `np.rot90` counts them."""
INTRINSICS = "--intrinsics fx,fy,cx,cy"
DEPTH_SCALE = "--depth-scale UNITS_PER_METRE"
OR_ESTIMATED = "or --depth-model NAME, which estimates it"
"""The options that tell what a recording may not."""
TABLE = "frame_up"
"""The one key that is a table and is written."""
LIMITS_TABLE = "limits"
"""The table of limits that are raised for this dataset."""


@dataclass(frozen=True)
class Settings:
    """Facts about a dataset missing in the format. None: unknown.

    Attributes
    ----------
    intrinsics : (fx, fy, cx, cy) or None
        Pixels.
    depth_scale : float or None
        Depth units in one metre: 1000 for millimetres.
    poses : str or None
        What the pose files mean, one of `pose_convention.CONVENTIONS`; by default "camera-to-world opencv".
    pose_shift : int or None
        The pose of a frame stands with the frame so many places later in its scene, if negative earlier.
    registration : (fx, fy, cx, cy, tx, ty, tz) or None
        The colour camera as the depth camera sees it, pixels and metres: `geometry.registration.Registration`. By
        default both are one.
    depth_is : str or None
        What a depth map holds: "z", along the camera's z axis, by default; "distance" to the camera's centre, as of
        Hypersim and some renderers; "inverse", the reciprocal of z, in reciprocals of the depth's unit.
    depth_turned : str or None
        How depth maps lie over the colour: turned clockwise by "90", "180" or "270" degrees, or mirrored.
    depth_nothing : float or None
        A stored value of depth maps, besides 0, that means that nothing was measured; of floats in metres.
    mirrored : str or None
        How colour and depth are mirrored: "left-right" or "top-bottom". Intrinsics are of the mirrored pictures.
    color_turned : str or None
        The turn, one of `TURNS`, that lays upright colour over depth as the sensor lies; intrinsics are of depth.
    world_up : (x, y, z) or None
        The direction against gravity in the world that the poses speak of, as the dataset's makers declare it.
    up : GivenUp or None
        The same as a person tells it, in the world or in the camera frame; in the file "world:X,Y,Z".
    frame_up : dict of str to (x, y, z)
        Up in the camera frame of single frames; the poses carry it to the others of the scene.
    name : str or None
        The dataset's name for people.
    limits : dict of str to int or str
        Limits that are raised for what is read below the dataset's folder: `system.limits.Limits`.
    estimated : bool
        Depth is estimated: frames of colour alone open, with a stand-in for their depth.
    browse : bool
        Pictures are only looked at: what nothing tells of the camera is made up, and said to be (`Camera.untold`).
    """

    intrinsics: tuple[float, float, float, float] | None = None
    depth_scale: float | None = None
    world_up: tuple[float, float, float] | None = None
    name: str | None = None
    up: GivenUp | None = None
    frame_up: Mapping[str, Vector] = field(default_factory=dict)
    browse: bool = False
    limits: Mapping[str, Any] = field(default_factory=dict)
    estimated: bool = False
    poses: str | None = None
    pose_shift: int | None = None
    registration: tuple[float, ...] | None = None
    depth_is: str | None = None
    depth_turned: str | None = None
    depth_nothing: float | None = None
    mirrored: str | None = None
    color_turned: str | None = None

    def __post_init__(self) -> None:
        for key, values in {**MEANT, "color_turned": TURNS}.items():
            given = getattr(self, key)
            known = given is None or given in values
            require(known, f"no such {key}", got=repr(given)[:60], expected=" | ".join(values))
        if self.depth_nothing is not None:
            (nothing,) = _numbers("depth_nothing", [self.depth_nothing], 1)
            require(nothing > 0, "depth_nothing must be positive", got=f"{nothing:g}", expected="a stored value")
            object.__setattr__(self, "depth_nothing", nothing)
        for key, count in (("intrinsics", 4), ("registration", 7)):
            if (values := getattr(self, key)) is not None:
                values = _numbers(key, values, count)
                Registration(*values)  # Says what is wrong with the focal lengths.
                object.__setattr__(self, key, values)
        if self.depth_scale is not None:
            (scale,) = _numbers("depth_scale", [self.depth_scale], 1)
            require(
                scale > 0, "the depth scale must be positive", got=f"{scale:g}", expected="depth units in one metre"
            )
            object.__setattr__(self, "depth_scale", scale)
        if self.poses is not None:
            check_convention(self.poses)
        whole = self.pose_shift is None or (isinstance(self.pose_shift, int) and not isinstance(self.pose_shift, bool))
        require(whole, "pose_shift must be a whole number of frames", got=str(self.pose_shift)[:40])
        if self.world_up is not None:
            object.__setattr__(self, "world_up", _direction("world_up", self.world_up))
        if isinstance(self.up, str):
            object.__setattr__(self, "up", GivenUp.parse(self.up))
        require(
            isinstance(self.up, GivenUp | None),
            "up must be a string",
            got=str(self.up)[:80],
            expected='such as "world:0,0,1"',
        )
        require(isinstance(self.frame_up, Mapping), "frame_up must be a table of frames", got=str(self.frame_up)[:80])
        ups = {frame: _direction(f"frame_up of {frame!r}", up) for frame, up in self.frame_up.items()}
        object.__setattr__(self, "frame_up", ups)
        require(self.name is None or isinstance(self.name, str), "name must be a string", got=repr(self.name))

    @property
    def meant(self) -> dict[str, Any]:
        """Declarations of pictures and depth maps, by the settings' names."""
        found = {key: getattr(self, key) for key in (*MEANT, "depth_nothing")}
        return {key: value for key, value in found.items() if value not in (None, MEANT["depth_is"][0])}

    def overridden(
        self,
        intrinsics: tuple[float, float, float, float] | None = None,
        depth_scale: float | None = None,
        up: GivenUp | None = None,
        **more: Any,
    ) -> Settings:
        """Settings overridden by the arguments; `up` also replaces the up of single frames.

        `more` may give `poses` and `registration`.
        """
        given: dict[str, Any] = {"intrinsics": intrinsics, "depth_scale": depth_scale, "up": up, **more}
        if up is not None:
            given["frame_up"] = {}
        return replace(self, **{key: value for key, value in given.items() if value is not None})


def unit_notes(settings: Settings, units_per_metre: float, whose: str) -> tuple[str, ...]:
    """Note on a depth unit known from the format alone; empty where set or estimated."""
    if settings.depth_scale is not None or settings.estimated:
        return ()
    return (
        f"the depth's unit is {whose}, {units_per_metre:g} to a metre, which no file states: "
        f"{DEPTH_SCALE} tells another",
    )


def camera_notes(settings: Settings, numbers: Sequence[float], whose: str) -> tuple[str, ...]:
    """Note on intrinsics known from the format alone; empty where set."""
    if settings.intrinsics is not None:
        return ()
    values = ",".join(f"{n:g}" for n in numbers)
    return (f"the camera is {whose}, {values}, which no file states: {INTRINSICS} tells another",)


def read_settings(root: Path) -> Settings:
    """Read the settings of a dataset; all None without `spatialviz.toml`.

    Raises
    ------
    InputError
        Malformed TOML, an unknown key, or a value that cannot be.
    """
    path = settings_file(root)
    if not path.is_file():
        return Settings()
    with as_input_error("the settings cannot be read", OSError, ValueError, got=str, path=path):
        table = parse_toml(read_text(path))
    limits = table.pop(LIMITS_TABLE, {})
    require(isinstance(limits, dict), "limits must be a table", path=path)
    # Tables such as [generator] say how the data came to be; they are for people and other tools.
    table = {key: value for key, value in table.items() if key == TABLE or not isinstance(value, dict)}
    unknown = sorted(set(table) - set(KEYS))
    if unknown:
        raise InputError(f"unknown setting {unknown[0]!r}", expected=f"one of {', '.join(KEYS)}", path=path)
    with in_file(path):
        return Settings(**table, limits=limits)


def write_settings(
    root: str | Path,
    intrinsics: tuple[float, float, float, float] | None,
    depth_scale: float | None,
    up: GivenUp | None = None,
    frame_up: Mapping[str, Vector] | None = None,
    **more: Any,
) -> Path:
    """Write camera and up settings of a recording to `spatialviz.toml`.

    What the file already holds and is not given here (None) stays, frames of `frame_up` that are not among them, too;
    but `up` is told of all frames. `more` may give any other key of `KEYS`. The file is replaced
    whole, so that a killed process leaves the old one.

    Returns
    -------
    Path
        The written `spatialviz.toml`.

    Raises
    ------
    InputError
        A value that cannot be, or a folder that cannot be written.
    """
    root = Path(root)
    settings = read_settings(root).overridden(intrinsics, depth_scale, up, **more)
    ups = {**settings.frame_up, **(frame_up or {})}
    values = {key: getattr(settings, key) for key in KEYS if key != TABLE}
    lines = [f"{key} = {_toml(value)}" for key, value in values.items() if value is not None]
    path = settings_file(root)
    lines += _tables(path)
    if ups:
        lines += ["", f"[{TABLE}]", *(f"{_toml(frame)} = {_toml(v)}" for frame, v in ups.items())]
    write_whole(path, ("\n".join(lines) + "\n").encode(), "the settings", make_folder=False)
    return path


def settings_file(root: Path) -> Path:
    """Path of the settings: in the dataset's folder, or next to a capture file."""
    return (root.parent if root.is_file() else root) / FILE_NAME


def _tables(path: Path) -> list[str]:
    """Lines of a settings file from the first table on, without `frame_up`."""
    if not path.is_file():
        return []
    kept: list[str] = []
    inside: str | None = None
    for line in read_text(path).splitlines():
        if line.lstrip().startswith("["):
            inside = line.split("#")[0].strip()
        if inside is not None and inside != f"[{TABLE}]":
            kept.append(line)
    while kept and not kept[-1].strip():
        kept.pop()
    return ["", *kept] if kept else []


def _toml(value: Any) -> str:
    """Value as TOML: text, numbers and lists of them are written as in JSON, with DEL escaped."""
    plain = str(value) if isinstance(value, GivenUp) else value
    return json.dumps(plain, ensure_ascii=False).replace("\x7f", "\\u007F")


def _direction(key: str, values: Any) -> Vector:
    x, y, z = _numbers(key, values, 3)
    require(math.hypot(x, y, z) >= 1e-9, f"{key} must point somewhere", got=[x, y, z])
    return x, y, z


LARGEST, SIZES = 1e12, "up to 1e12 in size"


def _numbers(key: str, values: Any, count: int) -> tuple[float, ...]:
    """`values` as `count` finite floats; a bool or a string is not a number."""
    good = (
        isinstance(values, Sequence)
        and not isinstance(values, str)
        and len(values) == count
        and all(isinstance(v, (int, float)) and not isinstance(v, bool) and abs(v) <= LARGEST for v in values)
    )
    if not good:
        what = "a finite number" if count == 1 else f"{count} finite numbers"
        raise InputError(f"{key} must be {what}", got=str(values[0] if count == 1 else values)[:80], expected=SIZES)
    return tuple(float(v) for v in values)


Vector = tuple[float, float, float]


@dataclass(frozen=True)
class GivenUp:
    """A direction against gravity, in words "world:X,Y,Z", "camera:X,Y,Z", or "X,Y,Z"."""

    vector: Vector  # (x, y, z): Of any length but 0
    frame: Literal["world", "camera"] | None = None
    """"world" is that of the poses, "camera" the OpenCV frame of each camera (image-up is 0,-1,0). None: the world in a
    dataset with poses, else the camera."""

    @classmethod
    def parse(cls, text: str) -> GivenUp:
        """Parse the text; InputError where malformed."""
        frame, colon, numbers = text.strip().rpartition(":")
        try:
            x, y, z = (float(part) for part in numbers.split(","))
        except ValueError:
            x = y = z = math.nan
        length = math.hypot(x, y, z)
        require(
            not (not (1e-9 < length <= LARGEST) or (colon and frame not in ("world", "camera"))),
            "up must be a vector that points somewhere",
            got=repr(text),
            expected="X,Y,Z, world:X,Y,Z or camera:X,Y,Z",
        )
        return cls((x, y, z), frame if frame in ("world", "camera") else None)

    def __str__(self) -> str:
        numbers = ",".join(f"{x + 0.0:g}" if float(f"{x:g}") == x else repr(x) for x in self.vector)
        return numbers if self.frame is None else f"{self.frame}:{numbers}"


def parse_level_at(text: str) -> tuple[str | None, int, int]:
    """Parse "U,V" or "FRAME:U,V" to (frame or None, u, v), pixels.

    Examples
    --------
    >>> from pipeline.datasets import parse_level_at
    >>> parse_level_at("000001/000002:320,400")
    ('000001/000002', 320, 400)
    """
    frame, colon, numbers = text.strip().rpartition(":")
    try:
        u, v = (int(part) for part in numbers.split(","))
    except ValueError:
        u = v = -1
    require(
        not (u < 0 or v < 0 or (colon and not frame)),
        "no pixel of a level surface",
        got=repr(text),
        expected="U,V or FRAME:U,V: column, row",
    )
    return frame or None, u, v


SOURCES: dict[UpSource, str] = {
    "given": "you said so: --up, --level-at, spatialviz.toml, or a surface that was called level",
    "declared": "the dataset declares it",
    "imu": "an inertial sensor measured it",
    "scene": "the posed frames of the scene agree on it",
    "plane": "it is the normal of a level plane of this frame",
    "assumed": "nothing tells: image-up is taken, or across a surface that may be a wall, seen alone",
}
"""How an up vector is known, by its source."""
ASSUMED = "up is assumed, as nothing tells it: left, right, above, below, in front and behind may all be wrong"
DECLARE = "--up X,Y,Z says where up is, --level-at U,V that the surface at a pixel is level"
