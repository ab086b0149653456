"""SUN RGB-D, as published and as VoteNet exports it."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest
from dataset_writers import (
    HEIGHT,
    WIDTH,
    K,
    write_sunrgbd,
    write_votenet,
)
from recording_checks import refused

from pipeline.datasets import open_dataset, survey

# SUN RGB-D


@pytest.mark.parametrize("prefix", ["", "kv1/NYUdata/", "xtion/sun3ddata/house/room/"])
def test_sunrgbd_is_read_back_exactly(tmp_path: Path, prefix: str) -> None:
    ids = [f"{prefix}{name}" for name in ("NYU0002", "NYU0010")]
    written = write_sunrgbd(tmp_path, ids)
    dataset = open_dataset(tmp_path)
    assert dataset.format == "sunrgbd"
    assert dataset.frame_ids == tuple(ids)
    for frame_id, (truth, Rtilt) in written.items():
        frame = dataset.load(frame_id)
        assert frame.notes == ()
        assert np.array_equal(frame.rgb, truth.rgb)
        assert np.array_equal(frame.depth, truth.depth)
        np.testing.assert_allclose(frame.camera.K, K)
        assert frame.camera.up_source == "declared"
        assert frame.camera.up is not None
        x, y, z = frame.camera.up
        np.testing.assert_allclose(Rtilt @ [x, z, -y], [0, 0, 1], atol=1e-5)
        assert y < -0.9
    alone = open_dataset(tmp_path / ids[0])
    assert alone.frame_ids == ("NYU0002",)
    assert np.array_equal(alone.load("NYU0002").depth, written[ids[0]][0].depth)
    assert open_dataset(tmp_path, intrinsics=(80, 81, 30, 20)).load(ids[0]).camera.fx == 80


def test_sunrgbd_filled_depth_is_the_second_choice(tmp_path: Path) -> None:
    write_sunrgbd(tmp_path, ["a"])
    shutil.rmtree(tmp_path / "a/depth")
    frame = open_dataset(tmp_path).load("a")
    assert (frame.depth == 2).all()
    assert "depth_bfx/ is used" in frame.notes[0]


@pytest.mark.parametrize("content", ["", "1 0 0", "lost", "nan " * 12, "2 0 0 0 0 2 0 0 0 0 2 0", None])
def test_sunrgbd_without_a_tilt_has_no_up(tmp_path: Path, content: str | None) -> None:
    write_sunrgbd(tmp_path, ["a", "b"])
    path = tmp_path / "a/extrinsics/20141221170930.txt"
    path.unlink() if content is None else path.write_text(content)
    frame = open_dataset(tmp_path).load("a")
    assert frame.camera.up is None
    assert "no up vector" in frame.notes[0]
    assert open_dataset(tmp_path).load("b").camera.up is not None
    np.savetxt(tmp_path / "a/extrinsics/20150101000000.txt", np.eye(3, 4))
    newest = open_dataset(tmp_path).load("a").camera.up
    assert newest is not None
    np.testing.assert_allclose(newest, [0, -1, 0], atol=1e-12)


def test_sunrgbd_broken_folders_are_broken_frames(tmp_path: Path) -> None:
    write_sunrgbd(tmp_path, [f"{k}" for k in range(8)])
    (tmp_path / "0/image/0000001.png").unlink()
    shutil.rmtree(tmp_path / "1/image")
    (tmp_path / "2/depth/0000001.png").unlink()
    (tmp_path / "3/intrinsics.txt").unlink()
    (tmp_path / "4/intrinsics.txt").write_text("60 0 31.5")
    path = tmp_path / "5/depth/0000001.png"
    path.write_bytes(path.read_bytes()[:-30])
    np.save(tmp_path / "depth.npy", np.zeros((HEIGHT, WIDTH)))
    shutil.move(tmp_path / "depth.npy", tmp_path / "6/depth/0000001.png")
    reports = list(survey(open_dataset(tmp_path)))
    assert [report.ok for report in reports] == [False] * 7 + [True]
    words = ["colour file", "colour file", "depth file", "missing", "count", "cut off", "rotated bits"]
    for word, report in zip(words, reports, strict=False):
        assert word in str(report.problem)


def test_sunrgbd_links_out_of_the_folder_are_not_followed(tmp_path: Path) -> None:
    write_sunrgbd(tmp_path / "data", ["kv1/a"])
    write_sunrgbd(tmp_path / "elsewhere", ["b"])
    (tmp_path / "data/kv1/b").symlink_to(tmp_path / "elsewhere/b")
    (tmp_path / "data/kv2").symlink_to(tmp_path / "elsewhere")
    (tmp_path / "data/kv1/again").symlink_to(tmp_path / "data")
    assert open_dataset(tmp_path / "data").frame_ids == ("kv1/a",)


# SUN RGB-D as VoteNet exports it


@pytest.mark.parametrize("inside", ["", "sunrgbd_trainval"])
def test_votenet_is_read_back_exactly(tmp_path: Path, inside: str) -> None:
    written = write_votenet(tmp_path / inside, ["000002", "000010"])
    dataset = open_dataset(tmp_path)
    assert dataset.format == "sunrgbd-votenet"
    assert dataset.frame_ids == ("000002", "000010")
    assert dataset.class_names == ("chair",)
    for frame_id, (truth, Rtilt) in written.items():
        frame = dataset.load(frame_id)
        assert frame.notes == ()
        assert np.abs(frame.rgb.astype(int) - truth.rgb).max() <= 3
        assert np.array_equal(frame.depth > 0, truth.depth > 0)
        np.testing.assert_allclose(frame.depth, truth.depth, rtol=1e-5)
        np.testing.assert_allclose(frame.camera.K, K)
        (chair,) = frame.annotations
        assert (chair.label, chair.mask) == ("chair", None)
        assert chair.bbox.tolist() == [10, 5, 30, 35]
        assert chair.box is not None
        corners = chair.box.corners
        upright = np.stack([corners[:, 0], corners[:, 2], -corners[:, 1]], axis=1) @ Rtilt.T
        forward, across = np.array([0.6, -0.8, 0]), np.array([-0.8, -0.6, 0])
        local = (upright - [0.1, 2.5, -0.4]) @ np.stack([across, forward, [0, 0, 1]], axis=1)
        np.testing.assert_allclose(np.abs(local), np.tile([0.3, 0.5, 0.4], (8, 1)), atol=1e-6)


def test_votenet_without_labels_is_a_recording(tmp_path: Path) -> None:
    write_votenet(tmp_path, ["1", "2"])
    (tmp_path / "label/1.txt").unlink()
    (tmp_path / "label/2.txt").write_text("")
    dataset = open_dataset(tmp_path)
    assert dataset.class_names == ()
    assert "no labels, 1.txt" in dataset.load("1").notes[0]
    assert dataset.load("2").notes == ()
    shutil.rmtree(tmp_path / "label")
    frame = open_dataset(tmp_path).load("1")
    assert frame.notes == ()
    assert frame.annotations == ()


@pytest.mark.parametrize(
    ("line", "word"),
    [
        ("sofa", "count"),
        ("sofa 1 2 3 4 5 6", "count"),
        ("sofa 1 2 3 4 0 2 0 1 1 1 x 0", "not numbers"),
        ("sofa 1 2 3 4 0 2 0 1 1 1 nan 0", "NaN"),
        ("sofa 1 2 0 4 0 2 0 1 1 1 1 0", "empty 2D box"),
        ("sofa 1 2 3 4 0 2 0 1 1 1 0 0", "no orientation"),
        ("sofa 1 2 3 4 0 2 0 1 -1 1 1 0", "at least 0"),
    ],
)
def test_votenet_malformed_label_leaves_the_others(tmp_path: Path, line: str, word: str) -> None:
    write_votenet(tmp_path, ["1"])
    path = tmp_path / "label/1.txt"
    path.write_text(f"{line}\n{path.read_text()}")
    frame = open_dataset(tmp_path).load("1")
    assert [(a.index, a.label) for a in frame.annotations] == [(1, "chair")]
    (note,) = frame.notes
    assert "annotation 0 (sofa), line 1" in note
    assert word in note


def test_votenet_wrong_calibrations_are_refused(tmp_path: Path) -> None:
    write_votenet(tmp_path, ["1", "2"])
    calib = tmp_path / "calib/1.txt"
    tilt, K_line = calib.read_text().splitlines()
    for text, words in (
        ((tmp_path / "calib/2.txt").read_text(), ["do not project to pixels", "1.mat"]),
        (f"{tilt}\n60 0 0 0 61 0 32 24 1", ["do not project to pixels"]),
        (f"{tilt}\n60 0 0 0 61 0 92.5 24.5 1", ["outside the image"]),
        (f"{tilt}\n60 0 32.5 0 61 24.5 0 0 1", ["column by column"]),
        (f"{tilt}\nnan 0 0 0 61 0 32.5 24.5 1", ["column by column"]),
        (tilt, ["two lines"]),
        (f"1 2 3\n{K_line}", ["count", "line 1"]),
        (f"2 0 0 0 2 0 0 0 2\n{K_line}", ["not a rotation", "1.txt"]),
    ):
        calib.write_text(text)
        refused(lambda: open_dataset(tmp_path).load("1"), *words)
    calib.unlink()
    refused(lambda: open_dataset(tmp_path).load("1"), "missing", "calib/1.txt")
    assert open_dataset(tmp_path).load("2").depth.any()


def test_votenet_wrong_point_files_are_refused(tmp_path: Path) -> None:
    from scipy.io import savemat

    write_votenet(tmp_path, ["1", "2"])
    path = tmp_path / "depth/1.mat"
    whole = path.read_bytes()
    for content in (b"", b"MATLAB 7.3", b"hello" * 100, whole[: len(whole) // 2], whole[:-20], whole[:130]):
        path.write_bytes(content)
        refused(lambda: open_dataset(tmp_path).load("1"), "1.mat")
    for table in (
        {"other": np.ones((3, 6))},
        {"instance": np.ones(3)},
        {"instance": np.array([["a" * 6] * 6])},
        {"instance": np.full((4, 6), np.nan)},
        {"instance": np.zeros((0, 6))},
        {"instance": np.array([[0, -1, 0, 0, 0, 0.0]])},
    ):
        savemat(path, table)
        refused(lambda: open_dataset(tmp_path).load("1"), "1.mat")
    path.unlink()
    refused(lambda: open_dataset(tmp_path).load("1"), "missing", "1.mat")
    (tmp_path / "image/2.jpg").unlink()
    assert [report.ok for report in survey(open_dataset(tmp_path))] == [False, False]
