"""7-Scenes: read back exactly, with its camera and its lost poses."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from dataset_writers import (
    K,
    write_png,
    write_seven_scenes,
)
from reader_checks import refused

from pipeline.datasets import (
    open_dataset,
    survey,
)

# 7-Scenes


@pytest.mark.parametrize("folder", ["", "seq-01"])
def test_seven_scenes_is_read_back_exactly(tmp_path: Path, folder: str) -> None:
    (tmp_path / folder).mkdir(exist_ok=True)
    written = write_seven_scenes(tmp_path / folder, 2)
    dataset = open_dataset(tmp_path)
    prefix = f"{folder}/" if folder else ""
    assert dataset.format == "7-scenes"
    assert dataset.frame_ids == (f"{prefix}frame-000000", f"{prefix}frame-000001")
    assert dataset.class_names == ()
    for frame_id, truth in zip(dataset.frame_ids, written, strict=True):
        frame = dataset.load(frame_id)
        assert np.array_equal(frame.rgb, truth.rgb)
        assert np.array_equal(frame.depth, truth.depth)
        assert (frame.depth[:3, :5] == 0).all()
        assert np.array_equal(frame.camera.K, K)
        assert frame.camera.T_world_camera is not None
        np.testing.assert_allclose(frame.camera.T_world_camera, truth.T_world_camera, atol=1e-12)


def test_seven_scenes_own_camera_is_for_its_own_size_only(tmp_path: Path) -> None:
    write_seven_scenes(tmp_path, 1)
    (tmp_path / "camera-intrinsics.txt").unlink()
    refused(lambda: open_dataset(tmp_path).load("frame-000000"), "640x480", "--intrinsics")
    given_K = open_dataset(tmp_path, intrinsics=(60, 61, 31.5, 23.5)).load("frame-000000").camera.K
    assert np.array_equal(given_K, K)
    write_png(tmp_path / "frame-000000.color.png", np.zeros((480, 640, 3), np.uint8))
    write_png(tmp_path / "frame-000000.depth.png", np.full((480, 640), 1500, np.uint16))
    camera = open_dataset(tmp_path).load("frame-000000").camera
    assert (camera.fx, camera.fy, camera.cx, camera.cy) == (585, 585, 320, 240)


@pytest.mark.parametrize("content", ["inf " * 16, "nan " * 16, "1 2 3", "", "lost", "2 0 0 0 " * 4])
def test_seven_scenes_unusable_pose_is_left_out_with_a_note(tmp_path: Path, content: str) -> None:
    write_seven_scenes(tmp_path, 1)
    (tmp_path / "frame-000000.pose.txt").write_text(content)
    frame = open_dataset(tmp_path).load("frame-000000")
    assert frame.camera.T_world_camera is None
    assert len(frame.notes) == 1
    assert "no camera pose, frame-000000.pose.txt" in frame.notes[0]


def test_seven_scenes_frame_without_depth_or_colour_is_broken(tmp_path: Path) -> None:
    write_seven_scenes(tmp_path, 3)
    (tmp_path / "frame-000000.depth.png").unlink()
    (tmp_path / "frame-000002.color.png").unlink()
    reports = list(survey(open_dataset(tmp_path)))
    assert [r.ok for r in reports] == [False, True, False]
    assert "depth file is missing" in str(reports[0].problem)
    assert "colour file is missing" in str(reports[2].problem)
