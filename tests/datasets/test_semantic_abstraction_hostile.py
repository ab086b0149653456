"""Semantic Abstraction: hostile files break their frame only, and name what is wrong."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
from semantic_abstraction_checks import VIEW, changed, editing, pose, refused, view  # noqa: F401
from semantic_abstraction_writer import TRUE_POSE, ViewTruth, write_view
from slow_cases import mostly_slow

from pipeline.datasets import open_dataset, survey


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


BROKEN: list[tuple[str, Any, str]] = [
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
]


@pytest.mark.parametrize(("name", "value", "word"), mostly_slow(BROKEN, fast=range(0, len(BROKEN), 3), several=True))
def test_what_a_frame_cannot_do_without_is_named(
    view: tuple[Path, ViewTruth], name: str, value: Any, word: str
) -> None:
    dataset = changed(view[0], lambda file: replace(file, name, value))
    refused(lambda: dataset.load(VIEW), word if word != "no segmentation" else "cannot be a segmentation", VIEW)


@pytest.mark.slow
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
