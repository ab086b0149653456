"""Detectors and readers from the command line: fused, recorded, and measured."""

from __future__ import annotations

from pathlib import Path

import pytest
from command_line import Folder, spatialviz

TEXT = "mug left of the laptop"
ASK = ["ask", "demo", 0, TEXT]


@pytest.fixture(scope="module")
def other(tmp_path_factory: Folder) -> Path:
    """Options of a simulated detector that errs otherwise."""
    file = tmp_path_factory.mktemp("models") / "other.toml"
    file.write_text("seed = 5\n", encoding="utf-8")
    return file


def test_two_detectors_are_fused_and_what_they_see_is_recorded(other: Path, tmp_path: Path) -> None:
    fused = ["--detector", "simulated", "--fuse", f"simulated={other}"]
    assert spatialviz(0, *ASK, *fused, "--json").record["answer"]["target"]["label"] == "mug"
    seen = tmp_path / "seen.json"
    spatialviz(0, "detect", "demo", *fused, "--fusion", "nms", "--frames", "0:2", "--out", seen)
    played = ["--detector", "recorded", "--model", seen]
    assert spatialviz(0, *ASK, *played, "--json").record["answer"]["target"]["label"] == "mug"


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["view", "demo", "--also", "simulated"], "--compare B --answers"),
        (["agree", "demo", "--also", "simulated"], "--compare B --answers"),
        (["detect", "--agree", "demo", "--also", "simulated"], "--compare B --answers"),
        ([*ASK, "--detector", "simulated", "--fuse", "nonsense"], "nonsense"),
        ([*ASK, "--detector", "simulated", "--fuse", "simulated=WORK/nowhere.toml"], "nowhere.toml"),
        ([*ASK, "--fuse", "simulated"], "--fuse"),
        ([*ASK, "--detector", "simulated", "--fuse", "yolo-seg=WORK/nothing.onnx"], "nothing.onnx"),
        ([*ASK, "--detector", "yolo-seg", "--model", "WORK/nothing.onnx"], "nothing.onnx"),
        ([*ASK, "--detector", "yolo-seg", "--model", "WORK/text.onnx"], "text.onnx"),
        ([*ASK, "--detector", "nonsense"], "nonsense"),
        ([*ASK, "--reader", "llm"], "--reader-url"),
    ],
)
def test_what_cannot_be_used_is_told_in_a_line(words: list[object], message: str, tmp_path: Path) -> None:
    (tmp_path / "text.onnx").write_text("not a model", encoding="utf-8")
    assert message in spatialviz(2, *(str(word).replace("WORK", str(tmp_path)) for word in words)).err


def test_the_bench_tells_ratios_and_keeps_them(tmp_path: Path) -> None:
    file = tmp_path / "bench.json"
    words = ("bench", "--only", "start.help", "--quick")
    (claim,) = spatialviz(0, *words, "--out", file, "--json").record["claims"]
    assert claim["ratio"] > 1
    assert claim["kept"] == "yes"
    printed = spatialviz(0, *words, "--before", file)
    assert "start.help" in printed.out
    assert "ratio before" in printed.out
    assert "start.help" in printed.err
    assert "label.packed" in spatialviz(2, "bench", "--only", "nonsense").err
    assert "no checkout" in spatialviz(2, "bench", "--before", tmp_path).err
    assert spatialviz(0, "bench", "srm", "--help").out == spatialviz(0, "ablation", "--help").out


def test_an_option_stands_for_a_command_of_before() -> None:
    assert spatialviz(0, "ask", "--glossary", "margin").out == spatialviz(0, "glossary", "margin").out
