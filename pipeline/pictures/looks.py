"""An answer in its frame: over the picture, and in 3D from the pair's viewpoint, with names at the boxes."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property

import cv2
import numpy as np

from pipeline.answering.ask import Trace
from pipeline.answering.coordinate_conventions import pixel_scale
from pipeline.answering.objects import SceneObject
from pipeline.answering.pipeline import file_of, line_of
from pipeline.diagnosis.answer import Answer
from pipeline.diagnosis.imported_answers import answered_box
from pipeline.geometry.boxes import Box3D, Side, edge_lines
from pipeline.geometry.cloud import cloud_of, viewpoint
from pipeline.geometry.frame import Frame
from pipeline.geometry.palette import ON_DARK, RGB, Role
from pipeline.pictures.marks import AnswerRoles, Stroke, answer_roles, draw_outline, roles_of, tinted
from pipeline.pictures.scene_view import PictureView, Wire, quiet_colors, scene_picture
from pipeline.pictures.shapes import CHECK, Box, paste, strokes
from pipeline.pictures.text import draw_text, font, plain, shortened, width_of
from pipeline.system.frozen import dataclass

GROUND: RGB = (9, 11, 14)
INK: RGB = (18, 20, 24)

SPOT = 0.012
"""Half the side of the box around a point, as a share of the frame's width."""


@dataclass(frozen=True)
class Named:
    """Object of an answer, or of its truth."""

    bbox: np.ndarray  # (4,) float64: x0, y0, x1, y1, pixels of the frame
    role: Role  # "target" or "reference"
    name: str
    right: bool  # By the labels
    given: bool  # Of the answer
    entry: SceneObject | None = None  # None for what an imported answer points at

    @staticmethod
    def of(entry: SceneObject, role: Role, name: str, right: bool, given: bool) -> Named:
        """Detected or labelled object."""
        return Named(np.asarray(entry.bbox, np.float64), role, name, right, given, entry)

    @property
    def box(self) -> Box3D | None:
        """3D box, camera frame; None without one."""
        return None if self.entry is None else self.entry.box

    @property
    def open_sides(self) -> Sequence[Side]:
        """Sides of its box on which it may go on; of what is labelled none is told."""
        return () if self.entry is None or not self.given else self.entry.lifted.open_sides or ()

    @property
    def color(self) -> RGB:
        """Colour of its box."""
        return ON_DARK[self.role if self.given else "truth"]


@dataclass(frozen=True)
class Look:
    """What an answer's picture shows."""

    answer: Answer
    frame: Frame | None  # None where nothing was looked at
    beside: Look | None = None  # Another answer whose objects are in view, too

    @cached_property
    def trace(self) -> Trace | None:
        """Trace of an answer with an object."""
        trace = self.answer.trace
        return trace if trace is not None and self.answer.pairs else None

    @cached_property
    def known(self) -> AnswerRoles:
        """Labelled objects of the answer."""
        return answer_roles(self.answer)

    @cached_property
    def given(self) -> tuple[Named, ...]:
        """Objects of the answer, the target first."""
        trace = self.trace
        if trace is None:
            return self._pointed_at()
        roles = sorted(roles_of(self.answer.pairs[0]).items(), key=lambda item: item[1] != "target")
        true = {(role, k) for k, (role, _) in self.known.truth.items()}
        right = self.answer.diagnosis is not None and self.answer.diagnosis.correct
        return tuple(
            Named.of(
                trace.objects[k],
                role,
                self.name(k),
                (role, self.known.labelled.get(k)) in true or (right and role == "target"),
                True,
            )
            for k, role in roles
        )

    def _pointed_at(self) -> tuple[Named, ...]:
        """Answer of an imported line that is among no detections: a box, or around a point."""
        d, frame = self.answer.diagnosis, self.frame
        source = None if d is None else d.evidence.answers.source
        if d is None or source is None or source.line is None or frame is None:
            return ()
        line, predictions = line_of(source), file_of(source)
        box, spot = answered_box(line, predictions, frame), None if line.answer is None else line.answer.point
        if box is None and spot is not None:
            at = np.array(spot) * pixel_scale(predictions.header, frame.width, frame.height)
            box = np.concatenate([at, at]) + SPOT * frame.width * np.array([-1, -1, 1, 1])
        return () if box is None else (Named(box, "target", "answer", d.correct, True),)

    @cached_property
    def missed(self) -> tuple[Named, ...]:
        """Labelled target and reference, those that the answer does not have."""
        answered = (
            set()
            if self.trace is None
            else {(role, self.known.labelled.get(k)) for k, role in roles_of(self.answer.pairs[0]).items()}
        )
        return tuple(
            Named.of(entry, role, self._label(k, entry), True, False)
            for k, (role, entry) in self.known.truth.items()
            if (role, k) not in answered
        )

    def _label(self, k: int, entry: SceneObject) -> str:
        """Name of a labelled object, with its number where it was detected under its label."""
        alike = (i for i, of in self.known.labelled.items() if of == k and self.answer.objects[i].label == entry.label)
        return next(map(self.name, alike), entry.label)

    def name(self, index: int) -> str:
        """Name of an object of the answer, with its number."""
        return "" if self.answer.trace is None else self.answer.trace.name(index).replace("·", " ")

    @property
    def all(self) -> tuple[Named, ...]:
        """Objects to draw, those of the answer last."""
        return (*self.missed, *reversed(self.given))


def frame_picture(answer: Answer, frame: Frame, widest: int) -> np.ndarray:
    """The frame with the answer's objects, boxes and names, at most so many pixels wide; (H, W, 3) uint8."""
    scale = min(1.0, widest / frame.width)
    image, placed = frame_shown(Look(answer, frame), (round(frame.width * scale), round(frame.height * scale)))
    draw_names(image, placed)
    return image


Placed = list[tuple[Named, np.ndarray]]
"""Objects of a picture with the corners of their boxes in it, (N, 2) float64, pixels."""


def frame_shown(look: Look, size: tuple[int, int]) -> tuple[np.ndarray, Placed]:
    """The whole frame with the answer's objects and boxes, (size[1], size[0], 3) uint8, and where these are."""
    assert look.frame is not None
    rgb = look.frame.rgb
    if look.trace is not None:
        rgb = tinted(rgb, look.trace.objects, roles_of(look.answer.pairs[0]))
    scale = min(size[0] / rgb.shape[1], size[1] / rgb.shape[0])
    width, height = (max(1, round(n * scale)) for n in (rgb.shape[1], rgb.shape[0]))
    x, y = (size[0] - width) // 2, (size[1] - height) // 2
    image = np.full((size[1], size[0], 3), GROUND, np.uint8)
    how = cv2.INTER_AREA if scale < 1 else cv2.INTER_CUBIC
    image[y : y + height, x : x + width] = cv2.resize(rgb, (width, height), interpolation=how)
    wide: Stroke = "thick" if size[0] > 400 else "thin"
    placed = []
    for named in look.all:
        box = named.bbox * scale + [x, y, x, y]
        draw_outline(image, box, named.color, wide if named.given else "dashed")
        placed.append((named, box[[0, 1, 2, 1, 2, 3, 0, 3]].reshape(4, 2)))
    return image, placed


def scene_shown(look: Look, size: tuple[int, int]) -> tuple[np.ndarray, Placed, list[np.ndarray]] | None:
    """The frame in 3D with the answer's boxes, (size[1], size[0], 3) uint8, where these are, and all that is in view.

    None where nothing of the answer or its truth has a box, or the frame no depth.
    """
    trace = look.trace
    if trace is None:
        return None
    frame, axes = trace.frame, trace.viewer
    to_show = np.stack([axes.right, axes.forward, axes.up])
    boxed = [(n, n.box.turned(to_show, 0.0)) for n in look.all if n.box is not None]
    cloud = cloud_of(frame, axes)
    if not boxed or not len(cloud.points):
        return None
    also = () if look.beside is None else (n.box for n in look.beside.all)
    every = [*(box.corners for _, box in boxed), *(box.turned(to_show, 0.0).corners for box in also if box)]
    about = np.concatenate(every)
    spacing = float(np.median(np.linalg.norm(about, axis=1))) / frame.camera.fx
    view = PictureView.at(
        viewpoint("pair", cloud.points, to_show, frame.camera, size[0] / size[1], about), size, spacing
    )
    masks = [n.entry.mask for n, _ in boxed if n.entry is not None and n.entry.mask.shape == frame.depth.shape]
    loud = np.any([np.zeros(frame.depth.shape, np.bool_), *masks], axis=0)[cloud.v, cloud.u]
    wires = [Wire(edge_lines([box], GROWN, [n.open_sides]), n.color, not n.given) for n, box in boxed]
    image = scene_picture(cloud, quiet_colors(cloud.painted(frame.rgb), loud), wires, view, GROUND)
    seen = [view.seen(corners)[:, :2].astype(np.float64) for corners in every]
    return image, [(n, corners) for (n, _), corners in zip(boxed, seen, strict=False)], seen


GROWN = 0.008
"""Boxes are drawn so much larger, so that the points of their sides do not hide them, metres."""


def free_corner(
    size: tuple[int, int], part: tuple[int, int], boxes: Sequence[np.ndarray], gap: int, above: bool = False
) -> tuple[int, int]:
    """Corner of a picture, as left and top of a part put there, in which the part hides least of the boxes.

    `above`: one of the upper two.
    """
    tops = (gap,) if above else (gap, size[1] - part[1] - gap)
    places = [(x, y) for y in tops for x in (size[0] - part[0] - gap, gap)]

    def hidden(at: tuple[int, int]) -> float:
        low, high, total = np.array(at), np.array(at) + part, 0.0
        for corners in boxes:
            first, last = corners.min(axis=0), corners.max(axis=0)
            shared = np.clip(np.minimum(last, high) - np.maximum(first, low), 0, None).prod()
            total += shared / max((last - first).prod(), 1.0)
        return total

    return min(places, key=hidden)


TAG, TAG_SIZE, WIDEST_TAG = 26, 14, 230
"""Height of a name's tag, size of its letters, and its width at most, pixels."""


def draw_names(image: np.ndarray, placed: Placed, taken: Sequence[Box] = ()) -> None:
    """Draw names at boxes, none over another or over what is taken, nor over a small box where there is room."""
    filled, small = [*taken], [own for own in (_around(corners) for _, corners in placed) if own[2] < LARGE]
    face = font(TAG_SIZE, True)
    for named, corners in reversed(placed):
        name = shortened(plain(named.name, INK), face, WIDEST_TAG - 34)
        mark = 20 if named.right else 0
        width = round(width_of(name, face)) + mark + 18
        where = _place(image, corners, width, filled, small)
        if where is None:
            continue
        filled.append(where)
        x, y = where[:2]
        paste(image, named.color, where, 5)
        if mark:
            strokes(image, CHECK, (x + 7, y + 4, 18, 18), INK, 2)
        draw_text(image, name, (x + 9 + mark, y + 18), face)


LARGE = 200
"""Boxes that are as wide have their name at a corner, and others at the middle of a side, pixels."""


def _place(
    image: np.ndarray, corners: np.ndarray, width: int, filled: Sequence[Box], small: Sequence[Box]
) -> Box | None:
    """Place of a tag at a box: above it, below, at its sides or in it, else nowhere."""
    height, wide = image.shape[:2]
    inside = (corners >= 0).all(axis=1) & (corners <= [wide, height]).all(axis=1)
    corners = corners[inside] if inside.any() else np.clip(corners, 0, [wide, height])
    low, high = corners.min(axis=0), corners.max(axis=0)
    top, bottom, left, right = (corners[k] for k in (*_ends(corners[:, 1]), *_ends(corners[:, 0])))
    if high[0] - low[0] < LARGE:
        middle = (low + high) / 2
        top, bottom = (np.array([middle[0], end]) for end in (low[1], high[1]))
        left, right = (np.array([end, middle[1]]) for end in (low[0], high[0]))
    starts = (
        top - [width / 2, TAG + 6],
        bottom - [width / 2, -6],
        right - [-6, TAG / 2],
        left - [width + 6, TAG / 2],
        (low + high - [width, TAG]) / 2,
    )
    limit = np.maximum(6, [wide - width - 6, height - TAG - 6])
    places = [(int(x), int(y), width, TAG) for x, y in (np.clip(start, 6, limit) for start in starts)]
    own = _around(corners)
    beside = [at for at in places[:-1] if not _overlap(at, own)]
    clear = [at for at in beside if not any(_overlap(at, box) for box in small)]
    tries = (*clear, *beside, *places)
    return next((at for at in tries if at[0] + width <= wide and not any(_overlap(at, o) for o in filled)), None)


def _around(corners: np.ndarray) -> Box:
    """Rectangle around corners."""
    (x0, y0), (x1, y1) = corners.min(axis=0), corners.max(axis=0)
    return int(x0), int(y0), int(x1 - x0), int(y1 - y0)


def _ends(values: np.ndarray) -> tuple[int, int]:
    return int(values.argmin()), int(values.argmax())


def _overlap(a: Box, b: Box) -> bool:
    return a[0] < b[0] + b[2] and b[0] < a[0] + a[2] and a[1] < b[1] + b[3] and b[1] < a[1] + a[3]
