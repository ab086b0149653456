"""By how much one factor would have to change for the right pair to win."""

from __future__ import annotations

from dataclasses import dataclass
from math import exp, inf

from pipeline.diagnosis.verdict import Diagnosis
from pipeline.pair_table import MIN_RELATION, MIN_SCORE, RankConfig

FACTORS = ("target", "reference", "relation")


@dataclass(frozen=True)
class Needed:
    """What one factor would have to be, all else as it is.

    Attributes
    ----------
    factor : str
        target, reference or relation.
    right, winner : float
        The factor of the best acceptable pair and of the answer now.
    right_above : float or None
        The right pair wins as soon as its factor is above this; None where no probability is enough.
    winner_below : float or None
        The right pair wins as soon as the answer's factor is below this; None where it is shared by both pairs,
        so that it cannot be lowered for one alone.
    """

    factor: str
    right: float
    winner: float
    right_above: float | None
    winner_below: float | None


def needed_changes(diagnosis: Diagnosis, config: RankConfig) -> tuple[Needed, ...]:
    """For each factor of weight above 0 the change that alone would mend the answer, the smallest change first.

    Empty where no acceptable pair stands among the candidates, or the answer is one.
    """
    winner, right = diagnosis.winner, diagnosis.right
    if winner is None or right is None or winner == right or right.log_score > winner.log_score:
        return ()
    gap = winner.log_score - right.log_score
    found = []
    for factor, weight in zip(
        FACTORS, (config.target_weight, config.reference_weight, config.relation_weight), strict=True
    ):
        if weight <= 0:
            continue
        low = MIN_RELATION if factor == "relation" else MIN_SCORE
        ours, theirs = (max(getattr(s, f"p_{factor}"), low) for s in (right, winner))
        shared = factor != "relation" and getattr(winner, factor) == getattr(right, factor)
        step = exp(min(gap / weight, 700.0))
        above, below = ours * step, theirs / step
        found.append(
            Needed(
                factor,
                ours,
                theirs,
                None if shared or above >= 1 else above,
                None if shared or below < low else below,
            )
        )
    return tuple(sorted(found, key=lambda n: inf if n.right_above is None else n.right_above - n.right))
