"""Redwood recordings: cameras, trajectories and names."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from dataset_writers import (
    HEIGHT,
    WIDTH,
    K,
    write_redwood,
)
from recording_checks import CAMERA, pose, refused

from pipeline.datasets import open_dataset, survey

# Redwood


@pytest.mark.parametrize(("inside", "opened"), [("", ""), ("RGBD", ""), ("RGBD", "RGBD")])
def test_redwood_is_read_back_exactly(tmp_path: Path, inside: str, opened: str) -> None:
    written = write_redwood(tmp_path / "rec", ["00000", "00001", "00010"], inside)
    dataset = open_dataset(tmp_path / "rec" / opened)
    assert dataset.format == "redwood"
    assert dataset.frame_ids == tuple(written)
    for frame_id, truth in written.items():
        frame = dataset.load(frame_id)
        assert frame.notes == ()
        assert np.array_equal(frame.rgb, truth.rgb)
        assert np.array_equal(frame.depth, truth.depth)
        assert np.array_equal(frame.camera.K, K)
        np.testing.assert_allclose(pose(frame), truth.T_world_camera, atol=1e-9)


def test_redwood_reads_nothing_above_but_the_camera_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write_redwood(tmp_path / "rec", ["0", "1"], "RGBD")
    (tmp_path / "rec/RGBD/trajectory.log").rename(tmp_path / "rec/trajectory.log")
    assert open_dataset(tmp_path / "rec").load("0").camera.T_world_camera is not None
    assert open_dataset(tmp_path / "rec/RGBD").load("0").camera.T_world_camera is None
    monkeypatch.chdir(tmp_path / "rec/RGBD")
    assert np.array_equal(open_dataset(".").load("0").camera.K, K)
    # Two folders up is never looked at, and a camera file of one's own goes first.
    (tmp_path / "rec/camera_primesense.json").rename(tmp_path / "camera_primesense.json")
    refused(lambda: open_dataset(tmp_path / "rec/RGBD"), "--intrinsics")
    camera = {"width": WIDTH, "height": HEIGHT, "intrinsic_matrix": [*(2 * K).T.ravel().tolist()[:8], 1]}
    (tmp_path / "rec/RGBD/intrinsics.json").write_text(json.dumps(camera))
    assert open_dataset(tmp_path / "rec/RGBD").load("0").camera.fx == 120


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda t: t.pop("width"), ["width is missing"]),
        (lambda t: t.update(width=640), ["another image size", "640x48", "64x48"]),
        (lambda t: t.update(intrinsic_matrix=K.ravel().tolist()), ["column by column"]),
        (lambda t: t["intrinsic_matrix"].pop(), ["count", "got 8"]),
        (lambda t: t.update(intrinsic_matrix=None), ["intrinsic_matrix"]),
        (lambda t: t.update(intrinsic_matrix="x"), ["not numbers"]),
        (lambda t: t["intrinsic_matrix"].__setitem__(0, -1), ["focal"]),
        (lambda t: t["intrinsic_matrix"].__setitem__(0, float("nan")), ["not finite"]),
    ],
)
def test_redwood_wrong_camera_file_is_refused(tmp_path: Path, change: Callable[[Any], Any], words: list[str]) -> None:
    write_redwood(tmp_path, ["0"])
    path = tmp_path / "camera_primesense.json"
    table = json.loads(path.read_text())
    change(table)
    path.write_text(json.dumps(table))
    refused(lambda: open_dataset(tmp_path).load("0"), *words, "camera_primesense.json")
    assert open_dataset(tmp_path, intrinsics=CAMERA).load("0").camera.fx == 60
    path.write_text('{"intrinsic_matrix": [1,')
    refused(lambda: open_dataset(tmp_path).load("0"), "malformed JSON", "camera_primesense.json")


@pytest.mark.parametrize(
    ("change", "word"),
    [
        (lambda lines: lines[:-1], "not whole"),
        (lambda lines: ["a b c", *lines[1:]], "line 1"),
        (lambda lines: ["0 0", *lines[1:]], "line 1"),
        (lambda lines: [lines[0], "1 2 3", *lines[2:]], "line 2"),
        (lambda lines: [lines[0], "1 2 3 x", *lines[2:]], "line 2"),
        (lambda lines: [*lines[:5], lines[0], *lines[6:]], "repeats frame 0"),
        (lambda lines: [*lines, "7 7 8", *lines[1:5], "8 8 9", *lines[1:5]], "4 poses for 2 frames"),
        (lambda lines: [], "empty"),
    ],
)
def test_redwood_malformed_trajectory_leaves_the_poses_out(
    tmp_path: Path, change: Callable[[list[str]], list[str]], word: str
) -> None:
    write_redwood(tmp_path, ["desk", "sofa"])
    path = tmp_path / "trajectory.log"
    path.write_text("\n".join(change(path.read_text().splitlines())))
    for report in survey(open_dataset(tmp_path)):
        assert report.ok
        assert not report.has_pose
        (note,) = (note for note in report.notes if "pose" in note)
        assert word in note


def test_redwood_poses_stay_with_their_frames(tmp_path: Path) -> None:
    written = write_redwood(tmp_path, ["0", "1", "2", "3"])
    for folder in ("color", "depth"):
        (tmp_path / folder / "2.png").unlink()
    dataset = open_dataset(tmp_path)
    assert dataset.frame_ids == ("0", "1", "3")
    for frame_id in dataset.frame_ids:
        np.testing.assert_allclose(pose(dataset.load(frame_id)), written[frame_id].T_world_camera, atol=1e-9)
    for folder in ("color", "depth"):
        (tmp_path / folder / "0.png").unlink()
    # Now the files begin at 1: they may as well count from 1 as have lost the first.
    assert "4 poses for 2 frames" in open_dataset(tmp_path).load("1").notes[0]
    lines = (tmp_path / "trajectory.log").read_text().splitlines()
    lines[1] = "inf 0 0 0"
    (tmp_path / "trajectory.log").write_text("\n".join(lines[:10]))
    lost, fine = (open_dataset(tmp_path).load(frame_id) for frame_id in ("1", "3"))
    assert lost.camera.T_world_camera is None
    assert "lost" in lost.notes[0]
    assert fine.camera.T_world_camera is not None


def test_redwood_times_in_the_names_may_differ_between_colour_and_depth(tmp_path: Path) -> None:
    names = ["0000001-000000000000", "0000002-000000033335", "0000003-000000066670"]
    written = write_redwood(tmp_path, names)
    for k, name in enumerate(names[1:]):
        (tmp_path / f"depth/{name}.png").rename(tmp_path / f"depth/{name[:8]}{5000 + k:012d}.png")
    dataset = open_dataset(tmp_path)
    assert dataset.frame_ids == tuple(names)
    for name, truth in written.items():
        frame = dataset.load(name)
        assert np.array_equal(frame.depth, truth.depth)
        np.testing.assert_allclose(pose(frame), truth.T_world_camera, atol=1e-9)
