"""Picture with overlays and drawing tools; objects with thumbnails, the log."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from pipeline.answering.frame_store import LoadedFrame, frame_colors
from pipeline.answering.objects import SceneObject
from pipeline.corrections.draft import Draft
from pipeline.geometry.frame import Frame
from pipeline.geometry.lifting import LiftedObject
from pipeline.geometry.masks import decode_crop, outlines
from pipeline.geometry.palette import DROPPED, ON_DARK, RGB, depth_colors, depth_ends, hex_color, ink, instance_colors
from pipeline.pictures.marks import TINT, edges_path, outline_path
from pipeline.system.encoded_pictures import jpeg
from spatialviz.app.frames import png_url, thumb_url
from spatialviz.app.kept_pictures import IMAGES
from spatialviz.app.markup import Child, Element, dot, h, heading, named, note, panel, score_text, term, words
from spatialviz.app.state import State

IMAGE_WIDTH = 720


def image_html(state: State) -> Element:
    """Frame's picture with masks, boxes and names; a click selects an object."""
    if state.loaded is None:
        return panel(note(state.problem or "no frame"), cls="picture")
    frame = state.loaded.context.frame
    unit = frame.width / 360
    quiet = "".join(_rectangle(entry.bbox) for entry in state.shown.objects) if state.boxes_shown else ""
    dashes = f"{3 * unit:.1f} {2 * unit:.1f}"
    ghosts = (
        _path(edges_path(ghost.box, frame.camera), ON_DARK[ghost.role], 1.1 * unit, stroke_dasharray=dashes)
        for ghost in (state.ghosts if state.flags.ghosts else ())
    )
    alt = (f"frame {frame.id}", *(f"{role} {state.shown.names[i]}" for i, role in state.roles.items()))
    return panel(
        h.div(
            h.img(src=_photo_url(state, state.loaded), alt=", ".join(alt), draggable="false", id="photo"),
            _svg(frame, _path(quiet, ON_DARK["other"], 0.7 * unit, opacity=".75") if quiet else None, "boxes"),
            _svg(frame, ghosts, "ghosts"),
            _svg(frame, overlay_marks(state), "overlay"),
            _svg(frame, None, "marked"),
            cls="pic",
            css={"--wh": f"{frame.width / frame.height:.3f}"},
            point="image:",
            band="edit:mask:rectangle:" if state.labels is None else "px-new:",
        ),
        cls="picture",
    )


def _photo_url(state: State, loaded: LoadedFrame) -> str:
    """Address of the frame's picture in the chosen colours; the last few are not made again."""
    frame, plain = loaded.context.frame, state.colors == "rgb"
    key = (state.colors, *(() if plain else (state.dark, *state.roles.items())))

    def make() -> bytes:
        colors = frame_colors(state.colors, frame, loaded.objects, state.roles, state.dark)
        step = max(1, round(frame.width / IMAGE_WIDTH))
        return jpeg(colors[::step, ::step])

    return IMAGES.url(loaded.photos.get(key, make), "jpg")


def _svg(frame: Frame, marks: Child, name: str) -> Element:
    size = f"0 0 {frame.width} {frame.height}"
    return h.svg(marks, viewBox=size, preserveAspectRatio="none", aria_hidden="true", id=name)


def _path(drawn: str, color: RGB | str, width: float, **look: str) -> Element:
    color = color if isinstance(color, str) else hex_color(color)
    return h.path(d=drawn, fill="none", stroke=color, stroke_width=f"{width:.2f}", **look)


def overlay_marks(state: State) -> list[Element]:
    """SVG boxes and names of the chosen objects over the picture, in pixels of the frame."""
    if state.loaded is None:
        return []
    frame, roles = state.loaded.context.frame, state.roles
    unit, shape = frame.width / 360, (frame.height, frame.width)
    marks: list[Element] = []
    places = (i for i in range(len(state.shown.objects)) if i in roles or i == state.selected)
    order = sorted(places, key=lambda i: i == state.selected)
    for i in [i for i in order if i in roles] if state.colors == "rgb" else ():
        drawn, color = outline_path(state.shown.objects[i].mask), hex_color(ON_DARK[roles[i]])
        marks.append(h.path(d=drawn, fill=color, fill_opacity=TINT, stroke=color, stroke_width=0.5 * unit))
    for i in order:
        entry = state.shown.objects[i]
        box, sides = entry.lifted.box, entry.lifted.open_sides
        drawn = _rectangle(entry.bbox) if box is None else edges_path(box, frame.camera, sides)
        marks.append(_path(drawn, ON_DARK[roles[i]] if i in roles else "#ffffff", 1.3 * unit))
    placed: list[tuple[float, float]] = []
    for i in order:
        name, color = state.shown.names[i].replace("·", " "), hex_color(ON_DARK[roles.get(i, "other")])
        x0, y0 = state.shown.objects[i].bbox[:2].tolist()
        # A name under another is moved below it.
        while near := [y for x, y in placed if abs(y - y0) < 14 * unit and abs(x - x0) < 60 * unit]:
            y0 = max(near) + 14.5 * unit
        placed.append((x0, y0))
        marks.append(name_tag(name, x0, y0 - 14 * unit, shape, unit, color))
    ends = [(u + 0.5, v + 0.5) for u, v in state.marks]
    marks += [h.circle(cx=u, cy=v, r=2.2 * unit, cls="measured", stroke_width=0.8 * unit) for u, v in ends]
    if state.measured is not None:
        (x0, y0), (x1, y1) = ends
        marks.append(h.path(d=f"M{x0:.1f} {y0:.1f}L{x1:.1f} {y1:.1f}", cls="measured", stroke_width=1.2 * unit))
        text = f"{state.measured.distance:.3f} m"
        marks.append(name_tag(text, (x0 + x1) / 2, (y0 + y1) / 2 + 3 * unit, shape, unit, "#f5f7fa"))
    return marks


def name_tag(text: str, x: float, y: float, shape: tuple[int, ...], unit: float, color: str) -> Element:
    """Name tag in the picture with the upper left corner at (x, y), or at the nearest place within `shape`."""
    width = len(text) * 6.2 + 8
    x, y = max(min(x, shape[1] - width * unit), 0), min(max(y, 0), shape[0] - 14 * unit)
    look = {"font_size": 10.5, "font_weight": 600, "fill": ink(color), "font_family": "system-ui,sans-serif"}
    tag = h.rect(width=f"{width:.1f}", height=14, rx=2, fill=color), h.text(text, x=4, y=10.4, **look)
    return h.g(h.g(*tag, transform=f"translate({x:.1f} {y:.1f}) scale({unit:.3f})"), cls="name-tag")


def _rectangle(bbox: np.ndarray) -> str:
    x0, y0, x1, y1 = bbox.tolist()
    return f"M{x0:.1f} {y0:.1f}H{x1:.1f}V{y1:.1f}H{x0:.1f}Z"


def smallest_at(objects: Sequence[SceneObject], pixel: tuple[int, int] | None) -> int | None:
    """Smallest object with a mask at a pixel (u, v)."""
    hits = [] if pixel is None else [i for i, o in enumerate(objects) if o.mask[pixel[::-1]]]
    return min(hits, key=lambda i: objects[i].lifted.quality.mask_pixels, default=None)


def log_html(entries: Sequence[tuple[str, str]]) -> Element:
    """Log, latest first."""
    rows = [h.li(h.span(time, cls="dim"), " ", text) for time, text in reversed(entries)]
    return h.ol(rows or h.li("nothing yet", cls="dim"), cls="log")


STEPS = 128
"""Colours of the depth bar."""


def depth_bar(state: State) -> Element | None:
    """Colour bar of depths, with its ends in metres, in the depth view."""
    if state.loaded is None or state.colors != "depth":
        return None
    depth = state.loaded.context.frame.depth
    low, high = depth_ends(depth)
    measured = depth[depth > 0]
    colors = depth_colors(np.linspace(low, high, STEPS, dtype=np.float32)[None], (low, high))
    bar = np.concatenate([colors[..., ::-1], np.full((1, STEPS, 1), 255, np.uint8)], axis=2)
    return h.figure(
        h.span(f"{low:.2f} m"),
        h.img(src=png_url(bar), alt=f"colours from {low:.2f} m, light, to {high:.2f} m, dark", draggable="false"),
        h.span(f"{high:.2f} m"),
        cls="depthbar",
        title="Nearer and farther ones have the colours of the ends: "
        f"{measured.min():.2f} to {measured.max():.2f} m were measured.",
    )


def legend_html(state: State) -> list[Child]:
    """Legend of the scene: roles that are drawn, and the paint."""
    drawn = {ghost.role for ghost in state.ghosts} if state.flags.ghosts else set()
    other = "" if state.other is None else state.other.name
    solid = {"target": "target", "reference": "reference", "truth": "asked about"}
    labelled = "by the label" if state.label_blamed else "correct by the labels"
    dashed = {"truth": labelled, "edited": other, "other": "as found"}
    return [
        *(_line(c, solid[role]) for role, c in ON_DARK.items() if role in solid and role in state.roles.values()),
        *(_line(c, dashed[role], " dashed") for role, c in ON_DARK.items() if role in dashed and role in drawn),
        h.span("✓ correct by the labels") if state.right_roles and "truth" not in drawn else None,
        *(h.span(dot(color), term(words(reason))) for reason, color in DROPPED.items() if state.colors == "evidence"),
        depth_bar(state),
    ]


def _line(color: RGB, text: str, look: str = "") -> Element:
    return h.span(h.i(cls=f"line{look}", color=color), text)


def index_map(objects: Sequence[SceneObject], step: int = 4) -> str:
    """Address of a picture, a `step`-th as large as the frame: in each pixel 1 + the smallest object there.

    The low byte is red, the high byte green.
    """
    places = np.zeros_like(objects[0].mask[::step, ::step], np.uint16)
    for i in sorted(range(len(objects)), key=lambda i: -objects[i].lifted.quality.mask_pixels):
        places[objects[i].mask[::step, ::step]] = i + 1
    channels = np.zeros_like(places), places >> 8, places & 255, np.full_like(places, 255)
    return png_url(np.stack(channels, 2).astype(np.uint8))


def objects_html(state: State, loaded: LoadedFrame) -> Element:
    """Objects by number; a click selects."""
    if not state.shown.objects:
        reason = loaded.problem or "Nothing is annotated or detected in this frame."
        return panel(heading("Objects"), note(reason), cls="objects")
    rows = (_row(state, i) for i in range(len(state.shown.objects)))
    return panel(heading(f"Objects ({len(state.shown.objects)})"), h.table(h.tbody(rows), cls="objects"))


def _row(state: State, i: int) -> Element:
    entry = state.shown.objects[i]
    box, quality = entry.lifted.box, entry.lifted.quality
    size = "no depth" if box is None else " × ".join(f"{s * 100:.0f}" for s in box.size) + " cm"
    doubts = "; ".join(quality.concerns)
    doubt = h.span("!", cls="low", title=doubts, aria_label=doubts) if doubts else ""
    return h.tr(
        h.td(thumb(state.loaded, entry.bbox, loading="lazy")),
        h.td(named(state.color(i), state.shown.names[i]), h.div(size, cls="dim"), cls="w"),
        h.td("" if box is None else f"{quality.distance:.1f} m", cls="n dim"),
        h.td(score_text(entry.score), doubt, cls="n"),
        id=f"object-{i}",
        do=f"object:{i}",
        hover=f"hover:{i}",
        cls="r",
    )


def thumb(loaded: LoadedFrame | None, bbox: np.ndarray, **look: str) -> Element:
    """Object's thumbnail, or an empty placeholder."""
    url = "" if loaded is None else thumb_url(loaded, bbox)
    return h.img(src=url, alt="", cls="thumb", **look) if url else h.span(cls="thumb")


PART_COLORS: tuple[RGB, ...] = (ON_DARK["edited"], ON_DARK["reference"], ON_DARK["target"], ON_DARK["truth"])
"""Colours of a draft's parts; a whole object has the first, the colour of edits."""


def mask_url(parts: Sequence[np.ndarray]) -> str:
    """Address of masks ((H, W) bool each) as a transparent picture, each part in its colour."""
    image = np.zeros((*parts[0].shape, 4), np.uint8)
    colors = [*PART_COLORS, *instance_colors(max(len(parts) - len(PART_COLORS), 0) or 1)]
    for part, (r, g, b) in zip(parts, colors, strict=False):
        image[part] = b, g, r, 255
    return png_url(image)


def outlined(objects: Sequence[SceneObject], names: Sequence[str], without: int | None) -> Iterator[dict[str, Any]]:
    """Outlines of objects for the editor: lines as x0, y0, x1, y1, ... in pixels."""
    for entry, name in zip(objects, names, strict=True):
        if entry.id != without:
            lines = [line.ravel().tolist() for line in outlines(entry.mask)]
            yield {"name": name, "size": entry.lifted.quality.mask_pixels, "lines": lines}


def around(draft: Draft) -> list[int] | None:
    """x0, y0, x1, y1 of the picture around the object before the edit; None for the whole picture."""
    (first, *_) = draft.steps[0]
    x0, y0, x1, y1 = decode_crop((draft.height, draft.width), first).box
    side = max(x1 - x0, y1 - y0)
    if side == 0:
        return None
    margin = max(side // 2, 24)
    box = [max(x0 - margin, 0), max(y0 - margin, 0), min(x1 + margin, draft.width), min(y1 + margin, draft.height)]
    return box if box[2] - box[0] < 0.7 * draft.width and box[3] - box[1] < 0.7 * draft.height else None


def told_of(draft: Draft, lifted: LiftedObject | None, parts: Sequence[np.ndarray]) -> str:
    """Size of the drawn mask and of the resulting box."""
    if len(parts) > 1:
        return f"{len(parts)} parts: " + " + ".join(f"{int(p.sum()):,}" for p in parts) + " pixels"
    pixels = f"{int(parts[0].sum()):,} pixels"
    if lifted is None:
        return pixels if draft.number is not None else "nothing is drawn yet"
    if lifted.box is None:
        return f"{pixels} · no 3D box: too little depth"
    width, height, depth = lifted.box.size
    return f"{pixels} · {lifted.quality.points:,} points · box {width:.2f} × {height:.2f} × {depth:.2f} m"
