"""The dataset readers: exact round trips, hostile input, and the real datasets."""

from __future__ import annotations

import json
import os
import pickle
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from dataset_writers import (
    HEIGHT,
    WIDTH,
    random_rotation,
    write_bop,
    write_folder,
)
from hypothesis import given, settings
from hypothesis import strategies as st
from reader_checks import FOLDER, MODELS, refused

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
from pipeline.datasets.files import natural
from pipeline.system import plugins

# Opening, naming, settings


def in_parts(name: str) -> tuple[list[tuple[int, int, str]], str]:
    parts = re.findall(r"[0-9]+|[^0-9]+", name)
    return [(0, int(p), "") if p[0].isascii() and p[0].isdigit() else (1, 0, p) for p in parts], name


@given(st.lists(st.from_regex(r"[ -.a-cA-C_0-9\u00e9\u0661]{0,12}", fullmatch=True), max_size=30))
def test_names_stand_in_the_order_of_their_numbers(names: list[str]) -> None:
    assert sorted(names, key=natural) == sorted(names, key=in_parts)
    assert sorted(["f10", "f2", "f02", "f2b", "f"], key=natural) == ["f", "f02", "f2", "f2b", "f10"]


def test_what_cannot_be_opened_is_told(tmp_path: Path) -> None:
    refused(lambda: open_dataset(tmp_path / "absent"), "no such dataset", "absent")
    (tmp_path / "file").write_text("x")
    refused(lambda: open_dataset(tmp_path / "file"), "a file is no dataset")
    (tmp_path / "file").unlink()
    refused(lambda: open_dataset(tmp_path), "the folder is empty", "color/", "depth/")
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
            repr(key),
            f"the index {index}, which is {dataset.frame_ids[index]}",
            f"{key}/000000",
            f"or {index} for",
        )
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


@settings(max_examples=30, deadline=None)
@given(
    numbers=st.tuples(*[st.floats(1e-6, 1e6)] * 5),
)
def test_settings_keep_every_digit(tmp_path_factory: pytest.TempPathFactory, numbers: tuple[float, ...]) -> None:
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
        ("depth_scale = 1e308", ["depth_scale must be a finite number; got 1e+308; expected up to 1e12"]),
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


@settings(max_examples=30, deadline=None)
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


def test_a_plugin_opens_its_own_format_before_any_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write_folder(tmp_path, [1])
    (tmp_path / "mine.txt").touch()
    opened: list[Settings] = []

    def open_mine(root: Path, given_settings: Settings) -> Any:
        opened.append(given_settings)
        return "mine"

    mine = DatasetFormat("mine", "mine: mine.txt", lambda root: (root / "mine.txt").exists(), open_mine)
    points = [_Point(ImportError("no such module")), _Point(42), _Point(mine)]
    monkeypatch.setattr(plugins, "entry_points", lambda group: points if group == "spatialviz.datasets" else [])
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
    refused(lambda: open_dataset(root, intrinsics=(518, 519, 325.5, 253.5), depth_scale=1).load("1"), "wrong unit")


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
        rays = np.stack([(u - a.camera.cx) / a.camera.fx, (v - a.camera.cy) / a.camera.fy, np.ones_like(z)], -1)
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
