"""Edits of a view listed; and their effects: the winner, its factors, the order of the pairs."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from pipeline.answering.answer_words import stands, why_no_answer
from pipeline.answering.json_records import present
from pipeline.diagnosis.story import change_words
from pipeline.diagnosis.story_words import Story, words
from pipeline.diagnosis.whatif.edits import CHECKS, Edits
from pipeline.diagnosis.whatif.rerun import Outcome, PairKeys
from pipeline.language.relation_names import PHRASE
from pipeline.system.errors import require
from pipeline.system.frozen import dataclass

_WORDS = {
    "k": "proposals a name (K)",
    "min_score": "minimum score",
    "scorer": "relations by",
    "target_weight": "weight of the target α",
    "reference_weight": "weight of the reference β",
    "relation_weight": "weight of the relation γ",
    "cone": "cone, degrees",
    "doubtful_cone": "undecided cone, degrees",
    "dead_zone": "dead zone, m",
    "dead_zone_depth": "dead zone in depth, m",
}

Record = dict[str, Any]


def what_changed(
    before: Outcome,
    after: Outcome,
    *,
    verdicts: tuple[str | None, str | None] | None = None,
    most: int = 20,
) -> Record:
    """Compare two answers to a question.

    Parameters
    ----------
    verdicts : pair of str or None, optional
        Of both, where the caller knows them.
    most : int
        So many pairs that changed their rank are listed at most, from the top.

    Returns
    -------
    dict
        `changed` (the winning pair is another); `before` and `after`, each with `target`, `reference`,
        `second_reference` (objects as {key, label}), the factors `p_target`, `p_reference`, `p_relation`, `product`,
        whether the pair `holds` and by what `relation_probability`, `probability`, the `margin` and `log_margin` (null
        where there is one pair only), `entropy`, `reason` where there is no answer, `verdict`; `factors`: what became
        of the pair that won before and of the one that wins now, as logs {before, after}; `moved`: the pairs with
        another rank, best first after the edit; `candidates`: keys of objects that `came` and `went`.

    >>> from pipeline.answering import open_pipeline
    >>> from pipeline.diagnosis.whatif.edits import Edits
    >>> from pipeline.diagnosis.whatif.rerun import Baseline, rerun
    >>> pipeline = open_pipeline("demo")
    >>> baseline = Baseline(pipeline, pipeline.prepare(0), "mug left of the laptop")
    >>> after = rerun(baseline, Edits().with_hidden(baseline.outcome.keys[0]))
    >>> what_changed(baseline.outcome, after)["changed"]
    True
    """
    first, last = before.winner, after.winner
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


def became(before: Outcome, after: Outcome, was: Story, now: Story) -> str:
    """Whether the edits have changed the answer, and made it right, as a headline; `was`, `now`: stories of both."""
    if before.winner != after.winner:
        return words("changes", "nothing") if why_no_answer(after.trace) is not None else change_words(True, was, now)
    margins = [f"{r.margin:.2f}" for r in (before.trace.ranking, after.trace.ranking) if r is not None]
    if len(set(margins)) < 2:
        return change_words(False, was, now)
    return words("changes", "margin", before=margins[0], after=margins[1])


def _answer(outcome: Outcome, verdict: str | None) -> Record:
    ranking = outcome.trace.ranking
    record = {"verdict": verdict, **present(reason=why_no_answer(outcome.trace))}
    if ranking is None:
        return record
    pair = ranking.pairs[0]
    ends = present(target=pair.target, reference=pair.reference, second_reference=pair.second_reference)
    return record | {
        **{role: _object(outcome, index) for role, index in ends.items()},
        "p_target": pair.p_target,
        "p_reference": pair.p_reference,
        "p_relation": pair.p_relation,
        "holds": stands(outcome.trace, pair),
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


def _object(outcome: Outcome, index: int) -> Record:
    return {"key": outcome.keys[index], "label": outcome.trace.objects[index].label}


def _factors(before: Outcome, after: Outcome, names: PairKeys) -> Record:
    """Log factors of a pair in both answers; null for no candidate pair."""
    record: Record = {"target": names[0], "reference": names[1]}
    for when, outcome in (("before", before), ("after", after)):
        at, pair = outcome.ranked.get(names, (None, None))
        record[when] = None if pair is None else {"rank": at, "log_score": pair.log_score, **pair.log_factors}
    return record


def _moved(before: Outcome, after: Outcome, most: int) -> list[Record]:
    old, new = before.ranked, after.ranked
    gone = [names for names in old if names not in new]
    ranks = {names: [side[names][0] if names in side else None for side in (old, new)] for names in (*new, *gone)}
    found = [
        {"target": names[0], "reference": names[1], "rank_before": was, "rank_after": now}
        for names, (was, now) in ranks.items()
        if was != now
    ]
    return found[:most]


@dataclass(frozen=True)
class EditDescription:
    """Edit described in words."""

    id: str  # Names it among the edits of its view
    text: str  # What is changed, in words
    key: str | None = None  # Of the object; None for a setting, and for a relation that of its first end


def each_edit(edits: Edits, named: Callable[[str], str] = str) -> tuple[EditDescription, ...]:
    """Edits in a fixed order; `named` gives the word for an object's key."""
    found = [EditDescription(_id("boxes", k), f"{named(k)}: its box", k) for k in edits.boxes]
    found += [EditDescription(_id("masks", k), f"{named(k)}: its mask", k) for k in edits.masks]
    found += [EditDescription(_id("added", k), f"{a.name}: added", k) for k, a in edits.added.items()]
    found += [EditDescription(_id("hidden", k), f"{named(k)}: hidden", k) for k in sorted(edits.hidden)]
    found += [
        EditDescription(_id("confidences", name, k), f"P({named(k)} | {name}) = {p:.2f}", k)
        for (name, k), p in edits.confidences.items()
    ]
    found += [
        EditDescription(_id("relations", r, a, b), f"P({named(a)} {PHRASE.get(r, r)} {named(b)}) = {p:.2f}", a)
        for (r, a, b), p in edits.relations.items()
    ]
    found += [
        EditDescription(_id(name), f"{_WORDS[name]}: {value}")
        for name, value in present(k=edits.k, min_score=edits.min_score, scorer=edits.scorer).items()
    ]
    found += [
        EditDescription(_id(group, name), f"{_WORDS.get(name, name)}: {value}")
        for group in CHECKS
        for name, value in getattr(edits, group).items()
    ]
    return tuple(found)


def without_edit(edits: Edits, id: str) -> Edits:
    """Edits without the one of this id; InputError for an unknown id, or one needed by other settings."""
    require(id in {edit.id for edit in each_edit(edits)}, "there is no such edit", got=id)
    group, *rest = json.loads(id)
    if group in ("k", "min_score", "scorer"):
        return replace(edits, **{group: None})
    held = getattr(edits, group)
    at = rest[0] if len(rest) == 1 else tuple(rest)
    if group == "hidden":
        return replace(edits, hidden=held - {at})
    left = {key: value for key, value in held.items() if key != at}
    return replace(edits, **{group: CHECKS[group](left) if group in CHECKS else left})


def _id(*parts: str) -> str:
    return json.dumps(parts, separators=(",", ":"))
