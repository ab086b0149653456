"""A client's view as a string: copied, pasted, and opened with."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path

from pipeline.answering.opening import Pipeline
from pipeline.diagnosis.whatif import Edits
from pipeline.diagnosis.whatif.state import ViewState, decode, encode
from pipeline.evaluation.run_folder import Run
from pipeline.system.errors import InputError
from spatialviz.app.dialog import Dialog
from spatialviz.app.markup import h
from spatialviz.app.place import Place
from spatialviz.app.run_panel import RunPanel
from spatialviz.app.state import State
from spatialviz.app.view_string import (
    FOV,
    SHIPPED_SCORERS,
    view_of,
    with_objects,
    with_settings,
)  # fmt: skip
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
