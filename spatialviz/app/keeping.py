"""What a client wants to keep: its answer as a case folder, or as one page."""

from __future__ import annotations

import re
import shlex
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from pipeline.answering.objects import PreparedFrame
from pipeline.answering.opening import Pipeline
from pipeline.diagnosis.answer import Answer
from pipeline.diagnosis.asking import answer
from pipeline.diagnosis.cases.saving import save_case
from pipeline.diagnosis.whatif import edits_record
from pipeline.diagnosis.whatif.state import ViewState, encode
from pipeline.evaluation.run_folder import Run
from pipeline.evaluation.shared_makers import shares_of_answer
from pipeline.system.errors import InputError
from spatialviz.app.judging import Judge
from spatialviz.app.layout import Dialog, Page
from spatialviz.app.markup import h
from spatialviz.app.state import State
from spatialviz.report import Subject, failure_page

CASES = "cases"
"""The folder, under the one that the program was started in, that cases are saved in."""
LONGEST_NAME = 80


def folder_name(text: str) -> str:
    """A text as the name of one folder: letters, digits, ".", "_" and "-"; empty where nothing is left."""
    return re.sub(r"(?:[^A-Za-z0-9._-]|-)+", "-", text).strip("-._")[:LONGEST_NAME].rstrip("-._")


class Keeping:
    """Saves what one client looks at.

    Parameters
    ----------
    page : Page
    dialog : Dialog
    sources : mapping of str to Source
    runs : mapping of str to Run
        By name of the source.
    judge : Judge
    opened_by : sequence of str
        The words of the command line that opened the page, for the commands that open it again.
    state : callable
        Gives the client's state.
    view : callable
        Gives it as the view of a state string.
    note : callable
        Writes a line of the log.
    """

    def __init__(
        self,
        page: Page,
        dialog: Dialog,
        sources: Mapping[str, Pipeline],
        runs: Mapping[str, Run],
        judge: Judge,
        opened_by: Sequence[str],
        *,
        state: Callable[[], State],
        view: Callable[[], ViewState],
        note: Callable[[str], None],
    ) -> None:
        self._page, self._dialog, self._sources, self._runs, self._judge = page, dialog, sources, runs, judge
        self._opened_by, self._state, self._view, self._note = tuple(opened_by), state, view, note

    def commands(self) -> dict[str, Callable[[str], None]]:
        """What the page may ask for, by the first word of its message."""
        return {
            "keep-case": lambda _: self.ask_name(),
            "save-case": self.save,
            "report": lambda _: self.report(),
        }

    def ask_name(self) -> None:
        """Ask where the case is to be saved."""
        state = self._state()
        if state.trace is None:
            self._fail(InputError("there is no answer to save", cause="ask something first"))
            return
        name = folder_name(f"{state.text}-{state.frame_id}")
        field = h.input(
            cls="find", value=name, enter="save-case", autofocus=True, spellcheck="false", autocomplete="off",
            aria_label="Name of the folder",
        )  # fmt: skip
        hint = (
            "A small folder with the picture, the detections and the answer. ",
            h.code("spatialviz replay"),
            " runs it again and says whether the answer is still the same.",
        )
        self._dialog.show(
            "Save this answer as a case",
            (h.div(h.span(f"{CASES}/", cls="dim"), field, cls="case"), h.div(hint, cls="dim small")),
            h.button("Save", local="send:save-case:"),
        )

    def save(self, name: str) -> None:
        """Save the answer as a case in a new folder."""
        clean = folder_name(name)
        folder = Path(CASES) / clean
        try:
            if not clean:
                raise InputError("this is no name for a folder", got=repr(name[:40]), expected="letters and digits")
            if folder.exists():
                raise InputError("there is a case of this name already", expected="another name", path=folder)
            source, context, state, given = self._given()
            run = self._runs.get(state.source)
            view = self._view()
            origin = {} if run is None else {"run": str(run.folder), "expression": view.expression_id}
            save_case(folder, source, context, state.text, run=origin, **given)
        except InputError as error:
            self._fail(error)
            return
        replay = shlex.join(["spatialviz", "replay", str(folder)])
        self._note(f"case saved: {replay}")
        self._dialog.show(
            "Saved",
            (
                h.div("The case is in ", h.code(str(folder.resolve())), ". Run it again with"),
                h.textarea(replay, cls="state", rows=2, readonly=True, spellcheck="false", aria_label="Command"),
                h.div(cls="copied", role="status"),
            ),
            h.button("Copy the command", local="copy"),
        )

    def report(self) -> None:
        """Send the answer as one page that holds all it needs."""
        from spatialviz.report.scene import scene_html

        self._page.toast("Report", "The page is being made.")
        try:
            source, context, state, given = self._given()
            answered = answer(source, context, state.text, **given)
            report = failure_page(answered, source, context, self._subject(answered), scene_html(answered, context))
        except InputError as error:
            self._fail(error)
            return
        name = f"{folder_name(f'{state.text}-{state.frame_id}') or 'answer'}.html"
        self._page.download(name, report.encode("utf-8", "replace"))
        self._note(f"report made: {name}")

    def _given(self) -> tuple[Pipeline, PreparedFrame, State, dict[str, Any]]:
        """What is asked of which frame, and what is known of the truth."""
        state = self._state()
        if state.trace is None or state.loaded is None:
            raise InputError("there is no answer to keep", cause="ask something first")
        source, context = self._sources[state.source], state.loaded.context
        truth = self._judge.truth(state.source, source, context)
        known = self._judge.known(state.source, context, truth, self._view().expression_id)
        edits = state.edits
        return source, context, state, {"truth": truth, "edits": edits_record(edits) if edits else None, **known}

    def _subject(self, answered: Answer) -> Subject:
        view = self._view()
        try:
            string = encode(view)
        except InputError:
            string = None
        commands = () if string is None else (shlex.join(["spatialviz", *self._opened_by, "--state", string]),)
        facts = () if view.run is None else (("run", view.run), ("expression", view.expression_id or answered.text))
        name = self._state().source
        run = self._runs.get(name)
        shares = shares_of_answer(self._sources[name], self._judge.labels(name)) if run is None else run.shares
        return Subject(view.dataset, view.frame, commands, string, facts, shares)

    def _fail(self, error: InputError) -> None:
        self._note(str(error))
        self._dialog.refuse(str(error))
