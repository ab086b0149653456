"""Suggestions for a frame: clear-cut questions by labels, annotations or detections, completions, and help for a name
that is not found."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence

import numpy as np

from pipeline.answering.answer_words import best_pair
from pipeline.answering.ask import Trace
from pipeline.answering.detector_prompts import name_for
from pipeline.answering.objects import PreparedFrame, SceneObject, all_objects
from pipeline.answering.pipeline import Pipeline
from pipeline.geometry.viewer import ViewerAxes
from pipeline.labels.cases import Case, FrameCases
from pipeline.language.expression import parse
from pipeline.language.naming import match, normal_form
from pipeline.language.noun_phrase import alone, readable
from pipeline.language.relation_names import DIRECTIONAL, PHRASE
from pipeline.proposals import Segmented
from pipeline.proposals.annotations import AnnotationDetector
from pipeline.relations.scorer import RelationScores
from pipeline.system.errors import InputError
from pipeline.system.frozen import dataclass


def suggest_expressions(
    objects: Sequence[SceneObject], scores: RelationScores, viewer: ViewerAxes, count: int = 3
) -> tuple[str, ...]:
    """Suggest up to `count` expressions with exactly one right answer in the frame; none with up only assumed.

    Those whose target's class stands in the frame several times come first:
    there the relation decides. No class and no relation is repeated while there are others.
    """
    if not objects or viewer.up_source == "assumed":
        return ()
    labels = [o.label for o in objects]
    number, single = Counter(labels), alone(labels)
    like = np.array([[a == b for b in labels] for a in labels], np.int64)
    pixels = [o.lifted.quality.mask_pixels for o in objects]
    found: list[tuple[float, str, str, str]] = []
    for n, relation in enumerate(scores.relations):
        states, likely = scores.states[..., n], scores.probabilities[..., n] >= 0.5
        # The rule and the scorer must agree on the one that is right, and on all of its like that are not.
        sure = (states == 1) & likely & (like @ ((states >= 0) | likely) == 1) & single
        for i, j in np.argwhere(sure).tolist() if relation in DIRECTIONAL else ():
            least = min(p for p, label in zip(pixels, labels, strict=True) if label in (labels[i], labels[j]))
            found.append((min(number[labels[i]], 3) + min(least, 3000) / 3000, labels[i], relation, labels[j]))
    chosen: list[str] = []
    used: Counter[str] = Counter()
    while found and len(chosen) < count:
        best = max(found, key=lambda f: (f[0] - 1.5 * (used[f[1]] + used[f[2]]) - 0.7 * used[f[3]], f[1:]))
        found.remove(best)
        _, target, relation, reference = best
        text = _worded(target, relation, reference, tuple(number))
        if text is None:
            continue
        used.update((target, relation, reference))
        chosen.append(text)
    return tuple(chosen)


def _worded(target: str, relation: str, reference: str, class_names: tuple[str, ...]) -> str | None:
    """Expression in words (`potted plant` for `potted_plant`), else with names as spelled; None for a misread.

    Class names may hold anything.
    """
    for a, b in ((readable(target, brief=False), readable(reference, brief=False)), (target, reference)):
        text = f"{a} {PHRASE[relation]} the {b}"
        try:
            read = parse(text, class_names=class_names).expression
        except InputError:
            continue
        if read is None:
            continue
        meant = normal_form(target), normal_form(reference)
        if (normal_form(read.target), normal_form(read.reference or "")) == meant:
            return text
    return None


OFFERED = 8
SURE = 0.5
"""A detection of a lower score may be of nothing, and is not offered."""


def completions(
    typed: str, labels: Iterable[str], examples: Sequence[str] = (), asked: Sequence[str] = ()
) -> list[dict[str, str]]:
    """Completions of a typed expression, the best first, at most `OFFERED`.

    Parameters
    ----------
    labels : iterable of str
        Names of the frame's objects.
    examples, asked : sequence of str
        Whole expressions that fit the frame, and that were asked before.

    Returns
    -------
    list of dict
        {"text", "kind", "detail"}: a "question" stands for all that is typed, a "name" or a "relation" ends it.
    """
    text, sources = typed.lower(), (("asked before", asked), ("example", examples))
    found = [{"text": t, "kind": "question", "detail": detail} for detail, whole in sources for t in whole]
    if text.strip():
        found = [o for o in found if o["text"].lower().startswith(text) and o["text"].lower() != text]
        names = sorted(set(labels), key=lambda n: (len(n), n))
        # A relation follows a name, else a name does.
        due = "relation" if any(text.rstrip().endswith(name.lower()) for name in names) else "name"
        for kind, detail, words in (("name", "in this frame", names), ("relation", "relation", PHRASE.values())):
            fitting = (w for w in words if _begins(text, w.lower()) or (text.endswith(" ") and kind == due))
            found += [{"text": word, "kind": kind, "detail": detail} for word in fitting]
    once: dict[str, dict[str, str]] = {}
    for offer in found:
        once.setdefault(offer["text"].strip().lower(), offer)
    return list(once.values())[:OFFERED]


def _begins(text: str, word: str) -> bool:
    """True where the end of a text, from the beginning of a word, begins this word."""
    starts = (k for k in range(max(0, len(text) - len(word) + 1), len(text)) if k == 0 or text[k - 1] == " ")
    return any(word.startswith(text[k:]) for k in starts)


@dataclass(frozen=True)
class MissedNames:
    """Help for names not found."""

    below: dict[str, float]  # Names that were not found, with the best score below the detector's minimum
    # What the detector finds in the frame, with a score of at least SURE, where it is asked for all that it knows, the
    # commonest first; empty for one that knows any name
    seen: dict[str, int]


def missed_names(pipeline: Pipeline, trace: Trace) -> MissedNames:
    """Find missed names below the detector's minimum score, and other seen objects.

    The detector runs again on the frame, once for each missing name and once for everything.

    Raises
    ------
    InputError
        The detector cannot be asked again.
    """
    detector, below = pipeline.needed_detector(), {}
    if isinstance(detector, Segmented):
        # Counting needs no masks.
        detector = detector.detector
    missing = {n.label: n for n in trace.query.nodes if n.label in trace.missing}
    for label, node in missing.items() if not detector.exact else ():
        name = name_for(node, detector, pipeline.synonyms)
        scores = pipeline.unfiltered_detector().detect(trace.frame, None if name is None else [name]).scores
        if len(scores):
            below[label] = float(scores.max())
    try:
        found = None if detector.vocabulary is None else detector.detect(trace.frame, None)
    except InputError:
        # Not every detector of a vocabulary can be asked for all of it.
        found = None
    labels = [] if found is None else [found.label(i) for i in np.flatnonzero(found.scores >= SURE).tolist()]
    return MissedNames(below, dict(Counter(labels).most_common()))


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
    pipeline: Pipeline,
    context: PreparedFrame,
    objects: Sequence[SceneObject],
    truth: FrameCases | None = None,
    count: int = 3,
) -> SuggestedQuestions:
    """Suggest questions about a frame, by its labels, its annotations, an imported file, or sure detections.

    Parameters
    ----------
    pipeline : Pipeline
        What will answer.
    objects : sequence of SceneObject
        All that its detector finds in the frame.
    truth : FrameCases, optional
        The labels of the frame.
    count : int
        Questions, at most.
    """
    if pipeline.predictions is not None:
        lines = pipeline.predictions.of_frame(context.frame.id)
        names = {name for line in lines for name in line.proposals or {}}
        return SuggestedQuestions(
            tuple(sorted(names)), tuple(line.text for line in lines[:count]), "the file of predictions"
        )
    if truth is not None and truth.cases:
        return SuggestedQuestions(
            tuple(sorted(set(truth.labels))), _labelled(pipeline, truth.cases, count), "the labels"
        )
    by = "the annotations"
    if context.frame.annotations:
        objects = all_objects(context, AnnotationDetector())
    else:
        objects, by = [o for o in objects if o.score >= SURE], f"detections of at least {SURE:.2f}"
    scores = pipeline.score(context, objects) if objects else None
    questions = () if scores is None else suggest_expressions(objects, scores, context.viewer, count)
    return SuggestedQuestions(tuple(sorted({o.label for o in objects})), questions, by)


def _labelled(pipeline: Pipeline, cases: Sequence[Case], count: int) -> tuple[str, ...]:
    """Clear-cut expressions of the labels about different objects, of names known to the detector."""
    known = None if pipeline.detector is None else pipeline.detector.vocabulary
    fit = [
        c for c in cases if known is None or all(match(n, known, pipeline.synonyms) for n in (c.target, c.reference))
    ]
    chosen: list[Case] = []
    used: Counter[str] = Counter()
    while fit and len(chosen) < count:
        # Of those about other things the shortest: it is read at a glance.
        worn = [used[c.target] + used[c.reference] + used[c.relation] + c.ambiguous + len(c.text) / 200 for c in fit]
        best = fit.pop(int(np.argmin(worn)))
        used.update((best.target, best.reference, best.relation))
        chosen.append(best)
    return tuple(c.text for c in chosen)


def first_answered(pipeline: Pipeline, context: PreparedFrame, questions: Sequence[str]) -> str:
    """First question with an answer; empty for none."""
    for text in questions:
        try:
            trace = pipeline.ask(context, text)
        except InputError:
            continue
        if best_pair(trace) is not None or trace.answered is not None:
            return text
    return ""
