"""Whole boxes of a scene's objects, joined of several views, and the sides that no view saw."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from posed_worlds import SCENE, demo

from pipeline.geometry import Annotation, Box3D, iou_3d, viewer_axes
from pipeline.geometry.boxes import SIDES
from pipeline.scenes.object_map import ObjectMap, map_record, map_scene
from pipeline.scenes.world_boxes import MEASURED_M, ViewBox, joined_box, seen_by, sides_along
from pipeline.scenes.world_frame import from_frame

UP = np.array([0.0, -1.0, 0.0])
NOTHING = np.zeros((0, 3))


def turned(degrees: float) -> np.ndarray:
    c, s = np.cos(np.deg2rad(degrees)), np.sin(np.deg2rad(degrees))
    return np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]])


def view_of(box: Box3D, **ends: tuple[float, float]) -> ViewBox:
    """A view that measures all sides of a box, but for those with 10 and 90 % of where they lie."""
    found = np.zeros((2, 6))
    for side, own in ends.items():
        found[:, SIDES.index(side)] = own  # type: ignore[arg-type]
    return ViewBox(box, found, 0.8)


TRUE = Box3D(np.array([0.0, 0.0, 2.0]), turned(20), np.array([0.6, 0.8, 0.4]))


def shrunk(side: str, by: float) -> Box3D:
    """The true box with a side too far inwards."""
    k = SIDES.index(side)  # type: ignore[arg-type]
    sign, size = 2 * (k % 2) - 1, TRUE.size.copy()
    size[k // 2] -= by
    return Box3D(TRUE.center - TRUE.R[:, k // 2] * sign * by / 2, TRUE.R, size)


def test_a_side_is_where_the_view_that_saw_it_puts_it() -> None:
    one = view_of(shrunk("far", 0.2), far=(-0.05, 0.35))
    # The other looks from behind: its near side is the far one, and it does not see the other.
    behind = shrunk("near", 0.15)
    other = ViewBox(
        Box3D(behind.center, behind.R @ turned(180), behind.size), view_of(behind, far=(-0.1, 0.3)).ends, 0.8
    )
    for views in ([one, other], [other, one]):
        found = joined_box(views, NOTHING, UP)
        assert iou_3d(found.box, TRUE) > 0.9
        assert (found.views, found.completed) == (2, ())
        assert set(found.interval.values()) == {(-MEASURED_M, MEASURED_M)}


def test_a_side_that_no_view_saw_keeps_the_surest_interval() -> None:
    views = [view_of(TRUE, far=(-0.1, 0.3)), view_of(TRUE, far=(-0.04, 0.12))]
    found = joined_box(views, NOTHING, UP)
    assert found.completed == ("far",)
    np.testing.assert_allclose(found.interval["far"], (-0.04, 0.12))


def test_one_wrong_view_of_four_does_not_move_a_side_far() -> None:
    wrong = Box3D(TRUE.center + TRUE.R[:, 0] / 2, TRUE.R, TRUE.size * 2)
    found = joined_box([view_of(TRUE)] * 3 + [view_of(wrong)], NOTHING, UP)
    assert iou_3d(found.box, TRUE) > 0.95


def test_what_other_views_saw_lies_in_the_box_and_stray_places_do_not_count() -> None:
    short = view_of(shrunk("right", 0.3))
    places = np.random.default_rng(1).uniform(-0.5, 0.5, (2000, 3)) * TRUE.size @ TRUE.R.T + TRUE.center
    stray = TRUE.center + TRUE.R @ [[3.0], [0], [0]] * np.ones((1, 3))
    found = joined_box([short, short], np.concatenate([places, np.repeat(stray[:1], 20, axis=0)]), UP)
    assert iou_3d(found.box, TRUE) > 0.85
    assert iou_3d(joined_box([short, short], NOTHING, UP).box, TRUE) < 0.6


def test_quarter_turns_only_exchange_sides() -> None:
    turns = (Box3D(TRUE.center, TRUE.R @ turned(90 * k), TRUE.size) for k in range(4))
    sized = (Box3D(b.center, b.R, b.size[[2, 1, 0]]) if k % 2 else b for k, b in enumerate(turns))
    found = [joined_box([view_of(box)] * 2, NOTHING, UP).box for box in sized]
    for one, other in pairwise(found):
        assert iou_3d(one, other) > 0.999
    np.testing.assert_array_equal(sides_along(np.eye(3), turned(90)), [5, 4, 2, 3, 0, 1])


def test_a_box_is_the_same_from_every_viewpoint_with_its_sides_named_by_it() -> None:
    whole = joined_box([view_of(TRUE, far=(-0.1, 0.3))], NOTHING, UP)
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = turned(180), (0.0, 0.0, 4.0)
    found = seen_by(whole, pose, viewer_axes(UP))
    assert found.completed == ("near",)
    np.testing.assert_allclose(found.interval["near"], (-0.1, 0.3))
    np.testing.assert_allclose(found.box.transformed(pose).corners.mean(axis=0), TRUE.center, atol=1e-9)


@pytest.fixture(scope="module")
def made() -> ObjectMap:
    return map_scene(demo(), "s", SCENE)


def test_boxes_of_the_demo_are_nearer_to_the_whole_ones_by_more_views(made: ObjectMap) -> None:
    pipeline = demo()
    found: dict[bool, list[float]] = {True: [], False: []}
    for entry in made.objects:
        ious = []
        for frame_id, number in entry.numbers.items():
            exact = next(a.box for a in pipeline.dataset.load(frame_id).annotations if a.index == number)
            assert exact is not None
            ious.append(iou_3d(made.boxes[entry.id].box, exact.transformed(made.poses[frame_id])))
        found[len(ious) == 3].append(float(np.median(ious)))
    assert np.mean(np.array(found[True]) >= 0.5) >= 0.7
    assert np.mean(found[True]) > np.mean(found[False])


def test_given_boxes_are_taken_as_they_are_whatever_their_axes_are_called(made: ObjectMap) -> None:
    def given(frame_id: str, a: Annotation) -> Annotation:
        assert a.box is not None
        return replace(a, box=Box3D(a.box.center, a.box.R[:, [1, 2, 0]], a.box.size[[1, 2, 0]]), fixed=True)

    pipeline = demo(annotated=given)
    found = map_scene(pipeline, "s", SCENE)
    np.testing.assert_allclose(found.up, made.up, atol=0.02)
    for a in pipeline.dataset.load(SCENE[0]).annotations:
        entry = found.of_object(SCENE[0], a.index)
        assert entry is not None
        assert a.box is not None
        if len(entry.numbers) == 3:
            assert iou_3d(found.boxes[entry.id].box, a.box.transformed(found.poses[SCENE[0]])) > 0.8


def test_a_map_tells_each_box_with_its_views_in_the_world(made: ObjectMap) -> None:
    record = map_record(made)
    assert record["reference"]["frame"] == "world"
    for entry in record["objects"]:
        assert entry["box"]["views"] == len(entry["numbers"])
        assert set(entry["box"]["interval_m"]) == set(SIDES)


def test_a_world_frame_has_the_joined_boxes(made: ObjectMap) -> None:
    world = from_frame(demo(), made, SCENE[0])
    for number, whole in made.boxes.items():
        own = world.wholes[number]
        assert iou_3d(own.box.transformed(made.poses[SCENE[0]]), whole.box) > 0.999
        assert np.abs(world.viewer.R_level_camera @ own.box.R - np.eye(3)).max() < 1, "near right, down, forward"
