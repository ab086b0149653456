"""The dataset card of labels."""

from __future__ import annotations

from collections import Counter

import pytest

from pipeline.labels import TABLES, Labels
from pipeline.labels.report import dataset_card


def front_matter(card: str) -> dict[str, object]:
    yaml = pytest.importorskip("yaml")
    _, head, _ = card.split("---\n", 2)
    return yaml.safe_load(head)


def test_the_card_says_what_the_tables_hold(label_sets: dict[str, Labels]) -> None:
    labels = label_sets["demo"]
    card = dataset_card(labels)
    head = front_matter(card)
    assert head["license"] == "unknown"
    assert head["size_categories"] == ["1K<n<10K"]
    configs = head["configs"]
    assert isinstance(configs, list)
    assert [c["config_name"] for c in configs] == list(TABLES)
    assert all((labels.root / c["data_files"][0]["path"]).is_file() for c in configs)
    left = Counter(labels.relations.column("left").to_pylist())
    expressions = Counter(labels.expressions.column("relation").to_pylist())
    assert f"| left | {left[1]} | {left[0]} | {left[-1]} | {expressions['left']} |" in card
    states = [s for r in labels.relation_names for s in labels.relations.column(r).to_pylist()]
    assert f"(U): {states.count(0) / len(states):.1%} of" in card
    ambiguous = sum(labels.expressions.column("ambiguous").to_pylist())
    assert f"acceptable answer: {ambiguous} ({ambiguous / labels.expressions.num_rows:.1%})" in card
    assert labels.manifest.profile_hash in card
    assert "unknown: ask the dataset's owner" in card


def test_the_card_bears_odd_names(label_sets: dict[str, Labels]) -> None:
    for kind in ("hostile", "empty"):
        card = dataset_card(label_sets[kind], licence='Ask "us": yes')
        assert front_matter(card)["license_name"] == 'Ask "us": yes'
        assert front_matter(card)["pretty_name"] == "Spatial relations of odd `name`"
        # Where somebody keeps the dataset is nobody's business.
        assert "/data/" not in card
