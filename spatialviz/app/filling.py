"""Bring every panel of the page up to a state."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager

from pipeline.datasets import Dataset, has_moves, moves
from spatialviz.app import beside_html, bottom, left, right, sentences_html, why
from spatialviz.app.layout import Page
from spatialviz.app.state import State


def fill_page(
    page: Page,
    state: State,
    *,
    dataset: Dataset,
    can_ask: bool,
    suggestions: Sequence[str],
    log: Sequence[tuple[str, str]],
    atomic: Callable[[], AbstractContextManager[None]],
) -> None:
    """Fill all panels at once. Handles whose content would not change send nothing."""
    leads = moves(dataset, state.frame_id) if has_moves(dataset) else None
    with atomic():
        page.ask.disabled = not can_ask
        place, count = dataset.frame_ids.index(state.frame_id), len(dataset.frame_ids)
        page.steps.content = left.frame_html(place, count, leads)
        page.parse.content = left.parse_html(state, suggestions)
        page.controls.content = left.controls_html(state)
        page.objects.content = left.objects_html(state, moving=leads is not None)
        fill_answer(page, state, can_ask)
        page.object.content = right.object_html(state)
        if page.agreement is not None:
            page.agreement.content = beside_html.agreement_html(state)
        page.image.content = bottom.image_html(state)
        page.log.content = bottom.log_html(log)


def fill_answer(page: Page, state: State, can_ask: bool = True) -> None:
    """Fill what follows a box that is dragged."""
    page.modules.content = left.modules_html(state)
    if state.labels is not None:
        page.answer.content = sentences_html.sentence_html(state)
        page.pairs.content = sentences_html.expressions_html(state)
        page.relations.content = sentences_html.history_html(state)
        page.why.content = why.why_html(state)
        return
    page.answer.content = right.answer_html(state, can_ask)
    page.pairs.content = right.pairs_html(state)
    page.relations.content = right.relations_html(state)
    page.why.content = why.why_html(state)
