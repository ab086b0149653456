"""What-if edits of a client's question: answered at interactive speed, with boxes and handles in the scene."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from threading import Lock, Thread
from time import perf_counter
from typing import Any

import numpy as np
import viser.transforms as vtf

from pipeline.answering.ask import Trace
from pipeline.answering.ranking import RankConfig
from pipeline.diagnosis.answer import Judged
from pipeline.diagnosis.verdict import Diagnosis
from pipeline.diagnosis.whatif import Baseline, Edits, Outcome, rerun
from pipeline.diagnosis.whatif.answer_view import BothAnswers
from pipeline.diagnosis.whatif.changes import each_edit, without_edit
from pipeline.diagnosis.whatif.edit_words import edit_from_words
from pipeline.diagnosis.whatif.placement import pulled
from pipeline.diagnosis.whatif.region import RegionPart, asked_pair
from pipeline.diagnosis.whatif.try_mend import mend_edits
from pipeline.evaluation.mend_counts import count_mends, mend_setting
from pipeline.geometry.boxes import Box3D, edge_lines
from pipeline.geometry.palette import RGB, palette
from pipeline.language.counted import counted
from pipeline.relations.relations import letter
from pipeline.system.errors import InputError
from spatialviz.app.context import Context, Part, choice, command
from spatialviz.app.edit_panel import cost_html, edit_html
from spatialviz.app.scene_client import Retained, triple
from spatialviz.app.state import EditMode, State

REGION_COLORS: dict[str, RGB] = {"T": (38, 166, 154), "U": (224, 152, 46)}
FAILS: RGB = (229, 72, 77)
OPACITY = {"T": 0.30, "U": 0.16}
OUTLINE_GROWTH = 0.006


MODES: tuple[EditMode, ...] = ("off", "move", "turn", "resize")
Face = tuple[int, int]
"""Axis and side, -1 or 1."""
FACES: tuple[Face, ...] = tuple((axis, side) for axis in range(3) for side in (-1, 1))


class BoxGizmo:
    """Box handles of a client: a transform control for move and turn, and a handle on each face for resize."""

    def __init__(self, ctx: Context, dragged: Callable[[Box3D, bool], None]) -> None:
        # `dragged` gets the latest box (camera frame), and True on release, on the page's own thread.
        self._ctx, self._dragged = ctx, dragged
        self._latest: tuple[Box3D, bool] | None = None
        self._lock = Lock()
        self._box: Box3D | None = None
        self._held: tuple[Retained, Box3D, np.ndarray] | None = None
        """Held handle, with box and rotation at the grab."""
        self._pulled = False
        self._mode: EditMode = "off"

    def show(self, box: Box3D | None, mode: EditMode) -> None:
        """Show the handles of a mode around a box, or none without a box; a held handle stays in place."""
        self._box, self._mode = (box, mode) if box is not None and mode != "off" else (None, "off")
        client, held = self._ctx.client, "" if self._held is None else self._held[0].name
        with client.atomic():
            for face in (None, *FACES):
                name = f"/edit/{'gizmo' if face is None else f'face-{face[0]}{face[1]:+}'}"
                wanted = self._box is not None and (face is None) == (self._mode != "resize")
                client.change(name, visible=wanted)
                if wanted and self._box is not None and name != held:
                    self._place(name, face, self._box)

    def _place(self, name: str, face: Face | None, box: Box3D) -> None:
        span, turning = float(box.size.max()), self._mode == "turn"
        if face is None:
            at, yaw = box.center, float(np.arctan2(box.R[1, 0], box.R[0, 0]))
            turn = vtf.SO3.from_z_radians(yaw if turning else 0.0)
            look = {
                "line_width": 3.0,
                "active_axes": (True, True, not turning),
                "disable_axes": turning,
                "disable_sliders": turning,
                "disable_rotations": not turning,
                "scale": float(np.clip(span, 0.18, 0.6)),
            }
        else:
            axis, side = face
            normal, along = box.R[:, axis] * side, box.R[:, (axis + 1) % 3]
            at = box.center + normal * box.size[axis] / 2
            turn = vtf.SO3.from_matrix(np.stack([normal, along, np.cross(normal, along)], axis=1))
            look = {
                "line_width": 4.0,
                "active_axes": (True, False, False),
                "disable_sliders": True,
                "disable_rotations": True,
                "scale": float(np.clip(0.5 * span, 0.07, 0.24)),
            }
        is_new = name not in self._ctx.client.nodes
        handle = self._ctx.client.put(
            "transform_controls", name, position=triple(at), wxyz=turn.wxyz, depth_test=False, visible=True, **look
        )
        if is_new:
            self._listen(handle, face)

    def _listen(self, handle: Retained, face: Face | None) -> None:
        @handle.on_update
        async def _(event: Any) -> None:
            if event.phase == "start" and self._box is not None:
                self._held = handle, self._box, _matrix(handle)
            if self._held is None or self._held[0] is not handle:
                return
            self._pulled |= event.phase == "update"
            box, ended, pulled = self._moved(face, *self._held), event.phase == "end", self._pulled
            if ended:
                self._held, self._pulled = None, False
            if pulled:
                with self._lock:
                    before, self._latest = self._latest, (box, ended or (self._latest or (box, False))[1])
                if before is None:
                    self._ctx.post(self._follow)

    def _follow(self) -> None:
        with self._lock:
            latest, self._latest = self._latest, None
        if latest is not None:
            self._dragged(self._ctx.scene.camera_box(latest[0]), latest[1])

    def _moved(self, face: Face | None, handle: Retained, box: Box3D, was: np.ndarray) -> Box3D:
        """Box at the grab of the handle, moved by the drag since."""
        if face is None and self._mode == "turn":
            return replace(box, R=vtf.SO3.from_matrix(_matrix(handle) @ was.T).as_matrix() @ box.R)
        if face is None:
            return replace(box, center=np.array(handle.position, np.float64))
        axis, side = face
        reach = float((np.array(handle.position) - box.center) @ box.R[:, axis]) * side
        return pulled(box, axis, side, reach - float(box.size[axis]) / 2)


def _matrix(handle: Retained) -> np.ndarray:
    return vtf.SO3(np.array(handle.wxyz)).as_matrix()


UNDOS = 200
COUNTING_SECONDS = 20.0
"""Time in which a run is answered again."""
Judge = Callable[[Trace, RankConfig | None], Judged]


class WhatIf(Part):
    """Edits a client's question."""

    def __init__(self, ctx: Context, judge: Judge) -> None:
        super().__init__(ctx)
        self._judge = judge
        self._baseline: Baseline | None = None
        self._judged: Judged = None
        self._of: tuple[str, ...] | None = None
        self._undo: list[Edits] = []
        self._live_since: Edits | None = None
        self._held: str | None = None
        self._gizmo = BoxGizmo(ctx, self._dragged)

    # ---- questions ------------------------------------------------------------------

    def check(self) -> None:
        """Drop edits of a former question."""
        asked = self._asked()
        if self._of is None or asked == self._of:
            return
        if self.state.edits:
            count = len(each_edit(self.state.edits))
            self.ctx.note(f"{counted(count, 'edit')} dropped: of “{self._of[2]}” in frame {self._of[1]}")
        self.state = replace(self.state, edits=Edits(), edited=None, tried=None, tried_value=None, mended=None)
        self._undo, self._of, self._baseline, self._live_since = [], None, None, None

    def answered(self) -> None:
        """Edit a new answer again if to the edited question."""
        self.check()
        if self.state.edits:
            self._judged = self.state.judged
            self._apply(self.state.edits)

    def _asked(self) -> tuple[str, ...] | None:
        state = self.state
        return None if state.trace is None else (state.source, state.frame_id, state.trace.query.text, state.side)

    def _base(self) -> Baseline:
        """Question without edits, read once."""
        state, asked = self.state, self._asked()
        if asked is None or state.loaded is None:
            raise InputError("nothing is asked: edits are of a question")
        if self._baseline is None or self._of != asked:
            source = self.ctx.answering
            self._baseline, self._of = Baseline(source, state.loaded.context.under(source.config.lift), asked[2]), asked
            # The shown answer is still without edits.
            self._judged = state.judged
        return self._baseline

    # ---- edits ----------------------------------------------------------------------

    @command("edit", "edit-live")
    def _edit(self, said: str, by: str) -> None:
        """Apply an edit such as "size:1:0.2"; live edits of a drag form a single step."""
        live = by == "edit-live"
        self._try(lambda: edit_from_words(said, self.state, self.ctx.answering, self.keys(self._base())), live)

    def _try(self, change: Callable[[], Edits], live: bool = False) -> None:
        try:
            edits = change()
            before = self.state.edits if self._live_since is None else self._live_since
            self._live_since = before if live else None
            if not live and edits != before:
                self._undo = [*self._undo, before][-UNDOS:]
            self._apply(edits)
        except InputError as error:
            self._live_since = None
            self.ctx.toast("Not edited", str(error), bad=True)
        self.ctx.draw(live)

    # ---- the mend of a story --------------------------------------------------------

    @command("try-mend")
    def _try_mend(self) -> None:
        """Answer under the change that the story names; a second press takes it back."""
        if self.state.tried is not None and self.state.edits == self.state.tried:
            self.state = replace(self.state, tried=None, tried_value=None)
            self._try(Edits)
        else:
            self._mend(None, "mend-value")
            self._count()

    @command("mend-value", "mend-live")
    def _mend(self, value: float | None, by: str) -> None:
        """Apply the change with another number, live while a slider is dragged."""
        self._base()
        judged, change = self._judged, None if not isinstance(self._judged, Diagnosis) else self._judged.story.change
        if change is None or not isinstance(judged, Diagnosis):
            raise InputError("no change is known to mend this answer")
        truth = judged.truth

        def tried() -> Edits:
            edits = mend_edits(self._base(), change, truth, value)
            self.state = replace(self.state, tried=edits, tried_value=value)
            return edits

        self._try(tried, live=by == "mend-live")

    def _count(self) -> None:
        """Count what a setting of this kind does to the run, beside the page."""
        run, judged, asked = self.ctx.answering_run, self._judged, self._asked()
        setting = None if run is None or not isinstance(judged, Diagnosis) else mend_setting(run, judged)
        if run is None or setting is None or not isinstance(judged, Diagnosis) or self.state.mended is not None:
            return
        expression = judged.truth.frame, judged.case.id

        def count() -> None:
            try:
                found = count_mends(run, setting, expression, COUNTING_SECONDS)
            except InputError as error:
                told = str(error)
                self.ctx.post(lambda: self.ctx.note(told))
                return
            self.ctx.post(lambda: self.ctx.show(mended=found) if asked == self._asked() else None)

        self.ctx.show(mended=setting)
        Thread(target=count, daemon=True, name="mends").start()

    @command("edit-remove")
    def _remove(self, id: str) -> None:
        self._try(lambda: without_edit(self.state.edits, id))

    @command("edit-undo")
    def _undo_last(self) -> None:
        if self._undo:
            edits, self._undo = self._undo[-1], self._undo[:-1]
            self._apply(edits)
            self.ctx.draw()

    @command("edit-reset")
    def _reset(self) -> None:
        if self.state.edits:
            self._try(Edits)

    def _apply(self, edits: Edits) -> None:
        """Answer again, and take the answer into the state."""
        baseline = self._base()
        start = perf_counter()
        outcome = rerun(baseline, edits)
        seconds = perf_counter() - start
        rank = replace(baseline.source.config.rank, **edits.rank) if edits.rank else None
        judged = self._judge(outcome.trace, rank) if edits else self._judged
        edited = BothAnswers(baseline.outcome, outcome, self._judged, seconds)
        self.state = self.state.under(edits, edited, judged, self.keys(baseline))

    def keys(self, baseline: Baseline) -> tuple[str, ...]:
        """Keys of the shown answer's objects."""
        edited = self.state.edited
        return baseline.outcome.keys if edited is None else edited.after.keys

    # ---- dragging -------------------------------------------------------------------

    def _dragged(self, box: Box3D, ended: bool) -> None:
        key = self._held
        if key is not None and self.state.loaded is not None:
            self._try(lambda: self.state.edits.with_box(key, box), live=not ended)

    @command("edit-mode")
    def _set_mode(self, mode: str) -> None:
        state, chosen = self.state, choice(MODES, self.state.mode, mode)
        if chosen is not None and chosen != state.mode and state.labels is None:
            if chosen != "off":
                self.ctx.page.call("tab", "Edit")
            selected = state.pair[0] if state.selected is None and state.pair is not None else state.selected
            self.ctx.show(mode=chosen, selected=selected)

    # ---- drawing --------------------------------------------------------------------

    def _selected_key(self) -> str | None:
        """Key of the selected object; None if not a candidate."""
        i = self.state.selected
        if i is None or i not in self.state.shown.place.values():
            return None
        return self.state.key_at(i, self.keys(self._base()))

    def _draw_scene(self, state: State) -> None:
        """Draw edited boxes and the asked region."""
        with self.ctx.client.atomic():
            self._draw_boxes(state)
            self._draw_region(state)

    def _draw_boxes(self, state: State) -> None:
        """Edited objects in the edited colour, with thin former boxes."""
        edited, edits, color = state.edited, state.edits, palette(state.dark)["edited"]
        now: list[Box3D] = []
        were: list[Box3D] = []
        if edited is not None:
            touched = {*edits.boxes, *edits.masks, *(key for _, key in edits.confidences)}
            now = self._boxes(edited.after, touched)
            were = self._boxes(edited.before, {*edits.boxes, *edits.masks, *edits.hidden})
        self.ctx.client.lines("/edit/now", edge_lines(now, OUTLINE_GROWTH), color, 2.6)
        self.ctx.client.lines("/edit/before", edge_lines(were), color, 1.0)

    def _boxes(self, outcome: Outcome, keys: set[str]) -> list[Box3D]:
        """3D boxes of objects in an answer, in the shown frame."""
        boxes = (o.lifted.box for key, o in zip(outcome.keys, outcome.trace.objects, strict=True) if key in keys)
        return [self.ctx.scene.shown_box(box) for box in boxes if box is not None]

    def _draw_region(self, state: State) -> None:
        trace = state.trace if state.flags.region else None
        asked = None if trace is None else asked_pair(trace, state.chosen, state.edits)
        marks = None if asked is None else (state.source, state.frame_id, state.dark, *asked.region_key)
        client = self.ctx.client
        if client.outdated("/region/", marks) and asked is not None:
            for part in asked.region:
                self._add_part(part)
        if asked is None or not np.isfinite(asked.middle).all():
            client.change("/region/target", visible=False)
            return
        middle = self.ctx.scene.to_show @ asked.middle
        color = {**REGION_COLORS, "F": FAILS}[letter(asked.placement.state)]
        look = {"radius": 0.014, "cast_shadow": False, "visible": True}
        client.put("icosphere", "/region/target", position=triple(middle), color=color, **look)

    def _add_part(self, part: RegionPart) -> None:
        client, R, color = self.ctx.client, self.ctx.scene.to_show.T, REGION_COLORS[part.label]
        corners = (part.triangles @ R).reshape(-1, 3).astype(np.float32)
        client.put(
            "mesh_simple",
            f"/region/{part.label}",
            vertices=corners,
            faces=np.arange(len(corners)).reshape(-1, 3),
            color=color,
            opacity=OPACITY[part.label],
            side="double",
            cast_shadow=False,
            receive_shadow=False,
        )
        client.lines(f"/region/{part.label}-rim", (part.lines @ R).astype(np.float32), color, 1.6)

    def follow(self, live: bool = False) -> None:
        """Draw handles, edits and the Edit tab for the state."""
        state, selected = self.state, self.state.selected
        if state.labels is not None:
            self._gizmo.show(None, "off")
            self.ctx.page.show("cost")
            return
        candidate = selected is not None and selected in state.shown.place.values()
        box = None
        if selected is not None and candidate and state.mode != "off":
            box, self._held = state.shown.objects[selected].lifted.box, self._selected_key()
        self._gizmo.show(None if box is None else self.ctx.scene.shown_box(box), state.mode)
        self._draw_scene(state)
        # Without objects there is nothing to edit.
        shown = state.drawer == "Edit" and bool(state.shown.objects)
        self.ctx.page.show("cost", cost_html(state, len(self._undo)) if shown else None)
        if not live:
            if not shown:
                self.ctx.page.show("edit")
                return
            hidden = selected is not None and f"#{state.shown.objects[selected].id}" in state.edits.hidden
            trace, editable = state.trace, candidate or hidden
            self.ctx.page.show("edit", None if trace is None else edit_html(state, trace, self.ctx.answering, editable))
