"""Labels from the command line: made, made on, checked, exported, and with sentences."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import pytest
from command_line import Folder, misused, spatialviz

FORMATS = ["jsonl", "coco", "kitti", "vqa", "parquet"]


@pytest.fixture(scope="module")
def labels(tmp_path_factory: Folder) -> Path:
    """Labels of three frames; not to be changed."""
    folder = tmp_path_factory.mktemp("labels") / "three"
    made = spatialviz(0, "label", "demo", "--out", folder, "--limit", 3, "--json").record
    assert made["frames"] == 3
    assert made["expressions"] > 50
    return folder


@pytest.fixture(scope="module")
def told(tmp_path_factory: Folder) -> tuple[Path, dict[str, Any]]:
    """Labels with sentences, and what was told when they were made."""
    folder = tmp_path_factory.mktemp("labels") / "told"
    kinds = ["--sentences", "--sentences-a-kind", 2, "--workers", 1]
    return folder, spatialviz(0, "label", "demo", "--out", folder, "--limit", 3, *kinds, "--json").record


def test_labels_are_made_once_and_then_gone_on_with(labels: Path) -> None:
    again = ["label", "demo", "--out", labels, "--limit", 3]
    assert "--resume goes on" in spatialviz(2, *again).err
    assert "3 were there already" in spatialviz(0, *again, "--resume").out


def test_labels_are_checked_and_reported(labels: Path, tmp_path: Path) -> None:
    printed = spatialviz(0, "check", labels, "--report", tmp_path / "report")
    assert "3 of 3 frames usable" in printed.out
    assert (tmp_path / "report" / "index.html").stat().st_size > 0
    assert "statistics" in spatialviz(0, "check", labels, "--json").records[-1]


@pytest.mark.parametrize("form", FORMATS)
def test_labels_are_exported(labels: Path, form: str, tmp_path: Path) -> None:
    printed = spatialviz(0, "export", labels, "--format", form, "--out", tmp_path / "out")
    assert re.search(r"\d+ (frames|images|questions), .* -> ", printed.out)
    assert (tmp_path / "out" / "export.json").stat().st_size > 0


def test_an_export_does_not_write_over_another(labels: Path, tmp_path: Path) -> None:
    words = ["export", labels, "--format", "coco", "--out", tmp_path]
    spatialviz(0, *words)
    assert "the folder is not empty" in spatialviz(2, *words).err


def test_tasks_of_several_share_a_folder(tmp_path: Path) -> None:
    words = ["label", "demo", "--out", tmp_path / "shared", "--limit", 3, "--workers", 1, "--shard"]
    assert "no such shard; got 3/2" in spatialviz(2, *words, "3/2").err
    assert "spatialviz label --merge" in spatialviz(0, *words, "1/2").out


@pytest.mark.parametrize("verb", ["merge", "check"])
def test_where_there_are_no_labels_it_is_told(verb: str, tmp_path: Path) -> None:
    assert "no labels here" in spatialviz(2, verb, tmp_path / "nowhere").err


def test_sentences_are_told_by_kind(told: tuple[Path, dict[str, Any]], tmp_path: Path) -> None:
    sentences = told[1]["sentences"]
    assert len(sentences) == 6
    assert sentences["extreme"] == 6
    refused = misused("label", "demo", "--out", tmp_path / "riddles", "--sentences", "riddle")
    assert "invalid choice 'riddle'" in refused.err
    assert not (tmp_path / "riddles").exists()


def test_sentences_of_labels_are_read_and_answered(told: tuple[Path, dict[str, Any]]) -> None:
    found = spatialviz(0, "eval", "demo", "--sentences", told[0] / "sentences.jsonl", "--json").record["all"]
    assert found["read"]["value"] == 1
    assert found["right"]["value"] > 0.9
