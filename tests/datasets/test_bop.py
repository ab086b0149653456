"""BOP: read back exactly, under whatever folder, and every broken part said."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from dataset_writers import (
    HEIGHT,
    WIDTH,
    K,
    write_bop,
    write_png,
)
from reader_checks import MODELS, refused

from pipeline.datasets import (
    open_dataset,
    survey,
)
from pipeline.geometry import Box3D


def edit_json(path: Path, change: Callable[[Any], Any]) -> None:
    table = json.loads(path.read_text())
    change(table)
    path.write_text(json.dumps(table))


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
def test_bop_scene_split_and_dataset_have_the_same_ids(tmp_path: Path, opened: str, expected: list[str]) -> None:
    write_bop(tmp_path / "data" / "test", {"000001": [1, 2]})
    models = tmp_path / "data" / "models_eval"
    models.mkdir()
    (models / "models_info.json").write_text(json.dumps(MODELS))
    dataset = open_dataset(tmp_path / opened)
    assert list(dataset.frame_ids) == expected
    # The models stand outside an opened split or scene, and nothing outside is read.
    assert dataset.class_names[0] == ("mug" if opened == "data" else "obj_000001")
    assert dataset.load(expected[0]).annotations[0].label == dataset.class_names[0]


def test_bop_scene_opened_as_the_working_folder_keeps_its_name(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
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
    edit_json(tmp_path / "000001/scene_camera.json", lambda t: [t["2"].pop(k) for k in ("cam_R_w2c", "cam_t_w2c")])
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
    edit_json(tmp_path / "000001/scene_camera.json", lambda t: t["1"].update(cam_R_w2c=[2, 0, 0, 0, 2, 0, 0, 0, 2]))
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


@pytest.mark.parametrize("table", [{"1": 5}, {"1": [5, None, {}]}, {"1": {"obj_id": 1}}, {"1": [{"obj_id": "x"}]}])
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
