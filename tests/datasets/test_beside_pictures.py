"""What stands beside pictures: poses and units in JSON, the left camera's pictures, depth under a picture's name."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from app_writers import truths
from dataset_writers import HEIGHT, OPENGL, WIDTH, K, Truth, write_png
from reader_checks import FOLDER, refused

from pipeline.datasets import dataset_notes, open_dataset


def write_frames(root: Path, made: list[Truth], key: str, matrices: list[Any], **more: Any) -> None:
    """Pictures, depth and a JSON a frame, as "All Data" of 3D Scanner App has them: `cameraPoseARFrame` 16 numbers by
    rows, `intrinsics` 9. Its readers reshape((4, 4)) them; what they mean is Apple's,
    https://developer.apple.com/documentation/arkit/arcamera/transform."""
    for number, (truth, matrix) in enumerate(zip(made, matrices, strict=True)):
        write_png(root / f"frame_{number:05d}.png", truth.rgb)
        write_png(root / f"depth_{number:05d}.png", truth.millimetres)
        table = {key: np.asarray(matrix).tolist(), "intrinsics": K.ravel().tolist(), "time": 5.0 + number, **more}
        (root / f"frame_{number:05d}.json").write_text(json.dumps(table))


WAYS = {
    "cameraPoseARFrame": lambda T: (T @ OPENGL).ravel(),
    "transform_matrix": lambda T: T @ OPENGL,
    "c2w": lambda T: T[:3],
    "T_world_camera": lambda T: T,
    "pose": lambda T: T.T.ravel(),  # By columns, as simd and Eigen print
    "extrinsics": lambda T: np.linalg.inv(T),
    "w2c": lambda T: np.linalg.inv(T)[:3].ravel(),
}


@pytest.mark.parametrize("key", WAYS)
def test_the_pose_of_a_frames_own_json_is_read_and_told(tmp_path: Path, key: str) -> None:
    made = truths(3)
    write_frames(tmp_path, made, key, [WAYS[key](truth.T_world_camera) for truth in made])
    dataset = open_dataset(tmp_path, depth_scale=1000.0)
    for frame_id, truth in zip(dataset.frame_ids, made, strict=True):
        frame = dataset.load(frame_id)
        assert frame.camera.T_world_camera is not None
        assert np.allclose(frame.camera.T_world_camera, truth.T_world_camera, atol=1e-6)
        assert np.allclose(frame.camera.K, K)
        if key == "cameraPoseARFrame":
            assert frame.camera.up_source == "declared"
            assert frame.camera.up is not None
            assert np.allclose(truth.T_world_camera[:3, :3] @ frame.camera.up, (0, 1, 0), atol=1e-6)
    (note,) = (note for note in dataset_notes(dataset) if "poses are" in note)
    assert f"{key} of frame_00000.json" in note
    assert ("world-to-camera" if key in ("extrinsics", "w2c") else "camera-to-world") in note
    assert not any("not read" in note for note in dataset_notes(dataset))


@pytest.mark.parametrize("inside", ["", "poses"])
def test_a_camera_file_may_hold_a_pose_for_each_frame(tmp_path: Path, inside: str) -> None:
    """K, and a matrix under each frame's name, as exercises made with Blender have them."""
    made = truths(3)
    for number, truth in enumerate(made):
        write_png(tmp_path / f"color/{number:04d}.png", truth.rgb)
        write_png(tmp_path / f"depth/{number:04d}.png", truth.millimetres)
    poses = {f"{number:04d}": truth.T_world_camera.tolist() for number, truth in enumerate(made)}
    table = {"K": K.tolist(), **({inside: poses} if inside else poses)}
    (tmp_path / "camera.json").write_text(json.dumps(table))
    dataset = open_dataset(tmp_path, depth_scale=1000.0)
    for frame_id, truth in zip(dataset.frame_ids, made, strict=True):
        pose = dataset.load(frame_id).camera.T_world_camera
        assert pose is not None
        assert np.allclose(pose, truth.T_world_camera)
    assert any("poses are those of camera.json, taken for camera-to-world" in note for note in dataset_notes(dataset))
    # Numbers of other frames are no poses of these.
    others = {f"9{name}": matrix for name, matrix in poses.items()}
    (tmp_path / "camera.json").write_text(json.dumps({"K": K.tolist(), **others, "88": np.eye(4).tolist()}))
    frame = open_dataset(tmp_path, depth_scale=1000.0).load("0000")
    assert frame.camera.T_world_camera is None
    assert "no camera pose: camera.json: its poses are of other frames, 90000 for one" in frame.notes


def test_a_frames_own_camera_is_its_own(tmp_path: Path) -> None:
    made = truths(2)
    write_frames(tmp_path, made, "c2w", [truth.T_world_camera for truth in made])
    wide = np.diag([2.0, 2.0, 1.0]) @ K
    (tmp_path / "frame_00001.json").write_text(json.dumps({"c2w": np.eye(4).tolist(), "intrinsics": wide.tolist()}))
    dataset = open_dataset(tmp_path, depth_scale=1000.0)
    focals = [dataset.load(frame_id).camera.fx for frame_id in dataset.frame_ids]
    assert focals == pytest.approx([60, 120])


@pytest.mark.parametrize(
    ("key", "value", "word"),
    [
        ("anchor", np.eye(4) + np.eye(4, k=3), "not read: anchor of frame_00000.json"),
        ("c2w", np.diag([2.0, 2.0, 2.0, 1.0]), "no camera pose, frame_00000.json: not a rotation"),
        ("objects", [{"pose": np.eye(4).tolist()}], ""),
        ("object", {"pose": np.diag([2.0, 1, 1, 1]).tolist()}, ""),
        ("c2w", [1.0] * 7, ""),
    ],
)
def test_a_pose_that_is_not_understood_is_named(tmp_path: Path, key: str, value: Any, word: str) -> None:
    made = truths(2)
    value = value.tolist() if isinstance(value, np.ndarray) else value
    write_frames(tmp_path, made, "time", [0.0, 1.0])
    for path in tmp_path.glob("*.json"):
        path.write_text(json.dumps({key: value, "intrinsics": K.ravel().tolist()}))
    dataset = open_dataset(tmp_path, depth_scale=1000.0)
    frame = dataset.load("frame_00000")
    assert frame.camera.T_world_camera is None
    assert word in "; ".join((*dataset_notes(dataset), *frame.notes))


@pytest.mark.parametrize("text", ["{", "[]", "null", '{"c2w": "x"}', '{"c2w": [[1], 2]}', "", "9" * 70_000])
def test_a_json_beside_a_picture_that_says_nothing_changes_nothing(tmp_path: Path, text: str) -> None:
    made = truths(2)
    write_frames(tmp_path, made, "time", [0.0, 1.0])
    for path in tmp_path.glob("*.json"):
        path.write_text(text)
    frame = open_dataset(tmp_path, **FOLDER).load("frame_00001")
    assert np.array_equal(frame.depth, made[1].depth)
    assert frame.camera.T_world_camera is None


@pytest.mark.parametrize(
    ("table", "units"),
    [
        # `rs2::depth_sensor::get_depth_scale`, metres in a unit; librealsense `rs_sensor.hpp`.
        ({"depth_scale": 0.0002500000118743628, "depth_units": 0.0002500000118743628}, 4000.0),
        ({"depth_units": "mm"}, 1000.0),
        ({"sensor": {"depth_scale": 5000.0}}, 5000.0),
        ({"depth_scale": 2.0}, None),
        ({"scale": 1000.0}, None),
    ],
)
def test_a_unit_in_a_json_of_any_name_is_read(tmp_path: Path, table: dict[str, Any], units: float | None) -> None:
    (truth,) = truths(1)
    write_png(tmp_path / "color/0.png", truth.rgb)
    write_png(tmp_path / "depth/0.png", truth.millimetres)
    numbers = {"fx": K[0, 0], "fy": K[1, 1], "ppx": K[0, 2], "ppy": K[1, 2], "width": WIDTH, "height": HEIGHT}
    (tmp_path / "color_intrinsics.json").write_text(json.dumps(numbers))
    (tmp_path / "depth_sensor.json").write_text(json.dumps(table))
    if units is None:
        refused(lambda: open_dataset(tmp_path), "the depth's unit is missing")
        return
    dataset = open_dataset(tmp_path)
    assert np.allclose(dataset.load("0").depth, truth.millimetres / units, rtol=1e-6)
    assert not any("not read" in note for note in dataset_notes(dataset))
