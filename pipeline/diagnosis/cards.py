"""Cards of an answer: what was answered and what it should be, thing by thing, for a glance."""

from __future__ import annotations

from collections.abc import Callable
from typing import Literal, TypeAlias

import numpy as np

from pipeline.answering.ask import Trace
from pipeline.answering.pair_table import ScoredPair
from pipeline.diagnosis.answer import Judged
from pipeline.diagnosis.story import really
from pipeline.diagnosis.story_words import words
from pipeline.diagnosis.verdict import Diagnosis, Missed
from pipeline.labels.cases import HIT
from pipeline.system.frozen import dataclass

End: TypeAlias = Literal["target", "reference"]


@dataclass(frozen=True)
class CardObject:
    """Thing on a card."""

    role: End
    name: str  # Of a detection with its number
    note: str  # What it really is, or how it was seen; may be empty
    bbox: np.ndarray  # (4,) float64: x0, y0, x1, y1, pixels
    index: int | None  # Among the trace's objects; None for a labelled thing that was not detected


@dataclass(frozen=True)
class Card:
    """Target and reference of one pair, under a title."""

    kind: Literal["answer", "right", "label"]
    objects: tuple[CardObject, ...]

    @property
    def title(self) -> str:
        """Title in words."""
        return words("cards", self.kind)


def cards_of(
    trace: Trace | None, judged: Judged, pair: ScoredPair | None, name: Callable[[int], str]
) -> tuple[Card, ...]:
    """Cards of a pair of an answer: the answer, and beside it what is right where that is another one.

    `pair`: the one that is looked at, None without an answer; `name`: of an object by its place in the trace. A right
    answer has one card, a refused question only the right one. The labelled pair stands in where no detection is right;
    of an answer that is right beside its label, the label's own.
    """
    d = judged if isinstance(judged, Diagnosis) else None
    found: list[Card] = []
    if trace is not None and pair is not None:
        things = [_answered(trace, d, "target", pair.target, pair.p_target, name)]
        if pair.reference is not None:
            things.append(_answered(trace, d, "reference", pair.reference, pair.p_reference, name))
        found.append(Card("answer", tuple(things)))
    if d is None or (d.correct and not d.lucky):
        return tuple(found)
    kind, case = "label" if d.verdict == "LABEL" else "right", d.case
    right = d.right if d.gold and kind == "right" else None
    answer = d.winner if d.gold and kind == "right" else None
    match, missed = d.evidence.match, d.missed is not None and d.verdict
    seen = right and (right.target, right.p_target)
    # What was answered rightly is what it should be, too.
    if answer is not None and match[answer.target] in case.acceptable:
        seen = answer.target, answer.p_target
    things = [_right(d, "target", case.target, case.target_object, seen, missed == "OPM-TARGET", name)]
    if case.reference:
        seen = right and (right.reference, right.p_reference)
        if answer is not None and answer.reference is not None and match[answer.reference] == case.reference_object:
            seen = answer.reference, answer.p_reference
        lost = missed == "OPM-REF"
        things.append(_right(d, "reference", case.reference, case.reference_object, seen, lost, name))
    return (*found, Card(kind, tuple(things)))


def _answered(
    trace: Trace,
    d: Diagnosis | None,
    role: End,
    index: int,
    score: float,
    name: Callable[[int], str],
) -> CardObject:
    note = "" if score >= 1 else words("cards", "scored", score=f"{score:.2f}")
    if d is not None and d.gold and index < d.evidence.detections:
        case = d.case
        example, label = (
            (case.target_object, case.target) if role == "target" else (case.reference_object, case.reference)
        )
        alike = label and (d.evidence.overlap[index][d.truth.alike[example]] >= HIT).any()
        if label and not alike:
            note = words("cards", "really", really=really(d, index, example))
    return CardObject(role, name(index), note, np.asarray(trace.objects[index].bbox, np.float64), index)


def _right(
    d: Diagnosis,
    role: End,
    label: str,
    example: int,
    seen: tuple[int | None, float] | None,
    lost: bool,
    name: Callable[[int], str],
) -> CardObject:
    """Right thing of a role: as it was detected, else, or where it is the one that was `lost`, as it is labelled."""
    box, missed = d.truth.boxes[example], d.missed if lost else None
    index, score = (None, None) if seen is None or lost else seen
    if index is None and d.gold and not lost:
        # It may have been seen without being in a pair that could win.
        here = np.flatnonzero(d.evidence.match == example)
        named = d.evidence.answers.candidates.get(label)
        both = [] if named is None else [int(k) for k in np.flatnonzero(np.isin(named.index, here))]
        if both and named is not None:
            best = max(both, key=lambda k: named.scores[k])
            index, score = int(named.index[best]), float(named.scores[best])
    if index is not None and index < d.evidence.detections:
        note = "" if score is None or score >= 1 else words("cards", "scored", score=f"{score:.2f}")
        return CardObject(role, name(index), note, np.asarray(d.evidence.answers.boxes[index], np.float64), index)
    note = words("cards", "labelled") if missed is None else _unseen(missed)
    return CardObject(role, label, note, np.asarray(box, np.float64), None)


def _unseen(missed: Missed) -> str:
    kind = "suppressed" if missed.suppressed else missed.kind.lower()
    return words("cards", kind, score="" if missed.score is None else f"{missed.score:.2f}")
