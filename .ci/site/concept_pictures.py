"""Pictures of the concepts: the pipeline, frames of reference, up, lengths, registration, and what is kept."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import cache

import cv2
import numpy as np
from svg import BAD, DOUBT, EDGE, INK, QUIET, REFERENCE, SURFACE, TARGET, TRUTH, Card

from pipeline.diagnosis import opened
from pipeline.diagnosis.answer import Answer
from pipeline.geometry.palette import ON_DARK, Role
from pipeline.geometry.viewer import viewer_axes
from pipeline.language.relation_names import DIRECTIONAL
from pipeline.pictures.looks import Look, scene_shown
from pipeline.pictures.marks import draw_outline, tinted, window


@cache
def asked() -> Answer:
    """The question of the picture of the pipeline."""
    return opened.open("demo", detector="simulated").ask(0, "bottle right of the laptop")


STAGES = (
    ("OPM", "finds the objects", "In: the colour picture, and each name by itself.", "Out: boxes, masks and scores."),
    ("LIFT", "makes them 3D", "In: a mask, depth, camera.", "Out: cleaned points, and a 3D box in metres."),
    ("SRM", "judges relations", "In: two objects in 3D.", "Out: a probability for each relation."),
    ("PRM", "ranks the pairs", "In: all scores and probabilities.", "Out: the pair with the highest product."),
)
PART = (444, 250)


def pipeline_card() -> Card:
    """Picture of the pipeline, with what goes in and out of each stage, of one question."""
    answer = asked()
    trace, pair = answer.needed_trace(), answer.pairs[0]
    card = Card(960, 616, "The pipeline: OPM, LIFT, SRM and PRM, with what goes in and out of each, for one question")
    x = 24 + card.spans(
        24, 46, [("“", INK), ("bottle", TARGET), (" right of the ", INK), ("laptop", REFERENCE), ("”", INK)], 27
    )
    card.arrow((x + 6, 37), (x + 46, 37))
    card.text(x + 56, 45, "PARSE: target, relation, reference", 20, QUIET)
    corners = [(24 + (PART[0] + 24) * (k % 2), 72 + (PART[1] + 22) * (k // 2)) for k in range(4)]
    for (x, y), (name, does, given, found) in zip(corners, STAGES, strict=True):
        card.box(x, y, *PART, fill=SURFACE, stroke=EDGE, radius=10)
        card.text(x + 252, y + 44, name, 27, bold=True)
        card.text(x + 252, y + 74, does, 19, QUIET)
        at = card.paragraph(x + 252, y + 116, given, 184, 19, QUIET)
        card.paragraph(x + 252, at + 8, found, 184, 19)
    for k in (0, 2):
        (x, y), (after, _) = corners[k], corners[k + 1]
        card.arrow((x + PART[0] + 2, y + 125), (after - 2, y + 125), color=INK, head=12)
    middle = 72 + PART[1] + 11
    card.lines([(714, middle - 11), (714, middle), (246, middle), (246, middle + 2)], stroke=INK, line=2.5)
    card.arrow((246, middle), (246, middle + 10), color=INK, head=10)
    size, flat = (224, 226), (224, 168)
    roles: dict[int, Role] = {
        int(i): "target" if name == "bottle" else "reference"
        for name, found in trace.candidates.items()
        for i in found.index
    }
    boxes = np.array([trace.objects[i].bbox for i in roles])
    photo, zoom, corner = window(tinted(trace.frame.rgb, trace.objects, roles), boxes, (2 * flat[0], 2 * flat[1]))
    for i, role in roles.items():
        box = (np.asarray(trace.objects[i].bbox, float).reshape(2, 2) - corner) * zoom
        draw_outline(photo, box.ravel(), ON_DARK[role])
    x, y = corners[0]
    card.picture(photo, x + 12, y + 12, *flat)
    for k, (name, color) in enumerate((("bottle", TARGET), ("laptop", REFERENCE))):
        card.text(x + 14, y + 206 + 26 * k, f"{len(trace.candidates[name].index)} found as “{name}”", 18, color)
    shown = scene_shown(Look(answer, trace.frame), (2 * size[0], 2 * size[1]))
    assert shown is not None
    card.picture(shown[0], corners[1][0] + 12, corners[1][1] + 12, *size)
    relations(card, answer, (pair.target, pair.reference), corners[2][0] + 8, corners[2][1] + 26)
    pairs(card, answer, corners[3][0] + 2, corners[3][1] + 30)
    return card


def relations(card: Card, answer: Answer, ends: tuple[int, int | None], x: float, y: float) -> None:
    """Draw the probabilities of the relations of a pair as bars."""
    scores = answer.needed_trace().scores
    assert scores is not None
    assert ends[1] is not None
    for k, name in enumerate(DIRECTIONAL):
        p = float(scores.probabilities[ends[0], ends[1], scores.relations.index(name)])
        at = y + 36 * k
        card.text(x + 78, at + 15, name, 18, INK if name == "right" else QUIET, anchor="end", bold=name == "right")
        card.box(x + 88, at, 100, 18, fill=EDGE, radius=4)
        card.box(x + 88, at, max(3, 100 * p), 18, fill=TRUTH if name == "right" else QUIET, radius=4)
        card.text(x + 198, at + 15, f"{p:.2f}", 17, INK if name == "right" else QUIET)


def pairs(card: Card, answer: Answer, x: float, y: float) -> None:
    """List the first pairs with their factors."""
    trace = answer.needed_trace()
    for k, pair in enumerate(answer.pairs[:3]):
        assert pair.reference is not None
        at, first = y + 76 * k, k == 0
        if first:
            card.box(x + 10, at - 12, 228, 66, fill=EDGE, radius=8)
        names = [trace.name(i).replace("·", " ") for i in (pair.target, pair.reference)]
        width = card.text(x + 20, at + 12, names[0], 18, TARGET, bold=first)
        card.text(x + 26 + width, at + 12, names[1], 18, REFERENCE, bold=first)
        product = pair.p_target * pair.p_reference * pair.p_relation
        factors = f"{pair.p_target:.2f} · {pair.p_reference:.2f} · {pair.p_relation:.2f} ="
        card.text(x + 20, at + 40, factors, 17, QUIET)
        card.text(x + 230, at + 40, f"{product:.2f}", 18, INK, bold=first, anchor="end")


PITCH = np.deg2rad(28)
EYE, TABLE = np.array([0.0, 1.5, 0.0]), np.array([0.0, 0.3, 1.65])


def seen(points: Sequence[Sequence[float]] | np.ndarray, x: float, y: float, zoom: float = 97) -> np.ndarray:
    """Pixels (N, 2) of points (right, up, forward), seen from the right and above, with parallel rays."""
    turn, tilt = np.deg2rad(75), np.deg2rad(28)
    right, up, forward = np.asarray(points, float).reshape(-1, 3).T
    a, b = right * np.cos(turn) + forward * np.sin(turn), forward * np.cos(turn) - right * np.sin(turn)
    return np.stack([x + zoom * a, y - zoom * (up * np.cos(tilt) + b * np.sin(tilt))], axis=1)


def cuboid(center: Sequence[float], size: Sequence[float]) -> list[np.ndarray]:
    """Edges of a box."""
    ends = np.array([(i, j, k) for i in (-1, 1) for j in (-1, 1) for k in (-1, 1)]) * np.array(size) / 2 + center
    return [ends[[a, b]] for a in range(8) for b in range(a + 1, 8) if np.isclose(ends[a], ends[b]).sum() == 2]


def frames_card() -> Card:
    """Picture of the three frames of reference on one scene."""
    card = Card(960, 470, "Three frames of reference: the camera's, the viewer's level frame, and the world")
    axes = viewer_axes(np.array([0, -np.cos(PITCH), -np.sin(PITCH)]))
    level = axes.matrix  # From the camera frame to right, up, forward.
    shown = (
        (
            "Camera",
            "x right, y down, z forward",
            "masks, points, 3D boxes",
            [("x", level @ [1, 0, 0]), ("y", level @ [0, 1, 0]), ("z", level @ [0, 0, 1])],
            EYE,
        ),
        (
            "Level frame of the viewer",
            "right, up, forward",
            "relations are judged here",
            [("right", np.eye(3)[0]), ("up", np.eye(3)[1]), ("forward", np.eye(3)[2])],
            EYE,
        ),
        (
            "World",
            "the dataset's own axes",
            "joins the frames of a scene",
            [("X", np.array([0, 0, -1])), ("Y", np.array([1, 0, 0])), ("Z", np.array([0, 1, 0]))],
            np.array([-0.9, 0.0, 2.3]),
        ),
    )
    for k, (name, words, use, arrows, origin) in enumerate(shown):
        x = 24 + k * 308
        card.box(x, 24, 296, 422, fill=SURFACE, stroke=EDGE, radius=10)
        card.text(x + 16, 58, name, 22, bold=True)
        card.text(x + 16, 86, words, 18, QUIET)
        card.text(x + 16, 428, use, 18, INK)
        room(card, x + 56, 344, level)
        for (label, way), color in zip(arrows, (TARGET, TRUTH, REFERENCE), strict=True):
            a, b = seen([origin, origin + 0.8 * np.asarray(way)], x + 56, 344)
            card.arrow(a, b, color=color, line=3.5, head=12)
            out = (b - a) / np.linalg.norm(b - a)
            at = b + out * 12
            anchor = "start" if out[0] > 0.3 else "end" if out[0] < -0.3 else "middle"
            card.text(at[0], at[1] + (6 if abs(out[1]) < 0.8 else 0 if out[1] < 0 else 14), label, 19, color,
                      bold=True, anchor=anchor, halo=True)  # fmt: skip
    return card


def room(card: Card, x: float, y: float, level: np.ndarray) -> None:
    """Draw the floor, a table with a mug, and the camera that looks down on them."""
    for k in range(5):
        side, ahead = -0.9 + 0.45 * k, 0.5 + 0.45 * k
        card.lines(seen([(side, 0, 0.5), (side, 0, 2.3)], x, y), stroke=EDGE, line=1.5)
        card.lines(seen([(-0.9, 0, ahead), (0.9, 0, ahead)], x, y), stroke=EDGE, line=1.5)
    for edge in cuboid(TABLE, (0.9, 0.6, 0.6)):
        card.lines(seen(edge, x, y), stroke=QUIET, line=1.8)
    for edge in cuboid(TABLE + np.array([-0.1, 0.39, 0.0]), (0.16, 0.18, 0.16)):
        card.lines(seen(edge, x, y), stroke=TARGET, line=2)
    corners = np.array([(a, b, 1.0) for a, b in ((-0.55, -0.42), (0.55, -0.42), (0.55, 0.42), (-0.55, 0.42))]) * 0.42
    corners = corners @ level.T + EYE
    for corner in corners:
        card.lines(seen([EYE, corner], x, y), stroke=INK, line=1.6)
    card.lines(seen(corners, x, y), close=True, stroke=INK, line=1.6, fill=INK, opacity=0.08)


STEPS = (
    ("You say it", "--up, --level-at, spatialviz.toml, a click", TRUTH),
    ("The dataset declares it", "a field of its format, a phone's own sensor", TRUTH),
    ("The posed frames agree", "floors and tables of the whole scene", TRUTH),
    ("A level plane of this frame", "a floor, a table top", TRUTH),
    ("Assumed", "the top of the picture: a warning stands everywhere", DOUBT),
)


def up_card() -> Card:
    """Picture of where up comes from: the first that is there counts."""
    card = Card(960, 392, "How up is known: the first of five sources that is there")
    card.text(24, 46, "How up is known: the first that is there", 26, bold=True)
    for k, (name, words, color) in enumerate(STEPS):
        y = 70 + 62 * k
        card.box(24, y, 360, 48, fill=SURFACE, stroke=color, line=2, radius=9)
        card.text(44, y + 31, name, 21, bold=True)
        card.text(404, y + 31, words, 20, QUIET)
        if k < 4:
            card.arrow((60, y + 50), (60, y + 61), head=8)
    return card


UNITS = 2000
"""Depth units in one metre of the demo's files."""


def lengths_card() -> Card:
    """Picture of how a pixel becomes a point, with the numbers of a pixel of the demo."""
    frame = asked().needed_trace().frame
    camera, pixel = frame.camera, (420, 330)
    z = float(frame.depth[pixel[1], pixel[0]])
    stored = round(z * UNITS)
    a, b = (pixel[0] - camera.cx) * z / camera.fx, (pixel[1] - camera.cy) * z / camera.fy
    card = Card(960, 424, "A stored depth divided by the depth scale is metres, and with the intrinsics a point")
    card.text(24, 46, "From a stored number to a point, of one pixel of the demo", 26, bold=True)
    lines = (
        ("stored depth", f"{stored}", "the number in the file"),
        ("÷ depth scale", f"{UNITS}", "steps of the file in one metre"),
        ("= depth z", f"{z:.3f} m", "along the camera's axis, not along the ray"),
        ("x = (u − cx) · z / fx", f"{a:+.3f} m", f"({pixel[0]} − {camera.cx:g}) · {z:.3f} / {camera.fx:g}"),
        ("y = (v − cy) · z / fy", f"{b:+.3f} m", f"({pixel[1]} − {camera.cy:g}) · {z:.3f} / {camera.fy:g}"),
    )
    for k, (name, value, words) in enumerate(lines):
        y = 100 + 62 * k
        card.text(24, y, name, 20, bold=True)
        card.text(366, y, value, 20, TARGET, bold=True, anchor="end")
        card.text(24, y + 25, words, 17, QUIET)
    eye, plane, far = np.array([430.0, 250.0]), 560.0, 880.0
    point = np.array([far, 366.0])
    hit = eye + (point - eye) * (plane - eye[0]) / (far - eye[0])
    card.box(396, 72, 540, 328, fill=SURFACE, stroke=EDGE, radius=10)
    card.arrow(eye, (918, eye[1]), color=QUIET)
    card.text(912, eye[1] - 12, "z", 20, QUIET, bold=True, anchor="end")
    card.lines([(plane, 176), (plane, 324)], stroke=INK, line=3)
    card.text(plane, 164, "picture", 18, INK, anchor="middle")
    card.lines([eye, point], stroke=TARGET, line=2.5)
    card.dot(*point, 7, TARGET)
    card.dot(*hit, 5, TARGET)
    card.dot(*eye, 6, INK)
    card.text(414, eye[1] + 32, "camera", 18, INK)
    card.lines([(far, eye[1]), (far, point[1] - 8)], stroke=QUIET, dash="4 5")
    card.text(far - 10, 320, "y", 20, TARGET, bold=True, anchor="end")
    card.text(plane + 10, 273, "v − cy", 17, QUIET)
    for y, start, end, words in ((108, eye[0], plane, "fy, in pixels"), (136, eye[0], far, "z, in metres")):
        card.lines([(start, y), (end, y)], stroke=QUIET, line=1.5)
        for x in (start, end):
            card.lines([(x, y - 5), (x, y + 5)], stroke=QUIET, line=1.5)
        card.text((start + end) / 2 if words[0] == "f" else 720, y - 8, words, 17, QUIET, anchor="middle", halo=True)
    return card


def registration_card() -> Card:
    """Picture of a frame whose depth lies on its colour, and of the same with the depth moved by 14 pixels."""
    frame = asked().needed_trace().frame
    card = Card(960, 424, "Edges of the depth drawn over the colour: registered, and shifted")
    where = slice(110, 330), slice(180, 500)
    for k, (shift, words, color) in enumerate(
        ((0, "registered: edges lie on the things", TRUTH), (14, "not registered: they lie beside", BAD))
    ):
        depth = np.roll(frame.depth, shift, axis=1)[where]
        depth = cv2.medianBlur(depth.astype(np.float32), 5)
        edges = (cv2.morphologyEx(depth, cv2.MORPH_GRADIENT, np.ones((3, 3), np.uint8)) > 0.08).astype(np.uint8)
        rgb = (frame.rgb[where] * 0.62).astype(np.uint8)
        rgb[edges > 0] = ON_DARK["truth" if k == 0 else "bad"]
        x = 24 + k * 464
        rgb = cv2.resize(rgb, None, fx=2, fy=2, interpolation=cv2.INTER_NEAREST)
        card.picture(rgb, x, 68, 448, 308, 78)
        card.text(x, 50, "Depth edges over the colour" if k == 0 else "The same, 14 pixels off", 21, bold=True)
        card.text(x, 406, words, 19, color)
    return card


def kept_card() -> Card:
    """Picture of what is kept on disk, and which command makes it of what."""
    card = Card(960, 404, "What is kept: dataset, label set, journal, run and case, with the commands between them")
    things = {
        "dataset": (24, 160, "Dataset", "your frames; only read", QUIET),
        "labels": (352, 60, "Label set", "what is true", TRUTH),
        "journal": (690, 60, "Journal", "who corrected what, when", TRUTH),
        "run": (352, 260, "Run", "every answer with its verdict", REFERENCE),
        "case": (690, 260, "Case", "one question to ask again", TARGET),
    }
    for x, y, name, words, color in things.values():
        card.box(x, y, 246, 84, fill=SURFACE, stroke=color, line=2, radius=10)
        card.text(x + 18, y + 36, name, 23, bold=True)
        card.text(x + 18, y + 64, words, 17, QUIET)
    for start, end, words, at, anchor in (
        ((270, 176), (348, 108), "label", (298, 124), "end"),
        ((270, 228), (348, 296), "eval", (298, 286), "end"),
        ((598, 88), (686, 88), "correct", (642, 76), "middle"),
        ((686, 118), (602, 118), "effective", (644, 142), "middle"),
        ((475, 146), (475, 256), "judges", (488, 206), "start"),
        ((598, 302), (686, 302), "save-case", (642, 290), "middle"),
    ):
        card.arrow(start, end)
        card.text(*at, words, 17, INK, anchor=anchor)
    card.text(690, 376, "replay says whether it is still so", 17, QUIET)
    card.text(352, 376, "view --run, failures, query", 17, QUIET)
    return card


PICTURES: Mapping[str, Callable[[], Card]] = {
    "pipeline": pipeline_card,
    "frames": frames_card,
    "up": up_card,
    "lengths": lengths_card,
    "registration": registration_card,
    "kept": kept_card,
}
