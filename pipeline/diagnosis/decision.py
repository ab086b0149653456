"""Verdict on an expression: exclusive, exhaustive, decided in a fixed order.

CORRECT      the answer's target overlaps the labelled one by half (LUCKY where the pair is not an acceptable one)
PARSE        the parsed triple is not the gold triple: WORDS, a name is not known or was read as another; GRAMMAR, it
             cannot be read or was read as something else; UNSUPPORTED, it holds what is not judged (`facing`, actions)
LABEL        AMBIGUOUS: the answer is another acceptable target; BAD_LABEL, BAD_BOX: a person marked the label;
             SUSPECT: the labels' own relations say of the answer that it is, or may be, right, and the expression does
             not list it
OPM-TARGET   no candidate overlaps an acceptable target: RANK, THRESHOLD, LOCALISATION or ABSENT (`why_missed`)
OPM-REF      no candidate pair is an acceptable one
LIFT, ATTRIBUTE, SRM, OPM-CONF, PRM, COMPOUND
             an acceptable pair stood among the candidates and lost. Each oracle is applied alone and the pairs are
             ranked again. Exactly one makes an acceptable pair win: it names the verdict; CONF is OPM-CONF where a
             false positive won, and PRM where two real objects did, whose confidences overruled the relation. Several
             do: the one with the largest margin of the best acceptable over the best other pair; within 1e-6 the
             earlier stage. None does: COMPOUND, with the smallest subset of them that does. Not even all of them:
             PRM, DEGENERATE: the right pair is excluded as one thing, or lost by a rule for ties. ATTRIBUTE is there
             only for expressions with attributes.

A choice among things ("leftmost", "second from the left"), a negation, and what is said of the viewer are relations of
a thing to its like, and worked out from boxes, attributes and confidences. A wrong one is the fault of whichever of
these mends it; of RECALL (COMPOUND), where only the things that were not found do; where nothing does, SRM's: CHOICE.

When several oracles are compared, relations count by what the network decides: above .5 as .99, below as .01, as the
truth has it; attributes likewise, from where they hold on. Else the truth, which is never less sure than a network,
would go farther than any true geometry and any true confidence, and a relation that the network had right, only not to
.99, would be blamed for a broken box or for confidences that overruled it. Where the network decides wrongly, the truth
still goes farther, and SRM is named.
(With planted faults: see `tests/benchmarks/planted.py`.)
"""

from __future__ import annotations

from dataclasses import replace
from math import prod

import numpy as np

from pipeline.diagnosis.frame_evidence import FrameEvidence
from pipeline.diagnosis.imported_answers import (
    blamed_alone,
    blamed_together,
    decided_by_label,
    judge_foreign_ranking,
    judge_without_ranking,
    unavailable_oracles,
)
from pipeline.diagnosis.minimal_repair import FactorRepair, factor_repairs
from pipeline.diagnosis.missed import not_proposed
from pipeline.diagnosis.needed_score import needed_box, needed_score
from pipeline.diagnosis.oracles import (
    ATTRIBUTE,
    CONF,
    LIFT,
    ORACLES,
    RECALL,
    SRM,
    OracleScores,
    names_of,
)
from pipeline.diagnosis.story import judged_story
from pipeline.diagnosis.substitution import substitute
from pipeline.diagnosis.verdict import Diagnosis
from pipeline.labels.cases import HIT, Case, misread
from pipeline.language.tree import Query
from pipeline.system.errors import InputError

FLIPS = {LIFT: "LIFT", ATTRIBUTE: "ATTRIBUTE", SRM: "SRM", CONF: "OPM-CONF"}
"""The oracles that are applied where a right pair stood among the candidates and lost, in the order of the stages."""
SAME_MARGIN = 1e-6


def diagnose(
    evidence: FrameEvidence,
    case: Case,
    *,
    parse_ok: bool,
    mark: str | None = None,
    query: Query | None = None,
    problem: InputError | None = None,
    found: OracleScores | None = None,
) -> Diagnosis:
    """Name the module that failed on an expression, and the reason.

    Parameters
    ----------
    parse_ok : bool
        The parser read the gold triple.
    mark : str, optional
        What a person said of the label: BAD_LABEL or BAD_BOX.
    query : Query, optional
        What the parser read.
    problem : InputError, optional
        Why it could not be read.
    found : OracleScores, optional
        What `substitute` finds, where it was worked out with other expressions.
    """
    if (line := evidence.answers.source.line) is not None and not line.ranked:
        decided = judge_without_ranking(evidence, case, parse_ok, mark)
    else:
        decided = _decided(evidence, case, parse_ok, mark, found or substitute(evidence, case))
    if decided.verdict == "PARSE":
        decided = replace(decided, detail=misread(query, case, problem))
    return replace(decided, story=judged_story(decided, query, problem, evidence.answers.unknown))


def _decided(evidence: FrameEvidence, case: Case, parse_ok: bool, mark: str | None, found: OracleScores) -> Diagnosis:
    pair, alone = found.pair(), found.alone()
    winner = None if pair is None else found.pair_at(int(found.winners[0]))
    index = found.best_acceptable
    target = pair[0] if pair is not None else alone
    overlap = 0.0 if target is None or not parse_ok else float(found.target.overlap[target, case.target_object])
    right = None if index is None else found.first_acceptable
    lost = pair is not None and right is not None and not found.covered[pair]
    diagnosis = Diagnosis(
        verdict="",
        detail=None,
        lucky=False,
        repair=(),
        right_with=int((found.right_target << np.arange(found.subsets)).sum()),
        margins=found.margins,
        winner=winner if parse_ok else None,
        right=None if right is None else found.pair_at(right),
        false_target=target is not None and bool(found.target.object[target] < 0),
        false_reference=bool(case.reference) and pair is not None and bool(found.reference.object[pair[1]] < 0),
        needed=_needed(found, case, right) if lost and right is not None else (),
        gold=parse_ok,
        untold=unavailable_oracles(evidence, case, parse_ok),
        case=case,
        evidence=evidence,
    )
    if len(diagnosis.untold) == len(ORACLES):
        diagnosis = replace(diagnosis, right_with=None)
    fits = pair is not None and bool(found.covered[pair])
    right = target is not None and bool(found.right[target])
    if (known := decided_by_label(diagnosis, overlap >= HIT, mark, right, fits, lucky=not fits)) is not None:
        return known
    flip = _smallest(found, range(1, found.subsets))
    diagnosis = replace(diagnosis, repair=() if flip is None else names_of(flip))
    unproposed = not_proposed(evidence, case, found, diagnosis)
    if unproposed is not None:
        return unproposed
    if found.table.config.rule is not None and (ranked := judge_foreign_ranking(found, diagnosis)) is not None:
        return ranked
    flips = [bit for bit in FLIPS if bit < found.subsets and found.mends(bit)]
    verdict, detail, repair = _flipped(found, diagnosis, flips)
    mends = tuple(name for bit in flips for name in names_of(bit))
    moved = any(n.right_above is not None or n.winner_below is not None for n in diagnosis.needed)
    together = None if moved or not lost else needed_score(evidence, case, found, missed=False)
    box = needed_box(evidence, case, found) if verdict == "LIFT" and lost else None
    return replace(
        diagnosis,
        verdict=verdict,
        detail=detail,
        repair=names_of(repair),
        mends=mends,
        needed_score=together,
        needed_box=box,
    )


def _needed(found: OracleScores, case: Case, right: int) -> tuple[FactorRepair, ...]:
    winner = int(found.winners[0])
    if found.table.config.rule is not None:
        return ()
    if case.meant is None:
        return factor_repairs(found.plain, winner, right)
    if case.meant.chooses:
        # Which thing is chosen depends on all others: no factor has a say by itself.
        return ()
    ours, theirs = (
        prod(f.probability for f in found.pair_at(at).factors if f.mention == case.meant.root.mention)
        for at in (right, winner)
    )
    looks = (ours, theirs) if case.meant.root.attributes else None
    return factor_repairs(found.plain, winner, right, looks)


def _flipped(found: OracleScores, diagnosis: Diagnosis, flips: list[int]) -> tuple[str, str | None, int]:
    """Verdict, detail and repair of an acceptable pair that lost; `flips` are the oracles mending it alone."""
    if not flips:
        several = [s for s in range(found.subsets) if not s & RECALL and s.bit_count() > 1]
        smallest = _smallest(found, several)
        if smallest is None and diagnosis.case.meant is not None and diagnosis.case.meant.chooses:
            # Which thing is the second from the left depends on those that were not found, too.
            smallest = _smallest(found, [s for s in range(found.subsets) if s & RECALL])
            if smallest is None:
                return "SRM", "CHOICE", 0
        if smallest is None:
            return "PRM", "DEGENERATE", 0
        alone = blamed_together(found, diagnosis, [bit for bit in FLIPS if bit & smallest])
        if len(alone) != 1:
            return "COMPOUND", "+".join(names_of(smallest)), smallest
        flips, repair = alone, smallest
    else:
        repair = 0
    margin = {bit: found.decided_margin(bit) for bit in blamed_alone(found, diagnosis, flips)}
    farthest = max(margin.values())
    chosen = next(bit for bit, m in margin.items() if m >= farthest - SAME_MARGIN)
    if chosen == CONF:
        real = not (diagnosis.false_target or diagnosis.false_reference)
        return ("PRM" if real else "OPM-CONF"), None, repair or CONF
    # What is wrong with a relation may be that of a box, and true boxes alone not enough.
    return FLIPS[chosen], None, repair or (chosen if chosen in flips else flips[0])


def _smallest(found: OracleScores, subsets: range | list[int]) -> int | None:
    """Smallest of these subsets with an acceptable winner; of equal ones the largest margin."""
    able = [s for s in subsets if found.accepted[s]]
    return min(able, key=lambda s: (s.bit_count(), -found.margins[s], s)) if able else None
