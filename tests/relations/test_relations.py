"""The relation profile: worked cases, hand-made scenes, and what must hold of any scene."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scenes import filled_cloud, frame_of, up_of, upright

from pipeline.geometry import extents, viewer_axes
from pipeline.language import DIRECTIONAL, INVERSE, PAIRWISE, PHRASE, VOCABULARIES
from pipeline.relations import F, RuleScorer, T, U, directional_states, letter, make_scorer, pairwise_states
from pipeline.relations.scorer import between_states, distances, superlative_states

SEEDS = st.integers(0, 2**32 - 1)


def states(*boxes: tuple, clouds: list | None = None) -> np.ndarray:
    """States of boxes given as (center, size) along (right, up, forward)."""
    center, size = (np.array([b[k] for b in boxes], float) for k in (0, 1))
    return pairwise_states(center - size / 2, center + size / 2, clouds)


def of(relation: str, found: np.ndarray, a: int = 0, b: int = 1) -> int:
    return int(found[a, b, PAIRWISE.index(relation)])


def true_of(found: np.ndarray, a: int = 0, b: int = 1) -> set[str]:
    return {r for r in DIRECTIONAL if of(r, found, a, b) == T}


def test_the_409_worked_cases_hold_exactly(shared_data: Path) -> None:
    cases = json.loads((shared_data / "golden" / "relations-viewer-cone-v1.json").read_text())["cases"]
    assert len(cases) == 409
    wrong = []
    for number, case in enumerate(cases):
        lo, hi = ([case[k][end] for k in "ab"] for end in ("lo", "hi"))
        found = directional_states(np.array(lo), np.array(hi))
        for a, b, key in ((0, 1, "a_to_b"), (1, 0, "b_to_a")):
            got = {r: letter(found[a, b, n]) for n, r in enumerate(DIRECTIONAL)}
            if got != case[key]:
                wrong.append((number, case["why"], key, got, case[key]))
    assert not wrong, wrong[:3]


def test_the_worked_cases_hold_all_at_once_too(shared_data: Path) -> None:
    """A pair's states must not depend on what else is in the scene."""
    cases = json.loads((shared_data / "golden" / "relations-viewer-cone-v1.json").read_text())["cases"][:60]
    lo, hi = (np.array([case[k][end] for case in cases for k in "ab"]) for end in ("lo", "hi"))
    found = directional_states(lo, hi)
    for k, case in enumerate(cases):
        got = {r: letter(found[2 * k, 2 * k + 1, n]) for n, r in enumerate(DIRECTIONAL)}
        assert got == case["a_to_b"], case["why"]


# By hand.

CUBE = (0.2, 0.2, 0.2)
EXACT = (0.25, 0.25, 0.25)
"""Its gaps are exact in binary, so that a case may lie on the 45 degrees themselves."""


@pytest.mark.parametrize(
    ("a", "holds"),
    [
        ((-1.0, 0, 2), {"left"}),
        ((1.0, 0, 2), {"right"}),
        ((0, 0, 1.0), {"front"}),
        ((0, 0, 3.0), {"behind"}),
        ((0, 1.0, 2), {"above"}),
        ((0, -1.0, 2), {"below"}),
        ((-1.0, 0, 1.0), {"left", "front"}),
        ((-1.0, 0, 1.4), {"left"}),
    ],
)
def test_one_cube_around_another(a: tuple, holds: set[str]) -> None:
    found = states((a, EXACT), ((0, 0, 2), EXACT))
    assert true_of(found) == holds
    assert true_of(found, 1, 0) == {INVERSE[r] for r in holds}


def test_a_displacement_between_the_cones_is_in_doubt() -> None:
    # Gaps of 0.4 across and 0.8 along: 63 degrees, past the 45 of T and inside the 67.5 of U.
    found = states(((-0.6, 0, 1.0), CUBE), ((0, 0, 2), CUBE))
    assert of("front", found) == T
    assert of("left", found) == U
    # 0.3 and 0.8 make 69 degrees.
    assert of("left", states(((-0.5, 0, 1.0), CUBE), ((0, 0, 2), CUBE))) == F


@pytest.mark.parametrize(("shift", "state"), [(0.0, F), (0.04, U), (0.06, T)])
def test_the_dead_zone_of_left_and_right(shift: float, state: int) -> None:
    # Thin panels, so that the overlap of the extents says nothing.
    thin = (0.001, 0.2, 0.2)
    assert of("right", states(((shift, 0, 2), thin), ((0, 0, 2), thin))) == state


@pytest.mark.parametrize(("z", "state"), [(2.0, T), (6.0, U)])
def test_the_dead_zone_of_depth_grows_with_distance(z: float, state: int) -> None:
    thin = (0.2, 0.2, 0.001)
    found = states(((0, 0, z + 0.11), thin), ((0, 0, z), thin))
    assert of("behind", found) == state
    assert of("front", found, 1, 0) == state


def test_overlap_along_the_axis_excludes_and_doubts() -> None:
    wide = (1.0, 0.2, 0.2)
    assert of("right", states(((0.15, 0, 2), wide), ((0, 0, 2), wide))) == F
    assert of("right", states(((0.40, 0, 2), wide), ((0, 0, 2), wide))) == U
    assert of("right", states(((0.60, 0, 2), wide), ((0, 0, 2), wide))) == T


def test_a_millimetre_does_not_flip_left_into_behind() -> None:
    # The gap to the left is near the switch from gaps to centres, and the centres say "behind".
    deep = (0.2, 0.2, 1.0)

    def pair(gap: float) -> np.ndarray:
        return states(((-0.2 - gap, 0, 2.8), deep), ((0, 0, 2), deep))

    assert of("left", pair(0.05)) == T
    assert of("behind", pair(0.05)) == F
    assert of("left", pair(0.01)) == F
    assert of("behind", pair(0.01)) == T
    for gap in (0.0201, 0.025, 0.0299, 0.0301, 0.035, 0.0399):
        assert of("left", pair(gap)) == of("behind", pair(gap)) == U


def test_above_asks_for_something_underneath() -> None:
    table = ((0, 0, 2), (1.0, 0.05, 1.0))
    assert of("above", states(((0, 0.2, 2), CUBE), table)) == T
    assert of("above", states(((2.0, 0.2, 2), CUBE), table)) == F, "higher, but far aside"
    assert of("above", states(((0.9, 0.8, 2), CUBE), table)) == T, "aside, but steeply higher"
    assert of("below", states(((0, -0.5, 2), CUBE), table)) == T
    assert of("above", states(((0, 0.11, 2), CUBE), table)) == T, "sinks in by a centimetre of noise"


def test_on_needs_contact_and_room() -> None:
    table = ((0, 0.7, 2), (1.0, 0.1, 1.0))

    def cup(bottom: float) -> np.ndarray:
        return states(((0.2, bottom + 0.1, 2), CUBE), table)

    assert of("on", cup(0.75)) == T
    assert of("on", cup(0.79)) == T
    assert of("on", cup(0.85)) == U
    assert of("on", cup(1.0)) == F
    assert of("on", cup(0.75), 1, 0) == F
    board = states(((0, 0.8, 2), (1.4, 0.1, 1.4)), table)
    assert of("on", board) == F, "larger than what should bear it"


def test_on_reads_the_surface_under_the_footprint_and_not_the_top_of_the_back() -> None:
    rng = np.random.default_rng(0)
    seat = rng.uniform([-0.5, 0.4, 1.5], [0.5, 0.45, 2.1], (4000, 3))
    back = rng.uniform([-0.5, 0.4, 2.4], [0.5, 1.0, 2.5], (4000, 3))
    sofa = np.concatenate([seat, back])
    cushion = rng.uniform([-0.1, 0.45, 1.6], [0.1, 0.6, 1.8], (2000, 3))
    lo, hi = np.stack([cushion.min(0), sofa.min(0)]), np.stack([cushion.max(0), sofa.max(0)])
    assert of("on", pairwise_states(lo, hi, [cushion, sofa])) == T
    assert of("on", pairwise_states(lo, hi)) == F


def test_the_surface_is_the_top_of_what_lies_under_the_footprint() -> None:
    rng = np.random.default_rng(0)
    block = rng.uniform([-0.5, 0, 1.5], [0.5, 0.4, 2.5], (4000, 3))
    cup = rng.uniform([-0.05, 0.4, 1.95], [0.05, 0.5, 2.05], (500, 3))
    # A rod far aside makes the block's extents higher than what bears the cup.
    rod = rng.uniform([0.45, 0.4, 2.45], [0.5, 1.2, 2.5], (400, 3))
    bearer = np.concatenate([block, rod])
    lo, hi = np.stack([cup.min(0), bearer.min(0)]), np.stack([cup.max(0), bearer.max(0)])
    assert of("on", pairwise_states(lo, hi, [cup, bearer])) == T


def test_in_counts_points_and_needs_the_rim_above() -> None:
    bowl = ((0, 0.1, 2), (0.6, 0.2, 0.6))
    assert of("in", states(((0, 0.1, 2), (0.1, 0.1, 0.1)), bowl)) == T
    assert of("in", states(((0, 0.3, 2), (0.1, 0.1, 0.1)), bowl)) == F
    assert of("in", states(((0.32, 0.1, 2), (0.2, 0.1, 0.1)), bowl)) == U
    sheet = ((0, 0.208, 2), (0.3, 0.016, 0.3))
    assert of("in", states(sheet, bowl)) == F, "within the margin of the rim, but on it"
    rng = np.random.default_rng(0)
    apple = rng.uniform([-0.05, 0.05, 1.95], [0.05, 0.15, 2.05], (500, 3))
    outside = apple + np.array([0.5, 0, 0])
    lo, hi = np.array([[-0.05, 0.05, 1.95], [-0.3, 0, 1.7]]), np.array([[0.55, 0.15, 2.05], [0.3, 0.2, 2.3]])

    def mixed(inside: int) -> int:
        cloud = np.concatenate([apple[:inside], outside[inside:]])
        return of("in", pairwise_states(lo, hi, [cloud, np.zeros((0, 3))]))

    assert [mixed(n) for n in (450, 275, 100)] == [T, U, F]


def test_near_is_measured_in_sizes() -> None:
    diagonal = np.sqrt(3) * 0.2
    for factor, state in ((0.4, T), (0.6, U), (0.9, U), (1.1, F)):
        found = states(((0, 0, 2), CUBE), ((0.2 + factor * diagonal, 0, 2), CUBE))
        assert of("near", found) == of("near", found, 1, 0) == state


def test_an_object_without_extents_is_in_doubt_with_all_others() -> None:
    lo, hi = np.random.default_rng(0).uniform(0, 1, (4, 3)), np.random.default_rng(1).uniform(1, 2, (4, 3))
    full = pairwise_states(lo, hi)
    lo2, hi2 = np.insert(lo, 2, np.nan, axis=0), np.insert(hi, 2, np.nan, axis=0)
    found = pairwise_states(lo2, hi2)
    others = np.array([0, 1, 3, 4])
    assert (found[2, others] == U).all()
    assert (found[others, 2] == U).all()
    assert (found[2, 2] == F).all()
    np.testing.assert_array_equal(found[np.ix_(others, others)], full)


# Of any scene.


def random_extents(rng: np.random.Generator, n: int) -> tuple[np.ndarray, np.ndarray]:
    """Objects at several scales, some touching and some exactly aligned."""
    center = rng.uniform([-1, -0.7, 1], [1, 0.7, 3], (n, 3)) * rng.choice([0.2, 1.0])
    center = np.where(rng.random((n, 3)) < 0.3, np.round(center, 1), center)
    size = rng.uniform(0, 0.8, (n, 3)) * rng.choice([0.1, 1.0], (n, 1))
    return center - size / 2, center + size / 2


@given(SEEDS)
def test_opposites_are_each_others_mirror(seed: int) -> None:
    lo, hi = random_extents(np.random.default_rng(seed), 8)
    found = pairwise_states(lo, hi)
    for relation, inverse in INVERSE.items():
        one, other = found[..., PAIRWISE.index(relation)], found[..., PAIRWISE.index(inverse)]
        np.testing.assert_array_equal(one, other.T)
        assert not ((one == T) & (other == T)).any(), f"{relation} and {inverse} at once"
    near = found[..., PAIRWISE.index("near")]
    np.testing.assert_array_equal(near, near.T)
    assert (found[np.eye(8, dtype=bool)] == F).all()
    assert set(np.unique(found)) <= {T, U, F}


@given(SEEDS)
def test_a_permutation_of_the_objects_permutes_the_states(seed: int) -> None:
    rng = np.random.default_rng(seed)
    lo, hi = random_extents(rng, 7)
    order = rng.permutation(7)
    np.testing.assert_array_equal(pairwise_states(lo[order], hi[order]), pairwise_states(lo, hi)[np.ix_(order, order)])


@given(SEEDS)
def test_a_mirrored_scene_swaps_left_and_right_only(seed: int) -> None:
    lo, hi = random_extents(np.random.default_rng(seed), 7)
    flip = np.array([-1, 1, 1])
    found = pairwise_states(lo, hi)
    mirrored = pairwise_states(np.minimum(lo * flip, hi * flip), np.maximum(lo * flip, hi * flip))
    swapped = [PAIRWISE.index({"left": "right", "right": "left"}.get(r, r)) for r in PAIRWISE]
    np.testing.assert_array_equal(mirrored, found[..., swapped])


@given(SEEDS)
@settings(max_examples=30)
def test_moving_the_scene_aside_or_up_changes_nothing(seed: int) -> None:
    rng = np.random.default_rng(seed)
    # A grid of eighths is exact in binary, so that no rounding can cross a threshold.
    lo = rng.integers(-8, 8, (7, 3)) / 8
    hi = lo + rng.integers(0, 6, (7, 3)) / 8
    moved = np.array([rng.integers(-4, 4), rng.integers(-4, 4), 0.0])
    np.testing.assert_array_equal(pairwise_states(lo + moved, hi + moved), pairwise_states(lo, hi))


@given(SEEDS)
@settings(max_examples=20, deadline=None)
def test_pitching_the_camera_changes_nothing(seed: int) -> None:
    """The same scene seen by a camera that pitches and rolls about its centre: the level axes take it back."""
    rng = np.random.default_rng(seed)
    centers, sizes = rng.uniform([-1, -0.5, 1.5], [1, 0.5, 3], (5, 3)), rng.uniform(0.1, 0.6, (5, 3))
    clouds = [filled_cloud(upright(c, s, rng.uniform(0, 90)), rng) for c, s in zip(centers, sizes, strict=True)]
    found = []
    for pitch, roll in ((0.0, 0.0), (rng.uniform(-35, 60), 0.0), (rng.uniform(-20, 40), rng.uniform(-10, 10))):
        viewer = viewer_axes(up_of(pitch, roll))
        seen = [cloud @ viewer.R_level_camera for cloud in clouds]
        lo, hi = zip(*(extents(s, None, viewer) for s in seen), strict=True)
        found.append((np.stack(lo), np.stack(hi)))
    for lo, hi in found[1:]:
        np.testing.assert_allclose(lo, found[0][0], atol=1e-9)
        np.testing.assert_allclose(hi, found[0][1], atol=1e-9)
        np.testing.assert_array_equal(directional_states(lo, hi), directional_states(*found[0]))


def test_no_objects_and_one_object() -> None:
    assert pairwise_states(np.zeros((0, 3)), np.zeros((0, 3))).shape == (0, 0, len(PAIRWISE))
    assert (pairwise_states(np.zeros((1, 3)), np.ones((1, 3))) == F).all()


# Rows: closest, farthest, between.

ROW_LO = np.array([[x, 0, 2] for x in (0.0, 1.0, 2.0, 3.0, 4.0)])
ROW_HI = ROW_LO + 0.2


def test_closest_and_farthest_of_a_row() -> None:
    assert superlative_states(ROW_LO, ROW_HI, [1, 2, 3, 4], [0])[:, 0].tolist() == [T, F, F, F]
    assert superlative_states(ROW_LO, ROW_HI, [1, 2, 3, 4], [0], farthest=True)[:, 0].tolist() == [F, F, F, T]
    both = superlative_states(ROW_LO, ROW_HI, [1, 2, 3], [0, 4])
    assert both.tolist() == [[T, F], [F, F], [F, T]]


def test_an_object_is_no_candidate_for_itself() -> None:
    assert superlative_states(ROW_LO, ROW_HI, [0, 1, 2], [0])[:, 0].tolist() == [F, T, F]
    assert superlative_states(ROW_LO, ROW_HI, [0, 1], [0], farthest=True)[:, 0].tolist() == [F, T]
    assert superlative_states(ROW_LO, ROW_HI, [2], [2]).tolist() == [[F]]


def test_ties_and_near_ties_for_the_closest() -> None:
    assert superlative_states(ROW_LO, ROW_HI, [1, 3, 4], [2])[:, 0].tolist() == [T, T, F]
    lo, hi = ROW_LO.copy(), ROW_HI.copy()
    lo[3, 0] += 0.02
    hi[3, 0] += 0.02
    assert superlative_states(lo, hi, [1, 3, 4], [2])[:, 0].tolist() == [T, U, F]
    lo[3, 0] += 0.02
    hi[3, 0] += 0.02
    assert superlative_states(lo, hi, [1, 3, 4], [2])[:, 0].tolist() == [T, F, F]


def test_objects_that_touch_the_reference_are_told_apart_by_their_centres() -> None:
    lo = np.array([[0, 0, 0], [0.1, 0, 0], [0.4, 0, 0.0]])
    hi = lo + np.array([[1, 1, 1], [0.1, 0.1, 0.1], [0.2, 0.2, 0.2]])
    found = superlative_states(lo, hi, [1, 2], [0])[:, 0]
    assert found[1] == T
    assert found[0] == U


def test_an_unknown_object_is_never_the_closest() -> None:
    lo, hi = ROW_LO.copy(), ROW_HI.copy()
    lo[1] = hi[1] = np.nan
    assert superlative_states(lo, hi, [1, 2, 3], [0])[:, 0].tolist() == [F, T, F]
    assert superlative_states(lo, hi, [1, 2, 3], [0], farthest=True)[:, 0].tolist() == [F, F, T]
    assert superlative_states(lo, hi, [2, 3], [1]).tolist() == [[F], [F]]


def test_nobody_competes() -> None:
    assert superlative_states(ROW_LO, ROW_HI, [], [0]).shape == (0, 1)
    assert superlative_states(ROW_LO, ROW_HI, [0], []).shape == (1, 0)


@given(SEEDS)
def test_distances_are_those_of_the_extents(seed: int) -> None:
    rng = np.random.default_rng(seed)
    lo, hi = random_extents(rng, 5)
    away = distances(lo, hi)
    np.testing.assert_array_equal(away, away.T)
    points = [rng.uniform(low, high, (300, 3)) for low, high in zip(lo, hi, strict=True)]
    for a in range(5):
        for b in range(5):
            nearest = np.clip(points[a], lo[b], hi[b])
            assert np.linalg.norm(points[a] - nearest, axis=1).min() >= away[a, b] - 1e-9
    assert (away[np.eye(5, dtype=bool)] == 0).all()


def test_between_is_the_corridor() -> None:
    lo = np.array([[0, 0, 2], [4, 0, 2], [2, 0, 2], [0.4, 0, 2], [2, 0, 3.4], [2, 0, 4.5], [5, 0, 2], [2, 3, 2.0]])
    hi = lo + 0.2
    found = between_states(lo, hi, range(2, 8), [0], [1])[:, 0, 0].tolist()
    assert found == [T, U, U, F, F, T], "middle, near one end, aside, far aside, beyond, above the line"
    np.testing.assert_array_equal(found, between_states(lo, hi, range(2, 8), [1], [0])[:, 0, 0])


def test_nothing_is_between_itself_and_another() -> None:
    found = between_states(ROW_LO, ROW_HI, range(5), range(5), range(5))
    for c in range(5):
        for i in range(5):
            for j in range(5):
                if len({c, i, j}) < 3:
                    assert found[c, i, j] == F
    assert found[2, 1, 3] == T
    assert found[2, 3, 1] == T
    lo, hi = ROW_LO.copy(), ROW_HI.copy()
    lo[1] = hi[1] = np.nan
    assert (between_states(lo, hi, [2], [1], [3]) == F).all()


# What is shown.


def test_every_relation_has_its_phrase_and_vocabularies_name_known_ones() -> None:
    assert set(PHRASE) >= set(PAIRWISE) | {"between", "closest", "farthest"}
    assert all(set(names) <= set(PAIRWISE) for names in VOCABULARIES.values())
    assert [letter(s) for s in (T, U, F)] == ["T", "U", "F"]


def test_the_rule_scorer_turns_states_into_probabilities() -> None:
    from pipeline.answering import PreparedFrame, all_objects
    from pipeline.proposals import AnnotationDetector

    frame = frame_of([upright((-0.4, 0.9, 2), (0.3, 0.3, 0.3)), upright((0.4, 0.9, 2), (0.3, 0.3, 0.3))], ["a", "b"])
    context = PreparedFrame(frame)
    scorer = make_scorer("rule")
    assert isinstance(scorer, RuleScorer)
    scores = scorer.score([o.lifted for o in all_objects(context, AnnotationDetector(("a", "b")))], context.viewer)
    assert scores.relations == PAIRWISE
    assert scores.of("left")[0, 1] == 0.95
    assert scores.of("right")[0, 1] == 0.05
    np.testing.assert_array_equal(scores.probabilities, np.array([0.05, 0.5, 0.95])[scores.states + 1])
    assert scorer.score([], context.viewer).probabilities.shape == (0, 0, len(PAIRWISE))


def test_an_unknown_scorer_is_refused() -> None:
    from pipeline.system import InputError

    with pytest.raises(InputError, match=r"no relation scorer 'magic'.*rule"):
        make_scorer("magic")
