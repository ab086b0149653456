"""Runs from the command line: expressions and sentences are judged, failures listed, compared, counted and audited."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import pytest
from command_line import Folder, label_three_frames, misused, spatialviz

SENTENCES = (
    {"frame": 0, "sentence": "the mug left of the laptop", "targets": [3], "kind": "relation"},
    {"frame": 0, "sentence": "the mug behind the laptop", "boxes": []},
    {"frame": 0, "sentence": "the zebra", "points": [[1, 1]]},
)
SILENT_SERVER = ["--reader", "llm", "--reader-url", "http://127.0.0.1:9/v1", "--reader-model", "none"]


@pytest.fixture(scope="module")
def labels(tmp_path_factory: Folder) -> Path:
    return label_three_frames(tmp_path_factory.mktemp("runs") / "labels")


@pytest.fixture(scope="module")
def run(labels: Path) -> Path:
    """A run of a simulated detector; not to be changed."""
    folder = labels.parent / "run"
    words = ["eval", "demo", "--labels", labels, "--detector", "simulated", "--out", folder]
    found = spatialviz(0, *words, "--json").record
    assert found["expressions"] > 50
    assert {"grounding", "srm", "verdicts", "oracles"} <= set(found["tables"])
    return folder


@pytest.fixture(scope="module")
def with_one_proposal(run: Path) -> Path:
    """The same with one proposal of each name, compared with the first."""
    folder = run.parent / "run1"
    words = ["eval", "demo", "--labels", run.parent / "labels", "--detector", "simulated", "--k", 1, "--out", folder]
    spatialviz(0, *words, "--compare", run, "--workers", 1)
    return folder


@pytest.fixture
def sentences(tmp_path: Path) -> Path:
    file = tmp_path / "sentences.jsonl"
    file.write_text("".join(f"{json.dumps(line)}\n" for line in SENTENCES), encoding="utf-8")
    return file


def test_a_run_keeps_its_tables_and_says_what_its_makers_share(run: Path) -> None:
    assert (run / "tables.md").stat().st_size > 0
    kept = json.loads((run / "run.json").read_text(encoding="utf-8"))
    assert kept["shares"][0]["kind"] == "simulated"
    assert kept["makers"]["masks"]


def test_what_annotations_answer_is_no_measurement_of_a_detector(labels: Path, tmp_path: Path) -> None:
    words = ["eval", "demo", "--labels", labels, "--tables", "grounding", "--limit", 20, "--no-plots", "--workers", 1]
    found = spatialviz(0, *words, "--out", tmp_path / "perfect", "--json").record
    assert found["shares"][0]["title"] == "OPM is the truth itself here"
    assert found["caveats"]["grounding"]


def test_failures_are_searched_and_cut(run: Path) -> None:
    spatialviz(0, "failures", run, "verdict:OPM-TARGET sort:margin", "--json")
    spatialviz(0, "failures", run, "--slices", "relation,class")
    assert "verdikt" in spatialviz(2, "failures", run, "verdikt:SRM").err


def test_failures_are_drawn_on_a_sheet(run: Path, tmp_path: Path) -> None:
    spatialviz(0, "failures", run, "verdict:OPM-CONF", "--sheet", tmp_path / "sheet.png", "--json")
    sheet = cv2.imread(str(tmp_path / "sheet.png"))
    assert sheet is not None
    assert sheet.shape[1] > 2400
    misused("failures", run, "--sheet", tmp_path / "sheet.txt")
    misused("failures", run, "class:nosuchclass", "--sheet", tmp_path / "none.png")
    assert [p.name for p in tmp_path.iterdir()] == ["sheet.png"]


def test_failures_are_compared_with_those_of_another_run(run: Path, with_one_proposal: Path) -> None:
    words = ["change:fixed,broken,verdict,other_reason", "--compare", with_one_proposal, "--json"]
    found = spatialviz(0, "failures", run, *words).record
    changes = {value["name"]: value["count"] for value in found["facets"]["change"]["values"]}
    assert len(found["comparison"]["broken"]) == changes["broken"] > 0
    assert found["failures"][0]["second_verdict"]
    assert found["failures"][0]["marks"] == []


def test_answers_are_compared_without_labels(run: Path, with_one_proposal: Path, tmp_path: Path) -> None:
    found = spatialviz(0, "failures", run, "--compare", with_one_proposal, "--answers", "--limit", 3, "--json").record
    assert found["differ"] + found["same"] == found["shared"] > 0
    assert len(found["answers"]) == 3
    files = {}
    for name in ("annotations", "simulated"):
        words = ("ask", "demo", "0", "mug", "mug left of the laptop", "a laptop", "--detector", name, "--json")
        files[name] = tmp_path / f"{name}.jsonl"
        files[name].write_text(spatialviz(0, *words).out, encoding="utf-8")
    both = ("failures", files["annotations"], "--answers", "--compare")
    assert spatialviz(1, *both, files["annotations"], "--json").record["same"] == 3
    assert "alike" in spatialviz(0, *both, files["simulated"]).out
    assert "--compare" in spatialviz(2, *both[:3]).err
    assert "no expression in common" in spatialviz(2, *both, run).err


def test_the_tables_of_a_run_are_printed_again(run: Path) -> None:
    assert spatialviz(0, "tables", run, "--json").record


def test_a_run_is_asked_in_sql_and_not_written(run: Path) -> None:
    rows = spatialviz(0, "query", run, "SELECT verdict, count(*) FROM records GROUP BY 1", "--json").records
    assert len(rows) > 1
    assert "a run is only read" in spatialviz(2, "query", run, "DROP TABLE records").err


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ([], "nothing says what is asked"),
        (["--labels", "NOWHERE", "--out", "OUT"], "no labels here"),
        (["--labels", "LABELS", "--out", "OUT", "--system", "vlm"], "--vlm-url"),
        (["--labels", "LABELS", "--out", "OUT", *SILENT_SERVER], "--reader llm goes with --sentences"),
    ],
)
def test_what_cannot_be_judged_is_told_in_a_line(labels: Path, words: list[str], message: str, tmp_path: Path) -> None:
    places = {"NOWHERE": tmp_path / "nowhere", "LABELS": labels, "OUT": tmp_path / "out"}
    assert message in spatialviz(2, "eval", "demo", *(places.get(word, word) for word in words)).err


def test_sentences_are_judged_and_kept_once(sentences: Path, tmp_path: Path) -> None:
    words = ["eval", "demo", "--sentences", sentences]
    found = spatialviz(0, *words, "--json").record
    assert found["all"]["sentences"] == 3
    assert found["kinds"]["relation"]["right"]["value"] == 1
    assert [failure["detail"] for failure in found["failures"]] == ["WORDS"]
    kept = [*words, "--out", tmp_path / "run"]
    spatialviz(0, *kept)
    assert len((tmp_path / "run" / "sentences.jsonl").read_text(encoding="utf-8").splitlines()) == 3
    assert "not empty" in spatialviz(2, *kept).err
    assert "--limit" in spatialviz(2, *words, "--limit", 2).err
    assert "127.0.0.1:9" in spatialviz(2, *words, *SILENT_SERVER).err


def test_a_sentence_of_which_nothing_is_right_is_refused(sentences: Path) -> None:
    with sentences.open("a", encoding="utf-8") as file:
        file.write(json.dumps({"frame": 0, "sentence": "the mug"}))
    assert "line 4" in spatialviz(2, "eval", "demo", "--sentences", sentences).err


def test_sentences_are_audited(sentences: Path, tmp_path: Path) -> None:
    spatialviz(0, "eval", "demo", "--sentences", sentences, "--out", tmp_path / "run")
    words = ["audit", sentences, "--dataset", "demo"]
    spatialviz(0, *words, "--runs", tmp_path / "run", "--out", tmp_path / "audit.jsonl")
    assert len((tmp_path / "audit.jsonl").read_text(encoding="utf-8").splitlines()) == 3
    assert spatialviz(0, *words, "--json", "--limit", 1).records
    assert "--dataset" in spatialviz(2, "audit", sentences).err


def test_a_run_is_judged_again_into_a_new_folder(run: Path, tmp_path: Path) -> None:
    new = tmp_path / "again"
    found = spatialviz(0, "judge-again", run, "--out", new, "--workers", 1, "--json").record
    assert found["kind"] == "run"
    (old, now) = (spatialviz(0, "failures", folder, "--json").record for folder in (run, new))
    assert (old["summary"], old["doubts"]) == (now["summary"], [])
    misused("judge-again", run, "--out", new)
