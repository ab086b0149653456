"""The review queue: what it ranks first, what it says of it, and how a review goes on."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from hypothesis import given
from hypothesis import strategies as st
from review_labels import copied, with_relations

from pipeline.corrections import (
    STATES,
    DoubtConfig,
    ItemKey,
    QueueConfig,
    item_keys,
    left_to_review,
    review_queue,
    with_states,
)
from pipeline.corrections.review.evidence import matched_boxes
from pipeline.corrections.review.items import KINDS, progress_counts
from pipeline.labels import Labels, open_labels, write_table
from pipeline.metrics import Agreement, cohen_kappa
from pipeline.system import InputError
from pipeline.training import TrainConfig

RULES_ONLY = QueueConfig(doubts=None)


@pytest.fixture(scope="module")
def turned(label_sets: dict[str, Labels], tmp_path_factory: pytest.TempPathFactory) -> tuple[Labels, ItemKey]:
    """The demo's labels with one clear cell turned, of which an expression tells."""
    labels = label_sets["demo"]
    told = [row for row in labels.expressions.to_pylist() if row["relation"] == "left"]
    best = max(told, key=lambda row: row["margin"])
    key = ItemKey(best["frame"], "relation", best["target_object"], best["reference_object"], "left")
    frame, a, b = (labels.relations.column(n).to_numpy() for n in ("frame", "a", "b"))
    left = labels.relations.column("left").to_numpy().copy()
    left[(frame == key.frame) & (a == key.a) & (b == key.b)] = -1
    return with_relations(labels, tmp_path_factory.mktemp("turned") / "labels", {"left": left}), key


@pytest.mark.slow
def test_a_turned_cell_comes_first_with_its_reasons(turned: tuple[Labels, ItemKey]) -> None:
    labels, key = turned
    train = TrainConfig(vocabulary="all", epochs=2, batch=64)
    queue = review_queue(labels, QueueConfig(DoubtConfig(folds=3, train=train)))
    rank = item_keys(queue).index(key)
    assert rank <= 2
    row = queue.slice(rank, 1).to_pylist()[0]
    assert row["label"] == "F"
    assert row["probability"] > 0.9
    assert row["wrong"] > 0.1
    assert row["score"] >= row["wrong"]
    assert any("relation/geometry" in reason for reason in row["reasons"])
    assert any("networks" in reason for reason in row["reasons"])
    score = queue.column("score").to_numpy()
    assert (np.diff(score) <= 0).all()
    assert score.min() > 0
    assert score.max() <= 1
    keys = item_keys(queue)
    assert len(set(keys)) == len(keys)
    doubtful = [r for r in queue.to_pylist() if r["label"] == "U"]
    assert len(doubtful) > 50
    assert all(
        r["wrong"] is None and r["score"] <= 0.5
        for r in doubtful
        if r["kind"] == "relation" and not any("relation/" in reason for reason in r["reasons"])
    )


@pytest.mark.slow
def test_networks_alone_do_not_ask_the_linter(turned: tuple[Labels, ItemKey]) -> None:
    labels, _ = turned
    train = TrainConfig(vocabulary="all", epochs=1, batch=256)
    config = QueueConfig(DoubtConfig(folds=2, train=train), linter=False, margins=False, undecided=False)
    queue = review_queue(labels, config).slice(0, 40)
    assert queue.num_rows == 40
    assert set(queue.column("kind").to_pylist()) == {"relation"}
    assert {len(reasons) for reasons in queue.column("reasons").to_pylist()} == {1}
    np.testing.assert_allclose(queue.column("score").to_numpy(), queue.column("wrong").to_numpy())


def test_the_linter_names_both_cells_of_a_contradiction(turned: tuple[Labels, ItemKey]) -> None:
    labels, key = turned
    queue = review_queue(labels, RULES_ONLY)
    rows = dict(zip(item_keys(queue), queue.to_pylist(), strict=True))
    relations = [k for k in item_keys(queue) if k.kind == "relation"]
    assert relations[0] == key, "the extents contradict it, and its mirror image too"
    mirrored = rows[ItemKey(key.frame, "relation", key.b or 0, key.a, "right")]
    assert any("relation/inverse" in reason for reason in mirrored["reasons"])
    assert mirrored["score"] < rows[key]["score"]
    assert {row["kind"] for row in rows.values()} == set(KINDS)
    assert all(row["probability"] is None for row in rows.values())
    for row in rows.values():
        assert row["label"] is not None
        assert row["reasons"]


def test_other_labels_of_the_frames_dispute_names_places_and_relations(
    label_sets: dict[str, Labels], tmp_path: Path
) -> None:
    labels = label_sets["demo"]
    folder = copied(labels, tmp_path / "other")
    table = labels.objects
    names, boxes = table.column("label").to_pylist(), table.column("bbox").to_pylist()
    names[0] = "zebra"
    boxes[1] = [x + 5000 for x in boxes[1]]
    for column, values in (("label", names), ("bbox", boxes)):
        at = table.schema.get_field_index(column)
        table = table.set_column(at, table.schema.field(at), pa.array(values, table.schema.field(at).type))
    write_table(table, folder / "objects.parquet")
    states = labels.relations.column("above").to_numpy()
    row = int(
        np.flatnonzero(
            (states == 1)
            & (labels.relations.column("a").to_numpy() > 1)
            & (labels.relations.column("b").to_numpy() > 1)
        )[0]
    )
    changed = states.copy()
    changed[row] = -1
    other = with_relations(open_labels(folder), tmp_path / "both", {"above": changed})
    config = QueueConfig(doubts=None, linter=False, margins=False, undecided=False)
    queue = review_queue(labels, config, other=other)
    frame = labels.objects.column("frame")[0].as_py()
    first, second = (labels.objects.column("object")[k].as_py() for k in (0, 1))
    pair = labels.relations.slice(row, 1).to_pylist()[0]
    key = ItemKey(pair["frame"], "relation", pair["a"], pair["b"], "above")
    rows = dict(zip(item_keys(queue), queue.to_pylist(), strict=True))
    assert set(rows) == {ItemKey(frame, "object", first, None, ""), ItemKey(frame, "object", second, None, ""), key}
    assert "zebra" in rows[ItemKey(frame, "object", first, None, "")]["reasons"][0]
    assert rows[key]["label"] == "T"
    assert review_queue(labels, config, other=labels).num_rows == 0


def test_boxes_match_where_either_is_the_others_best() -> None:
    first = np.array([[0, 0, 10, 10], [20, 0, 30, 10], [21, 0, 31, 10], [50, 50, 60, 60]], float)
    second = np.array([[20, 0, 30, 10], [1, 0, 11, 10], [58, 58, 70, 70]], float)
    np.testing.assert_array_equal(matched_boxes(first, second), [1, 0, -1, -1])
    np.testing.assert_array_equal(matched_boxes(first, second[:0]), [-1] * 4)


@pytest.mark.parametrize("name", ["hostile", "empty"])
def test_odd_labels_have_a_queue(label_sets: dict[str, Labels], name: str, tmp_path: Path) -> None:
    queue = review_queue(label_sets[name], RULES_ONLY, other=label_sets[name])
    assert (queue.num_rows > 0) == (name == "hostile")
    assert [ItemKey.read(k.text()) for k in item_keys(queue)] == item_keys(queue)
    write_table(queue, tmp_path / "queue.parquet")
    assert pq.read_table(tmp_path / "queue.parquet").equals(queue)


def test_nothing_to_learn_from_is_told(label_sets: dict[str, Labels]) -> None:
    with pytest.raises(InputError):
        review_queue(label_sets["empty"])


@given(st.text(), st.sampled_from(KINDS), st.integers(-9, 10**6), st.none() | st.integers(0, 10**6), st.text())
def test_keys_read_back(frame: str, kind: str, a: int, b: int | None, what: str) -> None:
    key = ItemKey(frame, kind, a, b, what)
    assert ItemKey.read(key.text()) == key
    assert "\n" not in key.text()


@pytest.mark.parametrize(
    "text",
    [
        "",
        "[]",
        "[1,2,3,4,5]",
        '["f","pair",0,1,"left"]',
        '["f","relation",true,1,"left"]',
        '["f","relation",0,"1","left"]',
        "null",
    ],
)
def test_what_is_no_key_is_refused(text: str) -> None:
    with pytest.raises(InputError, match="key of a review item"):
        ItemKey.read(text)


@pytest.mark.slow
def test_a_review_goes_on_until_all_is_settled(turned: tuple[Labels, ItemKey]) -> None:
    queue = review_queue(turned[0], QueueConfig(doubts=None)).slice(0, 30)
    keys = item_keys(queue)
    states = {keys[0]: "corrected", keys[3]: "unsure", keys[5]: "rejected", keys[8]: "accepted"}
    gone = ItemKey("no frame", "relation", 0, 1, "left")
    counts = progress_counts(queue, {**states, gone: "accepted"})  # pyright: ignore[reportArgumentType]
    assert counts == {
        "items": 30,
        "unreviewed": 26,
        "accepted": 1,
        "corrected": 1,
        "rejected": 1,
        "unsure": 1,
        "settled": 3,
        "elsewhere": 1,
    }
    known = with_states(queue, states)  # pyright: ignore[reportArgumentType]
    assert known.column("state")[3].as_py() == "unsure"
    assert with_states(known, {}).column("state").to_pylist() == ["unreviewed"] * 30
    left = item_keys(left_to_review(queue, states))  # pyright: ignore[reportArgumentType]
    assert left == [k for k in keys if k not in states] + [keys[3]]
    with pytest.raises(InputError, match="no such state"):
        with_states(queue, {keys[0]: "done"})  # pyright: ignore[reportArgumentType]


judged = st.sampled_from(STATES[1:])


@pytest.mark.slow
@given(st.lists(st.tuples(judged, judged), min_size=1, max_size=60))
def test_kappa_is_that_of_scikit_learn(pairs: list[tuple[str, str]]) -> None:
    from sklearn.metrics import cohen_kappa_score

    first, second = [p[0] for p in pairs], [p[1] for p in pairs]
    found = cohen_kappa(first, second)
    assert found.items == len(pairs)
    if len({*first, *second}) > 1:
        assert found.kappa == pytest.approx(cohen_kappa_score(first, second))
    else:
        assert np.isnan(found.kappa)
        assert found.record()["kappa"] is None


def agreement_of(first: Mapping[int, str], second: Mapping[int, str]) -> Agreement:
    """Agreement on the items that both have reviewed: "unreviewed" is no judgement."""
    none = "unreviewed"
    both = [key for key, said in first.items() if said != none and second.get(key, none) != none]
    return cohen_kappa([first[key] for key in both], [second[key] for key in both])


def test_agreement_is_of_what_both_reviewed() -> None:
    first = {1: "accepted", 2: "corrected", 3: "unreviewed", 4: "accepted", 5: "unsure"}
    second = {1: "accepted", 2: "accepted", 3: "accepted", 4: "unreviewed", 6: "accepted"}
    found = agreement_of(first, second)
    assert found.items == 2
    assert found.observed == 0.5
    assert np.isnan(agreement_of({}, second).kappa)
    with pytest.raises(InputError):
        cohen_kappa(["accepted"], [])
