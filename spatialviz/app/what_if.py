"""What if: edits of one client's question, answered by the core as fast as the mouse moves."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from threading import Lock
from time import perf_counter

import numpy as np

from pipeline.answering.ask import Trace
from pipeline.answering.opening import Pipeline
from pipeline.answering.ranking import RankConfig
from pipeline.diagnosis.verdict import Diagnosis
from pipeline.diagnosis.whatif import Baseline, Edits, Outcome, rerun
from pipeline.diagnosis.whatif.changes import each_edit, without_edit
from pipeline.diagnosis.whatif.decision_map import DecisionMap, decision_map
from pipeline.geometry.boxes import Box3D
from pipeline.language.counted import counted
from pipeline.system.errors import InputError
from spatialviz.app.edit_messages import edited_by
from spatialviz.app.edit_panel import cost_html, edit_html
from spatialviz.app.edit_scene import EditScene
from spatialviz.app.edited import Edited
from spatialviz.app.gizmo import MODES, BoxGizmo
from spatialviz.app.layout import Page
from spatialviz.app.legend import map_legend
from spatialviz.app.scene import SceneView
from spatialviz.app.scene_client import SceneClient
from spatialviz.app.state import Shown, State, shown_objects

UNDOS = 200
Judge = Callable[[Trace, RankConfig | None], Diagnosis | str | None]


class WhatIf:
    """Edits what a client has asked.

    Parameters
    ----------
    client : SceneClient
    page : Page
    scene : SceneView
    source : callable
        Gives the source that is looked at.
    state : callable
        Gives the client's state.
    take : callable
        Takes a new one.
    draw : callable
        Draws all of the page; with True what follows a drag.
    judge : callable
        The verdict on a trace, and the weights it was ranked with where they are not the source's.
    note : callable
        Writes a line of the log.
    post : callable
        Runs something later, on the client's own thread.
    """

    def __init__(
        self,
        client: SceneClient,
        page: Page,
        scene: SceneView,
        source: Callable[[], Pipeline],
        state: Callable[[], State],
        take: Callable[[State], None],
        draw: Callable[[bool], None],
        judge: Judge,
        note: Callable[[str], None],
        post: Callable[[Callable[[], None]], None],
    ) -> None:
        self._page, self._scene, self._source = page, scene, source
        self._state, self._take, self._draw, self._judge = state, take, draw, judge
        self._note, self._post = note, post
        self._baseline: Baseline | None = None
        self._judged: Diagnosis | str | None = None
        self._of: tuple[str, str, str] | None = None
        self._undo: list[Edits] = []
        self._live_since: Edits | None = None
        self._map: DecisionMap | None = None
        self._held: str | None = None
        self._drag: tuple[Box3D, bool] | None = None
        self._lock = Lock()
        self._gizmo = BoxGizmo(client, self._dragged)
        self._shown = EditScene(client, scene)

    def commands(self) -> dict[str, Callable[[str], None]]:
        """What the page may ask for, by the first word of its message."""
        return {
            "edit": lambda said: self._edit(said, live=False),
            "edit-live": lambda said: self._edit(said, live=True),
            "edit-mode": self._set_mode,
            "edit-remove": self._remove,
            "edit-undo": lambda _: self._undo_last(),
            "edit-reset": lambda _: self._reset(),
            "edit-map": lambda _: self._toggle_map(),
        }

    # ---- questions ------------------------------------------------------------------

    def check(self) -> None:
        """Drop edits of a question that is asked no longer, and a map that is not of this one."""
        asked = self._asked()
        if self._of is None or asked == self._of:
            return
        state = self._state()
        if state.edits:
            count = len(each_edit(state.edits))
            self._note(f"{counted(count, 'edit')} dropped: of “{self._of[2]}” in frame {self._of[1]}")
        self._take(replace(state, edits=Edits(), edited=None))
        self._undo, self._of, self._baseline, self._map, self._live_since = [], None, None, None, None

    def answered(self) -> None:
        """An answer has come in: where it is to the question that was edited, edit it again."""
        self.check()
        if self._state().edits:
            self._judged = self._state().judged
            self._apply(self._state().edits)

    def _asked(self) -> tuple[str, str, str] | None:
        state = self._state()
        return None if state.trace is None else (state.source, state.frame_id, state.trace.query.text)

    def _base(self) -> Baseline:
        """The question without edits, read once."""
        state, asked = self._state(), self._asked()
        if asked is None or state.loaded is None:
            raise InputError("nothing is asked: edits are of a question")
        if self._baseline is None or self._of != asked:
            self._baseline, self._of = Baseline(self._source(), state.loaded.context, asked[2]), asked
            # Nothing of this question is edited yet: what is shown is the answer without edits.
            self._judged = state.judged
        return self._baseline

    # ---- edits ----------------------------------------------------------------------

    def _edit(self, said: str, live: bool) -> None:
        """Carry out an edit such as "size:1:0.2"; a live one is followed by others of the same hand."""

        def change() -> Edits:
            baseline, state = self._base(), self._state()
            return edited_by(said, state, self._source(), self.keys(baseline))

        self._try(change, live)

    def _try(self, change: Callable[[], Edits], live: bool = False) -> None:
        try:
            edits = change()
            before = self._state().edits if self._live_since is None else self._live_since
            self._live_since = before if live else None
            if not live and edits != before:
                self._undo = [*self._undo, before][-UNDOS:]
            self._apply(edits)
        except InputError as error:
            self._live_since = None
            self._note(f"not edited: {error}")
            self._page.toast("Not edited", str(error))
        self._draw(live)

    def _remove(self, id: str) -> None:
        self._try(lambda: without_edit(self._state().edits, id))

    def _undo_last(self) -> None:
        if self._undo:
            edits, self._undo = self._undo[-1], self._undo[:-1]
            self._apply(edits)
            self._draw(False)

    def _reset(self) -> None:
        if self._state().edits:
            self._try(Edits)

    def _apply(self, edits: Edits) -> None:
        """Answer again, and take the answer into the state."""
        baseline, state = self._base(), self._state()
        start = perf_counter()
        outcome = rerun(baseline, edits)
        seconds = perf_counter() - start
        rank = replace(baseline.source.config.rank, **edits.rank) if edits.rank else None
        judged = self._judge(outcome.trace, rank) if edits else self._judged
        edited = Edited(baseline.outcome, outcome, self._judged, seconds)
        self._take(_taken(state, edits, edited, judged, self.keys(baseline)))

    def keys(self, baseline: Baseline) -> tuple[str, ...]:
        """Keys of the objects of the answer that is shown."""
        edited = self._state().edited
        return baseline.outcome.keys if edited is None else edited.after.keys

    # ---- dragging -------------------------------------------------------------------

    def _dragged(self, box: Box3D, ended: bool) -> None:
        """A handle has moved. Only the latest place counts where the session is still busy with one before."""
        with self._lock:
            waiting, self._drag = self._drag is not None, (box, ended)
        if not waiting:
            self._post(self._follow_drag)

    def _follow_drag(self) -> None:
        with self._lock:
            drag, self._drag = self._drag, None
        key = self._held
        if drag is None or key is None or self._state().loaded is None:
            return
        box, ended = drag
        self._try(lambda: self._state().edits.with_box(key, self._scene.camera_box(box)), live=not ended)

    def _set_mode(self, mode: str) -> None:
        modes = dict(zip(MODES, MODES, strict=True))
        state = self._state()
        if mode == "next":
            mode = MODES[(MODES.index(state.mode) + 1) % len(MODES)]
        if mode not in modes:
            return
        selected = state.selected
        if selected is None and state.pair is not None:
            selected = state.pair[0]
        self._take(replace(state, mode=modes[mode], selected=selected))
        self._draw(False)

    # ---- map ------------------------------------------------------------------------

    def _toggle_map(self) -> None:
        if self._map is not None:
            self._map = None
            self._draw(False)
            return
        try:
            key = self._selected_key()
            if key is None:
                raise InputError("no candidate of the question is selected")
            self._map = decision_map(self._base(), self._state().edits, key)
            self._note(f"decision map of {self._state().named(key)}: {self._map.seconds * 1000:.0f} ms")
        except InputError as error:
            self._page.toast("No decision map", str(error))
        self._draw(False)

    def _renewed_map(self) -> None:
        """The map is of the edits; where they have changed it is made anew, or given up."""
        if self._map is None or self._baseline is None:
            return
        try:
            self._map = decision_map(self._baseline, self._state().edits, self._map.key)
        except InputError as error:
            self._map = None
            self._note(f"no decision map: {error}")

    # ---- drawing --------------------------------------------------------------------

    def _selected_key(self) -> str | None:
        """The key of the selected object, where it is a candidate."""
        state = self._state()
        if state.selected is None or state.selected not in state.shown.place.values():
            return None
        entry = state.shown.objects[state.selected]
        return f"#{entry.id}" if entry.id >= 0 else _key_at(state, state.selected, self.keys(self._base()))

    def follow(self, live: bool = False) -> None:
        """Bring the handles, what is drawn of the edits, and the Edit tab up to the state."""
        state = self._state()
        if state.labels is not None:
            self._gizmo.show(None, "off")
            return
        selected = state.selected
        candidate = selected is not None and selected in state.shown.place.values()
        box = None
        if selected is not None and candidate and state.mode != "off" and state.loaded is not None:
            box = state.shown.objects[selected].lifted.box
            self._held = self._selected_key()
        self._gizmo.show(None if box is None else self._scene.shown_box(box), state.mode)
        if not live and self._map is not None:
            self._renewed_map()
        self._shown.draw(state, None if live else self._map, keep_map=live)
        # Where there is no object there is nothing to edit.
        self._page.show("cost", cost_html(state, len(self._undo)) if state.shown.objects else None)
        if not live:
            hidden = selected is not None and f"#{state.shown.objects[selected].id}" in state.edits.hidden
            self._page.show("map-legend", map_legend(state, self._map))
            self._page.show("edit", edit_html(state, self._source(), candidate or hidden, self._map))


def _taken(state: State, edits: Edits, edited: Edited, judged: Diagnosis | str | None, keys: tuple[str, ...]) -> State:
    """The state with an answer under edits.

    What was selected stays so. The chosen pair stays, too, unless it was the answer: then it is the new one.
    """
    assert state.loaded is not None
    outcome = edited.after
    trace = outcome.trace
    chosen = state.chosen
    first = chosen is None or chosen is state.ranked[0]
    named = (
        None
        if chosen is None
        else tuple(keys[i] for i in (chosen.target, chosen.reference, chosen.second_reference) if i is not None)
    )
    selected = _key_at(state, state.selected, keys)
    changed = replace(
        state,
        trace=trace,
        edits=edits,
        edited=edited if edits else None,
        judged=judged,
        shown=_with_confidences(shown_objects(state.loaded, trace, trace.exact, edited.before.trace), edits, outcome),
        pair=None,
        selected=None,
    )
    at = {key: changed.shown.place[i] for i, key in enumerate(outcome.keys)}
    at |= {f"#{o.id}": i for i, o in enumerate(changed.shown.objects) if o.id >= 0 and f"#{o.id}" not in at}
    pairs = [changed.at(p) for p in changed.ranked]
    kept = None if named is None or any(key not in at for key in named) else tuple(at[key] for key in named)
    pair = kept if kept in pairs and not first else pairs[0] if pairs else None
    return replace(changed, pair=pair, selected=None if selected is None else at.get(selected))


def _with_confidences(shown: Shown, edits: Edits, outcome: Outcome) -> Shown:
    """The objects with the scores that edits give them under the name they go by."""
    objects = list(shown.objects)
    for (name, key), p in edits.confidences.items():
        candidates = outcome.trace.candidates.get(name)
        if candidates is None or key not in outcome.keys:
            continue
        here = np.flatnonzero(candidates.index == outcome.keys.index(key))
        place = shown.place[outcome.keys.index(key)]
        if len(here) and candidates.labels[here[0]] == objects[place].label:
            objects[place] = replace(objects[place], score=p)
    return replace(shown, objects=tuple(objects))


def _key_at(state: State, i: int | None, keys: tuple[str, ...]) -> str | None:
    """The key of an object that is shown."""
    if i is None:
        return None
    entry = state.shown.objects[i]
    if entry.id >= 0:
        return f"#{entry.id}"
    return next((keys[t] for t, s in state.shown.place.items() if s == i), None)
