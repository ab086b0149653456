"""Systems that answer expressions: the protocol that an evaluation knows, the pipeline, imported predictions."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import field, replace
from pathlib import Path
from shutil import copyfile
from typing import Any, Protocol

import numpy as np

from pipeline.answering.batch import FrameAnswers, StageClock
from pipeline.answering.imported import needed_names, needed_rows, open_source
from pipeline.answering.objects import PreparedFrame, prepare_frame
from pipeline.answering.pipeline import Pipeline, file_of, line_of
from pipeline.answering.predictions import Prediction, Predictions
from pipeline.datasets import Dataset
from pipeline.datasets.base import load_picture
from pipeline.diagnosis.decision import diagnose
from pipeline.diagnosis.frame_evidence import DEFAULT_CONFIDENCE, FrameEvidence, matched
from pipeline.diagnosis.imported_answers import answered_box, answered_overlap
from pipeline.diagnosis.not_seen import SceneMaps, open_scene_maps
from pipeline.diagnosis.substitution import substitutions
from pipeline.diagnosis.verdict import Diagnosis
from pipeline.evaluation.leakage import Measured, measured_of
from pipeline.evaluation.records import asked_columns, diagnosis_columns, record
from pipeline.evaluation.relation_cases import RelationSpec
from pipeline.evaluation.relation_records import RelationRecords, SystemRecords
from pipeline.geometry.boxes import iou_2d
from pipeline.labels.cases import HIT, Case, FrameCases, is_gold, read_query
from pipeline.labels.reading import Labels, open_labels, read_table
from pipeline.language.expression import parse
from pipeline.language.naming import match
from pipeline.language.relation_names import PHRASE
from pipeline.language.tree import Query
from pipeline.proposals.base import reads_annotations
from pipeline.system.errors import InputError
from pipeline.system.frozen import dataclass

PREDICTIONS_FILE = "predictions.jsonl"
"""Copy of what was imported, in its run's folder."""
OWN = "pipeline"
"""Name in `run.json` of the pipeline itself, with predictions of its own or imported ones."""
Records = Callable[[FrameCases, "PreparedFrame | None"], "list[dict[str, Any]]"]
"""Gives the records of a frame's expressions; the frame is loaded where it is not given."""


class System(Protocol):
    """A system that answers expressions: plain values, so that a process can be given it."""

    @property
    def name(self) -> str:
        """Kind of the system in `run.json`: "pipeline", "referring", "vlm"."""
        ...

    @property
    def processes(self) -> bool:
        """Allow several processes at once."""
        ...

    def title(self, source: Pipeline) -> str:
        """Name of the row in tables."""
        ...

    def measured(self, source: Pipeline, relations: Sequence[str]) -> Measured:
        """Parts possibly shared by labels."""
        ...

    def decided(self, spec: EvalSpec, source: Pipeline, labels: Labels) -> tuple[System, tuple[str, ...]]:
        """Decide what has to be known of all answers before the first one; with words of it."""
        ...

    def open(self, spec: EvalSpec, source: Pipeline, labels: Labels, clock: StageClock) -> Records:
        """Open models once for a process."""
        ...

    def kept(self, spec: EvalSpec, source: Pipeline, folder: Path, out: Path) -> tuple[EvalSpec, dict[str, Any]]:
        """Copy the sources of answers into a run's folder (`out`, written as `folder`).

        Returns `spec`: of the copy. `record`: further keys of `run.json`.
        """
        ...


class PairSystem(Protocol):
    """A system that is asked about a sample of labelled pairs."""

    def record(self) -> dict[str, Any]:
        """Convert to JSON: `vlm` of `run.json`."""
        ...

    def ask(
        self,
        how: RelationSpec,
        dataset: Dataset,
        labels: Labels,
        records: RelationRecords,
        counted: np.ndarray,
        folder: Path,
    ) -> AskedPairs:
        """Ask about some of the (P,) bool counted pairs, and write every answer into the run's folder."""
        ...


@dataclass(frozen=True)
class AskedPairs:
    """Answers about M pairs: their rows in the records ((M,) int64), probabilities, a note, an entry of `run.json`."""

    rows: np.ndarray
    system: SystemRecords
    note: str
    record: dict[str, Any]


@dataclass(frozen=True)
class EvalSpec:
    """An evaluation as plain values that a process can be given."""

    dataset: str
    labels: str
    # options: arguments of `open_pipeline`: detector, model, srm, config, ...
    options: dict[str, Any] = field(default_factory=dict)
    system: System | None = None  # by default the pipeline, or with the option `predictions` what another pipeline gave
    pairs: PairSystem | None = None  # asked about labelled pairs beside the relation scorers
    limit: int | None = None  # only so many expressions, spread evenly over the frames
    grounding: bool = True  # answer the expressions
    relations: RelationSpec | None = None  # measure relations alone too, and how
    # confidence: score of an object that the oracle RECALL adds: the median of the run's right detections
    confidence: float | None = None
    verdicts: bool = True  # diagnose each expression; without, the evaluation is a third cheaper
    # marks: labels that a person marked: (frame, id of the expression) -> "BAD_LABEL" or "BAD_BOX"
    marks: dict[tuple[str, str], str] = field(default_factory=dict)
    map: str | None = None  # folder of object maps, which tell what a frame does not show (NOT-SEEN)

    def open(self) -> tuple[Pipeline, Labels]:
        """Open the dataset with the models, and the labels."""
        return open_source(self.dataset, **self.options), open_labels(self.labels)

    def maps(self, dataset: Dataset | None = None) -> SceneMaps | None:
        """Object maps, read anew; errors as of `open_scene_maps`."""
        return None if self.map is None else open_scene_maps(self.map, dataset)


def context_of(
    source: Pipeline, truth: FrameCases, given: PreparedFrame | None, clock: StageClock, boxes: bool = False
) -> PreparedFrame:
    """Prepare a frame, loaded unless given; InputError for another picture than the labels'."""
    if given is not None:
        truth.check_picture(given.frame)
        return given
    with clock.stage("read"):
        # Where nobody looks at the annotations, their masks are the most of what there would be to decode.
        whole = reads_annotations(source.needed_detector())
        frame = source.dataset.load(truth.frame) if whole else load_picture(source.dataset, truth.frame)
    truth.check_picture(frame)
    with clock.stage("lift"):
        return prepare_frame(source.dataset, frame, source.config.lift, boxes=boxes)


def class_names_of(labels: Labels) -> tuple[str, ...]:
    """Class names of the labelled objects, in order."""
    column = read_table(labels.root / "objects.parquet", "objects", ["label"]).column("label")
    return tuple(sorted(column.unique().to_pylist()))


@dataclass(frozen=True)
class OwnPipeline:
    """The pipeline itself."""

    name: str = OWN
    processes: bool = True

    def title(self, source: Pipeline) -> str:
        return f"{source.needed_detector().name} + {source.scorer.name}"

    def measured(self, source: Pipeline, relations: Sequence[str]) -> Measured:
        return measured_of(source, relations)

    def kept(self, spec: EvalSpec, source: Pipeline, folder: Path, out: Path) -> tuple[EvalSpec, dict[str, Any]]:
        return spec, {}

    def decided(self, spec: EvalSpec, source: Pipeline, labels: Labels) -> tuple[OwnPipeline, tuple[str, ...]]:
        return self, ()

    def open(self, spec: EvalSpec, source: Pipeline, labels: Labels, clock: StageClock) -> Records:
        class_names, maps = class_names_of(labels), spec.maps(source.dataset)
        parsed: dict[str, tuple[Query | None, InputError | None]] = {}

        def records(truth: FrameCases, given: PreparedFrame | None) -> list[dict[str, Any]]:
            # No answer depends on 3D boxes: features that are made of boxes fit them to the points themselves.
            context = context_of(source, truth, given, clock)
            names = dict.fromkeys(name for case in truth.cases for name in (case.target, case.reference))
            answers = FrameAnswers(source, context, tuple(names), {case.relation for case in truth.cases}, clock)
            with clock.stage("parse"):
                for case in truth.cases:
                    if case.text not in parsed:
                        parsed[case.text] = read_query(case, class_names)
            with clock.stage("records"):
                overlap = iou_2d(answers.boxes, truth.boxes)
                rows = [record(case, truth, answers, parsed[case.text], overlap) for case in truth.cases]
            if not spec.verdicts:
                return rows
            with clock.stage("verdicts"):
                evidence = FrameEvidence(truth, answers, confidence_of(spec))
                ranked = substitutions(evidence, truth.cases)
                for case, row, found in zip(truth.cases, rows, ranked, strict=True):
                    mark, (query, problem) = spec.marks.get((row["frame"], case.id)), parsed[case.text]
                    read = row["parse_ok"]
                    d = diagnose(evidence, case, parse_ok=read, mark=mark, query=query, problem=problem, found=found)
                    row |= diagnosis_columns(d if maps is None else maps.judged(d))
            return rows

        return records


def system_of(spec: EvalSpec) -> System:
    """System of a specification, else imported predictions or the pipeline itself."""
    return spec.system or (ImportedPredictions() if spec.options.get("predictions") is not None else OwnPipeline())


def confidence_of(spec: EvalSpec) -> float:
    """Score of objects added by the oracle RECALL."""
    return DEFAULT_CONFIDENCE if spec.confidence is None else spec.confidence


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
        file = file_of(source)
        copyfile(file.path, folder / PREDICTIONS_FILE)
        options = spec.options | {"predictions": out / PREDICTIONS_FILE}
        return replace(spec, options=options), {"imported": file.record()}

    def decided(self, spec: EvalSpec, source: Pipeline, labels: Labels) -> tuple[ImportedPredictions, tuple[str, ...]]:
        return self, ()

    def open(self, spec: EvalSpec, source: Pipeline, labels: Labels, clock: StageClock) -> Records:
        class_names, file = class_names_of(labels), file_of(source)
        maps = spec.maps(source.dataset)

        def records(truth: FrameCases, given: PreparedFrame | None) -> list[dict[str, Any]]:
            cases = tuple(c for c in truth.cases if file.line(truth.frame, c.text) is not None)
            if not cases:
                return []
            truth = replace(truth, cases=cases)
            context = context_of(source, truth, given, clock, boxes=True)
            return [_row(spec, source, truth, case, context, class_names, clock, maps) for case in cases]

        return records


def _row(
    spec: EvalSpec,
    source: Pipeline,
    truth: FrameCases,
    case: Case,
    context: PreparedFrame,
    class_names: tuple[str, ...],
    clock: StageClock,
    maps: SceneMaps | None,
) -> dict[str, Any]:
    """Record of an expression."""
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
        found = found if maps is None else maps.judged(found)
        row |= diagnosis_columns(found) | {"worked_out": _worked_out(file, found, case, line)}
    return row


def _worked_out(file: Predictions, found: Diagnosis, case: Case, line: Prediction) -> list[str] | None:
    """Numbers of the answer and of the right pair without a place in the file; None for none."""
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
    """Query as read by the system, else as meant; our own runs read for themselves."""
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
    """Row of an answer without a known ranking: the answer's place, and the right proposals."""
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
        "parse_ok": True if row["parse_ok"] is None else row["parse_ok"],
        "problem": line.problem or row["problem"],
        "iou": iou,
        "strict_iou": strict,
        "set_iou": lenient,
        "correct": iou >= HIT,
        "strict_correct": strict >= HIT,
        "set_correct": lenient >= HIT,
        "box": None if box is None else box.tolist(),
        "matched_target": None if at < 0 else at,
    }
    if line.answer is None:
        row |= {"reference_correct": False, "pair_correct": False}
    return row
