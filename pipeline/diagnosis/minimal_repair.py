"""Minimal repair: value of a single factor at which the right pair wins, exact on the table of all pairs."""

from __future__ import annotations

from math import exp, inf, prod

import numpy as np

from pipeline.answering.pair_table import MIN_RELATION, MIN_SCORE, PairTable
from pipeline.system.frozen import dataclass

FACTORS = ("target", "reference", "relation", "attributes")


@dataclass(frozen=True)
class FactorRepair:
    """Needed value of a factor, all else unchanged."""

    factor: str  # target, reference or relation; attributes, what is said of the target alone
    # right, winner: The factor of the best acceptable pair and of the answer now
    right: float
    winner: float
    # The right pair wins as soon as its factor is above this; None where no probability is enough
    right_above: float | None
    # The right pair wins as soon as the answer's factor is below this; None where none is low enough, or it is shared
    # by both pairs, so that it cannot be lowered for one alone
    winner_below: float | None


def factor_repairs(
    table: PairTable, winner: int, right: int, looks: tuple[float, float] | None = None
) -> tuple[FactorRepair, ...]:
    """Changes of single factors putting the right pair first, smallest first, for factors of weight above 0.

    `table`: of one scene, with one reference or none; `winner`, `right`: the pair that comes first, and the one that
    should; `looks`: P(attributes | x) of the right pair's target and of the answer's, where the expression has any.
    """
    config, ours, theirs = table.config, table.pair(right), table.pair(winner)
    of_pairs = len(table.ends) > 0
    weights = [config.target_weight, config.reference_weight * of_pairs, config.relation_weight * of_pairs]
    weights.append(0.0 if looks is None else 1.0)
    order = table.order()
    ahead = np.zeros(table.flat.shape[1], np.bool_)
    ahead[order[: int(np.flatnonzero(order == right)[0])]] = True
    found = []
    for factor, weight in zip(FACTORS, weights, strict=True):
        if weight <= 0:
            continue
        low, high = (MIN_RELATION, 1.0) if factor == "relation" else (MIN_SCORE, 1 - MIN_SCORE)
        if factor == "attributes" and looks is not None:
            now = looks
        else:
            now = tuple(getattr(pair, f"p_{factor}") for pair in (ours, theirs))
        mine, other = (max(p, low) for p in now)
        up, down = (_least_change(table, factor, pair, right, ahead) for pair in (right, winner))
        above, below = mine * exp(min(up / weight, 700.0)), other * exp(-min(down / weight, 700.0))
        found.append(
            FactorRepair(factor, mine, other, above if above < high else None, below if below >= low else None)
        )
    return tuple(sorted(found, key=lambda n: inf if n.right_above is None else n.right_above - n.right))


def _touched(table: PairTable, factor: str, pair: int) -> np.ndarray:
    """(P,) bool: pairs sharing a pair's factor."""
    columns = prod(table.shape[1:])
    at = np.arange(table.flat.shape[1])
    if factor == "relation":
        return at == pair
    return at // columns == pair // columns if factor in ("target", "attributes") else at % columns == pair % columns


def _least_change(table: PairTable, factor: str, pair: int, right: int, ahead: np.ndarray) -> float:
    """Least rise of the right pair's weighted log factor, or fall of another's, that puts the right pair first.

    `ahead`, (P,) bool: pairs now before the right one. Inf where one of them keeps its distance.
    """
    touched = _touched(table, factor, pair)
    # Pairs that share the risen factor rise with it; only those that share the fallen one fall.
    gained = touched if pair != right else ~touched
    if gained[right] or (ahead & ~gained).any():
        return inf
    scores = table.flat[0]
    return float((scores[gained] - scores[right]).max(initial=0.0))


def threshold(value: float, now: float) -> tuple[str, str]:
    """Threshold of a factor, with enough digits to differ from its present value, and from 0 and 1."""
    shown = is_now = ""
    for digits in range(2, 10):
        shown, is_now = f"{value:.{digits}f}", f"{now:.{digits}f}"
        if shown != is_now and 0 < float(shown) < 1:
            break
    return shown, f"{now:.2f}" if abs(now - value) >= 0.01 else is_now
