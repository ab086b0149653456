"""The reader of the Active Vision Dataset: round trips of rendered scans, moves, hostile input."""

from __future__ import annotations

import json
import pickle
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from avd_writer import (
    CX,
    CY,
    FX,
    FY,
    NAMES,
    ImageTruth,
    edit_annotations,
    image_name,
    struct_of,
    write_scan,
    write_structs,
)
from dataset_writers import random_rotation, write_png

from pipeline.answering import open_pipeline
from pipeline.datasets import MOVES, frame_record, has_moves, moves, open_dataset, splits, survey
from pipeline.datasets.avd import FARTHEST_M, SPLITS, read_names, read_poses
from pipeline.geometry import Frame
from pipeline.system import InputError

SCAN = "Home_001_1"


def name(index: int) -> str:
    return image_name(SCAN, index)


def refused(action: Callable[[], object], *words: str) -> None:
    with pytest.raises(InputError) as caught:
        action()
    message = str(caught.value)
    assert "\n" not in message
    for word in words:
        assert word in message, message


def up(frame: Frame) -> np.ndarray:
    assert frame.camera.up is not None
    return frame.camera.up


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict[str, ImageTruth]]:
    root = tmp_path_factory.mktemp("avd")
    return root, write_scan(root, steps=3, unregistered=(2,))


@pytest.fixture
def scan(written: tuple[Path, dict[str, ImageTruth]], tmp_path: Path) -> Path:
    """A copy of the scan's folder that a test may break."""
    shutil.copytree(written[0], tmp_path / "data")
    return tmp_path / "data" / SCAN


def same(frame: Frame, truth: ImageTruth) -> None:
    assert np.abs(frame.rgb.astype(int) - truth.color).max() <= 2
    expected = np.where(truth.millimetres > FARTHEST_M * 1000, 0, truth.millimetres).astype(np.float32)
    assert np.array_equal(frame.depth, expected / np.float32(1000))
    if truth.T_world_camera is None:
        assert frame.camera.T_world_camera is None
        return
    assert frame.camera.T_world_camera is not None
    np.testing.assert_allclose(frame.camera.T_world_camera, truth.T_world_camera, atol=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize("world", ["y-down", "y-up"])
def test_a_scan_of_full_size_is_read_back(tmp_path: Path, world: str) -> None:
    truths = write_scan(tmp_path, size=(1920, 1080), steps=1, world=world)
    dataset = open_dataset(tmp_path)
    assert dataset.format == "avd"
    assert dataset.frame_ids == tuple(f"{SCAN}/{stem}" for stem in truths)
    assert dataset.class_names == ("red_bull", "red_cup")
    for k, (stem, truth) in enumerate(truths.items()):
        frame = dataset.load(f"{SCAN}/{stem}")
        same(frame, truth)
        assert frame.camera.K.tolist() == [[FX, 0, CX], [0, FY, CY], [0, 0, 1]]
        assert frame.depth[0, 0] == np.float32(6.999)
        assert frame.depth[0, 1] == 0
        cup, bull = frame.annotations
        assert (cup.index, cup.label, cup.instance, cup.difficulty) == (0, "red_cup", 33, 1)
        assert (bull.index, bull.label, bull.instance, bull.difficulty) == (1, "red_bull", 21, 3)
        assert cup.bbox.tolist() == [100 + k, 200, 420 + k, 330]
        assert cup.mask is None
        assert cup.box is None
        # The writer's camera looks 5 degrees down, in a world of either height axis.
        assert frame.camera.up_source == "declared"
        np.testing.assert_allclose(up(frame), [0, -np.cos(np.deg2rad(5)), -np.sin(np.deg2rad(5))], atol=1e-9)
        assert [note for note in frame.notes if "fisheye" in note] == list(frame.notes) == list(frame.notes)[: k == 0]


def test_a_smaller_copy_scales_the_camera_and_the_boxes(written: tuple[Path, dict[str, ImageTruth]]) -> None:
    root, truths = written
    dataset = open_dataset(root / SCAN)
    assert dataset.frame_ids == tuple(truths)
    frames = [dataset.load(frame_id) for frame_id in dataset.frame_ids]
    for frame, truth in zip(frames, truths.values(), strict=True):
        same(frame, truth)
        assert frame.camera.fx == pytest.approx(FX / 10)
        # The middle of the image's left edge, pixel -0.5, stays where it is.
        assert frame.camera.cx == pytest.approx((CX + 0.5) / 10 - 0.5)
        assert frame.camera.cy == pytest.approx((CY + 0.5) / 10 - 0.5)
    np.testing.assert_allclose(frames[1].annotations[0].bbox, [10.1, 20, 42.1, 33], atol=1e-5)
    assert [len(frame.notes) for frame in frames] == [1, 0, 1, 0]
    assert "not registered" in frames[2].notes[0]
    assert frames[2].camera.up is None


def test_moves_lead_to_frames_of_the_dataset(written: tuple[Path, dict[str, ImageTruth]]) -> None:
    for opened, prefix in ((written[0], f"{SCAN}/"), (written[0] / SCAN, "")):
        dataset = open_dataset(opened)
        first, second, third, last = dataset.frame_ids
        assert has_moves(dataset)
        assert moves(dataset, first) == {"rotate_ccw": second}
        assert moves(dataset, second) == {"rotate_ccw": third, "rotate_cw": first}
        assert list(moves(dataset, second)) == [m for m in MOVES if m in ("rotate_ccw", "rotate_cw")]
        assert moves(dataset, third) == {"rotate_cw": second, "forward": last}
        assert moves(dataset, last) == {"backward": third}
        assert all(frame_id.startswith(prefix) for frame_id in dataset.frame_ids)
        refused(lambda dataset=dataset: moves(dataset, "nowhere"), "no frame")


def test_turning_left_is_counter_clockwise(written: tuple[Path, dict[str, ImageTruth]]) -> None:
    """The camera's forward axis turns towards its left, about the declared up."""
    dataset = open_dataset(written[0])
    first = dataset.load(dataset.frame_ids[0])
    second = dataset.load(moves(dataset, first.id)["rotate_ccw"])
    assert first.camera.T_world_camera is not None
    assert second.camera.T_world_camera is not None
    forward = first.camera.T_world_camera[:3, :3].T @ second.camera.T_world_camera[:3, 2]
    assert forward[0] < -0.4


def test_frame_records_have_moves_only_where_the_dataset_has(
    written: tuple[Path, dict[str, ImageTruth]], tmp_path: Path
) -> None:
    dataset = open_dataset(written[0])
    records = [json.loads(json.dumps(frame_record(report))) for report in survey(dataset)]
    assert records[0]["moves"] == {"rotate_ccw": dataset.frame_ids[1]}
    assert [r["ok"] for r in records] == [True] * 4
    write_png(tmp_path / "rgb/1.png", np.zeros((48, 64, 3), np.uint8))
    write_png(tmp_path / "depth/1.png", np.full((48, 64), 1500, np.uint16))
    plain = open_dataset(tmp_path, intrinsics=(60, 60, 31, 23), depth_scale=1000)
    assert not has_moves(plain)
    assert moves(plain, plain.frame_ids[0]) == {}
    assert splits(plain) == {}
    assert "moves" not in frame_record(next(survey(plain)))


def test_the_camera_may_stand_in_camera_params_and_scans_beside_each_other(tmp_path: Path) -> None:
    for where in (SCAN, "Office_001_1"):
        write_scan(tmp_path, where, steps=1, camera_params=True)
    for opened in (tmp_path, tmp_path / SCAN):
        frame = open_dataset(opened).load(open_dataset(opened).frame_ids[0])
        assert frame.camera.fx == pytest.approx(FX / 10)
    dataset = open_dataset(tmp_path)
    assert len(dataset.frame_ids) == 4
    assert splits(dataset) == {"test 1": dataset.frame_ids[:2], "test 2": dataset.frame_ids[2:]}
    assert len({scan for scans in SPLITS.values() for scan in scans}) == 9
    again = pickle.loads(pickle.dumps(dataset))
    assert np.array_equal(again.load(again.frame_ids[3]).depth, dataset.load(dataset.frame_ids[3]).depth)


def test_a_scan_among_other_datasets_is_none_of_theirs(scan: Path) -> None:
    root = scan.parent
    (root / "instance_id_map.txt").unlink()
    for other in ("tum", "notes"):
        (root / other).mkdir()
    refused(lambda: open_dataset(root), "no dataset is recognised", "a folder of")


def test_questions_are_answered_from_the_2d_boxes(written: tuple[Path, dict[str, ImageTruth]]) -> None:
    source = open_pipeline(written[0])
    trace = source.ask(source.dataset.load(source.dataset.frame_ids[0]), "red cup left of the red bull")
    assert trace.ranking is not None
    assert trace.objects[trace.ranking.pairs[0].target].label == "red_cup"


def test_the_fisheye_coefficients_are_never_used(scan: Path) -> None:
    before = open_dataset(scan).load(name(1))
    path = scan / "cameras.txt"
    path.write_text(path.read_text().replace("0.382444 0.105826 0.000859549 -0.00143275", "0 0 0 0"))
    after = open_dataset(scan).load(name(1))
    assert np.array_equal(before.camera.K, after.camera.K)
    assert np.array_equal(before.rgb, after.rgb)
    assert "0.382" in before.notes[0]
    assert not any("fisheye" in note for note in after.notes)


def edited(scan: Path, boxes: Any) -> Frame:
    edit_annotations(scan, lambda table: table[f"{name(2)}.jpg"].update(bounding_boxes=boxes))
    return open_dataset(scan).load(name(2))


def test_odd_boxes_are_clipped_dropped_or_named_with_a_note(scan: Path) -> None:
    frame = edited(
        scan,
        [
            [-50, 20, 300, 2000, 1, 5],
            [300, 300, 300, 400, 5, 5],
            [500, 400, 400, 300, 5, 5],
            [1930, 10, 2000, 90, 5, 5],
            [10, 10, 90, 90, 57, 2],
            [10, 10, 90, 90, 5],
        ],
    )
    assert [(a.index, a.label) for a in frame.annotations] == [
        (0, "advil_liqui_gels"),
        (4, "instance_57"),
        (5, "coca_cola_glass_bottle"),
    ]
    np.testing.assert_allclose(frame.annotations[0].bbox, [0, 2, 30, 108], atol=1e-5)
    assert frame.annotations[1].instance == 57
    assert frame.annotations[2].difficulty is None
    assert len(frame.notes) == 5
    for note, word in zip(frame.notes, ["clipped", "empty", "empty", "empty", "instance 57 has no name"], strict=True):
        assert word in note


@pytest.mark.parametrize(
    "boxes",
    [
        "none",
        {"a": 1},
        [["a", 1, 2, 3, 4, 5]],
        [[1, 2, 3]],
        [None],
        [[0, 0, 10, 10, True, 1]],
        [[0, 0, 10**40, 10, 1, 1]],
        [[0, 0, 10, 10, 1.5, 1]],
        [[0, float("nan"), 10, 10, 1, 1]],
        [[0, 0, 10, float("inf"), 1, 1]],
    ],
)
def test_what_is_no_box_is_left_out_with_a_note(scan: Path, boxes: Any) -> None:
    frame = edited(scan, boxes)
    assert frame.annotations == ()
    assert len(frame.notes) == 1
    assert open_dataset(scan).class_names == ("red_bull", "red_cup")


def test_missing_names_are_said_once(scan: Path) -> None:
    (scan.parent / "instance_id_map.txt").unlink()
    frames = [open_dataset(scan).load(name(k)) for k in (1, 2)]
    assert [a.label for a in frames[1].annotations] == ["instance_33", "instance_21"]
    assert "instance_id_map.txt is missing" in frames[0].notes[0]
    assert frames[1].notes == ()
    (scan / "instance_id_map.txt").write_text("red_cup 33\n")
    assert open_dataset(scan).class_names == ("instance_21", "red_cup")


@pytest.mark.parametrize("text", ["red_cup thirty", "33", "red_cup 33\nblue_cup 33", "\0", "red_cup -3"])
def test_a_broken_list_of_names_is_refused(scan: Path, text: str) -> None:
    (scan.parent / "instance_id_map.txt").write_text(text)
    refused(lambda: open_dataset(scan), "instance_id_map.txt")


def test_the_real_list_of_names_is_read(shared_data: Path) -> None:
    names = read_names(shared_data / "real/avd-format/instance_id_map.txt")
    assert len(names) == 34
    assert {k: names[k] for k in NAMES} == NAMES


def test_images_and_annotations_need_not_match(scan: Path) -> None:
    (scan / "jpg_rgb" / f"{name(2)}.jpg").unlink()
    edit_annotations(scan, lambda table: table.pop(f"{name(3)}.jpg"))
    dataset = open_dataset(scan)
    reports = list(survey(dataset))
    assert [r.id for r in reports] == [name(k) for k in (1, 2, 3, 4)]
    assert [r.ok for r in reports] == [True, False, True, True]
    assert "colour file is missing" in str(reports[1].problem)
    assert reports[2].annotations == 0
    assert "no entry in annotations.json" in reports[2].notes[-1]
    # The picture that the first frame's pointer leads to is gone, and the third has no pointers.
    assert moves(dataset, name(1)) == {}
    assert moves(dataset, name(3)) == {}
    assert moves(dataset, name(4)) == {"backward": name(3)}


def test_a_broken_depth_file_breaks_its_frame_only(scan: Path) -> None:
    depth = scan / "high_res_depth"
    path = depth / f"{image_name(SCAN, 1, 3)}.png"
    path.write_bytes(path.read_bytes()[:-40])
    (depth / f"{image_name(SCAN, 2, 3)}.png").unlink()
    write_png(depth / f"{image_name(SCAN, 3, 3)}.png", np.full((424, 512), 1500, np.uint16))
    reports = list(survey(open_dataset(scan)))
    assert [r.ok for r in reports] == [False, False, False, True]
    for report, words in zip(reports, ["cut off", "missing", "differ in size"], strict=False):
        assert words in str(report.problem)
        assert "high_res_depth" in str(report.problem)


def test_an_image_of_another_shape_is_refused(scan: Path) -> None:
    write_png(scan / "high_res_depth" / f"{image_name(SCAN, 1, 3)}.png", np.full((120, 192), 1500, np.uint16))
    assert cv2.imwrite(str(scan / "jpg_rgb" / f"{name(1)}.jpg"), np.zeros((120, 192, 3), np.uint8))
    refused(lambda: open_dataset(scan).load(name(1)), "another image size", "192x120", "1920x1080")


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ("1 OPENCV 1920 1080 1049 1092 927 545 0.3", ["count", "9 words"]),
        ("1 OPENCV 1920 1080 a b c d 0 0 0 0", ["not numbers"]),
        ("1 OPENCV 1920 1080 -1 1092 927 545 0 0 0 0", ["no camera"]),
        ("1 OPENCV 0 1080 1 1092 927 545 0 0 0 0", ["no camera"]),
        ("1 OPENCV 1920 1080 nan 1092 927 545 0 0 0 0", ["no camera"]),
        ("1 OPENCV 1920 1080 1049 1092 9270 545 0 0 0 0", ["principal point"]),
        ("# nothing", ["no camera is listed"]),
        ("", ["empty"]),
    ],
)
def test_a_broken_camera_is_refused_unless_one_is_told(scan: Path, line: str, words: list[str]) -> None:
    (scan / "cameras.txt").write_text(line)
    refused(lambda: open_dataset(scan).load(name(1)), *words, "cameras.txt")
    assert open_dataset(scan, intrinsics=(105, 109, 92, 54)).load(name(1)).camera.fx == 105


def test_a_missing_camera_is_asked_for(scan: Path) -> None:
    (scan / "cameras.txt").unlink()
    refused(lambda: open_dataset(scan).load(name(1)), "--intrinsics", "cameras.txt")
    frame = open_dataset(scan, intrinsics=(105, 109, 92, 54), depth_scale=500).load(name(2))
    np.testing.assert_allclose(frame.annotations[0].bbox, [10.1, 20, 42.1, 33], atol=1e-5)
    assert frame.camera.up_source == "declared"
    assert frame.depth.max() > 2


def structs(count: int, **changed: Any) -> list[dict[str, Any]]:
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = np.diag([1.0, -1, -1]), [0.3, 0.1, -2]
    return [{**struct_of(f"{name(k + 1)}.jpg", T), **changed} for k in range(count)]


def broken_structs(folder: Path, how: str) -> None:
    path = folder / "image_structs.mat"
    if how == "missing":
        path.unlink()
    elif how == "cut":
        path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    elif how == "text":
        path.write_text("not a MATLAB file at all, and long enough to hold a header " * 5)
    elif how == "empty":
        path.write_bytes(b"")
    elif how == "no structs":
        from scipy.io import savemat

        savemat(path, {"scale": 3.0})
    elif how == "scale":
        write_structs(folder, structs(4), scale=np.zeros((0, 0)))
    elif how == "negative scale":
        write_structs(folder, structs(4), scale=-2.0)
    elif how == "no rotation":
        write_structs(folder, structs(4, R=np.diag([1.0, -1, 1])))
    elif how == "not finite":
        write_structs(folder, structs(4, t=np.array([[np.nan], [0], [0]])))
    elif how == "pointers":
        write_structs(folder, structs(4, R=-1, t=-1))
    elif how == "cells":
        write_structs(folder, structs(4, R=np.array([["a", "b"]]), t="hello"))


@pytest.mark.parametrize(
    "how",
    [
        "missing",
        "cut",
        "text",
        "empty",
        "no structs",
        "scale",
        "negative scale",
        "no rotation",
        "not finite",
        "pointers",
        "cells",
    ],
)
def test_without_usable_poses_the_frames_are_still_there(scan: Path, how: str) -> None:
    broken_structs(scan, how)
    frame = open_dataset(scan).load(name(2))
    assert frame.camera.T_world_camera is None
    assert frame.camera.up is None
    assert len(frame.annotations) == 2
    assert any("no camera pose" in note for note in frame.notes), frame.notes


OUTSIDE = '{"../../etc/passwd.jpg": {"bounding_boxes": [[1, 1, 9, 9, 33, 1]]}}'


@pytest.mark.parametrize("how", ["{", "[1, 2]", "", OUTSIDE])
def test_broken_annotations_leave_the_pictures(scan: Path, how: str) -> None:
    (scan / "annotations.json").write_text(how)
    dataset = open_dataset(scan)
    assert dataset.frame_ids == tuple(name(k) for k in (1, 2, 3, 4))
    assert dataset.class_names == ()
    frame = dataset.load(name(2))
    assert frame.annotations == ()
    assert moves(dataset, name(2)) == {}


@pytest.mark.parametrize("pointer", ["../x.jpg", "/etc/passwd", 7, None, ["a"], "000110000990101.jpg", "00011.jpg"])
def test_pointers_that_lead_nowhere_are_left_out(scan: Path, pointer: Any) -> None:
    edit_annotations(scan, lambda table: table[f"{name(1)}.jpg"].update(forward=pointer, left=f"{name(4)}.jpg"))
    assert moves(open_dataset(scan), name(1)) == {"rotate_ccw": name(2), "left": name(4)}


def test_the_up_axis_is_that_of_most_cameras(tmp_path: Path) -> None:
    rng = np.random.default_rng(3)
    entries = structs(30)
    for k in range(4):
        T = np.eye(4)
        T[:3, :3] = random_rotation(rng)
        entries[k] = struct_of(f"{name(k + 1)}.jpg", T)
    write_structs(tmp_path, entries)
    poses = read_poses(tmp_path / "image_structs.mat")
    assert poses.up is not None
    # The level cameras have R = diag(1, -1, -1): their own y is down and is the world's -y.
    assert poses.up.tolist() == [0, 1, 0]
    np.testing.assert_allclose(poses.pose(name(20))[:3, 3], [0.3, 0.1, -2], atol=1e-9)
    sideways = np.eye(4)
    sideways[:3, :3] = [[0, 1, 0], [-1, 0, 0], [0, 0, 1]]
    write_structs(tmp_path, [struct_of(f"{name(1)}.jpg", sideways)])
    assert read_poses(tmp_path / "image_structs.mat").up is None


def test_a_declared_up_wins(scan: Path) -> None:
    (scan / "spatialviz.toml").write_text("world_up = [1, 0, 0]")
    frame = open_dataset(scan).load(name(1))
    assert frame.camera.T_world_camera is not None
    np.testing.assert_allclose(up(frame), frame.camera.T_world_camera[0, :3], atol=1e-12)
