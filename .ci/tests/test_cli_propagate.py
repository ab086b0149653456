"""Corrections carried to the other frames of a scene from the command line."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from command_line import Folder, label_three_frames, spatialviz

FRAME = "000001/000000"


@pytest.fixture(scope="module")
def labels(tmp_path_factory: Folder) -> Path:
    """Labels in which ann has corrected a class."""
    folder = tmp_path_factory.mktemp("propagate")
    label_three_frames(folder / "labels")
    edit = {"edit": "class", "frame": FRAME, "object": 2, "to": "notebook"}
    (folder / "edits.json").write_text(json.dumps([edit]), encoding="utf-8")
    spatialviz(0, "correct", folder / "labels", "--edits", folder / "edits.json", "--author", "ann")
    return folder / "labels"


def test_proposals_are_listed_accepted_and_taken_back(labels: Path) -> None:
    frames = spatialviz(0, "propagate", labels, FRAME, "--json").records
    assert [one["frame"] for one in frames] == ["000001/000001", "000001/000002"]
    assert [[p["fields"] for p in one["proposals"]] for one in frames] == [[["label"]], [["label"]]]
    assert "notebook" in spatialviz(0, "propagate", labels, FRAME).out
    # Nothing was saved by looking.
    assert len(spatialviz(0, "journal", labels, "--json").records) == 1
    saved = spatialviz(0, "propagate", labels, FRAME, "--accept", "--author", "ben", "--json").record["saved"]
    assert {(event["author"], event["after"]) for event in saved} == {("ben", "notebook")}
    assert len({event["group"] for event in saved}) == 1
    assert "nothing to propose" in spatialviz(1, "propagate", labels, FRAME).out
    spatialviz(0, "undo", labels, "--author", "ben")
    again = spatialviz(0, "propagate", labels, FRAME, "--to", 2, "--refine", "--json").record
    assert again["frame"] == "000001/000002"


def test_what_cannot_be_carried_is_told_in_a_line(labels: Path) -> None:
    assert "--author" in spatialviz(2, "propagate", labels, FRAME, "--accept").err
    assert "to itself" in spatialviz(2, "propagate", labels, FRAME, "--to", FRAME).err
    assert "no such object" in spatialviz(2, "propagate", labels, FRAME, "--object", 99).err


def test_labels_begun_by_hand_take_in_the_frames_that_get_something(tmp_path: Path) -> None:
    labels, edits = tmp_path / "labels", tmp_path / "edits.json"
    spatialviz(0, "label", "demo", "--out", labels, "--empty")
    new = {
        "edit": "new",
        "frame": FRAME,
        "label": "laptop",
        "polygon": [[281, 196], [364, 196], [364, 273], [281, 273]],
    }
    edits.write_text(json.dumps([new]), encoding="utf-8")
    spatialviz(0, "correct", labels, "--edits", edits, "--author", "ann")
    listed = spatialviz(0, "propagate", labels, FRAME, "--json").records
    assert [[p["new"] for p in one["proposals"]] for one in listed] == [[True], [True]]
    saved = spatialviz(0, "propagate", labels, FRAME, "--accept", "--doubtful", "--author", "ann", "--json").record
    assert [event["frame"] for event in saved["saved"]] == ["000001/000001", "000001/000002"]
