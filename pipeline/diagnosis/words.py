"""A verdict in one or two plain sentences."""

from __future__ import annotations

from collections.abc import Collection

from pipeline.diagnosis.repair import needed_changes
from pipeline.diagnosis.verdict import Diagnosis
from pipeline.evaluation.cases import Case
from pipeline.expression import Query
from pipeline.pair_table import RankConfig, ScoredPair
from pipeline.relations import PHRASE

_MODULE_WORDS = {
    "RECALL": "the missing objects", "LIFT": "true geometry", "SRM": "true relations", "CONF": "true confidences",
}  # fmt: skip


def explain(
    diagnosis: Diagnosis,
    case: Case,
    config: RankConfig,
    *,
    query: Query | None = None,
    problem: str | None = None,
    unknown: Collection[str] = (),
) -> str:
    """Why the answer is what it is, and the smallest change that would mend it.

    Parameters
    ----------
    diagnosis : Diagnosis
    case : Case
    config : RankConfig
    query : Query, optional
        What the parser read.
    problem : str, optional
        Why it could not be read, or could not be asked.
    unknown : collection of str
        Names that the detector does not know.
    """
    if diagnosis.verdict == "CORRECT":
        return _correct(diagnosis, case)
    if diagnosis.verdict == "PARSE":
        return _parse(case, query, problem)
    if diagnosis.verdict == "LABEL":
        return _label(diagnosis, case)
    if diagnosis.verdict in ("OPM-TARGET", "OPM-REF"):
        return _missed(diagnosis, unknown)
    return f"{_flipped(diagnosis, case)} {_smallest_change(diagnosis, config)}".strip()


def _correct(d: Diagnosis, case: Case) -> str:
    if not d.lucky:
        return "Right." if d.winner is None else f"Right: relation {_p(d.winner.p_relation)}."
    if d.winner is None:
        return f"The right {case.target}, but alone: all candidates of the two names count as one thing. Luck."
    return f"The right {case.target}, but its {case.reference} matches none of which the expression is true: luck."


def _parse(case: Case, query: Query | None, problem: str | None) -> str:
    meant = f"meant was ({case.target}, {PHRASE[case.relation]}, {case.reference})"
    if query is None:
        return f"The expression cannot be read: {problem}; {meant}."
    e = query.expression
    if len(query.readings) > 1:
        return f"The expression has {len(query.readings)} readings; {meant}."
    return f"Read as ({e.target}, {PHRASE.get(e.relation, e.relation)}, {e.reference}); {meant}."


def _label(d: Diagnosis, case: Case) -> str:
    if d.detail == "AMBIGUOUS":
        return (
            f"The answer is another {case.target} of which the expression is, or may be, true; "
            f"it has {len(case.acceptable)} right answers, and the label names one."
        )
    what = "its box" if d.detail == "BAD_BOX" else "what it says"
    return f"A person marked this label as wrong in {what}; the answer may well be right."


def _missed(d: Diagnosis, unknown: Collection[str]) -> str:
    missed, name = d.missed, d.missed_name
    assert missed is not None
    after = f" {_repaired(d)}" if d.repair and d.repair != ("RECALL",) else ""
    if name in unknown:
        return f"The detector does not know the name “{name}”.{after}"
    if missed.kind == "RANK":
        if missed.suppressed:
            return f"A better-scored box lies over the right {name} ({_p(missed.score)}) and suppressed it.{after}"
        return f"The right {name} has {_p(missed.score)}, place {missed.rank} by score: K cuts it off.{after}"
    if missed.kind == "THRESHOLD":
        return f"The detector gave the right {name} {_p(missed.score)}, below the minimum score.{after}"
    if missed.kind == "LOCALISATION":
        score = "" if missed.score is None else f" (score {_p(missed.score)})"
        return f"The best box of the right {name} overlaps it by {_p(missed.overlap)}{score}; .50 is asked.{after}"
    return f"The detector did not see the right {name} at all (best overlap {_p(missed.overlap)}).{after}"


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
    relation = PHRASE[case.relation]
    if d.verdict == "LIFT":
        boxed = " (of some objects the label's box)" if d.pseudo else ""
        return (
            f"A 3D box is off: for “{relation}” the right pair had {_p(right.p_relation)} and the answer "
            f"{_p(winner.p_relation)}. With true geometry{boxed} the right pair wins. Verdict: LIFT."
        )
    if d.verdict == "SRM":
        return (
            f"For “{relation}” the answer had {_p(winner.p_relation)} and the right pair "
            f"{_p(right.p_relation)}. With the labelled relations the right pair wins. Verdict: SRM."
        )
    if d.verdict in ("OPM-CONF", "PRM") and d.detail != "DEGENERATE":
        return _confidences(d, winner, right, case)
    if d.verdict == "COMPOUND":
        return f"No module alone is to blame. {_repaired(d)}"
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
        return (
            f"The answer's {' and '.join(false)} {what}; the right pair had {_p(right.p_target)} and "
            f"{_p(right.p_reference)}. With true confidences the right pair wins. Verdict: OPM-CONF."
        )
    parts = [
        f"the wrong {name} {_p(ours)} and the right one {_p(theirs)}"
        for name, mine, other, ours, theirs in (
            (case.target, winner.target, right.target, winner.p_target, right.p_target),
            (case.reference, winner.reference, right.reference, winner.p_reference, right.p_reference),
        )
        if mine != other
    ]
    favoured = "the right pair" if right.p_relation >= winner.p_relation else "the answer"
    first, second = sorted((winner.p_relation, right.p_relation), reverse=True)
    return (
        f"The detector gave {' and '.join(parts)}; the relation favoured {favoured} {_p(first)} to {_p(second)}. "
        "With equal confidences the answer is right. Verdict: PRM."
    )


def _repaired(d: Diagnosis) -> str:
    if not d.repair:
        return "No correction of the modules mends it."
    together = " together" if len(d.repair) > 1 else ""
    return f"It takes {' and '.join(_MODULE_WORDS[name] for name in d.repair)}{together}."


def _smallest_change(d: Diagnosis, config: RankConfig) -> str:
    for change in needed_changes(d, config):
        if change.right_above is not None:
            name = {"relation": "relation", "target": "target score", "reference": "reference score"}[change.factor]
            digits = 2 if change.right_above - change.right >= 0.01 else 4
            above, now = f"{change.right_above:.{digits}f}", f"{change.right:.{digits}f}"
            return f"Smallest change: its {name} above {above} instead of {now}."
    return ""


def _p(value: float | None) -> str:
    return "–" if value is None else f"{value:.2f}"
