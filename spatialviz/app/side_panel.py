"""The selected labelled object from three sides, and large in the picture: its points, its box, and hands on it."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence

import cv2
import numpy as np
import xxhash

from pipeline.answering.objects import SceneObject
from pipeline.corrections.journal.edits import Edits, set_box
from pipeline.corrections.journal.effective_frame import EffectiveFrame, Row
from pipeline.corrections.scene import labelled_box
from pipeline.corrections.side_views import SideViews, drag_box, dragged, face_to_points, side_views
from pipeline.geometry.boxes import Box3D
from pipeline.geometry.frame import Frame
from pipeline.geometry.masks import decode_run_length
from pipeline.geometry.palette import RGB, hex_color, palette
from pipeline.geometry.viewer import viewer_axes
from pipeline.proposals.annotations import box_mask
from pipeline.system.errors import InputError
from spatialviz.app.context import Context, command
from spatialviz.app.frames import jpeg_url
from spatialviz.app.label_part import LabelPart
from spatialviz.app.label_view import LabelView
from spatialviz.app.markup import Element, h
from spatialviz.report.picture import edges_path

LONGEST = 4000
"""Characters of a message."""
FACES = {(axis, side) for axis in "012" for side in ("1", "-1")}
CROP_MARGIN, CROP_LEAST = 0.35, 96
"""Around what is shown large: share of its longer side; pixels at least."""


class SidePanel(LabelPart):
    """The views of one client."""

    def __init__(self, ctx: Context) -> None:
        super().__init__(ctx)
        self._key = ""
        self._views: SideViews | None = None

    @property
    def _chosen(self) -> tuple[LabelView, int, SceneObject] | None:
        """The labels, the number of the selected object, and the object."""
        state = self.state
        view = state.labels
        if view is None or state.loaded is None or state.selected is None or state.selected >= len(view.numbers):
            return None
        return view, view.numbers[state.selected], state.shown.objects[state.selected]

    @command("next-object")
    def step(self, step: int) -> None:
        """Select the next object of the frame, by their numbers."""
        state = self.state
        if state.labels is not None and (count := len(state.labels.numbers)):
            at = -1 if state.selected is None and step > 0 else state.selected or 0
            item = state.labels.item
            # Who walks along looks at one after the other, and means no pair; that of an open item stays.
            self.ctx.show(selected=(at + step) % count, pair=None if item is None else state.pair)

    @command("side-drag")
    def drag(self, said: str) -> None:
        """Save what a hand did to the box: {"key", "moves"}; the key says which box it was."""
        chosen = self._chosen
        try:
            message = json.loads(said) if len(said) <= LONGEST else {}
            key, moves = str(message["key"]), list(message["moves"])
        except (ValueError, TypeError, KeyError, RecursionError):
            return
        if chosen is None or key != self._key:
            self.ctx.page.call("sidesBack")
            return
        self._dragged(lambda frame: drag_box(frame, chosen[1], moves))

    @command("side-fit")
    def fit(self, said: str) -> None:
        """Bring a face to the object's points: "key:axis:side"."""
        chosen, views = self._chosen, self._views
        key, axis, side = [*said.split(":"), "", ""][:3]
        if chosen is None or views is None or key != self._key or (axis, side) not in FACES:
            return

        def made(frame: EffectiveFrame) -> Edits:
            box = dragged(views.box, views.axes, [face_to_points(views, int(axis), int(side))])
            return set_box(frame, chosen[1], box, "a face fitted to the points")

        self._dragged(made)

    def _dragged(self, made: Callable[[EffectiveFrame], Edits]) -> None:
        """Save it; the box in the browser goes back where it cannot be."""
        try:
            self.save(made)
        except InputError:
            self.ctx.page.call("sidesBack")
            raise

    def follow(self) -> None:
        """Bring the views up to the state; points travel only where they, or the box, are others."""
        chosen = self._chosen
        self.ctx.page.show("crop", None if chosen is None else crops(self.ctx, chosen[0]))
        box = None if chosen is None else chosen[2].lifted.box
        if chosen is None or box is None or chosen[0].frame.row["up"] is None:
            self._told("", None)
            return
        view, number, entry = chosen
        loaded = self.state.loaded
        assert loaded is not None
        digest = xxhash.xxh3_64(np.concatenate([box.center, box.R.ravel(), box.size]).tobytes())
        digest.update(np.ascontiguousarray(entry.mask).data)
        digest.update(f"{self.state.source} {view.frame.frame} {number}".encode())
        key = digest.hexdigest()
        if key == self._key:
            return
        try:
            up = viewer_axes(np.array(view.frame.row["up"]))
            self._told(key, side_views(loaded.context.frame, up, box, entry.mask), f"{entry.label}·{number}")
        except InputError as error:
            self.ctx.note(f"no side views: {error}")
            self._told("", None)

    def _told(self, key: str, views: SideViews | None, name: str = "") -> None:
        if key != self._key:
            self._key, self._views = key, views
            self.ctx.page.call("sides", None if views is None else {"key": key, "name": name, **views.record()})


def crops(ctx: Context, view: LabelView) -> Element | None:
    """What is looked at, large: as it is, and beside it as the labeller had it where that is another."""
    state = ctx.state
    if state.loaded is None or state.selected is None:
        return None
    frame = state.loaded.context.frame
    places = [state.selected] if state.pair is None or state.selected not in state.pair else list(state.pair[:2])
    entries = [state.shown.objects[k] for k in dict.fromkeys(places)]
    names = [state.shown.names[k] for k in dict.fromkeys(places)]
    around = _around(np.array([e.bbox for e in entries]), frame)
    colors = palette(True)
    now = [(e.mask, e.lifted.box, colors["target" if k == 0 else "reference"]) for k, e in enumerate(entries)]
    found = [_crop(" and ".join(names), "now", frame, around, now)]
    before = view.frame.auto.objects.get(view.numbers[state.selected])
    if before is not None and _differs(before, view.frame.objects[view.numbers[state.selected]]):
        mask = _mask_of(before, (frame.height, frame.width))
        was = [(mask, labelled_box(before), colors["other"])]
        found.insert(0, _crop("before", "as labelled", frame, around, was))
    return h.div(found, cls="crops")


def _differs(before: Row, now: Row) -> bool:
    return any(before[name] != now[name] for name in ("mask", "bbox", "center", "R", "size"))


def _mask_of(row: Row, size: tuple[int, int]) -> np.ndarray:
    bbox = np.array(row["bbox"], np.float32)
    return box_mask(bbox, *size) if row["mask"] is None else decode_run_length(size, row["mask"])


def _around(boxes: np.ndarray, frame: Frame) -> tuple[int, int, int, int]:
    """x0, y0, x1, y1 of the picture around 2D boxes, with a margin."""
    lo, hi = boxes[:, :2].min(axis=0), boxes[:, 2:].max(axis=0)
    side = max(float((hi - lo).max()) * (1 + 2 * CROP_MARGIN), CROP_LEAST)
    middle = (lo + hi) / 2
    x0, y0 = (int(max(m - side / 2, 0)) for m in middle)
    x1, y1 = int(min(middle[0] + side / 2, frame.width)), int(min(middle[1] + side / 2, frame.height))
    return x0, y0, max(x1, x0 + 2), max(y1, y0 + 2)


def _crop(
    name: str, which: str, frame: Frame, around: tuple[int, int, int, int],
    things: Sequence[tuple[np.ndarray, Box3D | None, RGB]],
) -> Element:  # fmt: skip
    x0, y0, x1, y1 = around
    width, height = x1 - x0, y1 - y0
    picture = jpeg_url(np.ascontiguousarray(frame.rgb[y0:y1, x0:x1]), 90)
    marks: list[Element] = []
    for mask, box, color in things:
        line = _outline(mask[y0:y1, x0:x1]) + ("" if box is None else edges_path(box, frame.camera, (x0, y0)))
        # A dark line under the coloured one: it is seen on any ground.
        marks += [h.path(d=line, cls="mask under"), h.path(d=line, cls="mask", stroke=hex_color(color))]
    return h.figure(
        h.figcaption(h.b(name), h.span(which, cls="dim")),
        h.div(
            h.svg(h.image(href=picture, width=width, height=height), marks, viewBox=f"0 0 {width} {height}",
                  role="img", aria_label=f"{name}, {which}"),
            cls="pic-room",
        ),
        cls="crop",
    )  # fmt: skip


def _outline(mask: np.ndarray) -> str:
    lines, _ = cv2.findContours(np.ascontiguousarray(mask).view(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_TC89_L1)
    kept = (line.reshape(-1, 2) + 0.5 for line in lines if len(line) > 2)
    return "".join("M" + "L".join(f"{x:.1f} {y:.1f}" for x, y in line.tolist()) + "Z" for line in kept)
