"""Pictures of answers: written whole or not at all, and true to what they show."""

from __future__ import annotations

import os
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scenes import camera_of
from test_ask import _own_cache, row, truth
from test_whatif_region import FRAME
from whatif_scenes import context_of, source

from pipeline.answering.ask import Trace, ask
from pipeline.diagnosis.whatif import Baseline, Edits
from pipeline.geometry.boxes import EDGES, Box3D
from pipeline.geometry.camera import project
from pipeline.geometry.frame import Frame
from pipeline.geometry.palette import ON_DARK
from pipeline.proposals import AnnotationDetector
from pipeline.system.errors import InputError
from spatialviz.report.picture import answer_picture, box_edges_2d, dashed, save_picture, tinted, write_picture


@pytest.fixture(scope="module")
def trace(row: Frame, truth: AnnotationDetector) -> Trace:
    return ask(row, "mug right of the laptop", truth)


def test_a_picture_is_saved_whole(trace: Trace, tmp_path: Path) -> None:
    for name in ("answer.png", "answer.jpg"):
        save_picture(trace, tmp_path / name)
        image = cv2.imread(str(tmp_path / name))
        assert image is not None
        assert image.shape[1] == trace.frame.width
        assert image.shape[0] > trace.frame.height
    assert sorted(p.name for p in tmp_path.iterdir()) == ["answer.jpg", "answer.png"]
    png = cv2.imread(str(tmp_path / "answer.png"))
    assert png is not None
    np.testing.assert_array_equal(png[..., ::-1], answer_picture(trace))


def test_a_picture_that_cannot_be_saved_leaves_nothing(trace: Trace, tmp_path: Path) -> None:
    (tmp_path / "folder.png").mkdir()
    for path, message in (
        (tmp_path / "absent" / "x.png", "folder for the picture does not exist"),
        (tmp_path / "x.txt", "picture of this kind.*.txt.*png"),
        (tmp_path / "x", "picture of this kind"),
        (tmp_path / "folder.png", "cannot be written"),
    ):
        with pytest.raises(InputError, match=message) as caught:
            save_picture(trace, path)
        assert "\n" not in str(caught.value)
    assert [p.name for p in tmp_path.iterdir()] == ["folder.png"]
    with pytest.raises(InputError, match="cannot be written"):
        save_picture(trace, Path("/proc/answer.png"))


def test_a_failed_save_keeps_the_old_picture(trace: Trace, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "a.png"
    path.write_bytes(b"old")

    def full(number: int) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(InputError, match="No space left"):
        save_picture(trace, path)
    assert path.read_bytes() == b"old"
    assert [p.name for p in tmp_path.iterdir()] == ["a.png"]


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


def test_every_kind_of_answer_has_a_picture(row: Frame, truth: AnnotationDetector) -> None:
    shapes = set()
    for text in (
        "mug between the book and the laptop",
        "lamp left of the mug",
        "laptop left of the laptop",
        "mug left of a mug",
    ):
        image = answer_picture(ask(row, text, truth))
        assert image.dtype == np.uint8
        shapes.add(image.shape)
    assert len(shapes) == 1
    mask = row.annotations[3].mask
    assert mask is not None
    blind = Frame(row.id, row.rgb, np.where(mask, 0, row.depth), row.camera, row.annotations)
    assert answer_picture(ask(blind, "book left of the laptop", truth)).shape in shapes


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
