"""Cases of questions of which the detector refuses a name."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from test_failure_case import keep
from whatif_scenes import ScoringDetector

from pipeline.diagnosis import answer_record, open_case
from pipeline.diagnosis.cases.replay import replay_case
from pipeline.geometry import Frame
from pipeline.proposals import Proposals
from pipeline.system import UnknownClass


class NoLaptops(ScoringDetector):
    def detect(self, frame: Frame, labels: Sequence[str] | None) -> Proposals:
        if labels is not None and "laptop" in labels:
            raise UnknownClass("the model does not know the class 'laptop'", cause="known: book, mug, table")
        found = super().detect(frame, labels)
        return found.take(np.arange(len(found) // 2))


def test_a_reference_that_the_detector_does_not_know_is_kept_as_left_out(tmp_path: Path) -> None:
    kept = open_case(keep(tmp_path / "case", NoLaptops(), text="book left of the laptop"))
    (unused,) = answer_record(kept.answer())["expression"]["unused"]
    assert unused == {"text": "laptop", "why": "the model does not know the class 'laptop'"}
    assert replay_case(kept).same
