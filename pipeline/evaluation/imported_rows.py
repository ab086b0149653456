"""The records of imported predictions: expressions of labels that a file has lines for, judged as far as it goes."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from pipeline.answering.answering import FrameAnswers, StageClock
from pipeline.answering.imported import ImportedPipeline, needed_names, needed_rows
from pipeline.answering.objects import PreparedFrame
from pipeline.answering.predictions import Prediction
from pipeline.diagnosis.decision import diagnose
from pipeline.diagnosis.frame_evidence import DEFAULT_CONFIDENCE, FrameEvidence, matched
from pipeline.diagnosis.imported_answers import answered_box, answered_overlap
from pipeline.diagnosis.verdict import Diagnosis
from pipeline.evaluation.records import asked_columns, diagnosis_columns, record
from pipeline.geometry.boxes import iou_2d
from pipeline.labels.cases import HIT, Case, FrameCases, is_gold, read_query
from pipeline.language.expression import parse
from pipeline.language.naming import match
from pipeline.language.relation_names import PHRASE
from pipeline.language.tree import Query
from pipeline.system.errors import InputError


def told_cases(source: ImportedPipeline, truth: FrameCases) -> FrameCases:
    """The expressions of a frame that the file has lines for."""
    kept = tuple(c for c in truth.cases if source.predictions.line(truth.frame, c.text) is not None)
    return replace(truth, cases=kept)


def imported_rows(
    source: ImportedPipeline,
    truth: FrameCases,
    context: PreparedFrame,
    class_names: tuple[str, ...],
    *,
    confidence: float | None = None,
    marks: dict[tuple[str, str], str] | None = None,
    verdicts: bool = True,
    clock: StageClock | None = None,
) -> list[dict[str, Any]]:
    """The rows of a frame's expressions; each line of the file has candidates and probabilities of its own.

    Parameters
    ----------
    source : ImportedPipeline
    truth : FrameCases
        Only expressions that the file has lines for: `told_cases`.
    context : PreparedFrame
    class_names : tuple of str
        Of the labels, for reading.
    confidence, marks, verdicts
        As of `EvalSpec`.

    Raises
    ------
    InputError
        A line whose proposals lack a name that the expression asks for, or whose relations a pair.
    """
    rows = []
    for case in truth.cases:
        own = source.asked(truth.frame, case.text)
        assert isinstance(own, ImportedPipeline)
        line = own.line
        assert line is not None
        query, problem = _read(own, line, case, class_names)
        if not (line.relation and line.target) and source.predictions.header.settings is None:
            needed_names(line, (case.target, case.reference), source.predictions)
        gold = query is not None and is_gold(query, case)
        needed_rows(line, source.predictions, (case.target, case.relation, case.reference) if gold else None)
        answers = FrameAnswers(own, context, (case.target, case.reference), (case.relation,), clock)
        overlap = iou_2d(answers.boxes, truth.boxes)
        if line.ranked:
            row = record(case, truth, answers, (query, problem), overlap)
        else:
            row = _given_row(case, truth, answers, line, (query, problem), overlap)
        rows.append(row)
        if verdicts:
            given = DEFAULT_CONFIDENCE if confidence is None else confidence
            evidence = FrameEvidence(truth, answers, given, (case,))
            mark = (marks or {}).get((truth.frame, case.id))
            found = diagnose(evidence, case, parse_ok=row["parse_ok"], mark=mark, query=query, problem=problem)
            row |= diagnosis_columns(found) | {"worked_out": _worked_out(source, found, case, line)}
    return rows


def _worked_out(source: ImportedPipeline, found: Diagnosis, case: Case, line: Prediction) -> list[str] | None:
    """The numbers of the answer and of the right pair that the file does not give; None for none."""
    names, answers = list[str](), found.evidence.answers
    scored = line.pairs if source.predictions.header.ranking == "pair_scores" else ()
    own = {(a, b): score for a, b, score in scored or ()}
    for prefix, pair in (("", found.winner), ("right_", found.right)):
        if pair is None or pair.reference is None:
            continue
        score = own.get((answers.objects[pair.target].id, answers.objects[pair.reference].id))
        if score is None or not np.isclose(score, pair.log_score, rtol=1e-9, atol=0):
            names.append(f"{prefix}log_score")
        if answers.worked_out(case.relation, pair.target, pair.reference):
            names.append(f"{prefix}p_relation")
    return names or None


def _read(
    source: ImportedPipeline, line: Prediction, case: Case, class_names: tuple[str, ...]
) -> tuple[Query | None, InputError | None]:
    """How the system read the words: as it says; where it does not, as they are meant. A run of ours read them."""
    if source.predictions.header.settings is not None:
        return read_query(case, class_names)
    names = (case.target, case.reference)
    words = [case.target, case.relation, case.reference]
    if line.target and line.relation:
        theirs = (line.target, line.reference or "")
        told = [gold if match(own or gold, (gold,)) else own for own, gold in zip(theirs, names, strict=True)]
        words = [told[0], line.relation, told[1]]
    text = f"{words[0]} {PHRASE.get(words[1], words[1])} {words[2]}" if words[2] else words[0]
    return read_query(replace(case, text=text), (*class_names, *filter(None, (words[0], words[2]))), parse)


def _given_row(
    case: Case,
    truth: FrameCases,
    answers: FrameAnswers,
    line: Prediction,
    parsed: tuple[Query | None, InputError | None],
    overlap: np.ndarray,
) -> dict[str, Any]:
    """The row of an answer whose ranking is not told: where it is, and what of the proposals is right."""
    source = answers.source
    assert isinstance(source, ImportedPipeline)
    row = asked_columns(case, truth)
    if line.level:
        row = record(case, truth, answers, parsed, overlap)
        kept = {
            "parse_ok",
            "problem",
            "targets_found",
            "references_found",
            "target_rank",
            "reference_rank",
            "pair_covered",
        }
        row = asked_columns(case, truth) | {k: v for k, v in row.items() if k in kept or k.startswith("opm_")}
    frame = answers.context.frame
    hit = answered_overlap(line, source.predictions, truth, frame)
    if line.answer is not None and line.answer.yes is not None:
        hit = np.full(len(hit), float(line.answer.yes))
    box = answered_box(line, source.predictions, frame)
    strict, lenient = (float(hit[k].max()) if len(k) else 0.0 for k in (case.strict, case.acceptable))
    iou = float(hit[case.target_object])
    at = int(matched(hit[None], truth.alike[[case.target_object]])[0])
    row |= {
        "parse_ok": True if row["parse_ok"] is None else row["parse_ok"], "problem": line.problem or row["problem"],
        "iou": iou, "strict_iou": strict, "set_iou": lenient, "correct": iou >= HIT, "strict_correct": strict >= HIT,
        "set_correct": lenient >= HIT, "box": None if box is None else box.tolist(),
        "matched_target": None if at < 0 else at,
    }  # fmt: skip
    if line.answer is None:
        row |= {"reference_correct": False, "pair_correct": False}
    return row
