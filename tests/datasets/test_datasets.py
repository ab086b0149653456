"""The dataset readers: exact round trips, hostile input, and the real datasets."""

from __future__ import annotations

import json
import os
import pickle
import shutil
import struct
import sys
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
    random_rotation,
    write_bop,
    write_folder,
    write_png,
    write_seven_scenes,
)
from hypothesis import given, settings
from hypothesis import strategies as st

from pipeline.datasets import (
    DatasetFormat,
    Settings,
    open_dataset,
    read_settings,
    resolve_frame,
    survey,
    write_settings,
)
from pipeline.datasets.cameras import nearest_rotation
from pipeline.datasets.images import read_color, read_depth, read_mask
from pipeline.geometry.boxes import Box3D
from pipeline.system import plugins
from pipeline.system.errors import InputError

MODELS = {
    "1": {"name": "mug", "min_x": -40, "min_y": -30, "min_z": 0, "size_x": 80, "size_y": 70, "size_z": 90},
    "2": {"name": "laptop"},
}
FOLDER = {"intrinsics": (60.0, 61.0, 31.5, 23.5), "depth_scale": 1000.0}


def edit_json(path: Path, change: Callable[[Any], Any]) -> None:
    table = json.loads(path.read_text())
    change(table)
    path.write_text(json.dumps(table))


def refused(action: Callable[[], object], *words: str) -> str:
    """The message of the InputError, which must be one line and hold every word."""
    with pytest.raises(InputError) as caught:
        action()
    message = str(caught.value)
    assert "\n" not in message
    for word in words:
        assert word in message, message
    return message


# BOP


def test_bop_is_read_back_exactly(tmp_path: Path) -> None:
    written = write_bop(tmp_path, {"000001": [1, 20], "000002": [3]}, models=MODELS)
    dataset = open_dataset(tmp_path)
    assert dataset.format == "bop"
    assert dataset.root == tmp_path
    assert dataset.frame_ids == ("000001/000001", "000001/000020", "000002/000003")
    assert dataset.class_names == ("mug", "laptop", "obj_000012")
    for frame_id in dataset.frame_ids:
        frame, truth = dataset.load(frame_id), written[frame_id]
        assert frame.id == frame_id
        assert frame.notes == ()
        assert np.array_equal(frame.rgb, truth.rgb)
        assert np.array_equal(frame.depth, truth.depth)
        assert np.array_equal(frame.camera.K, K)
        assert frame.camera.T_world_camera is not None
        np.testing.assert_allclose(frame.camera.T_world_camera, truth.T_world_camera, atol=1e-4)
        assert frame.camera.up is None
        assert [a.label for a in frame.annotations] == ["mug", "laptop", "obj_000012"]
        for k, annotation in enumerate(frame.annotations):
            rows, columns = np.nonzero(truth.masks[k])
            edges = [columns.min(), rows.min(), columns.max() + 1, rows.max() + 1]
            assert annotation.index == k
            assert annotation.mask is not None
            assert np.array_equal(annotation.mask, truth.masks[k])
            assert annotation.bbox.tolist() == edges
            assert annotation.visible == 0.25 * (k + 1)


def test_bop_box_is_the_models_own_moved_by_its_pose(tmp_path: Path) -> None:
    written = write_bop(tmp_path, {"000001": [1]}, models=MODELS)
    mug, laptop, _ = open_dataset(tmp_path).load("000001/000001").annotations
    assert laptop.box is None
    assert mug.box is not None
    local = Box3D(np.array([0.0, 0.005, 0.045]), np.eye(3), np.array([0.08, 0.07, 0.09]))
    expected = local.transformed(written["000001/000001"].T_camera_object[0])
    np.testing.assert_allclose(mug.box.corners, expected.corners, atol=1e-5)
    np.testing.assert_allclose(mug.box.R @ mug.box.R.T, np.eye(3), atol=1e-12)


@pytest.mark.parametrize(
    ("opened", "expected"),
    [
        ("data/test/000001", ["000001/000001", "000001/000002"]),
        ("data/test", ["000001/000001", "000001/000002"]),
        ("data", ["000001/000001", "000001/000002"]),
    ],
)
def test_bop_scene_split_and_dataset_have_the_same_ids(
    tmp_path: Path, opened: str, expected: list[str]
) -> None:
    write_bop(tmp_path / "data" / "test", {"000001": [1, 2]})
    models = tmp_path / "data" / "models_eval"
    models.mkdir()
    (models / "models_info.json").write_text(json.dumps(MODELS))
    dataset = open_dataset(tmp_path / opened)
    assert list(dataset.frame_ids) == expected
    # The models stand outside an opened split or scene, and nothing outside is read.
    assert dataset.class_names[0] == ("mug" if opened == "data" else "obj_000001")
    assert dataset.load(expected[0]).annotations[0].label == dataset.class_names[0]


def test_bop_scene_opened_as_the_working_folder_keeps_its_name(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write_bop(tmp_path, {"000007": [1]})
    monkeypatch.chdir(tmp_path / "000007")
    assert open_dataset(".").frame_ids == ("000007/000001",)


def test_bop_with_two_splits_tells_them_apart(tmp_path: Path) -> None:
    test = write_bop(tmp_path / "test", {"000001": [1]}, seed=1)
    train = write_bop(tmp_path / "train", {"000001": [1]}, seed=2)
    dataset = open_dataset(tmp_path)
    assert dataset.frame_ids == ("test/000001/000001", "train/000001/000001")
    assert np.array_equal(dataset.load("test/000001/000001").rgb, test["000001/000001"].rgb)
    assert np.array_equal(dataset.load("train/000001/000001").rgb, train["000001/000001"].rgb)


def test_bop_opening_decodes_nothing(tmp_path: Path) -> None:
    write_bop(tmp_path, {"000001": [1]}, models=MODELS)
    for path in tmp_path.rglob("*.png"):
        path.write_bytes(b"")
    dataset = open_dataset(tmp_path)
    assert dataset.class_names == ("mug", "laptop", "obj_000012")
    refused(lambda: dataset.load("000001/000001"), "empty", "000001.png")


def test_bop_up_is_declared_only_by_the_datasets_own_file(tmp_path: Path) -> None:
    written = write_bop(tmp_path, {"000001": [1, 2]})
    edit_json(
        tmp_path / "000001/scene_camera.json", lambda t: [t["2"].pop(k) for k in ("cam_R_w2c", "cam_t_w2c")]
    )
    (tmp_path / "spatialviz.toml").write_text("world_up = [0, -2, 0]\n")
    dataset = open_dataset(tmp_path)
    camera = dataset.load("000001/000001").camera
    assert camera.up is not None
    assert camera.up_source == "declared"
    R_wc = written["000001/000001"].T_world_camera[:3, :3]
    np.testing.assert_allclose(R_wc @ camera.up, [0, -1, 0], atol=1e-4)
    unposed = dataset.load("000001/000002").camera
    assert unposed.T_world_camera is None
    assert unposed.up is None
    assert unposed.up_source is None


def test_bop_dropped_annotations_leave_the_places_of_the_others(tmp_path: Path) -> None:
    write_bop(tmp_path, {"000001": [1]}, objects=(1, 2, 3, 4, 5), models=MODELS)
    masks = tmp_path / "000001/mask_visib"
    write_png(masks / "000001_000000.png", np.zeros((HEIGHT, WIDTH), np.uint8))
    write_png(masks / "000001_000001.png", np.full((HEIGHT, WIDTH - 1), 255, np.uint8))
    whole = (masks / "000001_000003.png").read_bytes()
    (masks / "000001_000003.png").write_bytes(whole[: len(whole) // 2])
    (masks / "000001_000004.png").unlink()
    frame = open_dataset(tmp_path).load("000001/000001")
    assert [(a.index, a.label, a.mask is None) for a in frame.annotations] == [
        (2, "obj_000003", False),
        (4, "obj_000005", True),
    ]
    assert frame.notes[0] == "annotation 0 (mug): empty mask"
    assert "annotation 1 (laptop)" in frame.notes[1]
    assert "63x48" in frame.notes[1]
    assert "annotation 3 (obj_000004)" in frame.notes[2]
    assert "cut off" in frame.notes[2]
    assert "annotation 4 (obj_000005)" in frame.notes[3]
    assert len(frame.notes) == 4


def test_bop_without_masks_takes_the_visible_box(tmp_path: Path) -> None:
    written = write_bop(tmp_path, {"000001": [1]})
    shutil.rmtree(tmp_path / "000001/mask_visib")
    edit_json(tmp_path / "000001/scene_gt_info.json", lambda t: t["1"][1].update(bbox_visib=[-1, -1, -1, -1]))
    frame = open_dataset(tmp_path).load("000001/000001")
    assert [(a.index, a.mask) for a in frame.annotations] == [(0, None), (2, None)]
    rows, columns = np.nonzero(written["000001/000001"].masks[0])
    assert frame.annotations[0].bbox.tolist() == [
        columns.min(),
        rows.min(),
        columns.max() + 1,
        rows.max() + 1,
    ]
    assert frame.notes == ("annotation 1 (obj_000002): an empty bbox_visib",)


def test_bop_without_annotations_is_a_recording(tmp_path: Path) -> None:
    write_bop(tmp_path, {"000001": [1]})
    for name in ("scene_gt.json", "scene_gt_info.json"):
        (tmp_path / "000001" / name).unlink()
    dataset = open_dataset(tmp_path)
    assert dataset.class_names == ()
    assert dataset.load("000001/000001").annotations == ()


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda e: e.pop("cam_K"), ["cam_K is missing"]),
        (lambda e: e["cam_K"].__setitem__(0, float("nan")), ["not finite"]),
        (lambda e: e["cam_K"].__setitem__(2, float("inf")), ["not finite"]),
        (lambda e: e["cam_K"].__setitem__(0, -60), ["focal lengths must be positive"]),
        (lambda e: e["cam_K"].__setitem__(0, "sixty"), ["not numbers"]),
        (lambda e: e["cam_K"].pop(), ["a wrong count", "got 8"]),
        (lambda e: e["cam_K"].__setitem__(2, 97), ["principal point"]),
        (lambda e: e["cam_K"].__setitem__(5, -25), ["principal point"]),
        (lambda e: e.pop("depth_scale"), ["depth_scale is missing"]),
        (lambda e: e.update(depth_scale=0), ["depth_scale must be positive"]),
        (lambda e: e.update(depth_scale=500), ["wrong unit"]),
        (lambda e: e.update(depth_scale=0.0005), ["wrong unit"]),
    ],
)
def test_bop_broken_camera_breaks_its_frame_only(
    tmp_path: Path, change: Callable[[Any], Any], words: list[str]
) -> None:
    write_bop(tmp_path, {"000001": [1, 2, 3]})
    edit_json(tmp_path / "000001/scene_camera.json", lambda t: change(t["2"]))
    dataset = open_dataset(tmp_path)
    refused(lambda: dataset.load("000001/000002"), *words)
    assert [report.ok for report in survey(dataset)] == [True, False, True]


def test_bop_listed_image_without_its_file_is_broken_and_not_dropped(tmp_path: Path) -> None:
    write_bop(tmp_path, {"000001": [1, 2, 3]})
    (tmp_path / "000001/rgb/000001.png").unlink()
    (tmp_path / "000001/depth/000002.png").unlink()
    reports = list(survey(open_dataset(tmp_path)))
    assert [r.ok for r in reports] == [False, False, True]
    assert "rgb" in str(reports[0].problem)
    assert "000002.png" in str(reports[1].problem)


def test_bop_unlisted_image_is_no_frame(tmp_path: Path) -> None:
    write_bop(tmp_path, {"000001": [1, 2]})
    edit_json(tmp_path / "000001/scene_camera.json", lambda t: t.pop("2"))
    assert open_dataset(tmp_path).frame_ids == ("000001/000001",)


def test_bop_unusable_poses_are_left_out_with_a_note(tmp_path: Path) -> None:
    write_bop(tmp_path, {"000001": [1, 2]}, models=MODELS)
    edit_json(
        tmp_path / "000001/scene_camera.json", lambda t: t["1"].update(cam_R_w2c=[2, 0, 0, 0, 2, 0, 0, 0, 2])
    )
    edit_json(tmp_path / "000001/scene_gt.json", lambda t: t["1"][0].update(cam_t_m2c=[float("nan"), 0, 0]))
    frame = open_dataset(tmp_path).load("000001/000001")
    assert frame.camera.T_world_camera is None
    assert frame.annotations[0].box is None
    assert frame.annotations[0].mask is not None
    assert frame.notes[0] == "no camera pose: not a rotation"
    assert "annotation 0 (mug): no 3D box" in frame.notes[1]


@pytest.mark.parametrize("key", ["../../000001", "/etc/passwd", "1/../2", "-1", "", "1.0", "9" * 5000])
def test_bop_image_number_that_is_a_path_is_refused(tmp_path: Path, key: str) -> None:
    write_bop(tmp_path, {"000001": [1]})
    edit_json(tmp_path / "000001/scene_camera.json", lambda t: t.update({key: t["1"]}))
    refused(lambda: open_dataset(tmp_path), "image number", "scene_camera.json")


def test_bop_malformed_json_names_file_and_line(tmp_path: Path) -> None:
    write_bop(tmp_path, {"000001": [1], "000002": [1]})
    (tmp_path / "000002/scene_gt.json").write_text('{\n"1": [\n{"obj_id": 1,,}]}')
    dataset = open_dataset(tmp_path)
    refused(lambda: dataset.load("000002/000001"), "line 3", "000002/scene_gt.json")
    assert [r.ok for r in survey(dataset)] == [True, False]
    (tmp_path / "000001/scene_camera.json").write_text('{\n"1": ')
    refused(lambda: open_dataset(tmp_path), "line 2", "000001/scene_camera.json")
    (tmp_path / "000001/scene_camera.json").write_text("[1, 2]")
    refused(lambda: open_dataset(tmp_path), "object was expected")
    (tmp_path / "000001/scene_camera.json").write_text("[" * 100_000)
    refused(lambda: open_dataset(tmp_path), "malformed JSON")
    (tmp_path / "000001/scene_camera.json").write_bytes(b"\xff\xfe\x00")
    refused(lambda: open_dataset(tmp_path), "malformed JSON")


@pytest.mark.parametrize(
    "table", [{"1": 5}, {"1": [5, None, {}]}, {"1": {"obj_id": 1}}, {"1": [{"obj_id": "x"}]}]
)
def test_bop_tables_of_a_wrong_shape_do_not_crash(tmp_path: Path, table: Any) -> None:
    write_bop(tmp_path, {"000001": [1]}, models=MODELS)
    (tmp_path / "000001/scene_gt.json").write_text(json.dumps(table))
    (report,) = survey(open_dataset(tmp_path))
    assert not report.ok or report.annotations == 0
    assert report.problem or report.notes


def test_bop_grey_scale_is_said_to_be_unsupported(tmp_path: Path) -> None:
    write_bop(tmp_path, {"000001": [1]})
    (tmp_path / "000001/rgb").rename(tmp_path / "000001/gray")
    refused(lambda: open_dataset(tmp_path), "grey-scale", "rgb/")


def test_bop_jpeg_colour_is_found(tmp_path: Path) -> None:
    write_bop(tmp_path, {"000001": [1]})
    rgb = np.full((HEIGHT, WIDTH, 3), (200, 30, 60), np.uint8)
    (tmp_path / "000001/rgb/000001.png").unlink()
    write_png(tmp_path / "000001/rgb/000001.jpg", rgb)
    assert np.abs(open_dataset(tmp_path).load("000001/000001").rgb.astype(int) - rgb).max() <= 4


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


# Files that are not what they should be


def encodings() -> dict[str, bytes]:
    rng = np.random.default_rng(0)
    noise = rng.integers(0, 256, (HEIGHT, WIDTH, 3)).astype(np.uint8)
    depth = rng.integers(500, 4000, (HEIGHT, WIDTH)).astype(np.uint16)
    smooth = cv2.resize(noise[:4, :4], (640, 480), interpolation=cv2.INTER_LINEAR)

    def encode(suffix: str, image: np.ndarray, *options: int) -> bytes:
        return cv2.imencode(suffix, image, options)[1].tobytes()

    return {
        "png": encode(".png", noise),
        "png16": encode(".png", depth),
        "png-large": encode(".png", smooth),
        "jpeg": encode(".jpg", noise),
        "jpeg-large": encode(".jpg", smooth),
        "jpeg-progressive": encode(".jpg", smooth, cv2.IMWRITE_JPEG_PROGRESSIVE, 1),
        "jpeg-restarts": encode(".jpg", smooth, cv2.IMWRITE_JPEG_RST_INTERVAL, 2),
        "tiff": encode(".tiff", noise),
        "pgm": encode(".pgm", depth),
        "ppm": encode(".ppm", noise),
    }


@pytest.mark.parametrize("kind", list(encodings()))
def test_a_file_cut_anywhere_is_refused(tmp_path: Path, kind: str) -> None:
    whole = encodings()[kind]
    path = tmp_path / "000001.png"
    path.write_bytes(whole)
    assert read_color(path).shape[2] == 3
    size = len(whole)
    rng = np.random.default_rng(1)
    cuts = {
        size // 2,
        int(size * 0.95),
        size - 20,
        size - 2,
        size - 1,
        1,
        *rng.integers(1, size, 20).tolist(),
    }
    for cut in sorted(cuts):
        path.write_bytes(whole[:cut])
        refused(lambda: read_color(path), "000001.png")


@pytest.mark.parametrize("kind", ["png", "png16", "png-large"])
def test_a_png_with_a_flipped_bit_is_refused(tmp_path: Path, kind: str) -> None:
    whole = encodings()[kind]
    path = tmp_path / "1.png"
    for position in np.random.default_rng(2).integers(8, len(whole), 20).tolist():
        damaged = bytearray(whole)
        damaged[position] ^= 0x10
        path.write_bytes(damaged)
        refused(lambda: read_color(path), "1.png")


def test_a_jpeg_with_a_thumbnail_is_cut_where_the_picture_ends(tmp_path: Path) -> None:
    whole, thumbnail = encodings()["jpeg-large"], encodings()["jpeg"]
    segment = b"\xff\xe1" + struct.pack(">H", len(thumbnail) + 2) + thumbnail
    with_thumbnail = whole[:2] + segment + whole[2:]
    path = tmp_path / "1.jpg"
    path.write_bytes(with_thumbnail + b"\0\0padding")
    assert read_color(path).shape == (480, 640, 3)
    path.write_bytes(with_thumbnail[: len(with_thumbnail) * 3 // 4])
    refused(lambda: read_color(path), "cut off")


@pytest.mark.parametrize(
    "content",
    [
        b"",
        b"hello, I am no image\n",
        b"version https://git-lfs.github.com/spec/v1\n",
        b"\x89PNG\r\n\x1a\n",
        b"\xff\xd8\xff",
    ],
    ids=["empty", "text", "lfs", "png-magic-only", "jpeg-magic-only"],
)
@pytest.mark.parametrize("read", [read_color, read_mask, lambda path: read_depth(path, 1000)])
def test_what_is_no_image_is_refused(tmp_path: Path, content: bytes, read: Callable[[Path], object]) -> None:
    path = tmp_path / "000001.png"
    path.write_bytes(content)
    refused(lambda: read(path), "000001.png")
    refused(lambda: read(tmp_path / "absent.png"), "missing", "absent.png")
    refused(lambda: read(tmp_path), str(tmp_path))


@settings(max_examples=150, deadline=None)
@given(
    data=st.binary(max_size=200),
    magic=st.sampled_from([b"\x89PNG\r\n\x1a\n", b"\xff\xd8", b"P5 4 4 9 ", b"II*\0", b"\x93NUMPY"]),
)
def test_rubbish_behind_any_magic_is_refused_or_read(
    tmp_path_factory: pytest.TempPathFactory, data: bytes, magic: bytes
) -> None:
    path = tmp_path_factory.getbasetemp() / "rubbish"
    path.write_bytes(magic + data)
    for read in (read_color, lambda p: read_depth(p, 1000)):
        problem: InputError | None = None
        try:
            assert read(path).size > 0
        except InputError as error:
            problem = error
        assert problem is None or str(path) in str(problem)


def test_depth_of_a_wrong_kind_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "1.png"
    write_png(path, np.full((HEIGHT, WIDTH), 100, np.uint8))
    refused(lambda: read_depth(path, 1000), "8 bits", "1.png")
    assert cv2.imwrite(str(path), np.full((HEIGHT, WIDTH, 3), 1000, np.uint16))
    refused(lambda: read_depth(path, 1000), "one channel")
    write_png(path, np.full((HEIGHT, WIDTH), 1000, np.uint16))
    refused(lambda: read_depth(path, None), "--depth-scale")
    np.save(tmp_path / "1.npy", np.array([[{}]], dtype=object))
    refused(lambda: read_depth(tmp_path / "1.npy", 1.0), "1.npy")
    np.save(tmp_path / "1.npy", np.ones((4, 4), complex))
    refused(lambda: read_depth(tmp_path / "1.npy", 1.0), "must be numbers")
    np.save(tmp_path / "1.npy", np.ones((4, 4)))
    whole = (tmp_path / "1.npy").read_bytes()
    (tmp_path / "1.npy").write_bytes(whole[:-20])
    refused(lambda: read_depth(tmp_path / "1.npy", 1.0), "1.npy")


def test_exr_without_its_package_says_what_to_install(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "OpenEXR", None)
    path = tmp_path / "1.exr"
    path.write_bytes(b"\x76\x2f\x31\x01" + bytes(100))
    refused(lambda: read_depth(path, None), "pip install OpenEXR", "1.exr")


def test_exr_depth_is_read(tmp_path: Path) -> None:
    OpenEXR = pytest.importorskip("OpenEXR", reason="the optional OpenEXR package is not installed")
    depth = np.random.default_rng(0).uniform(0.5, 4, (HEIGHT, WIDTH)).astype(np.float32)
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    path = tmp_path / "1.exr"
    for channels in ({"Z": depth}, {"R": depth, "G": depth, "B": depth}):
        with OpenEXR.File(header, channels) as image:
            image.write(str(path))
        assert np.array_equal(read_depth(path, None), depth)
    with OpenEXR.File(header, {"R": depth, "G": depth + 1, "B": depth}) as image:
        image.write(str(path))
    refused(lambda: read_depth(path, None), "one channel")
    path.write_bytes(path.read_bytes()[:-20])
    refused(lambda: read_depth(path, None), "1.exr")


def test_colour_ignores_the_orientation_tag(tmp_path: Path) -> None:
    exif = b"Exif\0\0MM\0*\0\0\0\x08\0\x01\x01\x12\0\x03\0\0\0\x01\0\x06\0\0\0\0\0\0"
    whole = encodings()["jpeg-large"]
    path = tmp_path / "1.jpg"
    path.write_bytes(whole[:2] + b"\xff\xe1" + struct.pack(">H", len(exif) + 2) + exif + whole[2:])
    turned = cv2.imread(str(path))
    assert turned is not None
    assert turned.shape[:2] == (640, 480)
    assert read_color(path).shape[:2] == (480, 640)


def test_sixteen_bit_and_coloured_masks_keep_every_pixel(tmp_path: Path) -> None:
    mask = np.zeros((HEIGHT, WIDTH), np.uint16)
    mask[3, 4] = 1
    write_png(tmp_path / "1.png", mask)
    assert np.array_equal(read_mask(tmp_path / "1.png"), mask > 0)
    bgra = np.zeros((HEIGHT, WIDTH, 4), np.uint8)
    bgra[..., 3] = 255
    bgra[3, 4, 2] = 1
    assert cv2.imwrite(str(tmp_path / "1.png"), bgra)
    assert np.array_equal(read_mask(tmp_path / "1.png"), mask > 0)


def test_colour_and_depth_of_different_sizes_are_refused(tmp_path: Path) -> None:
    write_bop(tmp_path, {"000001": [1]})
    write_png(tmp_path / "000001/depth/000001.png", np.full((30, 40), 1000, np.uint16))
    refused(lambda: open_dataset(tmp_path).load("000001/000001"), "40x30", "64x48", "depth/000001.png")


# Opening, naming, settings


def test_what_cannot_be_opened_is_told(tmp_path: Path) -> None:
    refused(lambda: open_dataset(tmp_path / "absent"), "no such dataset", "absent")
    (tmp_path / "file").write_text("x")
    refused(lambda: open_dataset(tmp_path / "file"), "a dataset is a folder")
    refused(lambda: open_dataset(tmp_path), "scene_camera.json", "frame-XXXXXX.color.png", "depth/")
    (tmp_path / "rgb").mkdir()
    (tmp_path / "depth").mkdir()
    refused(lambda: open_dataset(tmp_path, **FOLDER), "no colour files")


@pytest.mark.parametrize(
    "options",
    [
        {"depth_scale": 0.0},
        {"depth_scale": float("nan")},
        {"depth_scale": -1000.0},
        {"intrinsics": (0.0, 60.0, 30.0, 20.0)},
        {"intrinsics": (60.0, float("inf"), 30.0, 20.0)},
        {"intrinsics": (60.0, 60.0, 30.0)},
    ],
)
def test_impossible_options_are_refused(tmp_path: Path, options: Any) -> None:
    write_folder(tmp_path, [1])
    refused(lambda: open_dataset(tmp_path, **{**FOLDER, **options}))


def test_given_facts_win_over_the_files(tmp_path: Path) -> None:
    written = write_bop(tmp_path, {"000001": [1]})
    (tmp_path / "spatialviz.toml").write_text("depth_scale = 4000\nintrinsics = [70, 71, 30, 20]\n")
    truth = written["000001/000001"]
    frame = open_dataset(tmp_path).load("000001/000001")
    assert np.array_equal(frame.depth, truth.depth / 2)
    assert frame.camera.fx == 70
    frame = open_dataset(tmp_path, intrinsics=(80, 81, 30, 20)).load("000001/000001")
    assert (frame.camera.fx, frame.camera.fy) == (80, 81)
    assert np.array_equal(frame.depth, truth.depth / 2)


def test_a_frame_is_found_by_id_index_and_loose_id(tmp_path: Path) -> None:
    write_bop(tmp_path, {"000001": [1, 20], "000002": [3]})
    dataset = open_dataset(tmp_path)
    assert resolve_frame(dataset, "000001/000020") == "000001/000020"
    assert resolve_frame(dataset, 0) == resolve_frame(dataset, "0") == "000001/000001"
    assert resolve_frame(dataset, 2) == "000002/000003"
    assert resolve_frame(dataset, "1/20") == "000001/000020"
    assert resolve_frame(dataset, "2/003") == "000002/000003"
    for key in (3, -1, "-1", "1/2", "", "nope", True, "../000001/000001", "9" * 5000):
        refused(lambda key=key: resolve_frame(dataset, key), "among 3", "index from 0 to 2")
    refused(lambda: resolve_frame(dataset, "000001/000021"), "000001/000020")
    refused(lambda: dataset.load("0"), "no frame")


def test_a_scene_is_not_taken_for_an_index(tmp_path: Path) -> None:
    write_bop(tmp_path, {"000001": [0, 1, 2], "000002": [0, 5], "000007": [3], "000008": [0, 3]})
    dataset = open_dataset(tmp_path)
    for key in ("000001", "000002"):
        index = int(key)
        refused(
            lambda key=key: resolve_frame(dataset, key),
            repr(key), f"the index {index}, which is {dataset.frame_ids[index]}", f"{key}/000000", f"or {index} for",
        )  # fmt: skip
    # An image's number that is no scene's, and leads elsewhere as an index.
    refused(lambda: resolve_frame(dataset, "000003"), "000002/000000", "000007/000003", "000008/000003")
    for index, frame_id in enumerate(dataset.frame_ids):
        assert resolve_frame(dataset, f"{index}") == resolve_frame(dataset, index) == frame_id
    # Nothing else is called so.
    assert resolve_frame(dataset, "000004") == dataset.frame_ids[4]
    write_bop(tmp_path / "one", {"2": [0, 1, 2], "3": [0]})
    dataset = open_dataset(tmp_path / "one")
    refused(lambda: resolve_frame(dataset, "2"), "2/000000", "expected a whole id [")
    assert resolve_frame(dataset, "1") == "2/000001"


def test_an_id_that_looks_like_an_index_is_an_id_first(tmp_path: Path) -> None:
    write_folder(tmp_path, [1, 2, 3])
    dataset = open_dataset(tmp_path, **FOLDER)
    assert resolve_frame(dataset, "1") == "1"
    assert resolve_frame(dataset, "0") == "1"
    assert resolve_frame(dataset, 1) == "2"


def test_settings_are_kept_and_read_back(tmp_path: Path) -> None:
    write_folder(tmp_path, [1])
    assert read_settings(tmp_path) == Settings()
    name = 'a "quoted" \\ näme\n\x7f'
    (tmp_path / "spatialviz.toml").write_text('world_up = [0, 0, 1]\nname = "kitchen"\n')
    assert write_settings(tmp_path, FOLDER["intrinsics"], None) == tmp_path / "spatialviz.toml"
    write_settings(tmp_path, None, 1000)
    kept = read_settings(tmp_path)
    assert kept == Settings((60, 61, 31.5, 23.5), 1000, (0, 0, 1), "kitchen")
    assert open_dataset(tmp_path).load("1").camera.up_source == "declared"
    assert sorted(os.listdir(tmp_path)) == ["depth", "pose.txt", "rgb", "spatialviz.toml"]
    (tmp_path / "spatialviz.toml").write_text(
        f"name = {json.dumps(name, ensure_ascii=True)}\n".replace("\x7f", "\\u007f")
    )
    write_settings(tmp_path, None, 5000)
    assert read_settings(tmp_path).name == name
    refused(lambda: write_settings(tmp_path, (0, 1, 2, 3), None), "focal")
    refused(lambda: write_settings(tmp_path / "absent", None, 1000), "cannot be written")


@settings(max_examples=50, deadline=None)
@given(
    numbers=st.tuples(*[st.floats(1e-6, 1e6)] * 5),
)
def test_settings_keep_every_digit(
    tmp_path_factory: pytest.TempPathFactory, numbers: tuple[float, ...]
) -> None:
    folder = tmp_path_factory.getbasetemp()
    fx, fy, cx, cy, scale = numbers
    write_settings(folder, (fx, fy, cx, cy), scale)
    assert read_settings(folder) == Settings((fx, fy, cx, cy), scale)


@pytest.mark.parametrize(
    ("content", "words"),
    [
        ("intrinsics = [1, 2", ["spatialviz.toml", "cannot be read"]),
        ("depth-scale = 1000", ["unknown setting", "depth_scale"]),
        ("depth_scale = true", ["depth_scale must be a finite number"]),
        ("depth_scale = nan", ["depth_scale must be a finite number"]),
        ("world_up = [0, 0, 0]", ["world_up"]),
        ('world_up = "z"', ["world_up must be 3 finite numbers"]),
        ("intrinsics = [1, 2, 3]", ["intrinsics must be 4 finite numbers"]),
        ("name = 3", ["name must be a string"]),
    ],
)
def test_malformed_settings_are_told(tmp_path: Path, content: str, words: list[str]) -> None:
    write_folder(tmp_path, [1])
    (tmp_path / "spatialviz.toml").write_text(content)
    refused(lambda: open_dataset(tmp_path, **FOLDER), *words)


@settings(max_examples=60, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), decimals=st.integers(3, 8))
def test_a_rounded_rotation_becomes_a_rotation_again(seed: int, decimals: int) -> None:
    R = random_rotation(np.random.default_rng(seed))
    mended = nearest_rotation(R.round(decimals))
    np.testing.assert_allclose(mended @ mended.T, np.eye(3), atol=1e-12)
    np.testing.assert_allclose(mended, R, atol=2 * 10.0**-decimals)
    for wrong in (R * 1.1, R @ np.diag([1, 1, -1]), R * np.nan):
        refused(lambda wrong=wrong: nearest_rotation(wrong))


class _Point:
    """An entry point, as far as `load_plugins` looks at one."""

    def __init__(self, loaded: object) -> None:
        self.name, self.value, self._loaded = "mine", "somewhere:FORMAT", loaded

    def load(self) -> object:
        if isinstance(self._loaded, Exception):
            raise self._loaded
        return self._loaded


def test_a_plugin_opens_its_own_format_before_any_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write_folder(tmp_path, [1])
    (tmp_path / "mine.txt").touch()
    opened: list[Settings] = []

    def open_mine(root: Path, given_settings: Settings) -> Any:
        opened.append(given_settings)
        return "mine"

    mine = DatasetFormat("mine", "mine: mine.txt", lambda root: (root / "mine.txt").exists(), open_mine)
    points = [_Point(ImportError("no such module")), _Point(42), _Point(mine)]
    monkeypatch.setattr(
        plugins, "entry_points", lambda group: points if group == "spatialviz.datasets" else []
    )
    with pytest.warns(UserWarning, match="plugin") as warned:
        assert open_dataset(tmp_path, depth_scale=7.0) == "mine"
    assert len(warned) == 2
    assert opened == [Settings(depth_scale=7.0)]
    (tmp_path / "mine.txt").unlink()
    with pytest.warns(UserWarning, match="plugin"):
        assert open_dataset(tmp_path, **FOLDER).format == "folder"


def test_a_survey_reports_and_goes_on(tmp_path: Path) -> None:
    written = write_bop(tmp_path, {"000001": [1, 2]}, models=MODELS)
    (tmp_path / "000001/depth/000001.png").write_bytes(b"not a picture")
    broken, fine = survey(open_dataset(tmp_path))
    assert (broken.index, broken.id, broken.ok, broken.median_depth) == (0, "000001/000001", False, None)
    assert "depth/000001.png" in str(broken.problem)
    depth = written["000001/000002"].depth
    assert (fine.index, fine.id, fine.ok, fine.problem) == (1, "000001/000002", True, None)
    assert (fine.width, fine.height, fine.annotations) == (WIDTH, HEIGHT, 3)
    assert fine.labels == ("mug", "laptop", "obj_000012")
    assert fine.depth_valid == np.mean(depth > 0)
    assert fine.median_depth == pytest.approx(np.median(depth[depth > 0]))
    assert fine.has_pose
    assert fine.up_source == "assumed"


def test_an_open_dataset_can_be_sent_to_another_process(tmp_path: Path) -> None:
    for name, write in (
        ("bop", lambda root: write_bop(root, {"000001": [1]})),
        ("folder", lambda r: write_folder(r, [1])),
    ):
        (tmp_path / name).mkdir()
        write(tmp_path / name)
        dataset = open_dataset(tmp_path / name, **FOLDER)
        frame = dataset.load(dataset.frame_ids[0])
        again = pickle.loads(pickle.dumps(dataset))
        assert np.array_equal(again.load(dataset.frame_ids[0]).depth, frame.depth)


# The real datasets


def test_real_ycbv_masks_are_as_its_own_tables_say(shared_data: Path) -> None:
    root = shared_data / "real/ycbv-bop"
    dataset = open_dataset(root)
    assert dataset.format == "bop"
    assert len(dataset.frame_ids) == 6
    assert len(dataset.class_names) == 12
    assert {"mug", "banana", "mustard bottle"} <= set(dataset.class_names)
    for frame_id in dataset.frame_ids:
        scene, image = frame_id.split("/")
        infos = json.loads((root / scene / "scene_gt_info.json").read_text())[str(int(image))]
        frame = dataset.load(frame_id)
        assert frame.notes == ()
        assert (frame.camera.fx, frame.camera.cy) == (1066.778, 241.3109)
        assert 0.5 < np.median(frame.depth[frame.depth > 0]) < 1.5
        assert len(frame.annotations) == len(infos)
        for annotation, info in zip(frame.annotations, infos, strict=True):
            assert annotation.mask is not None
            assert annotation.mask.sum() == info["px_count_visib"]
            x, y, w, h = info["bbox_visib"]
            assert np.abs(annotation.bbox - [x, y, x + w, y + h]).max() <= 1
            assert annotation.visible == info["visib_fract"]
            assert annotation.label in dataset.class_names


def test_real_seven_scenes(shared_data: Path) -> None:
    dataset = open_dataset(shared_data / "real/7scenes-redkitchen")
    assert dataset.format == "7-scenes"
    assert len(dataset.frame_ids) == 12
    reports = list(survey(dataset))
    assert all(r.ok and r.has_pose and not r.notes for r in reports)
    assert all(1 < (r.median_depth or 0) < 3 and r.depth_valid > 0.8 for r in reports)
    frame = dataset.load(dataset.frame_ids[0])
    assert frame.depth.max() < 60
    assert frame.camera.fx == 585


def test_real_dining_room(shared_data: Path) -> None:
    root = shared_data / "real/slambook-diningroom"
    dataset = open_dataset(root, intrinsics=(518, 519, 325.5, 253.5), depth_scale=1000)
    assert dataset.format == "folder"
    assert dataset.frame_ids == ("1", "2", "3", "4", "5")
    reports = list(survey(dataset))
    assert all(r.ok and r.has_pose and not r.notes for r in reports)
    assert all(2 < (r.median_depth or 0) < 4 for r in reports)
    refused(
        lambda: open_dataset(root, intrinsics=(518, 519, 325.5, 253.5), depth_scale=1).load("1"), "wrong unit"
    )


def test_real_poses_put_two_views_of_the_dining_room_on_each_other(shared_data: Path) -> None:
    """Depth of view 4, moved into view 5, meets the depth measured there; the inverse poses would not."""
    root = shared_data / "real/slambook-diningroom"
    dataset = open_dataset(root, intrinsics=(518, 519, 325.5, 253.5), depth_scale=1000)
    a, b = dataset.load("4"), dataset.load("5")
    T_a, T_b = a.camera.T_world_camera, b.camera.T_world_camera
    assert T_a is not None
    assert T_b is not None

    def error(T: np.ndarray) -> float:
        v, u = np.mgrid[0:480:4, 0:640:4]
        z = a.depth[v, u]
        rays = np.stack(
            [(u - a.camera.cx) / a.camera.fx, (v - a.camera.cy) / a.camera.fy, np.ones_like(z)], -1
        )
        points = (rays * z[..., None])[(z > 0.5) & (z < 4)]
        moved = points @ T[:3, :3].T + T[:3, 3]
        x = np.round(moved[:, 0] / moved[:, 2] * b.camera.fx + b.camera.cx).astype(int)
        y = np.round(moved[:, 1] / moved[:, 2] * b.camera.fy + b.camera.cy).astype(int)
        inside = (x >= 0) & (x < 640) & (y >= 0) & (y < 480) & (moved[:, 2] > 0)
        seen = b.depth[y[inside], x[inside]]
        return float(np.median(np.abs(seen - moved[inside, 2])[seen > 0]))

    right = error(np.linalg.inv(T_b) @ T_a)
    wrong = error(T_b @ np.linalg.inv(T_a))
    assert right < 0.06
    assert wrong > 2 * right
