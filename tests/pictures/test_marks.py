"""Marks over a frame: true to what they show."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scenes import camera_of
from test_ask import row, truth

from pipeline.answering.ask import Trace, ask
from pipeline.geometry.boxes import EDGES, Box3D, dashed
from pipeline.geometry.camera import project
from pipeline.geometry.frame import Frame
from pipeline.geometry.palette import ON_DARK
from pipeline.pictures.marks import box_edges_2d, tinted
from pipeline.proposals import AnnotationDetector

__all__ = ["row", "truth"]


@pytest.fixture(scope="module")
def trace(row: Frame, truth: AnnotationDetector) -> Trace:
    return ask(row, "mug right of the laptop", truth)


def test_only_objects_in_a_role_are_tinted(trace: Trace) -> None:
    rgb = trace.frame.rgb
    image = tinted(rgb, trace.objects, {0: "target"})
    mask = trace.objects[0].mask
    far = ~cv2.dilate(mask.view(np.uint8), np.ones((5, 5), np.uint8)).astype(bool)
    np.testing.assert_array_equal(image[far], rgb[far])
    core = cv2.erode(mask.view(np.uint8), np.ones((5, 5), np.uint8)).astype(bool)
    before = np.abs(rgb[core].astype(int) - ON_DARK["target"]).sum()
    assert np.abs(image[core].astype(int) - ON_DARK["target"]).sum() < 0.7 * before
    np.testing.assert_array_equal(tinted(rgb, trace.objects, {}), rgb)
    np.testing.assert_array_equal(rgb, trace.frame.rgb)


def test_the_edges_of_a_box_are_cut_at_the_camera() -> None:
    camera = camera_of()
    ahead = Box3D(np.array([0.1, 0, 2.0]), np.eye(3), np.ones(3))
    np.testing.assert_allclose(box_edges_2d(ahead, camera), project(ahead.corners, camera)[EDGES])
    # Edges of an open side have a gap: two lines each.
    assert box_edges_2d(ahead, camera, ("far", "left")).shape == (12 + 7, 2, 2)
    behind = Box3D(np.array([0, 0, -2.0]), np.eye(3), np.ones(3))
    assert box_edges_2d(behind, camera).shape == (0, 2, 2)
    around = Box3D(np.array([0, 1.0, 0]), np.eye(3), np.array([1, 1, 3.0]))
    edges = box_edges_2d(around, camera)
    assert edges.shape == (8, 2, 2)
    assert np.isfinite(edges).all()
    assert (edges[..., 1] > camera.cy).all(), "an edge of a box below the camera is drawn above it"


@given(arrays(np.float64, (5, 2, 3), elements=st.floats(-3, 3)), st.floats(0.05, 2), st.floats(0.1, 0.9))
@settings(max_examples=60)
def test_dashes_lie_on_their_lines_and_reach_both_ends(segments: np.ndarray, period: float, share: float) -> None:
    found = dashed(segments, period, share)
    length = np.linalg.norm(segments[:, 1] - segments[:, 0], axis=1)
    drawn = np.linalg.norm(found[:, 1] - found[:, 0], axis=1)
    at = 0
    for segment, total in zip(segments, length, strict=True):
        count = max(int(np.ceil(total / period)), 1)
        own, at = found[at : at + count], at + count
        np.testing.assert_allclose(own[0, 0], segment[0], atol=1e-5)
        np.testing.assert_allclose(own[-1, 1], segment[1], atol=1e-5)
        along = np.linalg.norm(own - segment[0].astype(np.float32), axis=2)
        assert (np.diff(along.ravel()) >= -1e-5).all()
    assert at == len(found)
    assert drawn.sum() <= length.sum() + 1e-4
    assert (drawn <= period + 1e-5).all()
    assert dashed(np.zeros((0, 2, 3)), 1).shape == (0, 2, 3)
