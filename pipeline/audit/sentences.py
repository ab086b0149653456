"""Auditing sentences that come with what is right: against the geometry of the annotated frame, and against systems."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence

import numpy as np

from pipeline.answering.ask import Trace
from pipeline.answering.objects import PreparedFrame
from pipeline.answering.pipeline import Pipeline
from pipeline.audit.geometry import Fit, by_own_sides, fit_of_triple, geometry_evidence, has_front
from pipeline.audit.suspicion import PRIOR, AuditItem, Evidence, SystemAnswers, system_evidence
from pipeline.diagnosis.asking import annotated_truth
from pipeline.diagnosis.sentence_truth import sentence_case
from pipeline.evaluation.sentence_files import Sentence, SentenceFile
from pipeline.labels.cases import FrameCases
from pipeline.labels.check.expressions import says_the
from pipeline.language.naming import match
from pipeline.language.relation_names import HORIZONTAL
from pipeline.relations.pair_measures import F, T, U
from pipeline.system.errors import InputError

OTHER_CLASS = 0.9
"""The weight of an annotation whose name is not what the sentence asks for."""
NOTHING_RIGHT = 0.6
"""The weight where nothing is said to be right, and something is."""


def audit_sentences(
    source: Pipeline,
    asked: SentenceFile,
    systems: Sequence[SystemAnswers] = (),
    progress: Callable[[int, int], None] | None = None,
) -> Iterator[AuditItem]:
    """Audit every sentence in the order of frames; `progress` is told (done, in all).

    `source`: the dataset with its own annotations as the detector.
    """
    by_frame: dict[str, list[Sentence]] = {}
    for sentence in asked.sentences:
        by_frame.setdefault(sentence.frame, []).append(sentence)
    done = 0
    for frame, sentences in by_frame.items():
        try:
            context = source.prepare(frame)
            truth: FrameCases | str | None = annotated_truth(context, source)
        except InputError as error:
            context, truth = None, str(error)
        for sentence in sentences:
            yield audited(sentence, source, context, truth, systems)
            done += 1
            if progress is not None:
                progress(done, len(asked.sentences))


def audited(
    sentence: Sentence,
    source: Pipeline,
    context: PreparedFrame | None,
    known: FrameCases | str | None,
    systems: Sequence[SystemAnswers] = (),
) -> AuditItem:
    """Audit one sentence; `known` are the frame's annotations, or the reason for their absence."""
    truth = known if isinstance(known, FrameCases) else None
    names = [] if truth is None else object_names(truth)
    right = np.zeros(0, np.int64) if truth is None else sentence.among(truth)
    said = ", ".join(names[k] for k in right) or ("nothing" if sentence.nothing else _places(sentence))
    evidence: list[Evidence] = []
    seems = unjudged = None
    if truth is None or context is None:
        unjudged = known if isinstance(known, str) else "the frame has no annotations"
    elif not len(right) and not sentence.nothing:
        unjudged = "no annotated object is what is right"
    else:
        try:
            evidence, seems = _geometry(sentence, source, context, truth, right, names)
        except InputError as error:
            unjudged = str(error)
    boxes = np.array(sentence.boxes or (), np.float64).reshape(-1, 4) if truth is None else truth.boxes[right]
    if len(boxes) and systems:
        labelled = [] if truth is None else list(zip(names, truth.boxes, strict=True))
        told = system_evidence(systems, (sentence.frame, sentence.text), boxes, labelled)
        if told is not None:
            evidence.append(told[0])
            seems = seems or told[1]
    item_id = sentence.id or str(sentence.line)
    return AuditItem(item_id, sentence.frame, sentence.text, said, seems, tuple(evidence), unjudged)


def object_names(truth: FrameCases) -> list[str]:
    """Names of annotated objects in tables: "mug·4"."""
    return [f"{label}·{number}" for label, number in zip(truth.labels, truth.numbers, strict=True)]


def _places(sentence: Sentence) -> str:
    given = ((name, getattr(sentence, name)) for name in ("targets", "points", "boxes"))
    return "; ".join(f"{name} {list(value)}" for name, value in given if value)


def _geometry(
    sentence: Sentence, source: Pipeline, context: PreparedFrame, truth: FrameCases, right: np.ndarray, names: list[str]
) -> tuple[list[Evidence], str | None]:
    trace = source.ask(context, sentence.text)
    root, top = trace.root, trace.root.pairwise
    targets = of_name(truth, root.name, source) if not root.anything else np.ones(len(truth.labels), np.bool_)
    reference = top.nodes[0].name if top is not None and top.nodes else ""
    sided = top is not None and top.relation in HORIZONTAL and has_front(reference)
    own = {way: _fit(trace, source, context, one, targets) for way, one in by_own_sides(truth).items()} if sided else {}
    fit = _fit(trace, source, context, truth, targets)
    sure = np.flatnonzero(fit.states == T)
    if sentence.nothing:
        text = f"nothing is said to be right, and it holds of {', '.join(names[k] for k in sure)}"
        return ([Evidence("geometry", NOTHING_RIGHT, text)] if len(sure) else []), _listed(sure, names)
    strange = right[~targets[right]]
    if len(strange):
        text = f"the sentence asks for a {root.name}, and what is right is annotated as {names[int(strange[0])]}"
        return [Evidence("class", OTHER_CLASS, text)], _listed(sure, names)
    words = (root.name, trace.relation if trace.query.default.root.triple is not None else "", reference)
    definite = says_the(sentence.text, [root.label])[0]
    evidence = geometry_evidence(fit, right, own, definite, words, names)
    wrong = any(e.kind in ("geometry", "several") and e.weight > PRIOR for e in evidence)
    return evidence, _listed(sure, names) if wrong else None


def _listed(chosen: np.ndarray, names: list[str]) -> str | None:
    return ", ".join(names[int(k)] for k in chosen) or None


def of_name(truth: FrameCases, name: str, source: Pipeline) -> np.ndarray:
    """(N,) bool: annotated things with this name."""
    known = tuple(dict.fromkeys([*truth.labels, *source.dataset.class_names]))
    return np.isin(truth.labels, match(name, known, source.synonyms))


def _fit(trace: Trace, source: Pipeline, context: PreparedFrame, truth: FrameCases, targets: np.ndarray) -> Fit:
    e = trace.query.expression
    plain = len(trace.query.readings) == 1 and trace.query.default.root.triple is not None
    if e is not None and plain and not e.second_reference and not e.inverse and e.relation in truth.states:
        return fit_of_triple(truth, targets, e.relation, of_name(truth, e.reference, source))
    case = sentence_case(truth, trace, source, context)
    states = np.full(len(targets), F, np.int8)
    if not isinstance(case, str):
        states[case.acceptable] = U
        states[case.strict] = T
    elif "true of nothing" not in case:
        raise InputError(case)
    return Fit(states, np.full(len(targets), np.nan))
