"""Boxes: axis-aligned in the image, oriented in 3D, and their overlaps."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Literal

import numpy as np

from pipeline.system.errors import require
from pipeline.system.frozen import dataclass

CORNER_SIGNS = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], dtype=np.float64)
"""Corner k of a box has the signs of row k: bit 2 of k is x, bit 1 is y, bit 0 is z."""

EDGES = np.array([(0, 1), (2, 3), (4, 5), (6, 7), (0, 2), (1, 3), (4, 6), (5, 7), (0, 4), (1, 5), (2, 6), (3, 7)])
"""The 12 edges of a box as pairs of corner numbers."""

Side = Literal["left", "right", "top", "bottom", "near", "far"]
SIDES: tuple[Side, ...] = ("left", "right", "top", "bottom", "near", "far")
"""Sides of a box by its axes where those are near (right, down, forward): at -x, +x, -y, +y, -z, +z."""

OPEN_GAP = 0.6
"""Share of an edge of an open side that is not drawn."""

CUBE = (CORNER_SIGNS / 2).astype(np.float32)
CUBE_FACES = np.array(
    [
        [0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1],
        [2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4], [1, 5, 7], [1, 7, 3],
    ]
)  # fmt: skip
"""The faces of a box as 12 triangles of corner numbers, and the box of size 1 that they are drawn on."""


@dataclass(frozen=True)
class Box3D:
    """An oriented 3D box.

    Attributes
    ----------
    center : (3,) float64
        Metres.
    R : (3, 3) float64
        Rotation; columns are the box's own axes.
    size : (3,) float64
        Full edge lengths along those axes, metres.

    >>> import numpy as np
    >>> from pipeline import Box3D
    >>> box = Box3D(np.array([0, 0, 2]), np.eye(3), np.array([0.4, 0.2, 0.3]))
    >>> box
    <Box3D center 0.000 0.000 2.000, size 0.400 0.200 0.300 m>
    >>> round(box.volume, 4), box.corners.shape
    (0.024, (8, 3))
    """

    center: np.ndarray
    R: np.ndarray
    size: np.ndarray

    def __post_init__(self) -> None:
        center, R, size = (np.asarray(a, dtype=np.float64) for a in (self.center, self.R, self.size))
        require(
            center.shape == (3,) and R.shape == (3, 3) and size.shape == (3,),
            "a 3D box needs center (3,), R (3, 3), size (3,)",
            got=lambda: f"{center.shape}, {R.shape}, {size.shape}",
        )
        # Thousands of boxes are made a second: of so few numbers Python's own take a third of the time.
        axes, sizes = R.tolist(), size.tolist()
        require(
            math.isfinite(sum(map(sum, axes), sum(center.tolist()) + sum(sizes))),
            "a 3D box must be finite",
            got=lambda: f"center {center}, size {size}",
        )
        require(min(sizes) >= 0, "a 3D box must have sizes of at least 0", got=sizes)
        require(_is_rotation(axes), "R of a 3D box is not a rotation", got=lambda: f"det {np.linalg.det(R):.3f}")
        object.__setattr__(self, "center", center)
        object.__setattr__(self, "R", R)
        object.__setattr__(self, "size", size)

    def __repr__(self) -> str:
        center, size = (" ".join(f"{x:.3f}" for x in values) for values in (self.center, self.size))
        return f"<Box3D center {center}, size {size} m>"

    @property
    def corners(self) -> np.ndarray:
        """Corners, (8, 3) float64, metres, in the order of CORNER_SIGNS."""
        return self.center + (CORNER_SIGNS * self.size / 2) @ self.R.T

    @property
    def volume(self) -> float:
        """Volume, cubic metres."""
        return float(np.prod(self.size))

    def transformed(self, T: np.ndarray) -> Box3D:
        """Box in another frame; T is (4, 4), rigid, new-from-old."""
        return self.turned(T[:3, :3], T[:3, 3])

    def turned(self, R: np.ndarray, shift: np.ndarray | float = 0.0) -> Box3D:
        """Box in other axes: R is (3, 3), rows the new axes in the old; then shifted, metres."""
        return Box3D(R @ self.center + shift, R @ self.R, self.size)


def drawn_edges(box: Box3D, open_sides: Sequence[Side] | None = None) -> np.ndarray:
    """Edges of a box to draw, (N, 2, 3) float64: twelve, those of open sides with a gap in their middle."""
    ends, cut = box.corners[EDGES], edges_of(open_sides or ())
    start, end = ends[cut, 0], ends[cut, 1]
    step = (end - start) * (1 - OPEN_GAP) / 2
    pieces = np.stack([start, start + step], axis=1), np.stack([end - step, end], axis=1)
    return np.concatenate([ends[~cut], *pieces])


def edges_of(sides: Sequence[Side]) -> np.ndarray:
    """(12,) bool: which of EDGES bound any of these sides."""
    signs = CORNER_SIGNS[EDGES]
    # An edge is of a side where both its corners are.
    of_side = [(signs[:, :, k // 2] == (-1, 1)[k % 2]).all(axis=1) for k in map(SIDES.index, sides)]
    return np.any([np.zeros(len(EDGES), np.bool_), *of_side], axis=0)


def half_dashed(box: Box3D, sides: Sequence[Side]) -> np.ndarray:
    """Edges of a box, (N, 2, 3) float32, of which those of these sides are dashed."""
    ends, unsure = box.corners[EDGES], edges_of(sides)
    return np.concatenate([ends[~unsure].astype(np.float32), dashed(ends[unsure], dash_of(box))])


def dashed(segments: np.ndarray, period: float, share: float = 0.55) -> np.ndarray:
    """Cut line segments into dashes.

    `segments`: (N, 2, D) float, start and end; `period`: approximate length of a dash with its gap: each segment holds
    a whole number of dashes, and ends with a dash; `share`: of the dash in it, 0..1. Returns (M, 2, D) float32 in the
    order of the segments.
    """
    segments = np.asarray(segments, np.float64)
    length = np.linalg.norm(segments[:, 1] - segments[:, 0], axis=1)
    count = np.maximum(np.ceil(length / period), 1).astype(int)
    which = np.repeat(np.arange(len(segments)), count)
    number = np.arange(len(which)) - np.repeat(np.cumsum(count) - count, count)
    # With the last gap left out, so that every corner is drawn.
    whole = count[which] - (1 - share)
    ends = np.stack([number / whole, np.minimum((number + share) / whole, 1.0)], axis=1)
    start, step = segments[which, 0], segments[which, 1] - segments[which, 0]
    return (start[:, None] + ends[..., None] * step[:, None]).astype(np.float32)


DASH, SHORTEST_DASH, LONGEST_DASH = 0.12, 0.03, 0.25
"""Period of a box's dashes: share of its diagonal, within metres that are told from afar and from nearby."""


def dash_of(box: Box3D) -> float:
    """Period of a box's dashes, metres."""
    return float(np.clip(DASH * np.linalg.norm(box.size), SHORTEST_DASH, LONGEST_DASH))


def edge_lines(
    boxes: Iterable[Box3D],
    growth: float = 0.0,
    open_sides: Iterable[Sequence[Side] | None] | None = None,
    dashes: bool = False,
) -> np.ndarray:
    """Edges of boxes, (N, 2, 3) float32, as `drawn_edges`, cut into `dashes` by the size of the box.

    Every box is first grown by `growth` metres.
    """
    grown = [Box3D(b.center, b.R, b.size + growth) for b in boxes]
    drawn = map(drawn_edges, grown) if open_sides is None else map(drawn_edges, grown, open_sides)
    if dashes:
        drawn = map(dashed, drawn, map(dash_of, grown))
    return np.concatenate([np.zeros((0, 2, 3)), *drawn]).astype(np.float32)


def boxes_on_ray(boxes: Mapping[int, Box3D], origin: np.ndarray, direction: np.ndarray) -> list[int]:
    """Numbers of the boxes on a ray, the smallest first: a mug is meant rather than the table around it."""
    hit = (i for i, b in boxes.items() if ray_entry(b, origin, direction) is not None)
    return sorted(hit, key=lambda i: boxes[i].volume)


def _is_rotation(R: Sequence[Sequence[float]]) -> bool:
    """Test the rows of a matrix to be orthonormal to 1e-3 and right-handed."""
    (a, b, c), (d, e, f), (g, h, i) = R
    determinant = a * (e * i - f * h) - b * (d * i - f * g) + c * (d * h - e * g)
    lengths = a * a + b * b + c * c - 1, d * d + e * e + f * f - 1, g * g + h * h + i * i - 1
    products = a * d + b * e + c * f, a * g + b * h + c * i, d * g + e * h + f * i
    return determinant > 0 and max(map(abs, lengths + products)) <= 1e-3


def ray_entry(box: Box3D, origin: np.ndarray, direction: np.ndarray) -> float | None:
    """Distance along a ray to a box, in lengths of `direction`; None for a miss (slab method)."""
    start, step = (origin - box.center) @ box.R, direction @ box.R
    safe = np.where(np.abs(step) < 1e-12, 1e-12, step)
    near, far = np.sort(np.stack([(-box.size / 2 - start) / safe, (box.size / 2 - start) / safe]), axis=0)
    enter, leave = float(near.max()), float(far.min())
    return None if leave < max(enter, 0.0) else max(enter, 0.0)


def iou_2d(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Intersection over union of every box of `a` with every box of `b`.

    Parameters
    ----------
    a, b : (N, 4), (M, 4) float
        x0, y0, x1, y1 in pixels, continuous coordinates.

    Returns
    -------
    (N, M) float64
        0..1; 0 where either box is empty.

    >>> from pipeline.geometry import iou_2d
    >>> iou_2d([[0, 0, 2, 2]], [[0, 0, 2, 1], [1, 0, 3, 2]]).round(3)
    array([[0.5  , 0.333]])
    """
    a = np.asarray(a, dtype=np.float64).reshape(-1, 4)
    b = np.asarray(b, dtype=np.float64).reshape(-1, 4)
    return paired_iou_2d(a[:, None], b[None])


def paired_iou_2d(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Intersection over union of paired boxes, (..., 4) float64 each as in `iou_2d`; 0 where empty or NaN."""
    low = np.maximum(a[..., :2], b[..., :2])
    high = np.minimum(a[..., 2:], b[..., 2:])
    intersection = np.clip(high - low, 0, None).prod(axis=-1)
    area_a = np.clip(a[..., 2:] - a[..., :2], 0, None).prod(axis=-1)
    area_b = np.clip(b[..., 2:] - b[..., :2], 0, None).prod(axis=-1)
    union = area_a + area_b - intersection
    return np.divide(intersection, union, out=np.zeros_like(union), where=union > 0)


def iou_3d(a: Box3D, b: Box3D) -> float:
    """Exact intersection over union of two oriented boxes, 0..1; 0 where the boxes only touch or either is flat.

    The intersection of two convex solids is the convex hull of the corners of
    each inside the other and of the points where an edge of one crosses a face
    of the other; its volume comes from Qhull.

    >>> import numpy as np
    >>> from pipeline.geometry import Box3D, iou_3d
    >>> a = Box3D(np.zeros(3), np.eye(3), np.ones(3))
    >>> round(iou_3d(a, a.turned(np.eye(3), np.array([0.5, 0, 0]))), 3)
    0.333
    """
    if a.volume <= 0 or b.volume <= 0:
        return 0.0
    vertices = np.concatenate([_inside(a.corners, b), _inside(b.corners, a), _crossings(a, b), _crossings(b, a)])
    if len(vertices) < 4:
        return 0.0
    from scipy.spatial import ConvexHull, QhullError

    try:
        volume = float(ConvexHull(vertices).volume)
    except QhullError:  # The shared part is flat: the boxes touch in a face or an edge.
        return 0.0
    return float(np.clip(volume / (a.volume + b.volume - volume), 0.0, 1.0))


def most_iou_3d(a: Box3D, b: Box3D) -> float:
    """Bound that `iou_3d` of two boxes does not exceed: each shares at most its part within the extents of the other
    along its own axes."""
    shared = min(a.volume, b.volume)
    for box, other in ((a, b), (b, a)):
        corners = (other.corners - box.center) @ box.R
        low, high = np.maximum(corners.min(axis=0), -box.size / 2), np.minimum(corners.max(axis=0), box.size / 2)
        shared = min(shared, float(np.clip(high - low, 0, None).prod()))
    union = a.volume + b.volume - shared
    # What rounding may take away is given back.
    return shared / union + 1e-9 if union > 0 else 0.0


def _inside(points: np.ndarray, box: Box3D) -> np.ndarray:
    local = (points - box.center) @ box.R
    return points[(np.abs(local) <= box.size / 2 + 1e-9).all(axis=1)]


def _crossings(a: Box3D, b: Box3D) -> np.ndarray:
    """Points, (N, 3), where edges of `a` cross faces of `b`."""
    start, end = (((a.corners[EDGES[:, k]] - b.center) @ b.R) for k in (0, 1))
    planes = np.concatenate([b.size / 2, -b.size / 2])
    axis = np.tile(np.arange(3), 2)
    delta = (end - start)[:, axis]
    t = np.divide(planes - start[:, axis], delta, out=np.full_like(delta, np.nan), where=np.abs(delta) > 1e-12)
    hit = start[:, None, :] + t[..., None] * (end - start)[:, None, :]
    on_face = (np.abs(hit) <= b.size / 2 + 1e-9).all(axis=2)
    return hit[(t >= 0) & (t <= 1) & on_face] @ b.R.T + b.center
