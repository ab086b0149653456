"""The verdict on one expression: exclusive, exhaustive, decided in a fixed order.

CORRECT      the answer's target overlaps the labelled one by half (LUCKY where the pair is not an acceptable one)
PARSE        the parsed triple is not the gold triple
LABEL        AMBIGUOUS: the answer is another acceptable target; BAD_LABEL, BAD_BOX: a person marked the label;
             SUSPECT: the labels' own relations say of the answer that it is, or may be, right, and the expression does
             not list it
OPM-TARGET   no candidate overlaps an acceptable target: RANK, THRESHOLD, LOCALISATION or ABSENT (`misses`)
OPM-REF      no candidate pair is an acceptable one
LIFT, SRM, OPM-CONF, PRM, COMPOUND
             an acceptable pair stood among the candidates and lost. Each oracle is applied alone and the pairs are
             ranked again. Exactly one makes an acceptable pair win: it names the verdict; CONF is OPM-CONF where a
             false positive won, and PRM where two real objects did, whose confidences overruled the relation. Several
             do: the one with the largest margin of the best acceptable over the best other pair; within 1e-6 the
             earlier stage. None does: COMPOUND, with the smallest subset of the three that does. Not even all three:
             PRM, DEGENERATE: the right pair is excluded as one thing, or lost by a rule for ties.

When several oracles are compared, relations count by what the network decides: above .5 as .99, below as .01, as the
truth has it. Else the truth, which is never less sure than a network, would go farther than any true geometry and any
true confidence, and a relation that the network had right, only not to .99, would be blamed for a broken box or for
confidences that overruled it. Where the network decides wrongly, the truth still goes farther, and SRM is named.
(With planted faults: see `tests/benchmarks/planted.py`.)
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from pipeline.answering.pair_table import ScoredPair, one_object_twice
from pipeline.diagnosis.frame_evidence import FrameEvidence
from pipeline.diagnosis.misses import Missed, why_missed
from pipeline.diagnosis.oracles import CONF, LIFT, SRM, SUBSETS, names_of, size
from pipeline.diagnosis.repair import Needed, needed_changes
from pipeline.diagnosis.substitution import CandidateSet, OracleScores, substitute
from pipeline.diagnosis.words import explain
from pipeline.geometry.boxes import Box3D
from pipeline.labels.cases import HIT, Case, FrameCases
from pipeline.language.expression import Query

VERDICTS = (
    "CORRECT", "PARSE", "LABEL", "OPM-TARGET", "OPM-REF", "LIFT", "SRM", "OPM-CONF", "PRM", "COMPOUND",
)  # fmt: skip
"""In the order in which they are decided."""
MODULE_OF = {
    "PARSE": "PARSE", "LABEL": "LABEL", "OPM-TARGET": "OPM", "OPM-REF": "OPM", "LIFT": "LIFT", "SRM": "SRM",
    "OPM-CONF": "OPM", "PRM": "PRM",
}  # fmt: skip
"""The module that a verdict blames; COMPOUND blames those of its repair."""
MARKS = ("BAD_LABEL", "BAD_BOX")
_FLIPS = (LIFT, SRM, CONF)
_ALL_FLIPS = LIFT | SRM | CONF
SAME_MARGIN = 1e-6


@dataclass(frozen=True)
class Diagnosis:
    """What failed and what would mend it, with all that it was judged by.

    Attributes
    ----------
    verdict : str
        One of VERDICTS.
    detail : str or None
        AMBIGUOUS, BAD_LABEL, BAD_BOX, SUSPECT; RANK, THRESHOLD, LOCALISATION, ABSENT; DEGENERATE; the oracles of
        COMPOUND.
    lucky : bool
        Right, but with a pair that is not acceptable.
    repair : tuple of str
        The smallest set of oracles with which an acceptable pair wins; empty where none is needed or none helps.
    mends : tuple of str
        Where an acceptable pair stood among the candidates and lost: every oracle that alone makes one win.
    right_with : int
        Bit s is set where the target is right with the oracles of subset s (`oracles`), on the gold triple.
    margins : (16,) float64
        S of the best acceptable pair less S of the best other one under each subset; NaN without any pair.
    winner, right : ScoredPair or None
        The answer, and the best acceptable pair among the candidates.
    false_target, false_reference : bool
        The answer's objects are of no labelled object of the asked class.
    missed : Missed or None
        With OPM-TARGET and OPM-REF.
    missed_name : str or None
        The class name of which the right object is missing.
    needed : tuple of Needed
        What one factor alone would have to be for the best acceptable pair to win; empty where one wins.
    pseudo : bool
        LIFT's truth was the box of the label for an object of either pair: the dataset has no pixels of it.
    text : str
        The verdict in words.
    gold : bool
        The expression was read as meant; else the evidence is that of the gold names, not the trace's own.
    case : Case
    evidence : FrameEvidence
    """

    verdict: str
    detail: str | None
    lucky: bool
    repair: tuple[str, ...]
    right_with: int
    margins: np.ndarray
    winner: ScoredPair | None
    right: ScoredPair | None
    false_target: bool = False
    false_reference: bool = False
    missed: Missed | None = None
    missed_name: str | None = None
    pseudo: bool = False
    mends: tuple[str, ...] = ()
    needed: tuple[Needed, ...] = ()
    text: str = ""
    gold: bool = True
    case: Case = field(kw_only=True)
    evidence: FrameEvidence = field(kw_only=True, repr=False)

    @property
    def truth(self) -> FrameCases:
        """What is true of the frame."""
        return self.evidence.truth

    @property
    def correct(self) -> bool:
        """The verdict is CORRECT."""
        return self.verdict == "CORRECT"

    @property
    def contributions(self) -> dict[str, float] | None:
        """Each factor's share of S(winner) - S(right), unweighted logs; positive favours the winner."""
        if self.winner is None or self.right is None:
            return None
        return {
            name: float(np.log(max(getattr(self.winner, f), 1e-6)) - np.log(max(getattr(self.right, f), 1e-6)))
            for name, f in (("target", "p_target"), ("reference", "p_reference"), ("relation", "p_relation"))
        }

    def acceptable_pairs(self) -> set[tuple[int, int]]:
        """Candidate pairs that are acceptable, as indices of the trace's objects."""
        if not self.gold:
            return set()
        found = substitute(self.evidence, self.case)
        targets, references = (role.places[: role.found] for role in (found.target, found.reference))
        covered = found.covered[: len(targets), : len(references)]
        here = np.argwhere(covered & ~one_object_twice((targets, references), self.evidence.same))
        return {(int(targets[i]), int(references[j])) for i, j in here}

    def labelled_boxes(self) -> dict[str, Box3D]:
        """The labelled target and reference in 3D, as far as their geometry is known."""
        ends = (("target", self.case.target_object), ("reference", self.case.reference_object))
        found = ((name, self.evidence.objects.get(k, points=False)) for name, k in ends)
        return {name: o.lifted.box for name, o in found if o is not None and o.lifted.box is not None}


def diagnose(
    evidence: FrameEvidence,
    case: Case,
    *,
    parse_ok: bool,
    mark: str | None = None,
    query: Query | None = None,
    problem: str | None = None,
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
    problem : str, optional
        Why it could not be read, or could not be asked.
    """
    found = _decided(evidence, case, parse_ok, mark)
    return replace(found, text=explain(found, case, query=query, problem=problem, unknown=evidence.answers.unknown))


def _decided(evidence: FrameEvidence, case: Case, parse_ok: bool, mark: str | None) -> Diagnosis:
    found = substitute(evidence, case)
    pair, alone = found.pair(), found.alone()
    winner = None if pair is None else found.plain.pair(int(found.winners[0]))
    place = found.best_acceptable
    target = pair[0] if pair is not None else alone
    overlap = 0.0 if target is None or not parse_ok else float(found.target.overlap[target, case.target_object])
    flip = _smallest(found, range(1, SUBSETS))
    right = None if place is None else place[0] * found.covered.shape[1] + place[1]
    lost = pair is not None and right is not None and not found.covered[pair]
    diagnosis = Diagnosis(
        verdict="",
        detail=None,
        lucky=False,
        repair=() if flip is None else names_of(flip),
        right_with=int((found.right_target << np.arange(SUBSETS)).sum()),
        margins=found.margins,
        winner=winner if parse_ok else None,
        right=None if right is None else found.plain.pair(right),
        false_target=target is not None and bool(found.target.object[target] < 0),
        false_reference=pair is not None and bool(found.reference.object[pair[1]] < 0),
        needed=needed_changes(found.plain, int(found.winners[0]), right) if lost and right is not None else (),
        pseudo=_pseudo(evidence, found, [p for p in (pair, place) if p is not None]),
        gold=parse_ok,
        case=case,
        evidence=evidence,
    )
    if overlap >= HIT:
        lucky = pair is None or not found.covered[pair]
        return replace(diagnosis, verdict="CORRECT", lucky=lucky, repair=())
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
        return replace(
            diagnosis, verdict="OPM-REF", detail=missed.kind, missed=missed, missed_name=case.reference
        )
    flips = [bit for bit in _FLIPS if found.accepted[bit]]
    verdict, detail, repair = _flipped(found, diagnosis, flips)
    mends = tuple(name for bit in flips for name in names_of(bit))
    return replace(diagnosis, verdict=verdict, detail=detail, repair=names_of(repair), mends=mends)


def _flipped(found: OracleScores, diagnosis: Diagnosis, flips: list[int]) -> tuple[str, str | None, int]:
    """Verdict, detail and repair where an acceptable pair lost; `flips` are the oracles that alone mend it."""
    if not flips:
        several = [s for s in range(SUBSETS) if not s & ~_ALL_FLIPS and size(s) > 1]
        smallest = _smallest(found, several)
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
    return ("LIFT" if chosen == LIFT else "SRM"), None, chosen


def _smallest(found: OracleScores, subsets: range | list[int]) -> int | None:
    """The smallest of these subsets with which an acceptable pair wins; of equal ones that with the largest margin."""
    able = [s for s in subsets if found.accepted[s]]
    return min(able, key=lambda s: (size(s), -found.margins[s], s)) if able else None


def _pseudo(evidence: FrameEvidence, found: OracleScores, pairs: list[tuple[int, int]]) -> bool:
    def boxed(role: CandidateSet, k: int) -> bool:
        return role.shape_of[k] >= 0 and bool(evidence.objects.pseudo[role.shape_of[k]])

    return any(boxed(found.target, i) or boxed(found.reference, j) for i, j in pairs)


def _missed(evidence: FrameEvidence, name: str, objects: np.ndarray) -> Missed:
    source, frame = evidence.answers.source, evidence.answers.context.frame
    right = evidence.truth.boxes[objects]
    return why_missed(frame, name, right, source.config.k, source.needed_detector(), source.unfiltered_detector)
