"""Answers that stand beside proposals and probabilities: what was answered is judged, and nothing in its place."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest
from benchmarks.other_pipeline import CENTRES, lines

from pipeline.answering.opening import open_pipeline
from pipeline.answering.predictions import GivenAnswer, Header, Prediction, write_predictions
from pipeline.datasets.demo import demo_labels
from pipeline.evaluation.importing import import_run
from pipeline.evaluation.job import RunReport
from pipeline.evaluation.run_folder import open_run
from pipeline.labels.reading import open_labels
from pipeline.system.errors import InputError


@pytest.fixture(scope="module")
def given() -> list[Prediction]:
    """What a pipeline without a fault gives of one frame in level 3, where it answers right."""
    dataset, labels = open_pipeline("demo", srm="rule").dataset, open_labels(demo_labels())
    found = [x.line for x in lines(CENTRES, dataset, labels, 4, every=10, share=0.0)]
    return [line for line in found if line.frame == found[0].frame]


def imported(folder: Path, given: list[Prediction], header: Header = CENTRES.header) -> tuple[RunReport, list[str]]:
    write_predictions(folder / "p.jsonl", header, given)
    report = import_run(folder / "p.jsonl", "demo", demo_labels(), folder / "run", plots=False)
    return report, open_run(folder / "run").records.column("verdict").to_pylist()


def test_answers_among_the_proposals_are_mostly_right(given: list[Prediction], tmp_path: Path) -> None:
    assert imported(tmp_path, given)[1].count("CORRECT") > 0.6 * len(given)


@pytest.mark.parametrize("ranking", ["pair_scores", "product", "none"])
@pytest.mark.parametrize(
    "answer", [GivenAnswer(point=(5.0, 5.0)), GivenAnswer(box=(0.0, 0.0, 20.0, 20.0)), GivenAnswer(yes=False)]
)
def test_an_answer_that_is_no_proposal_is_not_replaced_by_the_best_pair(
    given: list[Prediction], tmp_path: Path, answer: GivenAnswer, ranking: str
) -> None:
    pairs = {} if ranking == "pair_scores" else {"pairs": None}
    wrong = [replace(line, answer=answer, **pairs) for line in given]  # type: ignore[arg-type]
    header = replace(CENTRES.header, ranking=ranking)  # type: ignore[arg-type]
    _, verdicts = imported(tmp_path, wrong, header)
    assert len(verdicts) == len(given)
    assert set(verdicts) <= {"UNEXPLAINED", "LIFT", "OPM-TARGET", "OPM-REF", "LABEL"}


def test_ends_that_are_swapped_are_refused_with_their_line(given: list[Prediction], tmp_path: Path) -> None:
    line = next(x for x in given if x.answer and x.answer.reference is not None)
    assert line.answer is not None
    swapped = GivenAnswer(object=line.answer.reference, reference=line.answer.object)
    with pytest.raises(InputError, match=r"line 2, answer: the answer is no pair"):
        imported(tmp_path, [replace(line, answer=swapped)])
    assert not (tmp_path / "run").exists()


def _shares(x: float, size: int) -> float:
    return x / size


def _half(x: float, size: int) -> float:
    return x / 2


def resized(given: list[Prediction], change: Callable[[float, int], float]) -> list[Prediction]:
    """Level 1, with all 2D boxes changed."""
    found = []
    for line in given:
        proposals = {
            name: tuple(
                replace(p, mask=None, box=tuple(change(v, s) for v, s in zip(p.box, (640, 480, 640, 480), strict=True)))  # type: ignore[arg-type]
                for p in every
            )
            for name, every in (line.proposals or {}).items()
        }
        found.append(replace(line, proposals=proposals, boxes_3d=None, relations=None, pairs=None))
    return found


def test_boxes_that_are_smaller_than_a_pixel_are_refused(given: list[Prediction], tmp_path: Path) -> None:
    with pytest.raises(InputError, match='"box_unit": "shares"'):
        imported(tmp_path, resized(given, _shares))


def test_boxes_that_lie_on_nothing_are_told(given: list[Prediction], tmp_path: Path) -> None:
    told = "lies on a labelled object"
    assert any(told in words for words in imported(tmp_path, resized(given, _half))[0].warnings)
    (tmp_path / "whole").mkdir()
    assert not any(told in words for words in imported(tmp_path / "whole", given)[0].warnings)
