"""Answers with verdicts on frames of known truth: as asked, with edits, or as kept in a case."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from functools import lru_cache
from types import MappingProxyType
from typing import TYPE_CHECKING

import numpy as np

from pipeline.answering.answer_words import asked_in_part, best_pair
from pipeline.answering.ask import Trace
from pipeline.answering.batch import FrameAnswers
from pipeline.answering.detector_prompts import unused_words
from pipeline.answering.objects import PreparedFrame, all_objects
from pipeline.answering.pipeline import FrameUnusable, Pipeline, Skipped, contexts, skip_or_raise
from pipeline.answering.ranking import RankConfig
from pipeline.datasets.base import scene_of
from pipeline.diagnosis.answer import Answer, Edited
from pipeline.diagnosis.decision import diagnose
from pipeline.diagnosis.frame_evidence import DEFAULT_CONFIDENCE, FrameEvidence
from pipeline.diagnosis.sentence_truth import closest_pair, sentence_case
from pipeline.diagnosis.verdict import Diagnosis
from pipeline.labels.cases import Case, FrameCases, frame_cases, is_gold, read_cases, read_query
from pipeline.labels.labelling import label_objects
from pipeline.labels.plan import LabelConfig
from pipeline.labels.profiles import open_second_opinion
from pipeline.language.naming import match, spelt
from pipeline.language.relation_names import PHRASE
from pipeline.language.tree import Query
from pipeline.proposals.annotations import AnnotationDetector
from pipeline.relations.model import OnnxScorer, is_named
from pipeline.relations.relations import T, U
from pipeline.system.errors import InputError, ServerError, Unsupported, require

if TYPE_CHECKING:
    from pipeline.diagnosis.whatif import Edits
    from pipeline.labels.reading import Labels


def frame_truth(pipeline: Pipeline, context: PreparedFrame, labels: Labels | None = None) -> FrameCases | None:
    """Truth of a frame: by labels where given, else by its annotations; None without annotations.

    Raises
    ------
    InputError
        The labels say nothing of the frame or are of another picture, or its annotations cannot be labelled.
    """
    if labels is None:
        return annotated_truth(context, pipeline)
    truth = labelled_truth(context.frame.id, pipeline, labels)
    if truth is None:
        outlined = "a frame of the labels; what people outlined counts after `spatialviz export --effective`"
        raise InputError(f"the labels say nothing of frame {context.frame.id}", expected=outlined, path=labels.root)
    truth.check_picture(context.frame)
    return truth


def ask_and_judge(
    pipeline: Pipeline,
    key: str | int,
    expressions: Sequence[str],
    labels: Labels | None = None,
    skipped: Skipped | None = None,
    marks: Mapping[tuple[str, str], str] = MappingProxyType({}),
    confidence: float | None = None,
) -> Iterator[Answer]:
    """Answer and judge every expression on every frame of `key`; the truth of a frame is computed once.

    Parameters
    ----------
    key : str or int
        As for `pipeline.answering.pipeline.contexts`.
    labels : Labels, optional
        What says what is true. By default the frame's annotations do.
    skipped : callable, optional
        Told of each broken frame among all frames.
    marks, confidence
        As for `judge_trace`, the marks by frame and id of the expression: those of a run judge as the run did.
    """
    pipeline.needed_detector()
    for context in contexts(pipeline, key, skipped):
        truth: FrameCases | str | None = None
        try:
            for n, text in enumerate(expressions):
                trace = pipeline.ask(context, text)
                if n == 0:
                    truth = truth_or_reason(pipeline, context, labels)
                case = labelled_case(truth, trace.query.text) if isinstance(truth, FrameCases) else None
                mark = None if case is None else marks.get((context.frame.id, case.id))
                yield judged(trace, pipeline, context, truth, case=case, mark=mark, confidence=confidence)
        except FrameUnusable as error:
            skip_or_raise(error, key, context.frame.id, skipped)


def truth_or_reason(pipeline: Pipeline, context: PreparedFrame, labels: Labels | None) -> FrameCases | str | None:
    """Truth of a frame by `frame_truth`, or the reason for none."""
    try:
        return frame_truth(pipeline, context, labels)
    except InputError as error:
        return str(error)


def judged(
    trace: Trace,
    pipeline: Pipeline,
    context: PreparedFrame,
    truth: FrameCases | str | None,
    rank: RankConfig | None = None,
    *,
    case: Case | None = None,
    mark: str | None = None,
    confidence: float | None = None,
) -> Answer:
    """Answer of a trace with its verdict, or the reason for none; parameters as for `judge_trace`."""
    found: Diagnosis | str | None = truth if isinstance(truth, str) else None
    if isinstance(truth, FrameCases):
        try:
            found = judge_trace(trace, pipeline, context, truth, case=case, mark=mark, confidence=confidence, rank=rank)
        except InputError as error:
            found = str(error)
    if isinstance(found, str):
        return Answer(trace.query.text, trace, unjudged=found)
    return Answer(trace.query.text, trace, diagnosis=found)


def answer(
    pipeline: Pipeline,
    context: PreparedFrame,
    text: str,
    *,
    truth: FrameCases | None = None,
    case: Case | None = None,
    mark: str | None = None,
    confidence: float | None = None,
    edits: Edited | None = None,
) -> Answer:
    """Answer an expression, and judge the answer where the truth is known.

    `case`, `mark`, `confidence`: as for `pipeline.diagnosis.asking.judge_trace`; `edits`: edits as JSON.
    """
    pipeline.needed_detector()
    rank: RankConfig | None = None
    try:
        trace = pipeline.ask(context, text)
    except ServerError:
        raise  # Nothing is told about the expression.
    except InputError as error:
        found = None
        if truth is not None and case is not None:
            found = judge_refused(pipeline, context, truth, case, mark=mark, confidence=confidence)
        return Answer(text, problem=str(error), diagnosis=found)
    if edits:
        trace, rank = edited_trace(pipeline, context, text, edits)
    return judged(trace, pipeline, context, truth, rank, case=case, mark=mark, confidence=confidence)


def why_refused(pipeline: Pipeline, text: str, error: InputError) -> str:
    """Reason of a refused question in one short sentence: how it was read, or what is understood."""
    if isinstance(error, Unsupported | ServerError):
        return error.what
    try:
        e = pipeline.read(text).expression
    except InputError as unread:
        near = str(unread).partition("(did you mean ")[2].partition("?)")[0]
        return f"{unread.what}; did you mean {near}?" if near else f"{unread.what}; “X RELATION Y” is understood"
    # What it was read as tells why a word was taken for a name.
    return error.what if e is None else f"Read as “{e.target} {PHRASE[e.relation]} {e.reference}”: {error.what}"


def judge_refused(
    pipeline: Pipeline,
    context: PreparedFrame,
    truth: FrameCases,
    case: Case,
    *,
    mark: str | None = None,
    confidence: float | None = None,
) -> Diagnosis:
    """Verdict on a labelled expression that could not be asked: PARSE, or OPM where the detector lacks a name.

    Parameters as for `judge_trace`.
    """
    with suppress(InputError):  # A file without a line for it.
        pipeline = pipeline.asked(context.frame.id, case.text)
    query, unread = read_query(case, pipeline.dataset.class_names, pipeline.reader)
    answers = FrameAnswers(pipeline, context, (case.target, case.reference), (case.relation,))
    return judge_answers(answers, truth, case, query, mark=mark, confidence=confidence, problem=unread)


def edited_trace(pipeline: Pipeline, context: PreparedFrame, text: str, edits: Edited) -> tuple[Trace, RankConfig]:
    """Answer under edits, with the weights of its ranking."""
    from pipeline.diagnosis.whatif import Baseline, rerun

    read = pathless_edits(edits)
    return rerun(Baseline(pipeline, context, text), read).trace, replace(pipeline.config.rank, **read.rank)


def pathless_edits(edits: Edited) -> Edits:
    """Edits of JSON naming no file; InputError otherwise."""
    from pipeline.diagnosis.whatif import read_edits

    require(
        isinstance(edits, Mapping),
        "edits are no mapping",
        got=type(edits).__name__,
        expected='such as {"hidden": ["#3"]}',
    )
    read = read_edits(dict(edits))
    require(
        is_named(read.scorer),
        "the edits name a relation network by its path",
        got=read.scorer,
        expected="rule, trained, or an installed one (--srm FILE takes a path)",
    )
    return read


@lru_cache(maxsize=1)
def _second_opinion() -> OnnxScorer | None:
    return open_second_opinion(LabelConfig().second_opinion)


def annotated_truth(context: PreparedFrame, pipeline: Pipeline) -> FrameCases | None:
    """Truth of an annotated frame, labelled now by the default profile; None without annotations."""
    if not context.frame.annotations:
        return None
    config = LabelConfig(vocabulary="all", lift=context.config)
    objects = all_objects(context, AnnotationDetector())
    frame_id = context.frame.id
    ids = pipeline.dataset.frame_ids
    rows = label_objects(
        context,
        objects,
        config,
        frame_index=ids.index(frame_id) if frame_id in ids else 0,
        scene=scene_of(pipeline.dataset, frame_id),
        exact=True,
        network=_second_opinion(),
        expressions=False,
    )
    index, scene = int(rows.frames["frame_index"][0]), str(rows.frames["scene"][0])
    return frame_cases(frame_id, index, scene, rows.objects, rows.relations, {}, config.relations)


def labelled_truth(frame_id: str, pipeline: Pipeline, labels: Labels) -> FrameCases | None:
    """Truth of a frame by labels, with their expressions if it has any; None for a frame outside the labels."""
    if frame_id not in pipeline.dataset.frame_ids:
        return None
    index = pipeline.dataset.frame_ids.index(frame_id)
    return next((truth for truth in read_cases(labels, index, index + 1, bare=True) if truth.frame == frame_id), None)


def labelled_case(truth: FrameCases, text: str) -> Case | None:
    """Labelled expression with these words, if any."""
    wanted = " ".join(text.casefold().split())
    return next((c for c in truth.cases if " ".join(c.text.casefold().split()) == wanted), None)


def case_of(
    truth: FrameCases, trace: Trace, pipeline: Pipeline, context: PreparedFrame
) -> tuple[FrameCases, Case] | str:
    """Truth of a typed expression by the frame's relations, or the reason for none.

    Expressions of more than a relation between two names become a `sentence_case`.

    Nobody has labelled a pair as meant: among the surely true pairs the answered one is taken, else one with the
    answered target, else with the answered reference, else the first in the order of the objects.
    """
    query = trace.query
    if asked_in_part(trace):
        words = " and ".join(f"“{words}” ({why})" for words, why in unused_words(query))
        return f"not all of the question was used: {words}"
    e = query.expression
    plain = len(query.readings) == 1 and query.default.root.triple is not None
    if e is None or not plain or e.second_reference or e.inverse or e.relation not in truth.states:
        made = sentence_case(truth, trace, pipeline, context)
        return made if isinstance(made, str) else (truth, made)
    known = tuple(dict.fromkeys([*truth.labels, *pipeline.dataset.class_names]))
    # By other letters or another word it is the same pair, and has the same verdict.
    meant = [match(spelt(name, known, pipeline.synonyms), known, pipeline.synonyms) for name in (e.target, e.reference)]
    ends = [np.array([label in names for label in truth.labels], np.bool_) for names in meant]
    states = np.where(ends[0][:, None] & ends[1][None, :] & truth.judged, truth.states[e.relation], -1)
    np.fill_diagonal(states, -1)
    sure = np.argwhere(states == T)
    if not len(sure):
        return "in this frame the expression is true of nothing beyond doubt"
    a, b = (int(x) for x in sure[closest_pair(sure, trace, truth)])
    # Only the rows of the two ends are read: whatever the names mean here is of the asked class.
    alike = np.eye(len(truth.labels), dtype=np.bool_)
    alike[a], alike[b] = ends
    strict, acceptable = (np.flatnonzero((states >= least).any(axis=1)) for least in (T, U))
    case = Case(
        id="typed",
        text=query.text,
        target=e.target,
        relation=e.relation,
        reference=e.reference,
        target_object=a,
        reference_object=b,
        strict=strict,
        acceptable=acceptable,
        ambiguous=len(acceptable) > 1,
        margin=float("nan"),
    )
    return replace(truth, alike=alike, cases=(case,)), case


def judge_trace(
    trace: Trace,
    pipeline: Pipeline,
    context: PreparedFrame,
    truth: FrameCases,
    *,
    case: Case | None = None,
    mark: str | None = None,
    confidence: float | None = None,
    rank: RankConfig | None = None,
    before: FrameEvidence | None = None,
) -> Diagnosis | str:
    """Verdict on a trace, or the reason for none.

    Parameters
    ----------
    trace : Trace
        Edited or not.
    context : PreparedFrame
        Of the trace's frame.
    case : Case, optional
        The labelled expression; by default the one whose words were asked, else one made of the frame's relations.
    mark : str, optional
        BAD_LABEL or BAD_BOX.
    confidence : float, optional
        Score of an object that RECALL adds.
    rank : RankConfig, optional
        The weights the trace was ranked with, where they are not the pipeline's.
    before : FrameEvidence, optional
        Of the answer before an edit: what the edit leaves alone is not scored again.
    """
    pipeline = pipeline.asked(context.frame.id, trace.query.text)
    case = case or labelled_case(truth, trace.query.text)
    if best_pair(trace) is None and not trace.missing and trace.answered is None:
        return "there is no answer to judge"
    if case is None:
        made = case_of(truth, trace, pipeline, context)
        if isinstance(made, str):
            return made
        truth, case = made
    if rank is not None:
        pipeline = replace(pipeline, config=replace(pipeline.config, rank=rank))
    names = [name for name, _ in truth.roles(case)]
    query = trace.query
    if is_gold(query, case) and all(name in trace.candidates for name in names):
        answers = FrameAnswers.of_trace(pipeline, context, trace)
    else:
        answers = FrameAnswers(pipeline, context, names, case.relations)
        # What the detector does not know was read all the same.
        query = read_query(case, pipeline.dataset.class_names, pipeline.reader)[0] or query
    return judge_answers(answers, truth, case, query, mark=mark, confidence=confidence, before=before)


def judge_sentence(
    trace: Trace, pipeline: Pipeline, context: PreparedFrame, truth: FrameCases, right: np.ndarray
) -> Diagnosis | str:
    """Verdict on a trace with given right answers, (K,) int64 labelled objects; or the reason for none."""
    case = sentence_case(truth, trace, pipeline, context, right)
    if isinstance(case, str):
        return case
    return judge_answers(FrameAnswers.of_trace(pipeline, context, trace), truth, case, trace.query)


def judge_answers(
    answers: FrameAnswers,
    truth: FrameCases,
    case: Case,
    query: Query | None,
    *,
    mark: str | None = None,
    confidence: float | None = None,
    problem: InputError | None = None,
    before: FrameEvidence | None = None,
) -> Diagnosis:
    """Verdict on an expression by the detections of its frame; `problem`: reason for not reading it."""
    confidence = DEFAULT_CONFIDENCE if confidence is None else confidence
    evidence = FrameEvidence(truth, answers, confidence, (case,), before)
    gold = query is not None and is_gold(query, case)
    return diagnose(evidence, case, parse_ok=gold, mark=mark, query=query, problem=problem)
