"""ScanNet scenes: read back exactly, and what is broken said."""

from __future__ import annotations

import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest
from dataset_writers import (
    HEIGHT,
    WIDTH,
    K,
    write_png,
    write_scannet,
)
from recording_checks import pose, refused

from pipeline.datasets import open_dataset, survey

# ScanNet


def test_scannet_is_read_back_exactly(tmp_path: Path) -> None:
    written = write_scannet(tmp_path, [0, 2, 10])
    dataset = open_dataset(tmp_path)
    assert dataset.format == "scannet"
    assert dataset.frame_ids == ("0", "2", "10")
    for frame_id, truth in written.items():
        frame = dataset.load(frame_id)
        assert frame.notes == ()
        assert np.array_equal(frame.rgb, truth.rgb)
        assert np.array_equal(frame.depth, truth.depth)
        assert np.array_equal(frame.camera.K, K)
        np.testing.assert_allclose(pose(frame), truth.T_world_camera, atol=1e-12)
        assert frame.camera.up is None
    assert open_dataset(tmp_path, intrinsics=(80, 81, 30, 20), depth_scale=2000).load("2").camera.fx == 80


def test_scannet_larger_colour_is_made_as_large_as_the_depth_and_noted_once(tmp_path: Path) -> None:
    written = write_scannet(tmp_path, [0, 1])
    for frame_id, truth in written.items():
        large = cv2.resize(truth.rgb, (2 * WIDTH + 1, 2 * HEIGHT), interpolation=cv2.INTER_NEAREST)
        write_png(tmp_path / f"color/{frame_id}.png", large)
    dataset = open_dataset(tmp_path)
    frames = [dataset.load(frame_id) for frame_id in dataset.frame_ids]
    assert [len(frame.notes) for frame in frames] == [1, 0]
    assert "129x96" in frames[0].notes[0]
    assert "64x48" in frames[0].notes[0]
    for frame, truth in zip(frames, written.values(), strict=True):
        assert frame.rgb.shape == truth.rgb.shape
        # One column too many of 129 smears the noise a little; a shift of one pixel would give about 85.
        assert np.abs(frame.rgb.astype(int) - truth.rgb).mean() < 45
        assert np.array_equal(frame.camera.K, K)
    write_png(tmp_path / "color/1.png", np.zeros((96, 96, 3), np.uint8))
    refused(lambda: open_dataset(tmp_path).load("1"), "differ in size", "96x96")
    (tmp_path / "intrinsic/intrinsic_depth.txt").unlink()
    refused(lambda: open_dataset(tmp_path).load("0"), "missing", "intrinsic_depth.txt")


def test_scannet_colour_camera_serves_where_there_is_no_other_and_one_size(tmp_path: Path) -> None:
    write_scannet(tmp_path, [0])
    (tmp_path / "intrinsic/intrinsic_depth.txt").unlink()
    np.testing.assert_allclose(open_dataset(tmp_path).load("0").camera.K[:2], 2 * K[:2])


@pytest.mark.parametrize("content", ["-inf " * 16, "nan " * 16, "1 2 3", "", "lost", "2 0 0 0 " * 4])
def test_scannet_lost_pose_is_left_out_with_a_note(tmp_path: Path, content: str) -> None:
    write_scannet(tmp_path, [0, 1])
    (tmp_path / "pose/0.txt").write_text(content)
    lost, fine = (open_dataset(tmp_path).load(frame_id) for frame_id in ("0", "1"))
    assert lost.camera.T_world_camera is None
    assert len(lost.notes) == 1
    assert "no camera pose, 0.txt" in lost.notes[0]
    assert fine.camera.T_world_camera is not None
    (tmp_path / "pose/0.txt").unlink()
    assert "missing" in open_dataset(tmp_path).load("0").notes[0]
    shutil.rmtree(tmp_path / "pose")
    assert open_dataset(tmp_path).load("0").notes == ()


@pytest.mark.parametrize(
    ("content", "words"),
    [
        ("60 0 31.5 0 61 23.5 0 0 1", ["count", "got 9"]),
        ("60 0 31.5 0 0 61 23.5 0 0 0 1 0 0.1 0 0 1", ["last row"]),
        ("60 0 31.5 1 0 61 23.5 0 0 0 1 0 0 0 0 1", ["last column"]),
        ("60 0 0 0 0 61 0 0 31.5 23.5 1 0 0 0 0 1", ["column by column"]),
        ("-60 0 31.5 0 0 61 23.5 0 0 0 1 0 0 0 0 1", ["focal"]),
        ("nan 0 31.5 0 0 61 23.5 0 0 0 1 0 0 0 0 1", ["not finite"]),
        ("60 0 315 0 0 61 23.5 0 0 0 1 0 0 0 0 1", ["principal point"]),
        ("hello", ["not numbers"]),
    ],
)
def test_scannet_wrong_intrinsics_are_refused(tmp_path: Path, content: str, words: list[str]) -> None:
    write_scannet(tmp_path, [0])
    (tmp_path / "intrinsic/intrinsic_depth.txt").write_text(content)
    refused(lambda: open_dataset(tmp_path).load("0"), *words, "intrinsic_depth.txt")


def test_scannet_missing_and_cut_images_break_their_frame_only(tmp_path: Path) -> None:
    write_scannet(tmp_path, [0, 1, 2, 3])
    (tmp_path / "color/0.png").unlink()
    (tmp_path / "depth/1.png").unlink()
    path = tmp_path / "depth/2.png"
    path.write_bytes(path.read_bytes()[:-30])
    reports = list(survey(open_dataset(tmp_path)))
    assert [(report.id, report.ok) for report in reports] == [("0", False), ("1", False), ("2", False), ("3", True)]
    assert "colour file is missing" in str(reports[0].problem)
    assert "depth file is missing" in str(reports[1].problem)
    assert "cut off" in str(reports[2].problem)
