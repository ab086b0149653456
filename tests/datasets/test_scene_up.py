"""The vote of a scene's posed frames: the same for each frame that asks, and unmoved by one that lies."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from box_worlds import random_boxes
from scenes import Plane, angle_deg, camera_of, cast, up_of
from test_viewer import noisy

from pipeline.answering import prepare_frame
from pipeline.answering.json_records import viewer_record
from pipeline.datasets import resolved_camera, scene_of
from pipeline.datasets.base import frames_of_scene
from pipeline.datasets.up import MAX_VOTERS, own_disagreement, scene_vote
from pipeline.geometry import Camera, Frame, resolve_up, viewer_axes
from pipeline.labels import LabelConfig, label_objects
from pipeline.system import InputError

WORLD_UP = np.array([0.0, 0.6, 0.8])


class Scene:
    """Frames made on demand; `turn` is what their poses are turned by."""

    format, class_names = "test", ()

    def __init__(self, pitches: dict[str, float], **lies: np.ndarray) -> None:
        self.root, self.frame_ids = Path("/nowhere/room"), tuple(pitches)
        self.pitches, self.lies, self.loaded = pitches, lies, list[str]()

    def load(self, frame_id: str) -> Frame:
        self.loaded.append(frame_id)
        pitch = self.pitches[frame_id]
        if not np.isfinite(pitch):
            raise InputError("broken")
        viewer = viewer_axes(up_of(pitch, 4))
        boxes = random_boxes(np.random.default_rng(self.frame_ids.index(frame_id)), 1.4)
        seen = cast(camera_of(), boxes, [Plane((0, 1, 0), 1.4), Plane((0, 0, 1), 4.0)], viewer)
        T = np.eye(4)
        T[:3, :3] = self.lies.get(frame_id.split("/")[-1], np.eye(3)) @ turn(viewer.up, WORLD_UP)
        camera = Camera(camera_of().K, 320, 240, T)
        return Frame(frame_id, np.zeros((240, 320, 3), np.uint8), noisy(seen.depth), camera)


def turn(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """The rotation that takes unit vector a to b."""
    v = np.cross(a, b)
    K = np.array([[0, -v[2], v[1]], [v[2], 0, -v[0]], [-v[1], v[0], 0]])
    return np.eye(3) + K + K @ K / (1 + a @ b)


def steps(*pitches: float) -> dict[str, float]:
    return {f"a/{k}": pitch for k, pitch in enumerate(pitches)}


def about_x(degrees: float) -> np.ndarray:
    c, s = np.cos(np.deg2rad(degrees)), np.sin(np.deg2rad(degrees))
    return np.array([[1, 0, 0], [0, c, -s], [0, s, c]])


def test_all_frames_of_a_scene_take_the_up_that_they_agree_on() -> None:
    scene = Scene(steps(20, 45, 65))
    for frame_id in scene.frame_ids:
        frame = scene.load(frame_id)
        camera = resolved_camera(scene, frame)
        assert camera.up_source == "scene"
        assert camera.up is not None
        assert angle_deg(camera.up, up_of(scene.pitches[frame_id], 4)) < 1
        context = prepare_frame(scene, frame)
        assert context.viewer.up_source == "scene"
        np.testing.assert_allclose(context.viewer.up, camera.up, rtol=0, atol=1e-12)


def test_one_frame_that_lies_is_outvoted_and_reported() -> None:
    scene = Scene(steps(20, 30, 40, 50), **{"2": about_x(35)})
    found = scene_vote(scene, "a/2")
    assert found.up is not None
    assert angle_deg(found.up, WORLD_UP) < 1
    assert (found.scene, found.agreeing, found.voting) == ("a", 3, 4)
    ((name, angle),) = found.disagreeing
    assert name == "a/2"
    assert angle == pytest.approx(35, abs=2)
    assert own_disagreement(scene.load("a/2"), found) == pytest.approx(angle)
    assert own_disagreement(scene.load("a/1"), found) is None
    doubted, clean = (prepare_frame(scene, scene.load(name)).viewer for name in ("a/2", "a/1"))
    assert clean.up_doubt == ""
    assert doubted.up_doubt.endswith("degrees off the up of its scene, on which 3 of 4 frames that were asked agree")
    assert "up_doubt" not in viewer_record(clean)
    assert viewer_record(doubted)["up_doubt"] == doubted.up_doubt
    lying = prepare_frame(scene, scene.load("a/2"))
    rows = label_objects(lying, (), LabelConfig(), frame_index=2, scene="a", exact=True)
    assert rows.frames["notes"] == [[doubted.up_doubt]]


def test_the_vote_does_not_depend_on_who_asks_and_is_taken_once() -> None:
    pitches = steps(15, 35, 55, 70)
    first, second = Scene(pitches), Scene(pitches)
    a, b = scene_vote(first, "a/0"), scene_vote(second, "a/3")
    np.testing.assert_array_equal(a.up, b.up)
    assert scene_vote(first, "a/2") is a
    assert first.loaded == list(first.frame_ids)


def test_a_long_scene_is_asked_by_a_few_of_its_frames() -> None:
    scene = Scene(steps(*[30.0] * 40))
    assert scene_vote(scene, "a/7").voting == MAX_VOTERS
    assert len(scene.loaded) == MAX_VOTERS
    assert {scene.loaded[0], scene.loaded[-1]} == {"a/0", "a/39"}


@pytest.mark.parametrize(
    "made",
    [
        lambda: Scene(steps(30)),
        lambda: Scene(steps(30, 40), **{"1": about_x(60)}),
        lambda: Scene(steps(30, np.nan)),
    ],
)
def test_without_agreement_a_frame_goes_by_its_own_plane(made: Callable[[], Scene]) -> None:
    scene = made()
    assert scene_vote(scene, "a/0").up is None
    assert resolved_camera(scene, scene.load("a/0")).up_source == "plane"


def test_a_declared_up_and_a_frame_without_a_pose_ask_no_one() -> None:
    scene = Scene(steps(30, 40))
    frame = scene.load("a/0")
    scene.loaded.clear()
    declared = frame.camera.with_up(np.array([0, -1.0, 0]), "declared")
    assert resolved_camera(scene, replace(frame, camera=declared)) is declared
    bare = replace(frame, camera=Camera(frame.camera.K, 320, 240))
    np.testing.assert_array_equal(resolved_camera(scene, bare).up, resolve_up(frame.depth, bare.camera).up)
    assert scene.loaded == []


def test_scenes_are_folders_of_the_frames_ids() -> None:
    scene = Scene({"a/1": 20, "a/2": 20, "b/1": 20, "c": 20})
    assert [scene_of(scene, f) for f in scene.frame_ids] == ["a", "a", "b", "room"]
    assert frames_of_scene(scene, "a/2") == ("a/1", "a/2")
    assert frames_of_scene(scene, "c") == ("c",)
