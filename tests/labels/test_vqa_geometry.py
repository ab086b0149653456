"""Sizes and gaps of questions: unbiased where they are told, and not told where the object does not show them."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from itertools import combinations
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import cv2
import numpy as np
import pytest
from box_worlds import box_world
from scenes import frame_of, upright
from scipy.optimize import lsq_linear
from vqa_check import read_questions, verify_vqa

from pipeline.answering import PreparedFrame, all_objects
from pipeline.datasets import Dataset
from pipeline.geometry import Annotation, Box3D, Frame, viewer_axes
from pipeline.labels import LabelConfig, Labels, VqaConfig, build_table, export_labels, label_objects
from pipeline.labels.exports.base import ExportFrame
from pipeline.labels.exports.vqa_geometry import EXACT, FITTED, HUMAN, POINTS, Depths, Figures, figures_of, gap_between
from pipeline.proposals import AnnotationDetector


def rows_of(frame: Frame) -> ExportFrame:
    """A frame's labels, as an export reads them."""
    context = PreparedFrame(frame)
    config = LabelConfig(second_opinion="none")
    found = label_objects(
        context, all_objects(context, AnnotationDetector()), config, frame_index=0, scene="s", exact=True
    )
    tables = {n: build_table(n, c) for n, c in found.tables().items() if n != "candidates"}
    return ExportFrame(tables["frames"].to_pylist()[0], tables["objects"].to_pylist(), tables["relations"], [])


def depths_of(frame: Frame) -> Depths:
    return Depths(lambda: cast(Dataset, SimpleNamespace(load=lambda name: frame, root=Path("there"))))


def figures(frame: Frame, human: frozenset[int] = frozenset(), config: VqaConfig | None = None) -> list[Figures]:
    return figures_of(rows_of(frame), config or VqaConfig(), depths_of(frame), human)


def worlds(seeds: range) -> Iterator[tuple[Frame, list[tuple[np.ndarray, np.ndarray]]]]:
    """Frames of another maker's rooms without any 3D box, and the exact extents of their objects."""
    for seed in seeds:
        items, exact, _, depth, camera = box_world(seed, 480, 360)
        found = []
        for k, item in enumerate(items):
            assert item.evidence is not None
            mask = item.evidence.full(*depth.shape) > 0
            x, y, w, h = cv2.boundingRect(mask.view(np.uint8))
            found.append(Annotation(k, f"thing {k}", np.array([x, y, x + w, y + h], np.float64), mask))
        yield Frame(f"{seed}", np.zeros((*depth.shape, 3), np.uint8), depth, camera, tuple(found)), exact


@pytest.mark.slow
def test_sizes_without_boxes_are_those_of_the_objects() -> None:
    told: list[np.ndarray] = []
    before: list[np.ndarray] = []
    for frame, exact in worlds(range(300, 307)):
        rows = rows_of(frame)
        for row, one in zip(rows.objects, figures_of(rows, VqaConfig(), depths_of(frame), frozenset()), strict=True):
            lo, hi = exact[row["object"]]
            assert np.isnan(one.extents[2])
            if one.rests_on is not None:
                told.append((one.extents / (hi - lo))[:2])
                before.append(((np.array(row["hi"]) - row["lo"]) / (hi - lo))[:2])
    assert len(told) >= 6
    ratios = np.array(told)
    assert (np.abs(np.nanmedian(ratios, axis=0) - 1) < 0.04).all()
    assert np.mean(np.abs(ratios[~np.isnan(ratios)] - 1) < 0.15) > 0.9
    # The extents that relations are judged by are smaller, width above all.
    assert np.median(before, axis=0)[0] < 0.95


def exact_gap(a: Box3D, b: Box3D) -> float:
    """Metres between two boxes: the least squares of two points, one in each."""
    apart = b.center - a.center
    sides = np.hstack([a.R * (a.size / 2), -b.R * (b.size / 2)])
    return float(np.linalg.norm(sides @ lsq_linear(sides, apart, bounds=(-1, 1)).x - apart))


def boxes_apart() -> tuple[Frame, list[Box3D]]:
    at = ((-0.7, 0.9, 2.0), (0.1, 0.85, 2.1), (0.9, 0.9, 2.2))
    sizes = ((0.4, 0.4, 0.4), (0.3, 0.5, 0.3), (0.35, 0.35, 0.35))
    boxes = [upright(p, s, yaw) for p, s, yaw in zip(at, sizes, (0, 30, 60), strict=True)]
    return frame_of(boxes, ["chair", "table", "box"]), boxes


def without_boxes(frame: Frame) -> Frame:
    return replace(frame, annotations=tuple(replace(a, box=None) for a in frame.annotations))


def test_gaps_and_centres_are_those_between_the_objects() -> None:
    frame, boxes = boxes_apart()
    found = figures(without_boxes(frame))
    assert [f.rests_on for f in found] == [FITTED] * 3
    matrix = viewer_axes(cast(np.ndarray, frame.camera.up)).matrix
    R = viewer_axes(cast(np.ndarray, frame.camera.up)).R_level_camera
    for (i, a), (j, b) in combinations(enumerate(boxes), 2):
        gap = gap_between(found[i], found[j])
        assert gap is not None
        assert gap == pytest.approx(exact_gap(a, b), abs=0.02)
        centers = matrix @ R.T @ (a.center - b.center)
        assert np.linalg.norm(found[i].center - found[j].center) == pytest.approx(np.linalg.norm(centers), abs=0.1)


def test_given_boxes_are_measured_as_given_and_need_no_depth() -> None:
    frame, _ = boxes_apart()
    rows = rows_of(frame)
    given = [a.box for a in frame.annotations]
    if any(box is None for box in given):
        pytest.fail("the scene has exact boxes")
    matrix = viewer_axes(np.array(rows.frame["up"])).matrix
    none = Depths(None)
    for row, one, box in zip(rows.objects, figures_of(rows, VqaConfig(), none, frozenset()), given, strict=True):
        assert one.rests_on == EXACT
        np.testing.assert_allclose(one.extents, np.ptp(cast(Box3D, box).corners @ matrix.T, axis=0))
        assert gap_between(one, one) is None
        person = figures_of(rows, VqaConfig(), none, frozenset({row["object"]}))[row["object"]]
        assert person.rests_on == HUMAN
        said = Box3D(np.array(row["center"]), np.array(row["R"]).reshape(3, 3), np.array(row["size"]))
        np.testing.assert_allclose(person.extents, np.ptp(said.corners @ matrix.T, axis=0))
    assert none.missing == 4


def test_what_does_not_show_is_not_told() -> None:
    frame, _ = boxes_apart()
    bare = without_boxes(frame)
    whole = rows_of(bare)

    def told(**changes: Any) -> Figures:
        rows = replace(whole, objects=[{**whole.objects[0], **changes}, *whole.objects[1:]])
        return figures_of(rows, VqaConfig(), depths_of(bare), frozenset())[0]

    assert told().rests_on == FITTED
    old = told(estimator="gravity")
    assert old.rests_on is None
    assert len(old.points)
    for changes in (
        {"touches_border": True},
        {"occluded": 0.3},
        {"visible": 0.5},
        {"depth_missing": 0.7},
        {"kept": 0.2},
        {"fallback": True},
        {"mask": None},
        {"mask_source": "box"},
        {"mask_source": "box3d"},
    ):
        hidden = told(**changes)
        assert hidden.rests_on is None, changes
        assert not len(hidden.points)
        assert np.isnan(hidden.extents).all()
    # A mask that leaks onto what stands beside: cleaning drops what hangs at another depth.
    row = bare.annotations[0]
    mask = cast(np.ndarray, row.mask).copy()
    spill = np.flatnonzero(mask.any(axis=0))[-1]
    rows_in = np.flatnonzero(mask.any(axis=1))
    mask[rows_in[len(rows_in) // 2] : rows_in[len(rows_in) // 2] + 6, spill : spill + 30] = True
    leaked = replace(bare, annotations=(replace(row, mask=mask), *bare.annotations[1:]))
    width, clean = figures(leaked)[0].extents[0], figures(bare)[0].extents[0]
    assert width == pytest.approx(clean, rel=0.1)


def test_another_depth_is_not_measured() -> None:
    frame, _ = boxes_apart()
    bare = without_boxes(frame)
    other = replace(bare, depth=bare.depth * np.float32(1.01))
    depths = depths_of(other)
    found = figures_of(rows_of(bare), VqaConfig(), depths, frozenset())
    assert all(f.rests_on == FITTED and not len(f.points) for f in found)
    assert depths.missing == 1
    assert "another depth than was labelled" in depths.problem


@pytest.mark.slow
def test_an_export_without_the_dataset_says_what_is_not_asked(label_sets: dict[str, Labels], tmp_path: Path) -> None:
    labels = label_sets["demo"]
    config = VqaConfig(per_frame=200, kinds=("distance", "size"))
    report = export_labels(labels, "vqa", tmp_path / "with", options=config)
    assert report.notes == ()
    asked = list(read_questions(tmp_path / "with"))
    assert {q.about for q in asked} == {"center", "gap", "width", "height"}
    assert {q.rests_on for q in asked if q.about == "gap"} == {POINTS}
    assert {q.rests_on for q in asked if q.kind == "size"} == {EXACT}
    assert verify_vqa(tmp_path / "with", labels, config) == []
    gone = labels.manifest.model_copy(update={"dataset": {**labels.manifest.dataset, "path": str(tmp_path / "gone")}})
    report = export_labels(replace(labels, manifest=gone), "vqa", tmp_path / "without", options=config)
    (note,) = report.notes
    assert "without depth" in note
    assert "there is no such dataset" in note
    without = list(read_questions(tmp_path / "without"))
    assert without
    assert {q.about for q in without} == {"center", "width", "height"}
