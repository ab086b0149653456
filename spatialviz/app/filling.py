"""Update of every region of the page from a state."""

from __future__ import annotations

from pipeline.datasets.base import has_moves, moves
from spatialviz.app import answer, picture, sentences, stage_objects, stages, toolbar
from spatialviz.app.context import Context


def fill_page(ctx: Context) -> None:
    """Fill all regions at once; unchanged content sends nothing."""
    page, state, shared, dataset = ctx.page, ctx.state, ctx.shared, ctx.source.dataset
    page.call("theme", "dark" if state.dark else "light")
    page.call("task", state.task)
    page.call("working", "")
    asked = (state.trace is not None or state.labels is not None) and not state.error
    regions = {
        "where": toolbar.where_html(state, tuple(shared.store.sources), dataset.frame_ids),
        "moves": toolbar.moves_html(moves(dataset, state.frame_id)) if has_moves(dataset) else None,
        "suggestions": None if asked else toolbar.suggestions_html(state, state.offers.questions),
        "tasks": toolbar.tasks_html(state, bool(shared.journals)),
        "scene-tools": toolbar.scene_tools_html(state),
        "scene-buttons": toolbar.scene_buttons_html(state),
        "legend": picture.legend_html(state),
        "objects": picture.objects_html(state, state.loaded) if state.loaded else None,
        "image": picture.image_html(state),
        "object": stage_objects.object_html(state) if state.labels is None else None,
        "log": picture.log_html(ctx.log),
    }
    with page.together():
        page.fill(regions)
        fill_answer(ctx)


def fill_answer(ctx: Context) -> None:
    """Fill the regions following a dragged box."""
    state, view = ctx.state, ctx.state.labels
    regions = {
        "answer": sentences.sentence_html(state, view) if view else answer.answer_html(state, ctx.can_ask),
        "stages": None if view else stages.stages_html(state, state.stage),
        "expressions": sentences.expressions_html(view) if view else None,
        "history": sentences.history_html(view) if view else None,
    }
    ctx.page.fill(regions)
