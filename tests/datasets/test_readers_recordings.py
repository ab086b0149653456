"""Readers of recordings: TUM, ScanNet, Redwood, SUN RGB-D; round trips, hostile input, the real ones."""

from __future__ import annotations

import json
import pickle
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from dataset_writers import (
    HEIGHT,
    WIDTH,
    K,
    write_folder,
)
from every_format import WRITERS
from recording_checks import CAMERA, pose, refused

from pipeline.datasets import open_dataset, survey
from pipeline.geometry import backproject
from pipeline.geometry.level_plane import level_plane


def degrees(a: np.ndarray, b: np.ndarray) -> float:
    return float(np.degrees(np.arccos(np.clip(a @ b / np.linalg.norm(a) / np.linalg.norm(b), -1, 1))))


# Which format a folder has


@pytest.mark.parametrize("name", WRITERS)
def test_every_format_is_told_from_the_others(tmp_path: Path, name: str) -> None:
    root = tmp_path / "data"
    root.mkdir()
    WRITERS[name](root)
    dataset = open_dataset(root, intrinsics=CAMERA, depth_scale=None if name != "folder" else 1000)
    assert dataset.format == name
    assert dataset.root == root
    reports = list(survey(dataset))
    assert reports
    assert all(report.ok for report in reports), [report.problem for report in reports]
    again = pickle.loads(pickle.dumps(dataset))
    assert np.array_equal(again.load(dataset.frame_ids[0]).depth, dataset.load(dataset.frame_ids[0]).depth)


def test_a_folder_of_datasets_is_no_dataset_of_one_of_their_formats(tmp_path: Path) -> None:
    for name in ("tum", "scannet", "redwood", "sunrgbd", "avd", "semantic-abstraction", "folder"):
        (tmp_path / name).mkdir()
        WRITERS[name](tmp_path / name)
    refused(lambda: open_dataset(tmp_path), "no dataset is recognised", "a folder of 7 datasets", "avd")


@pytest.mark.parametrize("mark", ["pose.txt", "other.json", "large.json", "sun3d", "float"])
def test_a_plain_recording_stays_one(tmp_path: Path, mark: str) -> None:
    """Its poses, a foreign file above it, many images beside intrinsics.txt: none makes it another format."""
    root = tmp_path / "rec"
    write_folder(root, [1, 2], poses=mark == "pose.txt")
    camera = {"width": WIDTH, "height": HEIGHT, "intrinsic_matrix": K.T.ravel().tolist()}
    if mark == "pose.txt":
        (tmp_path / "intrinsics.json").write_text(json.dumps(camera))
    elif mark == "other.json":
        (tmp_path / "intrinsics.json").write_text('{"fx": 1}')
    elif mark == "large.json":
        (tmp_path / "intrinsics.json").write_text(json.dumps({**camera, "more": "x" * 100_000}))
    elif mark == "sun3d":
        (root / "rgb").rename(root / "image")
        (root / "extrinsics").mkdir()
        np.savetxt(root / "intrinsics.txt", K)
    else:
        (root / "intrinsics.json").write_text(json.dumps(camera))
        for number in (1, 2):
            (root / f"depth/{number}.png").unlink()
            np.save(root / f"depth/{number}.npy", np.full((HEIGHT, WIDTH), 1.5, np.float32))
    dataset = open_dataset(root, intrinsics=CAMERA, depth_scale=1.0 if mark == "float" else 1000)
    assert dataset.format == "folder"
    assert (dataset.load("1").camera.T_world_camera is not None) == (mark == "pose.txt")


# The real recordings


@pytest.mark.parametrize(
    ("folder", "name"),
    [
        ("open3d-testdata", "redwood"),
        ("open3d-testdata/RGBD", "redwood"),
        ("sunrgbd-toy", "sunrgbd-votenet"),
        ("sunrgbd-toy/sunrgbd_trainval", "sunrgbd-votenet"),
        ("sunrgbd-toy/images", "sunrgbd"),
        ("sunrgbd-toy/images/img_0063", "sunrgbd"),
        ("ycbv-bop", "bop"),
        ("7scenes-redkitchen", "7-scenes"),
        ("slambook-diningroom", "folder"),
    ],
)
def test_real_recordings_are_told_apart(shared_data: Path, folder: str, name: str) -> None:
    given_by_hand: dict[str, Any] = {"intrinsics": (518, 519, 325.5, 253.5), "depth_scale": 1000}
    options = given_by_hand if name == "folder" else {}
    assert open_dataset(shared_data / "real" / folder, **options).format == name


def test_the_folder_of_all_real_recordings_is_none(shared_data: Path) -> None:
    refused(lambda: open_dataset(shared_data / "real"), "no dataset is recognised")


@pytest.mark.parametrize("opened", ["", "RGBD"])
def test_real_redwood(shared_data: Path, opened: str) -> None:
    root = shared_data / "real/open3d-testdata"
    dataset = open_dataset(root / opened)
    assert dataset.frame_ids == tuple(f"{k:05d}" for k in range(5))
    blocks = np.loadtxt(root / "RGBD/trajectory.log", usecols=range(3), ndmin=2).reshape(5, 5, 3)
    frames = [dataset.load(frame_id) for frame_id in dataset.frame_ids]
    for frame, block in zip(frames, blocks, strict=True):
        assert frame.notes == ()
        assert frame.camera.K.tolist() == [[525, 0, 319.5], [0, 525, 239.5], [0, 0, 1]]
        np.testing.assert_allclose(pose(frame)[:3, :3], block[1:4], atol=1e-12)
        assert 1 < np.median(frame.depth[frame.depth > 0]) < 3


def test_real_redwood_poses_put_the_first_view_on_the_last(shared_data: Path) -> None:
    dataset = open_dataset(shared_data / "real/open3d-testdata")
    a, b = dataset.load("00000"), dataset.load("00004")

    def error(T: np.ndarray) -> float:
        v, u = (grid.ravel() for grid in np.mgrid[0:480:4, 0:640:4])
        points = backproject(a.depth, a.camera, v, u).astype(np.float64)
        moved = points[points[:, 2] > 0] @ T[:3, :3].T + T[:3, 3]
        x, y = (np.round(moved[:, k] / moved[:, 2] * 525 + c).astype(int) for k, c in ((0, 319.5), (1, 239.5)))
        inside = (x >= 0) & (x < 640) & (y >= 0) & (y < 480)
        seen = b.depth[y[inside], x[inside]]
        return float(np.median(np.abs(seen - moved[inside, 2])[seen > 0]))

    right = error(np.linalg.inv(pose(b)) @ pose(a))
    assert right < 0.02
    assert error(pose(b) @ np.linalg.inv(pose(a))) > 2 * right


def test_real_sunrgbd_folders(shared_data: Path) -> None:
    dataset = open_dataset(shared_data / "real/sunrgbd-toy/images")
    assert dataset.frame_ids == ("2014-12-18_11-31-54_260595134347", "img_0063")
    for frame_id, size, fx in zip(dataset.frame_ids, ((530, 730), (427, 561)), (529.5, 520.532), strict=True):
        frame = dataset.load(frame_id)
        assert frame.notes == ()
        assert frame.depth.shape == size
        assert frame.camera.fx == fx
        assert 1 < np.median(frame.depth[frame.depth > 0]) < 4
        assert frame.camera.up is not None
        assert frame.camera.up_source == "declared"
        plane = level_plane(frame.depth, frame.camera)
        assert plane is not None
        # The office's floor is 1.1 degrees off, the shelf of the other 6.1; read transposed, both are over 15 off.
        assert degrees(plane, frame.camera.up) < 7
        assert degrees(plane, frame.camera.up * [1, 1, -1]) > 15


@pytest.mark.slow
def test_real_bedroom_depth_is_the_image_that_the_points_came_from(shared_data: Path) -> None:
    from scipy.io import loadmat

    root = shared_data / "real/sunrgbd-toy/sunrgbd_trainval"
    frame = open_dataset(root).load("000001")
    assert frame.rgb.shape == (530, 730, 3)
    assert frame.camera.K.tolist() == [[529.5, 0, 364], [0, 529.5, 264], [0, 0, 1]]
    instance = loadmat(root / "depth/000001.mat")["instance"]
    v, u = np.nonzero(frame.depth)
    assert len(v) == len(instance)
    x, y, z = backproject(frame.depth, frame.camera, v, u).astype(np.float64).T
    Rtilt = np.array((root / "calib/000001.txt").read_text().split()[:9], float).reshape(3, 3).T
    upright = np.stack([x, z, -y], axis=1) @ Rtilt.T
    # Rows of the file stand column by column; in that order the points and the colours are the file's own.
    order = np.lexsort((v, u))
    np.testing.assert_allclose(upright[order], instance[:, :3], atol=1e-4)
    np.testing.assert_allclose(frame.rgb[v, u][order] / 255, instance[:, 3:], atol=1e-6)


def test_real_bedroom_boxes_are_the_files_own(shared_data: Path) -> None:
    root = shared_data / "real/sunrgbd-toy"
    dataset = open_dataset(root)
    names = ("bed", "dresser", "dresser_mirror", "lamp", "night_stand", "ottoman")
    assert dataset.class_names == names
    frame = dataset.load("000001")
    assert frame.notes == ()
    lines = [line.split() for line in (root / "sunrgbd_trainval/label/000001.txt").read_text().splitlines()]
    assert [a.label for a in frame.annotations] == [line[0] for line in lines]
    calib = (root / "sunrgbd_trainval/calib/000001.txt").read_text().split()
    Rtilt = np.array(calib[:9], float).reshape(3, 3).T

    def upright(v: np.ndarray) -> np.ndarray:
        return Rtilt @ np.array([v[0], v[2], -v[1]])

    assert frame.camera.up is not None
    assert degrees(upright(frame.camera.up), np.array([0, 0, 1])) < 0.01
    plane = level_plane(frame.depth, frame.camera)
    assert plane is not None
    assert degrees(plane, frame.camera.up) < 2
    rows, columns = np.nonzero(frame.depth)
    points = backproject(frame.depth, frame.camera, rows, columns)
    for annotation, line in zip(frame.annotations, lines, strict=True):
        numbers = np.array(line[1:], float)
        box = annotation.box
        assert box is not None
        assert np.abs(upright(box.center) - numbers[4:7]).max() < 0.001
        np.testing.assert_allclose(box.size / 2, numbers[7:10], atol=1e-9)
        along = upright(box.R[:, 1])
        assert degrees(along[:2], numbers[10:12]) < 0.1
        assert degrees(upright(box.R[:, 2]), np.array([0, 0, 1])) < 0.1
        # What is measured inside the 3D box is seen inside the 2D box, which was drawn independently.
        inside = (np.abs((points - box.center) @ box.R) <= box.size / 2).all(axis=1)
        x0, y0, x1, y1 = annotation.bbox
        seen = (columns >= x0) & (columns < x1) & (rows >= y0) & (rows < y1)
        assert inside.sum() > 150
        assert (inside & seen).sum() > 0.98 * inside.sum()
        assert (inside & seen).sum() > 0.05 * seen.sum()
