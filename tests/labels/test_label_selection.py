"""Selecting expressions: the same choice in any order, balanced, within its limits."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pipeline.labels import SelectConfig
from pipeline.labels.selection import SCARCE, select
from pipeline.system import InputError

Rows = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]


def candidates(seed: int, n: int) -> Rows:
    rng = np.random.default_rng(seed)
    ids = rng.integers(0, 2**63, n).astype(np.uint64)
    frame = rng.integers(0, max(1, n // 30) + 1, n)
    relation = rng.choice(6, n, p=[0.4, 0.3, 0.02, 0.02, 0.2, 0.06])
    target = rng.choice(12, n, p=np.array([12, 8, 4, 3, 2, 1, 1, 1, 1, 1, 1, 1]) / 36)
    return ids, frame, relation, target, rng.integers(0, 12, n)


configs = st.builds(
    SelectConfig,
    total=st.none() | st.integers(1, 400),
    per_frame=st.none() | st.integers(1, 30),
    balance=st.none() | st.floats(1, 10),
    seed=st.integers(0, 5),
)


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 10**6), st.integers(1, 600), configs)
def test_the_choice_does_not_depend_on_the_order(seed: int, n: int, config: SelectConfig) -> None:
    rows = candidates(seed, n)
    order = np.random.default_rng(seed + 1).permutation(n)
    ids, frame, relation, target, reference = (r[order] for r in rows)
    shuffled = select(ids, frame, relation, target, reference, config)
    np.testing.assert_array_equal(select(*rows, config)[order], shuffled)


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 10**6), st.integers(1, 600), configs)
def test_limits_hold(seed: int, n: int, config: SelectConfig) -> None:
    ids, frame, relation, target, reference = candidates(seed, n)
    kept = select(ids, frame, relation, target, reference, config)
    questions = np.stack([frame, relation, target, reference], axis=1)[kept]
    assert len(np.unique(questions, axis=0)) == kept.sum()
    if config.total is not None:
        assert kept.sum() <= config.total
    if config.per_frame is not None and kept.any():
        assert np.bincount(frame[kept]).max() <= config.per_frame
    if config.balance is not None and kept.any():
        counts = np.bincount(relation[kept])
        assert counts.max() <= config.balance * max(counts[counts > 0].min(), SCARCE) + 1
    assert kept.any()


def test_a_total_is_met_and_level_over_relations_and_classes() -> None:
    ids, frame, relation, target, reference = candidates(3, 20_000)
    kept = select(ids, frame, relation, target, reference, SelectConfig(total=600, per_frame=None, balance=None))
    counts = np.bincount(relation[kept], minlength=6)
    assert kept.sum() == 600
    assert counts.max() - counts.min() <= 1
    common = np.bincount(target[kept & (relation == 0)], minlength=12)
    assert common.max() - common.min() <= 1


def test_what_a_rare_relation_leaves_goes_to_the_others() -> None:
    relation = np.array([0] * 500 + [1] * 500 + [2] * 10)
    n = len(relation)
    ids = np.random.default_rng(0).integers(0, 2**63, n).astype(np.uint64)
    rows = (ids, np.arange(n), relation, np.zeros(n, int), np.zeros(n, int))
    kept = select(*rows, SelectConfig(total=300, per_frame=None, balance=None))
    assert np.bincount(relation[kept]).tolist() == [145, 145, 10]
    boundless = select(*rows, SelectConfig(total=None, per_frame=None, balance=1e308))
    assert np.array_equal(boundless, select(*rows, SelectConfig(total=None, per_frame=None, balance=None)))
    kept = select(*rows, SelectConfig(total=None, per_frame=None, balance=2.0))
    assert np.bincount(relation[kept]).tolist() == [2 * SCARCE, 2 * SCARCE, 10]


def test_another_seed_chooses_others() -> None:
    rows = candidates(5, 3000)
    first, second = select(*rows, SelectConfig(total=300, seed=0)), select(*rows, SelectConfig(total=300, seed=1))
    assert first.sum() == second.sum()
    assert (first & second).sum() < 0.6 * first.sum()


def test_nothing_to_choose_from() -> None:
    empty = np.zeros(0, np.int64)
    assert select(empty.astype(np.uint64), empty, empty, empty, empty, SelectConfig()).shape == (0,)
    with pytest.raises(InputError, match="at least 1"):
        SelectConfig(total=0)
    with pytest.raises(InputError, match="at least 1"):
        SelectConfig(per_frame=0)
    with pytest.raises(InputError, match="at least 1"):
        SelectConfig(balance=0.5)
