"""A region of the page reads no field of the state but those that it names, after whose change it is drawn anew."""

from __future__ import annotations

from dataclasses import fields, replace
from types import SimpleNamespace
from typing import Any, cast

import pytest

from pipeline import open_run
from pipeline.answering.frame_store import FrameStore
from pipeline.datasets.demo import demo_run
from pipeline.diagnosis.whatif.answer_view import shown_objects
from spatialviz.app.context import Context
from spatialviz.app.filling import FOLLOWING, REGIONS, Region
from spatialviz.app.state import State

FIELDS = frozenset(f.name for f in fields(State))


class Watched(State):
    """State that notes which of its fields are read."""

    def __getattribute__(self, name: str) -> Any:
        if name in FIELDS:
            READ.add(name)
        return super().__getattribute__(name)


READ: set[str] = set()


@pytest.fixture(scope="module")
def states() -> list[tuple[Context, Watched]]:
    """Right, wrong, refused and unasked questions, with each stage and tab open."""
    run = open_run(demo_run())
    source = run.source
    store = FrameStore({"demo": source})
    shared = SimpleNamespace(store=store, journals={"demo": None}, runs={}, labels={})
    ctx = cast(Context, SimpleNamespace(shared=shared, source=source, can_ask=True, log=[("12:00:00", "said")]))
    made: list[tuple[Context, Watched]] = []
    for search in ("verdict:OPM-CONF", "verdict:CORRECT", "verdict:LABEL", "verdict:PARSE", "verdict:OPM-TARGET"):
        failure = run.failures(search)[0]
        answer = failure.answer
        loaded = store.load("demo", failure.row["frame"])
        state = Watched(
            "demo",
            failure.row["frame"],
            loaded=loaded,
            text=answer.text,
            trace=answer.trace,
            found=shown_objects(loaded, answer.trace, False),
            error=answer.problem or "",
            judged=answer.diagnosis or answer.unjudged,
        )
        made.append((ctx, replace(state, pair=next(map(state.at, state.ranked), None), selected=0)))
    ctx, first = made[0]
    stages = [replace(first, stage=name) for name in ("PARSE", "OPM", "LIFT", "SRM", "PRM", "LABEL")]
    tabs = [replace(first, drawer=name) for name in ("Objects", "Log")]
    rest = [replace(first, trace=None, pair=None, judged=None), replace(first, colors="depth", camera="top")]
    return [*made, *((ctx, state) for state in (*stages, *tabs, *rest))]


@pytest.mark.parametrize("region", [*REGIONS, *FOLLOWING], ids=lambda region: region.name)
def test_what_is_read_is_named(region: Region, states: list[tuple[Context, Watched]]) -> None:
    named = set[str]()
    for ctx, state in states:
        READ.clear()
        for name in region.reads.split():
            getattr(state, name)
        named |= READ
        if region.wanted(state):
            READ.clear()
            region.draw(ctx, state)
            assert named >= READ, f"{region.name} reads {sorted(READ - named)}, too"
