"""Regions of the page, each drawn anew only after a change of what it reads of the state."""

from __future__ import annotations

from collections.abc import Callable, Iterable

from pipeline.datasets.base import has_moves, moves
from pipeline.system.frozen import dataclass
from spatialviz.app import answer, first_steps, picture, sentences, stage_objects, stages, toolbar
from spatialviz.app.context import Context
from spatialviz.app.markup import Child
from spatialviz.app.state import State


@dataclass(frozen=True)
class Region:
    """Region of static/index.html."""

    name: str
    reads: str  # Fields of `State`, apart by spaces
    draw: Callable[[Context, State], Child]
    wanted: Callable[[State], bool] = lambda _: True  # Else it is empty, and reads nothing


ASKED = "loaded problem kept text trace found error stopped judged edits edited other pair side"
"""An answer, and the pair that is looked at."""


def _suggestions(_: Context, state: State) -> Child:
    asked = (state.trace is not None or state.labels is not None) and not state.error
    return None if asked else toolbar.suggestions_html(state, state.offers.questions)


def _needs(ctx: Context, state: State) -> Child:
    return None if state.labels is not None else first_steps.needs_html(ctx, state.source)


def _moves(ctx: Context, state: State) -> Child:
    dataset = ctx.source.dataset
    return toolbar.moves_html(moves(dataset, state.frame_id)) if has_moves(dataset) else None


REGIONS = (
    Region("where", "source", lambda ctx, state: toolbar.where_html(state, tuple(ctx.shared.store.sources))),
    Region("moves", "source frame_id", _moves),
    Region("suggestions", "loaded trace labels error offers text judged", _suggestions),
    Region("needs", "source labels", _needs),
    Region("tasks", "labels evaluating", lambda ctx, state: toolbar.tasks_html(state, bool(ctx.shared.journals))),
    Region("scene-tools", "loaded flags colors camera point_size", lambda _, state: toolbar.scene_tools_html(state)),
    Region("scene-buttons", "found trace pair labels picking", lambda _, state: toolbar.scene_buttons_html(state)),
    Region("legend", f"{ASKED} colors flags dark labels", lambda _, state: picture.legend_html(state)),
    Region(
        "objects",
        "loaded trace found pair labels dark",
        lambda _, state: None if state.loaded is None else picture.objects_html(state, state.loaded),
        lambda state: state.drawer == "Objects",
    ),
    Region(
        "object",
        "found trace pair selected labels dark",
        lambda _, state: stage_objects.object_html(state),
        lambda state: state.drawer == "Objects" and state.labels is None,
    ),
    Region("log", "", lambda ctx, _: picture.log_html(ctx.log), lambda state: state.drawer == "Log"),
    Region("image", f"{ASKED} labels selected colors flags dark marks", lambda _, state: picture.image_html(state)),
)
FOLLOWING = (
    Region(
        "answer",
        f"{ASKED} offers listing labels dark picking source frame_id tried tried_value mended",
        lambda ctx, state: answer.answer_html(state, ctx.can_ask),
    ),
    Region(
        "stages",
        f"{ASKED} labels stage flags dark listing",
        lambda _, state: stages.stages_html(state, state.stage),
    ),
)
"""Regions following a dragged box."""
LABELLED = (
    Region("answer", "labels loaded picking", lambda _, s: sentences.sentence_html(s, s.labels) if s.labels else None),
    Region("expressions", "labels", lambda _, s: sentences.expressions_html(s.labels) if s.labels else None),
    Region("history", "labels", lambda _, s: sentences.history_html(s.labels) if s.labels else None),
)


class Filling:
    """Keeps the regions of a page up to its state."""

    def __init__(self, ctx: Context) -> None:
        self._ctx = ctx
        self._drawn: dict[str, tuple[object, ...]] = {}

    def fill(self) -> None:
        """Fill all regions after a change."""
        page, state = self._ctx.page, self._ctx.state
        page.call("theme", "dark" if state.dark else "light")
        page.call("task", state.task)
        page.call("working", "")
        page.call("hints", first_steps.is_demo(self._ctx.source.dataset.root))
        with page.together():
            self._fill((*REGIONS, *(LABELLED if state.labels else FOLLOWING)))
        page.call("selected", {"object": state.selected, "pair": self._rank(state)})

    def follow(self) -> None:
        """Fill the regions following a dragged box."""
        self._fill(FOLLOWING)

    def _rank(self, state: State) -> int | None:
        return next((k for k, pair in enumerate(state.ranked) if state.at(pair) == state.pair), None)

    def _fill(self, regions: Iterable[Region]) -> None:
        state = self._ctx.state
        for region in regions:
            wanted = region.wanted(state)
            read = [getattr(state, name) for name in region.reads.split()] if wanted else []
            key = (region, wanted, self._ctx.log if wanted and region.name == "log" else None, *read)
            before = self._drawn.get(region.name)
            if before is None or len(before) != len(key) or not all(map(_same, before, key)):
                self._drawn[region.name] = key
                self._ctx.page.show(region.name, region.draw(self._ctx, state) if wanted else None)


SIMPLE = (str, int, float, bool, tuple)
"""Types of fields that are compared; others are the same only as one object."""


def _same(one: object, other: object) -> bool:
    return one is other or (isinstance(one, SIMPLE) and isinstance(other, SIMPLE) and one == other)
