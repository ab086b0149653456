"""The viewer's level axes and the plane that tells where up is."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scenes import Plane, angle_deg, camera_of, cast, up_of, upright

from pipeline.datasets import open_dataset
from pipeline.geometry import Camera, resolve_up, viewer_axes
from pipeline.geometry.level_plane import level_plane
from pipeline.geometry.viewer import IMAGE_UP, STEEP

ROLLS = (0.0, 10.0, -15.0)


@pytest.mark.parametrize("pitch", [0.0, 20.0, 35.0])
@pytest.mark.parametrize("roll", ROLLS)
def test_axes_are_level_and_right_is_right(pitch: float, roll: float) -> None:
    axes = viewer_axes(up_of(pitch, roll))
    np.testing.assert_allclose(axes.right, np.cross(axes.forward, axes.up), atol=1e-12)
    assert axes.right[0] > 0.9, "right is not on the right of the picture"
    assert axes.forward[2] > 0.8
    assert axes.forward @ axes.up == pytest.approx(0, abs=1e-12)
    assert np.rad2deg(axes.pitch) == pytest.approx(pitch)


def test_an_unrolled_camera_keeps_its_own_right() -> None:
    for pitch in (0, 20, 35, 60, -30):
        np.testing.assert_allclose(viewer_axes(up_of(pitch)).right, [1, 0, 0], atol=1e-12)


UPS = st.tuples(*[st.floats(-1, 1)] * 3).filter(lambda u: np.linalg.norm(u) > 0.1)


@given(UPS)
def test_any_up_gives_a_proper_rotation(up: tuple[float, float, float]) -> None:
    u = np.array(up) / np.linalg.norm(up)
    # The heading itself vanishes only where the image's up lies along a steep up vector; that cannot be.
    axes = viewer_axes(np.array(up))
    R = axes.R_level_camera
    np.testing.assert_allclose(R @ R.T, np.eye(3), atol=1e-9)
    assert np.linalg.det(R) == pytest.approx(1)
    assert np.linalg.det(axes.matrix) == pytest.approx(-1), "(right, up, forward) is left-handed"
    np.testing.assert_allclose(axes.up, u, atol=1e-12)
    heading = np.array([0, 0, 1.0])
    if abs(u[2]) <= STEEP:
        assert axes.forward @ heading >= 0


def test_the_level_frame_and_the_scalar_axes_differ_in_the_sign_of_up_only() -> None:
    axes = viewer_axes(up_of(25, 8))
    np.testing.assert_allclose(axes.matrix, np.diag([1, -1, 1]) @ axes.R_level_camera)


def test_looking_straight_down_the_top_of_the_image_is_forward() -> None:
    axes = viewer_axes(np.array([0, 0, -1.0]))
    np.testing.assert_allclose(axes.forward, IMAGE_UP, atol=1e-12)
    np.testing.assert_allclose(axes.right, [1, 0, 0], atol=1e-12)


def test_looking_straight_up_the_bottom_of_the_image_is_forward() -> None:
    axes = viewer_axes(np.array([0, 0, 1.0]))
    np.testing.assert_allclose(axes.forward, -IMAGE_UP, atol=1e-12)
    np.testing.assert_allclose(axes.right, [1, 0, 0], atol=1e-12)


@pytest.mark.parametrize("pitch", [69.9, 70.2, -69.9, -70.2])
def test_forward_does_not_jump_where_the_view_becomes_steep(pitch: float) -> None:
    there = viewer_axes(up_of(70 * np.sign(pitch)))
    np.testing.assert_allclose(viewer_axes(up_of(pitch)).forward, there.forward, atol=0.01)


# The level plane.

FLOOR, TABLE = Plane((0, 1, 0), 1.3), Plane((0, 1, 0), 0.5)
WALL = Plane((0, 0, 1), 2.5)


def noisy(depth: np.ndarray, sigma: float = 0.0012, seed: int = 0) -> np.ndarray:
    rng = np.random.default_rng(seed)
    noise = rng.normal(size=depth.shape) * sigma * (0.4 + depth**2)
    holes = rng.random(depth.shape) < 0.05
    return np.where((depth > 0) & ~holes, depth + noise, 0).astype(np.float32)


@pytest.mark.parametrize("pitch", [12.0, 20.0, 35.0, 42.0])
@pytest.mark.parametrize("roll", [0.0, 8.0])
def test_a_noisy_floor_gives_up_within_a_degree(pitch: float, roll: float) -> None:
    viewer = viewer_axes(up_of(pitch, roll))
    seen = cast(camera_of(640, 480, 540), [upright((0.3, 1.0, 2.5), (0.4, 0.6, 0.4), 30)], [FLOOR], viewer)
    found = level_plane(noisy(seen.depth), camera_of(640, 480, 540))
    assert found is not None
    assert angle_deg(found, viewer.up) < 1
    assert np.linalg.norm(found) == pytest.approx(1)


def test_a_table_gives_up_within_a_degree() -> None:
    viewer = viewer_axes(up_of(35))
    table = upright((0, 0.55, 1.2), (1.6, 0.05, 0.9))
    seen = cast(camera_of(), [table, upright((0.1, 0.45, 1.1), (0.1, 0.15, 0.1))], [Plane((0, 1, 0), 1.3)], viewer)
    found = level_plane(noisy(seen.depth), camera_of())
    assert found is not None
    assert angle_deg(found, viewer.up) < 1


@pytest.mark.parametrize("pitch", [0.0, 10.0, 30.0])
def test_a_wall_alone_gives_no_up(pitch: float) -> None:
    viewer = viewer_axes(up_of(pitch))
    seen = cast(camera_of(), [], [WALL], viewer)
    assert (seen.depth > 0).all()
    assert level_plane(noisy(seen.depth), camera_of()) is None


def test_a_wall_larger_than_the_floor_is_not_taken_for_it() -> None:
    viewer = viewer_axes(up_of(30))
    seen = cast(camera_of(), [], [Plane((0, 1, 0), 1.5), Plane((0, 0, 1), 1.9)], viewer)
    floor, wall = (seen.ids == 0).sum(), (seen.ids == 1).sum()
    assert wall > 1.5 * floor > 0, "the case says nothing"
    found = level_plane(noisy(seen.depth), camera_of())
    assert found is not None
    assert angle_deg(found, viewer.up) < 1


def test_no_depth_gives_no_up() -> None:
    camera = camera_of()
    assert level_plane(np.zeros((240, 320), np.float32), camera) is None
    # All of it out of the range in which depth is trusted.
    assert level_plane(np.full((240, 320), 30, np.float32), camera) is None


def test_the_same_depth_gives_the_same_up() -> None:
    depth = noisy(cast(camera_of(), [], [FLOOR, WALL], viewer_axes(up_of(20, 5))).depth)
    np.testing.assert_array_equal(level_plane(depth, camera_of()), level_plane(depth.copy(), camera_of()))


def test_up_comes_from_the_best_source_there_is() -> None:
    viewer = viewer_axes(up_of(30))
    floor = cast(camera_of(), [], [FLOOR], viewer).depth
    wall = cast(camera_of(), [], [WALL], viewer_axes(up_of(0))).depth
    declared = camera_of().with_up(np.array([0.1, -1, 0]), "imu")
    assert resolve_up(floor, declared) is declared
    unnamed = Camera(camera_of().K, 320, 240, up=np.array([0, -1, 0.1]))
    assert resolve_up(floor, unnamed).up_source == "declared"
    fitted = resolve_up(floor, camera_of())
    assert fitted.up is not None
    assert fitted.up_source == "plane"
    assert angle_deg(fitted.up, viewer.up) < 1
    assumed = resolve_up(wall, camera_of())
    assert assumed.up_source == "assumed"
    np.testing.assert_array_equal(assumed.up, IMAGE_UP)


# Real frames: the world's up, as each frame finds it for itself, must be one and the same.


def ups_in_world(root: Path, **facts: Any) -> dict[str, np.ndarray]:
    dataset = open_dataset(root, **facts)
    found = {}
    for frame_id in dataset.frame_ids:
        frame = dataset.load(frame_id)
        up = level_plane(frame.depth, frame.camera)
        assert up is not None, frame_id
        assert frame.camera.T_world_camera is not None
        found[frame_id] = frame.camera.T_world_camera[:3, :3] @ up
    return found


def test_two_frames_of_a_ycb_scene_agree_where_up_is(shared_data: Path) -> None:
    ups = ups_in_world(shared_data / "real" / "ycbv-bop")
    assert len(ups) == 6
    for scene in ("000000", "000001", "000002"):
        first, second = (up for frame_id, up in ups.items() if frame_id.startswith(scene))
        assert angle_deg(first, second) < 1.5


@pytest.mark.slow
def test_the_views_of_a_room_agree_where_up_is(shared_data: Path) -> None:
    kitchen = ups_in_world(shared_data / "real" / "7scenes-redkitchen")
    dining = ups_in_world(
        shared_data / "real" / "slambook-diningroom", intrinsics=(518, 519, 325.5, 253.5), depth_scale=1000
    )
    # The poses themselves are only good to a degree or two.
    for ups in (kitchen, dining):
        middle = np.median(list(ups.values()), axis=0)
        assert max(angle_deg(up, middle) for up in ups.values()) < 3
