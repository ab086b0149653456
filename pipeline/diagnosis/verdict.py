"""Verdict of an answer, and its explanation in a sentence or two; `decision` finds it."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from pipeline.answering.pair_table import HOLDS, ScoredPair, one_object_twice
from pipeline.diagnosis.frame_evidence import FrameEvidence
from pipeline.diagnosis.minimal_repair import FactorRepair, smallest_change
from pipeline.diagnosis.oracles import names_of
from pipeline.diagnosis.substitution import substitute
from pipeline.geometry.boxes import Box3D
from pipeline.labels.cases import Case, FrameCases
from pipeline.language.relation_names import PHRASE
from pipeline.language.tree import Query
from pipeline.system.errors import InputError

Miss = Literal["RANK", "THRESHOLD", "LOCALISATION", "ABSENT"]
ORACLE_WORDS = {
    "RECALL": "the missing objects",
    "LIFT": "true geometry",
    "SRM": "true relations",
    "CONF": "true confidences",
    "ATTRIBUTE": "true attributes",
}

VERDICTS: tuple[str, ...] = (
    "CORRECT",
    "PARSE",
    "LABEL",
    "OPM-TARGET",
    "OPM-REF",
    "LIFT",
    "ATTRIBUTE",
    "SRM",
    "OPM-CONF",
    "PRM",
    "COMPOUND",
    "UNEXPLAINED",
)
"""In the order in which they are decided; ATTRIBUTE only of expressions with attributes, UNEXPLAINED only of imported
predictions."""


def shown_detail(detail: str | None, lucky: bool = False) -> str:
    """Detail of a verdict as printed; modules by the names of verdicts: `SRM+CONF` is SRM+OPM-CONF."""
    if lucky:
        return "LUCKY"
    return "+".join({"RECALL": "OPM", "CONF": "OPM-CONF"}.get(part, part) for part in (detail or "").split("+"))


def shown_verdict(verdict: str, detail: str | None, lucky: bool = False) -> str:
    """Verdict in a line: `OPM-TARGET RANK`, `CORRECT LUCKY`.

    >>> shown_verdict("COMPOUND", "SRM+CONF"), shown_verdict("CORRECT", None, lucky=True)
    ('COMPOUND SRM+OPM-CONF', 'CORRECT LUCKY')
    """
    return f"{verdict} {shown_detail(detail, lucky)}".strip()


RULES_VERSION = 2
"""Of the rules by which verdicts are found; another number where the same answer may have another verdict."""


def shown_verdicts(occurring: Collection[str]) -> tuple[str, ...]:
    """VERDICTS; ATTRIBUTE and UNEXPLAINED only where present: plain expressions of our own never have them.

    Where some are unexplained, a module that none names is not known to cost nothing, and is left out.
    """
    always = VERDICTS[:3] if "UNEXPLAINED" in occurring else tuple(v for v in VERDICTS[:-1] if v != "ATTRIBUTE")
    return tuple(v for v in VERDICTS if v in always or v in occurring)


MODULE_OF = {
    "PARSE": "PARSE",
    "LABEL": "LABEL",
    "OPM-TARGET": "OPM",
    "OPM-REF": "OPM",
    "LIFT": "LIFT",
    "ATTRIBUTE": "ATTRIBUTE",
    "SRM": "SRM",
    "OPM-CONF": "OPM",
    "PRM": "PRM",
}
"""The module that a verdict blames; COMPOUND blames those of its repair."""


@dataclass(frozen=True)
class Diagnosis:
    """Verdict with the repair, and the evidence behind both."""

    verdict: str  # One of VERDICTS
    # WORDS, GRAMMAR, UNSUPPORTED (not in files of earlier versions); AMBIGUOUS, BAD_LABEL, BAD_BOX, SUSPECT; RANK,
    # THRESHOLD, LOCALISATION, ABSENT; DEGENERATE; CHOICE; CONSTANT (of imported relations: about as probable of every
    # pair); SCORE (of imported pair scores: the right pair would stand first by what all others scored); the oracles of
    # COMPOUND; of UNEXPLAINED what the file gives (ANSWER, PROPOSALS, BOXES), or NOT-SEPARABLE
    detail: str | None
    lucky: bool  # Right, but with a pair that is not acceptable
    # The smallest set of oracles with which an acceptable pair wins; empty where none is needed or none helps
    repair: tuple[str, ...]
    # Bit s is set where the target is right with the oracles of subset s (`oracles`), on the gold triple; None where
    # predictions that were imported do not tell
    right_with: int | None
    # (S,) float64: of all S subsets, sixteen or with attributes thirty-two: S of the best acceptable pair less S of the
    # best other one under each subset; NaN without any pair
    margins: np.ndarray
    # winner, right: The answer, and the best acceptable pair among the candidates
    winner: ScoredPair | None
    right: ScoredPair | None
    # false_target, false_reference: The answer's objects are of no labelled object of the asked class
    false_target: bool = False
    false_reference: bool = False
    missed: Missed | None = None  # With OPM-TARGET and OPM-REF
    missed_name: str | None = None  # The class name of which the right object is missing
    # Where an acceptable pair stood among the candidates and lost: every oracle that alone makes one win
    mends: tuple[str, ...] = ()
    # What one factor alone would have to be for the best acceptable pair to win; empty where one wins
    needed: tuple[FactorRepair, ...] = ()
    text: str = ""  # The verdict in words
    # Of imported predictions: the oracles that cannot be put in place by what the file gives, and why; what
    # `right_with` says of subsets with these counts nowhere
    untold: dict[str, str] = field(default_factory=dict)
    # The expression was read as meant; else the evidence is that of the gold names, not the trace's own
    gold: bool = True
    case: Case = field(kw_only=True)
    evidence: FrameEvidence = field(kw_only=True, repr=False)

    @property
    def oracles(self) -> tuple[str, ...]:
        """Oracles of `margins` and `right_with`, in the order of their bits."""
        return names_of(len(self.margins) - 1)

    @property
    def truth(self) -> FrameCases:
        """Truth of the frame."""
        return self.evidence.truth

    @property
    def correct(self) -> bool:
        """True for the verdict CORRECT."""
        return self.verdict == "CORRECT"

    @property
    def contributions(self) -> dict[str, float] | None:
        """Share of each factor in S(winner) - S(right), unweighted logs; positive favours the winner.

        "attributes" only where something is said of the objects alone.
        """
        if self.winner is None or self.right is None or self.evidence.answers.source.config.rank.rule is not None:
            return None
        ours, theirs = self.winner.log_factors, self.right.log_factors
        return {name: ours[name] - theirs[name] for name in ours}

    def acceptable_pairs(self) -> set[tuple[int, int]]:
        """Acceptable candidate pairs, as indices of the trace's objects; none without a relation."""
        if not self.gold or not self.case.reference:
            return set()
        found = substitute(self.evidence, self.case)
        targets, references = (role.index[: role.found] for role in (found.target, found.reference))
        covered = found.covered[: len(targets), : len(references)]
        here = np.argwhere(covered & ~one_object_twice((targets, references), self.evidence.same))
        return {(int(targets[i]), int(references[j])) for i, j in here}

    def labelled_boxes(self) -> dict[str, Box3D]:
        """Labelled target and reference in 3D, with known geometry."""
        ends = (("target", self.case.target_object), ("reference", self.case.reference_object))
        found = ((n, self.evidence.objects.get(k, points=False)) for n, k in ends[: 2 if self.case.reference else 1])
        return {name: o.lifted.box for name, o in found if o is not None and o.lifted.box is not None}


@dataclass(frozen=True)
class Missed:
    """Reason for an object missing among the candidates."""

    # kind: RANK: the detector gave it, but others stood before it (K) or over it (suppression of overlapping boxes).
    # THRESHOLD: it gave it with less than the minimum score. LOCALISATION: the best box overlaps it by .1 to .5.
    # ABSENT: nothing overlaps it by .1.
    kind: Miss
    overlap: float  # The best IoU of all boxes seen
    score: float | None = None  # Of the box that was cut off, or of the best overlapping one
    rank: int | None = None  # With RANK: its rank from 1 by score, before suppression
    suppressed: bool = False  # With RANK: a better-scored box overlapped it too much


def explain(
    diagnosis: Diagnosis,
    case: Case,
    *,
    query: Query | None = None,
    problem: InputError | None = None,
    unknown: Collection[str] = (),
) -> str:
    """Explain the answer, and the smallest change to mend it.

    `query`: what the parser read; `problem`: why it could not be read, or could not be asked; `unknown`: names that the
    detector does not know.
    """
    if diagnosis.verdict == "PARSE":
        return _parse(case, query, problem)
    if diagnosis.verdict in ("OPM-TARGET", "OPM-REF"):
        return _missed(diagnosis, unknown)
    told = {"CORRECT": _correct, "LABEL": _label, "UNEXPLAINED": _unexplained}.get(diagnosis.verdict, _lost)
    return told(diagnosis, case)


def _unexplained(d: Diagnosis, case: Case) -> str:
    line = d.evidence.answers.source.line
    return unexplained(d.detail, case.target, line is None or line.ranked or line.answer is not None)


def _lost(d: Diagnosis, case: Case) -> str:
    return " ".join(filter(None, (_flipped(d, case), _others(d), smallest_change(d.needed))))


def _correct(d: Diagnosis, case: Case) -> str:
    if not d.lucky:
        if d.winner is None or not case.relation:
            return "Right."
        return f"Right: relation {_p(d.winner.p_relation)}.{_nearest(d.winner)}"
    if d.winner is None:
        return f"The right {case.target}, but alone: all candidates of the two names count as one thing. Luck."
    return f"The right {case.target}, but its {case.reference} matches none of which the expression is true: luck."


def _parse(case: Case, query: Query | None, problem: InputError | None) -> str:
    meant = f"meant was ({case.target}, {PHRASE[case.relation]}, {case.reference})"
    if query is None:
        return f"The expression cannot be read: {problem}; {meant}."
    e = query.expression
    if len(query.readings) > 1:
        return f"The expression has {len(query.readings)} readings; {meant}."
    if e is None:
        return f"Read as {query.default.description}, without a relation; {meant}."
    return f"Read as ({e.target}, {PHRASE.get(e.relation, e.relation)}, {e.reference}); {meant}."


def _label(d: Diagnosis, case: Case) -> str:
    marked = "A person marked this label as wrong in {}; the answer may well be right."
    words = {
        "AMBIGUOUS": f"The answer is another {case.target} of which the expression is, or may be, true; "
        f"it has {len(case.acceptable)} right answers, and the label names one.",
        "SUSPECT": f"The labels' own relations say of the answer that it is, or may be, a {case.target} "
        f"{PHRASE[case.relation]} the {case.reference}, and the expression does not list it: the label is suspect.",
        "BAD_BOX": marked.format("its box"),
    }
    return words.get(d.detail or "", marked.format("what it says"))


def _missed(d: Diagnosis, unknown: Collection[str]) -> str:
    missed, name = d.missed, d.missed_name
    assert missed is not None
    after = f" {_repaired(d)}" if d.repair and d.repair != ("RECALL",) else ""
    score, overlap = _p(missed.score), _p(missed.overlap)
    told = "" if missed.score is None else f" (score {score})"
    kind = "UNKNOWN" if name in unknown else "SUPPRESSED" if missed.suppressed else missed.kind
    words = {
        "UNKNOWN": f"The detector does not know the name “{name}”.",
        "SUPPRESSED": f"A better-scored box lies over the right {name} ({score}) and suppressed it.",
        "RANK": f"The right {name} has {score}, place {missed.rank} by score: K cuts it off.",
        "THRESHOLD": f"The detector gave the right {name} {score}, below the minimum score.",
        "LOCALISATION": f"The best box of the right {name} overlaps it by {overlap}{told}; .50 is asked.",
        "ABSENT": f"The detector did not see the right {name} at all (best overlap {overlap}).",
    }
    return words[kind] + after


def _flipped(d: Diagnosis, case: Case) -> str:
    winner, right = d.winner, d.right
    if winner is None or right is None:
        # No right pair was allowed; what else can be said depends on whether true masks tell its two things apart.
        first = (
            f"The masks of the right {case.target} and {case.reference} are so alike that they"
            if "LIFT" in d.repair
            else f"All candidates of the two names, of which the best {case.target} answered alone,"
            if winner is None
            else f"The right {case.target} and {case.reference}"
        )
        return f"{first} count as one thing. {_repaired(d) if d.repair else ''}".strip() + f" Verdict: {d.verdict}."
    if d.detail == "SCORE":
        return (
            f"The right {case.target} and {case.reference} lost, though with these confidences and this probability "
            f"other pairs of the file score enough to win. Verdict: PRM."
        )
    text = _said_of_both(d.verdict, winner, right, case)
    if d.detail == "CONSTANT":
        return f"{text[0].upper()}{text[1:]}: about as probable of every pair, it tells none apart. Verdict: SRM."
    if len(d.repair) > 1 and d.verdict in ("LIFT", "SRM"):
        why = "The confidences spoke for the right pair, but the truth is less sure of it than a scorer."
        return f"{text[0].upper()}{text[1:]}. {why} {_repaired(d)} Verdict: {d.verdict}."
    if len(d.repair) > 1 and d.verdict in ("OPM-CONF", "PRM"):
        return f"{text[0].upper()}{text[1:]}: it spoke for the right pair. {_repaired(d)} Verdict: {d.verdict}."
    if d.verdict == "LIFT":
        by = ", by estimated depth" if d.evidence.answers.context.frame.depth_source else ""
        if "LIFT" not in d.repair:
            how = "True geometry takes the relation half the way to the right pair or farther."
            return f"A 3D box is off{by}: {text}. {how} {_repaired(d)} Verdict: LIFT."
        return f"A 3D box is off{by}: {text}. With true geometry the right pair wins. Verdict: LIFT."
    if d.verdict == "ATTRIBUTE":
        return f"{text[0].upper()}{text[1:]}. With true attributes the right pair wins. Verdict: ATTRIBUTE."
    if d.detail == "CHOICE":
        return f"With all else true {text}. Verdict: SRM."
    if d.verdict == "SRM":
        return f"{text[0].upper()}{text[1:]}. With the labelled relations the right pair wins. Verdict: SRM."
    if d.verdict in ("OPM-CONF", "PRM") and d.detail != "DEGENERATE":
        return _confidences(d, winner, right, case)
    if d.verdict == "COMPOUND":
        return (
            f"No module that judged the right pair is to blame alone. {_repaired(d)}"
            if d.repair == ("RECALL",)
            else f"No module alone is to blame. {_repaired(d)}"
        )
    return "No true geometry, relation or confidence puts the right pair first: it lost a tie. Verdict: PRM."


def _confidences(d: Diagnosis, winner: ScoredPair, right: ScoredPair, case: Case) -> str:
    if d.verdict == "OPM-CONF":
        false = [
            f"{name} ({_p(p)})"
            for name, wrong, p in (
                (case.target, d.false_target, winner.p_target),
                (case.reference, d.false_reference, winner.p_reference),
            )
            if wrong
        ]
        what = "are false positives" if len(false) > 1 else "is a false positive"
        had = (
            f"pair had {_p(right.p_target)} and {_p(right.p_reference)}"
            if case.reference
            else (f"{case.target} had {_p(right.p_target)}")
        )
        return (
            f"The answer's {' and '.join(false)} {what}; the right {had}. With true confidences the right pair wins."
            f"{_nearest(right)} Verdict: OPM-CONF."
        )
    parts = [
        "the wrong {} {} and the right one {}".format(name, *distinct_digits(ours, theirs))
        for name, mine, other, ours, theirs in (
            (case.target, winner.target, right.target, winner.p_target, right.p_target),
            (case.reference, winner.reference, right.reference, winner.p_reference, right.p_reference),
        )
        if mine != other
    ]
    if not case.relation:
        text = f"the detector gave {' and '.join(parts)}" if parts else "both are one object"
        return f"{text[0].upper()}{text[1:]}. With equal confidences the answer is right. Verdict: PRM."
    first, second = distinct_digits(*sorted((winner.p_relation, right.p_relation), reverse=True))
    favoured = "the right pair" if right.p_relation >= winner.p_relation else "the answer"
    relation = (
        f"for the relation they are equal ({first})"
        if first == second
        else f"the relation favoured {favoured} {first} to {second}"
    )
    text = "; ".join([*(f"the detector gave {' and '.join(parts)}" for _ in parts[:1]), relation])
    return f"{text[0].upper()}{text[1:]}. With equal confidences the answer is right.{_nearest(right)} Verdict: PRM."


def _said_of_both(verdict: str, winner: ScoredPair, right: ScoredPair, case: Case) -> str:
    """Part of the expression speaking most for the answer, by kind where to blame, with both probabilities."""
    relations = [(PHRASE.get(k.relation, k.relation), k.probability) for k in winner.links]
    theirs = [k.probability for k in right.links]
    if case.meant is None:
        return _relation(winner.p_relation, right.p_relation, case)
    of_one = {"ATTRIBUTE": ("attribute",), "SRM": ("choice", "negation", "viewer")}.get(verdict)
    factors = [(f, g) for f, g in zip(winner.factors, right.factors, strict=True) if of_one is None or f.kind in of_one]
    told = [(f.text, f.probability, g.probability) for f, g in factors]
    if verdict != "ATTRIBUTE":
        told += [(phrase, p, q) for (phrase, p), q in zip(relations, theirs, strict=True)]
    if not told:
        return f"nothing that is said tells the right {case.target} from the answer"
    phrase, ours, other = max(told, key=lambda t: t[1] / max(t[2], 1e-9))
    mine, its = distinct_digits(ours, other)
    return f"“{phrase}” gave " + (f"both {mine}" if mine == its else f"the answer {mine} and the right one {its}")


def _relation(winner: float, right: float, case: Case) -> str:
    """Relation probabilities of the answer and of the right pair, and its truth of either."""
    ours, theirs = distinct_digits(winner, right)
    both = f"both the answer and the right pair {ours}"
    given = both if ours == theirs else f"the answer {ours} and the right pair {theirs}"
    neither = ", so that neither stands in it" if max(winner, right) < HOLDS else ""
    return f"“{PHRASE[case.relation]}” gave {given}{neither}"


def _nearest(pair: ScoredPair) -> str:
    """Words for a right pair with a disbelieved relation; else empty."""
    return "" if pair.p_relation >= HOLDS else f" Below {HOLDS:.2f} it is told as the nearest pair only."


def distinct_digits(*values: float) -> tuple[str, ...]:
    """Probabilities with two digits, or with as many more as distinguish them."""
    for digits in range(2, 10):
        shown = tuple(f"{value:.{digits}f}" for value in values)
        if len(set(shown)) == len(set(values)):
            return shown
    return tuple(f"{value:.2f}" for value in values)


def _repaired(d: Diagnosis) -> str:
    if not d.repair:
        return "No correction of the modules mends it."
    together = " together" if len(d.repair) > 1 else ""
    return f"It takes {' and '.join(ORACLE_WORDS[name] for name in d.repair)}{together}."


def _others(d: Diagnosis) -> str:
    """Other oracles mending the answer alone."""
    others = [name for name in d.mends if name not in d.repair]
    if not others:
        return ""
    words = " or ".join(ORACLE_WORDS[name] for name in others)
    return f"{words[0].upper()}{words[1:]} alone would do too."


def _p(value: float | None) -> str:
    return "–" if value is None else f"{value:.2f}"


def unexplained(detail: str | None, target: str, answered: bool = True) -> str:
    """Verdict UNEXPLAINED in words: known facts, and data that would tell more.

    `detail`: ANSWER, PROPOSALS, BOXES: what the file gives; or NOT-SEPARABLE; `target`: the name that was asked for;
    `answered`: there is an answer.
    """
    wrong = "Wrong" if answered else "Not answered"
    proposed = f"{wrong}, and the right {target} was proposed"
    return {
        "ANSWER": f"{wrong}. The file gives no more than the answer; with its proposals (level 1) it could be said "
        "whether the right thing was seen at all.",
        "PROPOSALS": f"{proposed}. With 3D boxes (level 2), relation probabilities "
        "(level 3) and an answer that is one of the proposals it could be said why it lost.",
        "BOXES": f"{proposed}, where it is. With relation probabilities (level 3) and "
        "an answer that is one of the proposals it could be said whether these or the ranking are to blame.",
    }.get(
        detail or "",
        "Wrong, and not separable: what a pair would have scored with a true module does not follow from the scores of "
        "the file. The probabilities that the ranking went by would tell.",
    )
