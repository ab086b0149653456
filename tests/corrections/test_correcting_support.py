"""What an object stands on, in scenes whose surfaces are known, and boxes brought down to it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scenes import frame_of, random_rotation, up_of, upright

from pipeline.answering import PreparedFrame, SceneObject, all_objects
from pipeline.corrections import Support
from pipeline.corrections.support import SnapMode, find_support, gap_below, snapped
from pipeline.geometry import Box3D, Frame, viewer_axes
from pipeline.proposals import AnnotationDetector
from pipeline.system import InputError

FLOOR = 1.2
WAYS: tuple[SnapMode, ...] = ("extend", "move")


def seen(frame: Frame) -> tuple[PreparedFrame, tuple[SceneObject, ...]]:
    context = PreparedFrame(frame)
    return context, all_objects(context, AnnotationDetector())


def standing(width: float, height: float, depth: float, right: float, forward: float, on: float, yaw: float) -> Box3D:
    """A box whose bottom is `on` metres under the camera; level frame (right, down, forward)."""
    return upright([right, on - height / 2, forward], [width, height, depth], yaw)


def table_scene(yaw: float = 20.0) -> Frame:
    table = standing(1.2, 0.7, 0.8, 0.0, 2.2, FLOOR, 0.0)
    mug = standing(0.12, 0.14, 0.12, 0.1, 2.1, 0.5, yaw)
    book = standing(0.2, 0.06, 0.2, -0.12, 2.1, 0.5, 0.0)
    chair = standing(0.4, 0.5, 0.4, 1.1, 2.4, FLOOR, yaw)
    return frame_of([table, mug, book, chair], ["table", "mug", "book", "chair"], pitch=28, floor=FLOOR)


@pytest.mark.parametrize(("number", "on", "height"), [(0, None, -FLOOR), (1, 0, -0.5), (2, 0, -0.5), (3, None, -FLOOR)])
def test_the_surface_under_each_thing_is_found(number: int, on: int | None, height: float) -> None:
    context, objects = seen(table_scene())
    box = objects[number].lifted.box
    assert box is not None
    found = find_support(context, box, objects, number)
    assert found.number == on
    assert found.height == pytest.approx(height, abs=0.004)
    assert found.points > 50
    assert found.spread < 0.005
    assert found.record()["object"] == on


def test_the_book_beside_a_mug_does_not_carry_it_and_the_one_below_does() -> None:
    table = standing(1.2, 0.7, 0.8, 0.0, 2.2, FLOOR, 0.0)
    below = standing(0.3, 0.05, 0.24, 0.0, 2.1, 0.5, 0.0)
    upper = standing(0.3, 0.05, 0.24, 0.0, 2.1, 0.45, 4.0)
    frame = frame_of([table, below, upper], ["table", "book", "book"], pitch=28, floor=FLOOR)
    context, objects = seen(frame)
    box = objects[2].lifted.box
    assert box is not None
    found = find_support(context, box, objects, 2)
    assert found.number == 1
    assert found.height == pytest.approx(-0.45, abs=0.012)


def test_a_box_that_sinks_in_is_lifted_and_one_that_hangs_far_above_is_left_alone() -> None:
    context, objects = seen(table_scene())
    box = objects[1].lifted.box
    assert box is not None
    up = context.viewer.up
    sunk = replace(box, center=box.center - 0.05 * up)
    assert find_support(context, sunk, objects, 1).height == pytest.approx(-0.5, abs=0.004)
    high = replace(box, center=box.center + 0.8 * up)
    with pytest.raises(InputError, match=r"0\.8\d m lower"):
        find_support(context, high, objects, 1)
    with pytest.raises(InputError, match="nothing level"):
        find_support(context, replace(box, center=box.center - 3 * up), objects, 1)


def test_where_only_a_wall_is_seen_there_is_nothing_to_stand_on() -> None:
    frame = table_scene()
    _, objects = seen(frame)
    wall = PreparedFrame(replace(frame, depth=np.full_like(frame.depth, 2.0)))
    box = objects[3].lifted.box
    assert box is not None
    with pytest.raises(InputError, match="nothing level"):
        find_support(wall, box, (), 3)


@pytest.mark.slow
@settings(max_examples=12)
@given(
    size=st.tuples(*(st.floats(0.15, 0.6) for _ in range(3))),
    place=st.tuples(st.floats(-0.5, 0.5), st.floats(1.8, 2.8)),
    yaw=st.floats(0, 90),
    pitch=st.floats(15, 40),
    way=st.sampled_from(WAYS),
)
def test_what_stands_on_the_floor_is_snapped_to_it(
    size: tuple[float, float, float], place: tuple[float, float], yaw: float, pitch: float, way: SnapMode
) -> None:
    truth = standing(*size, *place, FLOOR, yaw)
    context, objects = seen(frame_of([truth], ["crate"], pitch=pitch, floor=FLOOR))
    box = objects[0].lifted.box
    assert box is not None
    found = find_support(context, box, objects, 0)
    assert found.number is None
    after = snapped(box, found, context.viewer, way)
    bottom = float((after.corners @ context.viewer.up).min())
    assert bottom == pytest.approx(-FLOOR, abs=0.006)


tilts = st.integers(0, 10_000).map(lambda seed: random_rotation(np.random.default_rng(seed)))


@given(
    R=st.one_of(st.floats(0, 360).map(lambda yaw: upright([0, 0, 0], [1, 1, 1], yaw).R), tilts),
    size=st.tuples(*(st.floats(0.02, 2) for _ in range(3))),
    center=st.tuples(*(st.floats(-2, 2) for _ in range(3))),
    height=st.floats(-3, 3),
    pitch=st.floats(-60, 60),
    way=st.sampled_from(WAYS),
)
def test_snapping_puts_the_bottom_on_the_support_and_keeps_the_plan(
    R: np.ndarray, size: tuple[float, ...], center: tuple[float, ...], height: float, pitch: float, way: SnapMode
) -> None:
    viewer = viewer_axes(up_of(pitch))
    box = Box3D(np.array(center), viewer.R_level_camera.T @ R, np.array(size))
    support = Support(height, None, 10, 0.0)
    after = snapped(box, support, viewer, way)
    assert gap_below(after, support, viewer) == pytest.approx(0, abs=1e-9)
    axis = int(np.abs(box.R.T @ viewer.up).argmax())
    flat = [k for k in range(3) if k != axis]
    np.testing.assert_array_equal(after.size[flat], box.size[flat])
    np.testing.assert_array_equal(after.R, box.R)
    # Nothing moves beside the axis that stands.
    np.testing.assert_allclose(((after.center - box.center) @ box.R)[flat], 0, atol=1e-9)
    again = snapped(after, support, viewer, way)
    np.testing.assert_allclose(again.center, after.center, atol=1e-9)
    tops = [b.center @ b.R[:, axis] + np.sign(b.R[:, axis] @ viewer.up) * b.size[axis] / 2 for b in (box, after)]
    if way == "extend" and after.size[axis] != box.size[axis]:
        assert tops[0] == pytest.approx(tops[1], abs=1e-9)
    else:
        assert after.size[axis] == box.size[axis]
