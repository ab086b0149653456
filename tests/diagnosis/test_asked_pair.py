"""One pair of an answer under the relation that was asked."""

from __future__ import annotations

import numpy as np

import pipeline as core
from pipeline.answering import Trace
from pipeline.diagnosis import AskedPair, Edits, asked_pair


def asked(text: str) -> tuple[Trace, AskedPair]:
    trace = core.open("demo").ask(0, text).needed_trace()
    assert trace.ranking is not None
    found = asked_pair(trace, trace.ranking.pairs[0], Edits())
    assert found is not None
    return trace, found


def test_the_pair_stands_in_the_order_in_which_the_relation_is_judged() -> None:
    trace, found = asked("mug left of the laptop")
    assert [trace.objects[k].label for k in found.ends] == ["mug", "laptop"]
    assert found.placement.state == 1
    assert np.isfinite(found.middle).all()


def test_an_edited_rule_is_another_region_and_an_answer_without_a_pair_has_none() -> None:
    trace, found = asked("mug left of the laptop")
    assert trace.ranking is not None
    edited = asked_pair(trace, trace.ranking.pairs[0], Edits().with_settings("profile", cone=20.0))
    assert edited is not None
    assert edited.region_key != found.region_key
    assert asked_pair(trace, None, Edits()) is None
