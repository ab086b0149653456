"""The audit ranks planted wrong truths first: a small run of what prints the figures in the document."""

from __future__ import annotations

import pytest
from benchmarks.audited import RANKED, WAYS, audited, ranking
from benchmarks.people_words import LANGUAGE

from pipeline.datasets import demo_path


@pytest.mark.slow
def test_planted_truths_come_before_sound_ones() -> None:
    items, asked = audited(demo_path(), 3, slice(0, 12, 4), 30, systems=1)
    ways = [one.way for one in asked]
    found = {way: sum(one == way for one in ways) for way in WAYS}
    assert sum(found.values()) >= 9, found
    assert ways.count(None) >= 60
    by = {name: ranking(items, ways, kept) for name, kept in RANKED.items()}
    assert by["all"].auc > 0.85
    assert by["all"].precision > 3 * sum(found.values()) / len(ways)
    assert by["geometry, class, frame, several"].auc > 0.8


@pytest.mark.slow
@pytest.mark.skipif(not LANGUAGE.is_dir(), reason="the sentences that people wrote are not here")
def test_planted_truths_come_before_sound_ones_in_peoples_words() -> None:
    items, asked = audited(demo_path(), 3, slice(0, 12, 4), 30, systems=0, part=0)
    found = ranking(items, [one.way for one in asked], RANKED["all"])
    assert found.auc > 0.88
    misspelt = [i.score for i, one in zip(items, asked, strict=True) if one.sentence.kind == "misspelt"]
    assert misspelt
    assert max(misspelt) < 0.75
