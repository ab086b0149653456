"""Fitting boxes to points."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from lifting_checks import LEVEL, SEEDS
from scenes import filled_cloud, random_rotation, solid, up_of, upright

from pipeline.geometry import Box3D, canonicalised, extents_of, iou_3d, pca_box, viewer_axes
from pipeline.geometry.fitting import AXIS_RELABELLINGS, gravity_box
from pipeline.geometry.lifting import fit_box

# Fitting.


@given(SEEDS, st.integers(1, 400), st.integers(1, 4))
def test_extents_are_numpys_percentiles(seed: int, n: int, columns: int) -> None:
    x = np.random.default_rng(seed).normal(size=(n, columns)) * 3
    before = x.copy()
    lo, hi = extents_of(x)
    np.testing.assert_allclose(np.stack([lo, hi]), np.percentile(x, [1, 99], axis=0), atol=1e-12)
    np.testing.assert_array_equal(x, before)
    single = extents_of(x.astype(np.float32))
    np.testing.assert_allclose(np.stack(single), np.percentile(x, [1, 99], axis=0), atol=1e-5)


@pytest.mark.parametrize("yaw", [0.0, 20.0, -35.0, 44.0, 60.0, 90.0, 170.0])
@pytest.mark.parametrize("pitch", [0.0, 25.0])
def test_a_turned_upright_box_stays_itself(yaw: float, pitch: float) -> None:
    viewer = viewer_axes(up_of(pitch, 7))
    level = upright((0.2, 0.5, 2.0), (0.9, 0.5, 0.3), yaw)
    points = filled_cloud(level, np.random.default_rng(1)) @ viewer.R_level_camera
    box, confidence = gravity_box(points, viewer)
    found = Box3D(viewer.R_level_camera @ box.center, viewer.R_level_camera @ box.R, box.size)
    np.testing.assert_allclose(found.center, level.center, atol=0.01)
    # The 1st to the 99th percentile of a uniform box is 98 % of its length.
    np.testing.assert_allclose(np.sort(found.size), np.sort(level.size * 0.98), atol=0.012)
    np.testing.assert_allclose(found.R[:, 1], [0, 1, 0], atol=1e-9)
    turned = np.rad2deg(np.arctan2(found.R[0, 2], found.R[0, 0]))
    assert abs((turned - yaw + 45) % 90 - 45) < 1.5
    assert abs(turned) <= 45 + 1e-6
    assert iou_3d(found, level) > 0.9
    assert confidence == pytest.approx(1 - 0.3**2 / 0.9**2, abs=0.03)


def test_a_turned_box_reads_width_height_depth() -> None:
    box, _ = gravity_box(filled_cloud(upright((0, 0, 2), (1.0, 0.2, 0.5), 10), np.random.default_rng(0)), LEVEL)
    np.testing.assert_allclose(box.size, np.array([1.0, 0.2, 0.5]) * 0.98, atol=0.012)


def test_the_yaw_of_a_square_means_nothing() -> None:
    _, confidence = gravity_box(filled_cloud(upright((0, 0, 2), (0.5, 1.5, 0.5)), np.random.default_rng(0)), LEVEL)
    assert 0 <= confidence < 0.05


@pytest.mark.parametrize("seed", range(5))
def test_the_pca_box_finds_a_box_in_any_attitude(seed: int) -> None:
    rng = np.random.default_rng(seed)
    truth = Box3D(rng.uniform(-1, 1, 3), random_rotation(rng), np.array([1.0, 0.6, 0.3]))
    raw, confidence = pca_box(filled_cloud(truth, rng))
    assert iou_3d(raw, truth) > 0.88
    assert (np.diff(raw.size) < 0).all(), "the paper's axes fall in variance"
    assert confidence == pytest.approx(1 - 0.36, abs=0.04)
    renamed, _ = pca_box(filled_cloud(truth, np.random.default_rng(seed)), viewer_axes(up_of(20)))
    assert iou_3d(renamed, truth) > 0.88
    same, _ = pca_box(filled_cloud(truth, rng), None)
    assert np.linalg.det(same.R) == pytest.approx(1)


@pytest.mark.parametrize("points", [np.ones((1, 3)), np.ones((5, 3)), np.array([[0, 0, 1], [0, 0, 1.5]])])
@pytest.mark.parametrize("mode", ["gravity", "pca", "pca-raw"])
def test_a_few_points_still_have_a_box(points: np.ndarray, mode) -> None:
    box, confidence = fit_box(points.astype(np.float32), LEVEL, mode)
    assert box is not None
    np.testing.assert_allclose(box.center, points.mean(axis=0), atol=1e-6)
    assert 0 <= confidence <= 1


def test_the_axes_can_be_renamed_in_24_proper_ways() -> None:
    assert AXIS_RELABELLINGS.shape == (24, 3, 3)
    np.testing.assert_allclose(np.linalg.det(AXIS_RELABELLINGS), 1)
    assert len({M.tobytes() for M in AXIS_RELABELLINGS + 0.0}) == 24
    flat = [M.ravel().tolist() for M in AXIS_RELABELLINGS]
    assert flat == sorted(flat)


@given(SEEDS)
def test_the_canonical_box_is_the_same_solid_with_the_axes_nearest_to_its_frame(seed: int) -> None:
    rng = np.random.default_rng(seed)
    box = Box3D(rng.normal(size=3), random_rotation(rng), rng.uniform(0.1, 2, 3))
    canonical = canonicalised(box)
    np.testing.assert_allclose(solid(canonical), solid(box), atol=1e-6)
    traces = [np.trace(box.R @ M.T) for M in AXIS_RELABELLINGS]
    assert np.trace(canonical.R) == pytest.approx(max(traces), abs=1e-9)
    assert np.rad2deg(np.arccos(np.clip((np.trace(canonical.R) - 1) / 2, -1, 1))) <= 62.8
    again = canonicalised(canonical)
    np.testing.assert_allclose(again.R, canonical.R, atol=1e-12)
    np.testing.assert_array_equal(again.size, canonical.size)
    for M in AXIS_RELABELLINGS:
        other = canonicalised(Box3D(box.center, box.R @ M.T, np.abs(M) @ box.size))
        np.testing.assert_allclose(other.R, canonical.R, atol=1e-9)
        np.testing.assert_allclose(other.size, canonical.size, atol=1e-9)
