"""Features of a pair of objects: what they are, and what they do not depend on."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from network_checks import lifted, random_rows
from scenes import filled_cloud, up_of, upright

from pipeline.geometry import LiftedObject, ViewerAxes, pca_box, viewer_axes
from pipeline.relations import FEATURES, Appearance, feature_set
from pipeline.system import InputError


def some_objects(viewer: ViewerAxes, seed: int = 0, count: int = 5) -> list[LiftedObject]:
    """Clouds of solid boxes, the same ones in level coordinates whatever the viewer."""
    rng = np.random.default_rng(seed)
    found = []
    for _ in range(count):
        box = upright(rng.uniform((-1.5, -0.5, 1.5), (1.5, 1.0, 4)), rng.uniform(0.1, 0.8, 3), rng.uniform(0, 90))
        found.append(lifted(filled_cloud(box, rng, 800) @ viewer.R_level_camera, viewer))
    return found


# Features.


def slow_rel14(a: np.ndarray, b: np.ndarray) -> list[float]:
    delta, gap, share, ratio = [], [], [], []
    for k in range(3):
        (alo, ahi), (blo, bhi) = (a[k], a[3 + k]), (b[k], b[3 + k])
        delta.append((alo + ahi) / 2 - (blo + bhi) / 2)
        gap.append(alo - bhi if alo > bhi else -(blo - ahi) if blo > ahi else 0.0)
        ea, eb = max(ahi - alo, 0.001), max(bhi - blo, 0.001)
        share.append(max(min(ahi, bhi) - max(alo, blo), 0.0) / min(ea, eb))
        ratio.append(np.log(ea / eb))
    return [*delta, *gap, *share, *ratio, (a[2] + a[5]) / 2, (b[2] + b[5]) / 2]


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 10_000))
def test_rel14_is_what_it_says_for_every_pair(seed: int) -> None:
    rows = random_rows(seed)
    features = FEATURES["rel14"].pair(rows)
    for i in range(len(rows)):
        for j in range(len(rows)):
            np.testing.assert_allclose(features[i, j], slow_rel14(rows[i], rows[j]), atol=1e-12)


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 10_000))
def test_rel14_changes_its_sign_when_the_pair_is_swapped(seed: int) -> None:
    features = FEATURES["rel14"].pair(random_rows(seed))
    swapped = features.transpose(1, 0, 2)
    odd = [*range(0, 6), *range(9, 12)]
    np.testing.assert_allclose(swapped[..., odd], -features[..., odd], atol=1e-12)
    np.testing.assert_array_equal(swapped[..., 6:9], features[..., 6:9])
    np.testing.assert_array_equal(swapped[..., [12, 13]], features[..., [13, 12]])


def test_rel26_adds_place_size_and_cut_of_each_to_rel14() -> None:
    viewer = viewer_axes(up_of(15))
    objects = some_objects(viewer)
    objects[2] = replace(objects[2], quality=replace(objects[2].quality, touches_border=True))
    contract = feature_set("rel26")
    rows = contract.describe(objects, viewer)
    features = contract.pair(rows)
    np.testing.assert_array_equal(features[..., :14], FEATURES["rel14"].pair(rows[:, :6]))
    assert contract.columns[14:20] == (
        "right_a",
        "up_a",
        "log_size_right_a",
        "log_size_up_a",
        "log_size_forward_a",
        "cut_a",
    )
    for i, j in ((0, 2), (2, 1), (3, 3)):
        for half, item in ((features[i, j, 14:20], objects[i]), (features[i, j, 20:], objects[j])):
            np.testing.assert_allclose(half[:2], (item.lo + item.hi)[:2] / 2)
            np.testing.assert_allclose(np.exp(half[2:5]), item.hi - item.lo)
            assert half[5] == item.quality.touches_border
    assert {k for k in range(5) if features[k, 0, 19]} == {2}


def test_rel32_adds_the_lengths_of_each_class_to_rel26() -> None:
    viewer = viewer_axes(up_of(15))
    objects = some_objects(viewer)
    labels = ("mug", "beds", "no such thing", "cup", "sofa")
    shown = Appearance(np.zeros((5, 4)), labels, 640, 480)
    contract = feature_set("rel32")
    rows = contract.describe(objects, viewer, shown)
    features = contract.pair(rows)
    assert features.shape == (5, 5, 32) == (5, 5, contract.dimension)
    np.testing.assert_array_equal(features[..., :26], FEATURES["rel26"].pair(rows[:, :7]))
    np.testing.assert_allclose(features[1, 2, 26:29], [1, np.log(0.9), np.log(3.0)])
    np.testing.assert_array_equal(features[1, 2, 29:], 0)
    np.testing.assert_array_equal(rows[:, list(contract.named)], features[:, 0, 26:29])
    with pytest.raises(InputError, match="class names"):
        contract.describe(objects, viewer)


def test_paper30_is_both_raw_boxes_in_the_camera_frame() -> None:
    viewer = viewer_axes(up_of(25))
    objects = some_objects(viewer)
    contract = feature_set("paper30")
    features = contract.pair(contract.describe(objects, viewer))
    assert features.shape == (5, 5, 30)
    assert contract.dimension == 30
    assert contract.columns[0] == "a_T0"
    assert contract.columns[15:19] == ("b_T0", "b_T1", "b_T2", "b_R00")
    for i, j in ((0, 1), (3, 2), (4, 4)):
        for half, item in ((features[i, j, :15], objects[i]), (features[i, j, 15:], objects[j])):
            box, _ = pca_box(item.points)
            np.testing.assert_allclose(half[:3], box.center)
            np.testing.assert_allclose(half[3:12].reshape(3, 3), box.R)
            np.testing.assert_allclose(half[12:], box.size)


@pytest.mark.parametrize("name", ["rel14", "rel26", "canon30"])
def test_level_features_do_not_depend_on_pitch_and_raw_boxes_do(name: str) -> None:
    flat, steep = viewer_axes(up_of(0)), viewer_axes(up_of(30, 4))
    described = [FEATURES[name].describe(some_objects(v), v) for v in (flat, steep)]
    np.testing.assert_allclose(described[0], described[1], atol=2e-4)
    raw = [FEATURES["paper30"].describe(some_objects(v), v) for v in (flat, steep)]
    assert np.abs(raw[0] - raw[1]).max() > 0.1


def test_features_do_not_depend_on_how_the_shown_box_is_fitted() -> None:
    viewer = viewer_axes(up_of(20))
    rng = np.random.default_rng(3)
    cloud = filled_cloud(upright((0.3, 0.2, 2), (0.5, 0.3, 0.2), 30), rng, 500) @ viewer.R_level_camera
    for contract in (c for c in FEATURES.values() if not c.shown):
        one, other = (contract.describe([lifted(cloud, viewer, mode)], viewer) for mode in ("gravity", "pca-raw"))
        np.testing.assert_array_equal(one, other)


def test_an_object_of_which_only_a_box_is_known_has_features() -> None:
    viewer = viewer_axes(up_of(0))
    seen = some_objects(viewer)[0]
    assert seen.box is not None
    drawn = replace(seen, points=np.empty((0, 3), np.float32))
    for contract in (c for c in FEATURES.values() if not c.shown):
        row = contract.describe([drawn], viewer)
        assert np.isfinite(row).all()
    np.testing.assert_array_equal(FEATURES["paper30"].describe([drawn], viewer)[0, :3], seen.box.center)


def test_an_unknown_contract_is_refused() -> None:
    with pytest.raises(InputError, match=r"feature contract.*'rel15'.*rel14"):
        feature_set("rel15")
