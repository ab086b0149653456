"""Bring every region of the page up to a state."""

from __future__ import annotations

from collections.abc import Sequence

from pipeline.datasets import Dataset, has_moves, moves
from spatialviz.app import sentences_html
from spatialviz.app.answer import answer_html
from spatialviz.app.beside import agreement_html
from spatialviz.app.context import Shared
from spatialviz.app.layout import Page
from spatialviz.app.picture import depth_bar, image_html, log_html, objects_html
from spatialviz.app.stage_objects import object_html
from spatialviz.app.stages import stages_html
from spatialviz.app.state import State
from spatialviz.app.toolbar import (
    moves_html,
    problem_html,
    refusal_html,
    scene_tools_html,
    suggestions_html,
    tasks_html,
    tools_html,
    where_html,
)


def fill_page(
    page: Page,
    state: State,
    shared: Shared,
    *,
    dataset: Dataset,
    can_ask: bool,
    suggestions: Sequence[str],
    log: Sequence[tuple[str, str]],
) -> None:
    """Fill all regions at once. What would not change sends nothing."""
    leads = moves(dataset, state.frame_id) if has_moves(dataset) else None
    page.call("theme", "dark" if state.dark else "light")
    page.call("task", state.task)
    page.call("working", "")
    with page.together():
        page.show("where", where_html(state, tuple(shared.store.sources), dataset.frame_ids))
        page.show("moves", moves_html(leads))
        asked = state.trace is not None or state.labels is not None
        page.show("suggestions", None if asked and not state.error else suggestions_html(state, suggestions))
        page.show("tasks", tasks_html(state, bool(shared.runs), bool(shared.journals)))
        page.show("tools", tools_html())
        page.show("problem", problem_html(state))
        page.show("ask-problem", refusal_html(state))
        page.show("scene-tools", scene_tools_html(state))
        page.show("depth-legend", depth_bar(state))
        page.show("objects", objects_html(state))
        fill_answer(page, state, can_ask)
        page.show("agreement", agreement_html(state) if shared.second else None)
        page.show("image", image_html(state))
        page.show("object", object_html(state) if state.labels is None else None)
        page.show("log", log_html(log))


def fill_answer(page: Page, state: State, can_ask: bool = True) -> None:
    """Fill what follows a box that is dragged."""
    labels = state.labels is not None
    page.show("answer", sentences_html.sentence_html(state) if labels else answer_html(state, can_ask))
    page.show("stages", None if labels else stages_html(state, state.stage))
    page.show("expressions", sentences_html.expressions_html(state) if labels else None)
    page.show("history", sentences_html.history_html(state) if labels else None)
