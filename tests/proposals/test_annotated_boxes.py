"""Annotations with an exact 3D box and no mask: the points inside the box are the object's."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pipeline.answering import PreparedFrame, all_objects, pixels_inside
from pipeline.answering.ask import ask
from pipeline.answering.objects import BOX_MARGIN_M
from pipeline.datasets import open_dataset
from pipeline.geometry import Annotation, Box3D, Camera, Frame, backproject, intrinsics
from pipeline.proposals import AnnotationDetector, Proposals

HEIGHT, WIDTH = 120, 160
CAMERA = Camera(intrinsics(150, 150, 79.5, 59.5), WIDTH, HEIGHT).with_up(np.array([0, -1.0, 0]), "declared")
BOX = Box3D(np.array([0.0, 0.0, 2.0]), np.eye(3), np.array([0.5, 0.5, 0.4]))


def frame(*annotations: Annotation) -> Frame:
    """A board of 0.5 x 0.5 m at 1.9 m before a wall at 3 m."""
    depth = np.full((HEIGHT, WIDTH), 3.0, np.float32)
    v, u = np.mgrid[0:HEIGHT, 0:WIDTH]
    depth[(np.abs(u - 79.5) * 1.9 / 150 < 0.25) & (np.abs(v - 59.5) * 1.9 / 150 < 0.25)] = 1.9
    return Frame("1", np.zeros((HEIGHT, WIDTH, 3), np.uint8), depth, CAMERA, annotations)


def annotation(index: int = 0, box: Box3D | None = BOX, mask: np.ndarray | None = None) -> Annotation:
    return Annotation(index, "board", np.array([40, 20, 120, 100]), mask, box)


def test_points_inside_the_annotated_box_are_lifted_and_the_wall_behind_is_not() -> None:
    context = PreparedFrame(frame(annotation()))
    (found,) = all_objects(context, AnnotationDetector())
    assert found.lifted.quality.mask_source == "box3d"
    assert "no mask: the points inside the annotated 3D box were lifted" in found.lifted.quality.concerns
    assert np.array_equal(found.mask, context.frame.depth < 2)
    assert found.lifted.points[:, 2].max() < 2
    assert found.lifted.box is not None
    # Of a face that is seen flat half its width is taken for its depth.
    assert found.lifted.box.size[2] < 0.6 * found.lifted.box.size[0]
    assert np.abs(found.lifted.box.center[:2]).max() < 0.01


def test_asking_twice_gives_the_same_pixels() -> None:
    context = PreparedFrame(frame(annotation()))
    first, second = (all_objects(context, AnnotationDetector())[0] for _ in range(2))
    assert first.mask is second.mask
    assert first.lifted is second.lifted


@pytest.mark.parametrize("center", [[0, 0, 2.5], [3, 0, 2], [0, 0, -2]])
def test_a_box_without_a_point_leaves_the_2d_box(center: list[float]) -> None:
    box = replace(BOX, center=np.array(center, float))
    (found,) = all_objects(PreparedFrame(frame(annotation(box=box))), AnnotationDetector())
    assert found.lifted.quality.mask_source == "box"
    assert found.mask.sum() == 80 * 80


def test_a_mask_goes_before_the_box_and_no_box_means_the_2d_box() -> None:
    mask = np.zeros((HEIGHT, WIDTH), bool)
    mask[50:70, 60:90] = True
    shown = frame(annotation(0, BOX, mask), annotation(3, None), annotation(7, BOX))
    masked, plain, boxed = all_objects(PreparedFrame(shown), AnnotationDetector())
    assert [o.id for o in (masked, plain, boxed)] == [0, 3, 7]
    assert [o.lifted.quality.mask_source for o in (masked, plain, boxed)] == ["annotation", "box", "box3d"]
    assert np.array_equal(masked.mask, mask)
    assert plain.mask.sum() == 80 * 80
    assert np.array_equal(boxed.mask, shown.depth < 2)


class BoxDetector(AnnotationDetector):
    """A detector that finds 2D boxes by itself: the dataset's 3D boxes are not its own."""

    exact = False

    def fingerprint(self) -> str:
        return "boxes"

    def detect(self, frame: Frame, labels: object) -> Proposals:
        boxes, zero = np.array([[40, 20, 120, 100]], np.float32), np.zeros(1, np.int64)
        return Proposals(boxes, np.ones(1, np.float32), zero, ("board",), None, zero)


def test_a_detectors_2d_box_is_never_cut_by_an_annotated_3d_box() -> None:
    (found,) = all_objects(PreparedFrame(frame(annotation())), BoxDetector())
    assert found.lifted.quality.mask_source == "box"
    assert found.mask.sum() == 80 * 80


@settings(max_examples=30, deadline=None)
@given(
    rotation=st.tuples(*[st.floats(-3, 3)] * 3),
    center=st.tuples(st.floats(-1, 1), st.floats(-1, 1), st.floats(1, 3)),
    size=st.tuples(*[st.floats(0, 2)] * 3),
)
def test_pixels_inside_are_those_whose_points_are(
    rotation: tuple[float, ...], center: tuple[float, ...], size: tuple[float, ...]
) -> None:
    shown = frame()
    shown.depth[::7, ::5] = 0
    box = Box3D(np.array(center), cv2.Rodrigues(np.array(rotation))[0], np.array(size))
    mask = np.zeros((HEIGHT, WIDTH), bool)
    mask[10:, 30:150] = True
    found = pixels_inside(box, mask, shown)
    assert not found[shown.depth == 0].any()
    assert not found[~mask].any()
    v, u = np.nonzero(mask & (shown.depth > 0))
    local = (backproject(shown.depth, CAMERA, v, u) - box.center) @ box.R
    beyond = (np.abs(local) - box.size / 2).max(axis=1)
    assert found[v, u][beyond < BOX_MARGIN_M - 1e-5].all()
    assert not found[v, u][beyond > BOX_MARGIN_M + 1e-5].any()


def test_real_bedroom_is_answered_from_its_boxes(shared_data: Path) -> None:
    dataset = open_dataset(shared_data / "real/sunrgbd-toy")
    context = PreparedFrame(dataset.load("000001"))
    detector = AnnotationDetector(dataset.class_names)
    assert context.viewer.up_source == "declared"
    for found, known in zip(all_objects(context, detector), context.frame.annotations, strict=True):
        assert found.label == known.label
        assert found.lifted.quality.mask_source == "box3d"
        assert known.box is not None
        local = (found.lifted.points - known.box.center) @ known.box.R
        assert (np.abs(local) <= known.box.size / 2 + BOX_MARGIN_M + 1e-5).all()
    for text in ("lamp above the night stand", "ottoman in front of the bed", "bed behind the dresser"):
        trace = ask(context, text, detector, class_names=dataset.class_names)
        assert trace.ranking is not None
        assert trace.ranking.pairs[0].p_relation > 0.9, text
