"""The right dock's lower part: the image with its overlay, the frames to browse, the log."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from pipeline.answering.objects import SceneObject
from pipeline.geometry.palette import hex_color, palette
from spatialviz.app.beside_html import name_tag, second_overlay
from spatialviz.app.frames import FrameStore, jpeg_url
from spatialviz.app.paint import frame_colors
from spatialviz.app.pixels_html import pixel_row_html
from spatialviz.app.state import State
from spatialviz.app.text import note, panel, safe
from spatialviz.report.picture import box_edges_2d, tinted

IMAGE_WIDTH = 720
SHOWN_FRAMES = 24
CLICK = (
    "if(event.shiftKey)return;const b=this.getBoundingClientRect();"
    "sv('image:'+((event.clientX-b.left)/b.width).toFixed(5)+','+((event.clientY-b.top)/b.height).toFixed(5))"
)
"""Sends where a picture was clicked, as fractions of its width and height."""


def image_html(state: State) -> str:
    """The frame's picture with masks, boxes and names; a click selects the object under it."""
    if state.loaded is None:
        return panel(note(state.problem or "no frame"))
    frame = state.loaded.context.frame
    if state.colors == "rgb":
        picture = tinted(frame.rgb, state.shown.objects, state.roles if state.own_layer else {})
    else:
        picture = frame_colors(state.colors, state.loaded, state.roles, state.dark)
    step = max(1, round(frame.width / IMAGE_WIDTH))
    url = jpeg_url(picture[::step, ::step])
    band = "edit:mask:rectangle:" if state.labels is None else "px-new:"
    return panel(
        pixel_row_html(state),
        f'<div class="pic" style="--wh:{frame.width / frame.height:.3f}" onclick="{safe(CLICK)}" '
        f"onmousedown=\"svPaint(this,event,'{band}')\">"
        f'<img src="{url}"><svg viewBox="0 0 {frame.width} {frame.height}" preserveAspectRatio="none">'
        f"{overlay_marks(state)}</svg></div>",
        style="padding-top:.6em",
    )


def overlay_marks(state: State) -> str:
    """What is drawn over the picture: boxes and names, as elements of SVG in pixels of the frame."""
    if state.loaded is None:
        return ""
    frame, colors, roles = state.loaded.context.frame, palette(True), state.roles
    unit = frame.width / 360
    parts = []
    own = range(len(state.shown.objects)) if state.own_layer else range(0)
    order = sorted(own, key=lambda i: (i in roles, i == state.selected))
    for i in order:
        entry = state.shown.objects[i]
        role = roles.get(i, "other")
        strong = role != "other" or i == state.selected
        if not strong and not state.flags.boxes:
            continue
        color = "#ffffff" if i == state.selected and role == "other" else hex_color(colors[role])
        x0, y0, x1, y1 = (float(v) for v in entry.bbox)
        if strong and entry.lifted.box is not None:
            for (ax, ay), (bx, by) in box_edges_2d(entry.lifted.box, frame.camera):
                parts.append(
                    f'<line x1="{ax:.1f}" y1="{ay:.1f}" x2="{bx:.1f}" y2="{by:.1f}" '
                    f'stroke="{color}" stroke-width="{1.3 * unit:.2f}"/>'
                )
        else:
            parts.append(
                f'<rect x="{x0:.1f}" y="{y0:.1f}" width="{x1 - x0:.1f}" height="{y1 - y0:.1f}" fill="none" '
                f'stroke="{color}" stroke-width="{0.7 * unit:.2f}" opacity=".75"/>'
            )
    for ghost in state.ghosts if state.flags.ghosts else ():
        color = hex_color(colors[ghost.role])
        parts += [
            f'<line x1="{ax:.1f}" y1="{ay:.1f}" x2="{bx:.1f}" y2="{by:.1f}" stroke="{color}" '
            f'stroke-width="{1.1 * unit:.2f}" stroke-dasharray="{3 * unit:.1f} {2 * unit:.1f}"/>'
            for (ax, ay), (bx, by) in box_edges_2d(ghost.box, frame.camera)
        ]
    parts += second_overlay(state, unit)
    for i in order:
        if i not in roles and i != state.selected:
            continue
        color = hex_color(colors[roles.get(i, "other")])
        text = state.shown.names[i]
        x0, y0 = _name_place(state, i)
        parts.append(name_tag(text, x0, y0 - 14 * unit, (frame.height, frame.width), unit, color))
    return "".join(parts)


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


def window(ids: Sequence[str], current: int) -> range:
    """The places of the frames that are shown around the current one."""
    start = max(0, min(current - SHOWN_FRAMES // 2, len(ids) - SHOWN_FRAMES))
    return range(start, min(start + SHOWN_FRAMES, len(ids)))


def frames_html(state: State, ids: Sequence[str], store: FrameStore, ready: int | None = None) -> str:
    """Small pictures of the frames around the current one; those beyond `ready` are still to come."""
    current = ids.index(state.frame_id)
    cells = []
    places = window(ids, current)
    for number, i in enumerate(places):
        url, reason = store.thumb(state.source, ids[i]) if ready is None or number < ready else ("", "…")
        body = f'<img src="{url}">' if url else f'<span class="none">{safe(reason[:120])}</span>'
        cells.append(
            f'<div class="cell{" sel" if i == current else ""}" onclick="sv(\'frame:{i}\')" title="{safe(ids[i])}">'
            f"{body}<div>{safe(ids[i])}</div></div>"
        )
    more = f"frames {places.start + 1}–{places.stop} of {len(ids)}" if len(ids) > len(places) else f"{len(ids)} frames"
    return panel(f'<div class="dim" style="padding:.4em 0">{more}</div><div class="grid">{"".join(cells)}</div>')


def log_html(entries: Sequence[tuple[str, str]]) -> str:
    """What happened, latest first."""
    rows = "".join(f'<div><span class="dim">{safe(t)}</span> {safe(text)}</div>' for t, text in reversed(entries))
    return panel(f'<div class="log">{rows or "nothing yet"}</div>', style="padding-top:.5em")
