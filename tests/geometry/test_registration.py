"""The warp between a depth camera and a colour camera, and what pose files may mean by their matrices."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from pose_files import as_convention
from scenes import random_rotation

from pipeline.datasets import demo_path, open_dataset
from pipeline.geometry import (
    CONVENTIONS,
    STANDARD,
    Camera,
    Outlines,
    Registration,
    check_convention,
    estimate_warp,
    intrinsics,
    lift_pixels,
    project,
    registered,
    standard_poses,
    to_world,
)
from pipeline.geometry.registration import mean_known
from pipeline.system import InputError


def agreement(outlines: Outlines, warp: Registration) -> float:
    """Share, 0..1, of depth outlines on edges of colour under a warp, the mean over regions."""
    return mean_known(outlines.by_region(outlines.near(warp)))


def rigid(rng: np.random.Generator) -> np.ndarray:
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = random_rotation(rng), rng.normal(size=3)
    return T


def rotation_of(q: np.ndarray) -> np.ndarray:
    """Of a unit quaternion x y z w, by rotating the axes: v + 2 w (q x v) + 2 q x (q x v)."""
    axes, v = np.eye(3), q[:3]
    return np.stack([a + 2 * q[3] * np.cross(v, a) + 2 * np.cross(v, np.cross(v, a)) for a in axes], axis=1)


# What pose files mean


@pytest.mark.parametrize("convention", CONVENTIONS)
def test_a_convention_and_back_is_the_pose(convention: str) -> None:
    rng = np.random.default_rng(0)
    poses = np.stack([rigid(rng) for _ in range(20)])
    there = as_convention(poses, convention)
    np.testing.assert_allclose(standard_poses(there, convention), poses, atol=1e-12)
    assert (np.abs(there - poses).max() > 0.1) == (convention != STANDARD)


def test_conventions_by_hand() -> None:
    rng = np.random.default_rng(1)
    T = rigid(rng)
    np.testing.assert_allclose(standard_poses(np.linalg.inv(T), "world-to-camera opencv"), T, atol=1e-12)
    # OpenGL's camera looks along its own -z, and its y points up the picture.
    np.testing.assert_allclose(standard_poses(T, "camera-to-world opengl")[:3, 2], -T[:3, 2], atol=1e-12)
    np.testing.assert_allclose(standard_poses(T, "camera-to-world opengl")[:3, 1], -T[:3, 1], atol=1e-12)
    # A ROS body looks along its x, and its z points up.
    np.testing.assert_allclose(standard_poses(T, "camera-to-world ros")[:3, 2], T[:3, 0], atol=1e-12)
    np.testing.assert_allclose(standard_poses(T, "camera-to-world ros")[:3, 1], -T[:3, 2], atol=1e-12)


def test_a_quaternion_that_was_read_from_the_wrong_end() -> None:
    rng = np.random.default_rng(2)
    for _ in range(20):
        q = rng.normal(size=4)
        q /= np.linalg.norm(q)
        x, y, z, w = q
        read = np.eye(4)
        read[:3, :3] = rotation_of(np.array([w, x, y, z]))
        found = standard_poses(read, "camera-to-world opencv wxyz")
        np.testing.assert_allclose(found[:3, :3], rotation_of(q), atol=1e-9)


def test_an_unknown_convention_is_one_clear_error() -> None:
    with pytest.raises(InputError, match=r"no such pose convention.*world-to-camera opencv"):
        check_convention("camera-to-world blender")


# The warp

CAMERA = Camera(intrinsics(300.0, 300.0, 159.5, 119.5), 320, 240, np.eye(4))
WARP = Registration(270.0, 270.0, 158.0, 121.0, -0.03, 0.01, 0.02)


def test_warped_depth_lies_where_the_colour_camera_sees_it() -> None:
    depth = np.full((240, 320), 2.0, np.float32)
    warped, camera = registered(depth, CAMERA, WARP)
    assert np.isclose(warped[warped > 0], 2.02).all()
    corner = np.array([[(0 - 159.5) / 300 * 2 - 0.03, (0 - 119.5) / 300 * 2 + 0.01, 2.02]])
    u, v = np.rint(project(corner, camera)[0]).astype(int)
    assert warped[v, u] > 0
    assert (warped[: v - 1] == 0).all()
    assert (warped[:, : u - 1] == 0).all()
    # No pinholes inside, though pixels fall between pixels.
    assert (warped[v + 2 : 200, u + 2 : 280] > 0).all()


def test_the_nearer_surface_hides_the_farther() -> None:
    depth = np.full((240, 320), 3.0, np.float32)
    depth[80:160, 120:200] = 1.0
    warped, _ = registered(depth, CAMERA, WARP)
    u, v, _ = (round(float(c[0])) for c in WARP.pixels(np.array([160.0]), np.array([120.0]), np.array([1.0]), CAMERA))
    assert np.isclose(warped[v, u], 1.02)
    assert np.isclose(np.median(warped[v - 30 : v + 30, u - 30 : u + 30]), 1.02)


def test_the_pose_moves_with_the_camera() -> None:
    rng = np.random.default_rng(3)
    T = rigid(rng)
    depth = np.full((240, 320), 2.0, np.float32)
    camera = Camera(CAMERA.K, 320, 240, T)
    warped, moved = registered(depth, camera, WARP)
    v, u = np.nonzero(warped)
    assert moved.T_world_camera is not None
    after = to_world(lift_pixels(warped[v, u], moved, v, u), moved.T_world_camera)
    # They lie on the plane of the depth camera's z = 2 in its own world.
    depths = (after - T[:3, 3]) @ T[:3, 2]
    np.testing.assert_allclose(depths, 2.0, atol=1e-4)


def test_a_focal_length_of_zero_is_one_clear_error() -> None:
    with pytest.raises(InputError, match="focal lengths must be positive"):
        Registration(0.0, 500.0, 320.0, 240.0)


@pytest.mark.slow
@pytest.mark.parametrize("warp", [(1.09, 0.025, 0.005), (0.94, -0.03, 0.0)])
def test_a_planted_warp_is_estimated(warp: tuple[float, float, float]) -> None:
    dataset = open_dataset(demo_path())
    frames = [dataset.load(frame_id) for frame_id in dataset.frame_ids[:6]]
    moved = []
    for frame in frames:
        own = frame.camera
        depth, camera = registered(
            frame.depth, own, Registration(own.fx * warp[0], own.fy * warp[0], own.cx, own.cy, *warp[1:])
        )
        moved.append(replace(frame, depth=depth, camera=camera))
    outlines, plain = Outlines.of(moved), Outlines.of(frames)
    told = Registration.none(outlines.camera)
    found = estimate_warp(outlines).warp
    best = agreement(plain, Registration.none(plain.camera))
    assert agreement(outlines, told) < 0.75 * best
    assert agreement(outlines, found) > 0.9 * best
    # The warp back, where things are: at two and three metres, within two pixels.
    u, v = (c.ravel().astype(float) for c in np.meshgrid(np.arange(80, 640, 160), np.arange(60, 480, 120)))
    own = plain.camera
    truth = Registration(own.fx, own.fy, own.cx, own.cy, -warp[1], -warp[2])
    for z in (2.0, 3.0):
        there, right = (w.pixels(u, v, np.full(len(u), z), outlines.camera) for w in (found, truth))
        assert np.median(np.hypot(there[0] - right[0], there[1] - right[1])) < 2.0
