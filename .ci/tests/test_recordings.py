"""Recordings from the command line: browsed without a camera, never measured, imported, told what is seen."""

from __future__ import annotations

import json
import shutil
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from dataset_writers import random_truth, write_png
from depth_graphs import write_network, write_picture
from numpy.random import default_rng

from pipeline.datasets.odd_frames import MOST_DEPTHS, OddFrame
from spatialviz.cli import main
from spatialviz.printing import progress_bars
from spatialviz.run_frames import DECODED, print_odd_frames

TOLD = ["--intrinsics", "60,61,31.5,23.5", "--depth-scale", "1000"]


@pytest.fixture
def pairs(tmp_path: Path) -> Path:
    rng = default_rng(1)
    for number in range(3):
        truth = random_truth(rng)
        write_png(tmp_path / f"pairs/{number}.png", truth.rgb)
        write_png(tmp_path / f"pairs/{number}_depth.png", truth.millimetres)
    return tmp_path / "pairs"


def test_what_lacks_a_camera_is_listed(pairs: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["frames", str(pairs)]) == 0
    printed = capsys.readouterr().out
    assert printed.count("--intrinsics fx,fy,cx,cy") == 1
    assert "3 of 3 frames" in printed
    assert main(["frames", str(pairs), "--json"]) == 0
    records = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert [(r["ok"], r["median_depth"], r["up"]) for r in records] == [(True, None, None)] * 3
    assert main(["frames", str(pairs), *TOLD, "--json"]) == 0
    assert all(json.loads(line)["median_depth"] > 0 for line in capsys.readouterr().out.splitlines())


@pytest.mark.parametrize("command", ["frames", "doctor"])
@pytest.mark.parametrize("form", [[], ["--json"]], ids=["text", "json"])
def test_what_was_not_read_is_said(
    pairs: Path, command: str, form: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    (pairs / "extrinsics.yaml").write_text("T: [1, 2]\n")
    main([command, str(pairs), *TOLD, *form])
    assert "not read: extrinsics.yaml" in capsys.readouterr().out


@pytest.mark.parametrize(
    "command",
    [
        ["ask", "DATASET", "0", "mug left of book"],
        ["relations", "DATASET"],
        ["measure", "DATASET", "0", "5,5", "9,9"],
        ["label", "DATASET", "--out", "OUT"],
    ],
    ids=lambda command: command[0],
)
def test_what_lacks_a_camera_is_not_measured(
    pairs: Path, tmp_path: Path, command: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    words = {"DATASET": str(pairs), "OUT": str(tmp_path / "out")}
    assert main([words.get(word, word) for word in command]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert "3 pairs such as 0.png and 0_depth.png" in line
    assert "--intrinsics fx,fy,cx,cy and --depth-scale UNITS_PER_METRE" in line
    assert not (tmp_path / "out").exists()


def test_one_option_tells_camera_and_unit(pairs: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["ask", str(pairs), "0", "mug left of book"]) == 2
    assert "in one --intrinsics fx,fy,cx,cy,UNITS_PER_METRE" in capsys.readouterr().err
    assert main(["frames", str(pairs), "--intrinsics", "60,61,31.5,23.5,1000"]) == 0
    assert "nothing can be measured" not in capsys.readouterr().out
    assert main(["frames", str(pairs), "--intrinsics", "60,61,31.5,23.5,1000", "--depth-scale", "1000"]) == 2
    assert "say the same" in capsys.readouterr().err


def test_frames_tells_each_note_once_and_takes_folders_of_datasets(
    pairs: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for name in ("one", "two"):
        shutil.copytree(pairs, tmp_path / "many" / name)
    (tmp_path / "many/two/1.png").write_bytes(b"")
    assert main(["frames", str(tmp_path / "many"), *TOLD]) == 0
    printed = capsys.readouterr().out
    assert "3 of 3 frames" in printed
    assert "2 of 3 frames" in printed
    assert "note on 3 frames: up is assumed" in printed
    assert main(["frames", str(tmp_path / "many"), *TOLD, "--json", "--summary"]) == 0
    records = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert [(r["dataset"], r["frames_usable"]) for r in records] == [("one", 3), ("two", 2)]
    assert main(["frames", str(pairs), *TOLD, "--all"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert sum("64x48" in line and "depth, median" in line for line in lines) == 3


def test_frames_names_odd_frames(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for number in range(9):
        write_png(tmp_path / f"{number}.png", np.zeros((48, 64, 3), np.uint8))
        write_png(
            tmp_path / f"{number}_depth.png", np.full((48, 64), 9000 if number == 4 else 2000 + number, np.uint16)
        )
    reason = "depth changes by 7.0 m at the median from the frames before"
    assert main(["frames", str(tmp_path), *TOLD]) == 0
    assert [line for line in capsys.readouterr().out.splitlines() if line.startswith("odd: ")] == [f"odd: 4  {reason}"]
    assert main(["frames", str(tmp_path), *TOLD, "--json"]) == 0
    records = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert [r["odd"] for r in records] == [[reason] if k == 4 else [] for k in range(9)]
    assert [r["oddness"] >= 1 for r in records] == [k == 4 for k in range(9)]
    print_odd_frames([OddFrame("a", None, None)] * (MOST_DEPTHS + 1))
    assert "at most 2,000 frames were looked at" in capsys.readouterr().out


def test_a_missing_extra_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setitem(sys.modules, "rosbags.highlevel", None)
    (tmp_path / "a.mcap").write_bytes(b"x")
    assert main(["frames", str(tmp_path / "a.mcap")]) == 2
    assert "spatialviz[ros]" in capsys.readouterr().err


def test_colour_alone_is_measured_by_estimated_depth(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("SPATIALVIZ_CACHE", str(tmp_path / "cache"))
    write_picture(tmp_path / "pictures" / "1.png")
    model = write_network(tmp_path / "network.onnx", "moge-2")
    command = ["measure", str(tmp_path / "pictures"), "0", "10,10", "40,40"]
    assert main(command) == 2
    assert "--depth-model NAME" in capsys.readouterr().err
    command += ["--depth-model", str(model)]
    assert main([*command, "--json"]) == 0
    source = json.loads(capsys.readouterr().out)["depth_source"]
    assert source.startswith("estimated by moge-2 (network.onnx): metres")
    assert main(command) == 0
    assert f"depth is {source}" in " ".join(capsys.readouterr().out.split())


def test_progress_is_told_in_lines_where_no_terminal_is(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("spatialviz.printing.LINE_SECONDS", 0.02)
    with progress_bars() as tell:
        time.sleep(0.1)
        tell("reading frames", 3, 12)
        time.sleep(0.1)
    told = capsys.readouterr()
    assert "spatialviz: working, " in told.err
    assert "spatialviz: reading frames: 3 of 12" in told.err
    assert not told.out


def test_frames_says_what_was_not_decoded(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for k in range(DECODED + 4):
        write_png(tmp_path / f"{k:03}.png", np.full((48, 64, 3), 90, np.uint8))
        write_png(tmp_path / f"{k:03}_depth.png", np.full((48, 64), 2000, np.uint16))
    told = ["frames", str(tmp_path), *TOLD]
    assert main(told) == 0
    assert "4 were not decoded (--decode)" in capsys.readouterr().out
    assert main([*told, "--json"]) == 0
    records = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert sum(not record["decoded"] for record in records) == 4
    assert all(record["depth_valid"] is None for record in records if not record["decoded"])
    assert main([*told, "--decode"]) == 0
    assert "not decoded" not in capsys.readouterr().out
