"""Cameras from above: distances and turns are those of the poses, however the world is turned."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pipeline.datasets import InMemoryDataset
from pipeline.datasets.frame_reports import camera_plan
from pipeline.geometry import Camera, Frame

K = np.array([[100.0, 0, 32], [0, 100.0, 24], [0, 0, 1]])


def rotation(seed: int) -> np.ndarray:
    q, r = np.linalg.qr(np.random.default_rng(seed).normal(size=(3, 3)))
    q = q * np.sign(np.diag(r))
    return q if np.linalg.det(q) > 0 else -q


def frame(name: str, T: np.ndarray | None, up: np.ndarray | None = None) -> Frame:
    camera = Camera(K, 64, 48, T)
    camera = camera if up is None or T is None else camera.with_up(T[:3, :3].T @ up, "declared")
    return Frame(name, np.zeros((48, 64, 3), np.uint8), np.ones((48, 64), np.float32), camera)


def level(x: float, y: float, height: float, yaw: float, world: np.ndarray) -> np.ndarray:
    """A camera that looks level along `yaw`, in a world that is turned by `world` (z was up)."""
    forward = np.array([np.cos(yaw), np.sin(yaw), 0.0])
    T = np.eye(4)
    T[:3, :3] = world @ np.stack([np.cross(forward, [0, 0, 1.0]), [0, 0, -1.0], forward], axis=1)
    T[:3, 3] = world @ np.array([x, y, height])
    return T


spots = st.lists(
    st.tuples(st.floats(-4, 4), st.floats(-4, 4), st.floats(0.5, 2), st.floats(-3.1, 3.1)), min_size=2, max_size=8
)


@given(spots, st.integers(0, 2**31), st.booleans())
def test_the_plan_is_the_level_part_of_the_poses(spots, seed, declared):
    world = rotation(seed)
    up = world[:, 2] if declared else None
    frames = [frame(f"a/{k}", level(x, y, z, yaw, world), up) for k, (x, y, z, yaw) in enumerate(spots)]
    plan = camera_plan(InMemoryDataset(frames), "a/0")
    assert plan is not None
    assert plan.frame_ids == tuple(f.id for f in frames)
    flat = np.array([[x, y] for x, y, _, _ in spots])
    look = np.array([[np.cos(yaw), np.sin(yaw)] for *_, yaw in spots])
    # A turn about up is all that may differ, and it is the same for all.
    d = flat - flat.mean(axis=0)
    as_complex, expected = (v[:, 0] + 1j * v[:, 1] for v in (plan.headings, look))
    turn = as_complex / expected
    np.testing.assert_allclose(turn, turn[0], atol=1e-6)
    turned = (d[:, 0] + 1j * d[:, 1]) * turn[0]
    np.testing.assert_allclose(plan.positions, np.stack([turned.real, turned.imag], axis=1), atol=1e-6)


def test_scenes_and_frames_without_poses_stay_out():
    here, there = np.eye(4), np.eye(4)
    there[0, 3] = 1.0
    frames = [frame("a/0", here), frame("a/1", there), frame("b/0", here), frame("b/1", None), frame("c/0", None)]
    data = InMemoryDataset(frames)
    plan = camera_plan(data, "a/1")
    assert plan is not None
    assert plan.scene == "a"
    assert plan.frame_ids == ("a/0", "a/1")
    assert np.linalg.norm(plan.positions[0] - plan.positions[1]) == pytest.approx(1.0)
    assert camera_plan(data, "b/0") is None
    assert camera_plan(data, "c/0") is None


def test_a_long_scene_is_thinned_and_keeps_the_frame_that_is_shown():
    frames = []
    for k in range(50):
        T = np.eye(4)
        T[0, 3] = k / 10
        frames.append(frame(f"a/{k}", T))
    read: list[str] = []
    data = InMemoryDataset(frames)

    def load_pose(frame_id: str) -> np.ndarray | None:
        read.append(frame_id)
        return data.load(frame_id).camera.T_world_camera

    data.load_pose = load_pose  # type: ignore[attr-defined]
    plan = camera_plan(data, "a/7", most=5)
    assert plan is not None
    assert "a/7" in plan.frame_ids
    assert len(plan.frame_ids) <= 6
    assert set(read) == set(plan.frame_ids)
    odd = camera_plan(data, "a/7", most=2, also=["a/3", "b/0"])
    assert odd is not None
    assert "a/3" in odd.frame_ids
    assert len(odd.frame_ids) == 4
