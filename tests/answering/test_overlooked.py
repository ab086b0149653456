"""What a detector sees where it does not find what was asked for."""

from __future__ import annotations

from dataclasses import replace

import pytest

from pipeline.answering import Pipeline, open_pipeline
from pipeline.diagnosis import missed_names
from pipeline.geometry import Frame
from pipeline.proposals import Proposals


class Cut:
    """The demo's annotations as a detector that drops what has less than a score; the mugs have 0.125."""

    name = "cut"
    exact = False

    def __init__(self, source: Pipeline, least: float) -> None:
        self.inner, self.least = source.needed_detector(), least
        self.vocabulary = self.inner.vocabulary

    def fingerprint(self) -> str:
        return f"cut {self.least}"

    def detect(self, frame: Frame, labels: list[str] | None) -> Proposals:
        found = self.inner.detect(frame, labels)
        faint = [found.label(i) == "mug" for i in range(len(found))]
        scores = found.scores.copy()
        scores[faint] = 0.125
        return replace(found, scores=scores).take(scores >= self.least)


def test_what_was_not_found_is_looked_for_below_the_minimum_score() -> None:
    whole = open_pipeline("demo", srm="rule")
    frame = whole.dataset.load(whole.dataset.frame_ids[0])
    source = replace(whole, detector=Cut(whole, 0.3), open_unfiltered=lambda: Cut(whole, 0.0))
    trace = source.ask(frame, "mug left of the laptop")
    assert trace.missing == ("mug",)
    found = missed_names(source, trace)
    assert found.below == pytest.approx({"mug": 0.125})
    named = [one.label for one in frame.annotations]
    assert found.seen == {name: named.count(name) for name in named if name != "mug"}
    assert list(found.seen.values()) == sorted(found.seen.values(), reverse=True)
