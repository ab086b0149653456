"""What an earlier version judged is marked, and judged again beside it: the old run, labels or case stays as it is."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any

import pytest
from label_sets import label_demo

from pipeline.diagnosis import open_case
from pipeline.evaluation import (
    EvalSpec,
    doubts_of,
    evaluate_dataset,
    export_run,
    import_run,
    judge_again,
    judged_by,
    open_run,
    recorded_verdict,
)
from pipeline.labels import open_labels
from pipeline.paper import recorded_system
from pipeline.system import InputError

OLD = Path(__file__).parents[1] / "fixtures" / "2026-11-21"


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Labels of a frame, a run on them, its predictions, and these as an imported run."""
    folder = tmp_path_factory.mktemp("again")
    label_demo(folder / "labels", frames=1)
    spec = EvalSpec("demo", str(folder / "labels"), {"detector": "simulated"}, limit=20)
    evaluate_dataset(spec, folder / "run", plots=False)
    export_run(open_run(folder / "run"), folder / "run.jsonl")
    import_run(folder / "run.jsonl", "demo", folder / "labels", folder / "imported", plots=False)
    return folder


def files(folder: Path) -> dict[str, bytes]:
    return {str(p.relative_to(folder)): p.read_bytes() for p in folder.rglob("*") if p.is_file()}


def aged(folder: Path, **changes: Any) -> None:
    """Write a run's manifest as one of before had it."""
    manifest = json.loads((folder / "run.json").read_text())
    manifest.pop("verdict_rules")
    (folder / "run.json").write_text(json.dumps(manifest | changes))


@pytest.mark.parametrize("kind", ["run", "imported"])
def test_a_run_is_judged_again_into_a_new_folder(folder: Path, kind: str, tmp_path: Path) -> None:
    old = Path(shutil.copytree(folder, tmp_path / "all")) / kind
    aged(old, version="0.0.9")
    before = files(old)
    run = open_run(old)
    assert "0.0.9 with rules 1" in judged_by(run.manifest)
    assert "judge-again" in doubts_of(run)[0]
    told = judge_again(old, tmp_path / "new", plots=False, system=recorded_system)
    assert told == {"kind": "run", "out": str(tmp_path / "new"), "expressions": 20}
    assert files(old) == before
    again = open_run(tmp_path / "new")
    assert doubts_of(again) == ()
    assert again.name == run.name
    assert again.records.to_pylist() == run.records.to_pylist()
    with pytest.raises(InputError, match="not empty"):
        judge_again(old, tmp_path / "new", plots=False, system=recorded_system)


def test_labels_and_cases_are_judged_again_too(folder: Path, tmp_path: Path) -> None:
    before = files(folder / "labels")
    assert judge_again(folder / "labels", tmp_path / "labels", system=recorded_system)["kind"] == "labels"
    assert files(folder / "labels") == before
    assert open_labels(tmp_path / "labels").expressions.equals(open_labels(folder / "labels").expressions)
    told = judge_again(OLD / "case", tmp_path / "case", system=recorded_system)
    assert (told["kind"], told["changes"]) == ("case", [])
    assert open_case(tmp_path / "case").answer().text == open_case(OLD / "case").answer().text
    with pytest.raises(InputError, match="how it was made"):
        judge_again(folder, tmp_path / "nothing", system=recorded_system)


def test_a_recorded_verdict_is_compared_with_that_of_now(folder: Path) -> None:
    run = open_run(folder / "run")
    rows = run.records.to_pylist()
    for row in rows[:8]:
        found = recorded_verdict(row)
        assert found is not None
        assert found.is_that(run.answer(row["frame"], row["id"]).diagnosis)
        assert not found.is_that(None)
    assert recorded_verdict({"verdict": None}) is None
