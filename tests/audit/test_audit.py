"""The audit: each kind of evidence on a frame whose truth is known, and how pieces are joined."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from scenes import frame_of, upright

from pipeline.answering import Pipeline, open_pipeline
from pipeline.audit import AuditReport
from pipeline.audit.report import audit
from pipeline.audit.sentences import FACING, UNDECIDED, audit_sentences, has_front
from pipeline.audit.suspicion import (
    PRIOR,
    AuditItem,
    Evidence,
    SystemAnswers,
    agreement_weight,
    read_answers,
    wrong_probability,
)
from pipeline.datasets import InMemoryDataset
from pipeline.diagnosis import decode
from pipeline.evaluation import Sentence, SentenceFile
from pipeline.labels import Labels
from pipeline.system import InputError

LABELS = ["mug", "mug", "chair", "vase", "book"]
BOXES = [
    upright((-0.7, 1.0, 2.5), (0.15, 0.2, 0.15)), upright((0.7, 1.0, 2.5), (0.15, 0.2, 0.15)),
    upright((0, 0.9, 2.5), (0.5, 0.6, 0.5)), upright((0.0, 1.0, 2.1), (0.15, 0.2, 0.15)),
    upright((-0.75, 1.1, 1.8), (0.2, 0.1, 0.2)),
]  # fmt: skip
"""From left to right: a mug, the chair with a vase before it, another mug; a book before the first mug."""
LEFT, RIGHT, CHAIR, VASE, BOOK = range(5)


@pytest.fixture(scope="module")
def source() -> Pipeline:
    return open_pipeline(InMemoryDataset([frame_of(BOXES, LABELS, name="room")]))


def item(source: Pipeline, text: str, right: int | None, systems: tuple[SystemAnswers, ...] = ()) -> AuditItem:
    targets = () if right is None else (right,)
    asked = SentenceFile(Path("x"), (Sentence(1, "room", text, "plain", targets=targets),), {})
    (found,) = audit_sentences(source, asked, systems)
    return found


@pytest.mark.parametrize(
    ("text", "right", "kind", "seems"),
    [
        ("the mug left of the vase", LEFT, None, None),
        ("the mug left of the vase", RIGHT, "geometry", "mug·0"),
        ("the mug left of the chair", RIGHT, "frame", None),
        ("the mug left of the chair", BOOK, "class", "mug·0"),
        ("the mug near the zebra", LEFT, "unjudged", None),
        ("the vase behind the book", VASE, "geometry", None),
        ("the mug left of the vase", None, "geometry", "mug·0"),
        ("the mug behind the book", None, "geometry", "mug·0"),
    ],
)
def test_each_kind_of_wrong_truth(source: Pipeline, text: str, right: int | None, kind: str | None, seems: str) -> None:
    found = item(source, text, right)
    if kind == "unjudged":
        assert found.unjudged
        assert found.score == pytest.approx(PRIOR)
        return
    assert [e.kind for e in found.reasons] == ([] if kind is None else [kind])
    assert found.seems == seems
    assert (found.score > PRIOR) == (kind is not None)


BOOKS = [upright((x, 0.92, 2.5), (0.2, 0.25, 0.2)) for x in (-0.9, -0.3, 0.3, 0.9)] + [
    upright((0.0, 1.1, 2.5), (2.4, 0.1, 0.6)),
    upright((0.9, 0.95, 2.05), (0.2, 0.3, 0.2)),
]


@pytest.fixture(scope="module")
def shelf() -> Pipeline:
    """Four books from left to right on a desk, a potted plant before the last one."""
    return open_pipeline(InMemoryDataset([frame_of(BOOKS, ["book"] * 4 + ["desk", "potted plant"], name="room")]))


@pytest.mark.parametrize(
    ("text", "opposite", "right"),
    [
        ("the leftmost book", "the rightmost book", 0),
        ("second book from the left", "second book from the right", 1),
        ("Pick op the book on the right side of the picture", "Pick op the book on the left side of the picture", 3),
        ("the book closest to the plant", "the book farthest from the plant", 3),
        ("grab the book that is behind the plant", "grab the book that is in front of the plant", 3),
        ("the plant closest to me", "the book farthest from me", 5),
    ],
)
def test_opposite_words_are_found(shelf: Pipeline, text: str, opposite: str, right: int) -> None:
    sound, planted = item(shelf, text, right), item(shelf, opposite, right)
    assert sound.score <= UNDECIDED
    assert planted.score > 0.4


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("the lap on the table", "“lap” is not known"),
        ("the bok in front of the shelv", "“bok” is read as “book”"),
        ("the leftmost boko", "“boko” is read as “book”"),
        ("the rightmost plamt", "“plamt” is read as “plant”"),
    ],
)
def test_a_misspelt_word_is_weak_evidence_and_told(shelf: Pipeline, text: str, told: str) -> None:
    for right in range(len(BOOKS)):
        found = item(shelf, text, right)
        assert found.score <= 0.35, [e.text for e in found.evidence]
        assert told in (found.unjudged or "".join(e.text for e in found.evidence))


@pytest.mark.parametrize("name", ["plant", "potted plant", "house plant", "plants", "pottedplant"])
def test_a_thing_may_be_called_otherwise_than_it_is_annotated(shelf: Pipeline, name: str) -> None:
    assert "class" not in [e.kind for e in item(shelf, f"the {name} in front of the book", 5).evidence]
    assert [e.kind for e in item(shelf, f"the {name} in front of the book", 0).reasons] == ["class"]


def test_what_is_not_annotated_or_not_read_is_no_evidence(shelf: Pipeline) -> None:
    for text in (
        "the leftmost book on the floor",
        "the leftmost book, leaning against the wall",
        "the leftmost old book",
    ):
        assert item(shelf, text, 0).score <= PRIOR
        assert item(shelf, text, 3).score > 0.4
    assert item(shelf, "the book near the keyboard", 0).unjudged


def test_attributes_are_no_part_of_the_name(source: Pipeline) -> None:
    assert "class" not in [e.kind for e in item(source, "the small mug left of the vase", LEFT).evidence]
    assert [e.kind for e in item(source, "the small mug left of the vase", BOOK).reasons] == ["class"]


def test_a_frame_that_cannot_be_used_leaves_its_items_to_the_systems(source: Pipeline) -> None:
    asked = SentenceFile(Path("x"), (Sentence(1, "absent", "the mug", "plain", targets=(1,)),), {})
    (found,) = audit_sentences(source, asked)
    assert "no frame 'absent'" in (found.unjudged or "")
    assert (found.truth, found.score) == ("targets [1]", pytest.approx(PRIOR))


def test_words_say_how_far_the_rule_is_from_the_truth(source: Pipeline) -> None:
    (reason,) = item(source, "the mug left of the vase", RIGHT).reasons
    assert reason.text.startswith("mug·1 is not left of the vase by ")
    assert reason.text.endswith("; it holds of mug·0")
    assert dict(reason.figures)["margin"] < -0.1
    (reason,) = item(source, "the mug left of the chair", RIGHT).reasons
    assert "if the chair faces towards the viewer" in reason.text


def test_several_right_answers_count_where_the_sentence_says_the(source: Pipeline) -> None:
    both = [upright((-0.7, 1.0, 2.5), (0.15, 0.2, 0.15)), upright((-1.1, 1.0, 2.3), (0.15, 0.2, 0.15)), BOXES[VASE]]
    own = open_pipeline(InMemoryDataset([frame_of(both, ["mug", "mug", "vase"], name="room")]))
    definite, any_of = item(own, "the mug left of the vase", 0), item(own, "a mug left of the vase", 0)
    assert [e.kind for e in definite.reasons] == ["several"]
    assert definite.seems == "mug·0, mug·1"
    assert definite.score > any_of.score


def answered(source: Pipeline, name: str, text: str, index: int) -> SystemAnswers:
    bbox = source.dataset.load("room").annotations[index].bbox
    return SystemAnswers(name, {("room", text): tuple(float(v) for v in bbox)})


def test_systems_that_agree_against_the_truth_count_and_so_do_those_that_give_it(source: Pipeline) -> None:
    text = "the mug left of the vase"
    said = ((RIGHT, RIGHT, RIGHT), (RIGHT, RIGHT, LEFT), (RIGHT, BOOK, CHAIR), (LEFT, LEFT, LEFT))
    at = [
        item(source, text, LEFT, tuple(answered(source, f"s{k}", text, i) for k, i in enumerate(given)))
        for given in said
    ]
    scores = [found.score for found in at]
    assert scores == sorted(scores, reverse=True)
    assert scores[0] > 4 * scores[-1]
    (reason,) = at[0].reasons
    assert reason.text.startswith("3 of 3 systems give the same other answer, mug·1 (s0, s1, s2)")
    assert at[0].seems == "mug·1"


def test_own_sides_are_rotations_of_the_viewers() -> None:
    for sides in FACING.values():
        assert sorted(sides) == sorted(sides.values())
        # Left and right stay opposite, and so do front and behind.
        pairs = {frozenset((sides["left"], sides["right"])), frozenset((sides["front"], sides["behind"]))}
        assert pairs == {frozenset(("left", "right")), frozenset(("front", "behind"))}
    assert has_front("office chair")
    assert has_front("TV")
    assert not has_front("mug")


weights = st.lists(st.tuples(st.sampled_from(["geometry", "several", "systems"]), st.floats(0.01, 0.97)), max_size=5)


@given(weights, st.floats(0.06, 0.97))
def test_one_piece_gives_its_weight_and_more_evidence_moves_the_score_its_way(
    given_weights: list[tuple[str, float]], more: float
) -> None:
    pieces = [Evidence(kind, weight, "") for kind, weight in given_weights]  # pyright: ignore[reportArgumentType]
    assert wrong_probability([Evidence("class", more, "")]) == pytest.approx(more)
    base = wrong_probability(pieces)
    assert 0 < base < 1
    assert wrong_probability([*pieces, Evidence("class", more, "")]) >= base
    assert wrong_probability([*pieces, Evidence("class", 0.02, "")]) <= base
    assert wrong_probability(reversed(pieces)) == pytest.approx(base)


def test_what_systems_say_is_symmetric() -> None:
    assert agreement_weight(2, 2) == pytest.approx(PRIOR)
    assert agreement_weight(3, 0) > agreement_weight(1, 0) > PRIOR > agreement_weight(0, 1) > agreement_weight(0, 3)


def test_runs_on_sentences_are_read(tmp_path: Path) -> None:
    other = {"frame": "000001/000000", "sentence": "the mug", "answer": {"bbox": [0, 0, 9, 9]}}
    for name in ("first", "second", "third"):
        (tmp_path / name).mkdir()
        lines = [other, {**other, "sentence": "none", "answer": None}]
        (tmp_path / name / "sentences.jsonl").write_text("".join(json.dumps(line) + "\n" for line in lines))
    systems = [read_answers(tmp_path / name) for name in ("first", "second", "third")]
    assert all(len(s.boxes) == 1 for s in systems)
    with pytest.raises(InputError, match="no run here"):
        read_answers(tmp_path)
    (tmp_path / "first" / "sentences.jsonl").write_text('{"frame": 1}\n')
    with pytest.raises(InputError, match="damaged"):
        read_answers(tmp_path / "first")


def test_sentences_need_their_dataset(tmp_path: Path) -> None:
    path = tmp_path / "s.jsonl"
    path.write_text('{"frame": "000001/000000", "sentence": "the mug left of the laptop", "targets": [4]}\n')
    with pytest.raises(InputError, match="--dataset DATASET"):
        audit(path)
    report = audit(path, "demo")
    assert report.items[0].reasons
    *command, view = report.look(report.items[0]).split(" ")
    assert command == ["spatialviz", "view", "demo", "--state"]
    opened = decode(view)
    assert (opened.dataset, opened.frame, opened.expression) == ("demo", "000001/000000", "the mug left of the laptop")
    with pytest.raises(InputError, match="nothing to audit"):
        audit(tmp_path / "absent", "demo")


def test_labels_are_reviewed(label_sets: dict[str, Labels]) -> None:
    with pytest.raises(InputError, match="spatialviz review"):
        audit(label_sets["demo"].root)


def test_the_files_hold_every_item_by_rank(tmp_path: Path) -> None:
    strong, weak = (
        AuditItem(name, "f", 'a, "b"', "x", evidence=(Evidence("class", w, f"because of {name}"),))
        for name, w in (("strong", 0.9), ("weak", 0.3))
    )
    report = AuditReport.ranked("D", [weak, strong])
    report.write(tmp_path / "a.jsonl")
    lines = [json.loads(line) for line in (tmp_path / "a.jsonl").read_text().splitlines()]
    assert [line["id"] for line in lines] == ["strong", "weak"]
    assert lines[0]["look"].startswith("spatialviz view D --state sv1:")
    with pytest.raises(InputError, match="JSON lines"):
        report.write(tmp_path / "a.csv")
    assert report.record()["expected_wrong"] == 1.2
