"""What is shown of drawing pixels: the row of tools, the draft for the large editor, and the draft in the scene."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import cv2
import numpy as np

from pipeline.answering.objects import SceneObject
from pipeline.corrections.draft import Draft
from pipeline.geometry.boxes import EDGES, Box3D
from pipeline.geometry.camera import lift_pixels
from pipeline.geometry.frame import Frame
from pipeline.geometry.lifting import LiftedObject
from pipeline.geometry.masks import decode_crop
from pipeline.geometry.palette import ON_DARK, RGB, instance_colors, palette
from spatialviz.app.context import Context
from spatialviz.app.frames import png_url
from spatialviz.app.label_view import LabelView
from spatialviz.app.markup import Element, h
from spatialviz.app.state import State

TOOLS = {
    "brush": "paint pixels (Shift+I)",
    "erase": "take pixels away",
    "polygon": "corner by corner",
    "rectangle": "between two corners",
    "depth": "the surface around a click",
    "cut": "split it in parts (Shift+X)",
}
PART_COLORS: tuple[RGB, ...] = (ON_DARK["edited"], ON_DARK["reference"], ON_DARK["target"], ON_DARK["truth"])
"""Of the parts of a draft; a whole object has the first, that of edits."""


def pixel_row_html(state: State, view: LabelView) -> Element:
    """The tools above the picture, while labels are shown; each opens the large editor."""
    hint = "select two objects, one after the other"
    if state.pair is not None and state.pair[0] != state.pair[1]:
        one, other = (state.shown.names[i] for i in state.pair[:2])
        hint = f"{one} becomes a part of {other} (Shift+M)"
    return h.div(
        h.div(
            (
                _tool(name, f"px-tool:{name}", does, state.selected is not None or name != "cut")
                for name, does in TOOLS.items()
            ),
            _tool("new object", "px-new", "drawn on the picture (Shift+N; Shift-drag on the picture)", cls="w2"),
            _tool("new from 3D", "px-new:scene", "by clicks in the scene (Shift+T)", cls="w2"),
            _tool("merge", "px-merge", hint, state.pair is not None, cls="w2"),
            cls="pxrow",
        ),
    )


def _tool(name: str, do: str, hint: str, on: bool = True, cls: str = "") -> Element:
    return h.button(name, cls=cls, do=do, title=hint, disabled=not on)


def mask_url(parts: Sequence[np.ndarray]) -> str:
    """Masks ((H, W) bool each) as one transparent picture, each part in its colour: where the page finds it."""
    height, width = parts[0].shape
    image = np.zeros((height, width, 4), np.uint8)
    colors = [*PART_COLORS, *instance_colors(max(len(parts) - len(PART_COLORS), 0) or 1)]
    for part, (r, g, b) in zip(parts, colors, strict=False):
        image[part] = b, g, r, 255
    return png_url(image)


def outlines(objects: Sequence[SceneObject], names: Sequence[str], without: int | None) -> Iterator[dict[str, Any]]:
    """The outlines of objects for the editor: lines as x0, y0, x1, y1, ... in pixels."""
    for entry, name in zip(objects, names, strict=True):
        if entry.id != without:
            lines, _ = cv2.findContours(entry.mask.view(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_TC89_L1)
            kept = [(line.reshape(-1) + 0.5).tolist() for line in lines if len(line) > 2]
            yield {"name": name, "size": entry.lifted.quality.mask_pixels, "lines": kept}


def around(draft: Draft) -> list[int] | None:
    """x0, y0, x1, y1 of the picture around the object as it was; None where the whole picture is no larger."""
    (first, *_) = draft.steps[0]
    x0, y0, x1, y1 = decode_crop((draft.height, draft.width), first).box
    side = max(x1 - x0, y1 - y0)
    if side == 0:
        return None
    margin = max(side // 2, 24)
    box = [max(x0 - margin, 0), max(y0 - margin, 0), min(x1 + margin, draft.width), min(y1 + margin, draft.height)]
    return box if box[2] - box[0] < 0.7 * draft.width and box[3] - box[1] < 0.7 * draft.height else None


def told_of(draft: Draft, lifted: LiftedObject | None, parts: Sequence[np.ndarray]) -> str:
    """The size of what is drawn, and of the box that it would get."""
    if len(parts) > 1:
        return f"{len(parts)} parts: " + " + ".join(f"{int(p.sum()):,}" for p in parts) + " pixels"
    pixels = f"{int(parts[0].sum()):,} pixels"
    if lifted is None:
        return pixels if draft.number is not None else "nothing is drawn yet"
    if lifted.box is None:
        return f"{pixels} · no 3D box: too little depth"
    width, height, depth = lifted.box.size
    return f"{pixels} · {lifted.quality.points:,} points · box {width:.2f} × {height:.2f} × {depth:.2f} m"


POINT = 0.004
MOST_POINTS = 60_000
DRAFT = "/draft/"
"""Where it stands in the scene."""


def draw_draft(ctx: Context, frame: Frame, mask: np.ndarray, box: Box3D | None) -> None:
    """Show a mask's points in the scene, towards the viewer of the cloud they lie in, and a box (camera frame)."""
    with ctx.client.atomic():
        ctx.client.clear(DRAFT)
        color = palette(ctx.state.dark)["edited"]
        v, u = np.nonzero(mask & (frame.depth > 0))
        step = max(1, -(-len(v) // MOST_POINTS))
        v, u = v[::step], u[::step]
        if len(v):
            points = lift_pixels(frame.depth[v, u] * np.float32(0.995), frame.camera, v, u)
            shown = (points @ ctx.scene.to_show.T.astype(np.float32)).astype(np.float32)
            ctx.client.put(
                "point_cloud", f"{DRAFT}points", points=shown, colors=np.array(color, np.uint8), point_size=POINT,
                precision="float32", point_shading="flat", point_shape="square",
            )  # fmt: skip
        if box is not None:
            lines = ctx.scene.shown_box(box).corners[EDGES].astype(np.float32)
            ctx.client.lines(f"{DRAFT}box", lines, color, 2.6)
