"""Open sides of boxes: what the picture cuts, what something nearer hides, what nobody sees."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from pipeline.geometry import Box3D, Camera, LiftConfig, LiftedObject, ViewerAxes, intrinsics, lift, viewer_axes
from pipeline.geometry.boxes import EDGES, OPEN_GAP, SIDES, drawn_edges, edge_lines, edges_of, half_dashed
from pipeline.geometry.open_sides import open_sides

WIDTH, HEIGHT = 640, 480
LEVEL = np.array([0.0, -1.0, 0.0])


def seen_from(up: np.ndarray) -> Camera:
    return Camera(intrinsics(500, 500, WIDTH / 2, HEIGHT / 2), WIDTH, HEIGHT, up=up / np.linalg.norm(up))


def rendered(camera: Camera, boxes: Sequence[Box3D]) -> tuple[np.ndarray, np.ndarray]:
    """Depth, (H, W) float32, and number of the nearest box at each pixel; a wall at 6 m is -1."""
    v, u = np.mgrid[:HEIGHT, :WIDTH]
    rays = np.stack([(u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy, np.ones(u.shape)], axis=-1)
    depth, ids = np.full(u.shape, 6.0), np.full(u.shape, -1)
    for k, box in enumerate(boxes):
        with np.errstate(divide="ignore", invalid="ignore"):
            ends = (np.stack([-box.size, box.size]) / 2 + box.center @ box.R)[:, None, None] / (rays @ box.R)
        first, last = ends.min(axis=0).max(axis=-1), ends.max(axis=0).min(axis=-1)
        hit = (first < last) & (first > 0) & (first < depth)
        depth[hit], ids[hit] = first[hit], k
    return depth.astype(np.float32), ids


def lifted(camera: Camera, *boxes: Box3D, config: LiftConfig | None = None) -> LiftedObject:
    """First of the boxes, lifted from what is seen of it."""
    depth, ids = rendered(camera, boxes)
    (found,) = lift(depth, camera, [ids == 0], seen_by(camera), config=config)
    return found


def seen_by(camera: Camera) -> ViewerAxes:
    assert camera.up is not None
    return viewer_axes(camera.up)


def upright(
    camera: Camera, right: float, height: float, forward: float, size: Sequence[float], yaw: float = 0
) -> Box3D:
    """Box by place and size along the viewer's right, up and forward."""
    R = seen_by(camera).R_level_camera.T
    cos, sin = np.cos(yaw), np.sin(yaw)
    turn = np.array([[cos, 0, -sin], [0, 1, 0], [sin, 0, cos]])
    return Box3D(R @ [right, -height, forward], R @ turn, np.array(size))


AHEAD = seen_from(LEVEL)
ABOVE = seen_from(np.array([0.0, -0.8, -0.6]))


def test_of_a_thing_seen_from_its_front_only_the_far_side_is_open() -> None:
    assert lifted(AHEAD, upright(AHEAD, 0, 0, 2.5, [0.6, 0.5, 0.4])).open_sides == ("far",)


def test_from_above_the_far_edge_bounds_a_thing() -> None:
    assert lifted(ABOVE, upright(ABOVE, 0, -1.4, 1.8, [0.9, 0.5, 0.7])).open_sides == ()
    assert lifted(ABOVE, upright(ABOVE, 0.2, -1.4, 1.8, [0.9, 0.5, 0.7], yaw=0.5)).open_sides == ()


@pytest.mark.parametrize(
    ("side", "right", "height"), [("left", -1.6, 0), ("right", 1.6, 0), ("top", 0, 1.2), ("bottom", 0, -1.2)]
)
def test_the_border_of_the_picture_opens_a_side(side: str, right: float, height: float) -> None:
    found = lifted(AHEAD, upright(AHEAD, right, height, 2.5, [0.9, 0.9, 0.4]))
    assert set(found.open_sides or ()) - {"far"} == {side}
    assert found.quality.touches_border


def test_sides_go_by_the_viewer_and_not_by_the_picture() -> None:
    rolled = seen_from(np.array([1.0, 0.0, 0.0]))
    found = lifted(rolled, upright(rolled, 0, 1.6, 2.5, [0.9, 0.9, 0.4]))
    assert set(found.open_sides or ()) - {"far"} == {"top"}


def test_a_front_that_is_cut_below_goes_on_down_and_a_top_towards_the_viewer() -> None:
    front = upright(AHEAD, 0, -0.8, 2.0, [0.8, 1.2, 0.5])
    assert "near" not in (lifted(AHEAD, front).open_sides or ())
    top = upright(ABOVE, 0, -1.0, 0.8, [0.8, 0.2, 1.6])
    assert {"near"} <= set(lifted(ABOVE, top).open_sides or ()) <= {"near", "bottom"}


@pytest.mark.parametrize(("side", "right"), [("left", -0.5), ("right", 0.5)])
def test_something_nearer_opens_the_side_that_it_hides(side: str, right: float) -> None:
    thing, hiding = upright(AHEAD, 0, 0, 3, [1, 0.5, 0.4]), upright(AHEAD, right * 0.6, 0, 1.7, [0.3, 1.5, 0.1])
    assert set(lifted(AHEAD, thing, hiding).open_sides or ()) - {"far"} == {side}
    behind = upright(AHEAD, right, 0, 4.5, [0.6, 3, 0.1])
    assert set(lifted(AHEAD, thing, behind).open_sides or ()) - {"far"} == set()


def test_something_nearer_before_the_middle_opens_no_side() -> None:
    thing, bar = upright(AHEAD, 0, 0, 3, [1.4, 0.5, 0.4]), upright(AHEAD, 0, 0, 1.7, [0.1, 3, 0.1])
    assert set(lifted(AHEAD, thing, bar).open_sides or ()) - {"far"} == set()


def test_a_thing_that_fills_the_picture_is_open_all_around() -> None:
    found = lifted(AHEAD, upright(AHEAD, 0, 0, 2, [9, 9, 0.2]))
    assert {"left", "right", "top", "bottom"} <= set(found.open_sides or ())


def test_small_empty_and_scattered_masks_are_no_trouble() -> None:
    depth, box = np.full((HEIGHT, WIDTH), 2, np.float32), Box3D(np.array([0, 0, 2.0]), np.eye(3), np.full(3, 0.01))
    for codes in (
        np.zeros((5, 5), np.uint8),
        np.pad(np.ones((1, 1), np.uint8), 2),
        np.pad(np.ones((2, 2), np.uint8), 1),
    ):
        assert open_sides([box], [(codes, 300, 200)], depth, AHEAD) == [("far",)]
    speckled = (np.random.default_rng(0).random((HEIGHT, WIDTH)) < 0.3).astype(np.uint8)
    assert set(open_sides([box], [(speckled, 0, 0)], depth, AHEAD)[0]) <= set(SIDES)
    flat = replace(box, size=np.zeros(3))
    whole = np.ones((HEIGHT, WIDTH), np.uint8)
    assert set(open_sides([flat], [(whole, 0, 0)], depth, AHEAD)[0]) <= set(SIDES)


def test_without_depth_nothing_is_known() -> None:
    mask = np.zeros((HEIGHT, WIDTH), np.bool_)
    mask[100:200, 100:200] = True
    (found,) = lift(np.zeros((HEIGHT, WIDTH), np.float32), AHEAD, [mask], viewer_axes(LEVEL))
    assert (found.box, found.open_sides, found.goes_on) == (None, None, "")


def test_only_upright_boxes_as_fitted_have_open_sides() -> None:
    thing = upright(AHEAD, 1.6, 0, 2.5, [0.9, 0.9, 0.4])
    for mode in ("gravity", "pca", "pca-raw"):
        assert lifted(AHEAD, thing, config=LiftConfig(box=mode)).open_sides is None
    found = lifted(AHEAD, thing)
    assert found.goes_on == "may go on: right"
    assert found.moved_to(thing, viewer_axes(LEVEL)).open_sides is None


def test_edges_of_open_sides_have_a_gap() -> None:
    box = upright(ABOVE, 0.3, -1, 2, [0.6, 0.4, 0.5], yaw=0.4)
    np.testing.assert_array_equal(drawn_edges(box), box.corners[EDGES])
    assert len(edge_lines([box, box], open_sides=[(), ("far",)])) == 12 + 16
    for k, side in enumerate(SIDES):
        lines = (drawn_edges(box, (side,)) - box.center) @ box.R / box.size * 2
        on_side = np.isclose(lines[..., k // 2], (-1, 1)[k % 2]).all(axis=1)
        assert (on_side.sum(), len(lines)) == (8, 16)
        # Every line begins or ends in a corner, and the pieces of an edge leave the gap.
        off_corner = np.abs(np.abs(lines) - 1).max(axis=2).min(axis=1)
        np.testing.assert_allclose(off_corner, 0, atol=1e-9)
        lengths = np.linalg.norm(np.diff(lines, axis=1), axis=2)[:, 0]
        np.testing.assert_allclose(lengths, np.where(on_side, 1 - OPEN_GAP, 2))
    assert len(drawn_edges(box, SIDES)) == 24


@pytest.mark.parametrize("size", [(0.1, 0.12, 0.1), (0.6, 0.9, 0.5), (3.0, 2.5, 0.2)])
def test_dashes_draw_every_corner_and_half_of_each_edge(size: tuple[float, float, float]) -> None:
    box = Box3D(np.array([0.2, 0.1, 2.0]), np.eye(3), np.array(size))
    whole, cut = edge_lines([box]), edge_lines([box], dashes=True)
    assert len(whole) == 12 < len(cut) < 12 * 40
    length = [float(np.linalg.norm(lines[:, 1] - lines[:, 0], axis=1).sum()) for lines in (whole, cut)]
    assert 0.5 * length[0] < length[1] < 0.9 * length[0]
    for corner in box.corners:
        assert np.linalg.norm(cut.reshape(-1, 3) - corner, axis=1).min() < 1e-5
    assert np.isfinite(edge_lines([], dashes=True)).all()


def test_edges_of_unsure_sides_are_dashed() -> None:
    box = Box3D(np.array([0, 0, 2.0]), np.eye(3), np.array([1.0, 0.5, 0.8]))
    assert edges_of(("near",)).sum() == 4
    assert edges_of(("near", "left")).sum() == 7
    np.testing.assert_array_equal(half_dashed(box, ()), box.corners[EDGES].astype(np.float32))
    lines = half_dashed(box, ("far",))
    dashes = lines[8:]
    np.testing.assert_allclose(dashes[..., 2], 2.4, atol=1e-6)
    assert len(dashes) > 8
