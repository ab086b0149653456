"""What a client wants to keep: its answer as a case folder, or as one page."""

from __future__ import annotations

import re
import shlex
from collections.abc import Callable
from pathlib import Path
from typing import Any

from pipeline.answering.objects import PreparedFrame
from pipeline.answering.opening import Pipeline
from pipeline.diagnosis.answer import Answer
from pipeline.diagnosis.asking import answer
from pipeline.diagnosis.cases.saving import save_case
from pipeline.diagnosis.whatif import edits_record
from pipeline.diagnosis.whatif.state import ViewState, encode
from pipeline.evaluation.shared_makers import shares_of_answer
from pipeline.system.errors import InputError
from spatialviz.app.context import Context, Part, command
from spatialviz.app.judging import Judge
from spatialviz.app.markup import h
from spatialviz.app.state import State
from spatialviz.report import Subject, failure_page

CASES = "cases"
"""The folder, under the one that the program was started in, that cases are saved in."""
LONGEST_NAME = 80


def folder_name(text: str) -> str:
    """A text as the name of one folder: letters, digits, ".", "_" and "-"; empty where nothing is left."""
    return re.sub(r"(?:[^A-Za-z0-9._-]|-)+", "-", text).strip("-._")[:LONGEST_NAME].rstrip("-._")


class Keeping(Part):
    """Saves what one client looks at."""

    def __init__(self, ctx: Context, judge: Judge, view: Callable[[], ViewState]) -> None:
        super().__init__(ctx)
        self._judge, self._view = judge, view

    @command("keep-case")
    def ask_name(self) -> None:
        """Ask where the case is to be saved."""
        state = self.state
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
        self.ctx.dialog.show(
            "Save this answer as a case",
            (h.div(h.span(f"{CASES}/", cls="dim"), field, cls="case"), h.div(hint, cls="dim small")),
            h.button("Save", local="send:save-case:"),
        )

    @command("save-case")
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
            run = self.ctx.shared.runs.get(state.source)
            view = self._view()
            origin = {} if run is None else {"run": str(run.folder), "expression": view.expression_id}
            save_case(folder, source, context, state.text, run=origin, **given)
        except InputError as error:
            self._fail(error)
            return
        replay = shlex.join(["spatialviz", "replay", str(folder)])
        self.ctx.note(f"case saved: {replay}")
        self.ctx.dialog.show(
            "Saved",
            (
                h.div("The case is in ", h.code(str(folder.resolve())), ". Run it again with"),
                h.textarea(replay, cls="state", rows=2, readonly=True, spellcheck="false", aria_label="Command"),
                h.div(cls="copied", role="status"),
            ),
            h.button("Copy the command", local="copy"),
        )

    @command("report")
    def report(self) -> None:
        """Send the answer as one page that holds all it needs."""
        from spatialviz.report.scene import scene_html

        self.ctx.page.toast("Report", "The page is being made.")
        try:
            source, context, state, given = self._given()
            answered = answer(source, context, state.text, **given)
            report = failure_page(answered, source, context, self._subject(answered), scene_html(answered, context))
        except InputError as error:
            self._fail(error)
            return
        name = f"{folder_name(f'{state.text}-{state.frame_id}') or 'answer'}.html"
        self.ctx.page.download(name, report.encode("utf-8", "replace"))
        self.ctx.note(f"report made: {name}")

    def _given(self) -> tuple[Pipeline, PreparedFrame, State, dict[str, Any]]:
        """What is asked of which frame, and what is known of the truth."""
        state = self.state
        if state.trace is None or state.loaded is None:
            raise InputError("there is no answer to keep", cause="ask something first")
        source, context = self.ctx.shared.store.sources[state.source], state.loaded.context
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
        commands = (
            () if string is None else (shlex.join(["spatialviz", *self.ctx.shared.opened_by, "--state", string]),)
        )
        facts = () if view.run is None else (("run", view.run), ("expression", view.expression_id or answered.text))
        name = self.state.source
        run = self.ctx.shared.runs.get(name)
        shares = (
            shares_of_answer(self.ctx.shared.store.sources[name], self._judge.labels(name))
            if run is None
            else run.shares
        )
        return Subject(view.dataset, view.frame, commands, string, facts, shares)

    def _fail(self, error: InputError) -> None:
        self.ctx.note(str(error))
        self.ctx.dialog.refuse(str(error))
