"""A client's view as a string and back: what is named by objects survives another page."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from dataclasses import asdict, fields, replace
from pathlib import Path
from typing import Any

import numpy as np

from pipeline.answering.objects import SceneObject
from pipeline.answering.opening import Pipeline
from pipeline.diagnosis.whatif import Edits
from pipeline.diagnosis.whatif.pair_tables import detection_keys
from pipeline.diagnosis.whatif.state import CameraView, Toggle, ViewState, decode, encode
from pipeline.evaluation.run_folder import Run
from pipeline.system.errors import InputError
from spatialviz.app.layout import Dialog
from spatialviz.app.markup import h
from spatialviz.app.place import Place
from spatialviz.app.run_panel import RunPanel
from spatialviz.app.scene import SceneFlags
from spatialviz.app.state import State
from spatialviz.app.toolbar import LARGEST_POINT, LEAST_POINT
from spatialviz.app.viewpoint import Viewpoint


class ViewStrings:
    """Writes the view of one client as a string, and takes one back.

    Parameters
    ----------
    dialog : Dialog
    sources : mapping of str to Source
    runs : mapping of str to Run
        By name of the source.
    panel : RunPanel
    viewpoint : Viewpoint
    state : callable
        Gives the client's state.
    take : callable
        Takes a new one.
    go : callable
        Looks at a place.
    ask : callable
        Asks an expression again.
    show_context : callable
        Brings the room around the frame up to the state.
    draw : callable
    note : callable
        Writes a line of the log.
    """

    def __init__(
        self,
        dialog: Dialog,
        sources: Mapping[str, Pipeline],
        runs: Mapping[str, Run],
        panel: RunPanel,
        viewpoint: Viewpoint,
        *,
        state: Callable[[], State],
        take: Callable[[State], None],
        go: Callable[[Place], None],
        ask: Callable[[str], None],
        show_context: Callable[[], None],
        draw: Callable[[], None],
        note: Callable[[str], None],
    ) -> None:
        self._dialog, self._sources, self._runs = dialog, sources, runs
        self._panel, self._viewpoint = panel, viewpoint
        self._state, self._take, self._go, self._ask = state, take, go, ask
        self._show_context, self._draw, self._note = show_context, draw, note
        self._waiting: ViewState | None = None

    def commands(self) -> dict[str, Callable[[str], None]]:
        """What the page may ask for, by the first word of its message."""
        return {
            "copy-state": lambda _: self.copy(),
            "paste-state": lambda _: self.paste(),
            "restore": self.restore,
            "restore-with": self._confirm,
        }

    def now(self) -> ViewState:
        """What is looked at."""
        state = self._state()
        run = self._runs.get(state.source)
        return view_of(
            state,
            self._sources[state.source],
            self._viewpoint.turned_to(),
            None if run is None else str(run.folder.resolve()),
            self._panel.expression(state.frame_id, state.text),
        )

    def copy(self) -> None:
        """Put the view into the clipboard, and show it to be copied by hand."""
        try:
            string = encode(self.now())
        except InputError as error:
            self._fail(error)
            return
        hint = (
            "Paste it into the Ask field of a page, or open it with ",
            h.code("spatialviz view --state STRING"),
            ".",
        )
        self._dialog.show(
            "This view as a string",
            (
                h.textarea(string, cls="state", rows=5, readonly=True, spellcheck="false", aria_label="The string"),
                h.div("copying …", cls="copied", role="status"),
                h.div(hint, cls="dim small"),
            ),
            h.button("Copy again", local="copy"),
        )
        self._dialog.copy()
        self._note("view copied as a string")

    def paste(self) -> None:
        """Ask for a string."""
        self._dialog.show(
            "Open a view from its string",
            h.textarea(
                cls="state", rows=5, autofocus=True, spellcheck="false", placeholder="sv1:…", aria_label="The string"
            ),
            h.button("Open", local="send:restore:"),
        )

    def restore(self, string: str) -> None:
        """Show the view of a string; say so where that is not possible."""
        try:
            view = decode(string)
        except InputError as error:
            self._fail(error)
        else:
            self.open(view)

    def open(self, view: ViewState, confirmed: bool = False) -> None:
        """Show a view; say so where that is not possible. A file that it names is loaded only when `confirmed`."""
        try:
            self._show(view, confirmed)
        except InputError as error:
            self._fail(error)

    def _show(self, view: ViewState, confirmed: bool) -> None:
        """Show a view; InputError where it is of a dataset or a frame that is not here."""
        if view.dataset not in self._sources:
            opened = ", ".join(self._sources)
            raise InputError("the view is of a dataset that is not open here", got=view.dataset, expected=opened)
        if view.frame not in self._sources[view.dataset].dataset.frame_ids:
            raise InputError(f"{view.dataset} has no such frame", got=view.frame)
        if view.edits.scorer not in SHIPPED_SCORERS and not confirmed:
            self._waiting = view
            self._dialog.show(
                "This view wants to load a file",
                (
                    h.div("It scores relations with this network. Load only what you trust."),
                    h.pre(view.edits.scorer, cls="file"),
                ),
                h.button("Load it", do="restore-with:file"),
                h.button("Without it", do="restore-with:no"),
            )
            return
        self._dialog.close()
        self._look(view)

    def _confirm(self, answer: str) -> None:
        """What to do with the scorer of the view that waits."""
        view, self._waiting = self._waiting, None
        if view is not None:
            self.open(view if answer == "file" else replace(view, edits=view.edits.with_scorer(None)), confirmed=True)

    def _look(self, view: ViewState) -> None:
        if view.dataset != self._state().source:
            self._go(Place(view.dataset))
        run = self._runs.get(view.dataset)
        if view.run is not None and (run is None or run.folder.resolve().name != Path(view.run).name):
            self._note(f"the view is of the run {view.run}, which is not open here")
        elif view.expression_id is not None:
            self._panel.reveal(view.frame, view.expression_id)
        before = self._state()
        self._take(with_settings(before, view))
        self._go(Place(view.dataset, view.frame, view.expression))
        if self._state().flags.context != before.flags.context:
            self._show_context()
        if view.edits != self._state().edits:
            self._edit(view)
        self._take(with_objects(self._state(), self._sources[view.dataset], view))
        self._draw()
        if self._state().loaded is not None:
            if view.camera is None:
                self._viewpoint.place(self._state().camera)
            else:
                fov = view.toggles.get(FOV)
                self._viewpoint.turn_to(view.camera, float(fov) if isinstance(fov, (int, float)) else None)
        self._note("view opened from its string")

    def _edit(self, view: ViewState) -> None:
        """Ask again with the edits of a view; without any where they cannot be applied."""
        self._take(replace(self._state(), edits=view.edits))
        try:
            self._ask(view.expression)
        except InputError:
            self._take(replace(self._state(), edits=Edits(), edited=None))
            self._ask(view.expression)
            raise

    def _fail(self, error: InputError) -> None:
        self._note(str(error))
        self._dialog.refuse(str(error))


BEGINS = re.compile(r"\s*sv[0-9]{1,6}:")
"""How a state string begins; no expression does."""
CAMERA, FOV, POINTS = "camera view", "field of view", "point size"
"""Names of toggles: from where one looks ("sensor", "orbit", "top"), in radians how wide a turned camera sees, and the
factor by which points are drawn larger."""
SHIPPED_SCORERS = (None, "rule", "trained")


def view_of(
    state: State, source: Pipeline, camera: tuple[CameraView, float] | None, run: str | None, expression: str | None
) -> ViewState:
    """What a client looks at.

    Parameters
    ----------
    state : State
    source : Pipeline
        Of the state.
    camera : (CameraView, float) or None
        Where the camera was turned to, and its field of view; None where it is as it was placed.
    run, expression : str or None
        Folder of the run, and the id of its expression that is asked.
    """
    selected = None if state.selected is None else object_key(state, source, state.selected)
    ends = None if state.pair is None else [object_key(state, source, at) for at in state.pair[:2]]
    toggles: dict[str, Toggle] = {**asdict(state.flags), CAMERA: state.camera}
    if camera is not None:
        toggles[FOV] = round(camera[1], 4)
    if state.point_size != 1:
        toggles[POINTS] = state.point_size
    return ViewState(
        state.source,
        state.frame_id,
        state.text,
        selection=() if selected is None else (selected,),
        pair=None if ends is None or ends[0] is None or ends[1] is None else (ends[0], ends[1]),
        camera=None if camera is None else camera[0],
        toggles=toggles,
        edits=state.edits,
        run=run,
        expression_id=expression,
        colors=state.colors,
    )


def with_settings(state: State, view: ViewState) -> State:
    """The state with a view's paint, toggles and place to look from; what is not known is passed over."""
    known = {f.name for f in fields(SceneFlags)}
    flags = {name: value for name, value in view.toggles.items() if name in known and isinstance(value, bool)}
    changed: dict[str, Any] = {"flags": replace(state.flags, **flags)}
    if view.colors in ("rgb", "objects", "depth", "evidence"):
        changed["colors"] = view.colors
    if view.toggles.get(CAMERA) in ("sensor", "orbit", "top"):
        changed["camera"] = view.toggles[CAMERA]
    size = view.toggles.get(POINTS)
    if isinstance(size, float | int) and LEAST_POINT <= size <= LARGEST_POINT:
        changed["point_size"] = float(size)
    return replace(state, **changed)


def with_objects(state: State, source: Pipeline, view: ViewState) -> State:
    """The state with a view's selected object and chosen pair, as far as they are among its objects."""
    selected = next((object_place(state, source, key) for key in view.selection), None)
    pair = state.pair
    if view.pair is not None:
        ends = tuple(object_place(state, source, key) for key in view.pair)
        pair = next((at for p in state.ranked if (at := state.at(p))[:2] == ends), pair)
    return replace(state, selected=selected, pair=pair)


def object_key(state: State, source: Pipeline, place: int) -> str | None:
    """The key of a shown object (`whatif.pair_tables.detection_keys`); None where the detector does not find it so."""
    entry = state.shown.objects[place]
    if entry.id >= 0:
        return f"#{entry.id}"
    if state.edited is not None:
        edited = next((state.edited.after.keys[t] for t, at in state.shown.place.items() if at == place), None)
        if edited is not None:
            return edited
    keys, alike = _detections(state, source, entry.label)
    return next((key for key, same in zip(keys, alike(entry), strict=True) if same), None)


def object_place(state: State, source: Pipeline, key: str) -> int | None:
    """The shown object of a key; None where there is none."""
    objects = state.shown.objects
    if key.startswith("#") and "/" not in key:
        return next((i for i, o in enumerate(objects) if key == f"#{o.id}"), None)
    if state.edited is not None and key in state.edited.after.keys:
        return state.shown.place.get(state.edited.after.keys.index(key))
    name = key.rpartition("/")[0]
    if not any(o.label == name and o.id < 0 for o in objects):
        return None
    keys, alike = _detections(state, source, name)
    at = keys.index(key) if key in keys else None
    return None if at is None else next((i for i, o in enumerate(objects) if o.label == name and alike(o)[at]), None)


def _detections(
    state: State, source: Pipeline, name: str
) -> tuple[tuple[str, ...], Callable[[SceneObject], np.ndarray]]:
    """Keys of all that the detector finds of a name, and which of them an object is."""
    if state.loaded is None or source.detector is None:
        return (), lambda _: np.zeros(0, np.bool_)
    found = source.detector.detect(state.loaded.context.frame, [name])

    def alike(entry: SceneObject) -> np.ndarray:
        return (found.boxes == entry.bbox).all(axis=1)

    return detection_keys(name, found), alike
