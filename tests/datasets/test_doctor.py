"""Planted errors of unit, camera and poses are found, or it is said that they cannot be told; what mends is kept."""

from __future__ import annotations

import os
import shutil
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from dataset_writers import write_png
from pose_files import as_convention
from slow_cases import mostly_slow

from pipeline.answering import open_pipeline, relate_frames
from pipeline.datasets import (
    Examination,
    InMemoryDataset,
    apply,
    demo_path,
    examine,
    open_dataset,
    read_settings,
    write_settings,
)
from pipeline.datasets.doctor.examine import chosen_frames, examine_frames
from pipeline.datasets.plausible import camera_height, plausibility
from pipeline.datasets.settings import FILE_NAME
from pipeline.geometry import Frame, to_world
from pipeline.language import size_factor
from pipeline.synthetic import render_dataset
from pipeline.system import InputError

SUBJECTS = ("poses", "depth scale", "focal length", "principal point")


@pytest.fixture(scope="module")
def room() -> list[Frame]:
    """Three views of one room."""
    dataset = open_dataset(demo_path())
    return [dataset.load(frame_id) for frame_id in dataset.frame_ids if frame_id.startswith("000001/")]


def looked_at(frames: list[Frame]) -> Examination:
    dataset = InMemoryDataset(replace(frame, annotations=()) for frame in frames)
    return examine_frames(dataset, [dataset.load(i) for i in dataset.frame_ids], 1000.0)


def wrong(found: Examination) -> set[str]:
    return {opinion.about for opinion in found.wrong if opinion.about in SUBJECTS}


def test_nothing_is_wrong_with_a_sound_room(room: list[Frame]) -> None:
    found = looked_at(room)
    assert [found.of(about).state for about in SUBJECTS] == ["fine"] * 4
    assert not found.wrong
    assert found.hypotheses[0].words == "all as read"
    assert apply(found) is None


@pytest.mark.slow
@pytest.mark.parametrize(("factor", "right"), mostly_slow([(1.7, 1700.0), (5.0, 5000.0), (0.1, 100.0)], several=True))
def test_a_wrong_unit(room: list[Frame], factor: float, right: float) -> None:
    found = looked_at([replace(f, depth=f.depth * np.float32(factor)) for f in room])
    assert wrong(found) == {"depth scale"}
    assert found.mends["depth_scale"] == pytest.approx(right, rel=0.03)
    assert found.of("depth scale").option == f"--depth-scale {found.mends['depth_scale']:g}"


@pytest.mark.slow
@pytest.mark.parametrize("factor", mostly_slow([1.35, 0.75]))
def test_a_wrong_focal_length(room: list[Frame], factor: float) -> None:
    stretch = np.array([factor, factor, 1.0])[:, None]
    off = [replace(f, camera=replace(f.camera, K=f.camera.K * stretch)) for f in room]
    for frame, truth in zip(off, room, strict=True):
        frame.camera.K[:2, 2] = truth.camera.K[:2, 2]
    found = looked_at(off)
    assert wrong(found) == {"focal length"}
    assert found.mends["intrinsics"] == pytest.approx((460.8, 460.8, 319.5, 239.5), rel=0.03)


def test_a_swapped_principal_point(room: list[Frame]) -> None:
    off = [replace(f, camera=replace(f.camera, K=f.camera.K.copy())) for f in room]
    for frame in off:
        frame.camera.K[:2, 2] = frame.camera.K[1::-1, 2]
    found = looked_at(off)
    assert wrong(found) == {"principal point"}
    assert found.mends["intrinsics"] == pytest.approx((460.8, 460.8, 319.5, 239.5), rel=0.03)
    # One picture alone is enough for it: cameras have it in the middle.
    assert wrong(looked_at(off[:1])) == {"principal point"}


CONVENTIONS = ["world-to-camera opencv", "camera-to-world opengl", "world-to-camera ros"]


@pytest.mark.parametrize("convention", mostly_slow(CONVENTIONS))
def test_poses_of_another_convention(room: list[Frame], convention: str) -> None:
    off = []
    for frame in room:
        assert frame.camera.T_world_camera is not None
        T = as_convention(frame.camera.T_world_camera, convention)
        off.append(replace(frame, camera=replace(frame.camera, T_world_camera=T)))
    found = looked_at(off)
    assert wrong(found) == {"poses"}
    assert found.mends["poses"] == convention


def test_without_motion_nothing_is_called_wrong(room: list[Frame]) -> None:
    """The same view twice lands on itself whatever is believed of it."""
    twice = [room[0], replace(room[0], id="again")]
    found = looked_at([replace(f, depth=f.depth * np.float32(3.0)) for f in twice])
    assert not wrong(found)
    assert {found.of(about).state for about in ("poses", "depth scale", "focal length")} == {"unknown"}


def test_frames_without_poses_are_not_judged(room: list[Frame]) -> None:
    found = looked_at([replace(f, camera=replace(f.camera, T_world_camera=None)) for f in room])
    assert found.pairs == 0
    assert "poses" in found.of("depth scale").text
    assert {found.of(about).state for about in ("poses", "depth scale", "focal length")} == {"unknown"}


def test_sizes_of_known_things_tell_the_unit_of_one_frame(room: list[Frame]) -> None:
    """Millimetres that were read as 1/5000 m."""
    dataset = InMemoryDataset([replace(room[0], depth=room[0].depth / np.float32(5.0))])
    found = examine_frames(dataset, [dataset.load(room[0].id)], 5000.0)
    assert found.of("depth scale").state == "wrong"
    assert found.mends == {"depth_scale": 1000.0}
    assert "known classes" in found.of("depth scale").text


def test_poses_of_other_frames_are_not_explained_away(room: list[Frame]) -> None:
    turned = [
        replace(f, camera=replace(f.camera, T_world_camera=other.camera.T_world_camera))
        for f, other in zip(room, room[1:] + room[:1], strict=True)
    ]
    assert not wrong(looked_at(turned))


@pytest.mark.slow
def test_a_declared_up_that_level_planes_contradict(room: list[Frame]) -> None:
    off = []
    for frame in room:
        T = frame.camera.T_world_camera
        assert T is not None
        off.append(replace(frame, camera=frame.camera.with_up(T[:3, :3].T @ np.array([0.0, 1.0, 0.0]), "declared")))
    found = looked_at(off).of("up")
    assert (found.state, found.mend) == ("wrong", {"up": "world:0,0,1"})


@pytest.mark.slow
def test_poses_of_neighbours(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Six views of a room in a row, each with the pose of the next."""
    # Cameras are the best of few and not of many: choosing them costs most.
    monkeypatch.setattr("pipeline.synthetic.render.CANDIDATES", 4)
    render_dataset(tmp_path / "room", rooms=1, views=6, seed=3, width=320, height=240)
    dataset = open_dataset(tmp_path / "room")
    frames = [dataset.load(frame_id) for frame_id in dataset.frame_ids]
    late = [replace(f, camera=replace(f.camera, T_world_camera=n.camera.T_world_camera)) for f, n in pairwise(frames)]
    assert looked_at(frames).of("time").state == "fine"
    for number, frame in enumerate(late):
        write_png(tmp_path / f"late/color/{number}.png", frame.rgb)
        write_png(tmp_path / f"late/depth/{number}.png", np.rint(frame.depth * 1000).astype(np.uint16))
        (tmp_path / "late/pose").mkdir(exist_ok=True)
        np.savetxt(tmp_path / f"late/pose/{number}.txt", np.asarray(frame.camera.T_world_camera))
    K = frames[0].camera.K
    told: dict[str, Any] = {"intrinsics": (K[0, 0], K[1, 1], K[0, 2], K[1, 2]), "depth_scale": 1000}
    found = examine(tmp_path / "late", **told)
    assert not wrong(found)
    assert found.of("time").state == "wrong"
    assert found.of("time").evidence["shift"] == -1
    assert "1 place earlier" in found.of("time").text
    assert found.of("time").option == "pose_shift = -1 in spatialviz.toml"
    apply(found)
    mended = open_dataset(tmp_path / "late", **told)
    assert mended.load("0").camera.T_world_camera is None
    assert "-1 places on" in mended.load("0").notes[-1]
    for number in range(1, len(late)):
        pose = np.asarray(mended.load(str(number)).camera.T_world_camera)
        np.testing.assert_allclose(pose, np.asarray(frames[number].camera.T_world_camera), atol=1e-6)
    assert examine(tmp_path / "late", **told).of("time").state == "fine"


# Files


@pytest.fixture
def copy(tmp_path: Path) -> Path:
    """The first room of the demo, as a recording of one's own."""
    shutil.copytree(demo_path() / "000001", tmp_path / "000001")
    return tmp_path


@pytest.mark.slow
def test_what_mends_is_kept_and_mends(copy: Path) -> None:
    write_settings(copy, (320.0, 320.0, 319.5, 239.5), 10_000.0)
    (copy / FILE_NAME).write_text(f'name = "mine"\n{(copy / FILE_NAME).read_text()}\n[maker]\nwho = "me"\n')
    found = examine(copy)
    assert {o.about for o in found.wrong} == {"depth scale", "focal length"}
    assert apply(found) == copy / FILE_NAME
    settings = read_settings(copy)
    assert settings.name == "mine"
    assert "who =" in (copy / FILE_NAME).read_text()
    assert settings.depth_scale == pytest.approx(2000.0, rel=0.03)
    assert settings.intrinsics == pytest.approx((460.8, 460.8, 319.5, 239.5), rel=0.03)
    assert not {o.about for o in examine(copy).wrong}


def test_depth_that_readers_refuse(copy: Path) -> None:
    write_settings(copy, None, 1.0)
    found = examine(copy)
    assert found.mends["depth_scale"] == pytest.approx(2000.0, rel=0.03)


def test_a_folder_that_cannot_be_written_keeps_its_file(copy: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write_settings(copy, None, 10_000.0)
    before = (copy / FILE_NAME).read_bytes()

    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    found = examine(copy)
    monkeypatch.setattr(os, "replace", full)
    with pytest.raises((InputError, OSError)):
        apply(found)
    assert (copy / FILE_NAME).read_bytes() == before


def test_declared_conventions_are_read(copy: Path) -> None:
    before = open_dataset(copy).load("000001/000000").camera.T_world_camera
    told = open_dataset(copy, poses="world-to-camera opencv").load("000001/000000").camera.T_world_camera
    (copy / FILE_NAME).write_text('poses = "world-to-camera opencv"\n')
    after = open_dataset(copy).load("000001/000000").camera.T_world_camera
    assert before is not None
    assert after is not None
    np.testing.assert_allclose(after, np.linalg.inv(before), atol=1e-9)
    assert np.array_equal(after, np.asarray(told))


def test_a_declared_warp_is_read(copy: Path) -> None:
    before = open_dataset(copy).load("000001/000000")
    warp = (415, 415, 319.5, 239.5, -0.025, 0, 0)
    told = open_dataset(copy, registration=warp).load("000001/000000")
    (copy / FILE_NAME).write_text(f"registration = {list(warp)}\n")
    after = open_dataset(copy).load("000001/000000")
    assert np.array_equal(after.depth, told.depth)
    assert after.camera.fx == 415
    v, u = 200, 300
    z = before.depth[v, u]
    x = (u - 319.5) / 460.8 * z - 0.025
    assert after.depth[round((v - 239.5) * 415 / 460.8 + 239.5), round(415 * x / z + 319.5)] == pytest.approx(z, 0.01)


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ('poses = "upside down"', "no such pose convention"),
        ("registration = [1, 2, 3]", "registration must be 7 finite numbers"),
        ("registration = [0, 1, 1, 1, 0, 0, 0]", "focal lengths must be positive"),
    ],
)
def test_settings_that_cannot_be(copy: Path, text: str, problem: str) -> None:
    (copy / FILE_NAME).write_text(text)
    with pytest.raises(InputError, match=problem):
        open_dataset(copy)


def test_frames_of_a_long_recording_are_near_and_far(tmp_path: Path) -> None:
    """Twelve of a thousand: neighbours, and some hundreds apart."""
    for kind in ("color", "depth"):
        (tmp_path / kind).mkdir()
    for k in range(1000):
        for kind in ("color", "depth"):
            (tmp_path / kind / f"{k}.png").touch()
    rgb, depth = np.full((48, 64, 3), 90, np.uint8), np.full((48, 64), 1500, np.uint16)
    dataset = open_dataset(tmp_path, intrinsics=(60.0, 60.0, 31.5, 23.5), depth_scale=1000.0)
    asked: list[int] = []
    for kind, picture in (("color", rgb), ("depth", depth)):
        coded = cv2.imencode(".png", picture)[1].tobytes()
        for k in range(1000):
            (tmp_path / kind / f"{k}.png").write_bytes(coded)
    asked = sorted(int(frame.id) for frame in chosen_frames(dataset))
    gaps = np.diff(asked)
    assert 8 <= len(asked) <= 12
    assert gaps.min() <= 2
    assert gaps.max() >= 100


# One frame


def test_a_sound_frame_is_plausible(room: list[Frame]) -> None:
    assert [plausibility(frame) for frame in room] == [None] * len(room)


@pytest.mark.parametrize("factor", [5.0, 0.2])
def test_known_things_tell_a_wrong_unit(room: list[Frame], factor: float) -> None:
    for frame in room:
        found = plausibility(replace(frame, depth=frame.depth * np.float32(factor)))
        assert found is not None
        assert found.factor is not None
        assert 0.6 < found.factor / factor < 1.5
        assert "spatialviz doctor" in found.text


def test_a_floor_tells_a_wrong_unit_where_nothing_is_annotated(room: list[Frame]) -> None:
    for frame in room:
        bare = replace(frame, annotations=(), camera=replace(frame.camera, up=None, up_source=None))
        height, declared = camera_height(bare), camera_height(frame)
        assert plausibility(bare) is None
        if height is not None and declared is not None:
            assert height == pytest.approx(declared, rel=0.1)
        far = plausibility(replace(frame, annotations=(), depth=frame.depth * np.float32(5.0)))
        assert far is not None
        assert "too far for a room" in far.text


def test_a_few_things_of_odd_size_tell_nothing() -> None:
    assert size_factor(["mug", "chair", "unheard-of thing"], [0.7, 5.0, 3.0]) is None
    assert size_factor(["mug", "chair", "table", "sofa"], [0.1, 0.8, 9.0, 1.9]) is None
    found = size_factor(["mug", "chair", "table", "sofa"], [0.6, 4.5, 8.0, 9.0])
    assert found is not None
    assert found.low < 5 < found.high


# 7-Scenes: colour and depth are of two cameras


@pytest.mark.slow
def test_seven_scenes_is_registered(shared_data: Path, tmp_path: Path) -> None:
    root = tmp_path / "kitchen"
    shutil.copytree(shared_data / "real" / "7scenes-redkitchen", root)
    for path in (root, *root.iterdir()):
        path.chmod(0o755)
    assert "doctor" in " ".join(open_dataset(root).notes)  # pyright: ignore[reportAttributeAccessIssue]
    found = examine(root)
    assert [o.about for o in found.wrong] == ["registration"]
    figures = found.of("registration").evidence
    assert figures["edges"] < 0.4
    assert figures["edges_warped"] > 1.6 * figures["edges"]
    fx, *_ = found.mends["registration"]
    assert 515 < fx < 540
    apply(found)
    assert not examine(root).wrong
    spread = cup_spread(root, shared_data / "onnx" / "yolov8n_seg_480x640.onnx")
    assert len(spread) == 2
    assert max(spread) < 0.02


def cup_spread(root: Path, model: Path) -> list[float]:
    """Of each cup that is seen whole in three views or more: root mean square of its centres' distances, metres."""
    source = open_pipeline(root, detector="yolo-seg", model=model)
    centers: list[np.ndarray] = []
    for found in relate_frames(source, "all"):
        pose = source.dataset.load(found.frame_id).camera.T_world_camera
        for item in found.objects:
            quality, box = item.lifted.quality, item.lifted.box
            if item.label == "cup" and box is not None and quality.kept > 0.5 and not quality.touches_border:
                assert pose is not None
                centers.append(to_world(box.center, pose))
    clusters: list[list[np.ndarray]] = []
    for center in centers:
        near = [c for c in clusters if np.linalg.norm(np.median(c, axis=0) - center) < 0.15]
        (near[0] if near else clusters.append([]) or clusters[-1]).append(center)
    sound = [np.array(c) for c in clusters if len(c) >= 4]
    return [float(np.sqrt(((c - c.mean(axis=0)) ** 2).sum(axis=1).mean())) for c in sound]
