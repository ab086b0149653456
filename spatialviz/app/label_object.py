"""Correction of a labelled object: class, 3D box, reset of each field; three side views, and a large crop."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from operator import is_
from typing import Any, Literal

import numpy as np
import xxhash
from pydantic import NonNegativeInt

from pipeline.answering.objects import SceneObject
from pipeline.corrections.journal.edits import Edits, set_box, set_class
from pipeline.corrections.journal.effective import Corrector
from pipeline.corrections.journal.effective_frame import EffectiveFrame
from pipeline.corrections.journal.events import Event, Saved
from pipeline.corrections.label_editor import Target
from pipeline.corrections.object_card import LabelView, back_to_automatic, bring_back, object_card
from pipeline.corrections.review.decisions import UNNAMED
from pipeline.corrections.scene import SideViews, drag_box, dragged, face_to_points, fit_to_points, side_views
from pipeline.corrections.sightings import Sightings
from pipeline.corrections.vocabulary import Vocabulary, by_digits, completions, vocabulary_of
from pipeline.diagnosis.whatif.edit_words import box_with, number_of
from pipeline.diagnosis.whatif.placement import SMALLEST_SIDE
from pipeline.geometry.boxes import Box3D
from pipeline.geometry.frame import Frame
from pipeline.geometry.palette import RGB, hex_color, palette
from pipeline.geometry.viewer import viewer_axes
from pipeline.pictures.marks import edges_path, outline_path
from pipeline.system.errors import InputError, needed, require
from spatialviz.app.context import Context, command, there
from spatialviz.app.edit_panel import box_command, class_field, object_html, rejected_html, row
from spatialviz.app.frames import WIDTH, jpeg_url
from spatialviz.app.label_part import LabelPart
from spatialviz.app.markup import Element, button, h, panel
from spatialviz.app.object_strip import strip_html
from spatialviz.app.review_html import digits_row

FARTHEST = 1000.0
"""Metres: limit of a typed side or place of a box, against slips."""
SELECT = "Select an object: click its row, its pixels or its box."


class LabelObject(LabelPart):
    """Shows and corrects a client's selected labelled object."""

    def __init__(self, ctx: Context) -> None:
        super().__init__(ctx)
        self._words: dict[str, Vocabulary] = {}
        self._asked: tuple[str, int, str] | None = None
        self._seen: dict[str, Sightings] = {}
        ctx.editors.on_saved.append(self._learn)

    @property
    def _box(self) -> Box3D | None:
        """Box of the selected object."""
        state = self.state
        return None if state.selected is None else state.shown.objects[state.selected].lifted.box

    def _edit(self, made: Callable[[EffectiveFrame, int, Corrector], Edits]) -> bool:
        """Save an edit of the selected object; returns success."""
        number, corrector = needed(self.number, SELECT), self.editor.corrector
        return isinstance(self.save(lambda frame: made(frame, number, corrector)), Saved)

    # ---- class ------------------------------------------------------------------------

    def _vocabulary(self) -> Vocabulary:
        source, labels, dataset = self.state.source, self.editor.labels, self.editor.corrector.dataset
        if source not in self._words:
            try:
                self._words[source] = vocabulary_of(labels, dataset, self.location.to_read())
            except InputError:
                # Without the journal, class names given by people are unknown; not cached.
                return vocabulary_of(labels, dataset)
        return self._words[source]

    @command("class-typed")
    def _complete(self, typed: str) -> None:
        """Suggest classes for the typed text."""
        self._asked = None
        found = completions(typed, self._vocabulary())
        self.ctx.page.call("offer", {"typed": typed, "offers": [c.record() for c in found]})

    @command("class-focus")
    def _focus_class(self) -> None:
        self.ctx.page.call("focusClass")

    @command("class")
    def name_class(self, name: str) -> None:
        """Save another class name; an unknown class needs confirmation."""
        name, frame, number = " ".join(name.split()), self.view.frame, needed(self.number, SELECT)
        words, before, self._asked = self._vocabulary(), self._asked, (frame.frame, number, name)
        if not name or name == frame.objects[number]["label"]:
            self.ctx.draw()
        elif name not in words and self._asked != before:
            said = f"No class is called “{name}” yet: Enter again makes it one."
            offers = [c.record() for c in completions(name, words) if c.known]
            self.ctx.page.call("offer", {"offers": offers, "note": said})
        elif self._edit(lambda f, n, c: set_class(f, n, name)):
            self._words[self.state.source] = words.with_names([name])

    @command("digit")
    def choose_class(self, digit: int) -> None:
        """Name the object by a digit, from 1, of the most frequent classes."""
        names = self.digits
        if self.number is not None and 1 <= digit <= len(names):
            self.name_class(names[digit - 1])

    @property
    def digits(self) -> list[str]:
        """Classes chosen by digits."""
        here = (row["label"] for row in self.view.frame.objects.values())
        return by_digits(self._vocabulary(), here, UNNAMED)

    def _learn(self, events: tuple[Event, ...]) -> None:
        """Add class names from this person's earlier edits to the completions."""
        source = self.state.source
        given = [e.after for e in events if (e.ref.kind, e.ref.field) == ("object", "label")]
        if source in self._words and given:
            self._words[source] = self._words[source].with_names(given)

    # ---- other frames -----------------------------------------------------------------

    @property
    def _sightings(self) -> Sightings:
        source = self.state.source
        if source not in self._seen:
            self._seen[source] = Sightings(self.location.labels)
        return self._seen[source]

    @command("object-at")
    def look_at_object(self, number: NonNegativeInt, frame: str) -> None:
        """Show an object of a frame."""
        self.look_at(Target(frame, (number,)))

    @command("same-object")
    def step_frames(self, step: int) -> None:
        """Show the same object in the next frame that it is labelled in, or the previous."""
        number = needed(self.number, SELECT)
        found = there(self._sightings.beside(self.state.frame_id, number, step))
        self.look_at_object(found.number, found.frame)

    # ---- rejected objects ------------------------------------------------------------

    @command("object-back")
    def bring_back(self, number: int) -> None:
        """Restore a rejected object, and select it."""
        author = self.editor.author
        require(number in self.view.frame.left_out, "no rejected object to bring back", got=number)
        self.save(lambda frame: bring_back(frame, number, author))
        self.ctx.show(selected=self.view.place(number))

    # ---- box --------------------------------------------------------------------------

    @command("box-fit")
    def _fit(self) -> None:
        self._edit(fit_to_points)

    @command("field-back")
    def _give_back(self, field: str) -> None:
        self._edit(lambda f, n, c: back_to_automatic(f, n, field))

    @command("box-set")
    def _set_number(self, said: str) -> None:
        """Set a number of a box, as of `box_command`: OF:center:AXIS:METRES, OF:size:AXIS:METRES, OF:yaw:DEGREES."""
        loaded, box, number = self.state.loaded, self._box, self.number
        of, what, *numbers = said.split(":")
        still = number is not None and f"box-set:{of}" == box_command(self.state.frame_id, number)
        require(still, "another object is selected by now: nothing was changed")
        if loaded is None or box is None:
            return
        least, value = SMALLEST_SIDE if what == "size" else -FARTHEST, number_of(numbers[-1:])
        require(
            what == "yaw" or least <= value <= FARTHEST,
            f"{value:g} m: a 3D box takes {least:g} to {FARTHEST:g} m here",
        )
        changed = box_with(box, loaded.context.viewer, what, numbers)
        self._edit(lambda f, n, c: set_box(f, n, changed))

    # ---- drawing ----------------------------------------------------------------------

    def follow(self) -> None:
        """Draw the Edit tab for the state."""
        state, view, page, number = self.state, self.state.labels, self.ctx.page, self.number
        if view is None:
            return
        named = number is not None and (view.item is None or view.item.kind == "object")
        label = view.frame.objects[number]["label"] if named and number is not None else ""
        page.show("digits", panel(row("Class", class_field(label)), digits_row(self.digits, label)) if named else None)
        shown = panel(h.div(SELECT, cls="dim"))
        if number is not None and state.selected is not None:
            color = palette(state.dark)["truth"]
            frames = self._sightings.of(view.frame.frame, number)
            strip = strip_html(frames, view.frame.frame, self.picture)
            shown = object_html(object_card(view.frame, number), state.shown.names[state.selected], color, named, strip)
        page.show("edit", shown, rejected_html(view.frame.left_out))

    def picture(self, frame: str) -> str:
        """Address of a frame's picture."""
        sources = self.ctx.shared.store.sources
        number = self.ctx.shared.pictures.timeline(self.state.source).indices[frame]
        return f"app/frame/{list(sources).index(self.state.source)}/{number}/{WIDTH}.jpg"


CROP_MARGIN, CROP_LEAST = 0.35, 96
"""Margin of the large crop: share of the longer side; pixels at least."""


class SidePanel(LabelPart):
    """Side views of a client."""

    def __init__(self, ctx: Context) -> None:
        super().__init__(ctx)
        self._key = ""
        self._views: SideViews | None = None
        self._cropped: tuple[tuple[object, ...], Element | None] = (), None

    @property
    def _chosen(self) -> tuple[LabelView, int, SceneObject] | None:
        """Labels, number of the selected object, and the object."""
        state = self.state
        view = state.labels
        if view is None or state.loaded is None or state.selected is None or state.selected >= len(view.numbers):
            return None
        return view, view.numbers[state.selected], state.shown.objects[state.selected]

    @command("next-object")
    def step(self, step: int) -> None:
        """Select the next object of the frame, by number."""
        state = self.state
        if state.labels is not None and (count := len(state.labels.numbers)):
            at = -1 if state.selected is None and step > 0 else state.selected or 0
            item = state.labels.item
            # Stepping through objects chooses no pair; an open item's pair stays.
            self.ctx.show(selected=(at + step) % count, pair=None if item is None else state.pair)

    @command("side-drag")
    def drag(self, key: str, moves: list[Any]) -> None:
        """Save a drag of the box named by the key."""
        chosen = self._chosen
        if chosen is None or key != self._key:
            self.ctx.page.call("sidesBack")
            return
        self._dragged(lambda frame: drag_box(frame, chosen[1], moves))

    @command("side-fit")
    def fit(self, key: str, axis: Literal[0, 1, 2], side: Literal[1, -1]) -> None:
        """Fit a face to the object's points; the key names the box."""
        chosen, views = self._chosen, self._views
        if chosen is None or views is None or key != self._key:
            return

        def made(frame: EffectiveFrame) -> Edits:
            box = dragged(views.box, views.axes, [face_to_points(views, axis, side)])
            return set_box(frame, chosen[1], box, "a face fitted to the points")

        self._dragged(made)

    def _dragged(self, made: Callable[[EffectiveFrame], Edits]) -> None:
        """Save a drag; reset the browser's box on failure."""
        try:
            self.save(made)
        except InputError:
            self.ctx.page.call("sidesBack")
            raise

    def follow(self) -> None:
        """Draw the views for the state; points are sent only on a change of points or box."""
        chosen = self._chosen
        self.ctx.page.show("crop", None if chosen is None else self._crops(chosen[0]))
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
            self._told(key, side_views(loaded.context.frame, up, box, entry.mask), f"{entry.label} {number}")
        except InputError as error:
            self.ctx.note(f"no side views: {error}")
            self._told("", None)

    def _told(self, key: str, views: SideViews | None, name: str = "") -> None:
        if key != self._key:
            self._key, self._views = key, views
            self.ctx.page.call("sides", None if views is None else {"key": key, "name": name, **views.record()})

    def _crops(self, view: LabelView) -> Element | None:
        """Large crop of the current item, beside the labeller's version where different; made once."""
        state = self.state
        if state.loaded is None or state.selected is None:
            return None
        frame = state.loaded.context.frame
        places = [state.selected] if state.pair is None or state.selected not in state.pair else list(state.pair[:2])
        entries = [state.shown.objects[k] for k in dict.fromkeys(places)]
        merge = state.pair is not None and state.pair[0] != state.pair[1]
        # What is corrected of an object makes another entry of it.
        drawn = (frame, merge, *entries)
        if len(drawn) != len(self._cropped[0]) or not all(map(is_, drawn, self._cropped[0])):
            names = [state.shown.names[k] for k in dict.fromkeys(places)]
            before = view.as_labelled(view.numbers[state.selected], (frame.height, frame.width))
            self._cropped = drawn, _crops(frame, entries, names, before, merge)
        return self._cropped[1]


def _crops(
    frame: Frame,
    entries: Sequence[SceneObject],
    names: Sequence[str],
    before: tuple[np.ndarray, Box3D | None] | None,
    merge: bool,
) -> Element:
    around = _around(np.array([e.bbox for e in entries]), frame)
    colors = palette(True)
    now = [(e.mask, e.lifted.box, colors["truth"]) for e in entries]
    found = [_crop(" and ".join(names), "now", frame, around, now)]
    if before is not None:
        found.insert(0, _crop("before", "as labelled", frame, around, [(*before, colors["other"])]))
    tools = h.div(
        button("Pixels", "px-tool:brush", "edit its pixels (Shift+I)"),
        button("Merge", "px-merge", f"{' becomes a part of '.join(names)} (Shift+M)") if merge else None,
        cls="crop-tools",
    )
    return h.div(found, tools, cls="crops")


def _around(boxes: np.ndarray, frame: Frame) -> tuple[int, int, int, int]:
    """x0, y0, x1, y1 of the picture around 2D boxes, with a margin."""
    lo, hi = boxes[:, :2].min(axis=0), boxes[:, 2:].max(axis=0)
    side = max(float((hi - lo).max()) * (1 + 2 * CROP_MARGIN), CROP_LEAST)
    middle = (lo + hi) / 2
    x0, y0 = (int(max(m - side / 2, 0)) for m in middle)
    x1, y1 = int(min(middle[0] + side / 2, frame.width)), int(min(middle[1] + side / 2, frame.height))
    return x0, y0, max(x1, x0 + 2), max(y1, y0 + 2)


def _crop(
    name: str,
    which: str,
    frame: Frame,
    around: tuple[int, int, int, int],
    things: Sequence[tuple[np.ndarray, Box3D | None, RGB]],
) -> Element:
    x0, y0, x1, y1 = around
    width, height = x1 - x0, y1 - y0
    picture = jpeg_url(np.ascontiguousarray(frame.rgb[y0:y1, x0:x1]), 90)
    marks: list[Element] = []
    for mask, box, color in things:
        edges = "" if box is None else edges_path(box, frame.camera, origin=(x0, y0))
        line = outline_path(mask[y0:y1, x0:x1]) + edges
        # A dark line under the coloured line, visible on any ground.
        marks += [h.path(d=line, cls="mask under"), h.path(d=line, cls="mask", stroke=hex_color(color))]
    return h.figure(
        h.figcaption(h.b(name), h.span(which, cls="dim")),
        h.div(
            h.svg(
                h.image(href=picture, width=width, height=height),
                marks,
                viewBox=f"0 0 {width} {height}",
                role="img",
                aria_label=f"{name}, {which}",
            ),
            cls="pic-room",
        ),
        cls="crop",
    )
