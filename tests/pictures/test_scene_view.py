"""Points and boxes in 3D: what is nearer hides what is farther, and lines behind points are faint."""

from __future__ import annotations

import numpy as np
import pytest

from pipeline.geometry.boxes import Box3D, edge_lines
from pipeline.geometry.cloud import Cloud, CloudPart
from pipeline.geometry.palette import RGB
from pipeline.pictures.scene_view import PictureView, Wire, quiet_colors, scene_picture

EYE, AHEAD = np.zeros(3), np.array([0.0, 1.0, 0.0])
RED, BLUE, GREEN = (255, 0, 0), (0, 0, 255), (0, 255, 0)
GROUND = (9, 9, 9)
VIEW = PictureView.at((EYE, AHEAD, np.deg2rad(60)), (120, 90))


def wall(distance: float, half: float, step: float = 0.02) -> np.ndarray:
    """Points of a square wall, shown frame."""
    x, z = np.meshgrid(np.arange(-half, half, step), np.arange(-half, half, step))
    return np.stack([x.ravel(), np.full(x.size, distance), z.ravel()], axis=1).astype(np.float32)


def shown(walls: list[np.ndarray], colors: list[RGB], wires: list[Wire]) -> np.ndarray:
    points = np.concatenate([np.zeros((0, 3), np.float32), *walls])
    paint = np.repeat(np.array(colors, np.uint8).reshape(-1, 3), [len(w) for w in walls], axis=0)
    part = CloudPart(True, slice(0, len(points)), np.zeros(3), points.astype(np.float16), 0.02)
    at = np.zeros(len(points), np.int32)
    return scene_picture(Cloud(at, at, points, (part,)), paint, wires, VIEW, GROUND)


def test_the_nearer_hides_the_farther_in_any_order() -> None:
    near, far = wall(1.5, 0.2), wall(3.0, 1.2)
    for walls, colors in (([near, far], [RED, BLUE]), ([far, near], [BLUE, RED])):
        image = shown(walls, colors, [])
        assert tuple(image[45, 60]) == RED
        assert tuple(image[45, 85]) == BLUE
        assert tuple(image[2, 2]) == GROUND


def test_a_surface_has_no_holes() -> None:
    image = shown([wall(2.0, 0.6)], [BLUE], [])
    assert (image[30:60, 45:75] == BLUE).all()


def test_lines_before_points_are_bright_and_behind_them_faint() -> None:
    line = np.array([[[-0.5, 1.0, 0.0], [0.5, 1.0, 0.0]], [[-0.5, 4.0, 0.6], [0.5, 4.0, 0.6]]], np.float32)
    image = shown([wall(2.0, 1.2)], [RED], [Wire(line, GREEN)])
    assert image[43:48, 60, 1].max() > 240
    _, v, _ = VIEW.seen(np.array([0.0, 4.0, 0.6]))
    green = image[round(float(v)) - 2 : round(float(v)) + 3, 60, 1].max()
    assert 40 < green < 160


def test_dashes_leave_gaps() -> None:
    line = np.array([[[-0.8, 1.5, 0.0], [0.8, 1.5, 0.0]]], np.float32)
    whole, dashes = (
        shown([], [], [Wire(line, GREEN, dashed)])[44:46, :, 1].max(axis=0) > 200 for dashed in (False, True)
    )
    assert whole.sum() > 80
    assert 0.4 * whole.sum() < dashes.sum() < 0.95 * whole.sum()


@pytest.mark.parametrize("center", [(0, 0.2, 0), (0, 0, 0), (0, -1, 0), (50, 0.1, 0), (0, 1e4, 0)])
def test_boxes_anywhere_are_drawn_as_far_as_they_are_seen(center: tuple[float, float, float]) -> None:
    box = Box3D(np.array(center), np.eye(3), np.array([1.0, 1.0, 1.0]))
    image = shown([], [], [Wire(edge_lines([box]), GREEN), Wire(edge_lines([box]), BLUE, True)])
    assert image.shape == (90, 120, 3)


def test_the_eye_steps_back_where_points_would_be_squares() -> None:
    look = AHEAD * 0.3
    near, far = (PictureView.at((EYE, look, 0.8), (700, 470), spacing) for spacing in (0.0, 0.01))
    assert np.linalg.norm(far.eye - look) > 3 * np.linalg.norm(near.eye - look)
    np.testing.assert_allclose(far.axes, near.axes, atol=1e-9)


def test_only_points_of_interest_keep_their_color() -> None:
    colors = np.array([[200, 40, 40], [200, 40, 40]], np.uint8)
    loud, quiet = quiet_colors(colors, np.array([True, False])).astype(int)
    assert loud.tolist() == [200, 40, 40]
    assert np.ptp(quiet) < 0.5 * np.ptp(loud)
    assert quiet.max() < loud.max()
