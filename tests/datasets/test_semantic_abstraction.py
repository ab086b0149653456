"""The reader of Semantic Abstraction's HDF5 views: round trips of rendered rooms, splits, hostile input."""

from __future__ import annotations

import pickle
from pathlib import Path

import h5py
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from semantic_abstraction_checks import VIEW, editing, pose, refused, view  # noqa: F401
from semantic_abstraction_writer import TRUE_POSE, ViewTruth, Written, scene_pose, write_view
from slow_cases import mostly_slow

from pipeline.answering import open_pipeline
from pipeline.datasets import GivenExpression, Settings, given_expressions, has_moves, open_dataset
from pipeline.datasets.semantic_abstraction import RELATIONS, SemanticAbstractionDataset
from pipeline.datasets.semantic_abstraction_objects import fit_pose
from pipeline.datasets.semantic_abstraction_splits import (
    RANDOMIZED,
)
from pipeline.geometry import Frame, backproject, to_world
from pipeline.language import VOCABULARIES


def up(frame: Frame) -> np.ndarray:
    assert frame.camera.up is not None
    return frame.camera.up


# Reading back


@pytest.mark.parametrize("seed", mostly_slow([0, 1, 2]))
def test_a_view_is_read_back(tmp_path: Path, seed: int) -> None:
    truth = write_view(tmp_path / f"{VIEW}.hdf5", seed=seed)
    dataset = open_dataset(tmp_path)
    assert dataset.format == "semantic-abstraction"
    assert dataset.frame_ids == (VIEW,)
    assert "ceiling" in dataset.class_names
    assert not {"empty", "out of bounds"} & set(dataset.class_names)
    frame = dataset.load(VIEW)
    assert np.array_equal(frame.rgb, truth.rgb)
    assert np.array_equal(frame.depth, truth.depth)
    assert frame.camera.fx == pytest.approx(80 / np.tan(np.deg2rad(40)))
    assert frame.camera.cx == 80
    assert {a.index: a.label for a in frame.annotations} == truth.labels
    for a in frame.annotations:
        assert a.instance == a.index
        assert a.mask is not None
        assert np.array_equal(a.mask, truth.seg == a.index)
        rows, columns = np.nonzero(a.mask)
        assert a.bbox.tolist() == [columns.min(), rows.min(), columns.max() + 1, rows.max() + 1]


@pytest.mark.slow
@pytest.mark.parametrize("how", ["literal", "proper", "opengl", "inverse", "metres"])
@pytest.mark.parametrize("seed", mostly_slow([0, 1, 2]))
def test_the_pose_is_the_one_under_which_depth_and_points_agree(tmp_path: Path, how: Written, seed: int) -> None:
    write_view(tmp_path / f"{VIEW}.hdf5", how=how, seed=seed)
    frame = open_dataset(tmp_path).load(VIEW)
    np.testing.assert_allclose(pose(frame), TRUE_POSE, atol=1e-6)
    assert frame.camera.up_source == "declared"
    np.testing.assert_allclose(up(frame), [0, -1, 0], atol=1e-9)
    assert len(frame.notes) == (how != "proper")


def test_points_that_hang_upside_down_are_mirrored_as_a_whole(tmp_path: Path) -> None:
    write_view(tmp_path / f"{VIEW}.hdf5", how="proper")
    right = open_dataset(tmp_path).load(VIEW)
    write_view(tmp_path / f"{VIEW}.hdf5", how="points-down")
    frame = open_dataset(tmp_path).load(VIEW)
    np.testing.assert_allclose(pose(frame)[:3, :3], TRUE_POSE[:3, :3], atol=1e-9)
    np.testing.assert_allclose(up(frame), [0, -1, 0], atol=1e-9)
    for a, b in zip(frame.annotations, right.annotations, strict=True):
        assert (a.box is None) == (b.box is None)
        if a.box is not None and b.box is not None:
            np.testing.assert_allclose(a.box.center, b.box.center, atol=1e-5)
            np.testing.assert_allclose(a.box.size, b.box.size, atol=1e-5)


def test_no_pose_is_better_than_a_wrong_one(tmp_path: Path) -> None:
    write_view(tmp_path / f"{VIEW}.hdf5", how="nonsense")
    frame = open_dataset(tmp_path).load(VIEW)
    assert frame.camera.T_world_camera is None
    assert frame.camera.up is None
    assert frame.annotations
    assert all(a.box is None for a in frame.annotations)
    assert "no camera pose" in frame.notes[0]


def test_boxes_hold_the_whole_object_in_metres(view: tuple[Path, ViewTruth]) -> None:
    path, truth = view
    frame = open_dataset(path.parent).load(VIEW)
    T = pose(frame)
    boxed = [a for a in frame.annotations if a.box is not None]
    assert len(boxed) > 15
    for a in boxed:
        assert a.box is not None
        world = truth.world[a.index]
        corners = to_world(a.box.corners, T)
        np.testing.assert_allclose(corners.min(axis=0), world.min(axis=0), atol=1e-5)
        np.testing.assert_allclose(corners.max(axis=0), world.max(axis=0), atol=1e-5)
        assert np.linalg.det(a.box.R) == pytest.approx(1)
    few = [a for a in frame.annotations if a.box is None]
    assert all(len(truth.world[a.index]) < 20 for a in few)
    judged = 0
    # Objects wholly inside the scene's bounds: what is seen of them lies in their box, but for the sensor's noise.
    for a in boxed:
        assert a.box is not None
        assert a.mask is not None
        v, u = np.nonzero(a.mask & (frame.depth > 0))
        local = to_world(backproject(frame.depth, frame.camera, v, u), T) - T[:3, :3] @ a.box.center - T[:3, 3]
        half = np.abs((T[:3, :3] @ a.box.R) @ np.diag(a.box.size / 2)).sum(axis=1)
        inside = (np.abs(local) <= half + 0.08).all(axis=1)
        low, high = truth.world[a.index].min(axis=0), truth.world[a.index].max(axis=0)
        lowest, highest = np.array([[-1, -1, -0.1], [1, 1, 1.9]]) / 0.6
        if (low > lowest + 0.02).all() and (high < highest - 0.02).all() and len(v) > 50:
            assert inside.mean() > 0.9, a.label
            judged += 1
    assert judged > 5


def test_a_file_of_several_items_has_a_frame_each(tmp_path: Path) -> None:
    truth = write_view(tmp_path / f"sub/{VIEW}.hdf5", items=2)
    dataset = open_dataset(tmp_path)
    assert dataset.frame_ids == (f"sub/{VIEW}/0", f"sub/{VIEW}/1")
    first, second = (dataset.load(frame_id) for frame_id in dataset.frame_ids)
    assert np.array_equal(first.rgb, truth.rgb)
    assert np.array_equal(second.rgb, truth.rgb[::-1])
    assert np.array_equal(second.depth, truth.depth[::-1])
    assert np.array_equal(pickle.loads(pickle.dumps(dataset)).load(first.id).depth, first.depth)


def test_randomised_materials_are_another_picture_of_the_same_view(tmp_path: Path) -> None:
    truth = write_view(tmp_path / f"{VIEW}.hdf5", randomized=True)
    write_view(tmp_path / "00008|FloorPlan1_physics.hdf5")
    dataset = open_dataset(tmp_path)
    assert dataset.frame_ids == (VIEW, "00008|FloorPlan1_physics")
    frame = dataset.load(VIEW + RANDOMIZED)
    assert np.array_equal(frame.rgb, 255 - truth.rgb)
    assert np.array_equal(frame.depth, truth.depth)
    refused(lambda: dataset.load(f"00008|FloorPlan1_physics{RANDOMIZED}"), "randomised materials")
    refused(lambda: dataset.load("nowhere"), "no frame")


def test_told_settings_win(view: tuple[Path, ViewTruth]) -> None:
    dataset = open_dataset(view[0].parent, intrinsics=(90, 91, 79, 81), depth_scale=2)
    frame = dataset.load(VIEW)
    assert frame.camera.K[1].tolist() == [0, 91, 81]
    assert np.array_equal(frame.depth, view[1].depth / np.float32(2))


def test_views_are_told_from_other_folders(tmp_path: Path) -> None:
    write_view(tmp_path / "train" / f"{VIEW}.hdf5")
    assert open_dataset(tmp_path).frame_ids == (f"train/{VIEW}",)
    for other in ("tum", "notes"):
        (tmp_path / other).mkdir()
    refused(lambda: open_dataset(tmp_path), "no dataset is recognised", "a folder of")
    (tmp_path / "vool_split.json").write_text('{"train": []}')
    assert open_dataset(tmp_path).frame_ids == (f"train/{VIEW}",)
    renamed = tmp_path / "renamed"
    write_view(renamed / "kitchen.hdf5")
    assert open_dataset(renamed).frame_ids == ("kitchen",)
    other = tmp_path / "other"
    other.mkdir()
    with h5py.File(other / "table.hdf5", "w") as file:
        file["x"] = np.zeros(3)
    refused(lambda: open_dataset(other), "no dataset is recognised")


def test_questions_are_answered(view: tuple[Path, ViewTruth]) -> None:
    source = open_pipeline(view[0].parent)
    assert not has_moves(source.dataset)
    trace = source.ask(source.dataset.load(VIEW), "mug left of the laptop")
    assert trace.ranking is not None
    assert trace.viewer.up_source == "declared"


# Given expressions

ROWS = [
    ("mug", 0, "on the left of", "laptop"),
    ("laptop", 0, "on", "desk"),
    ("banana", 90, "in", "desk"),
    ("mug", 0, "[pad]", "laptop"),
    ("book", -2, "behind", "mug"),
]


def rows_of(truth: ViewTruth) -> list[tuple[str, int, str, str]]:
    ids = {label: number for number, label in truth.labels.items()}
    return [(t, n or ids[t], r, ref) for t, n, r, ref in ROWS]


@pytest.mark.parametrize("in_references", [False, True])
def test_the_datasets_own_expressions_are_given(tmp_path: Path, in_references: bool) -> None:
    path = tmp_path / f"{VIEW}.hdf5"
    truth = write_view(path)
    rows = rows_of(truth)
    write_view(path, descriptions=rows, in_references=in_references)
    found = given_expressions(open_dataset(tmp_path), VIEW)

    def of(label: str) -> tuple[int, ...]:
        return tuple(number for number, name in truth.labels.items() if name == label)

    assert len(of("mug")) > 1
    assert found == (
        GivenExpression("mug on the left of a laptop", "mug", "left", "laptop", (rows[0][1],), of("laptop")),
        GivenExpression("laptop on a desk", "laptop", "on", "desk", (rows[1][1],), of("desk")),
        GivenExpression("banana in a desk", "banana", "in", "desk", (), of("desk")),
        GivenExpression("book behind a mug", "book", "behind", "mug", of("book"), of("mug")),
    )
    frame = open_dataset(tmp_path).load(VIEW)
    assert {i for e in found for i in (*e.target_indices, *e.reference_indices)} <= {a.index for a in frame.annotations}


def test_relations_are_those_of_our_vocabulary() -> None:
    assert set(RELATIONS.values()) == set(VOCABULARIES["semantic-abstraction"])


def test_a_view_without_expressions_gives_none(view: tuple[Path, ViewTruth]) -> None:
    assert given_expressions(open_dataset(view[0].parent), VIEW) == ()


def test_lists_of_different_length_are_refused(tmp_path: Path) -> None:
    path = tmp_path / f"{VIEW}.hdf5"
    write_view(path, descriptions=[("mug", 4, "on", "desk")] * 3)
    with editing(path) as file:
        del file["data/descriptions/target_obj_id"]
        file["data/descriptions/target_obj_id"] = np.arange(2)
    dataset = open_dataset(tmp_path)
    refused(lambda: given_expressions(dataset, VIEW), "differ in length", VIEW)
    assert dataset.load(VIEW).annotations


# The fit of the pose


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 2**32 - 1), st.sampled_from(["literal", "proper", "opengl", "inverse", "metres"]))
def test_any_scene_of_blobs_gives_the_true_pose(seed: int, how: Written) -> None:
    """Twelve objects anywhere in the scene: no convention but the true one puts all of them onto themselves."""
    rng = np.random.default_rng(seed)
    middles = rng.uniform([-0.9, -0.9, 0.0], [0.9, 0.9, 1.8], (12, 3))
    owner = np.repeat(np.arange(12), 200)
    points = middles[owner] + rng.normal(0, 0.03, (len(owner), 3))
    camera = (points / 0.6 - TRUE_POSE[:3, 3]) @ TRUE_POSE[:3, :3]
    found = fit_pose(scene_pose(how), camera[::7], owner[::7], points, owner)
    np.testing.assert_allclose(found.T_world_camera, TRUE_POSE, atol=1e-6)
    np.testing.assert_allclose(found.up, [0, -1, 0], atol=1e-9)
    np.testing.assert_allclose(found.to_world(points), points / 0.6, atol=1e-9)
    assert found.share > 0.9


def test_recognising_needs_no_settings(tmp_path: Path) -> None:
    write_view(tmp_path / f"{VIEW}.hdf5")
    assert SemanticAbstractionDataset(tmp_path, Settings()).frame_ids == (VIEW,)
