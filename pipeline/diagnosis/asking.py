"""Expressions answered and judged, on frames whose truth is known: as asked, with edits, or as a case keeps them."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from pipeline.answering.answering import FrameAnswers
from pipeline.answering.ask import Trace
from pipeline.answering.json_records import trace_record
from pipeline.answering.objects import PreparedFrame
from pipeline.answering.opening import FrameUnusable, Pipeline, Skipped, contexts, skip_or_raise
from pipeline.answering.ranking import RankConfig
from pipeline.diagnosis.live import annotated_truth, diagnosis_record, judge_answers, judge_trace, labelled_truth
from pipeline.diagnosis.verdict import Diagnosis
from pipeline.labels.cases import Case, FrameCases, read_query
from pipeline.labels.reading import Labels
from pipeline.system.errors import InputError

Edited = Mapping[str, Any]
"""Edits as JSON; see `pipeline.diagnosis.whatif`."""


@dataclass(frozen=True)
class JudgedAnswer:
    """An answer, with what is known of it.

    Attributes
    ----------
    text : str
    trace : Trace or None
        None where the expression cannot be read or asked.
    problem : str or None
        Why not.
    diagnosis : Diagnosis or None
        None where there is no verdict.
    unjudged : str or None
        Why there is a truth and no verdict on this answer; None also where no truth is known at all.
    """

    text: str
    trace: Trace | None = None
    problem: str | None = None
    diagnosis: Diagnosis | None = None
    unjudged: str | None = None

    @property
    def verdict(self) -> str | None:
        """None where there is none."""
        return None if self.diagnosis is None else self.diagnosis.verdict


def known_truth(source: Pipeline, context: PreparedFrame, labels: Labels | None = None) -> FrameCases | None:
    """What is true of a frame: by labels where they are given, else by its annotations; None without annotations.

    Raises
    ------
    InputError
        The labels say nothing of the frame or are of another picture, or its annotations cannot be labelled.
    """
    if labels is None:
        return annotated_truth(context, source)
    truth = labelled_truth(context.frame.id, source, labels)
    if truth is None:
        raise InputError(f"the labels say nothing of frame {context.frame.id}", path=labels.root)
    truth.check_picture(context.frame)
    return truth


def ask_and_judge(
    source: Pipeline,
    key: str | int,
    expressions: Sequence[str],
    labels: Labels | None = None,
    skipped: Skipped | None = None,
) -> Iterator[JudgedAnswer]:
    """Every expression on every frame that `key` means, with verdicts; the truth of a frame is worked out once.

    Parameters
    ----------
    source : Pipeline
    key : str or int
        As for `pipeline.answering.opening.ask_frames`.
    expressions : sequence of str
    labels : Labels, optional
        What says what is true. By default the frame's annotations do.
    skipped : callable, optional
        Told of each broken frame among all frames.

    Raises
    ------
    InputError
        As `pipeline.answering.opening.ask_frames`.
    """
    source.needed_detector()
    for context in contexts(source, key, skipped):
        truth: FrameCases | str | None = None
        try:
            for n, text in enumerate(expressions):
                trace = source.ask(context, text)
                if n == 0:
                    truth = _truth_or_reason(source, context, labels)
                yield _judged(trace, source, context, truth)
        except FrameUnusable as error:
            skip_or_raise(error, key, context.frame.id, skipped)


def _truth_or_reason(source: Pipeline, context: PreparedFrame, labels: Labels | None) -> FrameCases | str | None:
    try:
        return known_truth(source, context, labels)
    except InputError as error:
        return str(error)


def _judged(
    trace: Trace,
    source: Pipeline,
    context: PreparedFrame,
    truth: FrameCases | str | None,
    rank: RankConfig | None = None,
) -> JudgedAnswer:
    judged: Diagnosis | str | None = None if isinstance(truth, FrameCases) else truth
    if isinstance(truth, FrameCases):
        try:
            judged = judge_trace(trace, source, context, truth, rank=rank)
        except InputError as error:
            judged = str(error)
    return _with_verdict(trace.query.text, trace, judged)


def _with_verdict(text: str, trace: Trace, judged: Diagnosis | str | None) -> JudgedAnswer:
    if isinstance(judged, str):
        return JudgedAnswer(text, trace, unjudged=judged)
    return JudgedAnswer(text, trace, diagnosis=judged)


def edited_verdicts(
    source: Pipeline,
    context: PreparedFrame,
    before: Trace,
    after: Trace,
    rank: RankConfig,
    labels: Labels | None = None,
) -> tuple[str | None, str | None]:
    """The verdicts on an answer without and with edits, by one truth; None where there is none.

    Parameters
    ----------
    rank : RankConfig
        The weights that `after` was ranked with.
    """
    truth = _truth_or_reason(source, context, labels)
    first, last = _judged(before, source, context, truth), _judged(after, source, context, truth, rank)
    return first.verdict, last.verdict


def answer(
    source: Pipeline,
    context: PreparedFrame,
    text: str,
    *,
    truth: FrameCases | None = None,
    case: Case | None = None,
    mark: str | None = None,
    confidence: float | None = None,
    edits: Edited | None = None,
) -> JudgedAnswer:
    """Answer an expression, and judge the answer where the truth is known.

    Parameters
    ----------
    source : Pipeline
    context : PreparedFrame
    text : str
    truth : FrameCases, optional
    case, mark, confidence
        As for `pipeline.diagnosis.live.judge_trace`.
    edits : mapping, optional
        Edits as JSON.

    Raises
    ------
    InputError
        Edits that cannot be applied.
    """
    source.needed_detector()
    rank: RankConfig | None = None
    try:
        trace = source.ask(context, text)
    except InputError as error:
        judged = None
        if truth is not None and case is not None:
            query, unread = read_query(case, source.dataset.class_names)
            answers = FrameAnswers(source, context, (case.target, case.reference), (case.relation,))
            judged = judge_answers(answers, truth, case, query, mark=mark, problem=unread or str(error))
        return JudgedAnswer(text, problem=str(error), diagnosis=judged)
    if edits:
        trace, rank = edited_trace(source, context, text, edits)
    if truth is None:
        return JudgedAnswer(text, trace)
    judged = judge_trace(trace, source, context, truth, case=case, mark=mark, confidence=confidence, rank=rank)
    return _with_verdict(text, trace, judged)


def edited_trace(source: Pipeline, context: PreparedFrame, text: str, edits: Edited) -> tuple[Trace, RankConfig]:
    """The answer under edits, and the weights it was ranked with.

    Raises
    ------
    InputError
        Edits that cannot be read, or ones that name a file.
    """
    from pipeline.diagnosis.whatif import Baseline, apply, read_edits

    read = read_edits(dict(edits))
    if read.scorer not in (None, "rule", "trained"):
        raise InputError("the edits name a relation network by its path", got=read.scorer, expected="--srm FILE")
    return apply(Baseline(source, context, text), read), replace(source.config.rank, **read.rank)


def judged_record(answer: JudgedAnswer) -> dict[str, Any]:
    """The whole of `ask --json`: `trace_record`, and where truth is known "verdict", or null with "verdict_reason"."""
    assert answer.trace is not None
    record = trace_record(answer.trace)
    if answer.diagnosis is not None:
        record["verdict"] = diagnosis_record(answer.diagnosis)
    elif answer.unjudged is not None:
        record |= {"verdict": None, "verdict_reason": answer.unjudged}
    return record


def answer_record(answered: JudgedAnswer) -> dict[str, Any]:
    """What a case keeps: the answer as in `ask --json`, without times; "judgement" as in `diagnosis_record`."""
    if answered.trace is None:
        record: dict[str, Any] = {"expression": {"text": answered.text}, "answer": None, "reason": answered.problem}
    else:
        record = trace_record(answered.trace)
        del record["timings_ms"]
    record["judgement"] = None if answered.diagnosis is None else diagnosis_record(answered.diagnosis)
    return record
