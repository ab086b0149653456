"""Floors and table-tops from any pitch a camera is held at; walls and ceilings are not taken for them."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from box_worlds import random_boxes
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st
from scenes import Plane, angle_deg, camera_of, cast, up_of, upright
from test_viewer import noisy

from pipeline.geometry import (
    IMAGE_UP,
    MIN_SCORE,
    Camera,
    decided,
    far_from_level,
    level_normal_at,
    resolve_up,
    up_hypotheses,
    viewer_axes,
)
from pipeline.geometry.level_plane import NOISY, _of_surface, level_plane
from pipeline.geometry.surface import LOOKED_UP_DEG, block_noise, may_be_wall, surface_blocks
from pipeline.synthetic import camera_at, make_room, sense_view
from pipeline.system import InputError

CAMERA = camera_of()


def world(pitch: float, roll: float, height: float, heading: float = 20.0, seed: int = 0, wall: float = 3.0):
    """Depth of boxes on a floor before two walls, and the true up."""
    viewer = viewer_axes(up_of(pitch, roll))
    a = np.deg2rad(heading)
    planes = [Plane((0, 1, 0), height), Plane((np.sin(a), 0, np.cos(a)), wall), Plane((np.cos(a), 0, -np.sin(a)), 2.0)]
    seen = cast(CAMERA, random_boxes(np.random.default_rng(seed), height), planes, viewer)
    return noisy(seen.depth), viewer.up, seen


@settings(max_examples=6, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(st.floats(0, 75), st.floats(-15, 15), st.floats(0.5, 2.3), st.floats(-40, 40), st.integers(0, 50))
@example(0, 0, 1.4, 20, 3)
@example(21, -9, 0.8, -25, 4)
@example(37, 12, 1.1, 35, 5)
@example(48, -14, 2.2, 0, 6)
@example(53, 15, 1.8, -40, 7)
@example(56, 5, 2.3, 15, 8)
@example(59, -8, 1.5, 30, 9)
@example(62, 0, 2.0, 0, 1)
@example(66, 10, 2.1, -10, 10)
@example(70, -3, 1.2, 40, 11)
@example(74, 7, 1.9, 25, 12)
def test_an_up_that_is_claimed_is_right_at_any_pitch(
    pitch: float, roll: float, height: float, heading: float, seed: int
) -> None:
    depth, up, seen = world(pitch, roll, height, heading, seed)
    found = level_plane(depth, CAMERA)
    floor = (seen.ids == len(seen.boxes)).mean()
    if found is None:
        # Seen steeply, a floor may as well be a wall that is looked up at.
        told = any(h.certain for h in up_hypotheses(depth, CAMERA))
        assert floor < 0.05 or (may_be_wall(up) and not told)
    else:
        assert angle_deg(found, up) < 5


def stereo(depth: np.ndarray, seed: int, error: float = 0.35) -> np.ndarray:
    """As a stereo camera gives it: an error of disparity that neighbours share, and steps of it."""
    rng, product = np.random.default_rng(seed), CAMERA.fx * 0.05
    shared = cv2.GaussianBlur(rng.standard_normal(depth.shape), (0, 0), 2.0) * 4 * error
    disparity = product / np.maximum(depth, 0.1) + shared + rng.normal(0, 0.1, depth.shape)
    return np.where(depth > 0, product / np.maximum(np.round(disparity * 8) / 8, 0.5), 0).astype(np.float32)


@pytest.mark.slow
@pytest.mark.parametrize(("pitch", "roll"), [(30.0, -9.0), (40.0, 5.0), (48.0, 12.0)])
def test_up_is_found_in_the_noise_of_a_stereo_camera(pitch: float, roll: float) -> None:
    for seed in range(3):
        _, up, seen = world(pitch, roll, 1.9, seed=seed, wall=4.0)
        depth = stereo(seen.depth, seed)
        assert block_noise(depth) > NOISY
        assert decided(_of_surface(surface_blocks(depth, CAMERA))) is None, "the case says nothing"
        found = level_plane(depth, CAMERA)
        assert found is not None
        assert angle_deg(found, up) < 5


def test_how_noisy_a_frame_is() -> None:
    _, _, seen = world(35, 3, 1.5)
    assert block_noise(seen.depth) < 0.02
    assert 0.15 < block_noise(noisy(seen.depth)) < 0.35
    assert block_noise(stereo(seen.depth, 1, 0.25)) < block_noise(stereo(seen.depth, 1)) < 10
    assert block_noise(np.zeros((120, 160), np.float32)) == 0


@settings(max_examples=10, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(st.floats(5, 89 - LOOKED_UP_DEG), st.floats(-12, 12), st.integers(0, 20))
def test_a_mirrored_picture_mirrors_up(pitch: float, roll: float, seed: int) -> None:
    depth, up, _ = world(pitch, roll, 1.4, seed=seed)
    here, there = level_plane(depth, CAMERA), level_plane(np.ascontiguousarray(depth[:, ::-1]), CAMERA)
    assert here is not None
    assert there is not None
    assert angle_deg(here, up) < 5
    assert angle_deg(there * (-1, 1, 1), here) < 5


@pytest.mark.parametrize("heading", [-35.0, 0.0, 35.0])
@pytest.mark.parametrize("pitch", [0.0, 10.0, 30.0, 60.0])
@pytest.mark.parametrize("roll", [-12.0, 0.0, 12.0])
def test_a_wall_alone_is_no_floor(heading: float, pitch: float, roll: float) -> None:
    a = np.deg2rad(heading)
    seen = cast(CAMERA, [], [Plane((np.sin(a), 0, np.cos(a)), 1.5)], viewer_axes(up_of(pitch, roll)))
    assert level_plane(noisy(seen.depth), CAMERA) is None
    assert resolve_up(noisy(seen.depth), CAMERA).up_source == "assumed"


@pytest.mark.parametrize("pitch", [55.0, 62.0, 70.0])
def test_a_floor_that_may_be_a_wall_is_assumed_to_be_one(pitch: float) -> None:
    viewer = viewer_axes(up_of(pitch, 4))
    depth = noisy(cast(CAMERA, [], [Plane((0, 1, 0), 1.6)], viewer).depth)
    found = resolve_up(depth, CAMERA)
    assert found.up_source == "assumed"
    assert found.up is not None
    assert angle_deg(found.up, viewer.up) < 2


def test_nothing_level_is_assumed_to_be_image_up() -> None:
    found = resolve_up(np.zeros((120, 160), np.float32), CAMERA)
    assert found.up_source == "assumed"
    np.testing.assert_array_equal(found.up, IMAGE_UP)


@pytest.mark.parametrize("ceiling", [True, False])
@pytest.mark.parametrize("pitch", [-32.0, -25.0, -17.0])
def test_a_wall_that_is_looked_up_at_is_no_floor(pitch: float, ceiling: bool) -> None:
    viewer = viewer_axes(up_of(pitch, 3))
    planes = [Plane((0, 0, 1), 2.2), *([Plane((0, -1, 0), 1.0)] if ceiling else [])]
    depth = noisy(cast(CAMERA, [], planes, viewer).depth)
    found, hypotheses = level_plane(depth, CAMERA), up_hypotheses(depth, CAMERA)
    assert any(h.kind == "floor" and h.score > MIN_SCORE and not h.certain for h in hypotheses), "the case says nothing"
    assert found is None or angle_deg(found, viewer.up) < 2


WALL_THINGS = {
    "cabinets": [((-0.4, 0.2), (0.6, 0.5, 0.35)), ((0.45, -0.1), (0.5, 0.7, 0.2))],
    "shelves": [((0.0, 0.3), (1.2, 0.03, 0.25)), ((0.1, -0.15), (0.9, 0.03, 0.25))],
    "thick pictures": [((-0.3, 0.1), (0.7, 0.5, 0.06)), ((0.5, 0.2), (0.3, 0.4, 0.06))],
}
"""Where on a wall (right, down from where the camera looks) and how wide, high and deep."""


@pytest.mark.parametrize("things", WALL_THINGS)
@pytest.mark.parametrize(("pitch", "roll", "heading"), [(-16.0, 0.0, 0.0), (-22.0, 9.0, 20.0), (-30.0, -8.0, -15.0)])
def test_a_wall_with_things_on_it_is_no_floor(things: str, pitch: float, roll: float, heading: float) -> None:
    viewer, away, a = viewer_axes(up_of(pitch, roll)), 1.7, np.deg2rad(heading)
    along, into = np.array([np.cos(a), 0, -np.sin(a)]), np.array([np.sin(a), 0, np.cos(a)])
    middle = np.array([0, np.tan(np.deg2rad(pitch)), 1]) * away / np.cos(a)
    boxes = [
        upright(middle + along * right + (0, down, 0) - into * size[2] / 2, size, heading)
        for (right, down), size in WALL_THINGS[things]
    ]
    seen = cast(CAMERA, boxes, [Plane((into[0], into[1], into[2]), away)], viewer)
    assert all((seen.ids == k).sum() > 300 for k in range(len(boxes))), "the case says nothing"
    found = level_plane(noisy(seen.depth), CAMERA)
    assert found is None or angle_deg(found, viewer.up) < 5


@pytest.mark.parametrize("pitch", [-18.0, -26.0])
def test_a_gable_under_a_roof_is_no_floor(pitch: float) -> None:
    viewer = viewer_axes(up_of(pitch, 4))
    slopes = [Plane((s * 0.7071, -0.7071, 0), 1.0) for s in (-1, 1)]
    seen = cast(CAMERA, [], [Plane((0, 0, 1), 1.8), *slopes], viewer)
    assert all((seen.ids == k).mean() > 0.02 for k in range(3)), "the case says nothing"
    found = level_plane(noisy(seen.depth), CAMERA)
    assert found is None or angle_deg(found, viewer.up) < 5


@pytest.mark.parametrize("pitch", [58.0, 66.0, 73.0])
def test_a_floor_that_is_looked_down_at_steeply_is_told_by_what_stands_on_it(pitch: float) -> None:
    viewer = viewer_axes(up_of(pitch, 6))
    ahead = 2.0 / np.tan(np.deg2rad(pitch))
    stool = upright((0.2, 1.8, ahead), (0.4, 0.4, 0.4), 30)
    bare, seen = (cast(CAMERA, things, [Plane((0, 1, 0), 2.0)], viewer).depth for things in ([], [stool]))
    assert level_plane(noisy(bare), CAMERA) is None
    found = level_plane(noisy(seen), CAMERA)
    assert found is not None
    assert angle_deg(found, viewer.up) < 2


@pytest.mark.parametrize("pitch", [-20.0, -10.0, 0.0])
def test_a_ceiling_says_where_up_is_and_is_not_taken_for_a_floor(pitch: float) -> None:
    viewer = viewer_axes(up_of(pitch, 6))
    planes = [Plane((0, -1, 0), 0.6), Plane((0.5, 0, 0.8660254), 2.5), Plane((-0.8660254, 0, 0.5), 2.5)]
    seen = cast(CAMERA, [], planes, viewer)
    assert (seen.ids == 0).mean() > 0.05, "the case says nothing"
    found = level_plane(noisy(seen.depth), CAMERA)
    assert found is not None
    assert angle_deg(found, viewer.up) < 2


@pytest.mark.parametrize("offset", [1.1, 1.2, 1.3])
def test_a_sloping_board_among_walls_is_no_floor(offset: float) -> None:
    viewer = viewer_axes(up_of(5))
    board = Plane((0, 0.766, 0.643), offset)
    seen = cast(CAMERA, [], [board, Plane((0.8, 0, 0.6), 1.1), Plane((-0.8, 0, 0.6), 1.1)], viewer)
    assert (seen.ids == 0).mean() > 0.15, "the case says nothing"
    found = level_plane(noisy(seen.depth), CAMERA)
    assert found is None or angle_deg(found, viewer.up) < 5


@pytest.mark.parametrize("pitch", [10.0, 50.0, 75.0])
def test_a_table_top_that_fills_the_picture_gives_up(pitch: float) -> None:
    viewer = viewer_axes(up_of(pitch, -7))
    ahead = min(0.5, 0.5 / np.tan(np.deg2rad(pitch)))
    things = [upright((x, 0.44, ahead), (0.08, 0.12, 0.08), 130 * x) for x in (-0.2, 0.0, 0.15)]
    seen = cast(CAMERA, things, [Plane((0, 1, 0), 0.5)], viewer)
    found = level_plane(noisy(seen.depth), CAMERA)
    assert found is not None
    assert angle_deg(found, viewer.up) < 2


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(4))
def test_rendered_rooms_never_claim_a_wrong_up(seed: int) -> None:
    room, rng = make_room(900 + seed), np.random.default_rng(seed)
    right = 0
    for pitch in (2, 20, 40, 55, 65, 74):
        place = np.array([room.width * rng.uniform(0.35, 0.65), room.depth * rng.uniform(0.35, 0.65), 1.9])
        angles = rng.uniform(-np.pi, np.pi), np.deg2rad(pitch), np.deg2rad(rng.uniform(-15, 15))
        camera = camera_at(place, *angles, width=320, height=240)
        depth, _ = sense_view(room, camera, rng)
        found = level_plane(depth, Camera(camera.K, 320, 240))
        assert camera.up is not None
        if found is not None:
            assert angle_deg(found, camera.up) < 5
            right += 1
    assert right >= 4


def test_hypotheses_come_best_first_and_a_contradiction_decides_nothing() -> None:
    depth, up, _ = world(40, 5, 1.4)
    found = up_hypotheses(depth, CAMERA)
    assert [h.score for h in found] == sorted((h.score for h in found), reverse=True)
    assert angle_deg(found[0].up, up) < 1
    turned = found[0].__class__(np.array([up[0], up[1] * 0.5, -0.9]), "floor", found[0].share, found[0].explained)
    assert turned.score > MIN_SCORE
    assert decided(found[:1]) is found[0]
    assert decided((found[0], turned)) is None
    assert decided(()) is None


# A surface that is named by a pixel.


@pytest.mark.parametrize("pitch", [15.0, 50.0, 80.0])
def test_the_surface_at_a_pixel_gives_its_normal(pitch: float) -> None:
    viewer = viewer_axes(up_of(pitch, 9))
    seen = cast(CAMERA, [upright((0.0, 1.0, 2.2), (0.5, 0.4, 0.5))], [Plane((0, 1, 0), 1.2)], viewer)
    floor = np.argwhere(seen.ids == 1)
    v, u = floor[len(floor) * 3 // 4]
    assert angle_deg(level_normal_at(noisy(seen.depth), CAMERA, int(u), int(v)), viewer.up) < 1


def test_a_wall_that_is_called_level_is_doubted() -> None:
    depth, up, seen = world(25, 5, 1.4)
    on_wall = np.argwhere((seen.ids == len(seen.boxes) + 1) & (depth > 0))
    v, u = on_wall[len(on_wall) // 2]
    wall = level_normal_at(depth, CAMERA, int(u), int(v))
    off = far_from_level(depth, CAMERA, wall)
    assert off == pytest.approx(90, abs=3)
    assert far_from_level(depth, CAMERA, up) is None
    assert far_from_level(depth, CAMERA, up_of(45, 5)) == pytest.approx(20, abs=2)


def test_a_pixel_that_names_no_plane_is_refused_in_one_line() -> None:
    depth = noisy(cast(CAMERA, [], [Plane((0, 1, 0), 1.2)], viewer_axes(up_of(40))).depth)
    depth[100:140, 100:140] = 0
    rough = np.random.default_rng(0).uniform(0.5, 3, depth.shape).astype(np.float32)
    cases = ((depth, 400, 10, "no such pixel"), (depth, 120, 120, "no depth"), (rough, 50, 50, "plane"))
    for found, u, v, what in cases:
        with pytest.raises(InputError, match=what) as error:
            level_normal_at(found, CAMERA, u, v)
        assert "\n" not in str(error.value)
