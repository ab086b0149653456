"""The floor's height and the grid of metres on it."""

from __future__ import annotations

import numpy as np
import pytest
from scenes import frame_of, up_of, upright

from pipeline.geometry import cloud_of, metre_grid, over_floor, viewer_axes
from pipeline.geometry.cloud import GRID_LIFT, floor_height, grid_lines


def test_the_grid_has_metre_cells_and_finer_lines_between() -> None:
    cells, fine = grid_lines(np.array([-1.2, 0.4]), np.array([0.7, 2.9]), -1.1)
    assert (cells[..., 2] == np.float32(-1.1)).all()
    assert sorted({float(x) for x in cells[cells[:, 0, 0] == cells[:, 1, 0]][:, 0, 0]}) == [-2, -1, 0, 1]
    assert len(cells) == 4 + 4
    assert len(fine) == 3 * (3 + 3)


@pytest.mark.parametrize(("named", "floor"), [("floor", -0.5), ("rug", -1.2)])
def test_the_floor_is_the_annotated_one_else_what_lies_lowest(named: str, floor: float) -> None:
    # A slab whose top is 0.5 m below the camera, a box on it, and the ground 1.2 m below.
    slab, mug = upright((0, 0.55, 1.5), (2.4, 0.1, 1.6)), upright((0, 0.4, 1.5), (0.2, 0.2, 0.2))
    frame = frame_of([slab, mug], [named, "mug"], pitch=25)
    viewer = viewer_axes(frame.camera.up if frame.camera.up is not None else up_of(25))
    points = cloud_of(frame, viewer).points
    assert floor_height(frame, viewer, points) == pytest.approx(floor, abs=0.02)
    cells, fine = metre_grid(frame, viewer, points)
    height = float(cells[0, 0, 2])
    assert (fine[..., 2] == np.float32(height)).all()
    assert floor < height < floor + 0.03 + GRID_LIFT
    assert cells[..., 0].min() <= np.percentile(points[:, 0], 1)


def test_what_lies_over_the_floor_is_above_nearly_all_of_its_points() -> None:
    rng = np.random.default_rng(0)
    points = np.concatenate([rng.uniform(-1, 1, (5000, 2)), rng.normal(0, 0.005, (5000, 1))], axis=1)
    height = over_floor(points, np.array([-1, -1, 0.0]), np.array([1, 1, 0.0]))
    assert 0.97 < (points[:, 2] < height).mean() < 0.99
    assert over_floor(points, np.array([5, 5, 0.0]), np.array([6, 6, 0.0])) == 0.0
