"""Numbers of an imported answer missing in its file, and computed here."""

from __future__ import annotations

from pipeline.answering.ask import Trace
from pipeline.answering.pair_table import Link, ScoredPair

ALWAYS = ("product", "probability", "log_factors")
"""Numbers of a pair that no file gives."""


def worked_out(trace: Trace, pair: ScoredPair) -> tuple[str, ...] | None:
    """Names of a pair's computed numbers in `ask --json`; None without imported predictions."""
    if trace.scores.given is None:
        return None
    weakest, first = pair.weakest, relation_given(trace, pair)
    whole = first if weakest is None else _link_given(trace, weakest)
    return (*("p_relation",) * (not first), *("relation_probability",) * (not whole), *ALWAYS)


def relation_given(trace: Trace, pair: ScoredPair) -> bool:
    """True for a relation given by the file, and for nothing imported or no relation."""
    if pair.reference is None or not trace.relation:
        return True
    return _link_given(
        trace, Link(trace.relation, pair.target, pair.reference, 1.0, pair.second_reference, trace.inverse)
    )


def _link_given(trace: Trace, link: Link) -> bool:
    scores = trace.scores
    ends = (link.b, link.a) if link.inverse else (link.a, link.b)
    if link.relation in scores.relations or scores.given is None:
        return link.relation not in scores.worked_out(*ends)
    third = () if link.c is None else (link.c,)
    return tuple(trace.objects[k].id for k in (*ends, *third)) in scores.beyond.get(link.relation, {})
