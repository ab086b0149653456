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
    found = best_failures(run.failures())
    assert len(found) == MOST
    shown = [f.row["verdict"] for f in found]
    counts = {v: n for v, n in run.verdicts.items() if v not in ("CORRECT", "LABEL")}
    assert shown[: len(counts)] == sorted(counts, key=lambda v: (-counts[v], v))
    assert shown[len(counts)] == "LABEL"
    assert [f.row["id"] for f in found] == [f.row["id"] for f in best_failures(run.failures())]


def test_frames_and_targets_change(run: Run) -> None:
    found = best_failures(run.failures("verdict:OPM-TARGET"))
    frames = set(run.failures("verdict:OPM-TARGET").table.column("frame").to_pylist())
    assert {f.row["frame"] for f in found} == frames
    assert not any(f.row["ambiguous"] for f in found[:3])


def test_a_sheet_holds_as_many_as_there_are(run: Run) -> None:
    told = []
    count = len(run.failures("verdict:PRM,SRM"))
    assert count == 3
    image = failures_sheet(run, "verdict:PRM,SRM", lambda done, of: told.append((done, of)))
    assert told == [(k + 1, count) for k in range(count)]
    assert image.shape[1] > 2400
    more = failures_sheet(run, "verdict:PRM,SRM,COMPOUND")
    assert more.shape[0] > image.shape[0] + 400


def test_nothing_to_draw_is_said(run: Run) -> None:
    with pytest.raises(InputError, match=r"no failure to draw \(the search finds none"):
        failures_sheet(run, "class:nosuchclass")
