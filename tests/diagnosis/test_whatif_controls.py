"""What the controls of the what-if are made of: numbers of a box, other masks, edits one by one."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pipeline.diagnosis import SMALLEST_SIDE, Edits, box_numbers, each_edit, without_edit
from pipeline.diagnosis.whatif.placement import MOST_PIXELS, grown, labelled_mask, rectangle, with_numbers
from pipeline.geometry import Box3D, ViewerAxes, encode_run_length, viewer_axes
from pipeline.labels import FrameCases
from pipeline.system import InputError

angle = st.floats(-179.0, 179.0)
length = st.floats(0.05, 3.0)
place = st.floats(-4.0, 4.0)


def looking_down(pitch: float) -> ViewerAxes:
    """A viewer whose camera is pitched down by degrees."""
    a = np.deg2rad(pitch)
    return viewer_axes(np.array([0.0, -np.cos(a), -np.sin(a)]), "declared")


def upright(viewer: ViewerAxes, center: tuple, size: tuple, yaw: float) -> Box3D:
    """An upright box in the camera frame, its centre given along right, forward and up; independent of the module."""
    t = np.deg2rad(yaw)
    width = np.cos(t) * viewer.right + np.sin(t) * viewer.forward
    depth = np.cross(width, -viewer.up)
    middle = center[0] * viewer.right + center[1] * viewer.forward + center[2] * viewer.up
    return Box3D(middle, np.stack([width, -viewer.up, depth], axis=1), np.array(size))


@given(st.tuples(place, place, place), st.tuples(length, length, length), angle, st.floats(0, 60))
def test_numbers_of_a_box_are_those_it_was_made_of(center: tuple, size: tuple, yaw: float, pitch: float) -> None:
    viewer = looking_down(pitch)
    numbers = box_numbers(upright(viewer, center, size, yaw), viewer)
    assert numbers.center == pytest.approx(center, abs=1e-9)
    assert numbers.size == pytest.approx(size, abs=1e-9)
    assert numbers.yaw == pytest.approx(yaw, abs=1e-6)


@given(st.tuples(place, place, place), angle, angle, st.floats(0, 60))
def test_typing_numbers_gives_the_box_with_those(center: tuple, yaw: float, turned: float, pitch: float) -> None:
    viewer = looking_down(pitch)
    box = upright(viewer, (0.1, 2.0, -0.3), (0.2, 0.3, 0.4), yaw)
    changed = with_numbers(box, viewer, center=center, size=(0.5, 0.6, 0.7), yaw=turned)
    assert changed.corners == pytest.approx(upright(viewer, center, (0.5, 0.6, 0.7), turned).corners, abs=1e-9)
    assert with_numbers(box, viewer).corners == pytest.approx(box.corners)


def test_a_turn_keeps_a_tilted_box_tilted() -> None:
    viewer = looking_down(20)
    tilt = np.array([[1.0, 0, 0], [0, 0.8, -0.6], [0, 0.6, 0.8]])
    box = Box3D(np.array([0.0, 0, 2]), upright(viewer, (0, 0, 0), (1, 1, 1), 30).R @ tilt, np.array([0.1, 0.2, 0.3]))
    turned = with_numbers(box, viewer, yaw=75)
    assert turned.R.T @ viewer.up == pytest.approx(box.R.T @ viewer.up)
    assert box_numbers(turned, viewer).yaw == pytest.approx(75)


def test_a_side_is_never_flat_and_numbers_must_be_finite() -> None:
    viewer = looking_down(0)
    box = upright(viewer, (0, 2, 0), (0.2, 0.2, 0.2), 0)
    assert with_numbers(box, viewer, size=(-1, 0, 0.3)).size == pytest.approx([SMALLEST_SIDE, SMALLEST_SIDE, 0.3])
    with pytest.raises(InputError):
        with_numbers(box, viewer, center=(float("nan"), 0, 0))


@given(st.integers(1, 9))
def test_a_mask_grows_by_a_disc_and_shrinks_back(pixels: int) -> None:
    mask = np.zeros((60, 80), np.bool_)
    mask[20:40, 30:55] = True
    rows, columns = np.nonzero(grown(mask, pixels))
    v, u = np.clip(rows, 20, 39), np.clip(columns, 30, 54)
    assert ((rows - v) ** 2 + (columns - u) ** 2 <= pixels**2).all()
    extent = rows.min(), rows.max(), columns.min(), columns.max()
    assert extent == (20 - pixels, 39 + pixels, 30 - pixels, 54 + pixels)
    assert (grown(grown(mask, pixels), -pixels) == mask).all()


def test_the_edge_of_the_picture_takes_nothing_from_a_mask() -> None:
    whole = np.ones((20, 30), np.bool_)
    assert grown(whole, -3).all()
    assert grown(whole, 0) is whole
    assert not grown(np.zeros((20, 30), np.bool_), 5).any()
    with pytest.raises(InputError):
        grown(whole, MOST_PIXELS + 1)


def test_a_rectangle_is_the_same_from_any_corner() -> None:
    mask = rectangle(40, 100, (0.2, 0.75, 0.5, 0.25))
    assert mask.sum() == 30 * 20
    assert mask[10:30, 20:50].all()
    assert (mask == rectangle(40, 100, (0.5, 0.25, 0.2, 0.75))).all()
    for nothing in ((0.5, 0.5, 0.5, 0.9), (1.2, 0.1, 1.4, 0.9), (float("nan"), 0, 1, 1)):
        with pytest.raises(InputError):
            rectangle(40, 100, nothing)


def truth(masks: tuple[str | None, ...]) -> FrameCases:
    boxes = np.array([[10, 10, 30, 30], [50, 10, 70, 30]], np.float64)
    numbers = np.array([4, 7])
    return FrameCases(
        "scene/0",
        0,
        "scene",
        ("mug", "mug"),
        boxes,
        np.eye(2, dtype=np.bool_),
        {},
        (),
        numbers,
        np.zeros((2, 2), np.bool_),
        {},
        {},
        masks,
    )


def test_the_labelled_mask_is_that_of_the_object_under_the_box() -> None:
    own = np.zeros((40, 80), np.bool_)
    own[12:28, 52:68] = True
    labelled = truth((None, encode_run_length(own)))
    found = labelled_mask(labelled, np.array([49, 10, 69, 31], np.float32), 40, 80)
    assert found is not None
    assert (found == own).all()
    assert labelled_mask(labelled, np.array([10, 10, 30, 30], np.float32), 40, 80) is None
    assert labelled_mask(labelled, np.array([30, 10, 50, 30], np.float32), 40, 80) is None
    assert labelled_mask(replace(labelled, boxes=np.zeros((0, 4)), masks=()), np.zeros(4), 40, 80) is None


def all_kinds() -> Edits:
    box = upright(looking_down(0), (0, 2, 0), (0.1, 0.1, 0.1), 0)
    mask = np.ones((4, 4), np.bool_)
    edits = Edits().with_box("#1", box).with_box("#2", box).with_mask("#1", mask).with_hidden("mug/3")
    edits = edits.with_confidence('a "mug"', "#1", 0.25).with_relation("left", "#1", "#2", 0.5)
    edits = edits.with_k(3).with_min_score(0.1).with_scorer("rule")
    edits = edits.with_settings("rank", relation_weight=2.0, target_weight=0.5)
    return edits.with_settings("profile", cone=30.0).with_settings("lift", erode=1.0)


def test_every_edit_is_listed_once_and_can_be_taken_back_alone() -> None:
    edits = all_kinds()
    listed = each_edit(edits, named=lambda key: f"<{key}>")
    assert len(listed) == 13
    assert len({edit.id for edit in listed}) == 13
    assert "P(<#1> left of <#2>) = 0.50" in [edit.text for edit in listed]
    left = edits
    for n, edit in enumerate(listed, start=1):
        alone = without_edit(edits, edit.id)
        assert {e.id for e in each_edit(alone)} == {e.id for e in listed} - {edit.id}
        left = without_edit(left, edit.id)
        assert len(each_edit(left)) == 13 - n
    assert not left
    assert left == Edits()


def test_what_is_no_edit_cannot_be_taken_back() -> None:
    for wrong in ("", "[]", '["boxes","#9"]', '["nothing"]', "no json"):
        with pytest.raises(InputError):
            without_edit(all_kinds(), wrong)


def test_a_threshold_that_others_lean_on_stays() -> None:
    edits = Edits().with_settings("profile", doubtful_cone=80.0, cone=75.0)
    doubtful = next(e.id for e in each_edit(edits) if "undecided" in e.text)
    with pytest.raises(InputError, match="doubtful_cone"):
        without_edit(edits, doubtful)
