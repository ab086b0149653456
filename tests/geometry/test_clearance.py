"""How far behind an object other surfaces are seen beside it."""

from __future__ import annotations

import numpy as np
import pytest
from scenes import Plane, camera_of, cast, up_of, upright

from pipeline.geometry.camera import Camera
from pipeline.geometry.clearance import LEAST_M, MOST_M, NOTHING_BEHIND
from pipeline.geometry.lifting import LiftedObject, lift
from pipeline.geometry.viewer import viewer_axes

CAMERA = camera_of()


def seen(*boxes, planes: tuple[Plane, ...] = (), up: np.ndarray | None = None) -> list[LiftedObject]:
    """What is lifted of boxes (level frame) before planes."""
    viewer = viewer_axes(up_of(0) if up is None else up)
    found = cast(CAMERA, boxes, planes, viewer)
    return list(lift(found.depth, CAMERA, [found.ids == k for k in range(len(boxes))], viewer))


def clearance(item: LiftedObject) -> np.ndarray:
    assert item.clearance is not None
    return item.clearance


@pytest.mark.parametrize("gap", [0.2, 0.7, 1.5])
@pytest.mark.parametrize(("pitch", "roll"), [(0.0, 0.0), (0.0, 12.0), (20.0, -8.0), (0.0, 90.0), (10.0, -90.0)])
def test_a_wall_bounds_what_stands_before_it(gap: float, pitch: float, roll: float) -> None:
    up = up_of(pitch, roll)
    y = 2.0 * np.tan(np.deg2rad(pitch))
    (item,) = seen(upright((0, y, 2.0), (0.4, 0.5, 0.3)), planes=(Plane((0, 0, 1), 2.15 + gap),), up=up)
    near, middle, share = clearance(item)
    back = 2.15 + gap - item.hi[2]
    assert share > 0.95
    np.testing.assert_allclose([near, middle], back, atol=0.03)


def test_what_is_hidden_or_cut_on_all_sides_has_nothing_behind_it() -> None:
    far, _ = seen(upright((0, 0, 3), (0.5, 0.5, 0.2)), upright((0, 0.3, 1.5), (1.8, 0.4, 0.1)))
    assert clearance(far)[2] < 0.9
    (alone,) = seen(upright((0, 0, 2), (0.4, 0.4, 0.4)))
    np.testing.assert_array_equal(clearance(alone), NOTHING_BEHIND)
    (cut,) = seen(upright((0, 0, 1), (4, 4, 0.2)), planes=(Plane((0, 0, 1), 3),))
    np.testing.assert_array_equal(clearance(cut), NOTHING_BEHIND)


def test_the_floor_before_a_thing_is_not_behind_it_and_far_is_far_enough() -> None:
    floor = Plane((0, 1, 0), 0.6)
    (item,) = seen(upright((0, 0.4, 2.0), (0.4, 0.4, 0.4)), planes=(floor, Plane((0, 0, 1), 9)))
    near, middle, share = clearance(item)
    assert middle == MOST_M
    assert LEAST_M < near <= middle
    assert share > 0.9


def test_moved_and_never_seen_objects() -> None:
    (item,) = seen(upright((0, 0, 2), (0.4, 0.5, 0.3)), planes=(Plane((0, 0, 1), 3),))
    assert item.box is not None
    moved = item.moved_to(item.box, viewer_axes(up_of(0)))
    np.testing.assert_array_equal(clearance(moved), clearance(item))
    empty = np.zeros((CAMERA.height, CAMERA.width), np.bool_)
    found = lift(np.zeros(empty.shape, np.float32), CAMERA, [empty, ~empty], viewer_axes(up_of(0)))
    for each in found:
        np.testing.assert_array_equal(clearance(each), NOTHING_BEHIND)
    assert lift(np.zeros(empty.shape, np.float32), Camera(CAMERA.K, 320, 240), [], viewer_axes(up_of(0))) == ()
