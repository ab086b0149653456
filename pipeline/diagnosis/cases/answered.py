"""One expression answered and judged, with its edits: what a case holds, and what it is compared by."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

from pipeline.answering.answering import FrameAnswers
from pipeline.answering.ask import Trace
from pipeline.answering.json_records import trace_record
from pipeline.answering.objects import PreparedFrame
from pipeline.answering.opening import Pipeline
from pipeline.answering.ranking import RankConfig
from pipeline.diagnosis.frame_evidence import DEFAULT_CONFIDENCE, FrameEvidence
from pipeline.diagnosis.live import Judgement, judge_trace, judgement_record
from pipeline.diagnosis.verdict import diagnose
from pipeline.diagnosis.words import explain
from pipeline.labels.cases import Case, FrameCases, is_gold, read_query
from pipeline.system.errors import InputError

Edited = Mapping[str, Any]
"""Edits as JSON; see `pipeline.diagnosis.whatif`."""


@dataclass(frozen=True)
class Answered:
    """What came of one expression.

    Attributes
    ----------
    text : str
    trace : Trace or None
        None where the expression cannot be read or asked.
    problem : str or None
        Why not.
    judgement : Judgement or None
        None without a truth.
    unjudged : str or None
        Why there is a truth and no verdict.
    """

    text: str
    trace: Trace | None
    problem: str | None
    judgement: Judgement | None
    unjudged: str | None = None


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
) -> Answered:
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
        judged = None if truth is None or case is None else _unasked(source, context, truth, case, str(error), mark)
        return Answered(text, None, str(error), judged)
    if edits:
        trace, rank = edited_trace(source, context, text, edits)
    if truth is None:
        return Answered(text, trace, None, None)
    judged = judge_trace(trace, source, context, truth, case=case, mark=mark, confidence=confidence, rank=rank)
    if isinstance(judged, str):
        return Answered(text, trace, None, None, judged)
    return Answered(text, trace, None, judged)


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


def _unasked(
    source: Pipeline, context: PreparedFrame, truth: FrameCases, case: Case, problem: str, mark: str | None
) -> Judgement:
    """The verdict on an expression that could not be asked."""
    query, unread = read_query(case, source.dataset.class_names)
    names = tuple(dict.fromkeys((case.target, case.reference)))
    answers = FrameAnswers(source, context, names, (case.relation,))
    evidence = FrameEvidence(truth, answers, DEFAULT_CONFIDENCE, (case,))
    gold = query is not None and is_gold(query, case)
    diagnosis = diagnose(evidence, case, parse_ok=gold, mark=mark, unfiltered=source.unfiltered_detector)
    said = explain(diagnosis, case, query=query, problem=unread or problem, unknown=answers.unknown)
    return Judgement(case, truth, evidence, diagnosis, said)


def answer_record(answered: Answered) -> dict[str, Any]:
    """The answer as in `ask --json`, without times; `judgement` as in `judgement_record`."""
    if answered.trace is None:
        record: dict[str, Any] = {"expression": {"text": answered.text}, "answer": None, "reason": answered.problem}
    else:
        record = trace_record(answered.trace)
        del record["timings_ms"]
    record["judgement"] = None if answered.judgement is None else judgement_record(answered.judgement)
    return record
