"""Predicates of declared relations, found by the relation's name.

A relation is declared in `pipeline.language.relation`; `@predicate` over a function of the measures, as in
`pipeline.relations.relations`, says when it holds. States, margins, regions and checks follow.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from pipeline.relations.pair_measures import AllMeasures, F, PairMeasures, Profile, T, U
from pipeline.system.errors import InputError

Judge = Callable[[AllMeasures], Sequence[np.ndarray]]
Slacks = Callable[[PairMeasures, Profile], tuple[np.ndarray, np.ndarray]]


@dataclass(frozen=True)
class Predicate:
    """Rule of one relation, or of several judged together."""

    relations: tuple[str, ...]
    states: Judge  # (..., N, N) states, one array for each of the relations: T, U or F at [a, b] for "a RELATION b"
    margins: Judge  # (N, N) float64 metres to the nearest threshold for each: positive for T, negative for F, 0 for U
    reads_points: bool = False  # It looks at more than extents


PREDICATES: dict[str, Predicate] = {}
"""By the name of a relation."""


def register(predicate: Predicate) -> None:
    """Register a predicate for its relations."""
    PREDICATES.update(dict.fromkeys(predicate.relations, predicate))


def predicate(relation: str) -> Callable[[Slacks], Slacks]:
    """Register a function of the measures of all ordered pairs as the rule of a relation.

    The function returns two (..., N, N) arrays: how many metres the measures could change before "a RELATION b" were
    no longer sure, and before it were surely false. Where the first is at least 0 the state is T, where only the
    second is, U, elsewhere F; the margins follow from both.
    """

    def registered(slacks: Slacks) -> Slacks:
        def states(measured: AllMeasures) -> tuple[np.ndarray]:
            holds, allows = slacks(measured.pairs, measured.profile)
            return (np.where(holds >= 0, T, np.where(allows >= 0, U, F)),)

        def margins(measured: AllMeasures) -> tuple[np.ndarray]:
            return (margin_of(*slacks(measured.pairs, measured.profile)),)

        register(Predicate((relation,), states, margins))
        return slacks

    return registered


def predicates_of(relations: Iterable[str]) -> list[Predicate]:
    """Predicates judging these relations, each once.

    Raises
    ------
    InputError
        A relation has none.
    """
    relations = tuple(relations)
    missing = [name for name in relations if name not in PREDICATES]
    if missing:
        raise InputError(
            f"the relation {missing[0]!r} has no predicate",
            expected=f"a function under @predicate({missing[0]!r}), as in pipeline/relations/relations.py",
            cause="it is declared in pipeline/language/relation.py alone",
        )
    return list({id(found): found for found in (PREDICATES[name] for name in relations)}.values())


def _stacked(relations: Sequence[str], of: Callable[[Predicate], Sequence[np.ndarray]]) -> np.ndarray:
    found: dict[str, np.ndarray] = {}
    for one in predicates_of(relations):
        found.update(zip(one.relations, of(one), strict=True))
    return np.stack([found[name] for name in relations], axis=-1)


def pair_states(measured: AllMeasures, known: np.ndarray, relations: Sequence[str]) -> np.ndarray:
    """(..., N, N, R) int8 states of the relations in order.

    U where the extents of either are not known (`known` is (..., N) bool), F of an object to itself.
    """
    result = _stacked(relations, lambda p: p.states(measured)).astype(np.int8)
    result[~(known[..., :, None] & known[..., None, :])] = U
    result[..., np.eye(known.shape[-1], dtype=bool), :] = F
    return result


def pair_margins(measured: AllMeasures, states: np.ndarray, relations: Sequence[str]) -> np.ndarray:
    """(N, N, R) float64 margins of the relations, metres, given their states; never beyond the state.

    Rounding at a threshold may part the two by a hair.
    """
    margins = _stacked(relations, lambda p: p.margins(measured))
    return np.where(states == T, np.maximum(margins, 0), np.where(states == F, np.minimum(margins, 0), 0.0))


def margin_of(holds: np.ndarray, allows: np.ndarray) -> np.ndarray:
    """Margin, given the slack of T and the slack of "T or U"."""
    return np.where(holds >= 0, holds, np.where(allows >= 0, 0.0, allows))
