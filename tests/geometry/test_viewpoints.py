"""From where a frame is looked at: what must be in view is."""

from __future__ import annotations

import numpy as np
import pytest
from scenes import camera_of

from pipeline.geometry import viewpoint
from pipeline.geometry.cloud import NEAREST, NEAREST_SPACINGS, fitting_viewpoint, nearest_distance, stride_of

POINTS = np.random.default_rng(1).uniform([-1, 1, -0.6], [1, 3, 0.4], (3000, 3))
CAMERA, LEVEL = camera_of(), np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]])


def seen(points: np.ndarray, eye: np.ndarray, look: np.ndarray, fov: float, aspect: float) -> np.ndarray:
    """Which of the points (N, 3) a view shows: (N,) bool."""
    forward = (look - eye) / np.linalg.norm(look - eye)
    right = np.cross(forward, [0, 0, 1.0])
    right /= np.linalg.norm(right)
    x, y, z = ((points - eye) @ np.stack([right, np.cross(right, forward), forward]).T).T
    tangent = np.tan(fov / 2)
    return (z > 0) & (np.abs(x) <= z * tangent * aspect) & (np.abs(y) <= z * tangent)


@pytest.mark.parametrize("aspect", [0.5, 1.3, 2.4])
@pytest.mark.parametrize("kind", ["orbit", "pair"])
def test_nearly_all_is_in_view_whatever_the_shape_of_the_page(kind: str, aspect: float) -> None:
    shown = seen(POINTS, *viewpoint(kind, POINTS, LEVEL, CAMERA, aspect), aspect)
    assert shown.mean() > 0.97


def test_a_pair_is_seen_whole_from_no_nearer_than_half_a_metre() -> None:
    pair = np.array([[0.2, 2.0, 0.0], [0.3, 2.1, 0.1]])
    eye, look, fov = viewpoint("pair", POINTS, LEVEL, CAMERA, 1.3, pair)
    assert seen(pair, eye, look, fov, 1.3).all()
    assert np.linalg.norm(eye - look) >= NEAREST - 1e-9
    assert np.linalg.norm(eye - look) < np.linalg.norm(np.subtract(*fitting_viewpoint(POINTS, 1.3)[:2]))


@pytest.mark.parametrize("away", [0.5, 2.0, 6.0])
def test_points_are_never_seen_so_near_that_they_come_apart(away: float) -> None:
    small = np.array([[0.0, away, 0.0], [0.05, away, 0.05]])
    eye, look, fov = viewpoint("pair", POINTS, LEVEL, CAMERA, 1.3, small)
    distance = float(np.linalg.norm(eye - look))
    spacing = stride_of(CAMERA) * away / CAMERA.fx
    assert distance >= max(NEAREST, NEAREST_SPACINGS * spacing) - 1e-6
    assert distance >= nearest_distance(small, CAMERA) - 1e-6
    # In pixels of a view of 800 rows: less than the size that the page allows a point.
    assert spacing / distance * 400 / np.tan(fov / 2) <= 4


def test_the_sensors_view_holds_its_picture_and_stands_where_it_stood() -> None:
    eye, look, fov = viewpoint("sensor", POINTS, LEVEL, CAMERA, 1.3)
    assert np.linalg.norm(eye) < 0.02
    np.testing.assert_allclose(look / np.linalg.norm(look), [0, 1, 0], atol=1e-9)
    assert fov >= 2 * np.arctan(CAMERA.height / 2 / CAMERA.fy)
    nothing = viewpoint("top", np.zeros((0, 3)), LEVEL, CAMERA, 1.3)
    np.testing.assert_allclose(nothing[1], [0, 2, 0], atol=1e-9)


def test_from_above_one_looks_down_at_the_middle() -> None:
    eye, look, _ = viewpoint("top", POINTS, LEVEL, CAMERA, 1.3)
    assert eye[2] > POINTS[:, 2].max()
    np.testing.assert_allclose(look[:2], [0, 2], atol=0.1)


@pytest.mark.parametrize("aspect", [0.8, 1.36, 2.0])
@pytest.mark.parametrize("covered", [(0.33, 0.36), (0.44, 1.0)])
def test_a_pair_does_not_stand_under_what_covers_the_view(aspect: float, covered: tuple[float, float]) -> None:
    for pair in (POINTS[:2] * 0.3 + [0, 2, 0], np.array([[-0.9, 2.0, -0.5], [0.9, 2.4, 0.4]])):
        eye, look, fov = viewpoint("pair", POINTS, LEVEL, CAMERA, aspect, pair, covered)
        assert seen(pair, eye, look, fov, aspect).all()
        forward = (look - eye) / np.linalg.norm(look - eye)
        right = np.cross(forward, [0, 0, 1.0])
        right /= np.linalg.norm(right)
        x, y, z = ((pair - eye) @ np.stack([right, np.cross(right, forward), forward]).T).T
        across, up = x / z / np.tan(fov / 2) / aspect, y / z / np.tan(fov / 2)
        assert not ((across > 1 - 2 * covered[0]) & (up > 1 - 2 * covered[1])).any()
