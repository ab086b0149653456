"""Pixel editor: drawing becomes a draft, an applied draft an action of the journal."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any, Literal

from pydantic import NonNegativeInt

from pipeline.corrections.draft import (
    Draft,
    edits_of_draft,
    lifted_draft,
    new_draft,
    rebased,
    with_depth_split,
    with_gesture,
)
from pipeline.corrections.journal.edits import merge_objects, set_class
from pipeline.corrections.journal.events import Conflict, Event
from pipeline.corrections.journal.field_refs import same_value
from pipeline.corrections.object_card import LabelView, paired
from pipeline.corrections.review.decisions import UNNAMED
from pipeline.corrections.vocabulary import by_digits, vocabulary_of
from pipeline.drawing.gestures import Canvas, Gesture, read_gesture
from pipeline.geometry.masks import mask_box
from pipeline.geometry.palette import depth_colors, hex_color
from pipeline.pictures.marks import box_edges_2d
from pipeline.proposals.segmenter import takes_points
from pipeline.system.errors import InputError, as_input_error, needed, require
from spatialviz.app.channel import Command
from spatialviz.app.context import Context, command, there
from spatialviz.app.frames import jpeg_url
from spatialviz.app.label_part import LabelPart
from spatialviz.app.picture import PART_COLORS, around, mask_url, outlined, told_of
from spatialviz.app.state import State

Tool = Literal["select", "brush", "erase", "polygon", "rectangle", "depth", "segment", "cut"]


class Pixels(LabelPart):
    """Draws the pixels of objects in turn."""

    def __init__(self, ctx: Context) -> None:
        super().__init__(ctx)
        self._drafts: dict[tuple[str, str], Draft] = {}
        self._open: tuple[str, str] | None = None
        self._canvas: tuple[tuple[str, str], Canvas] | None = None
        self._of: int | None = None
        self._tool, self._kind = "brush", "rgb"
        self._seen = 0
        self._said, self._bad, self._label = "", False, ""
        self._saving = False
        self._outlined: int | None = None
        """New object, already saved by strokes, without a name."""
        self._disputed: tuple[tuple[str, str], Conflict] | None = None
        ctx.editors.on_saved.append(self._decided)

    # ---- object and tool --------------------------------------------------------------

    @property
    def _key(self) -> tuple[str, str]:
        return self.state.source, self.state.frame_id

    @property
    def _draft(self) -> Draft | None:
        return self._drafts.get(self._key) if self._open == self._key else None

    @command("px-tool")
    def choose(self, tool: Tool) -> None:
        """Choose a tool; without a draft, begin on the selected object."""
        view, known = self.view, self._drafts.get(self._key)
        self._tool = tool
        self._tell()
        if self._draft is None and known is not None and known.changed:
            self._open, self._of = self._key, self.number
            self._tell("this was not applied yet")
        elif self._draft is None:
            self._begin(view, self.number)
        self.follow()

    @command("px-new")
    def new(self, where: str) -> None:
        """Begin a new object with a tool, or in a rectangle of the picture."""
        view = self.view
        if self._unapplied(self._drafts.get(self._key)):
            return
        self._tool, self._outlined = where if where in ("depth", "brush") else "rectangle", None
        self._tell()
        self._begin(view, None)
        if "," in where:
            self._changed(lambda d, c: with_gesture(d, _rectangle(where.split(","), d), c))
        self.follow()

    def _begin(self, view: LabelView, number: int | None) -> None:
        self._open, self._of = self._key, self.number
        self._drafts[self._key] = new_draft(view.frame, number)
        if number is None and self._tool == "cut":
            self._tool = "brush"

    @command("px-select")
    def select(self, fractions: str) -> None:
        """Draw on the object at a place of the picture."""
        if not self._unapplied(self._draft):
            self.ctx.handle(Command("image", (fractions,)))

    def _unapplied(self, draft: Draft | None) -> bool:
        """True, with a message, if an unapplied draft blocks another."""
        if draft is None or not draft.changed:
            return False
        self._open = self._key
        self._tell("apply or cancel this one first", True)
        self.follow()
        return True

    @command("px-apart")
    def _split(self) -> None:
        self._changed(with_depth_split)

    @command("px-cancel")
    def close(self) -> None:
        """Drop the draft."""
        self._drafts.pop(self._key, None)
        self._open = None
        self.follow()

    # ---- drawing ----------------------------------------------------------------------

    @command("px-draw")
    def drawn(self, number: NonNegativeInt, made: dict[str, Any]) -> None:
        """Add a stroke to the draft; the stroke's number is sent back as a receipt."""
        self._seen = number
        if made.get("do") == "segment":
            self.ctx.page.call("working", "segmenting")
        self._changed(lambda draft, canvas: with_gesture(draft, read_gesture(made, draft.height, draft.width), canvas))

    def _changed(self, change: Callable[[Draft, Canvas], Draft]) -> None:
        draft = there(self._draft)
        try:
            self._drafts[self._key] = change(draft, self._canvas_now())
            self._tell()
            self._keep()
        except InputError as error:
            self._tell(str(error), True)
        self.follow()

    @property
    def _fresh(self) -> bool:
        """True for a new, unnamed object."""
        return self._draft is not None and self._draft.number in (None, self._outlined)

    def _keep(self) -> None:
        """Save a stroke of a new object at once; naming comes later."""
        draft = self._draft
        if draft is None or not self._fresh or not draft.changed or not draft.mask.any():
            return
        made, self._saving = edits_of_draft(draft, self.view.frame, UNNAMED), True
        try:
            self.save(lambda _: made, draw=False)
        finally:
            self._saving = False
        self._outlined = made[0].ref.numbers[0]
        state, place = self.state, self.view.place(self._outlined)
        # Paired with the previous selection: the relations appear at once.
        self.state = replace(state, selected=place, pair=paired(state.pair, place, state.selected))
        self._begin(self.view, self._outlined)
        self.ctx.draw()

    def _canvas_now(self) -> Canvas:
        if self._canvas is None or self._canvas[0] != self._key:
            relifter = needed(self.editor.corrector.relifter, "the pictures are not at hand")
            segmenter = self.ctx.source.segmenter
            context = relifter.context(self.state.frame_id)
            self._canvas = self._key, Canvas(context, segmenter if takes_points(segmenter) else None)
        return self._canvas[1]

    @command("px-undo=take-back", "px-redo=bring-back")
    def _stepped(self, otherwise: str) -> None:
        """Undo or redo a step of the draft; without a step, an action of the journal."""
        draft = there(self._draft)
        moved = draft.back() if otherwise == "take-back" else draft.forth()
        self._drafts[self._key] = moved
        self._tell()
        if moved.at == draft.at:
            self.ctx.handle(Command(otherwise))
            self._tell(*self.ctx.editors.said)
        self.follow()

    # ---- saving -----------------------------------------------------------------------

    @command("px-apply")
    def apply(self, stay: bool, label: str) -> None:
        """Save the draft as an action; `stay` keeps the editor open."""
        view, draft = self.view, there(self._draft)
        outcome, number, self._label, self._saving = None, -1, label, True
        try:
            if draft.number is not None and draft.number == self._outlined:
                require(label.strip(), "what is it called?")
                made = set_class(view.frame, draft.number, label.strip())
            else:
                made = edits_of_draft(draft, view.frame, label)
            number = made[0].ref.numbers[0]
            if not stay:
                # Closed first: drawing the whole page takes longer than saving.
                self.ctx.page.call("pixels", {"on": False})
            outcome = self.save(lambda _: made)
            self._tell(*self.ctx.editors.said)
        except InputError as error:
            self._drafts[self._key] = rebased(draft, view.frame)
            self._tell(str(error), True)
        finally:
            self._saving = False
        if isinstance(outcome, Conflict):
            self._disputed = self._key, outcome
        if outcome is None or isinstance(outcome, Conflict):
            self.follow()
            return
        self._label, self._disputed, self._open = "", None, None
        self._drafts.pop(self._key, None)
        self.state = replace(self.state, selected=self.view.place(number))
        new, self._outlined = draft.number in (None, self._outlined), None
        if stay:
            self._begin(self.view, None if new else number)
        self.ctx.draw()

    def _decided(self, events: tuple[Event, ...]) -> None:
        """Drop the disputed draft after a late save."""
        if self._saving or self._disputed is None or self._disputed[0] != self._key:
            return
        wanted = self._disputed[1].edits
        if any(e.ref == edit.ref and same_value(e.after, edit.after) for e in events for edit in wanted):
            self._disputed = None
            self.close()

    @command("px-merge")
    def merge(self) -> None:
        """Merge the selected object into the previously selected object."""
        view, pair = self.view, self.state.pair
        pair = needed(None if pair is None or pair[0] == pair[1] else pair, "select two objects, one after the other")
        numbers = view.numbers[pair[1]], view.numbers[pair[0]]
        self.save(lambda frame: merge_objects(frame, numbers))
        self.ctx.show(selected=self.view.place(numbers[0]))

    # ---- display ----------------------------------------------------------------------

    @command("px-picture")
    def paint(self, kind: Literal["rgb", "depth"]) -> None:
        """Show the picture's colours or depth."""
        self._kind = kind
        self.follow()

    def _tell(self, said: str = "", bad: bool = False) -> None:
        self._said, self._bad = said, bad

    def follow(self) -> None:
        """Draw the editor for the state and the draft."""
        if self._saving:
            return
        state, view = self.state, self.state.labels
        if view is None or self._open != self._key:
            self._open = None
        draft = self._draft
        if draft is not None and view is not None and draft.number not in (None, *view.frame.objects):
            self._drafts.pop(self._key)
            self._open = None if draft.number != self._outlined else self._key
            if self._open is None:
                self.ctx.note(f"object {draft.number} stands no longer: what was drawn for it is dropped")
            else:
                # The object's first stroke was undone.
                self._outlined = None
                self._begin(view, None)
            draft = self._draft
        if draft is None or view is None or state.loaded is None:
            self.ctx.page.call("pixels", {"on": False})
            return
        moved = self.number is not None and self.number != self._of
        if not draft.changed and (moved or rebased(draft, view.frame) != draft):
            # A click in the picture changes the object; the view stays.
            self._begin(view, self.number if moved else draft.number)
            draft = self._drafts[self._key]
        self._show(draft, view, state)

    def _show(self, draft: Draft, view: LabelView, state: State) -> None:
        canvas = self._canvas_now()
        parts = draft.parts
        fresh, known = self._fresh, draft.number is not None
        row = None if draft.number is None or fresh else view.frame.objects[draft.number]
        label = "" if row is None else row["label"]
        lifted = lifted_draft(canvas, parts[0], label) if len(parts) == 1 else None
        box = None if lifted is None else lifted.box
        frame = canvas.context.frame
        words = vocabulary_of(self.editor.labels, self.ctx.source.dataset) if fresh else None
        picture = frame.rgb if self._kind == "rgb" else depth_colors(frame.depth)
        self.ctx.page.call("pixelsPicture", {"kind": self._kind, "url": jpeg_url(picture, 92)})
        data: dict[str, Any] = {
            "on": True,
            "near": around(draft),
            "key": f"{draft.frame}:new" if fresh else f"{draft.frame}:{draft.number}:{draft.version}",
            "tool": self._tool,
            "w": draft.width,
            "h": draft.height,
            "title": "new object" if row is None else f"{row['label']} {draft.number}",
            "fresh": fresh,
            "label": self._label,
            "cuttable": not fresh,
            "segments": canvas.segmenter is not None,
            "names": words.names if words else None,
            "digits": by_digits(words, (o.label for o in state.shown.objects), UNNAMED) if words else [],
            "drawn": mask_box(parts[0]) if fresh and parts[0].any() else None,
            "color": hex_color(PART_COLORS[0]),
            "mask": mask_url(parts),
            "others": list(outlined(state.shown.objects, state.shown.names, draft.number)),
            "edges": [] if box is None else (box_edges_2d(box, frame.camera) + 0.5).reshape(-1, 4).round(1).tolist(),
            "steps": draft.at if draft.changed else int(fresh and known),
            "kept": fresh and known,
            "back": draft.at > 0 or (fresh and known),
            "forth": draft.at < len(draft.steps) - 1,
            "parts": len(parts),
            "seen": self._seen,
            "said": self._said,
            "bad": self._bad,
            "info": told_of(draft, lifted, parts),
        }
        self.ctx.page.call("pixels", data)


def _rectangle(corners: list[str], draft: Draft) -> Gesture:
    with as_input_error("not a rectangle", ValueError, got=",".join(corners)[:60]):
        x0, y0, x1, y1 = map(float, corners)
    return read_gesture({"do": "surface", "at": [[x0, y0], [x1, y1]]}, draft.height, draft.width)
