"""The picture with what is drawn over it, the objects with their pictures, the log."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from pipeline.answering.objects import SceneObject
from pipeline.geometry.frame import Frame
from pipeline.geometry.palette import depth_colors, depth_ends, hex_color, palette
from spatialviz.app.beside import name_tag, second_overlay
from spatialviz.app.frame_cloud import frame_colors
from spatialviz.app.frames import LoadedFrame, jpeg_url, png_url
from spatialviz.app.markup import Child, Element, chosen, detector_score, h, heading, named, note, panel
from spatialviz.app.pixels_html import pixel_row_html
from spatialviz.app.state import State
from spatialviz.report.picture import box_edges_2d, edges_path, tinted

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
    alt = (f"frame {frame.id}", *(f"{role} {state.shown.names[i]}" for i, role in state.roles.items()))
    return panel(
        None if state.labels is None else pixel_row_html(state, state.labels),
        h.div(
            h.img(src=jpeg_url(picture[::step, ::step]), alt=", ".join(alt), draggable="false", id="photo"),
            _svg(frame, _quiet_boxes(state, frame.width / 360), "boxes"),
            _svg(frame, _ghost_marks(state, frame), "ghosts"),
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
    size = f"0 0 {frame.width} {frame.height}"
    return h.svg(marks, viewBox=size, preserveAspectRatio="none", aria_hidden="true", id=name)


def _quiet_boxes(state: State, unit: float) -> Element | None:
    """The 2D boxes of all objects, the same whatever is chosen."""
    if not state.boxes_shown or not state.own_layer:
        return None
    drawn = "".join(_rectangle(entry.bbox) for entry in state.shown.objects)
    return _path(drawn, hex_color(palette(True)["other"]), 0.7 * unit, opacity=".75")


def _path(drawn: str, color: str, width: float, **look: str) -> Element:
    return h.path(d=drawn, fill="none", stroke=color, stroke_width=f"{width:.2f}", **look)


def overlay_marks(state: State) -> list[Element]:
    """What is drawn over the picture of what is chosen: boxes and names, as elements of SVG in pixels of the frame."""
    if state.loaded is None:
        return []
    frame, colors, roles = state.loaded.context.frame, palette(True), state.roles
    unit, shape = frame.width / 360, (frame.height, frame.width)
    own = range(len(state.shown.objects)) if state.own_layer else range(0)
    marks: list[Element] = []
    order = sorted((i for i in own if i in roles or i == state.selected), key=lambda i: i == state.selected)
    for i in order:
        entry = state.shown.objects[i]
        drawn = _rectangle(entry.bbox) if entry.lifted.box is None else edges_path(entry.lifted.box, frame.camera)
        marks.append(_path(drawn, hex_color(colors[roles[i]]) if i in roles else "#ffffff", 1.3 * unit))
    marks += () if state.beside is None else second_overlay(state, state.beside, unit)
    for i in order:
        x0, y0 = _name_place(state, i)
        color = hex_color(colors[roles.get(i, "other")])
        marks += name_tag(state.shown.names[i], x0, y0 - 14 * unit, shape, unit, color)
    ends = [(u + 0.5, v + 0.5) for u, v in state.marks]
    marks += [h.circle(cx=u, cy=v, r=2.2 * unit, cls="measured", stroke_width=0.8 * unit) for u, v in ends]
    if state.measured is not None:
        (x0, y0), (x1, y1) = ends
        marks.append(h.path(d=f"M{x0:.1f} {y0:.1f}L{x1:.1f} {y1:.1f}", cls="measured", stroke_width=1.2 * unit))
        text = f"{state.measured.distance:.3f} m"
        marks += name_tag(text, (x0 + x1) / 2, (y0 + y1) / 2 + 3 * unit, shape, unit, "#f5f7fa")
    return marks


def _ghost_marks(state: State, frame: Frame) -> Iterator[Element]:
    """Boxes beside the answer's, which stay while other objects are chosen."""
    unit, colors = frame.width / 360, palette(True)
    for ghost in state.ghosts if state.flags.ghosts else ():
        drawn, dashes = edges_path(ghost.box, frame.camera), f"{3 * unit:.1f} {2 * unit:.1f}"
        yield _path(drawn, hex_color(colors[ghost.role]), 1.1 * unit, stroke_dasharray=dashes)


def _rectangle(bbox: np.ndarray) -> str:
    x0, y0, x1, y1 = (float(v) for v in bbox)
    return f"M{x0:.1f} {y0:.1f}H{x1:.1f}V{y1:.1f}H{x0:.1f}Z"


def _name_place(state: State, i: int) -> tuple[float, float]:
    """Where the name of an object stands: at its 2D box; where its 3D box is being dragged, at that."""
    entry, moved = state.shown.objects[i], None if state.labels is None else state.labels.moved
    if state.loaded is not None and moved is not None and moved.number == entry.id:
        edges = box_edges_2d(moved.box, state.loaded.context.frame.camera)
        if len(edges):
            return float(edges[..., 0].min()), float(edges[..., 1].min())
    return float(entry.bbox[0]), float(entry.bbox[1])


def smallest_at(objects: Sequence[SceneObject], pixel: tuple[int, int] | None) -> int | None:
    """The smallest object whose mask holds a pixel (u, v)."""
    hits = [] if pixel is None else [i for i, o in enumerate(objects) if o.mask[pixel[::-1]]]
    return min(hits, key=lambda i: objects[i].lifted.quality.mask_pixels, default=None)


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
    return h.figure(
        h.figcaption("Depth"),
        h.img(src=png_url(bar), alt=f"colours from {low:.2f} m, red, to {high:.2f} m, blue", draggable="false"),
        h.div((h.span(f"{at:.2f} m") for at in (low, (low + high) / 2, high)), cls="ticks"),
        cls="depthbar",
        title="Nearer and farther ones have the colours of the ends: "
        f"{measured.min():.2f} to {measured.max():.2f} m were measured.",
    )


def objects_html(state: State, loaded: LoadedFrame) -> Element:
    """The objects as they are numbered, and above them those of the chosen pair once more; a click selects one."""
    if not state.shown.objects:
        reason = loaded.problem or "Nothing is annotated or detected in this frame."
        return panel(heading("Objects"), note(reason), cls="objects")
    count = len(state.shown.objects)
    # Rows that change places would be sent again, all of them.
    pair = [_row(state, i, "of-pair") for i in dict.fromkeys(state.pair or ())]
    head = [h.tr(h.th(words, colspan=4)) for words in ("of the pair", "all")] if pair else [None, None]
    every = (_row(state, i, "object") for i in range(count))
    table = h.table(h.tbody(head[0], pair, id="of-pair"), h.tbody(head[1], every), cls="objects")
    return panel(heading(f"Objects{' of A' if state.beside else ''} ({count})"), table)


def _row(state: State, i: int, kind: str) -> Element:
    marks = chosen(i == state.selected, "r")
    # The page scrolls to the first of two rows of the same object.
    marks |= {"data_shown": None} if kind == "object" and i in (state.pair or ()) else {}
    entry, color = state.shown.objects[i], palette(state.dark)[state.roles.get(i, "other")]
    box, quality = entry.lifted.box, entry.lifted.quality
    size = "no depth" if box is None else " × ".join(f"{s * 100:.0f}" for s in box.size) + " cm"
    doubts = "; ".join(quality.concerns)
    return h.tr(
        h.td(thumb(state, i)),
        h.td(named(color, state.shown.names[i]), h.div(size, cls="dim"), cls="w"),
        h.td("" if box is None else f"{quality.distance:.1f} m", cls="n dim"),
        h.td(
            detector_score(entry.score),
            h.span("!", cls="low", title=doubts, aria_label=doubts) if doubts else "",
            cls="n",
        ),
        id=f"{kind}-{i}",
        do=f"object:{i}",
        hover=f"hover:{i}",
        **marks,
    )


def thumb(state: State, i: int) -> Element:
    """The small picture of an object; an empty place where it has none."""
    url = "" if state.loaded is None else state.loaded.thumb(state.shown.objects[i].bbox)
    return h.img(src=url, alt="", cls="thumb", loading="lazy") if url else h.span(cls="thumb")
