"""How each stage of an answer fared, in words."""

from __future__ import annotations

import pytest

import pipeline as core
from pipeline.diagnosis import Answer, failed_stages, stages_of, unasked_stages
from pipeline.language.glossary import glossary


@pytest.fixture(scope="module")
def answered() -> Answer:
    return core.open("demo").ask(0, "mug left of the laptop")


def test_an_answer_tells_its_stages_in_order_and_as_json(answered: Answer) -> None:
    stages = stages_of(answered.needed_trace(), answered.diagnosis)
    assert [s.name for s in stages if s.name != "ATTRIBUTE"] == ["PARSE", "OPM", "LIFT", "SRM", "PRM", "LABEL"]
    assert [s.record() for s in stages] == answered.record()["stages"]
    assert all(s.words for s in stages)
    assert "ms" in stages[0].cost


def test_a_name_that_is_not_there_fails_where_proposals_are_made() -> None:
    missing = core.open("demo").ask(0, "mug left of the bowl").needed_trace()
    assert failed_stages(missing, None) == ("OPM",)
    marks = {s.name: s.mark for s in stages_of(missing, None)}
    assert (marks["OPM"], marks["PRM"]) == ("bad", "idle")


def test_what_speaks_against_the_depth_is_told_where_boxes_are_made(answered: Answer) -> None:
    found = {s.name: s for s in stages_of(answered.needed_trace(), None, odd_depth=True)}
    assert found["LIFT"].mark == "doubt"
    assert "the depth looks odd" in found["LIFT"].words


def test_what_was_not_asked_or_refused_says_so() -> None:
    assert failed_stages(None, None) == ("PARSE",)
    idle = unasked_stages(None, 0, refused="")
    assert {s.mark for s in idle} == {"idle"}
    assert idle[0].words == glossary()["PARSE"].short
    refused = unasked_stages("the labels cannot be read", 3, refused="PARSE")
    assert (refused[0].mark, refused[-1].words) == ("bad", "no verdict")
