"""The image with what was found drawn over it, as one SVG: sharp at any size, in the colours of the page."""

from __future__ import annotations

import base64
from dataclasses import dataclass
from html import escape

import cv2
import numpy as np

from pipeline.answering.objects import SceneObject
from pipeline.diagnosis.answer import Answer
from pipeline.geometry.boxes import Box3D
from pipeline.geometry.camera import Camera
from pipeline.geometry.frame import Frame
from pipeline.geometry.masks import MaskCrop
from pipeline.geometry.palette import Role
from spatialviz.report.picture import box_edges_2d, roles_of

WIDEST = 1280
QUALITY = 86
SMALLEST_PART = 6
"""Pixels of outline below which a part of a mask is not drawn."""
_GLYPH = 0.53
"""Mean width of a letter over the size of the type."""


def picture_svg(frame: Frame, cast: AnswerRoles) -> str:
    """Masks and 3D boxes of the answer, dashed outlines of what is true, and a tag on each."""
    width, height = frame.width, frame.height
    unit = width / 640
    parts = [
        f'<svg class="picture" viewBox="0 0 {width} {height}" role="img" aria-label="The answer over the image">',
        f'<image href="{_jpeg(frame.rgb)}" width="{width}" height="{height}"/>',
        f'<g style="--u:{unit:.3f}">',
    ]
    for role, entry in cast.truth.values():
        parts.append(f'<path class="true {role}" d="{_outline(entry.mask)}"/>')
    for index, role in cast.roles.items():
        parts.append(f'<path class="mask {role}" d="{_outline(cast.objects[index].mask)}"/>')
    for index, role in cast.roles.items():
        box = cast.objects[index].lifted.box
        if box is not None:
            parts.append(f'<path class="box {role}" d="{_edges(box, frame.camera)}"/>')
    taken: list[tuple[float, float, float, float]] = []
    for index, role in reversed(cast.roles.items()):
        entry = cast.objects[index]
        parts.append(_tag(f"{entry.label} {entry.score:.2f}", role, entry.bbox, frame, taken))
    shown = {cast.labelled.get(index) for index in cast.roles}
    for k, (role, entry) in cast.truth.items():
        if k not in shown and entry.mask.any():
            bbox = np.array(MaskCrop(0, 0, entry.mask).box, np.float64)
            parts.append(_tag(f"true {role}: {entry.label}", "truth", bbox, frame, taken))
    return "".join([*parts, "</g></svg>"])


def _jpeg(rgb: np.ndarray) -> str:
    if rgb.shape[1] > WIDEST:
        size = (WIDEST, max(1, round(rgb.shape[0] * WIDEST / rgb.shape[1])))
        rgb = cv2.resize(rgb, size, interpolation=cv2.INTER_AREA)
    data = cv2.imencode(".jpg", np.ascontiguousarray(rgb[..., ::-1]), [cv2.IMWRITE_JPEG_QUALITY, QUALITY])[1]
    return "data:image/jpeg;base64," + base64.b64encode(data.tobytes()).decode("ascii")


def _outline(mask: np.ndarray) -> str:
    found, _ = cv2.findContours(mask.view(np.uint8), cv2.RETR_CCOMP, cv2.CHAIN_APPROX_SIMPLE)
    paths = []
    for contour in found:
        if len(contour) < 3 or cv2.arcLength(contour, True) < SMALLEST_PART:
            continue
        points = cv2.approxPolyDP(contour, 0.7, True)[:, 0]
        paths.append("M" + "L".join(f"{x + 0.5:g} {y + 0.5:g}" for x, y in points.tolist()) + "Z")
    return "".join(paths)


def _edges(box: Box3D, camera: Camera) -> str:
    reach = 8 * camera.width
    edges = box_edges_2d(box, camera)
    edges = np.clip(edges[np.isfinite(edges).all(axis=(1, 2))], -reach, reach)
    return "".join(f"M{a[0]:.1f} {a[1]:.1f}L{b[0]:.1f} {b[1]:.1f}" for a, b in edges)


def _tag(
    text: str, role: Role, bbox: np.ndarray, frame: Frame, taken: list[tuple[float, float, float, float]]
) -> str:
    """A name at its object, moved down where another tag already stands."""
    text = text if len(text) <= 40 else text[:39] + "…"
    unit = frame.width / 640
    size, high = 11.5 * unit, 18 * unit
    wide = len(text) * size * _GLYPH + 12 * unit
    x = float(np.clip(bbox[0], 0, max(frame.width - wide, 0)))
    # What is true has its name below, so that neither hides the other's object.
    above = bbox[3] + 2 * unit if role == "truth" else bbox[1] - high - 2 * unit
    y = float(np.clip(above, 0, frame.height - high))
    for _ in range(8):
        if not any(x < r and x + wide > left and y < b and y + high > t for left, t, r, b in taken):
            break
        y = y + high + 2 * unit if y + 2 * high < frame.height else 0.0
    taken.append((x, y, x + wide, y + high))
    return (
        f'<g class="tag {role}"><rect x="{x:.1f}" y="{y:.1f}" width="{wide:.1f}" height="{high:.1f}" '
        f'rx="{3 * unit:.1f}"/>'
        f'<text x="{x + wide / 2:.1f}" y="{y + high * 0.70:.1f}" font-size="{size:.1f}" '
        'text-anchor="middle" '
        f'textLength="{wide - 12 * unit:.1f}" lengthAdjust="spacingAndGlyphs">{escape(text)}</text></g>'
    )


@dataclass(frozen=True)
class AnswerRoles:
    """The roles of one answer.

    Attributes
    ----------
    objects : tuple of SceneObject
        As detected.
    target, reference : int or None
        Indices of the answer's objects.
    roles : dict of int to Role
        Index -> target or reference, for the answer's objects.
    right : (int, int) or None
        Indices of the best right pair among the detections.
    labelled : dict of int to int
        Index -> the labelled object that it is.
    truth : dict of int to (Role, SceneObject)
        Index of a labelled object -> its role and itself: the labelled target and reference, where they are known.
    exact : bool
        The detections are the dataset's own.
    """

    objects: tuple[SceneObject, ...]
    target: int | None
    reference: int | None
    roles: dict[int, Role]
    right: tuple[int, int] | None
    labelled: dict[int, int]
    truth: dict[int, tuple[Role, SceneObject]]
    exact: bool

    def name(self, index: int) -> str:
        """An object as the tables call it."""
        return self.objects[index].name(index, self.exact)


def answer_roles(answered: Answer) -> AnswerRoles:
    """The roles of an answer."""
    trace, judged = answered.trace, answered.diagnosis
    objects: tuple[SceneObject, ...] = () if trace is None else trace.objects
    best = None if trace is None or trace.ranking is None else next(iter(trace.ranking.pairs), None)
    right = None
    labelled: dict[int, int] = {}
    truth: dict[int, tuple[Role, SceneObject]] = {}
    if judged is not None:
        evidence, case = judged.evidence, judged.case
        # Another parse than the gold triple is judged by detections of its own.
        if evidence.answers.objects is objects:
            pair = judged.right
            right = None if pair is None or pair.reference is None else (pair.target, pair.reference)
            labelled = {index: int(k) for index, k in enumerate(evidence.match) if k >= 0}
        ends: tuple[tuple[Role, int], ...] = (("target", case.target_object), ("reference", case.reference_object))
        for role, k in ends:
            entry = evidence.objects.get(k, points=True)
            if entry is not None:
                truth[k] = role, entry
    return AnswerRoles(
        objects, None if best is None else best.target, None if best is None else best.reference,
        {} if best is None else roles_of(best), right, labelled, truth, trace is not None and trace.exact,
    )  # fmt: skip
