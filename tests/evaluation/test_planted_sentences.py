"""Planted faults in sentences with attributes: each module is broken in turn, and the verdict names it."""

from __future__ import annotations

from collections import Counter

import pytest
from benchmarks.planted_sentences import KINDS, planted_sentence_failures

from pipeline.answering import open_pipeline
from pipeline.diagnosis import ALL_ORACLES

pytestmark = pytest.mark.slow


@pytest.mark.parametrize("truth", ["typed", "given"])
def test_the_verdict_names_the_planted_module(truth: str, outcomes: list) -> None:
    by_module: dict[str, Counter[str]] = {}
    for o in outcomes:
        by_module.setdefault(o.module, Counter())[getattr(o, truth).verdict] += 1
    assert set(by_module) == set(KINDS)
    for module, verdicts in by_module.items():
        # Where boxes of books that lie on each other are moved, another book's box may count as the right one.
        assert verdicts[module] >= (0.8 if module in ("OPM-TARGET", "LIFT") else 0.95) * verdicts.total(), verdicts


@pytest.fixture(scope="module")
def outcomes() -> list:
    source = open_pipeline("demo", srm="rule")
    return list(planted_sentence_failures(source, frames=slice(3, 4), every=40, every_bare=2))


def test_a_wrong_attribute_is_never_the_relations_fault(outcomes: list) -> None:
    """And the other way round, with Shapley's oracles in both."""
    for o in outcomes:
        for d in (o.typed, o.given):
            assert d.oracles == ALL_ORACLES
            if o.module == "ATTRIBUTE":
                assert d.verdict != "SRM", o.text
            if o.module == "SRM":
                assert d.verdict != "ATTRIBUTE", o.text
