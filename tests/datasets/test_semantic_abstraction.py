"""The reader of Semantic Abstraction's HDF5 views: round trips of rendered rooms, splits, hostile input."""

from __future__ import annotations

import contextlib
import json
import os
import pickle
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from semantic_abstraction_subsets import novel_class, novel_room, novel_visual, novel_vocabulary
from semantic_abstraction_writer import TRUE_POSE, ViewTruth, Written, scene_pose, write_view

from pipeline.answering.opening import open_pipeline
from pipeline.datasets import GivenExpression, given_expressions, has_moves, open_dataset, splits, survey
from pipeline.datasets.semantic_abstraction import RELATIONS, SemanticAbstractionDataset
from pipeline.datasets.semantic_abstraction_file import (
    NOVEL_CLASSES,
    RANDOMIZED,
    RENAMED,
    SUBSETS,
    SYNONYMS,
    read_split,
    subsets_of,
    with_synonyms,
)
from pipeline.datasets.semantic_abstraction_objects import fit_pose
from pipeline.datasets.settings import Settings
from pipeline.geometry.camera import backproject, to_world
from pipeline.geometry.frame import Frame
from pipeline.language.relation_names import VOCABULARIES
from pipeline.system.errors import InputError

VIEW = "00007|FloorPlan201_physics"


def refused(action: Callable[[], object], *words: str) -> None:
    with pytest.raises(InputError) as caught:
        action()
    message = str(caught.value)
    assert "\n" not in message
    for word in words:
        assert word in message, message


def opened(root: Path) -> SemanticAbstractionDataset:
    dataset = open_dataset(root)
    assert isinstance(dataset, SemanticAbstractionDataset)
    return dataset


def pose(frame: Frame) -> np.ndarray:
    assert frame.camera.T_world_camera is not None
    return frame.camera.T_world_camera


def up(frame: Frame) -> np.ndarray:
    assert frame.camera.up is not None
    return frame.camera.up


@contextlib.contextmanager
def editing(path: Path) -> Iterator[Any]:
    """A file that a test changes; h5py's own types leave open what an entry is."""
    with h5py.File(path, "a") as file:
        yield file


@pytest.fixture
def view(tmp_path: Path) -> tuple[Path, ViewTruth]:
    path = tmp_path / f"{VIEW}.hdf5"
    return path, write_view(path)


# Reading back


@pytest.mark.parametrize("seed", [0, 1, 2])
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


@pytest.mark.parametrize("how", ["literal", "proper", "opengl", "inverse", "metres"])
@pytest.mark.parametrize("seed", [0, 1, 2])
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
        local = (to_world(backproject(frame.depth, frame.camera, v, u), T) - T[:3, :3] @ a.box.center - T[:3, 3])
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
    refused(lambda: open_dataset(tmp_path), "no dataset is recognised", "FloorPlan")
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


# Splits

TEST_VIEW = "00009|FloorPlan30_physics"
TABLE = {
    "train": [f"{VIEW}.hdf5"],
    "unseen_instances": [f"{TEST_VIEW}.hdf5", "../outside.hdf5", "/etc/outside.hdf5", "not here.hdf5"],
    "unseen_instances_dr": [f"{TEST_VIEW}.hdf5"],
    "unseen_instances_synonyms": [f"{TEST_VIEW}.hdf5"],
}


@pytest.fixture(params=["json", "pkl", "pkl2"])
def divided(request: pytest.FixtureRequest, tmp_path: Path) -> Path:
    write_view(tmp_path / f"{VIEW}.hdf5")
    described = [("laptop", 5, "on", "desk"), ("mug", 6, "on", "desk"), ("book", 7, "behind", "lamp")]
    write_view(tmp_path / f"{TEST_VIEW}.hdf5", descriptions=described, randomized=True)
    (tmp_path.parent / "outside.hdf5").write_bytes(b"outside")
    if request.param == "json":
        (tmp_path / "vool_split.json").write_text(json.dumps(TABLE))
    else:
        table = TABLE if request.param == "pkl" else {name: set(files) for name, files in TABLE.items()}
        (tmp_path / "vool_split.pkl").write_bytes(pickle.dumps(table, protocol=4 if request.param == "pkl" else 2))
    return tmp_path


def test_splits_name_frames_that_are_here(divided: Path) -> None:
    assert splits(open_dataset(divided)) == {
        "vool/train": (VIEW,),
        "vool/unseen_instances": (TEST_VIEW,),
        "vool/unseen_instances_dr": (TEST_VIEW + RANDOMIZED,),
        "vool/unseen_instances_synonyms": (TEST_VIEW + RENAMED,),
    }


def test_the_four_subsets(divided: Path) -> None:
    dataset = opened(divided)

    def texts(found: Any) -> list[tuple[str, str]]:
        return [(item.frame_id, item.expression.text) for item in found]

    plain = ["laptop on a desk", "book behind a lamp"]
    assert texts(novel_room(dataset)) == [(TEST_VIEW, text) for text in plain]
    assert texts(novel_visual(dataset)) == [(TEST_VIEW + RANDOMIZED, text) for text in plain]
    assert texts(novel_vocabulary(dataset)) == [(TEST_VIEW + RENAMED, "computer on a desk")]
    assert texts(novel_class(dataset)) == [
        (TEST_VIEW, "mug on a desk"),
        (TEST_VIEW + RANDOMIZED, "mug on a desk"),
        (TEST_VIEW + RENAMED, "mug on a desk"),
    ]
    assert [item.split for item in novel_class(dataset)] == list(TABLE)[1:]
    assert list(novel_room(dataset, "ssc")) == []
    everything = [*novel_room(dataset), *novel_visual(dataset), *novel_vocabulary(dataset), *novel_class(dataset)]
    for name, chosen in zip(SUBSETS, (novel_visual, novel_vocabulary, novel_class), strict=True):
        by_id = {(x.frame_id, x.expression.text) for x in everything
                 if name in subsets_of(x.frame_id, x.expression.target, x.expression.reference)}  # fmt: skip
        assert by_id == set(texts(chosen(dataset)))
    assert dataset.load(next(novel_visual(dataset)).frame_id).annotations


def test_a_view_with_other_names_is_the_same_view(tmp_path: Path) -> None:
    write_view(tmp_path / f"{TEST_VIEW}.hdf5")
    dataset = opened(tmp_path)
    plain, renamed = (dataset.load(TEST_VIEW + end) for end in ("", RENAMED))
    assert np.array_equal(plain.rgb, renamed.rgb)
    assert np.array_equal(plain.depth, renamed.depth)
    names = [(a.label, b.label) for a, b in zip(plain.annotations, renamed.annotations, strict=True)]
    assert [SYNONYMS.get(own, own) for own, _ in names] == [other for _, other in names]
    assert any(own != other for own, other in names)
    assert dataset.scene_of(TEST_VIEW + RENAMED) == "FloorPlan30"
    assert dataset.scene_of("view_of_a_room") is None


def test_synonyms_and_novel_classes_are_the_published_ones() -> None:
    assert len(SYNONYMS) == 17
    assert len(NOVEL_CLASSES) == 6
    expression = GivenExpression("sofa in front of a laptop", "sofa", "front", "laptop", (1,), (2, 3))
    changed = with_synonyms(expression)
    assert changed == GivenExpression("couch in front of a computer", "couch", "front", "computer", (1,), (2, 3))
    unknown = GivenExpression("mug on a desk", "mug", "on", "desk")
    assert with_synonyms(unknown) == unknown


class Malicious:
    """A pickle of it makes a file when it is loaded the usual way."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def __reduce__(self) -> Any:
        return Path.touch, (self.path,)


class Shell(Malicious):
    def __reduce__(self) -> Any:
        return os.system, (f"touch '{self.path}'",)


class Evaluated(Malicious):
    def __reduce__(self) -> Any:
        return eval, (f"open({str(self.path)!r}, 'w')",)


@pytest.mark.parametrize("kind", [Malicious, Shell, Evaluated])
@pytest.mark.parametrize("protocol", [0, 2, 4, 5])
def test_a_pickle_with_code_is_refused_and_not_run(
    view: tuple[Path, ViewTruth], kind: type[Malicious], protocol: int
) -> None:
    root = view[0].parent
    mark = root / "was run"
    data = pickle.dumps({"train": [kind(mark)]}, protocol)
    pickle.loads(data)
    assert mark.exists(), "the pickle is harmless, and proves nothing"
    mark.unlink()
    (root / "vool_split.pkl").write_bytes(data)
    dataset = open_dataset(root)
    refused(lambda: splits(dataset), "the pickle asks for", "nothing of this one was run", "vool_split.pkl")
    assert not mark.exists()
    assert dataset.load(VIEW).annotations


@pytest.mark.parametrize(
    "data",
    [
        b"",
        b"\x80\x04",
        b"garbage",
        pickle.dumps([1, 2]),
        pickle.dumps({"train": "abc"}),
        pickle.dumps({"train": [1]}),
        pickle.dumps({1: []}),
        pickle.dumps({"train": [f"{VIEW}.hdf5"]})[:-4],
        pickle.dumps({"train": [np.str_("a.hdf5")]}),
        b"\x80\x04\x8c\x08builtins\x8c\x06getattr\x93.",
        b"\x82\x01.",
        b"P123\n.",
        b"\x80\x04]r\xff\xff\xff\x7f.",
    ],
)
def test_a_pickle_that_is_no_table_of_lists_is_refused(tmp_path: Path, data: bytes) -> None:
    (tmp_path / "ssc_split.pkl").write_bytes(data)
    refused(lambda: read_split(tmp_path / "ssc_split.pkl"), "ssc_split.pkl")


@settings(max_examples=150, deadline=None)
@given(st.binary(max_size=60))
def test_any_bytes_are_a_table_or_refused(tmp_path_factory: pytest.TempPathFactory, data: bytes) -> None:
    path = tmp_path_factory.getbasetemp() / "any_split.pkl"
    path.write_bytes(data)
    with contextlib.suppress(InputError):
        assert isinstance(read_split(path), dict)


# Hostile files


def changed(path: Path, change: Callable[[Any], None]) -> Any:
    with editing(path) as file:
        change(file)
    return open_dataset(path.parent)


def replace(file: Any, name: str, value: Any) -> None:
    del file[name]
    if name in file["data"] and name not in ("data",):
        del file[f"data/{name}"]
    if value is not None:
        file[name] = value


@pytest.mark.parametrize("share", [0.0, 0.01, 0.3, 0.7, 0.99])
def test_a_cut_file_breaks_its_frame_only(view: tuple[Path, ViewTruth], share: float) -> None:
    path = view[0]
    other = path.parent / "00001|FloorPlan2_physics.hdf5"
    write_view(other)
    path.write_bytes(path.read_bytes()[: int(path.stat().st_size * share)])
    reports = list(survey(open_dataset(path.parent)))
    assert [r.ok for r in reports] == [True, False]
    assert VIEW in str(reports[1].problem)
    assert "cannot be read" in str(reports[1].problem)


@pytest.mark.parametrize(
    ("name", "value", "word"),
    [
        ("rgb", None, "rgb is missing"),
        ("depth", None, "depth is missing"),
        ("data/cam_intr", None, "cam_intr is missing"),
        ("rgb", np.zeros((1, 160, 160), np.uint8), "rgb has another form"),
        ("rgb", np.zeros((1, 160, 160, 4), np.uint8), "rgb has another shape"),
        ("rgb", np.zeros((1, 160, 160, 3), np.float32), "rgb has another form"),
        ("rgb", np.zeros((0, 160, 160, 3), np.uint8), "rgb has no item 0"),
        ("rgb", np.zeros((1, 0, 160, 3), np.uint8), "size"),
        ("rgb", "a text", "rgb has another form"),
        ("depth", np.ones((1, 80, 160), np.float32), "depth has another shape"),
        ("depth", np.ones((1, 160, 160), np.int32), "depth has another form"),
        ("depth", np.full((1, 160, 160), np.nan, np.float32), "no usable depth"),
        ("depth", np.full((1, 160, 160), 1500, np.float32), "wrong unit"),
        ("seg", np.zeros((1, 80, 160), np.int32), "seg has another shape"),
        ("seg", np.arange(160 * 160).reshape(1, 160, 160), "no segmentation"),
        ("seg", np.full((1, 160, 160), 2**40), "no segmentation"),
        ("data/cam_intr", np.eye(4), "cam_intr has another form"),
        ("data/cam_intr", -np.eye(3), "focal lengths"),
        ("data/cam_intr", np.full((3, 3), np.nan), "not finite"),
    ],
)
def test_what_a_frame_cannot_do_without_is_named(
    view: tuple[Path, ViewTruth], name: str, value: Any, word: str
) -> None:
    dataset = changed(view[0], lambda file: replace(file, name, value))
    refused(lambda: dataset.load(VIEW), word if word != "no segmentation" else "cannot be a segmentation", VIEW)


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("data/cam_pose", None),
        ("data/cam_pose", np.eye(3)),
        ("data/cam_pose", np.zeros((4, 4))),
        ("data/cam_pose", np.full((4, 4), np.nan)),
        ("data/cam_pose", np.diag([1.0, 2, 3, 1])),
        ("full_xyz_pts", None),
        ("full_xyz_pts", np.zeros((1, 0, 3), np.float32)),
        ("full_xyz_pts", np.full((1, 20_000, 3), np.nan, np.float32)),
        ("full_xyz_pts", np.full((1, 20_000, 3), 1e30, np.float32)),
        ("full_xyz_pts", np.zeros((1, 20_000, 2), np.float32)),
        ("full_objid_pts", None),
        ("full_objid_pts", np.zeros((1, 10), np.int32)),
        ("full_objid_pts", np.full((1, 20_000), -1, np.int32)),
        ("full_objid_pts", np.full((1, 20_000), 2**40)),
    ],
)
def test_without_a_usable_scene_there_is_a_frame_without_pose(
    view: tuple[Path, ViewTruth], name: str, value: Any
) -> None:
    frame = changed(view[0], lambda file: replace(file, name, value)).load(VIEW)
    assert frame.camera.T_world_camera is None
    assert {a.index: a.label for a in frame.annotations} == view[1].labels
    assert all(a.box is None for a in frame.annotations)
    assert "no camera pose" in frame.notes[0]


def test_some_bad_values_are_only_left_out(view: tuple[Path, ViewTruth]) -> None:
    path, truth = view
    with editing(path) as file:
        file["depth"][0, :20] = np.nan
        file["depth"][0, 20:30] = -1
        file["depth"][0, 30:40] = np.inf
        file["full_xyz_pts"][0, ::50] = np.nan
        del file["data/scene_bounds"]
        file["data/scene_bounds"] = np.full((2, 3), np.inf)
    frame = open_dataset(path.parent).load(VIEW)
    assert not frame.depth[:40].any()
    assert np.array_equal(frame.depth[40:], truth.depth[40:])
    np.testing.assert_allclose(pose(frame), TRUE_POSE, atol=1e-6)


def test_objects_without_classes_are_named_by_their_ids(view: tuple[Path, ViewTruth]) -> None:
    path, truth = view
    numbers = list(truth.labels)
    with editing(path) as file:
        names = file["data/objid_to_class"][()]
        del file["data/objid_to_class"]
        file["data/objid_to_class"] = names[: numbers[-1]]
    frame = open_dataset(path.parent).load(VIEW)
    assert frame.annotations[-1].label == f"object_{numbers[-1]}"
    assert "1 objects have no class" in frame.notes[0]
    with editing(path) as file:
        del file["data/objid_to_class"]
    frame = open_dataset(path.parent).load(VIEW)
    assert [a.label for a in frame.annotations] == [f"object_{number}" for number in numbers]
    assert open_dataset(path.parent).class_names == ()
    with editing(path) as file:
        replace(file, "seg", None)
    frame = open_dataset(path.parent).load(VIEW)
    assert frame.annotations == ()
    assert "seg is missing" in frame.notes[0]


def test_names_may_be_plain_and_stand_at_other_places(view: tuple[Path, ViewTruth]) -> None:
    path, truth = view
    with editing(path) as file:
        names = file["data/objid_to_class"][()]
        del file["data/objid_to_class"]
        file["data/objid_to_class"] = names[::-1]
    assert {a.index: a.label for a in open_dataset(path.parent).load(VIEW).annotations} == truth.labels
    with editing(path) as file:
        del file["data/objid_to_class"]
        plain = [name.partition(b"[")[0].decode() for name in names]
        file["data/objid_to_class"] = np.array(plain, object)
    assert {a.index: a.label for a in open_dataset(path.parent).load(VIEW).annotations} == truth.labels


def outside(file: Any, path: Path, how: str) -> None:
    other = path.parent / "secret.bin"
    with h5py.File(other, "w") as secret:
        secret["rgb"] = np.zeros((1, 160, 160, 3), np.uint8)
    del file["rgb"], file["data/rgb"]
    if how == "link":
        file["rgb"] = h5py.ExternalLink(str(other), "/rgb")
    elif how == "dangling link":
        file["rgb"] = h5py.ExternalLink("/nowhere/at/all.h5", "/rgb")
    elif how == "soft link":
        file["rgb"] = h5py.SoftLink("/depth")
    elif how == "external storage":
        raw = path.parent / "secret.raw"
        raw.write_bytes(bytes(160 * 160 * 3))
        file.create_dataset("rgb", (1, 160, 160, 3), np.uint8, external=[(str(raw), 0, 160 * 160 * 3)])
    else:
        layout = h5py.VirtualLayout((1, 160, 160, 3), np.uint8)
        layout[:] = h5py.VirtualSource(str(other), "rgb", (1, 160, 160, 3))
        file.create_virtual_dataset("rgb", layout)


@pytest.mark.parametrize("how", ["link", "dangling link", "soft link", "external storage", "virtual"])
def test_nothing_is_read_through_a_file_from_another(view: tuple[Path, ViewTruth], how: str) -> None:
    path = view[0]
    dataset = changed(path, lambda file: outside(file, path, how))
    refused(lambda: dataset.load(VIEW), "rgb", VIEW)


@pytest.mark.parametrize("how", ["other", "part", "empty", "few"])
def test_a_reference_to_something_else_is_refused(view: tuple[Path, ViewTruth], how: str) -> None:
    def change(file: Any) -> None:
        del file["data/rgb"]
        made = file.create_dataset("data/rgb", (0 if how == "few" else 1,), dtype=h5py.regionref_dtype)
        if how == "other":
            made[0] = file["depth"].regionref[0, ...]
        elif how == "part":
            made[0] = file["rgb"].regionref[0, :10]

    dataset = changed(view[0], change)
    refused(lambda: dataset.load(VIEW), "data/rgb")


def test_a_claim_of_a_huge_picture_is_refused_before_it_is_read(view: tuple[Path, ViewTruth]) -> None:
    def change(file: Any) -> None:
        del file["rgb"], file["data/rgb"]
        file.create_dataset("rgb", (1, 400_000, 400_000, 3), np.uint8, chunks=(1, 100, 100, 3))

    dataset = changed(view[0], change)
    refused(lambda: dataset.load(VIEW), "size")


# The fit of the pose


@settings(max_examples=40, deadline=None)
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
