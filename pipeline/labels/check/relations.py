"""Rules on relations among themselves: what cannot hold together, and what is missing.

In every profile here a directional relation asks that centres (or mean points)
be ordered along one axis, strictly. Such a relation has no cycle and never
holds both ways, though a cone is not transitive; a finding is then always an
error. "On" and "in" compare surfaces and points, not an order: two flat things
side by side at one height may each lie within 5 cm of "on" the other. Where the
extents allow that, the finding is a warning.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from pipeline.labels.check.findings import Finding, Severity
from pipeline.labels.check.geometry import Expected
from pipeline.labels.check.stream import UNKNOWN
from pipeline.labels.check.view import FrameView, pairs_where, state_letter
from pipeline.language.relation_names import INVERSE, MIRRORED, OPPOSITES, PAIRWISE, PHRASE
from pipeline.relations.relations import F, T

MIRRORED_PROFILES = ("viewer-cone-v1",)
"""Profiles in which "a left of b" and "b right of a" are one question."""

STRICT = tuple(name for name in PAIRWISE if MIRRORED.get(name) != name)
"""Relations that hold one way at most, and without cycles."""


def check_relations(view: FrameView, expected: Expected | None, profile: str) -> Iterator[Finding]:
    """All rules of the group but the comparison with geometry.

    Parameters
    ----------
    expected : Expected or None
        What geometry allows, where it can be recomputed.
    profile : str
        The name of the rule profile.
    """
    if not len(view.ids):
        return
    yield from _missing(view)
    yield from _unexpected(view)
    if profile in MIRRORED_PROFILES:
        yield from _inverse(view)
    yield from _exclusive(view)
    strict = [relation for relation in STRICT if relation in view.states]
    for relation in strict:
        yield from _both_ways(view, relation, expected)
    yield from _cycles(view, strict, expected)


def _missing(view: FrameView) -> Iterator[Finding]:
    wanted = view.related[:, None] & view.related[None, :] & ~np.eye(len(view.ids), dtype=np.bool_)
    for a, b in pairs_where(wanted & ~view.present):
        if view.present[b, a] or a < b:
            told = "has no row, the other way has one" if view.present[b, a] else "has no row, nor has the other way"
            message = f"{view.named(a)} to {view.named(b)} {told}"
            yield view.finding("relation/pair-missing", (view.ids[a], view.ids[b]), message)
    for relation, states in view.states.items():
        for a, b in pairs_where(view.present & (states == UNKNOWN)):
            yield view.finding(
                "relation/pair-missing",
                (view.ids[a], view.ids[b]),
                f"{view.relation_text(a, relation, b)} has no state",
                {"relation": relation},
            )


def _unexpected(view: FrameView) -> Iterator[Finding]:
    for a, b in pairs_where(view.present & ~(view.related[:, None] & view.related[None, :])):
        yield view.finding(
            "relation/unexpected",
            (view.ids[a], view.ids[b]),
            f"{view.named(a)} to {view.named(b)}: background takes part in no relation",
        )
    rows = view.relations
    if len(rows):
        for number in rows["a"][rows["a"] == rows["b"]]:
            yield view.finding("relation/unexpected", (number, number), "a relation of an object with itself")


def _inverse(view: FrameView) -> Iterator[Finding]:
    for one, other in OPPOSITES:
        if one not in view.states or other not in view.states:
            continue
        state, mirrored = view.states[one], view.states[other].T
        differs = (state != mirrored) & (state != UNKNOWN) & (mirrored != UNKNOWN)
        for a, b in pairs_where(differs):
            yield view.finding(
                "relation/inverse",
                (view.ids[a], view.ids[b]),
                f"{view.relation_text(a, one, b)} is {state_letter(state[a, b])}, "
                f"{view.relation_text(b, other, a)} is {state_letter(mirrored[a, b])}",
                {"relation": one, one: int(state[a, b]), other: int(mirrored[a, b])},
            )


def _exclusive(view: FrameView) -> Iterator[Finding]:
    for one, other in OPPOSITES:
        if one not in view.states or other not in view.states:
            continue
        for a, b in pairs_where((view.states[one] == T) & (view.states[other] == T)):
            yield view.finding(
                "relation/exclusive",
                (view.ids[a], view.ids[b]),
                f"{view.relation_text(a, one, b)} and {PHRASE[other]} it",
                {"relation": one},
            )


def _both_ways(view: FrameView, relation: str, expected: Expected | None) -> Iterator[Finding]:
    holds = view.states[relation] == T
    for a, b in pairs_where(np.triu(holds & holds.T)):
        yield view.finding(
            "relation/antisymmetry",
            (view.ids[a], view.ids[b]),
            f"{view.relation_text(a, relation, b)}, and the other way too",
            {"relation": relation},
            _severity(relation, np.array([[a, b], [b, a]]), expected),
        )


def _cycles(view: FrameView, relations: Sequence[str], expected: Expected | None) -> Iterator[Finding]:
    """One finding for each knot of objects: a shortest cycle in it; cycles of two are `relation/antisymmetry`."""
    n = len(view.ids)
    holds = np.array([view.states[relation] == T for relation in relations]).reshape(-1, n, n)
    # Two ways at once is a finding of its own; without those edges the longer cycles remain.
    holds &= ~np.swapaxes(holds, 1, 2)
    which, a, b = np.nonzero(holds)
    if not len(which):
        return
    from scipy.sparse import csr_matrix
    from scipy.sparse.csgraph import connected_components

    # All relations as one graph without edges between them.
    size = len(relations) * n
    graph = csr_matrix((np.ones(len(which), np.int8), (which * n + a, which * n + b)), (size, size))
    _, knot = connected_components(graph, directed=True, connection="strong")
    for number in np.flatnonzero(np.bincount(knot) > 1):
        nodes = np.flatnonzero(knot == number)
        k, members = int(nodes[0] // n), nodes % n
        cycle = members[shortest_cycle(holds[k][np.ix_(members, members)])]
        yield _cycle(view, relations[k], cycle, len(members), expected)


def _cycle(view: FrameView, relation: str, cycle: np.ndarray, knot: int, expected: Expected | None) -> Finding:
    edges = np.stack([cycle, np.roll(cycle, -1)], axis=1)
    margins = view.margins[relation][edges[:, 0], edges[:, 1]]
    chain = f" {PHRASE[relation]} ".join(view.named(k) for k in [*cycle, cycle[0]])
    return view.finding(
        "relation/cycle",
        tuple(view.ids[cycle]),
        f"{chain}; margins {', '.join(f'{m:.3f}' for m in margins)} m",
        {
            "relation": relation,
            "objects_in_knot": knot,
            **{f"margin_{a}_{b}": float(m) for (a, b), m in zip(view.ids[edges], margins, strict=True)},
        },
        _severity(relation, edges, expected),
    )


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


def _severity(relation: str, edges: np.ndarray, expected: Expected | None) -> Severity:
    """Warning for on and in, unless geometry rules out one of the edges."""
    if relation in INVERSE:
        return "error"
    if expected is not None and relation in expected.high:
        most = expected.high[relation][edges[:, 0], edges[:, 1]]
        if (most == F).any():
            return "error"
    return "warning"
