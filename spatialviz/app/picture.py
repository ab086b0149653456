"""The picture with what is drawn over it, the objects with their pictures, the log."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from pipeline.answering.objects import SceneObject
from pipeline.geometry.boxes import Box3D
from pipeline.geometry.camera import Camera
from pipeline.geometry.frame import Frame
from pipeline.geometry.palette import depth_colors, depth_ends, hex_color, palette
from spatialviz.app.beside import name_tag, second_overlay
from spatialviz.app.frame_cloud import frame_colors
from spatialviz.app.frames import jpeg_url, png_url
from spatialviz.app.markup import Child, Element, chosen, h, heading, named, note, panel
from spatialviz.app.pixels_html import pixel_row_html
from spatialviz.app.state import State
from spatialviz.report.picture import box_edges_2d, tinted

IMAGE_WIDTH = 720


def image_html(state: State) -> Element:
    """The frame's picture with masks, boxes and names; a click selects the object under it."""
    if state.loaded is None:
        return panel(note(state.problem or "no frame"), cls="picture")
    frame = state.loaded.context.frame
    if state.colors == "rgb":
        picture = tinted(frame.rgb, state.shown.objects, state.roles if state.own_layer else {})
    else:
        picture = frame_colors(state.colors, state.loaded, state.roles, state.dark)
    step = max(1, round(frame.width / IMAGE_WIDTH))
    roles = (f"{role} {state.shown.names[i]}" for i, role in state.roles.items())
    alt = ", ".join((f"frame {frame.id}", *roles))
    return panel(
        pixel_row_html(state),
        h.div(
            h.img(src=jpeg_url(picture[::step, ::step]), alt=alt, draggable="false", id="photo"),
            _svg(frame, _quiet_boxes(state, frame.width / 360), "boxes"),
            _svg(frame, overlay_marks(state), "overlay"),
            h.button(
                cls="large",
                local="maximise:picture",
                title="only the picture, or both again (Esc)",
                aria_label="enlarge the picture, or show both",
            ),
            cls="pic",
            css={"--wh": f"{frame.width / frame.height:.3f}"},
            point="image:",
            band="edit:mask:rectangle:" if state.labels is None else "px-new:",
        ),
        depth_bar(state),
        cls="picture",
    )


def _svg(frame: Frame, marks: Child, name: str) -> Element:
    view = f"0 0 {frame.width} {frame.height}"
    return h.svg(marks, viewBox=view, preserveAspectRatio="none", aria_hidden="true", id=name)


def _quiet_boxes(state: State, unit: float) -> Element | None:
    """The 2D boxes of all objects, the same whatever is chosen."""
    if not state.boxes_shown or not state.own_layer:
        return None
    drawn = "".join(_rectangle(entry.bbox) for entry in state.shown.objects)
    look = {"stroke": hex_color(palette(True)["other"]), "stroke_width": f"{0.7 * unit:.2f}", "opacity": ".75"}
    return h.path(d=drawn, fill="none", **look)


def overlay_marks(state: State) -> list[Element]:
    """What is drawn over the picture of what is chosen: boxes and names, as elements of SVG in pixels of the frame."""
    if state.loaded is None:
        return []
    frame, colors, roles = state.loaded.context.frame, palette(True), state.roles
    unit = frame.width / 360
    own = range(len(state.shown.objects)) if state.own_layer else range(0)
    marks: list[Element] = []
    order = sorted((i for i in own if i in roles or i == state.selected), key=lambda i: i == state.selected)
    for i in order:
        entry = state.shown.objects[i]
        color = hex_color(colors[roles[i]]) if i in roles else "#ffffff"
        drawn = _rectangle(entry.bbox) if entry.lifted.box is None else _edges(entry.lifted.box, frame.camera)
        marks.append(h.path(d=drawn, fill="none", stroke=color, stroke_width=f"{1.3 * unit:.2f}"))
    for ghost in state.ghosts if state.flags.ghosts else ():
        look = {"stroke_width": f"{1.1 * unit:.2f}", "stroke_dasharray": f"{3 * unit:.1f} {2 * unit:.1f}"}
        drawn = _edges(ghost.box, frame.camera)
        marks.append(h.path(d=drawn, fill="none", stroke=hex_color(colors[ghost.role]), **look))
    marks += second_overlay(state, unit)
    for i in order:
        x0, y0 = _name_place(state, i)
        shape, color = (frame.height, frame.width), hex_color(colors[roles.get(i, "other")])
        marks += name_tag(state.shown.names[i], x0, y0 - 14 * unit, shape, unit, color)
    return [*marks, *_measured(state, unit)]


def _measured(state: State, unit: float) -> list[Element]:
    """The pixels between which is measured, and the line and length between them."""
    assert state.loaded is not None
    ends = [(u + 0.5, v + 0.5) for u, v in state.marks]
    marks = [h.circle(cx=u, cy=v, r=2.2 * unit, cls="measured", stroke_width=0.8 * unit) for u, v in ends]
    found = state.measured
    if found is None:
        return marks
    (x0, y0), (x1, y1) = ends
    frame = state.loaded.context.frame
    line = h.path(d=f"M{x0:.1f} {y0:.1f}L{x1:.1f} {y1:.1f}", cls="measured", stroke_width=1.2 * unit)
    text, shape = f"{found.distance:.3f} m", (frame.height, frame.width)
    return [line, *marks, *name_tag(text, (x0 + x1) / 2, (y0 + y1) / 2 + 3 * unit, shape, unit, "#f5f7fa")]


def _rectangle(bbox: np.ndarray) -> str:
    x0, y0, x1, y1 = (float(v) for v in bbox)
    return f"M{x0:.1f} {y0:.1f}H{x1:.1f}V{y1:.1f}H{x0:.1f}Z"


def _edges(box: Box3D, camera: Camera) -> str:
    return "".join(f"M{ax:.1f} {ay:.1f}L{bx:.1f} {by:.1f}" for (ax, ay), (bx, by) in box_edges_2d(box, camera))


def _name_place(state: State, i: int) -> tuple[float, float]:
    """Where the name of an object stands: at its 2D box; where its 3D box is being dragged, at that."""
    entry, moved = state.shown.objects[i], None if state.labels is None else state.labels.moved
    if state.loaded is not None and moved is not None and moved.number == entry.id:
        edges = box_edges_2d(moved.box, state.loaded.context.frame.camera)
        if len(edges):
            return float(edges[..., 0].min()), float(edges[..., 1].min())
    return float(entry.bbox[0]), float(entry.bbox[1])


def object_at(state: State, x: float, y: float) -> int | None:
    """The smallest object whose mask (else whose 2D box) holds a point, given as fractions of width and height."""
    if state.loaded is None:
        return None
    return _smallest_at(state.shown.objects, x, y) if state.own_layer else None


def second_at(state: State, x: float, y: float) -> int | None:
    """The same of the second detector's objects."""
    return _smallest_at(state.second_layer, x, y)


def _smallest_at(objects: Sequence[SceneObject], x: float, y: float) -> int | None:
    if not objects:
        return None
    height, width = objects[0].mask.shape
    u, v = int(np.clip(x * width, 0, width - 1)), int(np.clip(y * height, 0, height - 1))
    hits = [i for i, o in enumerate(objects) if o.mask[v, u]]
    return min(hits, key=lambda i: objects[i].lifted.quality.mask_pixels) if hits else None


def log_html(entries: Sequence[tuple[str, str]]) -> Element:
    """What happened, latest first."""
    rows = [h.li(h.span(time, cls="dim"), " ", text) for time, text in reversed(entries)]
    return h.ol(rows or h.li("nothing yet", cls="dim"), cls="log")


STEPS = 128
"""Colours of the bar."""


def depth_bar(state: State) -> Element | None:
    """The colours of depths with their ends and their middle, metres, while these are shown."""
    if state.loaded is None or state.colors != "depth":
        return None
    depth = state.loaded.context.frame.depth
    low, high = depth_ends(depth)
    measured = depth[depth > 0]
    colors = depth_colors(np.linspace(low, high, STEPS, dtype=np.float32)[None], (low, high))
    bar = np.concatenate([colors[..., ::-1], np.full((1, STEPS, 1), 255, np.uint8)], axis=2)
    nearest, farthest = float(measured.min()), float(measured.max())
    return h.figure(
        h.figcaption("Depth"),
        h.img(src=png_url(bar), alt=f"colours from {low:.2f} m, red, to {high:.2f} m, blue", draggable="false"),
        h.div((h.span(f"{at:.2f} m") for at in (low, (low + high) / 2, high)), cls="ticks"),
        cls="depthbar",
        title=f"Nearer and farther ones have the colours of the ends: {nearest:.2f} to {farthest:.2f} m were measured.",
    )


def objects_html(state: State) -> Element | None:
    """The objects as they are numbered, and above them those of the chosen pair once more; a click selects one."""
    if state.loaded is None:
        return None
    if not state.shown.objects:
        reason = state.loaded.problem or "Nothing is annotated or detected in this frame."
        return panel(heading("Objects"), note(reason), cls="objects")
    count = len(state.shown.objects)
    # Rows that change places would be sent again, all of them.
    pair = [_row(state, i, "of-pair") for i in dict.fromkeys(state.pair or ())]
    head = [h.tr(h.th(words, colspan=4)) for words in ("of the pair", "all")] if pair else [None, None]
    every = (_row(state, i, "object") for i in range(count))
    table = h.table(h.tbody(head[0], pair, id="of-pair"), h.tbody(head[1], every), cls="objects")
    return panel(heading(f"Objects{' of A' if state.beside else ''} ({count})"), table)


def _row(state: State, i: int, kind: str) -> Element:
    assert state.loaded is not None
    in_pair = kind == "object" and i in (state.pair or ())
    marks = chosen(i == state.selected, "r")
    # The page scrolls to the first of two rows of the same object.
    marks |= {"data_shown": None} if in_pair else {}
    entry, color = state.shown.objects[i], palette(state.dark)[state.roles.get(i, "other")]
    box, quality = entry.lifted.box, entry.lifted.quality
    size = "no depth" if box is None else " × ".join(f"{s * 100:.0f}" for s in box.size) + " cm"
    doubts = "; ".join(quality.concerns)
    return h.tr(
        h.td(thumb(state, i)),
        h.td(named(color, state.shown.names[i]), h.div(size, cls="dim"), cls="w"),
        h.td("" if box is None else f"{quality.distance:.1f} m", cls="n dim"),
        h.td(score(entry.score), h.span("!", cls="low", title=doubts, aria_label=doubts) if doubts else "", cls="n"),
        id=f"{kind}-{i}",
        do=f"object:{i}",
        hover=f"hover:{i}",
        **marks,
    )


def thumb(state: State, i: int) -> Element:
    """The small picture of an object; an empty place where it has none."""
    url = "" if state.loaded is None else state.loaded.thumb(state.shown.objects[i].bbox)
    return h.img(src=url, alt="", cls="thumb", loading="lazy") if url else h.span(cls="thumb")


def score(value: float) -> str:
    """A detector's score; nothing where the objects are the dataset's own."""
    return "" if value >= 0.9995 else f"{value:.2f}"
