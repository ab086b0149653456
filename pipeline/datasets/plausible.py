"""Plausibility of a frame's depth for a room, in milliseconds."""

from __future__ import annotations

import numpy as np

from pipeline.geometry.camera import Camera, lift_pixels
from pipeline.geometry.frame import Frame
from pipeline.geometry.level_plane import level_plane
from pipeline.language.class_sizes import SizeFactor, size_factor
from pipeline.system.frozen import dataclass

EVERY = 8
"""Of rows and columns, one in so many is looked at for the range of depth."""
FAR_M, NEAR_M = 7.0, 0.7
"""The median depth of a frame indoors is between these, but for close-ups."""
HIGH_M, LOW_M = 3.3, 0.32
"""A camera is at least and at most so high above the lowest level that it sees, where it looks down on it."""
LOOKS_DOWN = 0.05
"""Share of the points that lie on the lowest level, to call it a floor."""
LEVEL = 0.04
"""They lie this close to it, as a share of the median depth."""
LEAST_SEEN, LEAST_PIXELS = 0.6, 30
HINT = "is the depth scale another? `spatialviz doctor` looks for it"


@dataclass(frozen=True)
class Doubt:
    """Evidence against the depth of a frame."""

    text: str  # One sentence
    factor: float | None = None  # By how much depth is about too far (5: five times too far), where that can be told


def depth_doubt(frame: Frame) -> Doubt | None:
    """Evidence against measured depth; None for a stand-in camera or estimated depth. Of a camera that is made up
    nothing can be said, and what a network estimates has no unit that could be wrong."""
    return None if frame.camera.untold or frame.depth_source else plausibility(frame)


def plausibility(frame: Frame) -> Doubt | None:
    """Evidence against the depth of a frame, or None. The sizes of annotated things of known classes decide where they
    can. Else the range of depth and the height of the camera above the lowest level that it sees must both be odd."""
    sizes = doubt_by_sizes(annotated_sizes(frame))
    if sizes is not None:
        return sizes
    sparse = frame.depth[::EVERY, ::EVERY]
    median = float(np.median(sparse[sparse > 0])) if (sparse > 0).any() else 1.0
    height = None if NEAR_M <= median <= FAR_M else camera_height(frame)
    if height is None or (height > LOW_M if median < NEAR_M else height < HIGH_M):
        return None
    seen = f"half of it is beyond {median:.2g} m, and the camera {height:.2g} m above the lowest level it sees"
    what = "too near, but for a close-up" if median < NEAR_M else "too far for a room"
    return Doubt(f"the depth is {what}: {seen}; {HINT}")


def annotated_sizes(frame: Frame) -> SizeFactor | None:
    """Oversize factor of the annotated things fully in view, by 2D boxes and depth."""
    height, width = frame.depth.shape
    labels: list[str] = []
    lengths: list[float] = []
    for annotation in frame.annotations:
        x0, y0, x1, y1 = (int(n) for n in np.rint(annotation.bbox))
        cut = x0 <= 1 or y0 <= 1 or x1 >= width - 1 or y1 >= height - 1
        if cut or (annotation.visible is not None and annotation.visible < LEAST_SEEN):
            continue
        inside = frame.depth[y0:y1, x0:x1]
        inside = inside[(inside > 0) & (True if annotation.mask is None else annotation.mask[y0:y1, x0:x1])]
        if len(inside) >= LEAST_PIXELS:
            labels.append(annotation.label)
            lengths.append(max((x1 - x0) / frame.camera.fx, (y1 - y0) / frame.camera.fy) * float(np.median(inside)))
    return size_factor(labels, lengths)


def doubt_by_sizes(found: SizeFactor | None) -> Doubt | None:
    """Evidence from sizes of named things against the depth."""
    if found is None:
        return None
    factor = found.middle
    how = f"{factor:.2g} times too large" if factor > 1 else f"{1 / factor:.2g} times too small"
    few = f"only {found.fitting} of {found.things} things of known classes have the size of their class"
    return Doubt(f"{few}, as if all were about {how}; {HINT}", factor)


def camera_height(frame: Frame) -> float | None:
    """Camera height above the lowest visible level surface, metres; else None."""
    camera = frame.camera
    up = camera.up
    if up is None:
        # A quarter of the pixels are enough for a floor.
        K = camera.K * np.array([0.5, 0.5, 1.0])[:, None]
        half = frame.depth[::2, ::2]
        up = level_plane(half, Camera(K, half.shape[1], half.shape[0]))
    if up is None:
        return None
    v, u = (a.ravel() for a in np.mgrid[0 : frame.height : EVERY, 0 : frame.width : EVERY])
    z = frame.depth[v, u]
    kept = z > 0
    heights = lift_pixels(z[kept], camera, v[kept], u[kept]) @ up.astype(np.float32)
    lowest = float(np.percentile(heights, 2))
    unit = float(np.median(z[kept]))
    on_it = np.abs(heights - lowest) < LEVEL * unit
    return -lowest if lowest < 0 and on_it.mean() >= LOOKS_DOWN else None
