"""Auditing the questions of RoboSpatial-Home: each answer against its mask, its like, the geometry, and systems."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from hashlib import sha256

import numpy as np

from pipeline.answering.answer_words import best_pair
from pipeline.answering.pipeline import Pipeline
from pipeline.audit.sentences import HOLDS, OWN_SIDES, has_front
from pipeline.audit.suspicion import AuditItem, Evidence, agreement_weight
from pipeline.datasets.files import read_bytes
from pipeline.evaluation.robospatial import Question, QuestionAnswers, drawn, points_of, published_right
from pipeline.language.expression import parse
from pipeline.language.naming import normal_form
from pipeline.language.relation_names import HORIZONTAL, INVERSE, MIRRORED
from pipeline.system.errors import InputError

UNUSABLE = 0.95
"""An answer that the published metric can never count as right."""
OUTSIDE, APART, SAME_REGION = 0.1, 0.8, 0.5
"""The share of an answer's points that may lie outside its mask; the weight where all do; the least IoU of the polygon
that is scored with the mask that was drawn."""
ONE_OF_TWO = 0.5
DETECTED = 0.6
"""Where detected objects say otherwise: detectors err, too."""
SURE, UNSURE_OF_FRAME = 0.9, 0.07
SAME_PLACE = 0.1
"""Points of systems that differ by less of the picture's size are one answer."""
Statement = tuple[str, str, str]


def audit_questions(
    questions: Sequence[Question],
    systems: Sequence[QuestionAnswers] = (),
    source: Pipeline | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> Iterator[AuditItem]:
    """Audit every question in order; `progress` is told (done, in all).

    `source`: the benchmark's frames with a detector, for the geometry of yes/no questions; without it that is left out.

    Raises InputError: a picture or mask cannot be read.
    """
    against = _contradictions(questions)
    for number, question in enumerate(questions, start=1):
        item = AuditItem(question.id, question.frame, question.text, question.answer, None, tuple(against[question.id]))
        if question.yes is None:
            found = _of_region(question)
        else:
            found, why = _of_geometry(question, source)
            item = replace(item, unjudged=why)
        yield replace(item, evidence=(*item.evidence, *found, *_of_systems(question, systems)))
        if progress is not None:
            progress(number, len(questions))


def _statement(question: Question) -> Statement | None:
    try:
        e = parse(question.text).expression
    except InputError:
        return None
    plain = e is not None and question.yes is not None and question.category == "configuration" and not e.inverse
    return (normal_form(e.target), e.relation, normal_form(e.reference)) if plain and e is not None else None


def _contradictions(questions: Sequence[Question]) -> dict[str, list[Evidence]]:
    found: dict[str, list[Evidence]] = {q.id: [] for q in questions}
    told: dict[tuple[str, Statement], tuple[Question, bool]] = {}
    for question in questions:
        statement = _statement(question)
        if statement is None or question.yes is None:
            continue
        picture = sha256(read_bytes(question.picture)).hexdigest()
        for same, truth in _implied(statement, question.yes):
            other = told.setdefault((picture, same), (question, truth))
            if other[1] != truth:
                for one, rival in ((question, other[0]), (other[0], question)):
                    text = f"{rival.id} of the same picture says {rival.answer} to “{rival.text}”"
                    piece = Evidence("contradiction", ONE_OF_TWO, text)
                    # Both say it again of the mirrored statement.
                    found[one.id] += [piece] if piece not in found[one.id] else []
    return found


def _implied(statement: Statement, yes: bool) -> Iterator[tuple[Statement, bool]]:
    a, relation, b = statement
    yield statement, yes
    if relation in MIRRORED:
        yield (b, MIRRORED[relation], a), yes
    if yes and relation in INVERSE and INVERSE[relation] != relation:
        yield (a, INVERSE[relation], b), False
        yield (b, relation, a), False


def _of_region(question: Question) -> list[Evidence]:
    polygon, region = question.polygon, question.region()
    if not len(polygon):
        return [Evidence("region", UNUSABLE, "the answer is neither yes, no, nor three points")]
    if region is None:
        return []
    size = np.array(region.shape[::-1]) - 1
    column, row = np.clip(np.round(polygon * size), 0, size).astype(int).T
    outside = float((~region[row, column]).mean())
    scored = drawn(polygon, (region.shape[0], region.shape[1]))
    iou = float((scored & region).sum() / max((scored | region).sum(), 1))
    figures = (("outside", outside), ("iou", iou))
    if outside > OUTSIDE:
        text = f"{outside:.0%} of the answer's points lie outside its mask (IoU of the two {iou:.2f})"
        return [Evidence("region", APART * outside + 0.1, text, figures)]
    if iou < SAME_REGION:
        text = f"the polygon that is scored overlaps the mask by an IoU of {iou:.2f}: right points count as wrong"
        return [Evidence("region", 0.1 + APART * (SAME_REGION - iou), text, figures)]
    return [Evidence("region", HOLDS, f"the points lie in the mask (IoU {iou:.2f})", figures)]


def _of_geometry(question: Question, source: Pipeline | None) -> tuple[list[Evidence], str | None]:
    statement = _statement(question)
    if statement is None:
        return [], "it is not whether one thing stands in a relation to another"
    sided = statement[1] in HORIZONTAL and has_front(statement[2])
    doubt = f"it does not say whether the viewer's or the {statement[2]}'s own {statement[1]} is meant"
    unsure = [Evidence("frame", UNSURE_OF_FRAME, doubt)] if sided else []
    if source is None or question.frame not in source.dataset.frame_ids:
        return unsure, "no detector looked at the picture (--detector)"
    try:
        best = best_pair(source.ask(source.prepare(question.frame), question.text))
    except InputError as error:
        return unsure, str(error)
    if best is None:
        return unsure, "the two things were not found"
    p = best.p_relation
    if (p >= SURE) == question.yes:
        return [Evidence("geometry", HOLDS, f"detected objects agree: the relation has {p:.2f}", (("p", p),))], None
    if 1 - SURE < p < SURE:
        return unsure, None
    text = f"detected objects say {'yes' if p >= SURE else 'no'}: the relation has {p:.2f}"
    return [
        Evidence("frame", OWN_SIDES, f"{text}; {doubt}", (("p", p),))
        if sided
        else Evidence("geometry", DETECTED, text, (("p", p),))
    ], None


def _of_systems(question: Question, systems: Sequence[QuestionAnswers]) -> list[Evidence]:
    texts = [(s.name, s.texts[question.id]) for s in systems if question.id in s.texts]
    if not texts:
        return []
    wrong = [(name, text) for name, text in texts if not published_right(question, text)]
    if question.yes is None:
        places = np.array([points[0] for _, text in wrong if (points := points_of(text))]).reshape(-1, 2)
        near = np.linalg.norm(places[:, None] - places[None], axis=2) < SAME_PLACE
        against = int(near.sum(axis=1).max(initial=0))
    else:
        opposite = "no" if question.yes else "yes"
        against = sum(published_right(replace(question, answer=opposite), text) for _, text in wrong)
    agreeing = len(texts) - len(wrong)
    text = f"{against} of {len(texts)} systems give the same other answer ({', '.join(n for n, _ in wrong) or 'none'})"
    figures = (("systems", float(len(texts))), ("against", float(against)), ("agreeing", float(agreeing)))
    return [Evidence("systems", agreement_weight(against, agreeing), text, figures)]
