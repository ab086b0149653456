"""Suggested questions of a frame: names of present objects, and questions with an answer."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pipeline.answering.answer_words import best_pair
from pipeline.answering.objects import PreparedFrame, SceneObject, all_objects
from pipeline.answering.pipeline import Pipeline
from pipeline.answering.suggestions import SURE, suggest_expressions
from pipeline.labels.cases import Case, FrameCases
from pipeline.language.naming import match
from pipeline.proposals.annotations import AnnotationDetector
from pipeline.system.errors import InputError


@dataclass(frozen=True)
class SuggestedQuestions:
    """Names and questions suggested for a frame."""

    names: tuple[str, ...] = ()
    # At most so many as were wanted; none where up is only assumed, unless they are labelled
    questions: tuple[str, ...] = ()
    # Who says that they are there: "the labels", "the annotations", "the file of predictions", "detections of at least
    # 0.50"
    by: str = ""

    @property
    def words(self) -> str:
        """Names, and their source."""
        return f"In this frame by {self.by}: {', '.join(self.names)}" if self.names else ""


def suggest_questions(
    source: Pipeline,
    context: PreparedFrame,
    objects: Sequence[SceneObject],
    truth: FrameCases | None = None,
    count: int = 3,
) -> SuggestedQuestions:
    """Suggest questions about a frame, by its labels, its annotations, an imported file, or sure detections.

    Parameters
    ----------
    source : Pipeline
        What will answer.
    objects : sequence of SceneObject
        All that its detector finds in the frame.
    truth : FrameCases, optional
        The labels of the frame.
    count : int
        Questions, at most.
    """
    if source.predictions is not None:
        lines = source.predictions.of_frame(context.frame.id)
        names = {name for line in lines for name in line.proposals or {}}
        return SuggestedQuestions(
            tuple(sorted(names)), tuple(line.text for line in lines[:count]), "the file of predictions"
        )
    if truth is not None and truth.cases:
        return SuggestedQuestions(tuple(sorted(set(truth.labels))), _labelled(source, truth.cases, count), "the labels")
    by = "the annotations"
    if context.frame.annotations:
        objects = all_objects(context, AnnotationDetector())
    else:
        objects, by = [o for o in objects if o.score >= SURE], f"detections of at least {SURE:.2f}"
    scores = source.score(context, objects) if objects else None
    questions = () if scores is None else suggest_expressions(objects, scores, context.viewer, count)
    return SuggestedQuestions(tuple(sorted({o.label for o in objects})), questions, by)


def _labelled(source: Pipeline, cases: Sequence[Case], count: int) -> tuple[str, ...]:
    """Clear-cut expressions of the labels about different objects, of names known to the detector."""
    known = None if source.detector is None else source.detector.vocabulary
    fit = [c for c in cases if known is None or all(match(n, known, source.synonyms) for n in (c.target, c.reference))]
    chosen: list[Case] = []
    used: Counter[str] = Counter()
    while fit and len(chosen) < count:
        # Of those about other things the shortest: it is read at a glance.
        worn = [used[c.target] + used[c.reference] + used[c.relation] + c.ambiguous + len(c.text) / 200 for c in fit]
        best = fit.pop(int(np.argmin(worn)))
        used.update((best.target, best.reference, best.relation))
        chosen.append(best)
    return tuple(c.text for c in chosen)


def first_answered(source: Pipeline, context: PreparedFrame, questions: Sequence[str]) -> str:
    """First question with an answer; empty for none."""
    for text in questions:
        try:
            trace = source.ask(context, text)
        except InputError:
            continue
        if best_pair(trace) is not None or trace.answered is not None:
            return text
    return ""
