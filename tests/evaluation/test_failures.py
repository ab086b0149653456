"""The expressions of a run that a search finds, as a table, and each of them answered again."""

from __future__ import annotations

import pyarrow as pa
import pytest
from slow_cases import mostly_slow

import pipeline
from pipeline.datasets import demo_run
from pipeline.evaluation import find_failures
from pipeline.system import InNotebook


@pytest.fixture(scope="module")
def run() -> pipeline.Run:
    return pipeline.open_run(demo_run())


def test_failures_are_those_of_the_search_as_an_arrow_table(run: pipeline.Run) -> None:
    found = run.failures("verdict:SRM,LIFT sort:margin")
    assert [f.row["id"] for f in found] == find_failures(run.records, found.search).column("id").to_pylist()
    assert {f.row["verdict"] for f in found} == {"SRM", "LIFT"}
    assert pa.table(found).equals(found.table)  # pyright: ignore[reportArgumentType]
    assert found.table.shape == (len(found), run.records.num_columns + 1)  # And the marks.
    assert repr(found) == f"<Failures 'verdict:SRM,LIFT sort:margin': {len(found)} expressions>"
    # What was not answered rightly: what the page lists, too, and one less the accuracy.
    wrong = [not right for right in run.records.column("set_correct").to_pylist()]
    assert len(run.failures()) == sum(wrong) < run.records.num_rows - run.verdicts["CORRECT"]
    with pytest.raises(pipeline.InputError, match="unknown field"):
        run.failures("verdikt:SRM")


def test_failures_are_a_sequence(run: pipeline.Run) -> None:
    found = run.failures("verdict:LIFT")
    assert found[-1].row == list(found)[-1].row
    assert [f.row["id"] for f in found[1:3]] == [f.row["id"] for f in found][1:3]
    with pytest.raises(IndexError):
        _ = found[len(found)]


@pytest.mark.parametrize(
    ("search", "most"),
    mostly_slow(
        [
            ("verdict:PARSE", 12),
            ("verdict:SRM", 1),
            ("verdict:LABEL detail:BAD_BOX", 1),
            ("verdict:LIFT", 1),
            ("", 600),
        ],
        fast=(0, 1, 2, 3),
        several=True,
    ),
)
def test_a_failure_answered_again_has_the_verdict_of_its_record(run: pipeline.Run, search: str, most: int) -> None:
    """All of those that were misread, and with the slow tests all failures of the run."""
    for failure in run.failures(search)[:most]:
        judged, told = failure.answer.diagnosis, tuple(failure.row[n] for n in ("verdict", "detail", "lucky", "said"))
        assert judged is not None
        assert (judged.verdict, judged.detail, judged.lucky, judged.text) == told
        assert failure.answer.text == failure.row["text"]


def test_an_expression_that_the_labels_do_not_have_is_said(run: pipeline.Run) -> None:
    frame = run.failures("verdict:SRM")[0].row["frame"]
    with pytest.raises(pipeline.InputError, match="the labels have no expression nothing of frame"):
        run.answer(frame, "nothing")


def test_a_result_shows_as_the_face_says_and_without_one_as_its_repr(
    run: pipeline.Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(InNotebook, "html_by", "builtins:repr")
    found = run.failures("verdict:OPM-REF")
    assert len(found) > 1
    assert found._repr_html_() == f"<Failures 'verdict:OPM-REF': {len(found)} expressions>"
    monkeypatch.setattr(InNotebook, "html_by", "")
    assert run._repr_html_() is None
