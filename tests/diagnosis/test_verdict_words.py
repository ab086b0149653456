"""What a verdict says of itself: only what was found."""

from __future__ import annotations

import re
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from diagnosis_worlds import world

from pipeline.answering import ScoredPair
from pipeline.diagnosis import Diagnosis, Missed, diagnose, substitute
from pipeline.diagnosis.story import judged_story
from pipeline.labels import Case

CASE = Case("1", "book on a book", "book", "on", "shelf", 0, 1, np.array([0]), np.array([0]), False, 0.1)
WINNER = ScoredPair(0, 3, 0.6, 0.5, 0.9, log_score=-1.3, product=0.27, probability=0.6)
EVIDENCE, _ = world(0)
RIGHT = ScoredPair(1, 2, 0.4, 0.3, 0.8, log_score=-2.3, product=0.096, probability=0.2)


def said(verdict: str, winner: ScoredPair | None, right: ScoredPair | None, **more: object) -> str:
    plain = Diagnosis(verdict, None, False, (), 0, np.full(16, np.nan), winner, right, case=CASE, evidence=EVIDENCE)
    return str(judged_story(replace(plain, **more)))  # pyright: ignore[reportArgumentType]


def test_a_degenerate_answer_is_told_from_none() -> None:
    alone = said("PRM", None, None)
    assert alone.startswith("All that was found for “book” and “shelf” is one thing, so no pair of two is left.")
    assert said("PRM", WINNER, None).startswith("The correct book and shelf were found as one thing")


@pytest.mark.parametrize(
    ("target", "reference", "words"),
    [
        (
            True,
            False,
            "What was taken for the book is {}; the shelf found with it scored 0.50, the correct shelf 0.30.",
        ),
        (False, True, "What was taken for the shelf is {}; the detector scored it 0.50, and the correct shelf 0.30."),
        (
            True,
            True,
            "The answer's “book” is {}, the “shelf” is {}; together they scored 2 times as high as the correct pair.",
        ),
    ],
)
def test_what_a_box_really_is_is_said(target: bool, reference: bool, words: str) -> None:
    text = said("OPM-CONF", WINNER, replace(RIGHT, reference=2), false_target=target, false_reference=reference)
    assert re.fullmatch(re.escape(words).replace(r"\{\}", "(another|the|part of the|something) [a-z ]+"), text), text


def test_a_score_that_is_many_times_higher_is_said_so() -> None:
    text = said("OPM-CONF", WINNER, replace(RIGHT, p_target=0.035), false_target=True)
    assert "the detector scored it 17 times as high as the correct book" in text


@pytest.mark.parametrize("verdict", ["LIFT", "SRM"])
def test_no_network_is_blamed_where_a_rule_scores(verdict: str) -> None:
    text = said(verdict, WINNER, RIGHT)
    assert "network" not in text
    assert "0.90" in text
    assert "0.80" in text


def test_luck_says_what_the_reference_really_is() -> None:
    found = said("CORRECT", WINNER, None, lucky=True, false_reference=True)
    assert found.startswith("The book is correct, but what was called “shelf” is ")
    assert "another shelf" in said("CORRECT", WINNER, None, lucky=True)
    assert "as one thing" in said("CORRECT", None, None, lucky=True)


def test_a_name_that_the_detector_does_not_know_is_not_called_unseen() -> None:
    plain = Diagnosis("", None, False, (), 0, np.full(16, np.nan), None, None, case=CASE, evidence=EVIDENCE)
    missed = {"missed": Missed("ABSENT", 0.0), "missed_name": "book"}
    found = replace(plain, verdict="OPM-TARGET", detail="ABSENT", repair=("RECALL",), **missed)
    assert judged_story(found, unknown={"book": "?"}).sentence == "The detector does not know the word “book”."
    assert judged_story(found, unknown={"shelf": "?"}).sentence.startswith("The detector did not see the book on")


def test_no_sentence_has_an_empty_clause_or_a_number_that_does_not_change() -> None:
    seen = set()
    for seed in range(400):
        evidence, case = world(seed)
        rng = np.random.default_rng(seed)
        table = evidence.probabilities("left")
        # As networks have them: most are next to 0 or to 1, and differ in the fifth digit.
        sharp = 1 / (1 + np.exp(-rng.normal(0, 8, table.shape)))
        table[:] = np.where(np.isnan(table), np.nan, sharp)
        d = evidence.detections
        vars(evidence.answers)["_scores"] = SimpleNamespace(of=lambda relation, t=table[:d, :d]: t)
        found = diagnose(evidence, case, parse_ok=True)
        text = str(found.story)
        seen.add(found.verdict)
        assert not re.search(r"gave ;|and ;|  |\(\)| ,|^[a-z]", text), text
        for now, before in re.findall(r"([\d.]+\d)(?:; it was| to) ([\d.]+\d)", text):
            assert now != before, text
    assert seen >= {"LIFT", "SRM", "PRM", "OPM-CONF"}


def test_an_answer_that_the_labels_call_right_and_do_not_list_makes_the_label_suspect() -> None:
    seen = 0
    for seed in range(300):
        evidence, case = world(seed)
        plain = diagnose(evidence, case, parse_ok=True)
        if plain.detail != "AMBIGUOUS" or plain.winner is None:
            continue
        found = substitute(evidence, case)
        pair = found.pair()
        if pair is None or not found.covered[pair]:
            continue
        listed = np.array([case.target_object])
        unlisted = replace(case, strict=listed, acceptable=listed)
        d = diagnose(evidence, unlisted, parse_ok=True)
        assert (d.verdict, d.detail) == ("LABEL", "SUSPECT")
        assert "does not list it" in d.text
        assert diagnose(evidence, unlisted, parse_ok=True, mark="BAD_BOX").detail == "BAD_BOX"
        seen += 1
    assert seen > 10


def test_a_right_pair_whose_relation_is_not_believed_is_told_as_the_nearest() -> None:
    weak = replace(RIGHT, p_relation=0.1)
    believed = said("CORRECT", WINNER, WINNER)
    assert believed == "This is the book that was meant; “on the shelf” has a probability of 0.90."
    assert "but only as the nearest" in said("CORRECT", weak, weak)


def test_a_box_that_is_off_by_estimated_depth_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    assert "estimated" not in said("LIFT", WINNER, RIGHT)
    frame = SimpleNamespace(depth_source="estimated by a network")
    monkeypatch.setattr(EVIDENCE.answers, "context", SimpleNamespace(frame=frame))
    assert said("LIFT", WINNER, RIGHT).startswith("A 3D box is off by estimated depth, ")
    assert "estimated" not in said("SRM", WINNER, RIGHT)
