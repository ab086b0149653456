"""Clustered bootstrap: against a plain loop, its coverage, and what must always hold of an interval."""

from __future__ import annotations

import json
import math
import warnings
from dataclasses import astuple

import numpy as np
import pytest
from benchmarks.grounding_figures import GroundingOutcomes, grounding_estimates, grounding_outcomes, mean_iou
from hypothesis import given, settings
from hypothesis import strategies as st

from pipeline.metrics import (
    BootstrapConfig,
    Estimate,
    bootstrap,
    cell_outcomes,
    f1_of,
    mean_estimate,
    multi_label_metrics,
    relation_estimates,
    share_estimate,
)
from pipeline.metrics.intervals import ratio_estimate, resample_weights
from pipeline.system import InputError

SEEDS = st.integers(0, 2**32 - 1)
FEW = BootstrapConfig(resamples=200)


def f1_estimate(tp, fp, fn, clusters, *, other=None, config: BootstrapConfig | None = None) -> Estimate:
    """F1 of counts a row; with `other`, the difference of two systems."""
    rows, second = (None if c is None else np.stack(c, axis=1).astype(np.float64) for c in ((tp, fp, fn), other))
    assert rows is not None
    return bootstrap(rows, clusters, lambda s: f1_of(s[:, :1], s[:, 1:2], s[:, 2:]), other=second, config=config)[0]


def slow_interval(figure, clusters: list, config: BootstrapConfig) -> tuple[float, float]:
    """Percentiles of `figure(rows)` over resamples, row by row and in plain Python."""
    ids = sorted(set(clusters))
    found = []
    for weights in np.concatenate(list(resample_weights(len(ids), config))).tolist():
        drawn = [row for one, times in zip(ids, weights, strict=True) for row in _rows_of(clusters, one) * int(times)]
        found.append(figure(drawn))
    found.sort()

    def percentile(share: float) -> float:
        place = share * (len(found) - 1)
        low = math.floor(place)
        high = min(low + 1, len(found) - 1)
        return found[low] + (place - low) * (found[high] - found[low])

    return percentile(0.025), percentile(0.975)


def _rows_of(clusters: list, one: object) -> list[int]:
    return [i for i, c in enumerate(clusters) if c == one]


def test_resamples_draw_as_many_clusters_as_there_are() -> None:
    config = BootstrapConfig(resamples=3000, seed=5)
    whole = np.concatenate(list(resample_weights(7, config)))
    assert whole.shape == (3000, 7)
    assert (whole.sum(axis=1) == 7).all()
    np.testing.assert_allclose(whole.mean(axis=0), 1, atol=0.06)
    # Of a multinomial with equal chances: variance 1 - 1/C, covariance -1/C.
    covariance = np.cov(whole.T)
    np.testing.assert_allclose(np.diag(covariance), 6 / 7, atol=0.1)
    np.testing.assert_allclose(covariance[~np.eye(7, dtype=bool)], -1 / 7, atol=0.06)
    for cells in (1, 10, 7 * 999):
        np.testing.assert_array_equal(np.concatenate(list(resample_weights(7, config, cells))), whole)
    assert not np.array_equal(np.concatenate(list(resample_weights(7, BootstrapConfig(3000, seed=6)))), whole)
    from_sequence = BootstrapConfig(3000, seed=np.random.SeedSequence(5))
    np.testing.assert_array_equal(np.concatenate(list(resample_weights(7, from_sequence))), whole)


@settings(max_examples=10, deadline=None)
@given(seed=SEEDS)
def test_intervals_are_those_of_a_plain_loop(seed: int) -> None:
    rng = np.random.default_rng(seed)
    n, config = 30, BootstrapConfig(resamples=50, seed=seed)
    clusters = [f"scene{k}" for k in rng.integers(0, 6, n)]
    a, b, weight = rng.random(n), rng.random(n), rng.integers(1, 4, n)
    tp, fp, fn = (rng.integers(1, 3, n) for _ in range(3))

    def mean(rows: list[int]) -> float:
        return sum(a[i] for i in rows) / len(rows)

    def ratio(rows: list[int]) -> float:
        return sum(a[i] for i in rows) / sum(int(weight[i]) for i in rows)

    def difference(rows: list[int]) -> float:
        return sum(a[i] for i in rows) / len(rows) - sum(b[i] for i in rows) / len(rows)

    def f1(rows: list[int]) -> float:
        doubled = 2 * sum(int(tp[i]) for i in rows)
        return doubled / (doubled + sum(int(fp[i]) + int(fn[i]) for i in rows))

    def f1_difference(rows: list[int]) -> float:
        doubled = 2 * sum(int(fp[i]) for i in rows)
        return f1(rows) - doubled / (doubled + sum(int(tp[i]) + int(fn[i]) for i in rows))

    for figure, found in (
        (mean, mean_estimate(a, clusters, config=config)),
        (ratio, ratio_estimate(a, weight, clusters, config=config)),
        (difference, mean_estimate(a, clusters, other=b, config=config)),
        (f1, f1_estimate(tp, fp, fn, clusters, config=config)),
        (f1_difference, f1_estimate(tp, fp, fn, clusters, other=(fp, tp, fn), config=config)),
    ):
        assert found.value == pytest.approx(figure(list(range(n))), abs=1e-12)
        assert (found.low, found.high) == pytest.approx(slow_interval(figure, clusters, config), abs=1e-12)
        assert (found.n, found.clusters) == (n, len(set(clusters)))


@pytest.mark.slow
def test_intervals_cover_the_truth_only_with_whole_scenes_drawn() -> None:
    rng = np.random.default_rng(0)
    config = BootstrapConfig(resamples=400)
    by_scene = by_row = 0
    for _ in range(200):
        sizes = rng.integers(5, 40, 40)
        chance = np.clip(rng.normal(0.6, 0.15, 40), 0, 1)
        clusters = np.repeat(np.arange(40), sizes)
        right = rng.random(len(clusters)) < chance[clusters]
        scene = mean_estimate(right, clusters, config=config)
        row = mean_estimate(right, np.arange(len(clusters)), config=config)
        by_scene += scene.low <= 0.6 <= scene.high
        by_row += row.low <= 0.6 <= row.high
    assert 0.90 <= by_scene / 200 <= 0.99
    assert by_row / 200 < 0.85, "rows of one scene are not independent"


@settings(max_examples=25, deadline=None)
@given(seed=SEEDS, clusters=st.integers(2, 12))
def test_what_holds_of_every_interval(seed: int, clusters: int) -> None:
    rng = np.random.default_rng(seed)
    ids = np.concatenate([np.arange(clusters), rng.integers(0, clusters, 40)])
    values, others = rng.random(len(ids)), rng.random(len(ids))
    found = mean_estimate(values, ids, config=FEW)
    assert found.low <= found.high
    assert values.min() - 1e-12 <= found.low
    assert found.high <= values.max() + 1e-12
    assert found.value == pytest.approx(values.mean())
    assert ("unreliable" in found.note) == (clusters < 10)
    order = rng.permutation(len(ids))
    assert astuple(mean_estimate(values[order], ids[order], config=FEW))[:3] == pytest.approx(astuple(found)[:3])
    # The same scenes once more, under other names.
    twice = mean_estimate(np.tile(values, 2), np.concatenate([ids, ids + clusters]), config=FEW)
    assert twice.value == pytest.approx(found.value, abs=1e-12)
    assert (twice.n, twice.clusters) == (2 * found.n, 2 * found.clusters)
    same = mean_estimate(values, ids, other=values.copy(), config=FEW)
    assert (same.value, same.low, same.high) == (0, 0, 0)
    there = mean_estimate(values, ids, other=others, config=FEW)
    back = mean_estimate(others, ids, other=values, config=FEW)
    assert (back.value, back.low, back.high) == pytest.approx((-there.value, -there.high, -there.low))


def test_a_scene_drawn_again_is_the_same_scene() -> None:
    values = np.array([1.0, 0.0, 0.0, 1.0, 1.0])
    again = mean_estimate(np.tile(values, 3), np.repeat([0, 1, 2], 5), config=FEW)
    assert (again.value, again.low, again.high) == pytest.approx((0.6, 0.6, 0.6))


def test_one_cluster_has_no_interval_and_says_so() -> None:
    found = mean_estimate([1, 0, 1, 1], ["office"] * 4)
    assert (found.value, found.n, found.clusters) == (0.75, 4, 1)
    assert math.isnan(found.low)
    assert math.isnan(found.high)
    assert "one cluster" in found.note
    assert found.formatted() == "75.0 [–]"
    # A second scene none of whose rows count does not make two.
    hollow = ratio_estimate([1, 0, 0], [1, 1, 0], ["a", "a", "b"])
    assert (hollow.value, hollow.n, hollow.clusters) == (0.5, 2, 1)
    assert math.isnan(hollow.low)


def test_what_is_undefined_has_no_interval() -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        empty = mean_estimate([], [])
        uncounted = ratio_estimate([0, 0], [0, 0], [1, 2])
        silent = f1_estimate([0, 0], [0, 0], [0, 0], [1, 2])
        # F1 rests on one scene of twenty: in a third of the resamples there is none.
        rare = f1_estimate([3] + [0] * 19, [1] + [0] * 19, [0] * 20, range(20))
    for found in (empty, uncounted, silent):
        assert math.isnan(found.value)
        assert math.isnan(found.low)
        assert found.note
        assert found.formatted() == "–"
        assert json.loads(json.dumps(found.record(), allow_nan=False))["value"] is None
    assert rare.value == pytest.approx(6 / 7)
    assert math.isnan(rare.low)
    assert "resamples" in rare.note


def test_how_an_estimate_is_written() -> None:
    found = Estimate(0.6274, 0.599, 0.6543, 1508, 20)
    assert found.formatted() == "62.7 [59.9, 65.4]"
    assert found.formatted(scale=1, decimals=3) == "0.627 [0.599, 0.654]"
    assert found.record() == {"value": 0.6274, "low": 0.599, "high": 0.6543, "n": 1508, "clusters": 20, "note": ""}
    assert Estimate(0.016, -0.00001, 0.03, 9, 20).formatted(signed=True) == "+1.6 [0.0, +3.0]"


@pytest.mark.parametrize(("values", "other"), [([1, np.nan], None), ([1, 0], [1, np.inf])])
def test_rows_that_a_file_lacks_are_refused(values: list, other: list | None) -> None:
    with pytest.raises(InputError, match="finite"):
        mean_estimate(values, [1, 2], other=other)


@pytest.mark.parametrize("wrong", [{"resamples": 0}, {"confidence": 1.0}, {"confidence": 0.0}, {"seed": -1}])
def test_a_bootstrap_that_makes_no_sense_is_refused(wrong: dict) -> None:
    with pytest.raises(InputError):
        BootstrapConfig(**wrong)


# Relations.


def scored(seed: int, pairs: int = 200) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    truth = rng.choice(np.array([-1, -1, 0, 1], np.int8), (pairs, 6))
    return np.clip(rng.normal(0.5 + 0.2 * truth, 0.3), 0, 1), truth, rng.integers(0, 15, pairs)


def test_relation_estimates_are_the_metrics_with_intervals() -> None:
    p, truth, scenes = scored(0)
    truth[:, 5] = 0
    truth[scenes > 0, 4] = 0
    cells = cell_outcomes(p, truth)
    found, metrics = relation_estimates(cells, scenes, config=FEW), multi_label_metrics(p, truth)
    for name in ("precision", "recall", "f1"):
        np.testing.assert_allclose([e.value for e in getattr(found, name)], getattr(metrics, name), rtol=1e-12)
    assert found.micro_f1.value == pytest.approx(metrics.micro_f1)
    assert found.macro_f1.value == pytest.approx(metrics.macro_f1)
    assert found.element_accuracy.value == pytest.approx(metrics.element_accuracy)
    assert [e.n for e in found.f1] == (truth != 0).sum(axis=0).tolist()
    assert [e.clusters for e in found.f1] == [15, 15, 15, 15, 1, 0]
    assert math.isnan(found.f1[4].low)
    assert math.isnan(found.f1[5].value)
    # The same resamples give each figure that it would be given alone.
    for k in range(4):
        alone = f1_estimate(cells.tp[:, k], cells.fp[:, k], cells.fn[:, k], scenes, config=FEW)
        assert (found.f1[k].low, found.f1[k].high) == pytest.approx((alone.low, alone.high), abs=1e-12)
    tp, fp, fn = (c.sum(axis=1) for c in (cells.tp, cells.fp, cells.fn))
    micro = f1_estimate(tp, fp, fn, scenes, config=FEW)
    assert (found.micro_f1.low, found.micro_f1.high) == pytest.approx((micro.low, micro.high), abs=1e-12)
    right = ratio_estimate((cells.tp | cells.tn).sum(axis=1), (truth != 0).sum(axis=1), scenes, config=FEW)
    assert astuple(found.element_accuracy)[:3] == pytest.approx(astuple(right)[:3], abs=1e-12)


def test_scorers_are_compared_on_the_same_resamples() -> None:
    p, truth, scenes = scored(1)
    better = np.clip(p + 0.15 * truth, 0, 1)
    cells, other = cell_outcomes(better, truth), cell_outcomes(p, truth)
    gain = relation_estimates(cells, scenes, other=other, config=FEW)
    first, second = multi_label_metrics(better, truth), multi_label_metrics(p, truth)
    assert gain.macro_f1.value == pytest.approx(first.macro_f1 - second.macro_f1)
    assert gain.micro_f1.low > 0
    same = relation_estimates(cells, scenes, other=cell_outcomes(better, truth), config=FEW)
    for e in (*same.precision, *same.recall, *same.f1, same.micro_f1, same.macro_f1, same.element_accuracy):
        assert (e.value, e.low, e.high) == (0, 0, 0)


# Grounding.


def answered(seed: int, noise: float) -> GroundingOutcomes:
    rng = np.random.default_rng(9)
    corner = rng.uniform(0, 60, (120, 2))
    truth = np.concatenate([corner, corner + rng.uniform(20, 60, (120, 2))], axis=1)
    sets = [np.concatenate([truth[i : i + 1], truth[: i % 3]]) for i in range(120)]
    strict = [s if i % 5 else np.zeros((0, 4)) for i, s in enumerate(sets)]
    rng = np.random.default_rng(seed)
    predicted = truth + np.tile(rng.normal(0, noise, (120, 2)), 2)
    predicted[rng.random(120) < 0.1] = np.nan
    right = rng.random(120) < 0.7
    asked = np.where(np.arange(120) % 4 == 0, np.nan, right)
    return grounding_outcomes(predicted, truth, strict, sets, asked, right)


def test_grounding_estimates_are_the_metrics_with_intervals() -> None:
    outcomes, scenes = answered(0, 12.0), np.arange(120) // 8
    found = grounding_estimates(outcomes, scenes, config=FEW)
    single, strict, acceptable = outcomes.hits()
    assert found.accuracy_single.value == pytest.approx(single.mean())
    assert found.accuracy_strict.value == pytest.approx(strict[~np.isnan(outcomes.iou_strict)].mean())
    assert found.accuracy_strict.n == 96
    assert found.accuracy_set.value == pytest.approx(acceptable.mean())
    means = (found.mean_iou_single.value, found.mean_iou_strict.value, found.mean_iou_set.value)
    assert means == pytest.approx(mean_iou(outcomes))
    assert found.reference_accuracy.value == pytest.approx(np.nanmean(outcomes.reference_right))
    assert found.reference_accuracy.n == 90
    assert found.pair_accuracy.value == pytest.approx(outcomes.pair_right.mean())
    assert found.answered.value == pytest.approx(outcomes.answered.mean())
    alone = mean_estimate(single, scenes, config=FEW)
    assert astuple(found.accuracy_single)[:3] == pytest.approx(astuple(alone)[:3])
    loose = grounding_estimates(outcomes, scenes, threshold=0.1, config=FEW)
    assert loose.accuracy_single.value == pytest.approx((outcomes.iou >= 0.1).mean())
    with pytest.raises(InputError):
        grounding_estimates(outcomes, scenes, threshold=0.0)


def test_systems_are_compared_on_the_same_expressions_only() -> None:
    good, bad, scenes = answered(1, 3.0), answered(2, 25.0), np.arange(120) // 8
    gain = grounding_estimates(good, scenes, other=bad, config=FEW)
    assert gain.accuracy_single.value == pytest.approx(good.hits()[0].mean() - bad.hits()[0].mean())
    assert gain.accuracy_single.low > 0
    same = grounding_estimates(good, scenes, other=answered(1, 3.0), config=FEW)
    for name in same.__dataclass_fields__:
        e = getattr(same, name)
        assert (e.value, e.low, e.high) == (0, 0, 0), name
    plain = grounding_outcomes(BOXES, BOXES, [BOXES[:1]] * 120, [BOXES[:1]] * 120)
    with pytest.raises(InputError, match="same expressions"):
        grounding_estimates(good, scenes, other=plain)
    nobody = grounding_estimates(plain, scenes, config=FEW)
    assert math.isnan(nobody.reference_accuracy.value)
    assert nobody.reference_accuracy.note == "no row counts"


BOXES = np.tile([0.0, 0.0, 2.0, 2.0], (120, 1))


def test_wilson_intervals() -> None:
    # Newcombe, Statistics in Medicine 1998, table I, method 3.
    golden = {(81, 263): (0.2553, 0.3662), (15, 148): (0.0624, 0.1605), (0, 20): (0, 0.1611), (1, 29): (0.0061, 0.1718)}
    for (hits, n), (low, high) in golden.items():
        found = share_estimate(np.arange(n) < hits, np.arange(n) // 2)
        assert (found.value, found.n) == (hits / n, n)
        assert (found.low, found.high) == pytest.approx((low, high), abs=1e-4)
    assert share_estimate(np.zeros(0, np.bool_), []).note == "no row counts"
