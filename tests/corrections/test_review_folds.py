"""Every frame is held out once, and nothing near it is learnt from then."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pipeline.corrections.review.doubts import make_folds
from pipeline.metrics import FrameKey
from pipeline.system import InputError


def keys(scenes: list[int], positions: np.ndarray | None = None) -> list[FrameKey]:
    """So many frames of each scene."""
    names = [f"s{k}" for k, count in enumerate(scenes) for _ in range(count)]
    at = [None] * len(names) if positions is None else [tuple(map(float, p)) for p in positions]
    return [FrameKey(f"{name}/{k}", name, k, at[k]) for k, name in enumerate(names)]  # pyright: ignore[reportArgumentType]


@settings(max_examples=30, deadline=None)
@given(st.lists(st.integers(1, 7), min_size=3, max_size=12), st.integers(2, 8), st.integers(0, 5))
def test_scenes_are_held_out_whole(scenes: list[int], count: int, seed: int) -> None:
    frames = keys(scenes)
    folds = make_folds(frames, count, seed)
    assert folds.kind == "scene"
    assert len(folds) == min(count, len(scenes))
    assert (folds.held.sum(axis=0) == 1).all()
    assert folds.held.any(axis=1).all()
    for held, learnt in zip(folds.held, folds.learnt, strict=True):
        inside, outside = ({frames[k].scene for k in np.flatnonzero(part).tolist()} for part in (held, learnt))
        assert not inside & outside
        assert inside | outside == {f.scene for f in frames}
    again = make_folds(frames, count, seed)
    np.testing.assert_array_equal(folds.held, again.held)


@settings(max_examples=30, deadline=None)
@given(st.integers(2, 60), st.integers(2, 6), st.integers(0, 99), st.floats(0.5, 20))
def test_blocks_of_one_scene_are_apart(count: int, folds: int, seed: int, room: float) -> None:
    positions = np.random.default_rng(seed).uniform(0, room, (count, 3)) * (1, 0.2, 0.05)
    found = make_folds(keys([count], positions), folds)
    assert found.kind == "blocks"
    assert (found.held.sum(axis=0) == 1).all()
    assert not (found.held & found.learnt).any()
    (gap,) = found.gaps.values()
    for held, learnt in zip(found.held, found.learnt, strict=True):
        if not held.any():
            continue
        assert 2 * learnt.sum() >= (~held).sum() > 0
        if isinstance(gap, float):
            apart = np.linalg.norm(positions[held][:, None] - positions[learnt][None], axis=2)
            assert apart.min() >= gap - 1e-9


def test_a_long_walk_keeps_its_gap_of_a_metre() -> None:
    positions = np.stack([np.linspace(0, 40, 200), np.zeros(200), np.zeros(200)], axis=1)
    found = make_folds(keys([200], positions), 4)
    assert found.gaps == {"s0": 1.0}
    assert sorted(found.held.sum(axis=1).tolist()) == [50, 50, 50, 50]


def test_frames_without_poses_are_held_out_in_runs() -> None:
    found = make_folds(keys([100, 3]), 5)
    assert found.kind == "blocks"
    assert found.gaps["s0"] == 2
    held = found.held[:, :100]
    assert (np.abs(np.diff(held.astype(int), axis=1)).sum(axis=1) <= 2).all(), "each is one run"
    first = next(k for k in range(5) if held[k, 0])
    assert not found.learnt[first, 20:21].any()
    assert found.learnt[first, 22:100].all()
    assert found.held[:, 100:].sum() == 3


@pytest.mark.parametrize(("scenes", "folds"), [([1], 5), ([], 5), ([9], 1)])
def test_too_few_are_refused(scenes: list[int], folds: int) -> None:
    with pytest.raises(InputError):
        make_folds(keys(scenes), folds)
