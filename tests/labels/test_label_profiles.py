"""Rule profiles: margins that agree with states, hashes that follow the thresholds, and the published geometry."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pipeline.labels import GIVEN, PROFILES, profile_of
from pipeline.language import INVERSE, PAIRWISE
from pipeline.system import InputError

NAMES = [name for name in PROFILES if name != GIVEN]


def random_extents(seed: int, n: int = 7) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    center = rng.uniform((-0.8, -0.4, 1.0), (0.8, 0.5, 2.5), (n, 3))
    half = rng.uniform(0.01, 0.35, (n, 3))
    return center - half, center + half


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 10**6), st.sampled_from(NAMES))
def test_the_margin_has_the_sign_of_the_state(seed: int, name: str) -> None:
    lo, hi = random_extents(seed)
    judged = PROFILES[name].judge(lo, hi, (lo + hi) / 2, None)
    off = ~np.eye(len(lo), dtype=bool)
    states, margins = judged.states[off], judged.margins[off]
    judged_columns = [PAIRWISE.index(r) for r in PROFILES[name].relations]
    states, margins = states[:, judged_columns], margins[:, judged_columns]
    assert (margins[states == 1] >= 0).all()
    assert (margins[states == -1] <= 0).all()
    assert (margins[states == 0] == 0).all()
    # Nearly every decision stands by something: a margin of 0 is the exception.
    assert (np.abs(margins[states != 0]) > 1e-9).mean() > 0.9


def test_geometry_decides_nothing_of_what_the_dataset_gives() -> None:
    lo, hi = random_extents(3)
    judged, measured = (PROFILES[name].judge(lo, hi, (lo + hi) / 2, None) for name in (GIVEN, "viewer-cone-v1"))
    off = ~np.eye(len(lo), dtype=bool)
    assert not judged.states[off].any()
    assert not judged.margins.any()
    np.testing.assert_array_equal(judged.distance, measured.distance)


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 10**6), st.integers(0, 10**6))
def test_a_shift_smaller_than_the_margin_leaves_a_direction_as_it_is(seed: int, shift: int) -> None:
    """Moving one object by less than half the margin cannot turn left into not-left.

    Half: a shift changes both the displacement and the overlap, and a cone's
    slack by at most its own length. The dead zone in depth grows with the
    distance, by 2 %.
    """
    profile = PROFILES["viewer-cone-v1"]
    lo, hi = random_extents(seed, 6)
    before = profile.judge(lo, hi, (lo + hi) / 2, None)
    direction = np.random.default_rng(shift).normal(size=3)
    direction /= np.linalg.norm(direction)
    horizontal = [PAIRWISE.index(r) for r in ("left", "right", "front", "behind")]
    least = np.abs(before.margins[0, 1:][:, horizontal])
    step = 0.45 * least[least > 1e-6].min()
    moved_lo, moved_hi = lo.copy(), hi.copy()
    moved_lo[0] += step * direction
    moved_hi[0] += step * direction
    after = profile.judge(moved_lo, moved_hi, (moved_lo + moved_hi) / 2, None)
    decided = before.margins[0, 1:][:, horizontal] != 0
    same = after.states[0, 1:][:, horizontal] == before.states[0, 1:][:, horizontal]
    assert same[decided].all()


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("seed", range(20))
def test_inverse_relations_mirror(name: str, seed: int) -> None:
    lo, hi = random_extents(seed)
    judged = PROFILES[name].judge(lo, hi, (lo + hi) / 2, None)
    for relation, inverse in INVERSE.items():
        if name != "viewer-cone-v1":
            continue
        a, b = PAIRWISE.index(relation), PAIRWISE.index(inverse)
        np.testing.assert_array_equal(judged.states[..., a], judged.states[..., b].T)
        np.testing.assert_allclose(judged.margins[..., a], judged.margins[..., b].T, atol=1e-12)


def test_unknown_extents_are_in_doubt_and_have_no_margin() -> None:
    lo, hi = random_extents(3)
    lo[2] = hi[2] = np.nan
    for profile in PROFILES.values():
        judged = profile.judge(lo, hi, (lo + hi) / 2, None)
        others = [k for k in range(len(lo)) if k != 2]
        assert (judged.states[2, others] == 0).all()
        assert (judged.margins[2] == 0).all()
        assert np.isnan(judged.distance[2]).all()


def test_the_published_geometry_of_semantic_abstraction() -> None:
    """By hand: reference 0.5 m wide at 2 m; its reach is 2 x 0.5 m = 1 m."""
    reference = np.array([0.0, 0.0, 2.0])
    offsets = {
        "left": (-0.9, 0, 0),
        "right": (0.9, 0, 0),
        "behind": (0, 0, 0.9),
        "front": (0, 0, -0.9),
        None: (1.1, 0, 0),  # beyond the reach
    }
    for relation, offset in offsets.items():
        centers = np.stack([reference + offset, reference])
        half = np.array([[0.05] * 3, [0.25] * 3])
        judged = PROFILES["semantic-abstraction-published"].judge(centers - half, centers + half, centers, None)
        said = {r for k, r in enumerate(PAIRWISE) if judged.states[0, 1, k] == 1}
        assert said == ({relation} if relation else set())
    # 53.13 degrees off the axis is the edge of the cone: cosine 0.6.
    for angle, holds in ((52.0, True), (54.0, False)):
        a = np.deg2rad(angle)
        centers = np.stack([reference + 0.8 * np.array([np.cos(a), 0, np.sin(a)]), reference])
        half = np.array([[0.05] * 3, [0.25] * 3])
        judged = PROFILES["semantic-abstraction-published"].judge(centers - half, centers + half, centers, None)
        assert bool(judged.states[0, 1, PAIRWISE.index("right")] == 1) is holds


def test_something_on_the_reference_gets_no_direction() -> None:
    lo = np.array([[-0.05, 0.5, 1.6], [-0.5, 0.0, 1.5]])
    hi = np.array([[0.05, 0.6, 1.7], [0.5, 0.5, 2.5]])
    judged = PROFILES["semantic-abstraction-published"].judge(lo, hi, (lo + hi) / 2, None)
    assert [r for k, r in enumerate(PAIRWISE) if judged.states[0, 1, k] == 1] == ["on"]
    assert (judged.margins[0, 1][:2] <= 0).all()


def test_hashes_tell_profiles_apart_and_are_stable() -> None:
    hashes = {p.hash for p in PROFILES.values()}
    assert len(hashes) == len(PROFILES)
    assert all(len(h) == 64 for h in hashes)
    assert PROFILES["viewer-cone-v1"].parameters["cone"] == 45.0


def test_an_unknown_profile_is_one_clear_error() -> None:
    with pytest.raises(InputError, match="no such rule profile"):
        profile_of("half-space")
