"""Regions and placements say what the rule says."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from whatif_scenes import row

from pipeline.diagnosis.whatif.region import CELLS, REACH, place_in_region, region_of
from pipeline.geometry import Box3D, LiftedObject, Quality, ViewerAxes, extents, viewer_axes
from pipeline.language import HORIZONTAL, PAIRWISE
from pipeline.relations import Profile, T, U, letter, pairwise_states
from pipeline.system import InputError

VIEWER = viewer_axes(np.array([0.1, -0.9, -0.3]))
FRAME = row()
lengths = st.floats(0.005, 1.5)
numbers = st.floats(-2, 2)


def solid(center: np.ndarray, size: np.ndarray, viewer: ViewerAxes = VIEWER) -> LiftedObject:
    """A box without points, its centre and size given along (right, up, forward)."""
    R = viewer.R_level_camera.T
    box = Box3D(center @ viewer.matrix, R, np.asarray(size, float))
    lo, hi = extents(np.empty((0, 3)), box, viewer)
    quality = Quality(1, 0, 0, 0, False, 1, False, "box")
    return LiftedObject(np.empty((0, 3), np.float32), box, 1.0, lo, hi, None, quality)


def rule(target: LiftedObject, reference: LiftedObject, relation: str, profile: Profile) -> int:
    lo, hi = np.stack([target.lo, reference.lo]), np.stack([target.hi, reference.hi])
    return int(pairwise_states(lo, hi, None, profile)[0, 1, PAIRWISE.index(relation)])


@st.composite
def profiles(draw: st.DrawFn) -> Profile:
    if draw(st.booleans()):
        return Profile()
    cone = draw(st.floats(5, 60))
    return Profile(cone=cone, doubtful_cone=draw(st.floats(cone, 89)), dead_zone=draw(st.floats(0, 0.3)))


@settings(max_examples=12, deadline=None)
@given(
    st.sampled_from(PAIRWISE),
    st.tuples(lengths, lengths, lengths),
    st.tuples(lengths, lengths, lengths),
    st.tuples(numbers, numbers, st.floats(-1, 4)),
    profiles(),
    st.integers(0, 2**32 - 1),
)
def test_what_is_drawn_is_where_the_rule_holds(
    relation: str,
    size: tuple[float, float, float],
    extent: tuple[float, float, float],
    middle: tuple[float, float, float],
    profile: Profile,
    seed: int,
) -> None:
    reference = solid(np.array(middle), np.array(extent))
    parts = {p.label: p for p in region_of(reference, relation, np.array(size), VIEWER, profile)}
    rng, far = np.random.default_rng(seed), (np.array(size) + extent) / 2 + REACH
    levels = [(p.triangles @ VIEWER.matrix.T)[..., 1] for p in parts.values()]
    height = levels[0][0, 0] if levels else middle[1]
    if relation in HORIZONTAL:
        assert height == pytest.approx(middle[1], abs=1e-9)
    for cell in rng.integers(0, CELLS, (40, 2)):
        place = np.array(middle)
        place[[0, 2]] += far[[0, 2]] * (2 * (cell + 0.5) / CELLS - 1)
        place[1] = height
        state = rule(solid(place, np.array(size)), reference, relation, profile)
        inside = {label: _covers(p.triangles, place) for label, p in parts.items()}
        drawn = T if inside.get("T") else U if inside.get("U") else -1
        assert drawn == state, (place, inside)
        assert not (inside.get("T") and inside.get("U"))
    for part, level in zip(parts.values(), levels, strict=True):
        np.testing.assert_allclose(level, height, atol=1e-9)
        assert np.isfinite(part.lines).all()
        assert part.lines.shape[1:] == (2, 3)


def _covers(triangles: np.ndarray, place: np.ndarray) -> bool:
    """Whether a place (level axes) is well inside a triangle, seen from above."""
    corners = (triangles @ VIEWER.matrix.T)[..., [0, 2]]
    a, b, c = corners[:, 0], corners[:, 1], corners[:, 2]
    p = place[[0, 2]]

    def turn(u: np.ndarray, v: np.ndarray) -> np.ndarray:
        return (v[:, 0] - u[:, 0]) * (p[1] - u[:, 1]) - (v[:, 1] - u[:, 1]) * (p[0] - u[:, 0])

    signs = np.stack([turn(a, b), turn(b, c), turn(c, a)], axis=1)
    area = np.abs((b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0])
    return bool(((((signs >= 0).all(axis=1)) | (signs <= 0).all(axis=1)) & (area > 0)).any())


@settings(max_examples=12, deadline=None)
@given(
    st.sampled_from(PAIRWISE),
    st.tuples(lengths, lengths, lengths),
    st.tuples(lengths, lengths, lengths),
    st.tuples(numbers, numbers, numbers),
    st.tuples(numbers, numbers, numbers),
    profiles(),
)
def test_a_placement_is_the_rules_verdict_with_its_reason(
    relation: str,
    size: tuple[float, float, float],
    extent: tuple[float, float, float],
    place: tuple[float, float, float],
    middle: tuple[float, float, float],
    profile: Profile,
) -> None:
    target, reference = solid(np.array(place), np.array(size)), solid(np.array(middle), np.array(extent))
    found = place_in_region(target, reference, relation, VIEWER, profile)
    assert found.state == rule(target, reference, relation, profile)
    assert found.why.endswith(f": {letter(found.state)}")
    assert "\n" not in found.why
    assert all(np.isfinite(v) for v in found.measures.values())


@pytest.mark.parametrize(
    ("relation", "offset", "size", "words"),
    [
        ("right", (0.8, 0, 0.48), 0.2, "by gaps, within 45°: T"),
        ("right", (0.8, 0, 0.9), 0.2, "between 45° and 67.5°: U"),
        ("right", (0.5, 0, 1.8), 0.2, "beyond 67.5°: F"),
        ("right", (-0.8, 0, 0), 0.2, "lies on the other side, by 0.80 m: F"),
        ("left", (-0.03, 0, 0), 0.01, "overlap by 100%"),
        ("behind", (0, 0, 0.6), 0.2, "0° off the axis by gaps, within 45°: T"),
        ("above", (0, 0.4, 0), 0.2, "In plan the two overlap by 100%, at least 20%: T"),
        ("above", (0.5, 0.9, 0), 0.2, "rises by 72°: T"),
        ("above", (0, 0.1, 0), 0.2, "below the other's top, more than 0.05 m: F"),
        ("on", (0, 0.3, 0), 0.2, "0.00 m between its bottom and the surface below, within 0.05 m: T"),
        ("near", (1.0, 0, 0), 0.2, "m between the two, more than"),
        ("in", (0, 0, 0), 0.2, "100% of it lies inside, at least 70%: T"),
    ],
)
def test_why_in_words(relation: str, offset: tuple[float, float, float], size: float, words: str) -> None:
    middle = np.array([0.1, -0.2, 2.0])
    reference = solid(middle, np.full(3, 0.4))
    assert words in place_in_region(solid(middle + offset, np.full(3, size)), reference, relation, VIEWER).why


@pytest.mark.parametrize("relation", PAIRWISE)
def test_a_region_lies_where_a_target_can_stand_in_the_relation(relation: str) -> None:
    middle, extent, size = np.array([0.1, -0.2, 2.0]), np.array([0.6, 0.4, 0.5]), np.array([0.2, 0.15, 0.2])
    parts = {p.label: p for p in region_of(solid(middle, extent), relation, size, VIEWER)}
    # Of things on another U is a matter of height alone.
    assert set(parts) == ({"T"} if relation == "on" else {"T", "U"})
    height = float((parts["T"].triangles[0, 0] @ VIEWER.matrix.T)[1] - middle[1])
    touching = (extent[1] + size[1]) / 2
    within = {"above": (touching - 0.06, touching), "on": (touching - 0.06, touching + 0.06)}
    within["below"] = (-touching, 0.06 - touching)
    low, high = within.get(relation, (-1e-9, 1e-9))
    assert low <= height <= high
    # The outline goes around the cells: every end of a segment is the end of another one.
    ends = np.round(parts["T"].lines.reshape(-1, 3), 6)
    assert (np.unique(ends, axis=0, return_counts=True)[1] % 2 == 0).all()


def test_a_region_of_nothing_is_refused() -> None:
    reference = solid(np.zeros(3), np.ones(3))
    lost = replace(reference, lo=np.full(3, np.nan), hi=np.full(3, np.nan), box=None)
    for thing, relation, size in (
        (lost, "left", np.ones(3)),
        (reference, "between", np.ones(3)),
        (reference, "left", np.full(3, np.nan)),
        (reference, "left", np.ones(2)),
    ):
        with pytest.raises(InputError):
            region_of(thing, relation, size, VIEWER)
    assert place_in_region(lost, reference, "left", VIEWER).state == U
    with pytest.raises(InputError):
        place_in_region(reference, reference, "closest", VIEWER)
