"""Three views of a box: what a hand does to a face moves that face alone, and the journal keeps one edit of it."""

from __future__ import annotations

import base64
from typing import Any

import numpy as np
import pytest
from editor_checks import Open, desk, place  # noqa: F401
from hypothesis import given, settings
from hypothesis import strategies as st
from journal_world import FRAME

from pipeline.corrections import (
    Saved,
    actions_of,
    apply_actions,
    drag_box,
    dragged,
    face_to_points,
    labelled_box,
    labelled_objects,
)
from pipeline.corrections.scene import VIEWS, box_axes, side_views
from pipeline.datasets import demo_path, open_dataset
from pipeline.diagnosis import SMALLEST_SIDE
from pipeline.geometry import Box3D, viewer_axes
from pipeline.system import InputError

angles = st.floats(-3.1, 3.1)
sizes = st.floats(0.02, 3.0)


@st.composite
def boxes(draw: Any) -> tuple[Box3D, np.ndarray]:
    """A box that stands upright, or nearly so, before a viewer who looks down or up; and its axes."""
    tilt = draw(st.floats(-0.6, 0.6))
    viewer = viewer_axes(np.array([0.0, -np.cos(tilt), -np.sin(tilt)]))
    R = np.stack([viewer.right, viewer.forward, viewer.up], axis=1)
    for axis, most in ((2, 3.1), (0, 0.3)):
        angle = draw(st.floats(-most, most))
        turn = np.roll(
            np.roll([[1, 0, 0], [0, np.cos(angle), -np.sin(angle)], [0, np.sin(angle), np.cos(angle)]], axis, 0),
            axis,
            1,
        )
        R = R @ turn
    order = draw(st.permutations(range(3)))
    R = R[:, order] * np.linalg.det(R[:, order])
    box = Box3D(
        np.array([draw(st.floats(-2, 2)), draw(st.floats(-1, 1)), draw(st.floats(0.5, 5))]),
        R,
        np.array([draw(sizes) for _ in range(3)]),
    )
    return box, box_axes(box, viewer)


def ends(box: Box3D, axis: np.ndarray) -> tuple[float, float]:
    along = box.corners @ axis
    return float(along.min()), float(along.max())


@given(boxes())
def test_the_axes_are_the_boxs_own(made: tuple[Box3D, np.ndarray]) -> None:
    box, axes = made
    assert np.allclose(axes @ axes.T, np.eye(3), atol=1e-9)
    assert np.linalg.det(axes) == pytest.approx(1)
    assert np.allclose(np.abs(axes @ box.R).max(axis=1), 1)
    assert {k for pair in VIEWS.values() for k in pair} == {0, 1, 2}


@settings(max_examples=30)
@given(boxes(), st.integers(0, 2), st.sampled_from([-1, 1]), st.floats(-4, 4))
def test_a_face_goes_where_it_is_drawn_and_the_others_stay(
    made: tuple[Box3D, np.ndarray], axis: int, side: int, by: float
) -> None:
    box, axes = made
    after = dragged(box, axes, [["face", axis, side, by]])
    for k in range(3):
        (lo, hi), (new_lo, new_hi) = ends(box, axes[k]), ends(after, axes[k])
        if k != axis:
            assert (new_lo, new_hi) == pytest.approx((lo, hi))
        elif side > 0:
            assert new_lo == pytest.approx(lo)
            assert new_hi == pytest.approx(max(hi + by, lo + SMALLEST_SIDE))
        else:
            assert new_hi == pytest.approx(hi)
            assert new_lo == pytest.approx(min(lo - by, hi - SMALLEST_SIDE))


@settings(max_examples=25)
@given(boxes(), st.integers(0, 2), angles, st.floats(-2, 2))
def test_a_box_that_is_moved_and_turned_keeps_its_size_and_comes_back(
    made: tuple[Box3D, np.ndarray], axis: int, angle: float, by: float
) -> None:
    box, axes = made
    after = dragged(box, axes, [["move", axis, by], ["turn", axis, angle]])
    assert after.size == pytest.approx(box.size)
    assert axes @ (after.center - box.center) == pytest.approx(by * (np.arange(3) == axis), abs=1e-9)
    back = dragged(after, axes, [["turn", axis, -angle], ["move", axis, -by]])
    assert back.corners == pytest.approx(box.corners, abs=1e-6)


@pytest.mark.parametrize(
    "moves",
    [
        [],
        [["face", 3, 1, 0.1]],
        [["face", 0, 2, 0.1]],
        [["face", 0, 0.1]],
        [["turn", 0, 1, 0.1]],
        [["move", 0, 1e9]],
        [["move", 0, float("nan")]],
        [[1]],
        ["face"],
        [["fly", 0, 1.0]],
        [["move", 0, 0.1]] * 13,
    ],
)
def test_what_is_no_move_is_refused(moves: Any) -> None:
    box = Box3D(np.array([0, 0, 2.0]), np.eye(3), np.ones(3))
    with pytest.raises(InputError, match="not what a hand does"):
        dragged(box, np.eye(3), moves)


def test_the_views_hold_the_objects_points_and_faces_go_to_them(desk: Open) -> None:
    ann = desk("ann")
    frame = ann.frame(FRAME)
    entry = max(labelled_objects(frame), key=lambda o: o.lifted.quality.points if o.lifted.box is not None else 0)
    box, picture = entry.lifted.box, open_dataset(demo_path()).load(FRAME)
    assert box is not None
    viewer = viewer_axes(np.array(frame.row["up"]))
    views = side_views(picture, viewer, box, entry.mask, 1000)
    assert len(views.points) <= 1000
    assert views.own.any() and not views.own.all()  # noqa: PT018
    record = views.record()
    sent = np.frombuffer(base64.b64decode(record["points"]), "<i2").reshape(-1, 3)
    assert (sent == views.points[views.own]).all()
    assert sorted(record["size"]) == pytest.approx(sorted(box.size))
    too_large = dragged(box, views.axes, [["face", 2, 1, 0.4]])
    again = side_views(picture, viewer, too_large, entry.mask)
    fitted = dragged(too_large, again.axes, [face_to_points(again, 2, 1)])
    assert ends(fitted, views.axes[2]) == pytest.approx(ends(box, views.axes[2]), abs=0.05)


def test_a_drag_is_one_edit_and_relations_follow_it(desk: Open) -> None:
    ann = desk("ann")
    frame = ann.frame(FRAME)
    number = next(n for n, row in frame.objects.items() if labelled_box(row) is not None)
    before = labelled_box(frame.objects[number])
    moves = [["face", 0, 1, 0.2], ["face", 2, -1, 0.1]]
    done = ann.save(drag_box(frame, number, moves))
    assert isinstance(done, Saved)
    assert [e.ref.field for e in done.events] == ["box"]
    after = labelled_box(ann.frame(FRAME).objects[number])
    assert before is not None
    assert after is not None
    assert after.size.sum() == pytest.approx(before.size.sum() + 0.3)
    ann.undo()
    back = labelled_box(ann.frame(FRAME).objects[number])
    assert back is not None
    assert back.corners == pytest.approx(before.corners)
    action = actions_of([{"edit": "drag", "frame": FRAME, "object": number, "moves": moves}])
    assert isinstance(apply_actions(ann.corrector, ann.location.to_write(), action, "ann"), Saved)
    by_file = labelled_box(ann.frame(FRAME).objects[number])
    assert by_file is not None
    assert by_file.corners == pytest.approx(after.corners)
