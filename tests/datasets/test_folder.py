"""Any other folder of colour and depth: read back exactly, or asked for what it lacks."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from dataset_writers import (
    HEIGHT,
    WIDTH,
    K,
    write_folder,
    write_png,
)
from reader_checks import FOLDER, refused

from pipeline.datasets import (
    open_dataset,
    survey,
)

# Any other folder


def test_folder_is_read_back_exactly(tmp_path: Path) -> None:
    written = write_folder(tmp_path, [1, 2, 9, 10])
    dataset = open_dataset(tmp_path, **FOLDER)
    assert dataset.format == "folder"
    assert dataset.frame_ids == ("1", "2", "9", "10")
    for frame_id, truth in zip(dataset.frame_ids, written, strict=True):
        frame = dataset.load(frame_id)
        assert np.array_equal(frame.rgb, truth.rgb)
        assert np.array_equal(frame.depth, truth.depth)
        assert np.array_equal(frame.camera.K, K)
        assert frame.camera.T_world_camera is not None
        np.testing.assert_allclose(frame.camera.T_world_camera, truth.T_world_camera, atol=1e-7)


def write_pgm(path: Path, depth: np.ndarray) -> None:
    path.write_bytes(b"P5\n# depth\n64 48\n65535\n" + depth.astype(">u2").tobytes())


def write_npy(path: Path, depth: np.ndarray) -> None:
    np.save(path, depth)


def write_tiff(path: Path, depth: np.ndarray) -> None:
    assert cv2.imwrite(str(path), depth)


@pytest.mark.parametrize(
    ("suffix", "write", "dtype", "scale"),
    [
        (".pgm", write_pgm, np.uint16, 1000.0),
        (".tiff", write_tiff, np.uint16, 1000.0),
        (".tiff", write_tiff, np.float32, None),
        (".npy", write_npy, np.uint16, 1000.0),
        (".npy", write_npy, np.float32, None),
        (".npy", write_npy, np.float64, None),
        (".npy", write_npy, np.float32, 1000.0),
    ],
)
def test_folder_depth_formats(
    tmp_path: Path, suffix: str, write: Callable[[Path, np.ndarray], None], dtype: Any, scale: float | None
) -> None:
    (truth,) = write_folder(tmp_path, [1])
    (tmp_path / "depth/1.png").unlink()
    stored = truth.millimetres if scale else truth.millimetres.astype(np.float64) / 1000
    write(tmp_path / f"depth/1{suffix}", stored.astype(dtype))
    dataset = open_dataset(tmp_path, intrinsics=FOLDER["intrinsics"], depth_scale=scale)
    assert np.array_equal(dataset.load("1").depth, truth.depth)


def test_folder_asks_for_what_it_lacks(tmp_path: Path) -> None:
    write_folder(tmp_path, [1])
    refused(lambda: open_dataset(tmp_path), "--intrinsics fx,fy,cx,cy", "--depth-scale UNITS_PER_METRE")
    only_scale = refused(lambda: open_dataset(tmp_path, intrinsics=FOLDER["intrinsics"]), "--depth-scale")
    assert "--intrinsics" not in only_scale
    (tmp_path / "depth/1.png").unlink()
    np.save(tmp_path / "depth/1.npy", np.full((HEIGHT, WIDTH), 1500, np.int32))
    dataset = open_dataset(tmp_path, intrinsics=FOLDER["intrinsics"])
    refused(lambda: dataset.load("1"), "--depth-scale UNITS_PER_METRE", "1.npy")


@pytest.mark.parametrize("scale", [1.0, 1e6])
def test_folder_wrong_depth_scale_is_told(tmp_path: Path, scale: float) -> None:
    write_folder(tmp_path, [1])
    dataset = open_dataset(tmp_path, intrinsics=FOLDER["intrinsics"], depth_scale=scale)
    refused(lambda: dataset.load("1"), "wrong unit", "1000 for millimetres", "depth/1.png")


def test_folder_what_is_not_finite_or_negative_was_not_measured(tmp_path: Path) -> None:
    write_folder(tmp_path, [1])
    (tmp_path / "depth/1.png").unlink()
    depth = np.full((HEIGHT, WIDTH), 1.5)
    depth[0, :4] = [np.nan, np.inf, -np.inf, -1]
    np.save(tmp_path / "depth/1.npy", depth)
    frame = open_dataset(tmp_path, intrinsics=FOLDER["intrinsics"]).load("1")
    assert frame.depth[0, :5].tolist() == [0, 0, 0, 0, 1.5]


@pytest.mark.parametrize(
    ("colors", "depths", "pairs"),
    [
        (["rgb_0001", "rgb_0002"], ["d1", "d2"], {"rgb_0001": "d1", "rgb_0002": "d2"}),
        (["s1_0001", "s2_0001"], ["s1_1", "s2_1"], {"s1_0001": "s1_1", "s2_0001": "s2_1"}),
        (["desk", "sofa"], ["sofa", "desk"], {"desk": "desk", "sofa": "sofa"}),
        (["10.5", "10.25"], ["10.25", "10.5"], {"10.5": "10.5", "10.25": "10.25"}),
    ],
)
def test_folder_pairs_by_number_or_by_name(
    tmp_path: Path, colors: list[str], depths: list[str], pairs: dict[str, str]
) -> None:
    for k, name in enumerate(colors):
        write_png(tmp_path / f"image/{name}.png", np.full((HEIGHT, WIDTH, 3), k, np.uint8))
    for k, name in enumerate(depths):
        write_png(tmp_path / f"depth/{name}.png", np.full((HEIGHT, WIDTH), 1000 + k, np.uint16))
    dataset = open_dataset(tmp_path, **FOLDER)
    assert set(dataset.frame_ids) == set(pairs)
    for color, depth in pairs.items():
        frame = dataset.load(color)
        assert frame.rgb[0, 0, 0] == colors.index(color)
        assert frame.depth[0, 0] == np.float32(1000 + depths.index(depth)) / np.float32(1000)


def test_folder_ambiguous_or_unmatched_files_are_refused(tmp_path: Path) -> None:
    write_folder(tmp_path, [1, 2])
    shutil.copy(tmp_path / "rgb/1.png", tmp_path / "rgb/01.png")
    refused(lambda: open_dataset(tmp_path, **FOLDER), "same number", "01.png", "1.png")
    (tmp_path / "rgb/01.png").unlink()
    shutil.copytree(tmp_path / "rgb", tmp_path / "color")
    refused(lambda: open_dataset(tmp_path, **FOLDER), "more than one colour folder")
    shutil.rmtree(tmp_path / "color")
    for k in (1, 2):
        (tmp_path / f"depth/{k}.png").rename(tmp_path / f"depth/{k + 5}.png")
    refused(lambda: open_dataset(tmp_path, **FOLDER), "do not pair")


def test_folder_frame_without_depth_is_broken_and_keeps_its_pose_line(tmp_path: Path) -> None:
    written = write_folder(tmp_path, [1, 2, 3])
    (tmp_path / "depth/2.png").unlink()
    dataset = open_dataset(tmp_path, **FOLDER)
    assert [r.ok for r in survey(dataset)] == [True, False, True]
    (tmp_path / "rgb/2.png").unlink()
    for opened in (dataset, open_dataset(tmp_path, **FOLDER)):
        pose = opened.load("3").camera.T_world_camera
        assert pose is not None
        np.testing.assert_allclose(pose, written[2].T_world_camera, atol=1e-7)


def test_folder_pose_matrices_and_unusable_poses(tmp_path: Path) -> None:
    written = write_folder(tmp_path, [0, 4], poses=False)
    dataset = open_dataset(tmp_path, **FOLDER)
    assert dataset.load("0").camera.T_world_camera is None
    assert dataset.load("0").notes == ()
    (tmp_path / "pose").mkdir()
    np.savetxt(tmp_path / "pose/00.txt", written[0].T_world_camera)
    np.savetxt(tmp_path / "pose/04.txt", np.full((4, 4), -np.inf))
    dataset = open_dataset(tmp_path, **FOLDER)
    pose = dataset.load("0").camera.T_world_camera
    assert pose is not None
    np.testing.assert_allclose(pose, written[0].T_world_camera, atol=1e-12)
    lost = dataset.load("4")
    assert lost.camera.T_world_camera is None
    assert "lost" in lost.notes[0]
    shutil.rmtree(tmp_path / "pose")
    (tmp_path / "pose.txt").write_text("0 0 0 0 0 0 1\n" * 3)
    assert "3 lines for 2 frames" in open_dataset(tmp_path, **FOLDER).load("0").notes[0]
    (tmp_path / "pose.txt").write_text("0 0 0 0 0 0 2\n1 2 3\n")
    dataset = open_dataset(tmp_path, **FOLDER)
    assert "length 1" in dataset.load("0").notes[0]
    assert "count" in dataset.load("4").notes[0]
