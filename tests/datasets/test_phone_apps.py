"""Recordings of apps and of published sets, written after their makers' documents, come back whole."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
from app_writers import (
    truths,
    write_colmap_binary,
    write_icl,
    write_polycam,
    write_replica,
    write_scannetpp,
    write_stray,
)
from dataset_writers import HEIGHT, WIDTH, K, Truth, write_png
from reader_checks import refused

from pipeline.answering.pipeline import open_sources
from pipeline.datasets import dataset_notes, open_dataset
from pipeline.geometry.frame import Frame


def check_geometry(frame: Frame, truth: Truth, near: float = 1e-6) -> None:
    assert np.array_equal(frame.depth, truth.depth)
    assert np.allclose(frame.camera.K, K, atol=near)
    assert frame.camera.T_world_camera is not None
    assert np.allclose(frame.camera.T_world_camera, truth.T_world_camera, atol=1e-6)


@pytest.mark.parametrize(("packed", "first"), [(True, 0), (False, 0), (False, 1)])
def test_stray_scanner_packed_and_unpacked(tmp_path: Path, packed: bool, first: int) -> None:
    made = truths(3)
    write_stray(tmp_path, made, packed, first)
    dataset = open_dataset(tmp_path)
    assert dataset.format == "stray-scanner"
    assert dataset.frame_ids == ("000000", "000001", "000002")
    # Out of order, as a video is not read.
    for number in (2, 0, 1):
        frame = dataset.load(dataset.frame_ids[number])
        check_geometry(frame, made[number])
        assert np.abs(frame.rgb.astype(int) - made[number].rgb).max() <= (12 if packed else 0)
    notes = dataset_notes(dataset)
    assert notes[0].startswith("not read: imu.csv")
    assert any("in order" in note for note in notes) == bool(first)


def test_a_pose_that_stray_scanner_lost_is_told(tmp_path: Path) -> None:
    write_stray(tmp_path, truths(3), packed=False)
    lines = (tmp_path / "odometry.csv").read_text().splitlines()
    (tmp_path / "odometry.csv").write_text("\n".join(lines[:3]))
    frames = [open_dataset(tmp_path).load(f"{n:06d}") for n in range(3)]
    assert [frame.camera.T_world_camera is not None for frame in frames] == [True, True, False]
    assert any("odometry.csv has none" in note for note in frames[2].notes)
    (tmp_path / "odometry.csv").write_text("timestamp, frame, x\n1, 2, 3")
    frame = open_dataset(tmp_path).load("000000")
    assert any("odometry.csv" in note for note in frame.notes)


def test_a_video_that_is_cut_off_is_named(tmp_path: Path) -> None:
    write_stray(tmp_path, truths(3), packed=True)
    (tmp_path / "rgb.mp4").write_bytes((tmp_path / "rgb.mp4").read_bytes()[:200])
    refused(lambda: open_dataset(tmp_path), "rgb.mp4", "ffmpeg")


@pytest.mark.parametrize("corrected", [True, False])
def test_polycam(tmp_path: Path, corrected: bool) -> None:
    made = truths(2)
    write_polycam(tmp_path, made, corrected)
    for root in (tmp_path, tmp_path / "keyframes"):
        dataset = open_dataset(root)
        assert dataset.format == "polycam"
        for frame_id, truth in zip(dataset.frame_ids, made, strict=True):
            frame = dataset.load(frame_id)
            check_geometry(frame, truth)
            assert np.array_equal(frame.rgb, truth.rgb)
            assert frame.camera.up is not None
            assert np.allclose(frame.camera.up, truth.T_world_camera[1, :3])
    assert any("without corrected" in note for note in dataset_notes(dataset)) != corrected


@pytest.mark.parametrize("how", ["lz4", "deflate", "stream", "unpacked"])
def test_scannetpp_iphone(tmp_path: Path, how: str) -> None:
    if how == "lz4":
        pytest.importorskip("lz4.block")
    made = truths(3)
    write_scannetpp(tmp_path, made, how)
    dataset = open_dataset(tmp_path)
    assert dataset.format == "scannet++"
    for frame_id, truth in zip(dataset.frame_ids, made, strict=True):
        frame = dataset.load(frame_id)
        assert frame.depth.shape == (192, 256)
        assert np.allclose(frame.depth[:HEIGHT, :WIDTH], truth.depth, atol=0.0011)
        assert frame.camera.T_world_camera is not None
        assert np.allclose(frame.camera.T_world_camera, truth.T_world_camera, atol=1e-9)
        assert np.abs(frame.rgb.astype(int) - truth.rgb[0, 0]).max() <= 2
    if how != "unpacked":
        path = tmp_path / "iphone/depth.bin"
        path.write_bytes(path.read_bytes()[:-9])
        refused(lambda: [open_dataset(tmp_path).load(frame_id) for frame_id in dataset.frame_ids], "depth")


@pytest.mark.parametrize("inside", ["", "results"])
def test_replica_as_nice_slam_has_it(tmp_path: Path, inside: str) -> None:
    made = truths(3)
    room = write_replica(tmp_path, made, 6553.5)
    dataset = open_dataset(room / inside)
    assert dataset.format == "replica"
    assert dataset_notes(dataset) == ()
    for frame_id, truth in zip(dataset.frame_ids, made, strict=True):
        frame = dataset.load(frame_id)
        assert np.allclose(frame.depth, truth.depth, atol=1 / 6553)
        assert np.allclose(frame.camera.K, K)
        assert frame.camera.T_world_camera is not None
        assert np.allclose(frame.camera.T_world_camera, truth.T_world_camera, atol=1e-9)
    assert open_sources(tmp_path)[1] == {}
    (tmp_path / "cam_params.json").unlink()
    refused(lambda: open_dataset(room), "camera", "--intrinsics")
    told = open_dataset(room, intrinsics=(60.0, 61.0, 31.5, 23.5))
    assert any("6553.5" in note for note in dataset_notes(told))


@pytest.mark.parametrize("reflected", [True, False])
def test_icl_nuim(tmp_path: Path, reflected: bool) -> None:
    made = truths(3)
    # Cameras that are held upright, y down, in a world whose y is down (as drawn) or whose z is up.
    turn = np.eye(4) if reflected else np.array([[1.0, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, 0], [0, 0, 0, 1]])
    for number, truth in enumerate(made):
        truth.T_world_camera[:3, :3] = cv2.Rodrigues(np.array([0.02, 0.2 * number, 0.01]))[0]
        truth.T_world_camera[:] = turn @ truth.T_world_camera
    if not reflected:
        for truth in made:
            truth.T_world_camera[:] = truth.T_world_camera @ np.diag([1.0, -1, -1, 1])
    write_icl(tmp_path, made, reflected)
    camera = (60.0, 61.0, 31.5, 23.5)
    refused(lambda: open_dataset(tmp_path).load("0"), "640x480", "--intrinsics")
    refused(lambda: open_dataset(tmp_path, intrinsics=(60.0, -61.0, 31.5, 23.5)), "fy=-61", "y is up", "fy=61")
    dataset = open_dataset(tmp_path, intrinsics=camera)
    for frame_id, truth in zip(dataset.frame_ids, made, strict=True):
        check_geometry(dataset.load(frame_id), truth)
    (note,) = (note for note in dataset_notes(dataset) if "livingRoom2" in note)
    assert ("reflected" in note) == reflected
    # The camera as SLAM programs take it, "fx fy cx cy" of its page: princeton-vl/DPVO, calib/*.txt.
    (tmp_path / "calib.txt").write_text("60.0 -61.0 31.5 23.5\n")
    dataset = open_dataset(tmp_path)
    if reflected:
        check_geometry(dataset.load("0"), made[0])
        assert any("fy -61 of calib.txt" in note for note in dataset_notes(dataset))
        assert not any("not read" in note for note in dataset_notes(dataset))
    else:
        refused(lambda: dataset.load("0"), "fy=-61", "y is up", "fy=61", "calib.txt")
    (tmp_path / "calib.txt").write_text("60.0 61.0 31.5 23.5\n")
    check_geometry(open_dataset(tmp_path).load("0"), made[0])


def test_associations_of_tum_name_their_pictures_in_either_order(tmp_path: Path) -> None:
    made = truths(2)
    write_icl(tmp_path, made, reflected=False)
    (tmp_path / "livingRoom2.gt.freiburg").rename(tmp_path / "groundtruth.txt")
    lines = (line.split() for line in (tmp_path / "associations.txt").read_text().splitlines())
    (tmp_path / "associations.txt").write_text("\n".join(" ".join(words[2:] + words[:2]) for words in lines))
    dataset = open_dataset(tmp_path, intrinsics=(60.0, 61.0, 31.5, 23.5))
    for frame_id, truth in zip(dataset.frame_ids, made, strict=True):
        check_geometry(dataset.load(frame_id), truth)
    (tmp_path / "associations.txt").write_text("0 a/0.png 0 b/0.png\n")
    refused(lambda: open_dataset(tmp_path), "line 1", "depth")


def test_colmap_binary_models(tmp_path: Path) -> None:
    made = truths(3)
    names = [f"view {number}.png" for number in range(3)]
    for truth, name in zip(made, names, strict=True):
        write_png(tmp_path / "images" / name, truth.rgb)
        write_png(tmp_path / "depth" / name, truth.millimetres)
    write_colmap_binary(tmp_path / "sparse/0", made, names)
    dataset = open_dataset(tmp_path, depth_scale=1000)
    assert dataset.format == "colmap"
    for frame_id, truth in zip(dataset.frame_ids, made, strict=True):
        check_geometry(dataset.load(frame_id), truth)
    whole = (tmp_path / "sparse/0/images.bin").read_bytes()
    for size in range(0, len(whole), 7):
        (tmp_path / "sparse/0/images.bin").write_bytes(whole[:size])
        refused(lambda: open_dataset(tmp_path, depth_scale=1000), "images.bin")


def test_a_recording_of_spectacular_ai_is_named_with_what_would_do(tmp_path: Path) -> None:
    for name in ("data.jsonl", "calibration.json", "data.mkv", "vio_config.yaml"):
        (tmp_path / name).write_text("{}")
    refused(lambda: open_dataset(tmp_path), "Spectacular AI", "sai-cli process")
