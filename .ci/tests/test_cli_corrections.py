"""Corrections from the command line, one after the other: saved, taken back, backed up, rescued, exported, imported."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import pytest
from command_line import Folder, label_three_frames, replaced, spatialviz

FORMATS = ["jsonl", "coco", "kitti", "vqa", "parquet"]
FRAME = "000001/000000"
PAGE = 4096
"""Bytes of a page of an SQLite file."""


@pytest.fixture(scope="module")
def work(tmp_path_factory: Folder) -> Path:
    """A folder with labels, in which each test goes on where the one before has ended."""
    folder = tmp_path_factory.mktemp("corrections")
    label_three_frames(folder / "labels")
    edit = {"edit": "class", "frame": FRAME, "object": 2, "to": "notebook"}
    (folder / "edits.json").write_text(json.dumps([edit]), encoding="utf-8")
    return folder


@pytest.fixture(scope="module")
def corrected(work: Path) -> Path:
    """The same, with a correction by ann that was taken back and made again."""
    labels = work / "labels"
    assert "no journal here" in spatialviz(2, "journal", labels).err
    correct = ["correct", labels, "--edits", work / "edits.json", "--author"]
    assert "class of notebook·2" in spatialviz(0, *correct, "ann").out
    # What ann has corrected bob does not overwrite.
    assert "ann made it notebook" in spatialviz(1, *correct, "bob").out
    spatialviz(0, "undo", labels, "--author", "ann")
    spatialviz(0, "redo", labels, "--author", "ann")
    return work


@pytest.fixture(scope="module")
def exported(corrected: Path) -> Path:
    """The same, with exports of the corrected labels."""
    export = ["export", corrected / "labels", "--corrected", "--format"]
    for form in FORMATS:
        out = corrected / f"{form}-corrected"
        assert " -> " in spatialviz(0, *export, form, "--out", out).out
        assert (out / "export.json").stat().st_size > 0
    return corrected


def test_a_journal_holds_what_was_done(corrected: Path) -> None:
    events = spatialviz(0, "journal", corrected / "labels", "--json").records
    assert [event["action"] for event in events] == ["edit", "undo", "redo"]
    spatialviz(1, "redo", corrected / "labels", "--author", "ann")


def test_a_journal_is_checked_and_backed_up_once(corrected: Path) -> None:
    journal = ["journal", corrected / "labels"]
    assert spatialviz(0, *journal, "--check", "--json").record["intact"] == 3
    backup = [*journal, "--backup", corrected / "backup.sqlite"]
    spatialviz(0, *backup)
    assert "there is a file of this name" in spatialviz(2, *backup).err
    assert "of the whole journal" in spatialviz(2, *journal, "--check", "--author", "ann").err


def test_a_damaged_journal_is_told_and_never_written(corrected: Path) -> None:
    labels, copy = corrected / "labels", corrected / "damaged.sqlite"
    spatialviz(0, "journal", labels, "--backup", copy)
    content = bytearray(copy.read_bytes())
    content[PAGE : 2 * PAGE] = bytes(PAGE)
    copy.write_bytes(content)
    assert "damaged: " in spatialviz(1, "journal", labels, "--journal", copy, "--check").out
    for words in (
        ["journal", labels],
        ["correct", labels, "--edits", corrected / "edits.json", "--author", "ann"],
        ["view", "demo", "--labels", labels, "--no-open-browser"],
    ):
        assert "the journal is damaged" in spatialviz(2, *words, "--journal", copy).err
    assert copy.read_bytes() == content


def test_a_journal_without_its_head_is_rescued(corrected: Path) -> None:
    labels, copy, rescued = corrected / "labels", corrected / "headless.sqlite", corrected / "rescued.sqlite"
    content = bytearray((labels / "journal.sqlite").read_bytes())
    content[3:4] = b"X"
    copy.write_bytes(content)
    spatialviz(0, "journal", labels, "--journal", copy, "--recover", rescued)
    events = spatialviz(0, "journal", labels, "--journal", rescued, "--json").records
    assert events == spatialviz(0, "journal", labels, "--json").records


def test_corrected_labels_are_written_once_and_pass_the_check(corrected: Path) -> None:
    labels, out = corrected / "labels", corrected / "effective"
    spatialviz(0, "effective", labels, "--out", out, "--json")
    assert "into a new or empty folder" in spatialviz(2, "effective", labels, "--out", out).err
    spatialviz(0, "check", out)
    again = ["export", out, "--corrected", "--format", "coco", "--out", corrected / "coco-again"]
    assert "these labels are corrected already" in spatialviz(2, *again).err


def test_what_was_exported_says_nothing_new(exported: Path) -> None:
    labels = exported / "labels"
    spatialviz(0, "import", labels, exported / "coco-corrected", "--author", "eve")
    found = spatialviz(0, "import", labels, exported / "jsonl-corrected", "--author", "eve", "--json").record
    assert found["compared"] > 500
    assert not found["edits"]


def test_what_was_changed_in_an_export_is_imported(exported: Path, tmp_path: Path) -> None:
    changed = Path(shutil.copytree(exported, tmp_path / "changed"))
    labels = changed / "labels"
    instances = changed / "coco-corrected" / "instances.json"
    replaced(instances, '"name": "mug"', '"name": "cup"')
    words = ["import", labels, instances, "--author", "eve"]
    found = spatialviz(0, *words, "--dry-run", "--json").record
    assert found["edits"]
    assert not found["saved"]
    spatialviz(0, *words)
    assert spatialviz(0, "journal", labels, "--author", "eve", "--json").records
    # What eve has said bob does not overwrite.
    objects = changed / "jsonl-corrected" / "objects.jsonl"
    words = ["import", labels, objects, "--author", "bob"]
    replaced(objects, '"label": "mug"', '"label": "jug"')
    spatialviz(1, *words)
    replaced(objects, '"label": "jug"', '"label": 7')
    spatialviz(2, *words)
    assert "there is no such file" in spatialviz(2, "import", labels, changed / "nowhere.json", "--author", "bob").err
