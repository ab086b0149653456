"""One labelled object corrected in the page: its class, its status, its 3D box, each field given back."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from pipeline.corrections.journal.edits import Edits, set_box, set_class, set_status
from pipeline.corrections.journal.effective import Corrector
from pipeline.corrections.journal.effective_frame import EffectiveFrame
from pipeline.corrections.journal.events import Saved
from pipeline.corrections.journal.field_refs import object_ref
from pipeline.corrections.label_editor import LabelEditor
from pipeline.corrections.object_card import back_to_automatic, bring_back, judgements, object_card
from pipeline.corrections.scene import MovingBox
from pipeline.corrections.support import fit_to_points, snap_to_support
from pipeline.corrections.vocabulary import Vocabulary, completions, vocabulary_of
from pipeline.diagnosis.whatif.placement import SMALLEST_SIDE, box_numbers, with_numbers
from pipeline.geometry.boxes import Box3D
from pipeline.geometry.palette import palette
from pipeline.system.errors import InputError
from spatialviz.app.context import Context, Part, command
from spatialviz.app.correct import Correct
from spatialviz.app.edit_panel import STATUS_WORDS, numbers_said, object_html, rejected_html, saved_html
from spatialviz.app.edit_scene import BoxGizmo
from spatialviz.app.label_view import LabelView
from spatialviz.app.markup import h, panel
from spatialviz.app.review_html import pair_html

FARTHEST = 1000.0
"""Metres: no typed side or place of a box is beyond; a number that slipped would otherwise be saved."""


class LabelObject(Part):
    """Shows and corrects the selected labelled object of one client."""

    def __init__(self, ctx: Context, correct: Correct) -> None:
        super().__init__(ctx)
        self._correct = correct
        self._words: dict[str, Vocabulary] = {}
        self._asked: tuple[str, int, str] | None = None
        self._rejected: list[tuple[str, int]] = []
        self._moving: MovingBox | None = None
        self._held: int | None = None
        self._follows = False
        self._gizmo = BoxGizmo(ctx, self._dragged, "/label")

    @property
    def _selected(self) -> tuple[LabelView, int] | None:
        """The labels that are shown, and the number of the selected object."""
        state = self.state
        view = state.labels
        if view is None or state.selected is None or state.selected >= len(view.numbers):
            return None
        return view, view.numbers[state.selected]

    def _edit(self, made: Callable[[EffectiveFrame, int, Corrector], Edits]) -> bool:
        """Save an edit of the selected object; whether it was."""
        chosen, desk = self._selected, self._correct.desk
        if chosen is None or desk is None:
            return False
        number = chosen[1]
        return isinstance(self._correct.save(lambda frame: made(frame, number, desk.corrector)), Saved)

    # ---- class ------------------------------------------------------------------------

    def _vocabulary(self, desk: LabelEditor) -> Vocabulary:
        source = self.state.source
        if source not in self._words:
            labels, dataset = desk.labels, desk.corrector.dataset
            try:
                self._words[source] = vocabulary_of(labels, dataset, desk.location.to_read())
            except InputError:
                # While the journal is away, class names that people have given are unknown; the next time they may not.
                return vocabulary_of(labels, dataset)
        return self._words[source]

    @command("class-typed")
    def _complete(self, typed: str) -> None:
        """Offer the classes that may be meant by what is being typed."""
        desk = self._correct.desk
        if desk is None or self._selected is None:
            return
        self._asked = None
        found = completions(typed, self._vocabulary(desk))
        self.ctx.page.call("offer", {"typed": typed, "offers": [c.record() for c in found]})

    @command("class-focus")
    def _focus_class(self) -> None:
        self.ctx.page.call("focusClass")

    @command("class")
    def name_class(self, name: str) -> None:
        """Save another class name; one that no class has is asked for twice."""
        chosen, desk = self._selected, self._correct.desk
        name = " ".join(name.split())
        if chosen is None or desk is None or not name:
            return
        view, number = chosen
        words = self._vocabulary(desk)
        asked = (view.frame.frame, number, name)
        if name == view.frame.objects[number]["label"]:
            self.ctx.draw()
            return
        if name not in words and self._asked != asked:
            self._asked = asked
            said = f"No class is called “{name}” yet: Enter again makes it one."
            offers = [c.record() for c in completions(name, words) if c.known]
            self.ctx.page.call("offer", {"offers": offers, "note": said})
            return
        self._asked = None
        if self._edit(lambda f, n, c: set_class(f, n, name)):
            self._words[self.state.source] = words.with_names([name])

    # ---- status -----------------------------------------------------------------------

    @command("object-status")
    def set_status(self, status: str) -> None:
        """Accept, reject or doubt the object; what it is already is taken off again."""
        chosen, desk = self._selected, self._correct.desk
        if chosen is None or desk is None or status not in STATUS_WORDS:
            return
        view, number = chosen
        cell, author = object_ref(view.frame.frame, number, "status"), desk.author
        wanted = None if judgements(view.frame, number).get(author) == status else status
        if self._edit(lambda f, n, c: set_status(f, cell, wanted, author=author)) and wanted == "rejected":
            self._rejected.append((view.frame.frame, number))

    @command("object-back")
    def bring_back(self, said: str) -> None:
        """Bring a rejected object back, by its number, else the one that was rejected last, and select it."""
        view, desk = self.state.labels, self._correct.desk
        if view is None or desk is None:
            return
        gone = [n for frame, n in self._rejected if frame == view.frame.frame and n in view.frame.left_out]
        number = int(said) if said.isdecimal() else next(reversed(gone or sorted(view.frame.left_out)), None)
        if number is None or number not in view.frame.left_out:
            self.ctx.note("no rejected object to bring back")
            return
        self._correct.save(lambda frame: bring_back(frame, number, desk.author))
        view = self.state.labels
        place = None if view is None else view.place(number)
        if place is not None:
            self.ctx.show(selected=place)

    # ---- box --------------------------------------------------------------------------

    @command("box-fit")
    def _fit(self) -> None:
        self._edit(fit_to_points)

    @command("box-snap")
    def _snap(self, way: str) -> None:
        self._edit(lambda f, n, c: snap_to_support(f, n, c, "move" if way == "move" else "extend"))

    @command("field-back")
    def _give_back(self, field: str) -> None:
        self._edit(lambda f, n, c: back_to_automatic(f, n, field))

    @command("box-set")
    def _set_number(self, said: str) -> None:
        """center:AXIS:METRES, size:AXIS:METRES, yaw:DEGREES."""
        state, chosen = self.state, self._selected
        box = None if state.selected is None else state.shown.objects[state.selected].lifted.box
        what, *rest = said.split(":")
        try:
            value = float(rest[-1])
        except (ValueError, IndexError):
            return
        if chosen is None or box is None or state.loaded is None or not np.isfinite(value):
            return
        if (what == "size" and not SMALLEST_SIDE <= value <= FARTHEST) or (what == "center" and abs(value) > FARTHEST):
            least = SMALLEST_SIDE if what == "size" else -FARTHEST
            self._correct.refuse(f"{value:g} m: a 3D box takes {least:g} to {FARTHEST:g} m here")
            return
        viewer = state.loaded.context.viewer
        numbers = box_numbers(box, viewer)
        if what == "yaw":
            changed = with_numbers(box, viewer, yaw=value)
        elif what in ("center", "size") and rest[0] in ("0", "1", "2"):
            a, b, c = (value if k == int(rest[0]) else float(x) for k, x in enumerate(getattr(numbers, what)))
            moved = what == "center"
            changed = with_numbers(box, viewer, center=(a, b, c) if moved else None, size=None if moved else (a, b, c))
        else:
            return
        self._edit(lambda f, n, c: set_box(f, n, changed))

    def _dragged(self, box: Box3D, ended: bool) -> None:
        chosen, state, desk = self._selected, self.state, self._correct.desk
        if chosen is None or desk is None or chosen[1] != self._held or state.selected is None:
            self._moving = None
            return
        view, number = chosen
        if ended:
            self._moving = None
            if self._correct.save(lambda frame: set_box(frame, number, box)) is None:
                self._correct.renew()
                self.ctx.draw()
            return
        try:
            if self._moving is None or self._moving.frame is not view.frame or self._moving.number != number:
                pair = None if state.pair is None else (view.numbers[state.pair[0]], view.numbers[state.pair[1]])
                self._moving = MovingBox(view.frame, desk.corrector, number, pair)
            moved = self._moving.moved(box)
        except InputError as error:
            self.ctx.note(f"not moved: {error}")
            return
        objects = list(state.shown.objects)
        entry = objects[state.selected]
        objects[state.selected] = replace(entry, lifted=replace(entry.lifted, box=box))
        there = replace(state.shown, objects=tuple(objects))
        self.state = replace(state, shown=there, labels=replace(view, moved=moved))
        self.ctx.draw(live=True)

    # ---- drawing ----------------------------------------------------------------------

    def follow(self, live: bool = False) -> None:
        """Bring the handles and the Edit tab up to the state; `live` follows a drag."""
        state, view, desk = self.state, self.state.labels, self._correct.desk
        if view is None or desk is None:
            self._gizmo.show(None, "off")
            return
        chosen = self._selected
        box = None if state.selected is None else state.shown.objects[state.selected].lifted.box
        if not self._gizmo.held:
            self._held = None if chosen is None else chosen[1]
        self._gizmo.show(None if box is None else self.ctx.scene.shown_box(box), state.mode)
        self.ctx.page.show("cost", saved_html(desk.author, view.said, view.bad, view.moved))
        if live or self._follows:
            # A drag that comes to nothing leaves the tab as it was: the fields go back.
            self._follows = live
            if box is not None and state.loaded is not None:
                self.ctx.page.call("numbers", numbers_said(box_numbers(box, state.loaded.context.viewer)))
        if live:
            if view.moved is not None and view.moved.card is not None:
                now = replace(state, labels=replace(view, card=view.moved.card))
                self.ctx.page.show("review-pair", pair_html(now))
            return
        gone = rejected_html(view.frame.left_out)
        if chosen is None or state.selected is None:
            hint = "Select an object: click its row, its pixels or its box."
            self.ctx.page.show("edit", panel(h.div(hint, cls="dim")), gone)
            return
        card = object_card(view.frame, chosen[1])
        color = palette(state.dark)[state.roles.get(state.selected, "other")]
        name = state.shown.names[state.selected]
        self.ctx.page.show("edit", object_html(card, name, color, state.mode, desk.author), gone)
