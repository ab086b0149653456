"""What a reader does not use is named; units, validity, camera paths and times that files state are taken."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from app_writers import truths
from dataset_writers import HEIGHT, WIDTH, K, quaternion_line, write_folder, write_nerfstudio, write_png
from every_format import WRITERS
from hypothesis import given
from hypothesis import strategies as st
from reader_checks import FOLDER, refused

from pipeline.answering.pipeline import open_sources
from pipeline.datasets import dataset_notes, open_dataset
from pipeline.datasets.cameras import or_note
from pipeline.datasets.images import end_of_range
from pipeline.datasets.settings import TURNS
from pipeline.datasets.trajectories import read_trajectory
from pipeline.datasets.turned import turn_to


def unread(root: Path) -> str:
    """The note of what was not read; "" where all was."""
    return next((note for note in dataset_notes(open_dataset(root, browse=True)) if "not read" in note), "")


# Files that were not read


@pytest.mark.parametrize("kind", sorted(WRITERS))
def test_a_dataset_of_a_format_has_nothing_that_is_not_read(tmp_path: Path, kind: str) -> None:
    WRITERS[kind](tmp_path)
    (tmp_path / "README.md").write_text("for people")
    assert unread(tmp_path) == ""


@pytest.mark.parametrize("kind", ["bop", "tum", "scannet", "redwood", "sunrgbd", "folder"])
def test_a_file_beside_a_dataset_is_named_in_every_format(tmp_path: Path, kind: str) -> None:
    WRITERS[kind](tmp_path)
    (tmp_path / "gravity.bin").write_bytes(b"123")
    (tmp_path / "thermal").mkdir()
    for number in range(5):
        (tmp_path / f"thermal/{number}.raw").write_bytes(b"1")
    note = unread(tmp_path)
    assert "gravity.bin" in note
    assert "thermal/ (5 files)" in note


def test_what_may_tell_a_camera_is_named_first_where_a_folder_is_taken_for_plain(tmp_path: Path) -> None:
    write_folder(tmp_path, [1, 2], poses=False)
    (tmp_path / "a_log.csv").write_text("1,2,3\n")
    (tmp_path / "gps_odometry.csv").write_text("north,east\n1,2\n")
    (tmp_path / "extrinsics.yaml").write_text("T: [1, 2]\n")
    note = unread(tmp_path)
    assert note.startswith("not read: extrinsics.yaml, gps_odometry.csv, a_log.csv; opened as a plain folder")
    # And so where it cannot be opened at all.
    refused(lambda: open_dataset(tmp_path), "--intrinsics", "not read: extrinsics.yaml, gps_odometry.csv")


def test_a_video_beside_depth_is_named_with_how_it_is_unpacked(tmp_path: Path) -> None:
    write_png(tmp_path / "depth/000000.png", truths(1)[0].millimetres)
    (tmp_path / "clip.mov").write_bytes(b"1234")
    refused(lambda: open_dataset(tmp_path), "clip.mov", "ffmpeg -i clip.mov -start_number 0 color/%06d.png")


# Units and what is no depth


def test_integer_depth_scale_is_the_unit(tmp_path: Path) -> None:
    made = write_nerfstudio(tmp_path)
    path = tmp_path / "transforms.json"
    table = json.loads(path.read_text()) | {"enable_depth_loading": True, "integer_depth_scale": 0.00025}
    path.write_text(json.dumps(table))
    dataset = open_dataset(tmp_path)
    assert np.allclose(dataset.load(dataset.frame_ids[0]).depth, made[0].depth / 4, atol=1e-6)
    assert dataset_notes(dataset) == ("the depth's unit is that of integer_depth_scale, 4000 to a metre of the poses",)
    given_ = open_dataset(tmp_path, depth_scale=1000)
    assert np.allclose(given_.load(dataset.frame_ids[0]).depth, made[0].depth)
    path.write_text(json.dumps(table | {"integer_depth_scale": -1}))
    refused(lambda: open_dataset(tmp_path), "integer_depth_scale", "positive")


def test_paths_of_windows(tmp_path: Path) -> None:
    made = write_nerfstudio(tmp_path)
    path = tmp_path / "transforms.json"
    path.write_text(path.read_text().replace("./images/", "images\\\\").replace("depth/", "depth\\\\"))
    dataset = open_dataset(tmp_path)
    assert np.array_equal(dataset.load(dataset.frame_ids[2]).depth, made[2].depth)
    assert unread(tmp_path) == ""
    for bad in ("C:\\\\scans\\\\1.png", "..\\\\1.png", "\\\\\\\\host\\\\1.png"):
        path.write_text(path.read_text().replace("images\\\\frame_00001.png", bad))
        refused(lambda: open_dataset(tmp_path), "outside the dataset")
        path.write_text(path.read_text().replace(bad, "images\\\\frame_00001.png"))


def test_transforms_in_a_folder_of_their_own_are_read_from_the_folder_above(tmp_path: Path) -> None:
    made = write_nerfstudio(tmp_path / "capture")
    text = (tmp_path / "capture/transforms.json").read_text()
    (tmp_path / "capture/transforms.json").unlink()
    path = tmp_path / "nerf/transforms.json"
    path.parent.mkdir()
    for start, slash in (("../capture/", "/"), ("..\\\\capture\\\\", "\\\\")):
        told = text.replace("./images/", f"{start}images{slash}").replace("depth/", f"{start}depth{slash}")
        path.write_text(told)
        dataset = open_dataset(tmp_path)
        assert dataset.format == "nerfstudio"
        frame = dataset.load(dataset.frame_ids[2])
        assert np.array_equal(frame.depth, made[2].depth)
        assert frame.camera.T_world_camera is not None
        assert np.allclose(frame.camera.T_world_camera, made[2].T_world_camera)
        assert unread(tmp_path) == ""
        refused(lambda: open_dataset(path.parent), "the folder above both", str(tmp_path))
        # Never outside the opened folder, and never of two that may be meant.
        path.write_text(told.replace(f"{start}images{slash}frame_00003", "../../frame_00003"))
        refused(lambda: open_dataset(tmp_path), "outside the dataset")
        path.write_text(told)
    (tmp_path / "other").mkdir()
    (tmp_path / "other/transforms.json").write_text(told)
    refused(lambda: open_dataset(tmp_path), "no dataset is recognised")


@pytest.mark.parametrize("before", ["C:\\\\Users\\\\ann\\\\scan", "/home/ann/scan"])
def test_absolute_paths_of_another_machine_are_those_of_the_folder(tmp_path: Path, before: str) -> None:
    made = write_nerfstudio(tmp_path)
    path = tmp_path / "transforms.json"
    path.write_text(path.read_text().replace("./images/", f"{before}/images/").replace("depth/", f"{before}/depth/"))
    dataset = open_dataset(tmp_path)
    assert np.array_equal(dataset.load(dataset.frame_ids[2]).depth, made[2].depth)
    assert any("by their last parts" in note for note in dataset_notes(dataset))


@pytest.mark.parametrize("value", [65535, 4095, 32767, 9999, 50000])
def test_the_end_of_the_range_is_no_depth_and_told(tmp_path: Path, value: int) -> None:
    write_folder(tmp_path, [1, 2])
    stored = np.full((HEIGHT, WIDTH), 1500, np.uint16)
    stored[:, :9] = value
    write_png(tmp_path / "depth/1.png", stored)
    frame = open_dataset(tmp_path, **FOLDER).load("1")
    assert frame.depth.max() == pytest.approx(1.5)
    assert any(f"hold {value}, the end of the range" in note for note in frame.notes)


def test_depth_that_is_measured_is_kept() -> None:
    # A wall seen head on, and one far away behind a near thing.
    wall = np.full((40, 40), 2000, np.uint16)
    assert end_of_range(wall) is None
    wall[:20] = 700
    assert end_of_range(wall) is None
    few = np.full((400, 400), 900, np.uint16)
    few[0, 0] = 4095
    assert end_of_range(few) is None
    assert end_of_range(np.full((9, 9), np.nan, np.float32)) is None
    assert end_of_range(np.full((9, 9), 1e10, np.float32)) == 1e10
    assert end_of_range(np.zeros((0, 4), np.uint16)) is None


def test_where_depth_is_cut_is_told_and_kept(tmp_path: Path) -> None:
    write_folder(tmp_path, [1, 2])
    stored = np.linspace(900, 14000, HEIGHT * WIDTH).reshape(HEIGHT, WIDTH)
    write_png(tmp_path / "depth/1.png", np.minimum(stored, 10000).astype(np.uint16))
    frame = open_dataset(tmp_path, **FOLDER).load("1")
    assert frame.depth.max() == 10
    assert any("lie at 10 m" in note for note in frame.notes)


@pytest.mark.parametrize("name", ["{}_depth_mask.npy", "{}_depth_valid.png", "{}_mask_depth.png", "{}_valid.png"])
def test_validity_beside_depth_is_no_depth_and_is_used(tmp_path: Path, name: str) -> None:
    """As DIODE has it, https://github.com/diode-dataset/diode-devkit: `N.png`, `N_depth.npy` (H, W, 1), a mask."""
    made = truths(3)
    for number, truth in enumerate(made):
        write_png(tmp_path / f"{number:05d}.png", truth.rgb)
        np.save(tmp_path / f"{number:05d}_depth.npy", truth.depth[..., None])
        mask = np.ones((HEIGHT, WIDTH), np.uint8)
        mask[: 5 + number] = 0
        path = tmp_path / name.format(f"{number:05d}")
        np.save(path, mask.astype(np.float32)) if path.suffix == ".npy" else write_png(path, 255 * mask)
    dataset = open_dataset(tmp_path, intrinsics=FOLDER["intrinsics"])
    for number, frame_id in enumerate(dataset.frame_ids):
        frame = dataset.load(frame_id)
        assert not frame.depth[: 5 + number].any()
        assert np.array_equal(frame.depth[5 + number :], made[number].depth[5 + number :])
    assert any("depth counts only where" in note for note in dataset_notes(dataset))
    write_png(tmp_path / "label/00000.png", np.ones((HEIGHT, WIDTH), np.uint8))


# Cameras and camera paths beside a plain folder


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("camera_params.json", '{"fx": 60, "fy": 61, "x_offset": 31.5, "y_offset": 23.5, "width": 64, "height": 48}'),
        ("oak.json", '{"rgb": {"f_x": 60, "f_y": 61, "principal_point_x": 31.5, "principal_point_y": 23.5}}'),
        ("device.yaml", "fx: 60\nfy: 61\nppx: 31.5\nppy: 23.5\n"),
        ("camera_matrix.csv", "60, 0, 31.5\n0, 61, 23.5\n0, 0, 1\n"),
        ("setup.json", '{"camera": {"w": 64, "h": 48, "fx": 60, "fy": 61, "cx": 31.5, "cy": 23.5, "scale": 1000}}'),
    ],
)
def test_a_camera_is_read_by_the_names_of_its_numbers(tmp_path: Path, name: str, text: str) -> None:
    made = write_folder(tmp_path, [1, 2])
    (tmp_path / name).write_text(text)
    (tmp_path / "settings_of_the_robot.json").write_text('{"speed": [1, 2, 3, 4], "width": 9}')
    frame = open_dataset(tmp_path, depth_scale=None if "scale" in text else 1000).load("1")
    assert np.allclose(frame.camera.K, K)
    assert np.array_equal(frame.depth, made[0].depth)
    assert "settings_of_the_robot.json" in unread(tmp_path)
    assert name not in unread(tmp_path)


def lines_of(kind: str, T: np.ndarray, number: int) -> str:
    x, y, z, qx, qy, qz, qw = (f"{v:.9f}" for v in quaternion_line(T))
    return {
        "matrix": " ".join(f"{v:.9f}" for v in T.ravel()),
        "kitti": " ".join(f"{v:.9f}" for v in T[:3].ravel()),
        "numbered": f"{number} " + " ".join((x, y, z, qx, qy, qz, qw)),
        "csv": ",".join((str(number), qw, qx, qy, qz, x, y, z)),
        "euroc": ",".join((str(number), x, y, z, qw, qx, qy, qz)),
    }[kind]


HEADS = {
    "csv": "frame,qw,qx,qy,qz,tx,ty,tz\n",
    "euroc": "#timestamp [ns], p_RS_R_x [m], p_RS_R_y [m], p_RS_R_z [m], q_RS_w [], q_RS_x [], q_RS_y [], q_RS_z []\n",
}
FILES = {
    "matrix": "traj.txt",
    "kitti": "poses.txt",
    "numbered": "groundtruth.txt",
    "csv": "odometry.csv",
    "euroc": "gt_poses.csv",
}


@pytest.mark.parametrize("kind", sorted(FILES))
def test_a_camera_path_beside_a_plain_folder(tmp_path: Path, kind: str) -> None:
    made = write_folder(tmp_path, [0, 1, 2], poses=False)
    text = "\n".join(lines_of(kind, truth.T_world_camera, number) for number, truth in enumerate(made))
    (tmp_path / FILES[kind]).write_text(HEADS.get(kind, "") + text + "\n")
    dataset = open_dataset(tmp_path, **FOLDER)
    for frame_id, truth in zip(dataset.frame_ids, made, strict=True):
        pose = dataset.load(frame_id).camera.T_world_camera
        assert pose is not None
        assert np.allclose(pose, truth.T_world_camera, atol=1e-6)
    assert any(FILES[kind] in note and "camera-to-world" in note for note in dataset_notes(dataset))
    # A path that cannot be read costs the poses, is told, and no more.
    (tmp_path / FILES[kind]).write_text("1 2 3\n4 5 6\n")
    frame = open_dataset(tmp_path, **FOLDER).load("0")
    assert frame.camera.T_world_camera is None
    assert any(FILES[kind] in note for note in frame.notes)


@given(st.text(max_size=200))
def test_a_camera_path_of_any_text_gives_poses_or_one_line(tmp_path_factory: pytest.TempPathFactory, text: str) -> None:
    path = tmp_path_factory.mktemp("path") / "traj.txt"
    path.write_text(text, encoding="utf-8")
    notes: list[str] = []
    found = or_note(notes, "", read_trajectory, path)
    assert all("\n" not in note for note in notes)
    assert found is None or {len(row) for row in found.rows} <= {7, 12, 16}


# Pairing by time


@pytest.mark.parametrize("unit", [1, 1e3, 1e9, 0])
def test_pictures_with_times_of_their_own_pair_by_the_nearest(tmp_path: Path, unit: float) -> None:
    made, start = truths(4), 1_700_000_000.0

    def name(at: float) -> str:
        if not unit:
            return f"{start + at:.6f}".replace(".", "_")
        return f"{start + at:.6f}" if unit == 1 else str(round((start + at) * unit))

    for number, truth in enumerate(made):
        write_png(tmp_path / f"rgb/{name(number / 10)}.png", truth.rgb)
        write_png(tmp_path / f"depth/{name(number / 10 + 0.004)}.png", truth.millimetres)
        # Depth at twice the rate: every second is nobody's.
        write_png(tmp_path / f"depth/{name(number / 10 + 0.05)}.png", made[0].millimetres // 2)
    lines = [
        " ".join((name(n / 10 - 0.003), *(f"{v:.9f}" for v in quaternion_line(t.T_world_camera))))
        for n, t in enumerate(made)
    ]
    (tmp_path / "groundtruth.txt").write_text("\n".join(lines))
    dataset = open_dataset(tmp_path, **FOLDER)
    assert len(dataset.frame_ids) == 4
    for frame_id, truth in zip(dataset.frame_ids, made, strict=True):
        frame = dataset.load(frame_id)
        assert np.array_equal(frame.depth, truth.depth)
        assert frame.camera.T_world_camera is not None
        assert np.allclose(frame.camera.T_world_camera, truth.T_world_camera, atol=1e-6)
    assert any("nearest time" in note for note in dataset_notes(dataset))


def test_times_too_far_apart_do_not_pair(tmp_path: Path) -> None:
    for number, truth in enumerate(truths(3)):
        write_png(tmp_path / f"rgb/{1_700_000_000 + number / 10:.6f}.png", truth.rgb)
        write_png(tmp_path / f"depth/{1_700_000_000 + number / 10 + 0.03:.6f}.png", truth.millimetres)
    refused(lambda: open_dataset(tmp_path, **FOLDER), "do not pair")


# Turned pictures


@pytest.mark.parametrize("turn", sorted(TURNS))
def test_a_turned_colour_picture_is_told_with_the_turn(tmp_path: Path, turn: str) -> None:
    rng = np.random.default_rng(1)
    depth, rgb = np.full((96, 128), 2000.0), np.full((96, 128, 3), 90, np.uint8)
    for near in (1500, 1000):
        x, y, w, h = rng.integers((0, 0, 30, 20), (70, 60, 50, 35))
        depth[y : y + h, x : x + w] = near
        rgb[y : y + h, x : x + w] = rng.integers(0, 255, 3)
    back = np.rot90(rgb, -TURNS[turn])
    assert turn_to(back, depth) == turn
    assert turn_to(np.zeros((128, 96, 3), np.uint8), depth) is None
    for number in (1, 2):
        write_png(tmp_path / f"rgb/{number}.png", back)
        write_png(tmp_path / f"depth/{number}.png", depth.astype(np.uint16))
    refused(lambda: open_dataset(tmp_path, **FOLDER).load("1"), "96x128", "128x96", f'color_turned = "{turn}"')
    (tmp_path / "spatialviz.toml").write_text(f'color_turned = "{turn}"\n')
    assert np.array_equal(open_dataset(tmp_path, **FOLDER).load("1").rgb, rgb)


def test_a_file_of_several_cameras_is_not_guessed_from(tmp_path: Path) -> None:
    write_folder(tmp_path, [1, 2])
    one, other = {"fx": 60, "fy": 61, "ppx": 31.5, "ppy": 23.5}, {"fx": 50, "fy": 51, "ppx": 30.5, "ppy": 22.5}
    path = tmp_path / "intrinsics.json"
    path.write_text(json.dumps({"depth": one, "color": other}))
    refused(lambda: open_dataset(tmp_path, depth_scale=1000), "--intrinsics", "not read: intrinsics.json")
    path.write_text(json.dumps({"depth": one, "color": one}))
    assert np.allclose(open_dataset(tmp_path, depth_scale=1000).load("1").camera.K, K)
    matrices = "left:\n  camera_matrix: [60, 0, 31.5, 0, 61, 23.5, 0, 0, 1]\n"
    path = path.rename(tmp_path / "intrinsics.yaml")
    path.write_text(matrices + matrices.replace("left", "right").replace("60", "50"))
    refused(lambda: open_dataset(tmp_path, depth_scale=1000), "--intrinsics", "not read: intrinsics.yaml")


@pytest.mark.parametrize("name", ["a.mkv", "a.svo2", "a.sens"])
def test_captures_that_are_not_read_are_named_with_what_unpacks_them(tmp_path: Path, name: str) -> None:
    (tmp_path / name).write_bytes(b"1234")
    words = {"a.mkv": "azure_kinect_mkv_reader", "a.svo2": "svo_export", "a.sens": "SensReader"}[name]
    refused(lambda: open_dataset(tmp_path), name, words)
    refused(lambda: open_dataset(tmp_path / name), name, words)


def test_a_unit_in_words_and_depth_with_a_leading_axis(tmp_path: Path) -> None:
    made = truths(2)
    for number, truth in enumerate(made):
        write_png(tmp_path / f"rgb/{number}.png", truth.rgb)
        (tmp_path / "depth").mkdir(exist_ok=True)
        np.save(tmp_path / f"depth/{number}.npy", truth.millimetres[None])
    camera = {"cam_K": K.ravel().tolist(), "depth_scale": 1.0, "depth_unit": "millimetre"}
    (tmp_path / "camera.json").write_text(json.dumps(camera))
    frame = open_dataset(tmp_path).load("0")
    assert np.array_equal(frame.depth, made[0].depth)


def test_what_lies_above_several_datasets_is_named(tmp_path: Path) -> None:
    for name in ("one", "two"):
        write_folder(tmp_path / name, [1, 2])
    (tmp_path / "camera_params.json").write_text('{"fx": 60, "fy": 61, "x_offset": 31.5, "y_offset": 23.5}')
    opened, left_out = open_sources(tmp_path, browse=True)
    assert set(opened) == {"one", "two"}
    assert "camera" in left_out["camera_params.json"]
