"""An up vector, and a pixel of a level surface, as a person writes them."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

from pipeline.geometry.camera import UpSource
from pipeline.system.errors import InputError

Vector = tuple[float, float, float]


@dataclass(frozen=True)
class GivenUp:
    """A direction against gravity, in words "world:X,Y,Z", "camera:X,Y,Z", or "X,Y,Z".

    Attributes
    ----------
    vector : (x, y, z)
        Of any length but 0.
    frame : str or None
        "world" is that of the poses, "camera" the OpenCV frame of each camera (image-up is 0,-1,0). None: the world
        in a dataset with poses, else the camera.
    """

    vector: Vector
    frame: Literal["world", "camera"] | None = None

    @classmethod
    def parse(cls, text: str) -> GivenUp:
        """Read the words; InputError where they are none."""
        frame, colon, numbers = text.strip().rpartition(":")
        try:
            x, y, z = (float(part) for part in numbers.split(","))
        except ValueError:
            x = y = z = math.nan
        length = math.hypot(x, y, z)
        if not (1e-9 < length < math.inf) or (colon and frame not in ("world", "camera")):
            raise InputError(
                "up must be a vector that points somewhere",
                got=repr(text),
                expected="X,Y,Z, world:X,Y,Z or camera:X,Y,Z",
            )
        return cls((x, y, z), frame if frame in ("world", "camera") else None)

    def __str__(self) -> str:
        numbers = ",".join(f"{x + 0.0:g}" if float(f"{x:g}") == x else repr(x) for x in self.vector)
        return numbers if self.frame is None else f"{self.frame}:{numbers}"


def parse_level_at(text: str) -> tuple[str | None, int, int]:
    """(frame or None, u, v) of "U,V" or "FRAME:U,V", pixels; InputError where it is neither."""
    frame, colon, numbers = text.strip().rpartition(":")
    try:
        u, v = (int(part) for part in numbers.split(","))
    except ValueError:
        u = v = -1
    if u < 0 or v < 0 or (colon and not frame):
        raise InputError("no pixel of a level surface", got=repr(text), expected="U,V or FRAME:U,V: column, row")
    return frame or None, u, v


SOURCES: dict[UpSource, str] = {
    "given": "you said so: --up, --level-at, spatialviz.toml, or a surface that was called level",
    "declared": "the dataset declares it",
    "imu": "an inertial sensor measured it",
    "scene": "the posed frames of the scene agree on it",
    "plane": "it is the normal of a level plane of this frame",
    "assumed": "nothing tells: image-up is taken",
}
"""How an up vector is known, by its source."""
ASSUMED = "up is assumed to be image-up: left, right, above, below, in front and behind may all be wrong"
DECLARE = "--up X,Y,Z says where up is, --level-at U,V that the surface at a pixel is level"
