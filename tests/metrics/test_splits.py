"""Splitting frames for training: no scene in two parts, blocks of cameras apart, and what leaks is said."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pipeline.metrics import DROPPED, TEST, TRAIN, VALIDATION, FrameKey, split_frames
from pipeline.metrics.splits import position_blocks
from pipeline.system import InputError

# At least three frames of each scene, so that two scenes can be cut into blocks.
keys = st.lists(st.integers(0, 9), min_size=1, max_size=20).map(
    lambda scenes: [FrameKey(f"{s}/{k}", f"scene {s}", k) for k, s in enumerate(scenes * 3)]
)


@given(keys, st.integers(0, 1000))
def test_no_scene_is_in_two_parts(frames: list[FrameKey], seed: int) -> None:
    scenes = {f.scene for f in frames}
    plan = split_frames(frames, None, seed)
    if len(scenes) < 3:
        assert plan.kind == "blocks"
        return
    assert plan.kind == "scene"
    assert plan.warning is None
    assert set(plan.part.tolist()) == {TRAIN, VALIDATION, TEST}
    for scene in scenes:
        assert len({plan.part[k] for k, f in enumerate(frames) if f.scene == scene}) == 1
    again = split_frames(frames[::-1], None, seed)
    np.testing.assert_array_equal(plan.part, again.part[::-1])
    assert sorted(s for p in ("train", "validation", "test") for s in plan.record()[f"{p}_scenes"]) == sorted(scenes)


def test_seeds_part_scenes_differently_and_in_proportion() -> None:
    frames = [FrameKey(str(k), f"s{k}", k) for k in range(100)]
    parts = [split_frames(frames, None, seed).part for seed in range(2)]
    assert [np.bincount(p).tolist() for p in parts] == [[70, 10, 20]] * 2
    assert (parts[0] != parts[1]).any()


@settings(max_examples=30)
@given(st.integers(0, 10_000), st.integers(10, 120), st.floats(0.5, 40))
def test_blocks_of_cameras_are_apart(seed: int, n: int, extent: float) -> None:
    rng = np.random.default_rng(seed)
    positions = rng.uniform(0, extent, (n, 3)) * (1, 0.3, 0.1)
    cut = position_blocks(positions, 1.0)
    if cut is None:
        return
    part, gap = cut
    assert 0 < gap <= 1
    distance = np.linalg.norm(positions[:, None] - positions[None], axis=2)
    for a, b in ((TRAIN, VALIDATION), (VALIDATION, TEST), (TRAIN, TEST)):
        assert distance[np.ix_(part == a, part == b)].min() >= gap - 1e-9
    assert (part == TRAIN).sum() >= 0.35 * n


def test_one_scene_is_cut_into_blocks_with_a_metre_between_them() -> None:
    path = [FrameKey(f"f{k}", "s", k, (0.1 * k, 0.0, 1.0)) for k in range(200)]
    plan = split_frames(path)
    assert plan.kind == "blocks"
    assert plan.gaps == {"s": 1.0}
    assert "same scene" in str(plan.warning)
    assert "random frames" in str(plan.warning)
    blocks = [plan.indices(part) for part in (TRAIN, VALIDATION, TEST)]
    assert all((np.diff(b) == 1).all() for b in blocks), "contiguous"
    assert 18 <= (plan.part == DROPPED).sum() <= 20
    near = split_frames([replace(f, position=(0.001 * k, 0.0, 0.0)) for k, f in enumerate(path)])
    assert 0.01 <= near.gaps["s"] < 1
    assert "too close together" in str(near.warning)


def test_without_poses_neighbouring_frames_are_kept_apart() -> None:
    frames = [FrameKey(f"f{k}", "s", k) for k in range(100)]
    plan = split_frames(frames)
    assert plan.gaps == {"s": 2}
    assert "poses are missing" in str(plan.warning)
    assert plan.part.tolist() == [TRAIN] * 68 + [DROPPED] * 2 + [VALIDATION] * 10 + [DROPPED] * 2 + [TEST] * 18
    standing = [replace(f, position=(1.0, 2.0, 3.0)) for f in frames]
    np.testing.assert_array_equal(split_frames(standing).part, plan.part)
    shuffled = split_frames([frames[k] for k in np.random.default_rng(0).permutation(100)])
    assert {f.frame for f, p in zip(shuffled.frames, shuffled.part, strict=True) if p == TEST} == {
        f"f{k}" for k in range(82, 100)
    }


def test_too_few_scenes_or_frames_are_refused() -> None:
    frames = [FrameKey(f"f{k}", f"s{k % 5}", k) for k in range(50)]
    with pytest.raises(InputError, match="three scenes"):
        split_frames(frames[:1] * 5, "scene")
    for few in ([], frames[:2]):
        with pytest.raises(InputError, match="three frames"):
            split_frames(few)
