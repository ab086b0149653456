"""The editor of pixels: what a client draws by hand becomes a draft, and what is applied one action of the journal."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from typing import Any

from pipeline.corrections.draft import (
    Draft,
    edits_of_draft,
    lifted_draft,
    new_draft,
    rebased,
    with_depth_split,
    with_gesture,
)
from pipeline.corrections.drawing.depth_region import TOLERANCE
from pipeline.corrections.drawing.gestures import Canvas, Gesture, gesture_of, read_gesture
from pipeline.corrections.journal.edits import merge_objects
from pipeline.corrections.journal.events import Conflict, Event
from pipeline.corrections.journal.field_refs import same_value
from pipeline.geometry.palette import depth_colors, hex_color
from pipeline.system.errors import InputError
from spatialviz.app.context import Context, Part, command
from spatialviz.app.correct import Correct
from spatialviz.app.frames import jpeg_url
from spatialviz.app.label_view import LabelView
from spatialviz.app.pixels_html import PART_COLORS, PixelScene, around, mask_url, outlines, told_of
from spatialviz.app.selection import Selection
from spatialviz.app.state import State
from spatialviz.report.picture import box_edges_2d

TOOLS = ("select", "brush", "erase", "polygon", "rectangle", "depth", "cut")
LONGEST = 400_000
"""Characters of a message."""


class Pixels(Part):
    """Draws the pixels of one object after the other."""

    def __init__(self, ctx: Context, correct: Correct, selection: Selection) -> None:
        super().__init__(ctx)
        self._correct, self._selection, self._scene = correct, selection, PixelScene(ctx)
        self._drafts: dict[tuple[str, str], Draft] = {}
        self._open: tuple[str, str] | None = None
        self._canvas: tuple[tuple[str, str], Canvas] | None = None
        self._of: int | None = None
        self._tool, self._view, self._kind = "brush", "picture", "rgb"
        self._adds, self._tolerance = True, TOLERANCE
        self._seen = 0
        self._said, self._bad, self._label = "", False, ""
        self._saving = False
        self._disputed: tuple[tuple[str, str], Conflict] | None = None
        correct.on_saved(self._decided)

    # ---- which object, which tool -----------------------------------------------------

    @property
    def _key(self) -> tuple[str, str]:
        return self.state.source, self.state.frame_id

    @property
    def _draft(self) -> Draft | None:
        return self._drafts.get(self._key) if self._open == self._key else None

    def _selected(self) -> int | None:
        state = self.state
        return None if state.labels is None or state.selected is None else state.labels.numbers[state.selected]

    def _labels(self) -> LabelView | None:
        """What labels are shown; says so where there are none."""
        view = self.state.labels
        if view is None:
            self.ctx.note("not done: show the labels first")
        return view

    @command("px-tool")
    def choose(self, tool: str) -> None:
        """Take a tool; where nothing is open yet, begin on the selected object."""
        view = self._labels()
        if view is None or tool not in TOOLS:
            return
        self._tool = tool
        self._tell("")
        if self._draft is None:
            self._begin(view, self._selected(), resume=True)
        self.follow()

    @command("px-new")
    def new(self, where: str) -> None:
        """Begin a new object: drawn, by clicks in the scene ("scene"), or in a rectangle of the picture (fractions)."""
        view = self._labels()
        if view is None:
            return
        draft = self._drafts.get(self._key)
        if draft is not None and draft.changed:
            self._open = self._key
            self._say("apply or cancel this one first", True)
            return
        self._tool, self._view = ("depth", "scene") if where == "scene" else ("rectangle", "picture")
        self._tell("")
        self._begin(view, None)
        if where not in ("", "scene"):
            corners = where.split(",")
            self._changed(lambda d, c: with_gesture(d, _rectangle(corners, d), c))
        self.follow()

    def _begin(self, view: LabelView, number: int | None, resume: bool = False) -> None:
        known = self._drafts.get(self._key)
        self._open, self._of, self._adds = self._key, self._selected(), True
        if resume and known is not None and known.changed:
            self._tell("this was not applied yet")
            return
        self._drafts[self._key] = new_draft(view.frame, number)
        if number is None and self._tool == "cut":
            self._tool = "brush"

    @command("px-select")
    def select(self, fractions: str) -> None:
        """Draw on the object at a place of the picture."""
        draft = self._draft
        if draft is not None and draft.changed:
            self._say("apply or cancel this one first", True)
            return
        self._selection.select_at(fractions)

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
    def drawn(self, said: str) -> None:
        """A movement of the hand: "7:{...}"; 7 is told back, so that the page knows what is done."""
        number, _, text = said.partition(":")
        if number.isascii() and number.isdigit() and len(number) < 10:
            self._seen = int(number)

        def gesture(draft: Draft) -> Gesture:
            if len(text) > LONGEST:
                raise InputError("the movement is too long", got=f"{len(text)} characters")
            try:
                message = json.loads(text)
            except (ValueError, RecursionError) as error:
                raise InputError("not a movement of a tool", got=repr(text)[:60]) from error
            return read_gesture(message, draft.height, draft.width)

        self._changed(lambda draft, canvas: with_gesture(draft, gesture(draft), canvas))

    @command("px-hand")
    def hand(self, said: str) -> None:
        """How clicks in the scene count: "true:0.015", adding or removing, and how alike a surface must be."""
        adds, _, tolerance = said.partition(":")
        try:
            self._tolerance = float(tolerance)
        except ValueError:
            return
        self._adds = adds == "true"

    def on_ray(self, pixel: tuple[int, int] | None) -> bool:
        """A click in the scene; whether it was meant for the draft."""
        if self._draft is None or self._view != "scene":
            return False
        if pixel is None:
            self._say("no point of the cloud is there", True)
            return True
        at = [[pixel[0] + 0.5, pixel[1] + 0.5]]

        def grown(draft: Draft, canvas: Canvas) -> Draft:
            made = gesture_of("depth", at, draft.height, draft.width, adds=self._adds, tolerance=self._tolerance)
            return with_gesture(draft, made, canvas)

        self._changed(grown)
        return True

    def _changed(self, change: Callable[[Draft, Canvas], Draft]) -> None:
        draft = self._draft
        if draft is None:
            return
        try:
            self._drafts[self._key] = change(draft, self._canvas_now())
            self._tell("")
        except InputError as error:
            self._tell(str(error), True)
        self.follow()

    def _canvas_now(self) -> Canvas:
        if self._canvas is None or self._canvas[0] != self._key:
            desk = self._correct.desk
            if desk is None or desk.corrector.relifter is None:
                raise InputError("the pictures are not at hand")
            self._canvas = self._key, Canvas(desk.corrector.relifter.context(self.state.frame_id))
        return self._canvas[1]

    @command("px-undo=undo", "px-redo=redo")
    def _stepped(self, which: str) -> None:
        draft = self._draft
        if draft is None:
            return
        moved = draft.back() if which == "undo" else draft.forth()
        self._tell("")
        if moved.at != draft.at:
            self._drafts[self._key] = moved
            self.follow()
        else:
            self._correct.taken_back(which)
            view = self.state.labels
            if view is not None:
                self._tell(view.said, view.bad)
            self.follow()

    # ---- saving -----------------------------------------------------------------------

    @command("px-apply")
    def apply(self, said: str) -> None:
        """Save the draft as one action: {"stay", "label"}; with "stay" the editor remains open."""
        view, draft = self._labels(), self._draft
        if view is None or draft is None:
            return
        try:
            message = json.loads(said)
            stay, label = bool(message["stay"]), str(message["label"])
        except (ValueError, TypeError, KeyError, RecursionError):
            stay, label = False, ""
        try:
            made = edits_of_draft(draft, view.frame, label)
        except InputError as error:
            self._drafts[self._key] = rebased(draft, view.frame)
            self._say(str(error), True)
            return
        self._label, self._saving = label, True
        if not stay:
            # Closed at once: drawing the whole page takes longer than saving.
            self.ctx.page.call("pixels", {"on": False})
        try:
            outcome = self._correct.save(lambda _: made)
        finally:
            self._saving = False
        after = self.state.labels
        if isinstance(outcome, Conflict):
            self._disputed = self._key, outcome
        if outcome is None or isinstance(outcome, Conflict) or after is None:
            self._say("not saved" if after is None else after.said, True)
            return
        number, self._label, self._disputed = made[0].ref.numbers[0], "", None
        self._drafts.pop(self._key, None)
        state = self.state
        self.state = replace(state, selected=after.place(number))
        self._tell(after.said, after.bad)
        if stay:
            self._begin(after, None if draft.number is None else number)
        else:
            self._open = None
        self.ctx.draw()

    def _decided(self, events: tuple[Event, ...]) -> None:
        """Drop the draft that was in dispute, once it was saved after all."""
        if self._saving or self._disputed is None or self._disputed[0] != self._key:
            return
        wanted = self._disputed[1].edits
        if any(e.ref == edit.ref and same_value(e.after, edit.after) for e in events for edit in wanted):
            self._disputed = None
            self.close()

    @command("px-merge")
    def merge(self) -> None:
        """Make the selected object a part of the one that was selected before it."""
        view = self._labels()
        if view is None:
            return
        pair = self.state.pair
        if pair is None or pair[0] == pair[1]:
            self.ctx.page.toast("Not done", "Select two objects, one after the other.")
            return
        numbers = view.numbers[pair[1]], view.numbers[pair[0]]
        if self._correct.save(lambda frame: merge_objects(frame, numbers)) is None:
            return
        after = self.state.labels
        if after is not None:
            self.ctx.show(selected=after.place(numbers[0]))

    # ---- what is shown ----------------------------------------------------------------

    @command("px-view")
    def look(self, view: str) -> None:
        """Draw on the "picture", or by clicks in the "scene"."""
        if view in ("picture", "scene"):
            self._view = view
            self._say("")

    @command("px-picture")
    def paint(self, kind: str) -> None:
        """Show the picture's "rgb" or its "depth"."""
        if kind in ("rgb", "depth"):
            self._kind = kind
            self.follow()

    def _say(self, said: str, bad: bool = False) -> None:
        self._tell(said, bad)
        self.follow()

    def _tell(self, said: str, bad: bool = False) -> None:
        self._said, self._bad = said, bad

    def follow(self) -> None:
        """Bring the editor up to the state and the draft."""
        if self._saving:
            return
        state = self.state
        view = state.labels
        if self._open is not None and (view is None or self._open != self._key):
            self._open = None
        draft = self._draft
        if draft is None or view is None or state.loaded is None:
            self._scene.clear()
            self.ctx.page.call("pixels", {"on": False})
            return
        selected = self._selected()
        if draft.number is not None and draft.number not in view.frame.objects:
            self._drafts.pop(self._key)
            self.ctx.note(f"object {draft.number} stands no longer: what was drawn for it is dropped")
            self._open = None
            self.follow()
            return
        moved = selected is not None and selected != self._of
        if not draft.changed and (moved or rebased(draft, view.frame) != draft):
            # A click in the picture brings another object; the view stays where the hand is.
            self._begin(view, selected if moved else draft.number)
            draft = self._drafts[self._key]
        self._show(draft, view, state)

    def _show(self, draft: Draft, view: LabelView, state: State) -> None:
        canvas = self._canvas_now()
        parts = draft.parts
        lifted = lifted_draft(canvas, parts[0]) if len(parts) == 1 else None
        box = None if lifted is None else lifted.box
        frame = canvas.context.frame
        if self._view == "scene":
            self._scene.draw(frame, draft.mask, box, state.dark)
        else:
            self._scene.clear()
            picture = frame.rgb if self._kind == "rgb" else depth_colors(frame.depth)
            self.ctx.page.call("pixelsPicture", {"kind": self._kind, "url": jpeg_url(picture, 92)})
        fresh = draft.number is None
        row = None if draft.number is None else view.frame.objects[draft.number]
        data: dict[str, Any] = {
            "on": True,
            "near": around(draft),
            "key": f"{draft.frame}:{draft.number}:{draft.version}",
            "view": self._view,
            "tool": self._tool,
            "w": draft.width,
            "h": draft.height,
            "title": "new object" if row is None else f"{row['label']}·{draft.number}",
            "fresh": fresh,
            "label": self._label,
            "cuttable": not fresh,
            "names": list(view.frame.setting.class_names) if fresh else None,
            "color": hex_color(PART_COLORS[0]),
            "mask": mask_url(parts),
            "others": outlines(state.shown.objects, state.shown.names, draft.number),
            "edges": [] if box is None else (box_edges_2d(box, frame.camera) + 0.5).reshape(-1, 4).round(1).tolist(),
            "steps": draft.at if draft.changed else 0,
            "back": draft.at > 0,
            "forth": draft.at < len(draft.steps) - 1,
            "parts": len(parts),
            "seen": self._seen,
            "said": self._said,
            "bad": self._bad,
            "info": told_of(draft, lifted, parts),
        }
        self.ctx.page.call("pixels", data)


def _rectangle(corners: list[str], draft: Draft) -> Gesture:
    try:
        x0, y0, x1, y1 = (float(c) for c in corners)
    except ValueError as error:
        raise InputError("not a rectangle", got=",".join(corners)[:60]) from error
    return gesture_of("surface", [[x0, y0], [x1, y1]], draft.height, draft.width, fractions=True)
