"""What an edit changed: the winner, its factors, the order of the pairs."""

from __future__ import annotations

from typing import Any

import numpy as np

from pipeline.answering.json_records import why_no_answer
from pipeline.answering.pair_table import ScoredPair
from pipeline.diagnosis.whatif.rerun import Outcome

Record = dict[str, Any]
_Names = tuple[str, str | None, str | None]


def what_changed(
    before: Outcome,
    after: Outcome,
    *,
    verdicts: tuple[str | None, str | None] | None = None,
    most: int = 20,
) -> Record:
    """Two answers to one question side by side.

    Parameters
    ----------
    before, after : Outcome
    verdicts : pair of str or None, optional
        Of both, where the caller knows them.
    most : int
        So many pairs that changed their rank are listed at most, from the top.

    Returns
    -------
    dict
        `changed` (the winning pair is another); `before` and `after`, each with
        `target`, `reference`, `second_reference` (objects as {key, label}),
        the factors `p_target`, `p_reference`, `p_relation`, `product`, whether
        the pair `holds` and by what `relation_probability`, `probability`, the
        `margin` and `log_margin` (null where there is one pair only),
        `entropy`, `reason` where there is no answer, `verdict`;
        `factors`: what became of the pair that won before and of the one that
        wins now, as logs {before, after}; `moved`: the pairs with another
        rank, best first after the edit; `candidates`: keys of objects that
        `came` and `went`.
    """
    first, last = _winner(before), _winner(after)
    told = verdicts or (None, None)
    return {
        "changed": first != last,
        "before": _answer(before, told[0]),
        "after": _answer(after, told[1]),
        "factors": {
            "winner_before": None if first is None else _factors(before, after, first),
            "winner_after": None if last is None else _factors(before, after, last),
        },
        "moved": _moved(before, after, most),
        "candidates": {
            "came": sorted(set(after.keys) - set(before.keys)),
            "went": sorted(set(before.keys) - set(after.keys)),
        },
    }


def _names(outcome: Outcome, pair: ScoredPair) -> _Names:
    keys = outcome.keys
    return (
        keys[pair.target],
        None if pair.reference is None else keys[pair.reference],
        None if pair.second_reference is None else keys[pair.second_reference],
    )


def _winner(outcome: Outcome) -> _Names | None:
    ranking = outcome.trace.ranking
    return None if ranking is None else _names(outcome, ranking.pairs[0])


def _answer(outcome: Outcome, verdict: str | None) -> Record:
    ranking, reason = outcome.trace.ranking, why_no_answer(outcome.trace)
    record: Record = {"verdict": verdict}
    if reason is not None:
        record["reason"] = reason
    if ranking is None:
        return record
    pair = ranking.pairs[0]
    record |= {
        role: _object(outcome, place)
        for role, place in (
            ("target", pair.target),
            ("reference", pair.reference),
            ("second_reference", pair.second_reference),
        )
        if place is not None
    }
    return record | {
        "p_target": pair.p_target,
        "p_reference": pair.p_reference,
        "p_relation": pair.p_relation,
        "holds": pair.holds,
        "relation_probability": pair.relation_probability,
        "product": pair.product,
        "probability": pair.probability,
        "log_score": pair.log_score,
        "margin": ranking.margin,
        "log_margin": ranking.log_margin if np.isfinite(ranking.log_margin) else None,
        "entropy": ranking.entropy,
        "degenerate": ranking.degenerate,
        "reading": ranking.reading.description,
        "pairs": len(ranking.pairs),
    }


def _object(outcome: Outcome, place: int) -> Record:
    return {"key": outcome.keys[place], "label": outcome.trace.objects[place].label}


def _pairs(outcome: Outcome) -> dict[_Names, tuple[int, ScoredPair]]:
    pairs = () if outcome.trace.ranking is None else outcome.trace.ranking.pairs
    return {_names(outcome, pair): (at, pair) for at, pair in enumerate(pairs, start=1)}


def _factors(before: Outcome, after: Outcome, names: _Names) -> Record:
    """The log factors of one pair in both answers; null where it is no candidate pair."""
    record: Record = {"target": names[0], "reference": names[1]}
    for when, outcome in (("before", before), ("after", after)):
        at, pair = _pairs(outcome).get(names, (None, None))
        record[when] = None if pair is None else {"rank": at, "log_score": pair.log_score, **pair.log_factors}
    return record


def _moved(before: Outcome, after: Outcome, most: int) -> list[Record]:
    old, new = _pairs(before), _pairs(after)
    gone = [names for names in old if names not in new]
    found = []
    for names in (*new, *gone):
        was, now = (ranks[names][0] if names in ranks else None for ranks in (old, new))
        if was != now:
            found.append({"target": names[0], "reference": names[1], "rank_before": was, "rank_after": now})
    return found[:most]
