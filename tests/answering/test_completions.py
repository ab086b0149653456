"""What may come next of an expression that is typed."""

from __future__ import annotations

from pipeline.diagnosis import completions
from pipeline.diagnosis.suggestions import OFFERED

LABELS = ("mug", "lamp", "trash can", "mug")


def texts(typed: str, examples: tuple[str, ...] = (), asked: tuple[str, ...] = ()) -> list[str]:
    return [offer["text"] for offer in completions(typed, LABELS, examples, asked)]


def test_before_anything_is_typed_whole_questions_are_offered_once_those_asked_before_first() -> None:
    offers = completions("", LABELS, ("mug left of the lamp", "lamp near the mug"), ("Lamp near the mug",))
    assert [(o["text"], o["kind"], o["detail"]) for o in offers] == [
        ("Lamp near the mug", "question", "asked before"),
        ("mug left of the lamp", "question", "example"),
    ]


def test_a_word_that_is_begun_is_completed_by_names_of_the_frame_and_relations() -> None:
    assert texts("trash") == ["trash can"]
    assert "lamp" in texts("mug left of the l")
    assert "left of" in texts("mug l")
    assert "lamp" not in texts("clam"), "the middle of a word begins none"


def test_after_a_name_a_relation_is_due_and_after_a_relation_a_name() -> None:
    after_name = completions("mug ", LABELS)
    assert {o["kind"] for o in after_name} == {"relation"}
    assert len(after_name) == OFFERED
    assert texts("mug left of the ") == ["mug", "lamp", "trash can"]


def test_a_question_that_is_typed_in_full_is_not_offered() -> None:
    assert texts("mug left of the lamp", ("mug left of the lamp",)) == []
