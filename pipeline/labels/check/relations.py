"""Rules on relations: what cannot hold together, what is missing, and what geometry says.

In every profile here a directional relation asks that centres (or mean points)
be ordered along one axis, strictly. Such a relation has no cycle and never
holds both ways, though a cone is not transitive; a finding is then always an
error. "On" and "in" compare surfaces and points, not an order: two flat things
side by side at one height may each lie within 5 cm of "on" the other. Where the
extents allow that, the finding is a warning.

Against geometry stands what the stored extents say under the rules that the manifest names.
Distances and all relations but on and in follow from the extents alone, and are
compared exactly. "On" and "in" also read the objects' points, which labels do not keep:
of them only what extents can decide is checked, as a lowest and a highest state.

- "a on b" asks that 30 % of a's footprint lie over b's, that a's footprint be
  less than 1.5 times b's, and that a's bottom be near b's surface. The first two
  follow from the extents; the surface lies between b's bottom and top, give or
  take SURFACE_SLACK for the points beyond the percentiles.
- "a in b" asks that a reach below b's top, which follows from the extents, and
  that enough of a's points lie in b: surely not where the extents are apart,
  surely where a's lie within b's.

Where the labels say that a second opinion doubts the rules, U is what is expected.

In `semantic-abstraction-published` directions follow from extents, mean points
and the stored "on" and "in". Without stored "on" and "in" a pair that may touch
can be refused any direction, so that only T is compared.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from functools import partial

import numpy as np

from pipeline.labels.check.view import Finding, FrameView, state_letter
from pipeline.labels.profiles import GIVEN, JudgedPairs, semantic_abstraction_directions
from pipeline.language.relation_names import HORIZONTAL, INVERSE, MIRRORED, OPPOSITES, PAIRWISE, PHRASE
from pipeline.relations.pair_measures import NOT_JUDGED, AllMeasures
from pipeline.relations.relations import (
    PREDICATES,
    F,
    PairMeasures,
    Profile,
    T,
    U,
    known_extents,
    letter,
    measure_pairs,
    pair_margins,
    pair_states,
)
from pipeline.system.frozen import dataclass

MIRRORED_PROFILES = ("viewer-cone-v1",)
"""Profiles in which "a left of b" and "b right of a" are one question."""

STRICT = tuple(name for name in PAIRWISE if MIRRORED.get(name) != name)
"""Relations that hold one way at most, and without cycles."""


def check_relations(view: FrameView, expected: Expected | None, profile: str) -> Iterator[Finding]:
    """All rules on relations but the comparison with geometry.

    `expected` is what the extents say, from `EXPECTED`; without it contradictions that geometry may allow stay
    warnings.
    """
    if not len(view.ids):
        return
    states, named = view.states, view.named
    both, relations = view.related[:, None] & view.related[None, :], view.relations
    lacking = both & ~np.eye(len(view.ids), dtype=np.bool_) & ~view.present
    yield from view.where(
        "relation/pair-missing",
        lacking & (view.present.T | np.triu(np.ones_like(lacking), 1)),
        lambda a, b: (
            f"{named(a)} to {named(b)} has no row, "
            + ("the other way has one" if view.present[b, a] else "nor has the other way")
        ),
    )
    for relation in states:
        yield from _stateless(view, relation)
    yield from view.where(
        "relation/unexpected",
        view.present & ~both,
        lambda a, b: f"{named(a)} to {named(b)}: background takes part in no relation",
    )
    for number in relations["a"][relations["a"] == relations["b"]]:
        yield view.finding("relation/unexpected", (number, number), "a relation of an object with itself")
    opposites = [(one, other) for one, other in OPPOSITES if one in states and other in states]
    for pair in opposites if profile in MIRRORED_PROFILES else ():
        yield from _inverse(view, *pair)
    for pair in opposites:
        yield from _exclusive(view, *pair)
    strict = [relation for relation in STRICT if relation in states]
    for relation in strict:
        yield from _both_ways(view, relation, expected)
    yield from _cycles(view, strict, expected)


def _stateless(view: FrameView, relation: str) -> Iterator[Finding]:
    return view.where(
        "relation/pair-missing",
        view.present & (view.states[relation] == NOT_JUDGED),
        lambda a, b: f"{view.relation_text(a, relation, b)} has no state",
        lambda *_: {"relation": relation},
    )


def _inverse(view: FrameView, one: str, other: str) -> Iterator[Finding]:
    state, mirrored, text = view.states[one], view.states[other].T, view.relation_text
    return view.where(
        "relation/inverse",
        (state != mirrored) & (state != NOT_JUDGED) & (mirrored != NOT_JUDGED),
        lambda a, b: (
            f"{text(a, one, b)} is {state_letter(state[a, b])}, {text(b, other, a)} is {state_letter(mirrored[a, b])}"
        ),
        lambda a, b: {"relation": one, one: state[a, b], other: mirrored[a, b]},
    )


def _exclusive(view: FrameView, one: str, other: str) -> Iterator[Finding]:
    return view.where(
        "relation/exclusive",
        (view.states[one] == T) & (view.states[other] == T),
        lambda a, b: f"{view.relation_text(a, one, b)} and {PHRASE[other]} it",
        lambda *_: {"relation": one},
    )


def _both_ways(view: FrameView, relation: str, expected: Expected | None) -> Iterator[Finding]:
    holds = view.states[relation] == T
    impossible = _impossible(relation, expected, len(holds))
    return view.where(
        "relation/antisymmetry",
        np.triu(holds & holds.T),
        lambda a, b: f"{view.relation_text(a, relation, b)}, and the other way too",
        lambda *_: {"relation": relation},
        np.asarray(impossible | impossible.T),
    )


def _impossible(relation: str, expected: Expected | None, n: int) -> np.ndarray:
    """(N, N) bool: pairs with a surely false relation, so that a contradiction is an error."""
    if relation in INVERSE:
        return np.ones((n, n), np.bool_)
    high = None if expected is None else expected.high.get(relation)
    return np.zeros((n, n), np.bool_) if high is None else high == F


def _cycles(view: FrameView, relations: Sequence[str], expected: Expected | None) -> Iterator[Finding]:
    n = len(view.ids)
    holds = np.array([view.states[relation] == T for relation in relations]).reshape(-1, n, n)
    # Two ways at once is a finding of its own; without those edges the longer cycles remain.
    holds &= ~np.swapaxes(holds, 1, 2)
    if not has_cycle(holds):
        return
    which, a, b = np.nonzero(holds)
    from scipy.sparse import csr_matrix
    from scipy.sparse.csgraph import connected_components

    # All relations as one graph without edges between them.
    size = len(relations) * n
    graph = csr_matrix((np.ones(len(which), np.int8), (which * n + a, which * n + b)), (size, size))
    knot = connected_components(graph, directed=True, connection="strong")[1]
    for number in np.flatnonzero(np.bincount(knot) > 1):
        nodes = np.flatnonzero(knot == number)
        relation, members = relations[int(nodes[0] // n)], nodes % n
        cycle = members[shortest_cycle(holds[nodes[0] // n][np.ix_(members, members)])]
        edges = np.stack([cycle, np.roll(cycle, -1)])
        margins = view.margins[relation][tuple(edges)]
        chain = f" {PHRASE[relation]} ".join(view.named(k) for k in [*cycle, cycle[0]])
        named = {f"margin_{a}_{b}": m for a, b, m in zip(*view.ids[edges], margins, strict=True)}
        yield view.finding(
            "relation/cycle",
            tuple(view.ids[cycle]),
            f"{chain}; margins {', '.join(f'{m:.3f}' for m in margins)} m",
            {"relation": relation, "objects_in_knot": len(members), **named},
            "error" if _impossible(relation, expected, n)[tuple(edges)].any() else "warning",
        )


def has_cycle(holds: np.ndarray) -> bool:
    """Whether any of the graphs (R, N, N) bool has a cycle: nodes without a way in are taken away as long as any is."""
    ways_in, left = holds.sum(axis=1, dtype=np.int64), np.ones(holds.shape[:2], np.bool_)
    while (free := left & (ways_in == 0)).any():
        left &= ~free
        graphs, nodes = np.nonzero(free)
        np.subtract.at(ways_in, graphs, holds[graphs, nodes])
    return bool(left.any())


def shortest_cycle(holds: np.ndarray) -> np.ndarray:
    """Indices of a shortest cycle of a strongly connected graph ((N, N) bool), from its lowest number on."""
    from scipy.sparse import csr_matrix
    from scipy.sparse.csgraph import shortest_path

    steps, before = shortest_path(csr_matrix(holds), unweighted=True, return_predecessors=True)
    closing = np.where(holds.T, steps, np.inf)
    np.fill_diagonal(closing, np.inf)
    start, end = np.unravel_index(int(closing.argmin()), closing.shape)
    path = [int(end)]
    while path[-1] != start:
        path.append(int(before[start, path[-1]]))
    path.reverse()
    return np.roll(path, -int(np.argmin(path)))


SURFACE_SLACK = 0.10
MANY_POINTS = 100
"""With fewer points the percentiles of an object say little of where its points are."""
MARGIN_TOLERANCE, MARGIN_TOLERANCE_RELATIVE = 1e-4, 1e-4
"""Metres; margins are stored with 24 bits."""


@dataclass(frozen=True)
class Expected:
    """What geometry allows of every ordered pair."""

    # low, high dict of str to (N, N) int8: by relation: the stored state must lie between
    low: dict[str, np.ndarray]
    high: dict[str, np.ndarray]
    margins: dict[str, np.ndarray]  # dict of str to (N, N) float64: metres; NaN where only its sign is known
    distance: np.ndarray  # (N, N) float64: metres between the extents, NaN where unknown


def expected_viewer_cone(view: FrameView) -> Expected:
    """`viewer-cone-v1` from the stored extents."""
    known, pairs, contact = _measured(view)
    both = known[:, None] & known[None, :]
    exact = [relation for relation in PAIRWISE if not PREDICATES[relation].reads_points]
    measured = AllMeasures(pairs, Profile())
    states = pair_states(measured, known, exact)
    slack = np.where(both[..., None], pair_margins(measured, states, exact), 0.0)
    for k, relation in enumerate(exact):
        contact.low[relation] = contact.high[relation] = states[..., k]
        contact.margins[relation] = slack[..., k]
    return contact


def _measured(view: FrameView) -> tuple[np.ndarray, PairMeasures, Expected]:
    """Objects with known extents ((N,) bool), measures of all pairs, allowed states of on, in and distances."""
    lo, hi = view.extents
    known = known_extents(lo, hi)
    pairs = measure_pairs(np.where(known[:, None], lo, 0.0), np.where(known[:, None], hi, 0.0), Profile())
    both = known[:, None] & known[None, :]
    return (
        known,
        pairs,
        Expected(*_contact(view, pairs, Profile(), both), np.where(both, np.linalg.norm(pairs.gap, axis=2), np.nan)),
    )


def expected_semantic_abstraction(view: FrameView) -> Expected:
    """`semantic-abstraction-published` from extents, mean points and the stored on and in."""
    _, _, expected = _measured(view)
    (lo, hi), centroid = view.extents, view.objects["centroid"]
    centroid = np.where(np.isfinite(centroid), centroid, (lo + hi) / 2)
    shape = (len(lo), len(lo), len(PAIRWISE))
    contact = JudgedPairs(np.full(shape, F, np.int8), np.full(shape, -np.inf), expected.distance)
    stored = {"on", "in"} <= set(view.states)
    if stored:
        for relation in ("on", "in"):
            k = PAIRWISE.index(relation)
            contact.states[..., k] = np.where(view.present, view.states[relation], F)
            contact.margins[..., k] = np.nan_to_num(view.margins[relation], nan=-np.inf)
    judged = semantic_abstraction_directions(lo, hi, centroid, contact)
    low, high = expected.low, expected.high
    touching = np.maximum(high["on"], high["in"]) == T
    touching |= touching.T
    for relation in HORIZONTAL:
        k = PAIRWISE.index(relation)
        high[relation] = judged.states[..., k]
        low[relation] = high[relation] if stored else np.where(touching, F, high[relation]).astype(np.int8)
        expected.margins[relation] = judged.margins[..., k] if stored else np.full(shape[:2], np.nan)
    return expected


def _contact(
    view: FrameView, pairs: PairMeasures, profile: Profile, both: np.ndarray
) -> tuple[dict[str, np.ndarray], dict[str, np.ndarray], dict[str, np.ndarray]]:
    """Lowest and highest states of on and in, and their margins as far as they are known."""
    n = len(both)
    if not n:
        empty = np.zeros((0, 0), np.int8)
        return ({"on": empty, "in": empty}, {"on": empty, "in": empty}, {"on": empty * 1.0, "in": empty * 1.0})
    extent = pairs.extent
    area = extent[:, 0] * extent[:, 2]
    covered = pairs.overlap[..., 0] * pairs.overlap[..., 2] / area[:, None]
    supported = (covered >= profile.on_overlap) & (area[:, None] / area[None, :] < profile.on_area_ratio)
    bottom = pairs.lo[:, None, 1]
    surface = np.clip(bottom, pairs.lo[None, :, 1] - SURFACE_SLACK, pairs.hi[None, :, 1] + SURFACE_SLACK)
    gap = np.abs(bottom - surface)
    touching = np.maximum(profile.on_gap, profile.on_gap_relative * extent[:, 1])[:, None]
    on = np.where(gap <= touching, T, np.where(gap <= profile.on_gap_doubtful, U, F))
    on = np.where(supported, on, F)

    sunk = (pairs.hi[None, :, 1] - bottom) / extent[:, None, 1] >= profile.in_below_rim
    low, high = pairs.lo - profile.in_inflation, pairs.hi + profile.in_inflation
    apart = ((pairs.lo[:, None] > high[None]) | (pairs.hi[:, None] < low[None])).any(axis=2)
    within = ((pairs.lo[:, None] >= low[None]) & (pairs.hi[:, None] <= high[None])).all(axis=2)
    many = (view.objects["points"] >= MANY_POINTS)[:, None]
    inside_high = np.where(sunk & ~(apart & many), T, F)
    inside_low = np.where(sunk & within & many, T, F)

    def settled(states: np.ndarray) -> np.ndarray:
        return np.where(np.eye(n, dtype=np.bool_), F, np.where(both, states, U)).astype(np.int8)

    unknown = np.where(both, np.nan, 0.0)
    return (
        {"on": settled(np.full((n, n), F)), "in": settled(inside_low)},
        {"on": settled(on), "in": settled(inside_high)},
        {"on": unknown, "in": unknown.copy()},
    )


def expected_given(view: FrameView) -> Expected:
    """`given`: the dataset itself says the states, with no margin; only distances follow from the extents."""
    shape = (len(view.ids), len(view.ids))
    low, high, margins = (
        {relation: np.full(shape, value) for relation in view.states} for value in (np.int8(F), np.int8(T), 0.0)
    )
    return Expected(low, high, margins, expected_viewer_cone(view).distance)


EXPECTED: dict[str, Callable[[FrameView], Expected]] = {
    "viewer-cone-v1": expected_viewer_cone,
    "semantic-abstraction-published": expected_semantic_abstraction,
    GIVEN: expected_given,
}
"""What geometry says under each profile."""


def check_geometry(view: FrameView, expected: Expected) -> Iterator[Finding]:
    """Compare states, margins and distances with the extents."""
    for relation in view.states:
        if relation in expected.high:
            yield from _against_extents(view, expected, relation)
    with np.errstate(invalid="ignore"):
        far = np.abs(view.distance - expected.distance) > MARGIN_TOLERANCE * (1 + np.abs(expected.distance))
    far |= np.isfinite(view.distance) != np.isfinite(expected.distance)
    yield from view.where(
        "relation/geometry",
        view.present & far,
        lambda a, b: (
            f"{view.named(a)} to {view.named(b)}: distance {view.distance[a, b]:.4f} m, "
            f"the extents say {expected.distance[a, b]:.4f} m"
        ),
        lambda a, b: {"stored": view.distance[a, b], "geometry": expected.distance[a, b]},
        np.zeros_like(far),
    )


def _against_extents(view: FrameView, expected: Expected, relation: str) -> Iterator[Finding]:
    states, doubted, margins = view.states[relation], view.doubted(relation), view.margins[relation]
    low, high = (np.where(doubted, U, bound[relation]) for bound in (expected.low, expected.high))
    wanted = np.where(doubted, 0.0, expected.margins[relation])
    judged, nearest = view.present & (states != NOT_JUDGED), np.clip(states, low, high)
    off = judged & (states != nearest)
    told = partial(view.relation_text, relation=relation)
    yield from view.where(
        "relation/geometry",
        off,
        lambda a, b: (
            f"{told(a=a, b=b)}: stored {state_letter(states[a, b])}, the extents say {letter(int(nearest[a, b]))}"
        ),
        lambda a, b: {
            "relation": relation,
            "stored": states[a, b],
            "geometry": nearest[a, b],
            "margin": wanted[a, b],
        },
        np.abs(states.astype(np.int64) - nearest) > 1,
    )
    signed = np.where(states == T, margins >= 0, np.where(states == F, margins <= 0, margins == 0))
    with np.errstate(invalid="ignore"):
        differs = np.abs(margins - wanted) > MARGIN_TOLERANCE + MARGIN_TOLERANCE_RELATIVE * np.abs(wanted)
    yield from view.where(
        "relation/geometry",
        judged & ~off & (~signed | differs),
        lambda a, b: (
            f"{told(a=a, b=b)}: margin {margins[a, b]:.4f} m, "
            + (
                f"the extents say {wanted[a, b]:.4f} m"
                if np.isfinite(wanted[a, b])
                else "its sign is that of another state"
            )
        ),
        lambda a, b: {"relation": relation, "stored_margin": margins[a, b], "margin": wanted[a, b]},
        np.zeros_like(off),
    )
