"""Kinds of depth, mirrored pictures, turned depth maps and values that mean nothing are named, posed or alone."""

from __future__ import annotations

import os
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from benchmarks.doctor_plants import Planted

from pipeline.datasets import InMemoryDataset, apply, demo_path, examine, open_dataset, read_settings
from pipeline.datasets.doctor.examine import Examination, chosen_frames, examine_frames
from pipeline.datasets.doctor.planes import flatness, square_focals
from pipeline.datasets.meant import as_meant, depth_of, laid_over, mirrored_frame, ray_lengths
from pipeline.datasets.settings import Settings, write_settings
from pipeline.geometry import Camera, Frame, intrinsics
from pipeline.system import InputError

FIELD = Path(os.environ.get("SPATIALVIZ_SHARED", "../shared")) / "data" / "field"


@pytest.fixture(scope="module")
def room() -> list[Frame]:
    """Three views of one room."""
    dataset = open_dataset(demo_path())
    ids = [frame_id for frame_id in dataset.frame_ids if frame_id.startswith("000001/")]
    return [replace(dataset.load(frame_id), annotations=()) for frame_id in ids]


def alone(frame: Frame) -> Frame:
    return replace(frame, camera=Camera(frame.camera.K, frame.width, frame.height))


def looked_at(frames: list[Frame]) -> Examination:
    dataset = InMemoryDataset(frames)
    return examine_frames(dataset, chosen_frames(dataset), 1000.0)


@pytest.mark.parametrize(
    ("planted", "mends"),
    [
        (Planted("depth kind", "distance"), {"depth_is": "distance"}),
        (Planted("depth map", "180"), {"depth_turned": "180"}),
        (Planted("depth map", "top-bottom"), {"depth_turned": "top-bottom"}),
        (Planted("missing depth", 65.535), {"depth_nothing": 65535.0}),
    ],
)
def test_one_thing_is_called_wrong_and_mended(room: list[Frame], planted: Planted, mends: dict[str, object]) -> None:
    most_missing = max(room, key=lambda frame: int((frame.depth == 0).sum()))
    for frames in (room, [alone(most_missing)]):
        found = looked_at(planted.read(frames))
        assert {opinion.about for opinion in found.wrong} == {planted.about}
        assert found.mends == mends
        assert all(np.allclose(a.depth, b.depth, rtol=1e-4) for a, b in zip(found.mended, frames, strict=True))


def test_poses_are_not_blamed_for_what_depth_explains(room: list[Frame]) -> None:
    """Distances and poses of other places: nothing lands, and planes still tell what depth is."""
    rng = np.random.default_rng(3)
    moved = []
    for frame in room:
        T = np.array(frame.camera.T_world_camera)
        T[:3, 3] += rng.normal(0, 1.5, 3)
        moved.append(replace(frame, camera=replace(frame.camera, T_world_camera=T)))
    assert "are the poses of other frames" in looked_at(moved).of("poses").text
    found = looked_at(Planted("depth kind", "distance").read(moved))
    assert {opinion.about for opinion in found.wrong} == {"depth kind"}
    assert "are the poses of other frames" not in found.of("poses").text


def test_inverse_depth_is_mended_with_its_unit(room: list[Frame]) -> None:
    found = looked_at([replace(f, depth=4 * f.depth) for f in Planted("depth kind", "inverse").read(room)])
    assert {opinion.about for opinion in found.wrong} == {"depth kind"}
    assert found.mends["depth_is"] == "inverse"
    assert found.mends["depth_scale"] == pytest.approx(4000, rel=0.02)
    assert np.allclose(found.mended[0].depth, room[0].depth, rtol=0.02)


@pytest.mark.parametrize("way", ["left-right", "top-bottom"])
def test_mirrored_pictures_are_named_and_a_person_decides(room: list[Frame], way: str) -> None:
    """Poses of a left-handed world land alike, and exchange no sides of the pictures."""
    found = looked_at(Planted("pictures", way).read(room))
    assert {opinion.about for opinion in found.wrong} == {"pictures"}
    assert not found.mends
    assert "left-handed" in (found.of("pictures").option or "")
    assert "text in a picture" in looked_at([alone(room[0])]).of("pictures").text


def test_a_principal_point_from_the_other_side(room: list[Frame]) -> None:
    off = []
    for frame in room:
        K = frame.camera.K - [[0, 0, 100], [0, 0, 50], [0, 0, 0]]
        part = replace(frame.camera, K=K, width=540, height=430)
        off.append(replace(frame, rgb=frame.rgb[50:, 100:].copy(), depth=frame.depth[50:, 100:].copy(), camera=part))
    found = looked_at(Planted("principal point", "other side").read(off))
    assert {opinion.about for opinion in found.wrong} == {"principal point"}
    assert found.mends["intrinsics"][2:] == pytest.approx((219.5, 189.5), abs=1)


def test_a_sound_room_and_a_flat_wall_raise_no_alarm(room: list[Frame]) -> None:
    assert not looked_at(room).wrong
    assert looked_at([alone(room[1])]).of("depth kind").state == "fine"
    # A wall seen head on is farthest, of one value, and surface.
    wall = replace(room[0], depth=np.where(np.arange(480)[:, None] < 300, 2.0, 1.4).repeat(640, 1).astype(np.float32))
    assert looked_at([alone(wall)]).of("missing depth").state == "fine"


def test_planes_bend_under_a_wrong_kind_of_depth_whatever_the_focal_length() -> None:
    """A floor and two walls, drawn exactly: 1/z is affine, and three square planes tell the focal length."""
    K = intrinsics(300, 300, 159.5, 119.5)
    v, u = np.mgrid[:240, :320]
    rays = np.stack([(u - 159.5) / 300, (v - 119.5) / 300, np.ones(u.shape)], axis=-1)
    turn = np.deg2rad([40.0, -25.0])
    yaw = np.array([[np.cos(turn[0]), 0, np.sin(turn[0])], [0, 1, 0], [-np.sin(turn[0]), 0, np.cos(turn[0])]])
    pitch = np.array([[1, 0, 0], [0, np.cos(turn[1]), -np.sin(turn[1])], [0, np.sin(turn[1]), np.cos(turn[1])]])
    normals = np.eye(3) @ yaw @ pitch
    across = rays @ normals.T
    depth = np.where(across > 1e-3, [2.0, 1.1, 2.2] / np.maximum(across, 1e-3), 99.0).min(axis=-1).astype(np.float32)
    frame = Frame("a", np.random.default_rng(0).integers(0, 255, (240, 320, 3), np.uint8), depth, Camera(K, 320, 240))
    flat = np.nanmean(flatness(frame), axis=0)
    assert flat[0] > flat[1] + 0.2
    bent = replace(frame, depth=(depth * ray_lengths(K, depth.shape)).astype(np.float32))
    assert np.nanmean(flatness(bent), axis=0)[1] == pytest.approx(flat[0], abs=0.02)
    short = replace(frame, camera=Camera(intrinsics(240, 240, 159.5, 119.5), 320, 240))
    told = square_focals(short)
    assert len(told) == 3
    assert np.exp(told[:, 0]) == pytest.approx(1.25, rel=0.02)
    found = looked_at([short]).of("focal length")
    assert (found.state, found.mend) == ("wrong", {})
    assert found.evidence["factor"] == pytest.approx(1.25, rel=0.02)
    assert looked_at([frame]).of("focal length").state == "fine"


def test_what_is_meant_is_undone(room: list[Frame]) -> None:
    frame = room[0]
    assert np.array_equal(mirrored_frame(mirrored_frame(frame, "left-right"), "left-right").depth, frame.depth)
    square = frame.depth[:, :480]
    assert np.array_equal(laid_over(np.rot90(square, -1), "90"), square)
    assert np.array_equal(laid_over(laid_over(square, "270"), "90"), square)
    with pytest.raises(InputError, match="square"):
        laid_over(frame.depth, "90")
    assert np.allclose(
        depth_of(depth_of(frame.depth, frame.camera.K, "inverse"), frame.camera.K, "inverse"), frame.depth
    )
    assert as_meant(frame, {}) is frame


@pytest.mark.parametrize(
    "wrong", [{"depth_is": "disparity"}, {"mirrored": True}, {"depth_turned": 90}, {"depth_nothing": 0}]
)
def test_settings_that_cannot_be_are_refused(wrong: dict[str, object]) -> None:
    with pytest.raises(InputError):
        Settings(**wrong)  # type: ignore[arg-type]


def copied(name: str, to: Path) -> Path:
    (found,) = FIELD.glob(f"{name}-*") if FIELD.is_dir() else (None,)
    if found is None:
        pytest.skip("the field inputs are not here")
    return Path(shutil.copytree(found, to / "copy"))


def test_distance_of_the_field_is_kept_and_read(tmp_path: Path) -> None:
    """Hypersim (apple/ml-hypersim#9) and others store the distance to the camera."""
    path = copied("08", tmp_path)
    found = examine(path)
    assert {opinion.about for opinion in found.wrong} == {"depth kind"}
    apply(found)
    assert read_settings(path).depth_is == "distance"
    assert not examine(path).wrong


def test_a_mirrored_kinect_of_the_field(tmp_path: Path) -> None:
    """libfreenect2#172: colour and depth are mirrored, the poses are not."""
    path = copied("30", tmp_path)
    assert {opinion.about for opinion in examine(path).wrong} == {"pictures"}
    write_settings(path, None, None, mirrored="left-right")
    assert not examine(path).wrong
    first = open_dataset(path)
    masks = [a.mask for a in first.load(first.frame_ids[0]).annotations]
    assert all(mask is not None and mask.shape == (240, 320) for mask in masks)


def test_saturated_pixels_of_the_field_are_no_surface(tmp_path: Path) -> None:
    path = copied("12", tmp_path)
    found = examine(path)
    if found.wrong:
        apply(found)
    dataset = open_dataset(path)
    assert all(dataset.load(i).depth.max() < 20 for i in dataset.frame_ids)
    assert not examine(path).wrong
