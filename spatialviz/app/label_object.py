"""One labelled object corrected in the page: its class, its status, its 3D box, each field given back."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import replace

from pipeline.corrections.journal.edits import Edits, set_box, set_class, set_status
from pipeline.corrections.journal.effective import Corrector
from pipeline.corrections.journal.effective_frame import EffectiveFrame
from pipeline.corrections.journal.events import Event, Saved
from pipeline.corrections.journal.field_refs import object_ref
from pipeline.corrections.object_card import back_to_automatic, bring_back, judgements, object_card
from pipeline.corrections.scene import MovingBox
from pipeline.corrections.support import fit_to_points, snap_to_support
from pipeline.corrections.vocabulary import Vocabulary, completions, vocabulary_of
from pipeline.diagnosis.whatif.placement import SMALLEST_SIDE, box_numbers
from pipeline.geometry.boxes import Box3D
from pipeline.geometry.palette import palette
from pipeline.system.errors import InputError, needed, require
from spatialviz.app.context import Context, command
from spatialviz.app.edit_messages import box_with, number_of
from spatialviz.app.edit_panel import STATUS_WORDS, box_command, numbers_said, object_html, rejected_html, saved_html
from spatialviz.app.edit_scene import BoxGizmo
from spatialviz.app.label_item import UNNAMED, digits_row
from spatialviz.app.label_part import LabelPart
from spatialviz.app.markup import h, panel
from spatialviz.app.review_html import pair_html

FARTHEST = 1000.0
"""Metres: no typed side or place of a box is beyond; a number that slipped would otherwise be saved."""
SELECT = "Select an object: click its row, its pixels or its box."


class LabelObject(LabelPart):
    """Shows and corrects the selected labelled object of one client."""

    def __init__(self, ctx: Context) -> None:
        super().__init__(ctx)
        self._words: dict[str, Vocabulary] = {}
        self._asked: tuple[str, int, str] | None = None
        self._rejected: list[tuple[str, int]] = []
        self._moving: MovingBox | None = None
        self._held: int | None = None
        self._follows = False
        ctx.editors.on_saved.append(self._learn)
        self._gizmo = BoxGizmo(ctx, self._dragged, "/label")

    @property
    def _box(self) -> Box3D | None:
        """Of the selected object."""
        state = self.state
        return None if state.selected is None else state.shown.objects[state.selected].lifted.box

    def _edit(self, made: Callable[[EffectiveFrame, int, Corrector], Edits]) -> bool:
        """Save an edit of the selected object; whether it was."""
        number, corrector = needed(self.number, SELECT), self.editor.corrector
        return isinstance(self.save(lambda frame: made(frame, number, corrector)), Saved)

    # ---- class ------------------------------------------------------------------------

    def _vocabulary(self) -> Vocabulary:
        source, labels, dataset = self.state.source, self.editor.labels, self.editor.corrector.dataset
        if source not in self._words:
            try:
                self._words[source] = vocabulary_of(labels, dataset, self.location.to_read())
            except InputError:
                # While the journal is away, class names that people have given are unknown; the next time they may not.
                return vocabulary_of(labels, dataset)
        return self._words[source]

    @command("class-typed")
    def _complete(self, typed: str) -> None:
        """Offer the classes that may be meant by what is being typed."""
        self._asked = None
        found = completions(typed, self._vocabulary())
        self.ctx.page.call("offer", {"typed": typed, "offers": [c.record() for c in found]})

    @command("class-focus")
    def _focus_class(self) -> None:
        self.ctx.page.call("focusClass")

    @command("class")
    def name_class(self, name: str) -> None:
        """Save another class name; one that no class has is asked for twice."""
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
        """Name the object by a digit, from 1, of the classes that are most frequent."""
        names = self.digits
        if self.number is not None and 1 <= digit <= len(names):
            self.name_class(names[digit - 1])

    @property
    def digits(self) -> list[str]:
        """The classes that digits choose."""
        here = Counter(row["label"] for row in self.view.frame.objects.values())
        often = (c.name for c in completions("", self._vocabulary(), 18))
        names = dict.fromkeys((*often, *(name for name, _ in here.most_common())))
        return [name for name in names if name != UNNAMED][:9]

    def _learn(self, events: tuple[Event, ...]) -> None:
        """Class names that this person has given elsewhere can be completed here."""
        source = self.state.source
        given = [e.after for e in events if (e.ref.kind, e.ref.field) == ("object", "label")]
        if source in self._words and given:
            self._words[source] = self._words[source].with_names(given)

    # ---- status -----------------------------------------------------------------------

    @command("object-status")
    def set_status(self, status: str) -> None:
        """Accept, reject or doubt the object; what it is already is taken off again."""
        frame, number, author = self.view.frame, needed(self.number, SELECT), self.editor.author
        if status not in STATUS_WORDS:
            return
        cell = object_ref(frame.frame, number, "status")
        wanted = None if judgements(frame, number).get(author) == status else status
        if self._edit(lambda f, n, c: set_status(f, cell, wanted, author=author)) and wanted == "rejected":
            self._rejected.append((frame.frame, number))

    @command("object-back")
    def bring_back(self, said: str) -> None:
        """Bring a rejected object back, by its number, else the one that was rejected last, and select it."""
        frame, author = self.view.frame, self.editor.author
        gone = [n for name, n in self._rejected if name == frame.frame and n in frame.left_out]
        found = int(said) if said.isdecimal() else next(reversed(gone or sorted(frame.left_out)), None)
        number = needed(found if found in frame.left_out else None, "no rejected object to bring back")
        self.save(lambda frame: bring_back(frame, number, author))
        place = self.view.place(number)
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
        """Of an object, as `box_command` says it: OF:center:AXIS:METRES, OF:size:AXIS:METRES, OF:yaw:DEGREES."""
        loaded, box = self.state.loaded, self._box
        if loaded is None or box is None:
            return
        of, what, *numbers = said.split(":")
        require(
            f"box-set:{of}" == box_command(self.state.frame_id, needed(self.number, SELECT)),
            "another object is selected by now: nothing was changed",
        )
        least, value = SMALLEST_SIDE if what == "size" else -FARTHEST, number_of(numbers[-1:])
        require(
            what == "yaw" or least <= value <= FARTHEST,
            f"{value:g} m: a 3D box takes {least:g} to {FARTHEST:g} m here",
        )
        changed = box_with(box, loaded.context.viewer, what, numbers)
        self._edit(lambda f, n, c: set_box(f, n, changed))

    def _dragged(self, box: Box3D, ended: bool) -> None:
        view, number, state = self.state.labels, self.number, self.state
        moving, self._moving = self._moving, None
        if view is None or number is None or number != self._held or state.selected is None:
            return
        if ended:
            try:
                self.save(lambda frame: set_box(frame, number, box))
            except InputError as error:
                self.ctx.fail(error)
                self.renew()
                self.ctx.draw()
            return
        try:
            if moving is None or moving.frame is not view.frame or moving.number != number:
                pair = None if state.pair is None else (view.numbers[state.pair[0]], view.numbers[state.pair[1]])
                moving = MovingBox(view.frame, self.editor.corrector, number, pair)
            moved, self._moving = moving.moved(box), moving
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
        state, view, page = self.state, self.state.labels, self.ctx.page
        if view is None:
            self._gizmo.show(None, "off")
            return
        number, box = self.number, self._box
        if not self._gizmo.held:
            self._held = number
        self._gizmo.show(None if box is None else self.ctx.scene.shown_box(box), state.mode)
        page.show("cost", saved_html(self.editor.author, view.said, view.bad, view.moved))
        if (live or self._follows) and number is not None and box is not None and state.loaded is not None:
            # A drag that comes to nothing leaves the tab as it was: the fields go back.
            numbers, sends = box_numbers(box, state.loaded.context.viewer), box_command(state.frame_id, number)
            page.call("numbers", numbers_said(numbers, sends))
        self._follows = live
        if live:
            if view.moved is not None and view.moved.card is not None:
                page.show("review-pair", pair_html(replace(state, labels=replace(view, card=view.moved.card))))
            return
        named = number is not None and (view.item is None or view.item.kind == "object")
        label = view.frame.objects[number]["label"] if named and number is not None else ""
        page.show("digits", panel(digits_row(self.digits, label)) if named else None)
        shown = panel(h.div(SELECT, cls="dim"))
        if number is not None and state.selected is not None:
            color = palette(state.dark)[state.roles.get(state.selected, "other")]
            name = state.shown.names[state.selected]
            shown = object_html(object_card(view.frame, number), name, color, state.mode, self.editor.author)
        page.show("edit", shown, rejected_html(view.frame.left_out))
