"""Other pipelines' predictions from the command line: written, judged as a run, kept as cases and replayed."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from command_line import Folder, label_three_frames, spatialviz


@pytest.fixture(scope="module")
def work(tmp_path_factory: Folder) -> Path:
    """Labels, and the predictions of a run on them; not to be changed."""
    folder = tmp_path_factory.mktemp("predictions")
    labels = label_three_frames(folder / "labels")
    words = ["eval", "demo", "--labels", labels, "--tables", "grounding", "--limit", 20, "--no-plots", "--workers", 1]
    spatialviz(0, *words, "--out", folder / "run")
    spatialviz(0, "export-run", folder / "run", "--out", folder / "predictions.jsonl", "--json")
    return folder


@pytest.fixture(scope="module")
def imported(work: Path) -> Path:
    """The run that the predictions make; not to be changed."""
    words = ["--dataset", "demo", "--labels", work / "labels", "--no-plots", "--out", work / "imported"]
    assert spatialviz(0, "import-run", work / "predictions.jsonl", *words, "--json").record["expressions"] == 20
    return work / "imported"


def test_what_was_predicted_is_a_case_that_later_predictions_are_held_against(
    work: Path, imported: Path, tmp_path: Path
) -> None:
    lines = (work / "predictions.jsonl").read_text(encoding="utf-8").splitlines()
    asked = json.loads(lines[1])
    words = ["save-case", imported, asked["frame"], asked["text"], "--out", tmp_path / "cases" / "first", "--json"]
    spatialviz(0, *words)
    replay = ["replay", tmp_path / "cases", "--predictions"]
    assert spatialviz(0, *replay, work / "predictions.jsonl", "--json").records[-1]["same"] == 1
    later = tmp_path / "later.jsonl"
    none = {"frame": asked["frame"], "text": asked["text"], "answer": None, "problem": "none"}
    later.write_text(f"{lines[0]}\n{json.dumps(none)}\n", encoding="utf-8")
    spatialviz(1, *replay, later)
    assert "--detector" in spatialviz(2, *replay, later, "--detector", "live").err


def test_what_holds_no_predictions_is_told_in_a_line(work: Path, tmp_path: Path) -> None:
    words = ["--dataset", "demo", "--labels", work / "labels", "--out", tmp_path / "none"]
    spatialviz(2, "import-run", work / "labels" / "manifest.json", *words)


def test_published_files_are_imported_as_they_are(tmp_path: Path) -> None:
    labels = tmp_path / "labels"
    spatialviz(0, "label", "demo", "--out", labels, "--limit", 1, "--workers", 1)
    published = tmp_path / "published"
    spatialviz(0, "export", labels, "--format", "coco", "--out", published)
    words = ["--dataset", "demo", "--labels", labels, "--no-plots", "--json", "--out"]
    found = spatialviz(0, "import-run", published / "instances.json", *words, tmp_path / "run").record
    assert found["imported"]["level"] == 1
    assert found["expressions"] == 40
    refused = spatialviz(2, "import-run", published / "export.json", *words, tmp_path / "none")
    assert "does not say of which format it is" in refused.err
