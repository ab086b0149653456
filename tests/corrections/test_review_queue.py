"""The review queue: what it ranks first, what it says of it, and how a review goes on."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest
from hypothesis import given
from hypothesis import strategies as st
from review_labels import with_relations

from pipeline.corrections import (
    STATES,
    DoubtConfig,
    ItemKey,
    item_keys,
    review_queue,
)
from pipeline.corrections.review.items import KINDS
from pipeline.labels import Labels, write_table
from pipeline.metrics import Agreement, cohen_kappa
from pipeline.system import InputError
from pipeline.training import TrainConfig


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
    queue = review_queue(labels, DoubtConfig(folds=3, train=train))
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


def test_the_linter_names_both_cells_of_a_contradiction(turned: tuple[Labels, ItemKey]) -> None:
    labels, key = turned
    queue = review_queue(labels)
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


@pytest.mark.parametrize("name", ["hostile", "empty"])
def test_odd_labels_have_a_queue(label_sets: dict[str, Labels], name: str, tmp_path: Path) -> None:
    queue = review_queue(label_sets[name])
    assert (queue.num_rows > 0) == (name == "hostile")
    write_table(queue, tmp_path / "queue.parquet")
    assert pq.read_table(tmp_path / "queue.parquet").equals(queue)


def test_nothing_to_learn_from_is_told(label_sets: dict[str, Labels]) -> None:
    with pytest.raises(InputError):
        review_queue(label_sets["empty"], DoubtConfig())


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
