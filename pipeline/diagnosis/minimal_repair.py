"""Minimal repair: value of a single factor at which the right pair wins, exact on the table of all pairs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import exp, inf, log, prod

import numpy as np

from pipeline.answering.pair_table import MIN_RELATION, MIN_SCORE, PairTable

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
        up, down = _least_rise(table, factor, right, ahead), _least_fall(table, factor, winner, right, ahead)
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


def _least_rise(table: PairTable, factor: str, right: int, ahead: np.ndarray) -> float:
    """Least rise of the right pair's weighted log factor; inf where no rise puts the pair first."""
    low, _ = _bounds(table, _touched(table, factor, right), right, ahead)
    return log(low) if low < inf else inf


def _least_fall(table: PairTable, factor: str, winner: int, right: int, ahead: np.ndarray) -> float:
    """Least fall of the answer's weighted log factor; inf where no fall puts the right pair first."""
    touched = _touched(table, factor, winner)
    if touched[right]:
        return inf
    _, high = _bounds(table, touched, right, ahead, rising=False)
    return -log(high) if high > 0 else inf


def _bounds(
    table: PairTable, touched: np.ndarray, right: int, ahead: np.ndarray, rising: bool = True
) -> tuple[float, float]:
    """Bounds of a factor on the touched pairs' weights (e to the S) with the right pair first.

    `ahead`, (P,) bool: pairs now before the right one. First the least rising factor from 1, inf for none; second the
    greatest falling factor from 1, 0 for none.
    """
    scores = table.flat[0]
    weight = np.exp(np.minimum(scores - scores[right], 700.0))
    moving, fixed = np.where(touched, weight, 0.0), np.where(touched, 0.0, weight)
    others = np.isfinite(scores) & (np.arange(len(scores)) != right)
    rows = np.arange(len(scores)) // prod(table.shape[1:])
    if table.config.aggregate == "marginal":
        # Of the pairs only those of its own target are compared with it; targets by the sums of their pairs.
        others &= rows == rows[right]
    sides = [(moving[others], fixed[others], moving[right], fixed[right], ahead[others])]
    if table.config.aggregate == "marginal":
        a, b = (np.bincount(rows, weights=w, minlength=table.shape[0]) for w in (moving, fixed))
        away = np.arange(len(a)) != rows[right]
        before = np.bincount(rows, weights=ahead, minlength=table.shape[0]) > 0
        sides.append((a[away], b[away], a[rows[right]], b[rows[right]], before[away]))
    low, high = (1.0, inf) if rising else (0.0, 1.0)
    for theirs, rest, ours, base, before in sides:
        # ours * y + base > theirs * y + rest
        slope, gap = ours - theirs, rest - base
        bound = gap / np.where(slope == 0, 1.0, slope)
        low = max(low, float(bound[slope > 0].max(initial=0.0)))
        high = min(high, float(bound[slope < 0].min(initial=inf)))
        if ((slope == 0) & ((gap > 0) | ((gap == 0) & before))).any():
            low = inf
    # Bounds that meet leave a point, where two pairs tie, and no room in which the right pair comes first.
    return (low, high) if low < high * (1 - 1e-9) else (inf, 0.0)


def smallest_change(changes: Sequence[FactorRepair]) -> str:
    """Smallest change of a single factor putting the right pair first, in words, or that none exists."""
    names = {
        "relation": "relation",
        "target": "target score",
        "reference": "reference score",
        "attributes": "attributes",
    }
    for change in changes:
        if change.right_above is None:
            continue
        above, now = threshold(change.right_above, change.right)
        if change.right_above < 0.01 and change.right < 0.005 and change.factor != "reference":
            # Two pairs that are both next to 0: what is enough says more than what is just enough.
            return f"A {names[change.factor]} of 0.01 instead of {change.right:.2f} would put the right pair first."
        return f"Smallest change: its {names[change.factor]} above " + (
            f"{above}, which is a tie." if above == now else f"{above} instead of {now}."
        )
    if not changes:
        return ""
    falls = [n for n in changes if n.winner_below is not None]
    if not falls:
        return "No change of one factor alone would put the right pair first."
    least = min(falls, key=lambda n: n.winner - (n.winner_below or 0.0))
    below, now = threshold(least.winner_below or 0.0, least.winner)
    what = f"Smallest change: the answer's {names[least.factor]} below {below}"
    return f"{what}, which is a tie." if below == now else f"{what} instead of {now}."


def threshold(value: float, now: float) -> tuple[str, str]:
    """Threshold of a factor, with enough digits to differ from its present value, and from 0 and 1."""
    shown = is_now = ""
    for digits in range(2, 10):
        shown, is_now = f"{value:.{digits}f}", f"{now:.{digits}f}"
        if shown != is_now and 0 < float(shown) < 1:
            break
    return shown, f"{now:.2f}" if abs(now - value) >= 0.01 else is_now
