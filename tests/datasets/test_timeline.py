"""Timeline: a byte a frame from counts, scenes as runs, odd frames with reasons; 100,000 frames are few bytes."""

from __future__ import annotations

import json
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pipeline.datasets import open_dataset
from pipeline.datasets.base import scene_of, scenes_of
from pipeline.datasets.demo import demo_path
from pipeline.datasets.odd_frames import OddFrame
from pipeline.datasets.timeline import ALL, MOST_SCENES, UNKNOWN, Timeline, next_with_share, oddest, timeline_of

MANY = 100_000


def listing(ids: tuple[str, ...]) -> Any:
    """A dataset of ids alone."""
    return SimpleNamespace(frame_ids=ids, root=demo_path())


@given(st.lists(st.tuples(st.integers(0, 300), st.integers(0, 300)), min_size=1, max_size=20))
def test_a_share_is_nothing_only_of_nothing_and_all_only_of_all(counts: list[tuple[int, int]]) -> None:
    line = Timeline(tuple(f"{k}" for k in range(len(counts) + 1)), ())
    shares = line.shares({f"{k}": n for k, n in enumerate(counts)} | {"not of the dataset": (1, 1)})
    assert shares.dtype == np.uint8
    assert shares[-1] == UNKNOWN
    for share, (well, bad) in zip(shares, counts, strict=False):
        if not well + bad:
            assert share == UNKNOWN
            continue
        assert share == pytest.approx(ALL * bad / (well + bad), abs=1)
        assert (share == 0) == (bad == 0)
        assert share < ALL or bad * ALL > (well + bad) * (ALL - 1)


def test_scenes_are_runs_of_frames_as_each_frame_says() -> None:
    dataset = open_dataset(demo_path())
    line = timeline_of(dataset)
    assert scenes_of(dataset) == tuple(scene_of(dataset, i) for i in dataset.frame_ids)
    assert [scene for _, scene in line.scenes] == list(dict.fromkeys(scenes_of(dataset)))
    assert all(scene_of(dataset, dataset.frame_ids[k]) == scene for k, scene in line.scenes)
    assert timeline_of(listing(tuple(f"{k}/0" for k in range(MOST_SCENES + 1)))).scenes == ()


def test_missing_depth_and_the_oddest_frames_with_their_reasons() -> None:
    frames = [OddFrame("0", 0.5, 2.0, ("a", "b")), OddFrame("1", None, None), OddFrame("2", 0.0, 0.1)]
    frames.append(OddFrame("3", 0.001, 9.0, ("c",)))
    assert Timeline(("0", "1", "2", "3"), ()).missing_depth(frames).tolist() == [127, UNKNOWN, 0, 1]
    assert oddest(frames) == [(0, "a, b"), (3, "c")]
    assert oddest(frames, 1) == [(3, "c")]


def test_steps_go_round_the_frames_that_have_a_share() -> None:
    shares = np.array([0, 9, UNKNOWN, 7, 0], np.uint8)
    assert [next_with_share(shares, at, 1) for at in range(5)] == [1, 3, 3, 1, 1]
    assert [next_with_share(shares, at, -1) for at in range(5)] == [3, 3, 1, 1, 3]
    assert next_with_share(shares[[0, 2]], 0, 1) is None


def test_a_hundred_thousand_frames_are_few_bytes() -> None:
    ids = tuple(f"{k // 500:04d}/frame-{k:06d}" for k in range(MANY))
    line = timeline_of(listing(ids))
    shares = line.shares({i: (k % 7, k % 3) for k, i in enumerate(ids)})
    odd = oddest([OddFrame(i, 0.1, 3.0, ("pose jumps 0.7 m from the frames before",)) for i in ids])
    # Four thirds of the shares in base64.
    assert shares.nbytes * 4 / 3 + len(json.dumps([line.scenes, odd])) < 200_000
