"""Imported predictions as a system: the expressions that their file has lines for, judged as far as it goes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from shutil import copyfile
from typing import Any

import numpy as np

from pipeline.answering.answering import FrameAnswers, StageClock
from pipeline.answering.imported import file_of, line_of, needed_names, needed_rows
from pipeline.answering.objects import PreparedFrame
from pipeline.answering.opening import Pipeline
from pipeline.answering.predictions import Prediction, Predictions
from pipeline.diagnosis.decision import diagnose
from pipeline.diagnosis.frame_evidence import FrameEvidence, matched
from pipeline.diagnosis.imported_answers import answered_box, answered_overlap
from pipeline.diagnosis.verdict import Diagnosis
from pipeline.evaluation.records import asked_columns, diagnosis_columns, record
from pipeline.evaluation.shared_makers import Measured, measured_of
from pipeline.evaluation.systems import OWN, EvalSpec, Records, class_names_of, confidence_of, context_of
from pipeline.geometry.boxes import iou_2d
from pipeline.labels.cases import HIT, Case, FrameCases, is_gold, read_query
from pipeline.labels.reading import Labels
from pipeline.language.expression import parse
from pipeline.language.naming import match
from pipeline.language.relation_names import PHRASE
from pipeline.language.tree import Query
from pipeline.system.errors import InputError

PREDICTIONS_FILE = "predictions.jsonl"
"""Copy of what was imported, in its run's folder."""


@dataclass(frozen=True)
class ImportedPredictions:
    """The predictions of another pipeline; each line of their file has candidates and probabilities of its own."""

    name: str = OWN
    processes: bool = True

    def title(self, source: Pipeline) -> str:
        return file_of(source).header.system

    def measured(self, source: Pipeline, relations: Sequence[str]) -> Measured:
        return measured_of(source, relations)

    def kept(self, spec: EvalSpec, source: Pipeline, folder: Path, out: Path) -> tuple[EvalSpec, dict[str, Any]]:
        file, rescored = file_of(source), spec.options.get("rescore") is not None
        copyfile(file.path, folder / PREDICTIONS_FILE)
        options = {k: v for k, v in spec.options.items() if k != "rescore"}
        options |= {"predictions": out / PREDICTIONS_FILE, **({"rescored": True} if rescored else {})}
        return replace(spec, options=options), {"imported": file.record()}

    def open(self, spec: EvalSpec, source: Pipeline, labels: Labels, clock: StageClock) -> Records:
        class_names, file = class_names_of(labels), file_of(source)

        def records(truth: FrameCases, given: PreparedFrame | None) -> list[dict[str, Any]]:
            cases = tuple(c for c in truth.cases if file.line(truth.frame, c.text) is not None)
            if not cases:
                return []
            truth = replace(truth, cases=cases)
            context = context_of(source, truth, given, clock, boxes=True)
            return [_row(spec, source, truth, case, context, class_names, clock) for case in cases]

        return records


def _row(
    spec: EvalSpec,
    source: Pipeline,
    truth: FrameCases,
    case: Case,
    context: PreparedFrame,
    class_names: tuple[str, ...],
    clock: StageClock,
) -> dict[str, Any]:
    """The record of one expression.

    Raises
    ------
    InputError
        The line's proposals lack a name that the expression asks for, or its relations a pair.
    """
    own = source.asked(truth.frame, case.text)
    file, line = file_of(own), line_of(own)
    query, problem = _read(file, line, case, class_names)
    if not (line.relation and line.target) and file.header.settings is None:
        needed_names(line, (case.target, case.reference), file)
    gold = query is not None and is_gold(query, case)
    needed_rows(line, file, (case.target, case.relation, case.reference) if gold else None)
    answers = FrameAnswers(own, context, (case.target, case.reference), (case.relation,), clock)
    overlap = iou_2d(answers.boxes, truth.boxes)
    if line.ranked:
        row = record(case, truth, answers, (query, problem), overlap)
    else:
        row = _given_row(case, truth, answers, (query, problem), overlap)
    if spec.verdicts:
        evidence = FrameEvidence(truth, answers, confidence_of(spec), (case,))
        mark = spec.marks.get((truth.frame, case.id))
        found = diagnose(evidence, case, parse_ok=row["parse_ok"], mark=mark, query=query, problem=problem)
        row |= diagnosis_columns(found) | {"worked_out": _worked_out(file, found, case, line)}
    return row


def _worked_out(file: Predictions, found: Diagnosis, case: Case, line: Prediction) -> list[str] | None:
    """The numbers of the answer and of the right pair that the file does not give; None for none."""
    names, answers = list[str](), found.evidence.answers
    scored = line.pairs if file.header.ranking == "pair_scores" else ()
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
    file: Predictions, line: Prediction, case: Case, class_names: tuple[str, ...]
) -> tuple[Query | None, InputError | None]:
    """How the system read the words: as it says; where it does not, as they are meant. A run of ours read them."""
    if file.header.settings is not None:
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
    parsed: tuple[Query | None, InputError | None],
    overlap: np.ndarray,
) -> dict[str, Any]:
    """The row of an answer whose ranking is not told: where it is, and what of the proposals is right."""
    file, line = file_of(answers.source), line_of(answers.source)
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
    hit = answered_overlap(line, file, truth, frame)
    if line.answer is not None and line.answer.yes is not None:
        hit = np.full(len(hit), float(line.answer.yes))
    box = answered_box(line, file, frame)
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
