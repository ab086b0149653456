"""Heads of rows, from the recorded columns alone, are those of the stories that are told of their answers."""

from __future__ import annotations

from collections import defaultdict

import pytest

from pipeline.datasets import demo_run
from pipeline.diagnosis import VERDICTS
from pipeline.diagnosis.story_words import STORIES
from pipeline.evaluation import open_run
from pipeline.evaluation.browsing import shown_rows
from pipeline.evaluation.row_stories import row_head

EACH = 3
"""Rows that are answered again, of each verdict with each detail."""
OLD = ("id", "frame", "text", "target", "reference", "verdict", "detail", "lucky", "said", "box")


def test_a_head_is_that_of_the_story():
    run = open_run(demo_run())
    kinds = defaultdict(list)
    for row in run.records.to_pylist():
        kinds[row["verdict"], row["detail"], row["lucky"]].append(row)
    assert len(kinds) > 15
    for rows in kinds.values():
        for row in rows[:: -(-len(rows) // EACH)]:
            found = run.answer(row["frame"], row["id"]).diagnosis
            assert found is not None
            assert row_head(row) == (found.story.tone, found.story.head), (row["text"], found.story)


@pytest.mark.parametrize("verdict", [None, *VERDICTS])
@pytest.mark.parametrize("detail", [None, "AMBIGUOUS", "DEGENERATE", "LOCALISATION", "SRM+CONF"])
def test_every_verdict_has_a_head_with_whatever_was_recorded(verdict, detail):
    tones = {tone for tone, _, _ in STORIES.values()}
    for answered in (None, [0.0, 0.0, 9.0, 9.0]):
        row = dict.fromkeys(OLD) | {"target": "mug", "reference": "shelf", "box": answered}
        tone, head = row_head(row | {"verdict": verdict, "detail": detail})
        assert tone in tones
        assert head[:1].isupper()
        assert "{" not in head
        assert "None" not in head


def test_rows_of_an_older_release_are_shown_with_heads():
    records = open_run(demo_run()).records.slice(0, 20).select(OLD)
    rows = shown_rows(records)
    assert all(row["head"] and "box" in row for row in rows)
    assert rows[0]["text"] == records.column("text")[0].as_py()
