"""Object maps: identity, names by vote, presence, moved things, and growth by further frames."""

from __future__ import annotations

from dataclasses import replace
from itertools import combinations
from pathlib import Path

import numpy as np
import pytest
from posed_worlds import SCENE, Planted, boxes_at, demo

from pipeline.geometry import Annotation, Frame
from pipeline.scenes.map_files import map_path, read_map, read_maps, save_map
from pipeline.scenes.object_map import ObjectMap, map_record, map_scene
from pipeline.scenes.voxels import BACKGROUND, Voxels
from pipeline.system.errors import InputError

A, B = (-0.5, 1.1, 2.0), (0.6, 1.1, 2.4)


def truth(frames: list[Frame]) -> dict[tuple[str, int], int]:
    """By sighting, what it is: exact boxes of one class within 1 cm in the world are one thing."""
    things: list[tuple[str, np.ndarray]] = []
    found = {}
    for frame in frames:
        for a in frame.annotations:
            assert a.box is not None
            assert frame.camera.T_world_camera is not None
            center = a.box.transformed(frame.camera.T_world_camera).center
            same = [k for k, (label, c) in enumerate(things) if label == a.label and np.abs(c - center).max() < 0.01]
            found[frame.id, a.index] = same[0] if same else len(things)
            things.append((a.label, center))
    return found


def test_objects_of_the_demo_keep_one_identity_through_its_views() -> None:
    pipeline = demo()
    right = said = true = 0
    for scene in range(1, 5):
        ids = [f"{scene:06d}/{k:06d}" for k in range(3)]
        made = map_scene(pipeline, "s", ids)
        thing = truth([pipeline.dataset.load(i) for i in ids])
        for one, other in combinations(made.joins, 2):
            same = thing[one.frame_id, one.number] == thing[other.frame_id, other.number]
            joined = one.object_id == other.object_id
            right, said, true = right + (same and joined), said + joined, true + same
    assert right / said >= 0.99
    assert right / true >= 0.98


def test_a_wrong_class_is_outvoted_and_a_missing_detection_is_told() -> None:
    def annotated(frame_id: str, a: Annotation) -> Annotation | None:
        if frame_id == SCENE[1] and a.label == "laptop":
            return replace(a, label="book")
        return None if frame_id == SCENE[2] and a.label == "desk" else a

    made = map_scene(demo(annotated=annotated), "s", SCENE)
    laptop, desk = made.of_object(SCENE[1], 2), made.of_object(SCENE[0], 0)
    assert laptop is not None
    assert desk is not None
    assert (laptop.label, laptop.votes) == ("laptop", {"laptop": 2.0, "book": 1.0})
    assert (desk.label, desk.presence[SCENE[2]], desk.state) == ("desk", "missed", "static")


def test_a_thing_that_was_moved_is_two_states_that_are_linked() -> None:
    pipeline = boxes_at([{"box": A, "lamp": (0.0, 1.1, 3.0)}] * 2 + [{"lamp": (0.0, 1.1, 3.0), "box": B}] * 2)
    made = map_scene(pipeline, "s", pipeline.dataset.frame_ids)
    first, lamp, second = (made.of_object(*of) for of in (("s/0", 0), ("s/0", 1), ("s/3", 1)))
    assert first is not None
    assert lamp is not None
    assert second is not None
    assert [o.state for o in (first, lamp, second)] == ["moved", "static", "moved"]
    assert (first.other_place, second.other_place, lamp.other_place) == (second.id, first.id, None)
    assert list(first.presence.values()) == ["seen", "seen", "gone", "gone"]
    assert len(lamp.numbers) == 4


def test_further_frames_give_the_map_of_all_at_once_and_only_they_are_looked_at_for_objects(tmp_path: Path) -> None:
    whole = save_map(map_scene(demo(), "s", SCENE), tmp_path / "whole")
    part = save_map(map_scene(demo(), "s", SCENE[:2]), tmp_path / "part")
    pipeline = demo()
    assert isinstance(pipeline.dataset, Planted)
    grown = save_map(map_scene(pipeline, "s", SCENE, known=read_map(part)), tmp_path / "part")
    assert pipeline.dataset.loaded == [SCENE[2]]
    assert grown.read_bytes() == whole.read_bytes()


def test_a_map_of_other_poses_is_made_anew() -> None:
    known = map_scene(demo(moved={SCENE[0]: (0.2, 0.0, 0.0)}), "s", SCENE[:2])
    made = map_scene(demo(), "s", SCENE, known=known)
    assert map_record(made) == map_record(map_scene(demo(), "s", SCENE))


def test_a_frame_that_cannot_be_read_is_left_out_with_its_reason() -> None:
    made = map_scene(demo(), "s", (*SCENE[:2], "000001/000099"))
    assert made.frame_ids == SCENE[:2]
    assert "no frame" in made.left_out["000001/000099"]


def test_a_scene_in_which_nothing_is_found_is_a_map_without_objects() -> None:
    made = map_scene(demo(annotated=lambda frame_id, a: None), "s", SCENE[:2])
    assert (made.frame_ids, made.objects) == (SCENE[:2], ())
    assert set(made.voxels.sizes()) == {BACKGROUND}


@pytest.fixture(scope="module")
def small() -> ObjectMap:
    pipeline = boxes_at([{"box": A}] * 2)
    return map_scene(pipeline, "a/b", pipeline.dataset.frame_ids)


def test_a_map_that_was_saved_is_read_as_it_was(small: ObjectMap, tmp_path: Path) -> None:
    path = save_map(small, tmp_path)
    assert path == map_path(tmp_path, "a/b")
    (scene, read), *others = read_maps(tmp_path).items()
    assert (scene, others) == ("a/b", [])
    assert map_record(read) == map_record(small)
    assert save_map(read, tmp_path / "again").read_bytes() == path.read_bytes()


def test_a_damaged_map_is_refused_in_a_line(small: ObjectMap, tmp_path: Path) -> None:
    path = save_map(small, tmp_path)
    data = path.read_bytes()
    with np.load(path) as arrays:
        members = {name: arrays[name] for name in arrays.files}
    text = bytes(members["table"])
    for name, value in {
        "table": np.frombuffer(text.replace(b'"version": 2', b'"version": 9'), np.uint8),
        "pairs": members["pairs"][::-1],
        "counts": members["counts"].astype(np.float64),
        "poses": members["poses"][:1],
        "boxes": members["boxes"][1:],
    }.items():
        np.savez(path, **{**members, name: value})
        with pytest.raises(InputError, match="map"):
            read_map(path)
    path.write_bytes(data[: len(data) // 2])
    with pytest.raises(InputError, match="no map"):
        read_map(path)
    with pytest.raises(InputError, match="holds no object map"):
        read_maps(tmp_path / "nowhere")


def test_a_map_of_the_first_version_opens_without_boxes_and_is_made_anew(small: ObjectMap, tmp_path: Path) -> None:
    path = save_map(small, tmp_path)
    with np.load(path) as arrays:
        members = {name: arrays[name] for name in arrays.files if name != "boxes"}
    text = bytes(members["table"]).replace(b'"version": 2', b'"version": 1')
    np.savez(path, **{**members, "table": np.frombuffer(text, np.uint8)})
    read = read_map(path)
    assert read.objects == small.objects
    assert [one["box"] for one in map_record(read)["objects"]] == [None]
    pipeline = boxes_at([{"box": A}] * 2)
    again = map_scene(pipeline, "a/b", pipeline.dataset.frame_ids, known=read)
    assert map_record(again) == map_record(small)


def test_memory_is_that_of_the_surfaces_however_many_frames_show_them() -> None:
    rng = np.random.default_rng(1)
    points, owners = rng.uniform(-1, 1, (2_000, 3)), rng.integers(BACKGROUND, 4, 2_000)
    once = Voxels().added(points, owners)
    often = once
    for _ in range(5):
        often = often.added(points, owners)
    np.testing.assert_array_equal(often.pairs, once.pairs)
    assert set(often.counts.tolist()) == {6}


def test_places_of_objects_that_are_one_are_counted_together() -> None:
    points = np.array([[0.01, 0.01, 0.01], [0.51, 0.01, 0.01], [0.01, -0.51, 0.01]])
    voxels = Voxels().added(points, np.array([0, 1, BACKGROUND])).added(points, np.array([2, 1, BACKGROUND]))
    assert voxels.shared() == {(0, 2): 1}
    one = voxels.renamed({0: 0, 1: 1, 2: 0})
    assert one.sizes() == {BACKGROUND: 1, 0: 1, 1: 1}
    assert one.counts.tolist() == [2, 2, 2]
    np.testing.assert_allclose(one.of(0, least=2), points[:1])


def test_a_point_beyond_the_reach_of_voxels_is_refused() -> None:
    with pytest.raises(InputError, match="too far"):
        Voxels().added(np.array([[1e4, 0, 0]]), np.array([0]))


def test_a_map_is_of_one_dataset_and_its_poses(small: ObjectMap, tmp_path: Path) -> None:
    save_map(small, tmp_path)
    same = boxes_at([{"box": A}] * 2).dataset
    assert list(read_maps(tmp_path, same)) == ["a/b"]
    with pytest.raises(InputError, match="maps of another dataset"):
        read_maps(tmp_path, demo().dataset)
    pose = next(iter(small.declared.values())).copy()
    pose[0, 3] += 0.1
    made = replace(small, declared={**small.declared, small.frame_ids[0]: pose})
    save_map(made, tmp_path)
    with pytest.raises(InputError, match=f"another pose of frame {small.frame_ids[0]}"):
        read_maps(tmp_path, same)
