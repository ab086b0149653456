"""How up is known, in the words that every place uses."""

from __future__ import annotations

from pipeline.geometry.camera import UpSource

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
