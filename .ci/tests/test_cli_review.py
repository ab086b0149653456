"""The review of labels from the command line: a queue, what two people say of it, and how far they have come."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from command_line import Folder, label_three_frames, spatialviz


@pytest.fixture(scope="module")
def work(tmp_path_factory: Folder) -> Path:
    """Labels with a queue, of which ann accepted the first item and bob rejected it."""
    folder = tmp_path_factory.mktemp("review")
    labels = label_three_frames(folder / "labels")
    words = ["review", labels, "--no-networks", "--out", folder / "queue.parquet", "--limit", 1]
    item = spatialviz(0, *words, "--json").record
    assert "no two reviewers have judged" in spatialviz(1, "review", labels, "--agreement").out
    if item["kind"] == "relation":
        about = {name: item[name] for name in ("a", "b", "relation")}
    else:
        about = {"expression": item["expression"]} if item["expression"] else {"object": item["a"]}
    for author, said in (("ann", "accepted"), ("bob", "rejected")):
        edits = folder / f"{author}.json"
        edits.write_text(json.dumps([{"edit": "judge", "frame": item["frame"], **about, "to": said}]), encoding="utf-8")
        spatialviz(0, "correct", labels, "--edits", edits, "--author", author)
    return folder


def test_agreement_names_who_differs_on_what(work: Path) -> None:
    words = ["review", work / "labels", "--agreement"]
    found = spatialviz(0, *words, "--json").record
    assert found["reviewers"] == ["ann", "bob"]
    assert len(found["differ"]) == 1
    assert "ann" in spatialviz(0, *words).out


def test_what_reviewers_disagree_on_comes_first(work: Path) -> None:
    words = ["review", work / "labels", "--no-networks", "--limit", 1, "--json"]
    assert "reviewers disagree" in spatialviz(0, *words).out


@pytest.mark.parametrize(
    "words",
    [
        ["--author", "cay", "--limit", 3],
        ["--all", "--limit", 3],
    ],
)
def test_a_queue_is_shown_to_a_person(work: Path, words: list[object]) -> None:
    printed = spatialviz(0, "review", work / "labels", "--queue", work / "queue.parquet", *words)
    assert "to look at" in printed.out


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--queue", "LABELS/objects.parquet"], "queue"),
        (["--author", "ann", "--all"], "exclude"),
        (["--accept"], "correct LABELS --edits"),
        (["--no-networks", "--detector", "recorded"], "failures A --compare B"),
        (["--progress"], "journal LABELS"),
    ],
)
def test_options_that_make_no_sense_are_told_in_a_line(work: Path, words: list[object], message: str) -> None:
    words = [str(word).replace("LABELS", str(work / "labels")) for word in words]
    assert message in spatialviz(2, "review", work / "labels", *words).err


def test_judgements_leave_the_labels_sound(work: Path, tmp_path: Path) -> None:
    assert spatialviz(0, "journal", work / "labels", "--check", "--json").record["intact"] == 2
    spatialviz(0, "effective", work / "labels", "--out", tmp_path / "effective")
    spatialviz(0, "check", tmp_path / "effective")
