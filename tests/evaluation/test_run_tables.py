"""Several runs in one table: every system has its rows, under a name of its own."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import pytest
from chat_server import MODELS, Clock, running

from pipeline.answering import open_pipeline, record_detections
from pipeline.evaluation import PERFECT, EvalSpec, RunReport, evaluate_dataset
from pipeline.evaluation.grounding_tables import relation_gain
from pipeline.evaluation.job import other_systems
from pipeline.evaluation.leakage import SIMULATED
from pipeline.labels import Makers, SourceSpec, label_dataset, open_labels
from pipeline.metrics import BootstrapConfig, Estimate
from pipeline.paper import Referring, Vlm
from pipeline.system import InputError

FRAMES = 3
EXPRESSIONS = 60
QUICK = BootstrapConfig(resamples=200)
MAKERS = Makers(None, "", None, None, None, None)
VLM = f"VLM {MODELS[0]}"


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Labels, and a run of every kind of system."""
    out = tmp_path_factory.mktemp("runs")
    label_dataset(SourceSpec("demo"), out / "labels", limit=FRAMES)
    source = open_pipeline("demo", detector="simulated", srm="rule")
    names, frames = source.dataset.class_names, source.dataset.frame_ids[:FRAMES]
    record_detections(source, out / "found.json", names, frame_ids=frames)
    for name in ("annotations", "simulated"):
        evaluated(out, name, detector=name)
    whole = EvalSpec(
        "demo", str(out / "labels"), {"detector": "simulated", "srm": "rule"}, system=Referring(), limit=EXPRESSIONS
    )
    evaluate_dataset(whole, out / "whole", plots=False, bootstrap=QUICK)
    with pytest.MonkeyPatch.context() as patch, running(Clock()) as server:
        patch.setenv("SPATIALVIZ_CACHE", str(out / "cache"))
        server.answer = lambda _: "[0.25, 0.25, 0.75, 0.75]"
        model = Vlm(server.url, MODELS[0])
        asked = EvalSpec("demo", str(out / "labels"), {"srm": "rule"}, model, limit=9)
        evaluate_dataset(asked, out / "vlm", plots=False, bootstrap=QUICK)
    return out


def evaluated(
    folder: Path, name: str, others: tuple[str, ...] = (), plots: bool = False, **options: object
) -> RunReport:
    spec = EvalSpec("demo", str(folder / "labels"), {"srm": "rule", **options}, limit=EXPRESSIONS)
    return evaluate_dataset(
        spec, folder / name, others=[folder / o for o in others], plots=plots, bootstrap=QUICK, overwrite=True
    )


@pytest.mark.slow
def test_every_detector_has_its_rows(folder: Path) -> None:
    pytest.importorskip("matplotlib", reason="the extra report is not installed")
    others = ("annotations", "simulated", "whole", "vlm")
    report = evaluated(folder, "recorded", others, plots=True, detector="recorded", model=folder / "found.json")
    tables = {table.key: table for table in report.tables}
    names = [row.name for row in tables["grounding"].rows if row.source == "measured"]
    # What is simulated out of the truth stands below what is not, and the truth itself below that.
    detectors = ("recorded + rule", "simulated + rule", "annotations + rule")
    pairs = [name for d in detectors for name in (f"{d}: OPM only", d)]
    assert names == [VLM, *pairs[:4], "simulated, whole expression", *pairs[4:]]
    assert [row.shares for row in tables["grounding"].rows if row.source == "measured"] == [
        "",
        *[SIMULATED] * 5,
        *[PERFECT] * 2,
    ]
    assert [row.name for row in tables["relations"].rows] == [*names, "expressions"]
    assert [row.name for row in tables["stages"].rows] == list(detectors)
    assert [row.name for row in tables["gain"].rows] == list(detectors)
    by_name = {row.name: row.cells for row in tables["grounding"].rows}
    # A recording of the simulated detector is the simulated detector.
    assert by_name["recorded + rule"] == by_name["simulated + rule"]
    assert by_name[VLM][-1] == 9
    assert by_name["annotations + rule"][-1] > 9  # pyright: ignore[reportOperatorIssue]
    for row in tables["gain"].rows:
        own, alone = by_name[row.name][0], by_name[f"{row.name}: OPM only"][0]
        assert isinstance(own, Estimate)
        assert isinstance(alone, Estimate)
        assert isinstance(row.cells[0], Estimate)
        assert row.cells[0].value == pytest.approx(own.value - alone.value)
    assert (folder / "recorded" / "plots" / "relations.png").stat().st_size > 10_000


@pytest.mark.slow
def test_names_that_are_taken_are_told_apart(folder: Path) -> None:
    shutil.copytree(folder / "simulated", folder / "again", dirs_exist_ok=True)
    hashed = open_labels(folder / "labels").manifest.tables["expressions"].content_hash
    runs = [folder / "simulated", folder / "again", folder / "again", folder / "annotations"]
    found = other_systems(runs, "simulated + rule", hashed, MAKERS)
    assert list(found) == [
        "simulated + rule (simulated)",
        "simulated + rule (again)",
        "simulated + rule (again, 2)",
        "annotations + rule",
    ]
    gain, test = relation_gain(found["simulated + rule (again)"][0], config=QUICK)
    assert gain.n == test.n == found["annotations + rule"][0].num_rows


@pytest.mark.slow
def test_runs_that_cannot_stand_beside_are_refused(folder: Path, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="other labels"):
        other_systems([folder / "simulated"], "x", "0123", MAKERS)
    with pytest.raises(InputError, match="no evaluation run"):
        other_systems([tmp_path], "x", "0123", MAKERS)
    for text in ("", "[]", '{"name": 3}', '{"name": "x", "labels": 3}', "\udcff"):
        (tmp_path / "run.json").write_text(text, errors="surrogateescape")
        with pytest.raises(InputError, match="manifest cannot be read"):
            other_systems([tmp_path], "x", "0123", MAKERS)
    manifest = json.loads((folder / "simulated" / "run.json").read_text())
    (tmp_path / "run.json").write_text(json.dumps(manifest))
    with pytest.raises(InputError, match="no evaluation run"):
        other_systems([tmp_path], "x", manifest["labels"]["content_hash"], MAKERS)
