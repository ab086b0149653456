"""Questions on frames with the verdict on each answer, where the truth of the frame is known."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

from pipeline.answering.ask import Trace
from pipeline.answering.json_records import trace_record
from pipeline.answering.objects import PreparedFrame
from pipeline.answering.opening import FrameUnusable, Pipeline, Skipped, contexts, skip_or_raise
from pipeline.answering.ranking import RankConfig
from pipeline.diagnosis.live import Judgement, annotated_truth, judge_trace, judgement_record, labelled_truth
from pipeline.labels.cases import FrameCases
from pipeline.labels.reading import Labels
from pipeline.system.errors import InputError


@dataclass(frozen=True)
class JudgedAnswer:
    """An answer, with what is known of it.

    Attributes
    ----------
    trace : Trace
    judgement : Judgement or None
        None where there is no verdict.
    unjudged : str or None
        Why there is a truth and no verdict on this answer; None also where no truth is known at all.
    """

    trace: Trace
    judgement: Judgement | None = None
    unjudged: str | None = None


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
    if truth is None:
        return JudgedAnswer(trace)
    if isinstance(truth, str):
        return JudgedAnswer(trace, unjudged=truth)
    try:
        judged = judge_trace(trace, source, context, truth, rank=rank)
    except InputError as error:
        judged = str(error)
    return JudgedAnswer(trace, unjudged=judged) if isinstance(judged, str) else JudgedAnswer(trace, judged)


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
    if truth is None or isinstance(truth, str):
        return None, None
    first = _judged(before, source, context, truth)
    last = _judged(after, source, context, truth, rank)
    return _verdict(first), _verdict(last)


def _verdict(answer: JudgedAnswer) -> str | None:
    return None if answer.judgement is None else answer.judgement.diagnosis.verdict


def judged_record(answer: JudgedAnswer) -> dict[str, Any]:
    """The whole of `ask --json`: `trace_record`, and where truth is known "verdict", or null with "verdict_reason"."""
    record = trace_record(answer.trace)
    if answer.judgement is not None:
        record["verdict"] = judgement_record(answer.judgement)
    elif answer.unjudged is not None:
        record |= {"verdict": None, "verdict_reason": answer.unjudged}
    return record
