"""Cases from the command line: kept, asked again, shown as a page, and refused where they are damaged."""

from __future__ import annotations

import re
import shutil
from pathlib import Path

import pytest
from command_line import Folder, misused, spatialviz

TEXT = "mug left of the laptop"
MANIFEST = "spatialviz-case.json"


@pytest.fixture(scope="module")
def cases(tmp_path_factory: Folder) -> Path:
    """Two cases, of a simulated detector and of the annotations; not to be changed."""
    folder = tmp_path_factory.mktemp("cases")
    words = ["save-case", "demo", 0, TEXT, "--detector", "simulated", "--out", folder / "simulated", "--json"]
    assert spatialviz(0, *words).record
    spatialviz(0, "save-case", "demo", 0, "mug right of the laptop", "--out", folder / "annotated")
    return folder


def test_a_case_is_not_written_over(cases: Path) -> None:
    refused = spatialviz(2, "save-case", "demo", 0, TEXT, "--out", cases / "simulated")
    assert str(cases / "simulated") in refused.err


def test_cases_that_did_not_change_are_the_same(cases: Path) -> None:
    assert spatialviz(0, "replay", cases, "--json").records[-1]["same"] == 2


def test_a_case_is_a_dataset_of_one_frame(cases: Path) -> None:
    assert "1 of 1 frame can be used" in spatialviz(0, "frames", cases / "simulated").out


def test_a_case_is_a_page_that_is_small_and_written_once(cases: Path, tmp_path: Path) -> None:
    words = ["report", cases / "simulated", "--out", tmp_path / "failure.html"]
    assert spatialviz(0, *words, "--json").record["bytes"] < 4e6
    assert (tmp_path / "failure.html").stat().st_size > 1000
    assert "failure.html" in spatialviz(2, *words).err


def test_a_change_is_told_by_the_status_until_it_is_accepted(cases: Path, tmp_path: Path) -> None:
    case = Path(shutil.copytree(cases / "annotated", tmp_path / "case"))
    text = (case / MANIFEST).read_text(encoding="utf-8")
    (case / MANIFEST).write_text(re.sub(r'"verdict": "[A-Z-]*"', '"verdict": "SRM"', text), encoding="utf-8")
    spatialviz(1, "replay", case)
    spatialviz(0, "replay", case, "--update")
    spatialviz(0, "replay", case)


def test_a_damaged_case_fails_the_replay(cases: Path, tmp_path: Path) -> None:
    shutil.copytree(cases, tmp_path / "cases")
    (tmp_path / "cases" / "annotated" / "rgb.png").unlink()
    printed = misused("replay", tmp_path / "cases")
    assert "damaged" in printed.out + printed.err
    assert "there is no such case" in spatialviz(2, "replay", tmp_path / "nowhere").err
