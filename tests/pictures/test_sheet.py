"""Sheet of a run's failures: spread over verdicts and frames, the same each time."""

from __future__ import annotations

import pytest

from pipeline import InputError, Run, open_run
from pipeline.datasets.demo import demo_run
from pipeline.pictures.sheet import MOST, best_failures, failures_sheet


@pytest.fixture(scope="module")
def run() -> Run:
    return open_run(demo_run())


def test_each_verdict_has_its_turn(run: Run) -> None:
    found = best_failures(run)
    assert len(found) == MOST
    shown = [f.row["verdict"] for f in found]
    counts = {v: n for v, n in run.verdicts.items() if v not in ("CORRECT", "LABEL")}
    assert shown[: len(counts)] == sorted(counts, key=lambda v: (-counts[v], v))
    assert shown[len(counts)] == "LABEL"
    assert [(f.row["frame"], f.row["id"]) for f in found] == [(f.row["frame"], f.row["id"]) for f in best_failures(run)]


def test_frames_and_targets_change(run: Run) -> None:
    found = best_failures(run, "verdict:OPM-TARGET")
    frames = set(run.failures("verdict:OPM-TARGET").table.column("frame").to_pylist())
    assert {f.row["frame"] for f in found} == frames
    assert not any(f.row["ambiguous"] for f in found[:3])


def test_a_sheet_holds_as_many_as_there_are(run: Run) -> None:
    told = []
    failures = best_failures(run, "verdict:PRM,SRM")
    image = failures_sheet(run, failures, lambda done, of: told.append((done, of)))
    assert told == [(k + 1, len(failures)) for k in range(len(failures))]
    assert image.shape[1] > 2400
    more = failures_sheet(run, [failures[0]] * 4)
    assert more.shape[0] > image.shape[0]


def test_nothing_to_draw_is_said(run: Run) -> None:
    assert best_failures(run, "class:nosuchclass") == []
    with pytest.raises(InputError, match="no failure to draw"):
        failures_sheet(run, [])
