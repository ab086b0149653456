"""Settings by which failures may be mended, counted over a run."""

from __future__ import annotations

import pytest

from pipeline.datasets import demo_run
from pipeline.evaluation import evaluate_labels, open_run
from pipeline.evaluation.comparing import changes, shared_rows
from pipeline.evaluation.mend_counts import SettingChange, count_mends, mend_setting, under
from pipeline.system.arrow import pa


def setting_of(search: str) -> SettingChange | None:
    run = open_run(demo_run())
    found = run.failures(search)[0].answer.diagnosis
    assert found is not None
    return mend_setting(run, found)


def test_each_kind_has_the_setting_that_one_would_try() -> None:
    assert setting_of("verdict:OPM-TARGET detail:THRESHOLD") == SettingChange("min_score", 0.015, 0.009)
    assert setting_of("verdict:OPM-TARGET detail:RANK") == SettingChange("k", 5, 6)
    assert setting_of("verdict:SRM") == SettingChange("srm", "rel32", "rule")
    assert setting_of("verdict:PRM -detail:DEGENERATE") == SettingChange("relation_weight", 1.0, 4.6)
    for nothing in ("detail:ABSENT", "detail:LOCALISATION", "verdict:LIFT", "detail:DEGENERATE"):
        assert setting_of(nothing) is None


def test_counts_are_those_of_an_evaluation_under_the_setting() -> None:
    run, setting = open_run(demo_run()), SettingChange("min_score", 0.015, 0.009)
    failure = run.failures("verdict:OPM-TARGET detail:THRESHOLD")[0]
    found = count_mends(run, setting, (failure.row["frame"], failure.row["id"]))
    again = pa.concat_tables(evaluate_labels(under(run, setting).spec))
    own, other = shared_rows(run.records, again)
    became = changes(run.records.take(own), again.take(other)).tolist()
    assert (found.mended, found.broken) == (became.count("fixed"), became.count("broken"))
    assert found.looked == found.total == 1800
    said = f"minimum score 0.009 in place of 0.015: {found.mended} mended, {found.broken} broken. This answer "
    assert found.said.startswith(said)
    row = next(r for r in again.to_pylist() if (r["frame"], r["id"]) == (failure.row["frame"], failure.row["id"]))
    assert found.this == row["set_correct"]


def test_without_time_so_many_are_looked_at() -> None:
    found = count_mends(open_run(demo_run()), SettingChange("k", 5, 6), seconds=0.0)
    assert 0 < found.looked < found.total
    assert found.said.endswith(f"of {found.looked} looked at.")
    assert found.this is None


@pytest.mark.parametrize("name", ["min_score", "k"])
def test_the_run_stays_as_it_was(name: str) -> None:
    run = open_run(demo_run())
    under(run, SettingChange(name, None, 7 if name == "k" else 0.5))
    assert run.spec == open_run(demo_run()).spec
