"""The verdict on one expression: exclusive, exhaustive, decided in a fixed order.

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

from collections.abc import Callable
from dataclasses import replace
from math import prod

import numpy as np

from pipeline.diagnosis.frame_evidence import FrameEvidence
from pipeline.diagnosis.needed import Needed, needed_changes
from pipeline.diagnosis.oracles import ATTRIBUTE, CONF, LIFT, RECALL, SRM, CandidateSet, OracleScores, names_of
from pipeline.diagnosis.substitution import substitute
from pipeline.diagnosis.verdict import Diagnosis, Missed, explain
from pipeline.geometry.boxes import iou_2d
from pipeline.geometry.frame import Frame
from pipeline.labels.cases import HIT, Case, misread
from pipeline.language.tree import Query
from pipeline.proposals.base import Detector, Proposals, suppress
from pipeline.system.errors import InputError

_FLIPS = {LIFT: "LIFT", ATTRIBUTE: "ATTRIBUTE", SRM: "SRM", CONF: "OPM-CONF"}
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
) -> Diagnosis:
    """Name the module that failed on one expression, and say why.

    Parameters
    ----------
    evidence : FrameEvidence
    case : Case
    parse_ok : bool
        The parser read the gold triple.
    mark : str, optional
        What a person said of the label: BAD_LABEL or BAD_BOX.
    query : Query, optional
        What the parser read.
    problem : InputError, optional
        Why it could not be read, or could not be asked.
    """
    found = _decided(evidence, case, parse_ok, mark)
    if found.verdict == "PARSE":
        found = replace(found, detail=misread(query, case, problem))
    return replace(found, text=explain(found, case, query=query, problem=problem, unknown=evidence.answers.unknown))


def _decided(evidence: FrameEvidence, case: Case, parse_ok: bool, mark: str | None) -> Diagnosis:
    found = substitute(evidence, case)
    pair, alone = found.pair(), found.alone()
    winner = None if pair is None else found.pair_at(int(found.winners[0]))
    index = found.best_acceptable
    target = pair[0] if pair is not None else alone
    overlap = 0.0 if target is None or not parse_ok else float(found.target.overlap[target, case.target_object])
    flip = _smallest(found, range(1, found.subsets))
    right = None if index is None else index[0] * found.covered.shape[1] + index[1]
    lost = pair is not None and right is not None and not found.covered[pair]
    diagnosis = Diagnosis(
        verdict="",
        detail=None,
        lucky=False,
        repair=() if flip is None else names_of(flip),
        right_with=int((found.right_target << np.arange(found.subsets)).sum()),
        margins=found.margins,
        winner=winner if parse_ok else None,
        right=None if right is None else found.pair_at(right),
        false_target=target is not None and bool(found.target.object[target] < 0),
        false_reference=bool(case.reference) and pair is not None and bool(found.reference.object[pair[1]] < 0),
        needed=_needed(found, case, right) if lost and right is not None else (),
        pseudo=_pseudo(evidence, found, [p for p in (pair, index) if p is not None]),
        gold=parse_ok,
        case=case,
        evidence=evidence,
    )
    if overlap >= HIT:
        return replace(diagnosis, verdict="CORRECT", lucky=pair is None or not found.covered[pair], repair=())
    if not parse_ok:
        return replace(diagnosis, verdict="PARSE", repair=())
    if target is not None and found.right[target]:
        return replace(diagnosis, verdict="LABEL", detail="AMBIGUOUS", repair=())
    if mark is not None:
        return replace(diagnosis, verdict="LABEL", detail=mark, repair=())
    if pair is not None and found.covered[pair]:
        return replace(diagnosis, verdict="LABEL", detail="SUSPECT", repair=())
    if not found.right[: found.target.found].any():
        missed = _missed(evidence, case.target, case.acceptable)
        return replace(diagnosis, verdict="OPM-TARGET", detail=missed.kind, missed=missed, missed_name=case.target)
    if not found.covered[: found.target.found, : found.reference.found].any():
        pairs = evidence.truth.acceptable_pairs(case)
        shown = found.target.overlap[: found.target.found] >= HIT
        wanted = pairs[np.asarray((shown & np.asarray(pairs.any(axis=1))[None]).any(axis=0))].any(axis=0)
        missed = _missed(evidence, case.reference, np.flatnonzero(wanted))
        return replace(diagnosis, verdict="OPM-REF", detail=missed.kind, missed=missed, missed_name=case.reference)
    flips = [bit for bit in _FLIPS if bit < found.subsets and found.accepted[bit]]
    verdict, detail, repair = _flipped(found, diagnosis, flips)
    mends = tuple(name for bit in flips for name in names_of(bit))
    return replace(diagnosis, verdict=verdict, detail=detail, repair=names_of(repair), mends=mends)


def _needed(found: OracleScores, case: Case, right: int) -> tuple[Needed, ...]:
    winner = int(found.winners[0])
    if case.meant is None:
        return needed_changes(found.plain, winner, right)
    if case.meant.chooses:
        # Which thing is chosen depends on all others: no factor has a say by itself.
        return ()
    ours, theirs = (
        prod(f.probability for f in found.pair_at(at).factors if f.mention == case.meant.root.mention)
        for at in (right, winner)
    )
    looks = (ours, theirs) if case.meant.root.attributes else None
    return needed_changes(found.plain, winner, right, looks)


def _flipped(found: OracleScores, diagnosis: Diagnosis, flips: list[int]) -> tuple[str, str | None, int]:
    """Verdict, detail and repair where an acceptable pair lost; `flips` are the oracles that alone mend it."""
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
        return "COMPOUND", "+".join(names_of(smallest)), smallest
    chosen = flips[0]
    if len(flips) > 1:
        margin = {bit: found.decided_margin(bit) for bit in flips}
        farthest = max(margin.values())
        chosen = next(bit for bit in flips if margin[bit] >= farthest - SAME_MARGIN)
    if chosen == CONF:
        real = not (diagnosis.false_target or diagnosis.false_reference)
        return ("PRM" if real else "OPM-CONF"), None, CONF
    return _FLIPS[chosen], None, chosen


def _smallest(found: OracleScores, subsets: range | list[int]) -> int | None:
    """The smallest of these subsets with which an acceptable pair wins; of equal ones that with the largest margin."""
    able = [s for s in subsets if found.accepted[s]]
    return min(able, key=lambda s: (s.bit_count(), -found.margins[s], s)) if able else None


def _pseudo(evidence: FrameEvidence, found: OracleScores, pairs: list[tuple[int, int]]) -> bool:
    def boxed(role: CandidateSet, k: int) -> bool:
        return role.shape_of[k] >= 0 and bool(evidence.objects.pseudo[role.shape_of[k]])

    return any(boxed(found.target, i) or boxed(found.reference, j) for i, j in pairs)


def _missed(evidence: FrameEvidence, name: str, objects: np.ndarray) -> Missed:
    source, frame = evidence.answers.source, evidence.answers.context.frame
    right = evidence.truth.boxes[objects]
    return why_missed(frame, name, right, source.config.k, source.needed_detector(), source.unfiltered_detector)


NEAR_MISS = 0.1
"""A box that overlaps at least this much, and less than a half, is of the object but badly placed."""


def why_missed(
    frame: Frame,
    name: str,
    right: np.ndarray,
    k: int,
    detector: Detector,
    unfiltered: Callable[[], Detector],
) -> Missed:
    """Look for a right box among all that the detector gives, then among what it drops.

    Parameters
    ----------
    frame : Frame
    name : str
        The class name that was asked.
    right : (M, 4) float
        Boxes of the objects that would have been right, pixels.
    k : int
    detector : Detector
    unfiltered : callable
        Gives the same detector without a minimum score; called only when it is needed.
    """
    seen = _detections(detector, frame, name)
    best = 0.0
    score: float | None = None
    if seen is not None and len(seen):
        overlap = iou_2d(seen.boxes, right).max(axis=1, initial=0.0)
        order = np.argsort(-seen.scores, kind="stable")
        hits = np.flatnonzero(overlap[order] >= HIT)
        if len(hits):
            rank = int(hits[0])
            survives = set(suppress(seen.boxes[order]).tolist())
            return Missed(
                "RANK",
                float(overlap[order[rank]]),
                float(seen.scores[order[rank]]),
                rank + 1,
                not detector.exact and not any(int(h) in survives for h in hits),
            )
        best, score = float(overlap.max()), float(seen.scores[int(overlap.argmax())])
    loose = _detections(unfiltered(), frame, name)
    if loose is not None and len(loose):
        overlap = iou_2d(loose.boxes, right).max(axis=1, initial=0.0)
        if overlap.max() >= HIT:
            at = int(np.where(overlap >= HIT, loose.scores, -1.0).argmax())
            return Missed("THRESHOLD", float(overlap[at]), float(loose.scores[at]))
        if overlap.max() > best:
            best, score = float(overlap.max()), float(loose.scores[int(overlap.argmax())])
    return Missed("LOCALISATION", best, score) if best >= NEAR_MISS else Missed("ABSENT", best)


def _detections(detector: Detector, frame: Frame, name: str) -> Proposals | None:
    """All detections of a name; None where the detector cannot know it."""
    try:
        return detector.detect(frame, [name])
    except InputError:
        return None
