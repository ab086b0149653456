"""Two detectors on one frame: the best matching, and what it counts."""

from __future__ import annotations

from dataclasses import replace
from itertools import permutations
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from shelf import NAMES, SHELF

from pipeline.answering import (
    FrameAgreement,
    Pipeline,
    agree_frames,
    agreement_record,
    figures,
    open_pipeline,
)
from pipeline.answering.agreement import (
    Layer,
    agree,
    layer_of_proposals,
    matched,
    overlaps,
    rank_correlation,
)
from pipeline.geometry import iou_2d
from pipeline.proposals import Detector, SimulatedDetector, SimulationOptions
from pipeline.system import InputError

WORDS = ("mug", "trash can", "bin", "lamp")


@st.composite
def layers(draw: st.DrawFn) -> Layer:
    n = draw(st.integers(0, 6))
    corner = draw(arrays(np.float64, (n, 2), elements=st.integers(0, 12)))
    side = draw(arrays(np.float64, (n, 2), elements=st.integers(0, 10)))
    scores = draw(arrays(np.float64, n, elements=st.floats(0, 1)))
    labels = tuple(draw(st.lists(st.sampled_from(WORDS), min_size=n, max_size=n)))
    return Layer(np.concatenate([corner, corner + side], axis=1), scores, labels, (None,) * n)


def by_trial(overlap: np.ndarray, same: np.ndarray, min_iou: float) -> tuple[int, int, float]:
    """(pairs of one name, pairs, sum of overlaps) of the best of all matchings."""
    if overlap.shape[0] > overlap.shape[1]:
        overlap, same = overlap.T, same.T
    n, m = overlap.shape
    best = (0, 0, 0.0)
    for columns in permutations(range(m), n):
        fits = [(i, j) for i, j in enumerate(columns) if overlap[i, j] >= min_iou and overlap[i, j] > 0]
        value = (sum(bool(same[i, j]) for i, j in fits), len(fits), sum(float(overlap[i, j]) for i, j in fits))
        best = max(best, value, key=lambda v: (v[0], v[1], round(v[2], 9)))
    return best


@given(
    st.integers(0, 5).flatmap(
        lambda n: st.integers(0, 5).flatmap(
            lambda m: st.tuples(
                arrays(np.float64, (n, m), elements=st.floats(0, 1)), arrays(np.bool_, (n, m), elements=st.booleans())
            )
        )
    ),
    st.sampled_from([0.1, 0.3, 0.5, 0.75]),
)
@settings(max_examples=30)
def test_the_matching_is_the_best_of_all(found: tuple[np.ndarray, np.ndarray], min_iou: float) -> None:
    overlap, same = found
    pairs = matched(overlap, same, min_iou)
    assert len({int(i) for i in pairs[:, 0]}) == len({int(j) for j in pairs[:, 1]}) == len(pairs)
    i, j = pairs.T
    assert (overlap[i, j] >= min_iou).all()
    names, count, total = by_trial(overlap, same, min_iou)
    assert (int(same[i, j].sum()), len(pairs)) == (names, count)
    assert float(overlap[i, j].sum()) == pytest.approx(total, abs=1e-9)


def turned(found: FrameAgreement) -> FrameAgreement:
    return FrameAgreement(
        found.labels_b,
        found.labels_a,
        found.scores_b,
        found.scores_a,
        found.pairs[:, ::-1],
        found.iou,
        found.same,
        found.beyond_b,
        found.beyond_a,
        found.nearest_b,
        found.nearest_a,
    )


COUNTS = ("both", "otherwise", "only_a", "only_b", "beyond_a", "beyond_b", "a", "b")


@given(layers(), layers(), st.randoms(use_true_random=False))
@settings(max_examples=25)
def test_neither_order_nor_side_matters(a: Layer, b: Layer, random: Any) -> None:
    there, back = figures([agree(a, b)]), figures([turned(agree(b, a))])
    order = list(range(len(a)))
    random.shuffle(order)
    mixed = Layer(a.boxes[order], a.scores[order], tuple(a.labels[i] for i in order), tuple(a.masks[i] for i in order))
    shuffled = figures([agree(mixed, b)])
    for other in (back, shuffled):
        for name in COUNTS:
            assert there[name] == other[name]
        assert there["share"] == other["share"]
        assert (there["mean_iou"] or 0) == pytest.approx(other["mean_iou"] or 0, abs=1e-6)
    assert there["both"] + there["otherwise"] + there["only_a"] + there["beyond_a"] == len(a)
    assert there["both"] + there["otherwise"] + there["only_b"] + there["beyond_b"] == len(b)


@given(layers())
@settings(max_examples=30)
def test_a_detector_agrees_with_itself(a: Layer) -> None:
    solid = [i for i in range(len(a)) if iou_2d(a.boxes[i], a.boxes[i])[0, 0] == 1]
    a = Layer(a.boxes[solid], a.scores[solid], tuple(a.labels[i] for i in solid), (None,) * len(solid))
    found = figures([agree(a, a)])
    assert (found["both"], found["otherwise"], found["only_a"], found["only_b"]) == (len(a), 0, 0, 0)
    assert found["share"] == (1 if len(a) else None)
    assert found["share_placed"] == (1 if len(a) else None)


def simulated(seed: int) -> SimulatedDetector:
    return SimulatedDetector(SimulationOptions(seed=seed), NAMES)


def test_masks_decide_where_both_have_them() -> None:
    a = layer_of_proposals(simulated(1).detect(SHELF, None))
    b = layer_of_proposals(simulated(2).detect(SHELF, None))
    found = overlaps(a, b)
    for i in range(0, len(a), 3):
        for j in range(len(b)):
            one, other = a.masks[i], b.masks[j]
            assert one is not None
            assert other is not None
            union = np.count_nonzero(one | other)
            assert found[i, j] == pytest.approx(np.count_nonzero(one & other) / union if union else 0, abs=1e-12)
    bare = Layer(b.boxes, b.scores, b.labels, (None, *b.masks[1:]))
    mixed = overlaps(a, bare)
    np.testing.assert_allclose(mixed[:, 0], iou_2d(a.boxes, b.boxes)[:, 0])
    np.testing.assert_allclose(mixed[:, 1:], found[:, 1:])


BOX, FAR, THIRD = [0.0, 0.0, 10.0, 10.0], [40.0, 40.0, 50.0, 50.0], [80.0, 0.0, 90.0, 9.0]


def plain(rows: list[tuple[str, float, list[float]]], names: tuple[str, ...] | None = None) -> Layer:
    boxes = np.array([r[2] for r in rows]).reshape(-1, 4)
    return Layer(boxes, np.array([r[1] for r in rows]), tuple(r[0] for r in rows), (None,) * len(rows), names)


def test_every_kind_of_disagreement_is_told_apart() -> None:
    a = plain([("mug", 0.9, BOX), ("trash can", 0.8, FAR), ("lamp", 0.4, THIRD), ("zebra", 0.3, [200, 0, 220, 20])])
    known = ("bin", "bowl", "plate", "lamp")
    b = plain([("bin", 0.7, FAR), ("bowl", 0.6, BOX), ("plate", 0.5, [120, 0, 130, 20])], known)
    found = agree(a, b)
    assert sorted(map(tuple, found.pairs.tolist())) == [(0, 1), (1, 0)]
    assert found.labels_a[int(found.pairs[found.named_otherwise[0], 0])] == "mug"
    assert found.only_a.tolist() == [2]
    assert found.only_b.tolist() == [2]
    assert found.nearest_a.tolist() == [1, 1, 0, 0]
    assert found.nearest_b.tolist() == [1, 1, 0]
    assert found.beyond_a.tolist() == [False, False, False, True]
    sums = figures([found])
    assert (sums["both"], sums["otherwise"], sums["only_a"], sums["only_b"], sums["beyond_a"]) == (1, 1, 1, 1, 1)
    assert sums["share"] == pytest.approx(2 / 6, abs=1e-6)
    assert sums["share_placed"] == pytest.approx(4 / 6, abs=1e-6)
    rows = {row["name"]: row for row in sums["classes"]}
    assert tuple(rows["trash can"][n] for n in ("a", "b", "both")) == (1, 1, 1)
    assert "bin" not in rows
    assert "zebra" not in rows
    assert rows["mug"]["otherwise"] == rows["bowl"]["otherwise"] == 1
    assert sums["renamed"] == [["mug", "bowl", 1]]
    record = agreement_record("f", found)
    assert [p["same_name"] for p in record["pairs"]].count(True) == 1
    assert record["alone_a"] == [{"index": 2, "label": "lamp", "score": 0.4, "nearest_iou": 0.0}]


def test_a_shared_name_goes_before_a_better_overlap() -> None:
    a = plain([("mug", 0.9, [0, 0, 10, 10])])
    b = plain([("lamp", 0.9, [0, 0, 10, 10]), ("mug", 0.2, [0, 0, 10, 6])])
    found = agree(a, b)
    assert found.pairs.tolist() == [[0, 1]]
    assert found.same.all()


def test_the_threshold_is_met_by_equality() -> None:
    a, b = plain([("mug", 1, [0, 0, 10, 10])]), plain([("mug", 1, [0, 0, 10, 5])])
    assert len(agree(a, b, min_iou=0.5).pairs) == 1
    assert len(agree(a, b, min_iou=0.51).pairs) == 0


@pytest.mark.parametrize("min_iou", [0, -0.1, 1.01, float("nan")])
def test_a_least_overlap_out_of_range_is_refused(min_iou: float) -> None:
    with pytest.raises(InputError, match="the least overlap"):
        agree(plain([]), plain([]), min_iou=min_iou)


def test_masks_of_other_pictures_are_refused() -> None:
    one = Layer(np.array([BOX]), np.ones(1), ("mug",), (np.ones((4, 5), np.bool_),))
    other = Layer(np.array([BOX]), np.ones(1), ("mug",), (np.ones((5, 4), np.bool_),))
    with pytest.raises(InputError, match=r"must be of one size; got \(4, 5\) and \(5, 4\)"):
        agree(one, other)


def test_empty_masks_are_of_no_thing() -> None:
    empty = Layer(np.array([BOX]), np.ones(1), ("mug",), (np.zeros((20, 20), np.bool_),))
    found = agree(empty, empty)
    assert len(found.pairs) == 0
    assert figures([found])["share"] == 0


def test_ranks_correlate_where_there_is_an_order() -> None:
    assert rank_correlation(np.array([0.1, 0.2, 0.2, 0.9]), np.array([3, 5, 5, 8])) == 1
    assert rank_correlation(np.arange(5), -np.arange(5)) == -1
    assert rank_correlation(np.ones(5), np.arange(5)) is None
    assert rank_correlation(np.arange(2), np.arange(2)) is None


def test_kappa_is_one_where_all_names_are_alike_and_none_without_a_choice() -> None:
    a = plain([("mug", 0.9, BOX), ("trash can", 0.8, FAR)])
    b = plain([("mug", 0.9, BOX), ("bin", 0.8, FAR)])
    assert figures([agree(a, b)])["name_kappa"] == 1
    assert figures([agree(plain([("mug", 0.9, BOX)]), plain([("mug", 0.9, BOX)]))])["name_kappa"] is None
    crossed = plain([("lamp", 0.9, FAR), ("mug", 0.8, BOX)])
    other = plain([("mug", 0.9, FAR), ("lamp", 0.8, BOX)])
    assert figures([agree(crossed, other)])["name_kappa"] == pytest.approx(-1)


# The job.


def pipeline_and_simulated() -> tuple[Pipeline, Detector]:
    second = open_pipeline("demo", detector="simulated", srm="rule").needed_detector()
    return open_pipeline("demo", detector="annotations", srm="rule"), second


@pytest.mark.slow
def test_the_job_compares_frame_by_frame_and_sums() -> None:
    source, second = pipeline_and_simulated()
    found = dict(agree_frames(source, second, "0:3"))
    assert list(found) == list(source.dataset.frame_ids[:3])
    sums = figures(found.values())
    assert sums["a"] == sum(len(source.dataset.load(f).annotations) for f in found)
    assert sums["both"] == sum(int(f.same.sum()) for f in found.values())
    assert sums["share"] is not None
    assert 0.5 < sums["share"] < 1
    assert sum(row["a"] for row in sums["classes"]) == sums["a"]
    assert sum(row["b"] for row in sums["classes"]) == sums["b"]
    same = figures(f for _, f in agree_frames(replace(source, detector=second), second, "0"))
    assert (same["share"], same["mean_iou"], same["only_a"], same["only_b"]) == (1, 1, 0, 0)
    assert same["score_correlation"] == pytest.approx(1)


def test_both_are_asked_for_the_same_names() -> None:
    source, second = pipeline_and_simulated()
    ((_, found),) = agree_frames(source, second, "0", names=["mug", "zebra"])
    assert set(found.labels_a) == {"mug"}
    with pytest.raises(InputError, match="knows none of the names; got zebra"):
        list(agree_frames(source, second, "0", names=["zebra"]))
