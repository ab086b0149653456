"""Odd frames: a planted fault is the oddest and the only odd frame; slow, fast and irregular recordings have none."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from dataset_writers import write_png
from hypothesis import given
from hypothesis import strategies as st

from pipeline.datasets import InMemoryDataset, demo_path, open_dataset
from pipeline.datasets.base import ChangedFrames, load_depth
from pipeline.datasets.odd_frames import DepthSample, OddFrame, odd_frames
from pipeline.geometry import Camera, Frame

K = np.array([[100.0, 0, 32], [0, 100.0, 24], [0, 0, 1]])
COUNT = 24


def frame(name: str, x: float, yaw: float = 0.0, posed: bool = True) -> Frame:
    """A camera at x, turned by `yaw`, before a slanted wall with a tenth of the depth missing."""
    T = np.eye(4)
    T[:3, :3] = [[np.cos(yaw), 0, np.sin(yaw)], [0, 1, 0], [-np.sin(yaw), 0, np.cos(yaw)]]
    T[0, 3] = x
    depth = np.tile(np.linspace(1.5, 3.0, 64, dtype=np.float32) + np.float32(x / 5), (48, 1))
    depth[::10] = 0
    return Frame(name, np.zeros((48, 64, 3), np.uint8), depth, Camera(K, 64, 48, T if posed else None))


def walk(step: float = 0.02, posed: bool = True, scene: str = "a") -> list[Frame]:
    return [frame(f"{scene}/{k}", k * step, k * step, posed) for k in range(COUNT)]


def moved(one: Frame) -> Frame:
    T = one.camera.T_world_camera
    assert T is not None
    T = T.copy()
    T[1, 3] += 0.7
    return replace(one, camera=replace(one.camera, T_world_camera=T))


def half_missing(one: Frame) -> Frame:
    depth = one.depth.copy()
    depth[:, :32] = 0
    return replace(one, depth=depth)


FAULTS = {
    "pose jumps 0.7 m": moved,
    "view turns 5": lambda one: replace(
        one, camera=replace(one.camera, T_world_camera=frame("", 0.02, 1.02).camera.T_world_camera)
    ),
    "depth changes by ": lambda one: replace(one, depth=one.depth * 5),
    "no depth in 5": half_missing,
}


def odd(frames: list[Frame]) -> dict[str, tuple[str, ...]]:
    return {one.id: one.reasons for one in odd_frames(InMemoryDataset(frames)) if one.reasons}


@pytest.mark.parametrize("words", FAULTS)
@given(at=st.integers(0, COUNT - 1))
def test_a_planted_fault_is_the_only_odd_frame(words: str, at: int) -> None:
    frames = walk(0.001 if "turns" in words else 0.02)
    frames[at] = FAULTS[words](frames[at])
    found = odd_frames(InMemoryDataset(frames))
    assert max(found, key=lambda one: one.oddness or 0).id == f"a/{at}"
    assert [one.id for one in found if one.reasons] == [f"a/{at}"]
    assert found[at].reasons[0].startswith(words)
    if not words.startswith("no depth"):
        assert found[at].reasons[0].endswith("from the frames around" if at < 2 else "from the frames before")


@given(st.floats(0, 1), st.integers(0, 2**31))
def test_motion_that_goes_on_is_not_odd(step: float, seed: int) -> None:
    assert not odd(walk(step))
    # Slow, then so fast a pan for a while, then slow again.
    xs = np.cumsum([0.01] * 12 + [0.01 + 0.2 * step] * 12 + [0.01] * 12)
    assert not odd([frame(f"a/{k}", x) for k, x in enumerate(xs)])
    shaken = np.cumsum(np.random.default_rng(seed).uniform(0, 0.08, 40))
    assert not odd([frame(f"a/{k}", x) for k, x in enumerate(shaken)])


def test_the_first_frame_after_a_cut_is_odd() -> None:
    frames = [frame(f"a/{k}", 0.02 * k + 2.0 * (k >= 10)) for k in range(COUNT)]
    assert list(odd(frames)) == ["a/10"]


def test_a_scene_begins_without_a_jump_and_has_its_own_measure() -> None:
    slow, fast = walk(0.001), walk(0.5, scene="b")
    assert not odd([*slow, *fast])
    slow[7] = moved(slow[7])
    assert list(odd([*slow, *fast])) == ["a/7"]


def test_without_poses_depth_alone_tells() -> None:
    frames = walk(posed=False)
    frames[3] = FAULTS["depth changes by "](frames[3])
    assert list(odd(frames)) == ["a/3"]


@pytest.mark.parametrize("count", [1, 2, 3])
def test_few_frames_have_no_measure_of_their_own(count: int) -> None:
    found = odd_frames(InMemoryDataset([frame(f"a/{k}", 1.5 * k) for k in range(count)]))
    assert not any(one.reasons for one in found)
    assert [one.depth_missing for one in found] == pytest.approx([5 / 48] * count)


def test_more_frames_than_are_looked_at_are_sampled_evenly() -> None:
    frames, told = walk(), []
    found = odd_frames(InMemoryDataset(frames), 2, 12, lambda done, of: told.append((done, of)))
    assert told == [(0, 12)] * 2 + [(k, 12) for k in range(1, 13)]
    looked = [k for k, one in enumerate(found) if one.depth_missing is not None]
    assert len(looked) == 12
    assert max(np.diff(looked)) <= 3
    assert found[1] == OddFrame("a/1", None, None)


def test_a_recording_is_looked_at_without_its_colour_and_without_a_unit(tmp_path: Path) -> None:
    for k in range(9):
        (tmp_path / f"{k}.png").write_bytes(b"broken")
        stored = np.full((48, 64), 2000 + k, np.uint16)
        stored[: 30 if k == 4 else 3] = 0
        write_png(tmp_path / f"{k}_depth.png", stored)
    (tmp_path / "7_depth.png").write_bytes(b"broken")
    found = odd_frames(open_dataset(tmp_path, browse=True))
    assert [one.reasons for one in found] == [() if k != 4 else ("no depth in 62%",) for k in range(9)]
    assert found[7] == OddFrame("7", None, None)
    # Where the unit is told, depth is compared too.
    write_png(tmp_path / "2_depth.png", np.full((48, 64), 8000, np.uint16))
    told = odd_frames(open_dataset(tmp_path, intrinsics=(100, 100, 32, 24), depth_scale=1000))
    assert told[2].reasons == ("depth changes by 6.0 m at the median from the frames before",)


@pytest.mark.parametrize("name", ["7scenes-redkitchen", "open3d-testdata/RGBD", "ycbv-bop"])
def test_real_recordings_without_a_fault_have_no_odd_frame(shared_data: Path, name: str) -> None:
    found = odd_frames(open_dataset(shared_data / "real" / name))
    assert not [one for one in found if one.reasons]
    assert all(one.oddness is not None for one in found)


def test_depth_that_was_read_already_says_the_same() -> None:
    dataset = open_dataset(demo_path())
    known = {k: DepthSample.of(dataset.load(i).depth) for k, i in enumerate(dataset.frame_ids[:7])}
    read: list[str] = []

    class Counted(ChangedFrames):
        def load_depth(self, frame_id: str) -> np.ndarray | None:
            read.append(frame_id)
            return load_depth(dataset, frame_id)

    assert odd_frames(Counted(dataset), known=known) == odd_frames(dataset)
    assert read == list(dataset.frame_ids[7:])
