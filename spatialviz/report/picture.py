"""A picture of an answer: masks, boxes and names over the colour image, without any screen."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import cv2
import numpy as np

from pipeline.answering.ask import Trace
from pipeline.answering.objects import SceneObject
from pipeline.answering.pair_table import ScoredPair
from pipeline.answering.told_answer import best_pair, told
from pipeline.geometry.boxes import EDGES, Box3D
from pipeline.geometry.camera import Camera, project
from pipeline.geometry.palette import ON_DARK, Role
from pipeline.system.errors import InputError
from pipeline.system.whole_files import write_whole

TINT = 0.45


def tinted(rgb: np.ndarray, objects: Sequence[SceneObject], roles: Mapping[int, Role]) -> np.ndarray:
    """The picture with the masks of objects in a role tinted in its colour, outlined.

    Parameters
    ----------
    rgb : (H, W, 3) uint8
    objects : sequence of SceneObject
    roles : mapping
        Place in `objects` -> role; the rest is left alone.

    Returns
    -------
    (H, W, 3) uint8
    """
    image = rgb.copy()
    for index, role in roles.items():
        mask, color = objects[index].mask, np.array(ON_DARK[role])
        image[mask] = (image[mask] * (1 - TINT) + color * TINT).astype(np.uint8)
        outline, _ = cv2.findContours(mask.view(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_SIMPLE)
        cv2.drawContours(image, outline, -1, ON_DARK[role], max(1, rgb.shape[1] // 500), cv2.LINE_AA)
    return image


def box_edges_2d(box: Box3D, camera: Camera, near: float = 0.05) -> np.ndarray:
    """The visible edges of a 3D box in the image, clipped at the image plane.

    Returns
    -------
    (M, 2, 2) float64
        Start and end of each edge, pixels; M <= 12.
    """
    ends = box.corners[EDGES]
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
    """Index -> target or reference, for the objects of an answer."""
    roles: dict[int, Role] = {k: "reference" for k in (pair.second_reference, pair.reference) if k is not None}
    roles[pair.target] = "target"
    return roles


def answer_picture(trace: Trace) -> np.ndarray:
    """The answer of a trace drawn over its frame: (H + caption, W, 3) uint8."""
    roles = roles_of(trace.ranking.pairs[0]) if trace.ranking is not None and trace.ranking.pairs else {}
    image = tinted(trace.frame.rgb, trace.objects, roles)
    scale = max(1.0, trace.frame.width / 640)
    for index, role in roles.items():
        entry = trace.objects[index]
        if entry.lifted.box is not None:
            for start, end in box_edges_2d(entry.lifted.box, trace.frame.camera):
                _line(image, start, end, ON_DARK[role], max(1, round(1.5 * scale)))
    for index, role in roles.items():
        entry = trace.objects[index]
        _tag(image, f"{entry.label} {entry.score:.2f}", entry.bbox[:2], ON_DARK[role], 0.5 * scale)
    return np.concatenate([image, _caption(trace, image.shape[1], scale)])


def save_picture(trace: Trace, path: Path) -> None:
    """Write the picture of an answer; raises as `write_picture`."""
    write_picture(answer_picture(trace), path)


def write_picture(image: np.ndarray, path: Path) -> None:
    """Write a picture ((H, W, 3) uint8 RGB), whole or not at all; the format follows the file's ending.

    Raises
    ------
    InputError
        Where the folder does not exist or cannot be written, or the ending is not that of an image.
    """
    if not path.parent.is_dir():
        raise InputError("the folder for the picture does not exist", path=path.parent)
    try:
        ok, data = cv2.imencode(path.suffix or ".", image[..., ::-1])
    except cv2.error:
        ok, data = False, np.zeros(0, np.uint8)
    if not ok:
        raise InputError("cannot write a picture of this kind", got=path.suffix, expected=".png or .jpg", path=path)
    write_whole(path, data.tobytes(), "the picture")


def _line(image: np.ndarray, start: np.ndarray, end: np.ndarray, color: Sequence[int], width: int) -> None:
    height, wide = image.shape[:2]
    a, b = (tuple(int(np.clip(x, -8 * wide, 8 * wide)) for x in point) for point in (start, end))
    inside, p, q = cv2.clipLine((0, 0, wide, height), a, b)
    if inside:
        cv2.line(image, p, q, tuple(color), width, cv2.LINE_AA)


def _tag(image: np.ndarray, text: str, at: np.ndarray, color: Sequence[int], scale: float) -> None:
    text = text.encode("ascii", "replace").decode()
    (w, h), base = cv2.getTextSize(text, cv2.FONT_HERSHEY_SIMPLEX, scale, 1)
    x = int(np.clip(at[0], 0, max(image.shape[1] - w - 8, 0)))
    y = int(np.clip(at[1], h + base + 4, image.shape[0]))
    cv2.rectangle(image, (x, y - h - base - 4), (x + w + 8, y), tuple(color), -1)
    cv2.putText(image, text, (x + 4, y - base), cv2.FONT_HERSHEY_SIMPLEX, scale, (20, 20, 20), 1, cv2.LINE_AA)


def _caption(trace: Trace, width: int, scale: float) -> np.ndarray:
    text = str(trace.query.expression)
    if best_pair(trace) is None:
        text += ": no answer"
    else:
        answer = told(trace, lambda index: trace.objects[index].label)
        text += f": {answer.numbers if answer.holds else answer.sentence('this pair')} ({trace.scorer})"
    strip = np.full((round(26 * scale), width, 3), 24, np.uint8)
    cv2.putText(
        strip,
        text.encode("ascii", "replace").decode(),
        (round(8 * scale), round(18 * scale)),
        cv2.FONT_HERSHEY_SIMPLEX,
        0.48 * scale,
        (235, 235, 235),
        1,
        cv2.LINE_AA,
    )
    return strip


def dashed(segments: np.ndarray, period: float, share: float = 0.55) -> np.ndarray:
    """Line segments cut into dashes.

    Parameters
    ----------
    segments : (N, 2, D) float
        Start and end of each.
    period : float
        Length of a dash with its gap, about: each segment holds a whole number of dashes, and ends with one.
    share : float
        Of the dash in it, 0..1.

    Returns
    -------
    (M, 2, D) float32
        In the order of the segments.
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
