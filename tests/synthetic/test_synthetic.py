"""The renderer of synthetic rooms: geometry that is exact, layouts that hold, files that repeat."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from room_checks import frame_of, room_of
from slow_cases import mostly_slow

from pipeline.geometry import lift_pixels, to_world
from pipeline.synthetic import Room, camera_at, choose_views, make_room, render_view, sense
from pipeline.synthetic.layout import FLOOR, TOUCH_M, WALL, overlaps, part_boxes
from pipeline.synthetic.lighting import sunlight
from pipeline.synthetic.model import ObjectModel
from pipeline.synthetic.raycast import OFFSET_M, build_scene, find_surfaces, pixel_rays
from pipeline.synthetic.render import exact_view, noise_sigma
from pipeline.system import InputError

SEEDS = (0, 1, 2, 3, 4, 9)


# Rooms


@pytest.mark.parametrize("seed", mostly_slow(SEEDS, fast=(0, 1)))
def test_nothing_interpenetrates(seed: int) -> None:
    instances = room_of(seed).instances
    boxes = [part_boxes(i.model, i.position, i.yaw) for i in instances]
    owner = np.repeat(np.arange(len(boxes)), [len(b) for b in boxes])
    flat = np.concatenate(boxes)
    hit = overlaps(flat, flat) & (owner[:, None] != owner[None])
    pairs = {(instances[owner[a]].model.label, instances[owner[b]].model.label) for a, b in np.argwhere(hit)}
    assert not pairs


@pytest.mark.parametrize("seed", SEEDS)
def test_everything_rests_on_its_support(seed: int) -> None:
    room = room_of(seed)
    for instance in room.instances:
        bottom = instance.position[2] + instance.model.low[2]
        if instance.support == FLOOR:
            assert bottom == pytest.approx(0, abs=1e-9)
        elif instance.support == WALL:
            back = instance.box.corners[:, :2]
            gap = np.min([back, [room.width, room.depth] - back], axis=(0, 1)).min()
            assert 0 <= gap < 0.005
        else:
            base = room.instances[instance.support]
            tops = [surface.z for surface in base.model.surfaces] + [float(base.model.high[2])]
            assert np.abs(bottom - base.position[2] - np.array(tops)).min() < 1e-9
            middle = (instance.position - base.position) @ base.R
            assert (np.abs(middle[:2]) <= base.model.size[:2] / 2).all(), instance.model.label


@pytest.mark.parametrize("seed", SEEDS)
def test_everything_is_inside_the_walls(seed: int) -> None:
    room = room_of(seed)
    for instance in room.instances:
        corners = instance.box.corners
        assert (corners >= -1e-9).all(), instance.model.label
        assert (corners <= np.array([room.width, room.depth, room.height]) + 1e-9).all(), instance.model.label


@pytest.mark.slow
def test_equal_seeds_give_equal_rooms_and_others_differ() -> None:
    first, again, other = make_room(5), make_room(5), make_room(9)
    assert [i.model.key for i in first.instances] == [i.model.key for i in again.instances]
    assert np.array_equal([i.position for i in first.instances], [i.position for i in again.instances])
    assert [i.model.key for i in first.instances] != [i.model.key for i in other.instances]


def test_rooms_hold_several_of_a_class_and_things_on_under_and_behind() -> None:
    study, dining, living = room_of(0), room_of(1), room_of(2)
    labels = [i.model.label for i in study.instances]
    assert labels.count("mug") >= 2
    assert "laptop" in labels
    dining_labels = [i.model.label for i in dining.instances]
    assert dining_labels.count("chair") >= 2
    assert dining_labels.count("mug") >= 2
    table = next(i for i in dining.instances if i.model.label == "dining table")
    beneath = [
        i for i in dining.instances if np.hypot(*(i.position - table.position)[:2]) < 0.4 and i.position[2] < 0.1
    ]
    assert any(i.model.label == "box" for i in beneath)
    sofa = next(i for i in living.instances if i.model.label == "sofa")
    behind = [i for i in living.instances if i.support == FLOOR and i.position[1] > sofa.position[1] + 0.4]
    assert any(i.model.label == "potted plant" and abs(i.position[0] - sofa.position[0]) < 1.0 for i in behind)
    assert len({i.model.label for seed in range(4) for i in room_of(seed).instances}) >= 25


def test_no_object_is_a_single_box() -> None:
    for seed in range(4):
        for instance in room_of(seed).instances:
            faces = sum(len(part.faces) for part in instance.model.parts)
            assert len(instance.model.parts) > 1 or faces > 200, instance.model.label


def shelves_of(room: Room) -> list[int]:
    return [k for k, i in enumerate(room.instances) if i.model.label in ("bookshelf", "shelf")]


@pytest.mark.parametrize("seed", SEEDS)
def test_a_few_things_on_each_shelf_are_objects_of_their_own(seed: int) -> None:
    """Rows of books are parts of their shelf, so that a frame is not mostly books."""
    room = room_of(seed)
    for index in shelves_of(room):
        resting = [i.model.label for i in room.instances if i.support == index]
        assert 2 <= len(resting) <= 6
        assert resting.count("book") <= 2
    assert len(room.instances) < 55


@pytest.mark.slow
@pytest.mark.parametrize("seed", mostly_slow([0, 1, 2]))
def test_a_shelfs_books_are_seen_stand_on_its_boards_and_are_named_as_the_shelf(seed: int) -> None:
    frame, room = frame_of(seed), room_of(seed)
    for index in shelves_of(room):
        model = room.instances[index].model
        covers = [part for part in model.parts if part.material.texture and part.material.texture[0] == "cover"]
        assert len(covers) >= 3
        assert (np.min([part.low for part in covers], axis=0) >= model.low - 1e-12).all()
        assert (np.max([part.high for part in covers], axis=0) <= model.high + 1e-12).all()
        # The parts of one shelf's books do not run into each other or into its frame.
        boxes = part_boxes(ObjectModel("books", tuple(covers)), np.zeros(3), 0.0)
        assert overlaps(boxes, boxes).sum() == len(covers)
        v, u = np.nonzero(frame.instances == index)
        points = lift_pixels(frame.depth_exact[v, u], frame.camera, v, u)
        local = (points - frame.boxes[index].center) @ frame.boxes[index].R + (model.low + model.high) / 2
        inside = np.zeros(len(local), dtype=bool)
        for part in covers:
            inside |= ((local > part.low - 0.002) & (local < part.high + 0.002)).all(axis=1)
        assert inside.sum() >= 5


@pytest.mark.slow
def test_a_mug_stands_on_each_side_of_the_laptop_in_the_first_view() -> None:
    camera = choose_views(room_of(0), 1, np.random.default_rng(0), 160, 120)[0]
    frame = render_view(room_of(0), camera, np.random.default_rng(0))
    x: dict[str, list[float]] = {"mug": [], "laptop": []}
    for index, instance in enumerate(room_of(0).instances):
        # At 640x480 these are 300 pixels or more.
        if instance.model.label in x and (frame.instances == index).sum() >= 300 / 16:
            x[instance.model.label].append(frame.boxes[index].center[0])
    assert len(x["laptop"]) == 1
    assert min(x["mug"]) < x["laptop"][0] - 0.15
    assert max(x["mug"]) > x["laptop"][0] + 0.15


@pytest.mark.slow
def test_a_trash_can_stands_left_of_the_dining_table_in_the_first_view() -> None:
    camera = choose_views(room_of(1), 1, np.random.default_rng(1), 160, 120)[0]
    frame = render_view(room_of(1), camera, np.random.default_rng(0))
    index = {i.model.label: k for k, i in enumerate(room_of(1).instances)}
    assert (frame.instances == index["trash can"]).sum() >= 10
    assert frame.boxes[index["trash can"]].center[0] < frame.boxes[index["dining table"]].center[0] - 0.8


# Frames


@pytest.mark.slow
@pytest.mark.parametrize("seed", mostly_slow([0, 1, 2, 3]))
def test_exact_boxes_hold_the_exact_points_of_their_masks(seed: int) -> None:
    frame = frame_of(seed)
    seen = np.unique(frame.instances[frame.instances >= 0])
    assert len(seen) >= 8
    for index in seen:
        v, u = np.nonzero(frame.instances == index)
        points = lift_pixels(frame.depth_exact[v, u], frame.camera, v, u)
        box = frame.boxes[index]
        local = np.abs((points - box.center) @ box.R)
        assert (local <= box.size / 2 + 1e-3).all(), room_of(seed).instances[index].model.label


@pytest.mark.slow
def test_masks_meet_the_surface_they_name() -> None:
    """The points of the floor lie on the floor: depth, pose and instance ids agree."""
    frame = frame_of(3)
    assert frame.camera.T_world_camera is not None
    v, u = np.nonzero((frame.instances < 0) & (frame.depth_exact > 0))
    world = to_world(lift_pixels(frame.depth_exact[v, u], frame.camera, v, u), frame.camera.T_world_camera)
    room = room_of(3)
    to_shell = np.min(
        [
            np.abs(world[:, 2]),
            np.abs(world[:, 0]),
            np.abs(world[:, 1]),
            room.width - world[:, 0],
            room.depth - world[:, 1],
        ],
        axis=0,
    )
    assert np.median(np.abs(to_shell)) < 2e-3
    assert world[:, 2].min() > -2e-3


@pytest.mark.slow
@pytest.mark.parametrize("seed", mostly_slow([0, 1, 2, 3, 8, 9, 10, 11], fast=(0, 3)))
def test_one_view_of_each_room_looks_another_way(seed: int) -> None:
    room = room_of(seed)
    cameras = choose_views(room, 3, np.random.default_rng([seed, 11]), 96, 72)
    ahead = [camera.T_world_camera[:2, 2] for camera in cameras if camera.T_world_camera is not None]
    headings = np.array([np.arctan2(y, x) for x, y in ahead])
    apart = np.rad2deg(np.abs((headings[:, None] - headings + np.pi) % (2 * np.pi) - np.pi))
    assert (apart + 360 * np.eye(3)).min(axis=1).max() >= 40


@pytest.mark.slow
def test_views_are_a_robots() -> None:
    for seed in range(4):
        room = room_of(seed)
        for camera in choose_views(room, 3, np.random.default_rng(seed), 96, 72):
            T = camera.T_world_camera
            assert T is not None
            assert camera.up is not None
            assert 1.0 <= T[2, 3] <= 1.5
            assert 0 < T[0, 3] < room.width
            assert 0 < T[1, 3] < room.depth
            pitch = np.rad2deg(np.arcsin(-T[2, 2]))
            assert 9.9 <= pitch <= 30.1
            assert np.rad2deg(np.abs(np.arcsin(T[2, 0]))) <= 2.1
            assert np.allclose(T[:3, :3] @ camera.up, [0, 0, 1])
            depth, instances = exact_view(room, camera)
            counts = np.bincount(instances[instances >= 0])
            assert (counts >= 30 * (96 / 640) ** 2 * 4).sum() >= 8
            assert depth[depth > 0].min() > 0.3


@given(
    st.floats(-np.pi, np.pi),
    st.floats(0.0, 0.6),
    st.floats(-0.04, 0.04),
    st.lists(st.floats(-3, 3), min_size=3, max_size=3),
)
def test_camera_axes_are_opencvs(heading: float, pitch: float, roll: float, place: list[float]) -> None:
    camera = camera_at(np.array(place), heading, pitch, roll)
    T = camera.T_world_camera
    assert T is not None
    assert np.allclose(T[:3, :3].T @ T[:3, :3], np.eye(3), atol=1e-12)
    assert np.linalg.det(T[:3, :3]) == pytest.approx(1)
    assert np.allclose(T[:3, 3], place)
    # y points down, z points where the camera looks, and the pitch lowers it.
    assert T[2, 1] < 0
    assert T[2, 2] == pytest.approx(-np.sin(pitch))
    assert np.arctan2(T[1, 2], T[0, 2]) == pytest.approx(heading, abs=1e-9)


@pytest.mark.slow
def test_colour_is_neither_black_nor_burnt_out() -> None:
    for seed in range(4):
        rgb = frame_of(seed).rgb.astype(float)
        assert 90 < rgb.mean() < 215
        assert (rgb.max(axis=2) < 12).mean() < 0.03
        assert (rgb.min(axis=2) > 250).mean() < 0.15


@pytest.mark.slow
@pytest.mark.parametrize("seed", mostly_slow([1, 2, 3, 9]))
def test_the_sun_shines_where_nothing_is_between_it_and_the_point(seed: int) -> None:
    """Asking only the rays that leave by the window gives what asking all of them gives."""
    frame, room = frame_of(seed), room_of(seed)
    scene = build_scene(room)
    v, u = (g.ravel() for g in np.indices((120, 160)))
    seen = find_surfaces(scene, frame.camera, pixel_rays(frame.camera, v, u))
    sun = room.sun.astype(np.float32)
    facing = seen.hit & (seen.normal @ sun > 0) & (seen.flat @ sun > 0)
    start = seen.position + OFFSET_M * seen.flat
    expected = facing & ~scene.tracer.blocked(start, np.broadcast_to(sun, start.shape))
    got = sunlight(scene, seen).any(axis=1)
    assert 0.003 < expected.mean() < 0.5
    assert (got != expected).mean() < 0.001


def test_a_camera_without_a_pose_is_refused() -> None:
    from dataclasses import replace

    camera = replace(frame_of(0).camera, T_world_camera=None)
    with pytest.raises(InputError, match="pose"):
        render_view(room_of(0), camera, np.random.default_rng(0))


# The sensor


@given(st.integers(0, 2**32 - 1))
@settings(max_examples=10)
def test_noise_grows_with_depth_as_stated(seed: int) -> None:
    spread = []
    for z in (0.8, 2.0, 4.0, 6.0):
        exact = np.full((120, 120), z, dtype=np.float32)
        got = sense(exact, np.random.default_rng(seed))
        assert got.dtype == np.float32
        kept = got[got > 0]
        assert len(kept) > 0.99 * got.size
        spread.append(float((kept - z).std()))
        assert spread[-1] == pytest.approx(float(noise_sigma(np.array(z))), rel=0.06)
        assert abs(float((kept - z).mean())) < 4 * spread[-1] / 120
    assert spread == sorted(spread)


def test_depth_edges_lose_and_smear_pixels_and_flat_parts_do_not() -> None:
    exact = np.full((200, 60), 1.0, dtype=np.float32)
    exact[:, 30:] = 3.0
    got = sense(exact, np.random.default_rng(1))
    edge = got[:, 29:31]
    assert 0.2 < (edge == 0).mean() < 0.4
    assert 0.1 < ((edge > 1.1) & (edge < 2.9)).mean() < 0.35
    inner = got[:, 2:27]
    assert (inner == 0).mean() < 0.01
    assert np.abs(inner[inner > 0] - 1).max() < 0.02


def test_no_return_stays_no_return_and_noise_never_goes_negative() -> None:
    exact = np.zeros((50, 50), dtype=np.float32)
    assert (sense(exact, np.random.default_rng(0)) == 0).all()
    exact[10:20] = 0.06
    got = sense(exact, np.random.default_rng(0))
    assert np.isfinite(got).all()
    assert (got >= 0).all()
    assert (got[:9] == 0).all()
    assert (sense(np.full((20, 20), 9.0, dtype=np.float32), np.random.default_rng(0)) == 0).all()


def test_touching_is_not_overlapping() -> None:
    a = np.array([[0, 0, 0, 0.5, 0.5, 0.5, 0.0]])
    side = np.array([[1.0, 0, 0, 0.5, 0.5, 0.5, 0.0]])
    deep = np.array([[1.0 - 3 * TOUCH_M, 0, 0, 0.5, 0.5, 0.5, 0.0]])
    corner = np.array([[0.5 + 0.70, 0.0, 0, 0.5, 0.5, 0.5, np.pi / 4]])
    clear = np.array([[0.5 + 0.72, 0.0, 0, 0.5, 0.5, 0.5, np.pi / 4]])
    got = [bool(overlaps(a, b)[0, 0]) for b in (side, deep, corner, clear)]
    assert got == [False, True, True, False]
