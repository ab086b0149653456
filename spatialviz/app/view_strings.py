"""Exports of a client: view as a string, answer as a case or a page, cases of rows."""

from __future__ import annotations

import re
import shlex
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any, get_args

from pipeline.answering.objects import PreparedFrame
from pipeline.answering.pipeline import Pipeline
from pipeline.corrections.judging import Judge
from pipeline.diagnosis.answer import Answer
from pipeline.diagnosis.asking import answer
from pipeline.diagnosis.cases.saving import save_case
from pipeline.diagnosis.whatif import Edits, edits_record
from pipeline.diagnosis.whatif.state import CameraView, Toggle, ViewState, decode, encode
from pipeline.evaluation.leakage import shares_of_answer
from pipeline.language.counted import counted
from pipeline.pictures.answer_card import answer_picture
from pipeline.pictures.film import answer_film, mending_film
from pipeline.pictures.writing import encoded_film, encoded_picture
from pipeline.relations.model import is_named
from pipeline.system.errors import InputError, require
from spatialviz.app.context import Context, Part, command
from spatialviz.app.markup import h, note
from spatialviz.app.state import ColorMode, Place, State
from spatialviz.app.toolbar import LARGEST_POINT, LEAST_POINT
from spatialviz.report.page import Subject, failure_page, scene_html


class Exports(Part):
    """Opens views by strings; saves the answer as a case or a report, and the `selected` rows of a run as cases."""

    def __init__(
        self,
        ctx: Context,
        judge: Judge,
        reveal: Callable[[str, str], None],
        selected: Callable[[], list[dict[str, Any]]],
        go: Callable[[Place], None],
        ask: Callable[[str], None],
    ) -> None:
        super().__init__(ctx)
        self._judge, self._reveal, self._selected, self._go, self._ask = judge, reveal, selected, go, ask
        self._waiting: ViewState | None = None

    def now(self) -> ViewState:
        state, run = self.state, self.ctx.run
        return view_of(
            state,
            self.ctx.scene.viewpoint.turned_to(),
            None if run is None else str(run.folder.resolve()),
            state.expression_id(state.text),
        )

    def restore(self, string: str) -> None:
        """Show the view of a string."""
        self.open(decode(string))

    def open(self, view: ViewState, confirmed: bool = False) -> None:
        """Show a view; a file named in the view is loaded only if `confirmed`. InputError if inapplicable."""
        sources = self.ctx.shared.store.sources
        what, opened = "the view is of a dataset that is not open here", ", ".join(sources)
        require(view.dataset in sources, what, got=view.dataset, expected=opened)
        ids = sources[view.dataset].dataset.frame_ids
        require(view.frame in ids, f"{view.dataset} has no such frame", got=view.frame)
        first = self.ctx.shared.first_view
        if needs_file(view.edits.scorer, first and first.edits.scorer, self.ctx.shared.alone) and not confirmed:
            self._waiting = view
            self.ctx.dialog.show(
                "This view wants to load a file",
                (
                    h.div("It scores relations with this network. Load only what you trust."),
                    h.pre(view.edits.scorer, cls="file"),
                ),
                h.button("Load it", do="restore-with:file"),
                h.button("Without it", do="restore-with:no"),
            )
            return
        self.ctx.dialog.close()
        self._look(view)

    @command("restore-with")
    def _confirm(self, answer: str) -> None:
        """Handle the decision on the waiting view's scorer."""
        view, self._waiting = self._waiting, None
        if view is not None:
            view = view if answer == "file" else replace(view, edits=view.edits.with_scorer(None))
            self.open(view, confirmed=True)

    def _look(self, view: ViewState) -> None:
        if view.dataset != self.state.source:
            self._go(Place(view.dataset))
        run = self.ctx.shared.runs.get(view.dataset)
        if view.run is not None and (run is None or run.folder.resolve().name != Path(view.run).name):
            self.ctx.note(f"the view is of the run {view.run}, which is not open here")
        elif view.expression_id is not None:
            self._reveal(view.frame, view.expression_id)
        self.state = with_settings(self.state, view)
        self._go(Place(view.dataset, view.frame, view.expression))
        if view.edits != self.state.edits:
            self._edit(view)
        self.state = with_objects(self.state, view)
        self.ctx.draw()
        if self.state.loaded is not None:
            if view.camera is None:
                self.ctx.scene.viewpoint.place(self.state.camera)
            else:
                fov = view.toggles.get(FOV)
                self.ctx.scene.viewpoint.turn_to(view.camera, float(fov) if isinstance(fov, (int, float)) else None)

    def _edit(self, view: ViewState) -> None:
        """Ask again with the edits of a view; without edits if inapplicable."""
        self.state = replace(self.state, edits=view.edits)
        try:
            self._ask(view.expression)
        except InputError:
            self.state = replace(self.state, edits=Edits(), edited=None)
            self._ask(view.expression)
            raise

    # ---- what is kept ------------------------------------------------------------------

    @command("keep-case")
    def save(self) -> None:
        """Save the answer as a case in a new folder, named after question and frame."""
        source, context, state = self._answered()
        folder = case_folder(state.text, state.frame_id)
        require(not folder.exists(), "this answer is a case already", path=folder)
        self._save(folder, context, state.text, self.now().expression_id, self._given(source, context))
        self.ctx.toast("Case saved", f"{folder.resolve()}; `spatialviz replay` runs it again")

    def _save(
        self, folder: Path, context: PreparedFrame, text: str, expression: str | None, given: Mapping[str, Any]
    ) -> None:
        run = self.ctx.run
        origin = {} if run is None else {"run": str(run.folder), "expression": expression}
        maps = None if run is None else run.maps
        save_case(folder, self.ctx.source, context, text, run=origin, maps=maps, **given)

    @command("report")
    def report(self) -> None:
        """Send the answer as a self-contained page."""
        self.ctx.toast("Report", "The page is being made.")
        source, context, state = self._answered()
        answered = answer(source, context, state.text, **self._given(source, context))
        report = failure_page(answered, source, context, self._subject(answered), scene_html(answered, context))
        name = f"{case_folder(state.text, state.frame_id).name}.html"
        self.ctx.page.download(name, report.encode("utf-8", "replace"))

    @command("copy-picture")
    def copy_picture(self) -> None:
        """Send the answer as a picture, for the clipboard."""
        state, answered = self.state, self._shown()
        assert state.loaded is not None
        picture = answer_picture(answered, state.loaded.context.frame, state.source)
        name = f"{case_folder(state.text, state.frame_id).name}.png"
        self.ctx.page.download(name, encoded_picture(picture), copy=True)

    @command("copy-film")
    def copy_film(self) -> None:
        """Send a film: the answer without and with the edits, without any before and after what would mend it."""
        self.ctx.toast("Film", "It is being made.")
        state, answered = self.state, self._shown()
        if state.edits:
            film = answer_film(self._shown(edited=False), answered, state.source, moving=False)
        else:
            film = mending_film(answered, state.source, moving=False)
        self.ctx.page.download(f"{case_folder(state.text, state.frame_id).name}.gif", encoded_film(film))

    def _shown(self, edited: bool = True) -> Answer:
        """Answer that is shown, or the refusal; InputError without a question."""
        state = self.state
        if not state.text or state.loaded is None:
            raise InputError("there is no answer to show", cause="ask something first")
        source, context = self.ctx.source, state.loaded.context
        given = self._given(source, context)
        if not edited:
            given.pop("edits", None)
        return answer(source, context, state.text, **given)

    def _answered(self) -> tuple[Pipeline, PreparedFrame, State]:
        """Current pipeline, frame and state; InputError without a question."""
        state = self.state
        if state.trace is None or state.loaded is None:
            raise InputError("there is no answer to keep", cause="ask something first")
        return self.ctx.source, state.loaded.context, state

    def _given(self, source: Pipeline, context: PreparedFrame) -> dict[str, Any]:
        """Known truth, and the edits."""
        edits = self.state.edits
        edited = {"edits": edits_record(edits)} if edits else {}
        return {**self._known(source, context, self.now().expression_id), **edited}

    def _known(self, source: Pipeline, context: PreparedFrame, expression: str | None) -> dict[str, Any]:
        name = self.state.source
        truth = self._judge.truth(name, source, context)
        return {"truth": truth, **self._judge.known(name, context.frame.id, truth, expression)}

    def _subject(self, answered: Answer) -> Subject:
        view, run, string = self.now(), self.ctx.run, None
        with suppress(InputError):
            string = encode(view)
        opened = ["spatialviz", *self.ctx.shared.opened_by, "--state"]
        commands = () if string is None else (shlex.join([*opened, string]),)
        facts = () if view.run is None else (("run", view.run), ("expression", view.expression_id or answered.text))
        shares = shares_of_answer(self.ctx.source, self._judge.labels(self.state.source)) if run is None else run.shares
        return Subject(view.dataset, view.frame, commands, string, facts, shares)

    @command("row-cases")
    def save_rows(self) -> None:
        """Save each selected row as a case; existing cases stay."""
        rows = self._selected()
        count = len(rows)
        require(count <= MOST, "so many cases are not made at once", got=count, expected=f"up to {MOST}")
        saved, refused, there = list[str](), list[str](), 0
        for number, row in enumerate(rows, 1):
            self.ctx.page.call("working", f"case {number} of {count}")
            folder = case_folder(row["text"], row["frame"])
            there += folder.exists()
            try:
                if not folder.exists():
                    self._save_row(folder, row)
                    saved.append(str(folder))
            except InputError as error:
                refused.append(f"{row['text']}: {error}")
        self.ctx.page.call("working", "")
        self.ctx.dialog.show(
            "Cases of the selected",
            (
                h.p(f"{counted(len(saved), 'case')} saved{f', {there} were there already' if there else ''}."),
                h.pre("\n".join(saved), cls="file") if saved else None,
                [note(reason, "bad") for reason in refused[:TOLD]],
            ),
        )

    def _save_row(self, folder: Path, row: dict[str, Any]) -> None:
        context = self.ctx.shared.store.load(self.state.source, row["frame"]).context
        self._save(folder, context, row["text"], row["id"], self._known(self.ctx.source, context, row["id"]))


BEGINS = re.compile(r"\s*sv[0-9]{1,6}:")
"""Prefix of a state string, never of an expression."""
CAMERA, FOV, POINTS = "camera view", "field of view", "point size"
"""Toggles: viewpoint ("sensor", "orbit", "top"), field of view of a turned camera (radians), point size factor."""


def needs_file(scorer: str | None, first: str | None, alone: bool) -> bool:
    """True if a view's scorer is a file in need of consent; `first` is the server's scorer, `alone` as in `Shared`.

    InputError for an uninstalled scorer on a shared server, without revealing the existence of files.
    """
    named = is_named(scorer)
    require(
        named or alone or scorer == first,
        "the view scores relations with a network that is not installed here",
        got=scorer,
        expected="rule, trained, or an installed one",
        cause="where a token is needed no other file is loaded",
    )
    return not named and (alone or scorer != first)


def view_of(
    state: State, camera: tuple[CameraView, float] | None, run: str | None, expression: str | None
) -> ViewState:
    """View of a client."""
    # `camera` holds the turned view and field of view; `run` is a folder, `expression` the id of its asked expression.
    selected = None if state.selected is None else state.key_of(state.selected)
    ends = None if state.pair is None else [state.key_of(at) for at in state.pair[:2]]
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
    """State with a view's colours, toggles and viewpoint; unknown values are ignored."""
    known = asdict(state.flags)
    flags = {name: value for name, value in view.toggles.items() if name in known and isinstance(value, bool)}
    size = view.toggles.get(POINTS)
    if not isinstance(size, float | int) or not LEAST_POINT <= size <= LARGEST_POINT:
        size = state.point_size
    return replace(
        state,
        flags=replace(state.flags, **flags),
        colors=next((mode for mode in get_args(ColorMode) if mode == view.colors), state.colors),
        camera=next((mode for mode in ("sensor", "orbit", "top") if mode == view.toggles.get(CAMERA)), state.camera),
        point_size=float(size),
    )


def with_objects(state: State, view: ViewState) -> State:
    """State with a view's selection and chosen pair, if among its objects."""
    selected = next((state.place_of(key) for key in view.selection), None)
    pair = state.pair
    if view.pair is not None:
        ends = tuple(state.place_of(key) for key in view.pair)
        pair = next((at for p in state.ranked if (at := state.at(p))[:2] == ends), pair)
    return replace(state, selected=selected, pair=pair)


CASES = "cases"
"""Folder of saved cases, under the working directory."""
LONGEST_NAME = 80
MOST, TOLD = 200, 5
"""Cases per job, and reported reasons of failure, at most."""


def case_folder(text: str, frame: str) -> Path:
    """Folder of an answer's case: letters, digits, ".", "_" and "-" of the question and the frame."""
    name = re.sub(r"(?:[^A-Za-z0-9._-]|-)+", "-", f"{text}-{frame}").strip("-._")[:LONGEST_NAME].rstrip("-._")
    return Path(CASES) / (name or "answer")
