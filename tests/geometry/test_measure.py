"""Measuring between two pixels: against the demo's own figures, the geometry of boxes, and pixels without depth."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scenes import camera_of, up_of

from pipeline.answering import open_pipeline
from pipeline.geometry import Box3D, viewer_axes
from pipeline.geometry.viewer import measure
from pipeline.system import InputError

CAMERA = camera_of()
PIXELS = st.tuples(st.integers(0, CAMERA.width - 1), st.integers(0, CAMERA.height - 1))
DEPTHS = st.floats(0.25, 9.0, width=32)


@given(PIXELS, PIXELS, DEPTHS, DEPTHS, st.floats(-40, 40), st.floats(-25, 25))
def test_it_is_symmetric_and_spans_the_level_box_between_the_points(
    a: tuple[int, int], b: tuple[int, int], near: float, far: float, pitch: float, roll: float
) -> None:
    depth = np.zeros((CAMERA.height, CAMERA.width), np.float32)
    depth[a[1], a[0]], depth[b[1], b[0]] = near, far
    viewer = viewer_axes(up_of(pitch, roll))
    there, back = measure(depth, CAMERA, viewer, a, b), measure(depth, CAMERA, viewer, b, a)
    assert there.distance == back.distance
    np.testing.assert_array_equal(there.parts, -back.parts)
    # The upright box that both points are corners of has the parts as its sizes, and the distance as its diagonal.
    right, up, forward = np.abs(there.parts)
    box = Box3D(there.points.mean(axis=0), viewer.R_level_camera.T, np.array([right, up, forward]))
    for point in there.points:
        assert np.linalg.norm(box.corners - point, axis=1).min() < 1e-5
    assert np.linalg.norm(box.size) == pytest.approx(there.distance, abs=1e-9)
    assert np.linalg.norm(there.points[1] - there.points[0]) == pytest.approx(there.distance, abs=1e-9)


def test_the_demos_first_frame_has_known_lengths() -> None:
    context = open_pipeline("demo").prepare(0)
    frame = context.frame
    found = measure(frame.depth, frame.camera, context.viewer, (120, 200), (420, 330))
    assert found.record() == {
        "pixels": [[120, 200], [420, 330]],
        "points": [[-0.9588, -0.1898, 2.2145], [0.3797, 0.3419, 1.741]],
        "distance": 1.5161,
        "right": 1.3289,
        "up": -0.3562,
        "forward": -0.6369,
    }
    assert found.words == ("1.329 m right", "0.356 m down", "0.637 m back")


def test_a_pixel_outside_or_without_depth_is_refused() -> None:
    depth = np.ones((CAMERA.height, CAMERA.width), np.float32)
    depth[7, 5] = 0
    viewer = viewer_axes(up_of(0))
    with pytest.raises(InputError, match=r"no depth.*got 5,7"):
        measure(depth, CAMERA, viewer, (3, 3), (5, 7))
    with pytest.raises(InputError, match="no such pixel"):
        measure(depth, CAMERA, viewer, (CAMERA.width, 0), (3, 3))
