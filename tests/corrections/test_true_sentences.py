"""A sentence that a person says is true of a pair: kept in the journal, read as any other expression of labels."""

from __future__ import annotations

from pathlib import Path

import pytest
from editor_checks import Open, desk, place  # noqa: F401
from journal_world import FRAME

from pipeline.corrections import (
    EffectiveFrame,
    LabelEditor,
    Saved,
    actions_of,
    apply_actions,
    effective_truth,
    materialise,
)
from pipeline.corrections.journal import edits
from pipeline.corrections.object_card import expression_cards
from pipeline.labels import open_labels
from pipeline.labels.check.linter import check_labels
from pipeline.relations import F, T
from pipeline.system import InputError

TEXT = "the thing that I mean left of the other"


def pair_where(frame: EffectiveFrame, state: int) -> tuple[int, int]:
    numbers = frame.pairs.numbers.tolist()
    return next((a, b) for a in numbers for b in numbers if a != b and frame.pairs.state(a, b, "left") == state)


def say(ann: LabelEditor, a: int, b: int, text: str = TEXT) -> EffectiveFrame:
    frame = ann.frame(FRAME)
    words = frame.objects[a]["label"], "left", frame.objects[b]["label"]
    assert isinstance(ann.save(edits.add_sentence(frame, text, words, a, b)), Saved)
    return ann.frame(FRAME)


def test_a_true_sentence_becomes_a_case(desk: Open) -> None:
    ann = desk("ann")
    a, b = pair_where(ann.frame(FRAME), T)
    frame = say(ann, a, b)
    (case,) = (c for c in effective_truth(frame).cases if c.text == TEXT)
    assert (case.target_object, case.reference_object) == tuple(list(frame.objects).index(n) for n in (a, b))
    assert case.target_object in case.strict
    assert set(case.strict) <= set(case.acceptable)
    assert any(c.text == TEXT and c.target_object == a for c in expression_cards(frame))
    with pytest.raises(InputError, match="say so already"):
        edits.add_sentence(frame, TEXT, (case.target, "left", case.reference), a, b)
    ann.undo()
    assert not any(c.text == TEXT for c in effective_truth(ann.frame(FRAME)).cases)


def test_what_the_labels_deny_of_the_pair_is_corrected_with_it(desk: Open) -> None:
    ann = desk("ann")
    a, b = pair_where(ann.frame(FRAME), F)
    frame = say(ann, a, b)
    assert (frame.pairs.state(a, b, "left"), frame.pairs.state(b, a, "right")) == (T, T)
    ann.undo()
    assert ann.frame(FRAME).pairs.state(a, b, "left") == F


def test_another_pair_takes_its_place_and_it_goes_with_its_objects(desk: Open) -> None:
    ann = desk("ann")
    numbers = ann.frame(FRAME).pairs.numbers.tolist()
    a, b, c = numbers[:3]
    say(ann, a, b)
    frame = say(ann, a, c)
    assert [r["reference_object"] for r in frame.expressions.values() if r["text"] == TEXT] == [c]
    ann.save(edits.set_status(frame, edits.object_ref(FRAME, c, "status"), "rejected"))
    gone = ann.frame(FRAME)
    assert any(w.text == TEXT and "gone" in w.reason for w in gone.withdrawn)
    assert not any(r["text"] == TEXT for r in gone.expressions.values())


def test_a_sentence_of_the_labels_gets_the_pair_as_an_answer(desk: Open) -> None:
    ann = desk("ann")
    frame = ann.frame(FRAME)
    row = next(iter(frame.expressions.values()))
    other = next(n for n in frame.pairs.numbers.tolist() if n not in row["targets"] and n != row["reference_object"])
    words = row["target"], row["relation"], row["reference"]
    made = edits.add_sentence(frame, row["text"].upper(), words, other, row["reference_object"])
    assert isinstance(ann.save(made), Saved)
    assert other in ann.frame(FRAME).expressions[row["id"]]["targets"]


def test_a_file_of_edits_says_the_same_and_labels_carry_it(desk: Open, tmp_path: Path) -> None:
    ann = desk("ann")
    a, b = pair_where(ann.frame(FRAME), T)
    x, y = (ann.frame(FRAME).objects[n]["label"] for n in (a, b))
    action = {
        "edit": "true",
        "frame": FRAME,
        "text": f"the {x} left of the {y}",
        "target": x,
        "relation": "left",
        "reference": y,
        "a": a,
        "b": b,
    }
    journal = ann.location.to_write()
    assert isinstance(apply_actions(ann.corrector, journal, actions_of([action]), "bob"), Saved)
    materialise(ann.labels, journal, tmp_path / "effective")
    written = open_labels(tmp_path / "effective")
    assert action["text"] in written.expressions.column("text").to_pylist()
    found = [f for f in check_labels(written) if f.severity == "error"]
    assert not found, found
