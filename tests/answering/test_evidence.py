"""Sentences as people say them, answered: attributes, choices, negation, the viewer, and what cannot be used."""

from __future__ import annotations

from dataclasses import replace
from itertools import product

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scenes import frame_of, upright

import pipeline
from pipeline.answering import Trace, best_pair, trace_record, why_no_answer
from pipeline.answering.ask import ask
from pipeline.answering.evidence import ranked_probability
from pipeline.geometry import Frame
from pipeline.proposals import AnnotationDetector
from pipeline.system import UnknownClass

KNOWN = ("mug", "laptop", "book", "potted plant", "table", "box")
RED, WHITE, BLUE = (190, 30, 35), (235, 235, 230), (40, 70, 180)


@pytest.fixture(scope="module")
def row() -> Frame:
    """From left to right on a table: red mug 0, white mug 1, blue mug 2 (larger and nearer), book 3, laptop 4."""
    places = [(-0.6, 1.5), (-0.3, 1.5), (0.0, 1.3), (0.3, 1.5), (0.6, 1.5)]
    sizes = [(0.12, 0.14, 0.12), (0.12, 0.14, 0.12), (0.16, 0.2, 0.16), (0.12, 0.14, 0.12), (0.14, 0.14, 0.14)]
    things = [upright((x, 0.58 - size[1] / 2, z), size) for (x, z), size in zip(places, sizes, strict=True)]
    table = upright((0, 0.63, 1.45), (1.7, 0.1, 0.7))
    frame = frame_of([*things, table], ["mug", "mug", "mug", "book", "laptop", "table"], pitch=25)
    rgb = np.full_like(frame.rgb, 225)
    for annotation, color in zip(frame.annotations, (RED, WHITE, BLUE), strict=False):
        assert annotation.mask is not None
        rgb[annotation.mask] = color
    return replace(frame, rgb=rgb)


def asked(frame: Frame, text: str) -> Trace:
    return ask(frame, text, AnnotationDetector(KNOWN))


def target(trace: Trace) -> int | None:
    best = best_pair(trace)
    return None if best is None else trace.objects[best.target].id


@pytest.mark.parametrize(
    ("text", "meant"),
    [
        ("the red mug", 0),
        ("white mug", 1),
        ("could you pass me the blue one", 2),
        ("the red mug on the table", 0),
        ("leftmost mug", 0),
        ("the rightmost mug", 2),
        ("second mug from the left", 1),
        ("first mug from the right", 2),
        ("the last mug from the left", 2),
        ("the mug on the left", 0),
        ("the biggest mug", 2),
        ("closest mug", 2),
        ("the mug nearest to the camera", 2),
        ("the middle mug", 1),
        ("the mug closest to the book", 2),
        ("the cup that is not white and left of the blue mug", 0),
        ("the mug between the two other mugs", 1),
        ("the thing to the right of the book", 4),
        ("the mug, not the red one, left of the blue mug", 1),
        ("the object farthest to the right", 4),
        ("is there a mug to the left of the white cup?", 0),
        ("the mug left of the laptop on the floor, the white one", 1),
        ("rightmost mug in back row", 1),
        ("mug left", 0),
        ("any mug except the one in front and the red one", 1),
    ],
)
def test_the_thing_that_is_meant_is_answered(row: Frame, text: str, meant: int) -> None:
    assert target(asked(row, text)) == meant


def test_every_factor_is_shown_and_the_product_is_theirs(row: Frame) -> None:
    trace = asked(row, "the red mug left of the white mug")
    record = trace_record(trace)
    best = record["pairs"][0]
    assert [(f["kind"], f["text"]) for f in best["factors"]] == [("attribute", "red"), ("attribute", "white")]
    told = np.prod([f["probability"] for f in best["factors"]])
    assert best["product"] == pytest.approx(
        best["p_target"] * best["p_reference"] * best["p_relation"] * told, abs=1e-4
    )
    tree = record["expression"]["tree"]
    assert (tree["label"], tree["head"]) == ("red mug", "mug")
    assert tree["relations"][0]["of"][0]["attributes"] == [{"kind": "color", "value": "white"}]


def test_a_question_that_several_things_fit_is_not_answered(row: Frame) -> None:
    trace = asked(row, "the mug")
    assert best_pair(trace) is None
    assert trace_record(trace)["answer"] is None
    assert "3 things fit" in str(why_no_answer(trace))
    assert target(asked(row, "the laptop")) == 4


def test_where_nothing_is_what_was_asked_the_nearest_is_no_answer_of_it(row: Frame) -> None:
    record = trace_record(asked(row, "the fourth mug from the left"))
    assert record["answer"]["holds"] is False, "there are three; that several fit it would be wrong"


def test_what_cannot_be_used_is_told(row: Frame) -> None:
    record = trace_record(asked(row, "the wooden mug on the floor, next to the book"))["expression"]
    assert [u["text"] for u in record["unused"]] == ["floor", "wooden"]
    with pytest.raises(UnknownClass, match="window"):
        asked(row, "the mug by the window")
    # Only one thing is called so: which it is does not hang on the floor.
    assert target(asked(row, "the book on the floor")) == 3


def test_a_name_is_shown_as_what_it_was_taken_for(row: Frame) -> None:
    names = trace_record(asked(row, "the leftmost cup"))["expression"]["names"]
    assert [(n["said"], n["taken_as"]) for n in names] == [("cup", "mug")]


def test_a_misspelt_name_is_shown_as_what_it_was_taken_for(row: Frame) -> None:
    trace = asked(row, "the mug abov the tabel, left of the lapotp")
    record = trace_record(trace)["expression"]
    assert [(n["said"], n["taken_as"], n["how"]) for n in record["names"]] == [
        ("tabel", "table", "spelling"),
        ("lapotp", "laptop", "spelling"),
    ]
    assert record["mended"] == [{"said": "abov", "read_as": "above"}]


def test_nothing_that_is_all_of_it_does_not_hold(row: Frame) -> None:
    best = best_pair(asked(row, "the black mug left of the book"))
    assert best is not None
    assert not best.holds


@settings(max_examples=30, deadline=None)
@given(st.lists(st.tuples(st.floats(-5, 5), st.floats(0, 1)), min_size=1, max_size=6), st.integers(1, 4))
def test_the_kth_of_uncertain_things_is_counted_right(things: list[tuple[float, float]], rank: int) -> None:
    keys = np.array([k for k, _ in things]) + 1e-6 * np.arange(len(things))
    belief = np.array([b for _, b in things])
    found = ranked_probability(keys, belief, rank)
    for i in range(len(things)):
        before = [j for j in range(len(things)) if keys[j] < keys[i]]
        chance = 0.0
        for there in product((0, 1), repeat=len(before)):
            if sum(there) == rank - 1:
                chance += float(
                    np.prod([belief[j] if t else 1 - belief[j] for j, t in zip(before, there, strict=True)])
                )
        assert found[i] == pytest.approx(chance, abs=1e-9)


def test_what_has_no_place_in_an_order_is_never_chosen() -> None:
    assert ranked_probability(np.array([np.nan, 1.0]), np.ones(2), 1).tolist() == [0.0, 1.0]


def test_what_must_not_hold_is_true_of_another_thing_of_the_name() -> None:
    opened = pipeline.open("demo", srm="rule")
    held, denied = (
        opened.ask(0, text) for text in ("mug left of the laptop", "the mug that is not left of the laptop")
    )
    assert held.target is not None
    assert denied.target is not None
    assert (held.target.label, denied.target.label) == ("mug", "mug")
    assert held.target.id != denied.target.id
    assert denied.verdict in ("CORRECT", "LABEL", None)


def test_on_the_floor_is_lower_than_its_like_where_no_floor_is_annotated() -> None:
    boxes = [upright((-0.4, 0.75, 2.0), (0.5, 0.5, 0.5)), upright((-0.4, 0.4, 2.0), (0.2,) * 3)]
    boxes.append(upright((0.5, 0.9, 2.0), (0.2,) * 3))
    frame = frame_of(boxes, ["cabinet", "jar", "jar"], floor=1.0, pitch=20)
    detector = AnnotationDetector(("cabinet", "jar"))
    low, high = (ask(frame, f"the jar {words} the floor", detector) for words in ("on", "that is not on"))
    assert (target(low), target(high)) == (2, 1)
    # It is a guess of height, not of a floor: the word is still told, and nothing is held to be true.
    assert [u["text"] for u in trace_record(low)["expression"]["unused"]] == ["floor"]


def test_a_frame_without_the_name_answers_with_its_kinds() -> None:
    frame = frame_of([upright((-0.4, 0.6, 2.0), (0.5,) * 3)], ["armchair"])
    assert target(ask(frame, "the chair", AnnotationDetector(("armchair", "chair", "bed")))) == 0
    assert target(ask(frame, "the bed", AnnotationDetector(("armchair", "chair", "bed")))) is None
