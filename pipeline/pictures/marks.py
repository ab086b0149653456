"""Marks of an answer over its frame: masks, boxes in 2D and 3D, crops; and which object plays which role."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Literal

import cv2
import numpy as np
import xxhash

from pipeline.answering.objects import SceneObject
from pipeline.answering.pair_table import ScoredPair
from pipeline.diagnosis.answer import Answer
from pipeline.geometry.boxes import Box3D, Side, dashed, drawn_edges
from pipeline.geometry.camera import Camera, project
from pipeline.geometry.masks import outlines
from pipeline.geometry.palette import ON_DARK, RGB, Role
from pipeline.system.frozen import dataclass
from pipeline.system.recent import Recent

TINT = 0.45


def tinted(rgb: np.ndarray, objects: Sequence[SceneObject], roles: Mapping[int, Role]) -> np.ndarray:
    """Tint the masks of objects in a role with the role's colour, outlined.

    `rgb`: (H, W, 3) uint8; `roles`: place in `objects` -> role; others are left alone. Returns (H, W, 3) uint8.
    """
    image = rgb.copy()
    for index, role in roles.items():
        mask, color = objects[index].mask, np.array(ON_DARK[role])
        image[mask] = (image[mask] * (1 - TINT) + color * TINT).astype(np.uint8)
        outline, _ = cv2.findContours(mask.view(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_SIMPLE)
        cv2.drawContours(image, outline, -1, ON_DARK[role], max(1, rgb.shape[1] // 500), cv2.LINE_AA)
    return image


def box_edges_2d(
    box: Box3D, camera: Camera, open_sides: Sequence[Side] | None = None, near: float = 0.05
) -> np.ndarray:
    """Visible edges of a 3D box in the image, clipped at the image plane; those of open sides have a gap.

    Returns (M, 2, 2) float64: start and end of each line, pixels.
    """
    ends = drawn_edges(box, open_sides)
    a, b = ends[:, 0], ends[:, 1]
    keep = (a[:, 2] > near) | (b[:, 2] > near)
    a, b = a[keep], b[keep]
    # An edge that crosses the near plane is cut there instead of being mirrored.
    t = np.divide(near - a[:, 2], b[:, 2] - a[:, 2], out=np.zeros(len(a)), where=np.abs(b[:, 2] - a[:, 2]) > 1e-9)
    cut = (a + np.clip(t, 0, 1)[:, None] * (b - a)) + np.array([0, 0, 1e-6])
    a = np.where((a[:, 2] <= near)[:, None], cut, a)
    b = np.where((b[:, 2] <= near)[:, None], cut, b)
    return np.stack([project(a, camera), project(b, camera)], axis=1)


def roles_of(pair: ScoredPair) -> dict[int, Role]:
    """Roles of the objects of an answer: target or reference, by index."""
    roles: dict[int, Role] = {k: "reference" for k in (pair.second_reference, pair.reference) if k is not None}
    roles[pair.target] = "target"
    return roles


def edges_path(
    box: Box3D,
    camera: Camera,
    open_sides: Sequence[Side] | None = None,
    origin: tuple[float, float] = (0.0, 0.0),
) -> str:
    """SVG path of the visible edges of a 3D box, in pixels of the picture from `origin`."""
    reach = 8 * camera.width
    edges = box_edges_2d(box, camera, open_sides) - np.array(origin)
    edges = np.clip(edges[np.isfinite(edges).all(axis=(1, 2))], -reach, reach)
    return "".join(f"M{a[0]:.1f} {a[1]:.1f}L{b[0]:.1f} {b[1]:.1f}" for a, b in edges)


_outlines = Recent[tuple[tuple[int, ...], bytes], str](64)


def outline_path(mask: np.ndarray) -> str:
    """SVG path of the outlines of a mask; those of the last few masks are kept."""
    mask = np.ascontiguousarray(mask)

    def draw() -> str:
        return "".join("M" + "L".join(f"{x:.1f} {y:.1f}" for x, y in line.tolist()) + "Z" for line in outlines(mask))

    return _outlines.get((mask.shape, xxhash.xxh3_128_digest(mask.data)), draw)


@dataclass(frozen=True)
class AnswerRoles:
    """Labelled objects of an answer."""

    labelled: dict[int, int]  # index of a detection -> the labelled object that it is
    # dict of int to (Role, SceneObject): index of a labelled object -> its role and itself: the labelled target and
    # reference, where they are known
    truth: dict[int, tuple[Role, SceneObject]]


def answer_roles(answered: Answer) -> AnswerRoles:
    """Labelled objects of an answer."""
    trace, judged = answered.trace, answered.diagnosis
    labelled: dict[int, int] = {}
    truth: dict[int, tuple[Role, SceneObject]] = {}
    if judged is not None:
        evidence, case = judged.evidence, judged.case
        # Another parse than the gold triple is judged by detections of its own.
        if trace is not None and evidence.answers.objects is trace.objects:
            labelled = {index: int(k) for index, k in enumerate(evidence.match) if k >= 0}
        ends: tuple[tuple[Role, int], ...] = (("target", case.target_object), ("reference", case.reference_object))
        for role, k in ends[: 2 if case.reference else 1]:
            entry = evidence.objects.get(k, points=True)
            if entry is not None:
                truth[k] = role, entry
    return AnswerRoles(labelled, truth)


MARGIN = 0.14
LEAST = 0.3
"""How much of a frame's width a picture shows at least."""
GROUND = (14, 16, 20)
Stroke = Literal["thick", "thin", "dashed"]
CROSS = 8
"""Half the size of a ✕, pixels of the crop."""


@dataclass(frozen=True)
class Outline:
    """Box to draw."""

    box: np.ndarray  # (4,) float64: x0, y0, x1, y1, pixels of the frame
    color: RGB
    style: Stroke = "thick"  # "thick", "thin" or "dashed": colours are doubled by it
    crossed: bool = False  # With a red ✕ at its corner: of what is wrong


def answer_crop(rgb: np.ndarray, outlines: Sequence[Outline], size: tuple[int, int] = (360, 270)) -> np.ndarray:
    """Crop a picture to all boxes with a margin, and draw the boxes.

    `rgb`: (H, W, 3) uint8; `outlines`: without any the whole frame is shown; `size`: width and height, pixels. Returns
    (size[1], size[0], 3) uint8.
    """
    image, scale, corner = window(rgb, np.array([o.box for o in outlines]), size)
    for outline in outlines:
        ends = (outline.box.reshape(2, 2) - corner) * scale
        draw_outline(image, ends.ravel(), outline.color, outline.style)
        if outline.crossed:
            at = np.clip([ends[1, 0], ends[0, 1]], CROSS + 4, np.array(size) - CROSS - 4)
            cv2.circle(image, tuple(np.round(at).astype(int).tolist()), CROSS + 4, GROUND, -1, cv2.LINE_AA)
            arms = (at + CROSS * np.array([[[-1, -1], [1, 1]], [[-1, 1], [1, -1]]]) * 0.6).round().astype(np.int32)
            cv2.polylines(image, list(arms), False, ON_DARK["bad"], 3, cv2.LINE_AA)
    return image


def window(
    rgb: np.ndarray, boxes: np.ndarray, size: tuple[int, int], least: float = LEAST
) -> tuple[np.ndarray, float, np.ndarray]:
    """Cut a picture to boxes, (N, 4), with a margin: the cut, its scale, and its corner in the picture, (2,) pixels."""
    height, width = rgb.shape[:2]
    ends = np.asarray(boxes, np.float64).reshape(-1, 4)
    low, high = np.array([0.0, 0.0]), np.array([width, height], np.float64)
    if len(ends):
        low, high = ends[:, :2].min(axis=0), ends[:, 2:].max(axis=0)
    # As wide as it must be, in the shape of the picture.
    span = np.maximum((high - low) * (1 + 2 * MARGIN), least * width * np.array([1, size[1] / size[0]]))
    scale = float(min(np.array(size) / np.minimum(span, np.maximum(high - low, [width, height]))))
    shown = np.array(size) / scale
    corner = (low + high) / 2 - shown / 2
    # Inside the frame where it fits, else in its middle.
    room = np.array([width, height]) - shown
    corner = np.where(room >= 0, np.clip(corner, 0, np.maximum(room, 0)), room / 2)
    move = np.array([[scale, 0, -corner[0] * scale], [0, scale, -corner[1] * scale]])
    return cv2.warpAffine(rgb, move, size, borderMode=cv2.BORDER_CONSTANT, borderValue=GROUND), scale, corner


def draw_outline(image: np.ndarray, box: np.ndarray, color: RGB, style: Stroke = "thick") -> None:
    """Draw a box, (4,) pixels of the picture, with a dark rim."""
    x0, y0, x1, y1 = box
    corners = np.clip([[x0, y0], [x1, y0], [x1, y1], [x0, y1], [x0, y0]], -2000, 4000)
    lines = np.stack([corners[:-1], corners[1:]], axis=1)
    lines = np.round(dashed(lines, 16.0) if style == "dashed" else lines).astype(np.int32)
    wide = 3 if style == "thick" else 2
    for paint, thick in (((0, 0, 0), wide + 2), (color, wide)):
        cv2.polylines(image, list(lines), False, paint, thick, cv2.LINE_AA)
