"""Sides of a 3D box that a view does not bound: cut by the picture, hidden by something nearer, or not seen at all."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np

from pipeline.geometry.boxes import SIDES, Box3D, Side
from pipeline.geometry.camera import Camera

BESIDE = 0.3
"""Share of a box's length within which the outline lies beside a side."""
TOWARDS = 0.5
"""Cosine in the picture above which the outline faces a side."""
ALONG = 0.3
"""Cosine above which a surface runs on towards a side: a front that the picture cuts below goes on down, not near."""
NEARER = 0.05
"""Metres, and share of the distance, by which something nearer hides what is behind."""
STEPS = np.array([[0.0], [-3.0], [-6.0], [3.0]])
"""Pixels outwards from the outline, at an image width of 640: twice the object's surface, then what may hide it."""
OUTLINE = 60
"""The outline is thinned evenly to less than twice this number of pixels."""
TURN = 3
"""Pixels along the outline, both ways, that tell its direction."""


def open_sides(
    boxes: Sequence[Box3D], crops: Sequence[tuple[np.ndarray, int, int]], depth: np.ndarray, camera: Camera
) -> list[tuple[Side, ...]]:
    """Sides of SIDES where each object may go on beyond its box.

    A side is open where at least half of the outline that lies beside it and faces it is at the picture's border, or
    next to something nearer, while the object's surface runs on towards the side. The far side is open too where no
    outline lies beside it: the fit put it there unseen. From above, the far edge of a table's top bounds it.

    Parameters
    ----------
    boxes : sequence of Box3D
        Camera frame; their axes are near the viewer's (right, down, forward).
    crops : sequence of (codes, x0, y0)
        (h, w) uint8, a rectangle around each object's pixels, 0 outside of them, and its upper left corner, pixels.
    depth : (H, W) float32
        Metres, 0 where missing.
    """
    if not boxes:
        return []
    outlines = [_outline(*crop) for crop in crops]
    owner = np.repeat(np.arange(len(boxes)), [outline.shape[1] for outline in outlines])
    outline, along = np.concatenate(outlines, axis=1)
    outwards = 1j * along / np.maximum(np.abs(along), 1)
    height, width = depth.shape
    at = outline + STEPS * (width / 640) * outwards
    u, v = np.rint(at.real), np.rint(at.imag)
    inside_u, inside_v = np.minimum(np.maximum(u, 0), width - 1), np.minimum(np.maximum(v, 0), height - 1)
    _, z, deeper, beyond = depth[inside_v.astype(np.intp), inside_u.astype(np.intp)]
    goes_on = (beyond > 0) & (beyond < z - np.maximum(NEARER, NEARER * z))
    goes_on |= (inside_u[3] != u[3]) | (inside_v[3] != v[3])

    R = np.array([box.R for box in boxes])
    center, size = np.array([box.center for box in boxes]), np.array([box.size for box in boxes])
    x, y = (at.real - camera.cx) / camera.fx, (at.imag - camera.cy) / camera.fy
    surface = np.array([[x[0] * z, y[0] * z, z], [x[2] * deeper, y[2] * deeper, deeper]])
    end, inner = np.einsum("tij,sit->sjt", R[owner], surface)
    place = (end - (center[:, None] @ R)[owner, 0].T) / np.maximum(size, 1e-6)[owner].T
    side = np.sign(place)
    towards = (R[:, 0] + 1j * R[:, 1])[owner].T - R[:, 2][owner].T * (x[0] + 1j * y[0])
    facing = (towards * outwards.conj()).real * side > TOWARDS * np.abs(towards)
    run = end - inner
    runs_on = (run * side > ALONG * np.sqrt((run * run).sum(axis=0))) | (deeper <= 0)
    beside = facing & (np.abs(place) > 0.5 - BESIDE) & (z > 0)
    number = 6 * owner + _LOWER + (place > 0)
    seen, found = (
        np.bincount(number[chosen], minlength=6 * len(boxes)).reshape(-1, 6)
        for chosen in (beside, beside & goes_on & runs_on)
    )
    is_open = (2 * found >= seen) & (seen > 0)
    is_open[:, 5] |= seen[:, 5] == 0
    return [tuple(side for side, goes in zip(SIDES, row, strict=True) if goes) for row in is_open.tolist()]


def _outline(codes: np.ndarray, x0: int, y0: int) -> np.ndarray:
    """Pixels of the outline, thinned, and its directions there, (2, N) complex: u + iv."""
    contours, _ = cv2.findContours(codes, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE, offset=(x0, y0))
    parts = [part[:, 0] @ _COMPLEX for part in contours if len(part) > 2 * TURN]
    thin = max(1, sum(map(len, parts)) // OUTLINE)
    found = [(part[TURN:-TURN:thin], part[2 * TURN :: thin] - part[: -2 * TURN : thin]) for part in parts]
    return np.concatenate([np.array(part) for part in found], axis=1) if found else np.empty((2, 0), np.complex128)


_COMPLEX = np.array([1, 1j])
_LOWER = np.array([[0], [2], [4]])
