"""Systems that answer expressions: the protocol that an evaluation knows, and the pipeline's own."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from pipeline.answering.answering import FrameAnswers, StageClock
from pipeline.answering.imported import open_source
from pipeline.answering.objects import PreparedFrame, prepare_frame
from pipeline.answering.opening import Pipeline
from pipeline.datasets import Dataset
from pipeline.datasets.base import load_picture
from pipeline.diagnosis.decision import diagnose
from pipeline.diagnosis.frame_evidence import DEFAULT_CONFIDENCE, FrameEvidence
from pipeline.evaluation.records import by_raw_scores, diagnosis_columns, raw_columns, record
from pipeline.evaluation.relation_cases import RelationSpec
from pipeline.evaluation.relation_records import RelationRecords, SystemRecords
from pipeline.evaluation.shared_makers import Measured, measured_of
from pipeline.geometry.boxes import iou_2d
from pipeline.labels.cases import FrameCases, read_query
from pipeline.labels.reading import Labels, open_labels, read_table
from pipeline.language.tree import Query
from pipeline.proposals.base import reads_annotations
from pipeline.system.errors import InputError

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
        """Whether several processes may ask at once."""
        ...

    def title(self, source: Pipeline) -> str:
        """Name of the row in tables."""
        ...

    def measured(self, source: Pipeline, relations: Sequence[str]) -> Measured:
        """Parts that labels may share."""
        ...

    def open(self, spec: EvalSpec, source: Pipeline, labels: Labels, clock: StageClock) -> Records:
        """Open models once for a process."""
        ...

    def kept(self, spec: EvalSpec, source: Pipeline, folder: Path, out: Path) -> tuple[EvalSpec, dict[str, Any]]:
        """Copy into a run's folder (`out`, written as `folder`) what answers were read from.

        Returns
        -------
        spec : EvalSpec
            Of the copy.
        record : dict
            Further keys of `run.json`.
        """
        ...


class PairSystem(Protocol):
    """A system that is asked about a sample of labelled pairs."""

    def record(self) -> dict[str, Any]:
        """As JSON: `vlm` of `run.json`."""
        ...

    def ask(
        self, how: RelationSpec, dataset: Dataset, labels: Labels, records: RelationRecords, counted: np.ndarray,
        folder: Path,
    ) -> AskedPairs:  # fmt: skip
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
    """An evaluation as plain values that a process can be given.

    Attributes
    ----------
    dataset : str
    labels : str
    options : dict
        Arguments of `open_pipeline`: detector, model, srm, config, ...
    system : System or None
        By default the pipeline, or with the option `predictions` what another pipeline gave.
    pairs : PairSystem or None
        Asked about labelled pairs beside the relation scorers.
    limit : int or None
        Only so many expressions, spread evenly over the frames.
    grounding : bool
        Answer the expressions.
    relations : RelationSpec or None
        Measure relations alone too, and how.
    confidence : float or None
        Score of an object that the oracle RECALL adds: the median of the run's right detections.
    verdicts : bool
        Diagnose each expression; without, the evaluation is a third cheaper.
    marks : dict
        Labels that a person marked: (frame, id of the expression) -> "BAD_LABEL" or "BAD_BOX".
    """

    dataset: str
    labels: str
    options: dict[str, Any] = field(default_factory=dict)
    system: System | None = None
    pairs: PairSystem | None = None
    limit: int | None = None
    grounding: bool = True
    relations: RelationSpec | None = None
    confidence: float | None = None
    verdicts: bool = True
    marks: dict[tuple[str, str], str] = field(default_factory=dict)

    def open(self) -> tuple[Pipeline, Labels]:
        """Dataset with its models, and labels."""
        return open_source(self.dataset, **self.options), open_labels(self.labels)


def context_of(
    source: Pipeline, truth: FrameCases, given: PreparedFrame | None, clock: StageClock, boxes: bool = False
) -> PreparedFrame:
    """A frame ready to be asked about, loaded where it is not given; InputError where it is not that of the labels."""
    if given is not None:
        truth.check_picture(given.frame)
        return given
    with clock.stage("read"):
        # Where nobody looks at the annotations, their masks are the most of what there would be to decode.
        load = source.dataset.load if reads_annotations(source.needed_detector()) else _picture_of(source.dataset)
        frame = load(truth.frame)
    truth.check_picture(frame)
    with clock.stage("lift"):
        return prepare_frame(source.dataset, frame, source.config.lift, boxes=boxes)


def _picture_of(dataset: Dataset) -> Callable[[str], Any]:
    return lambda frame: load_picture(dataset, frame)


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

    def open(self, spec: EvalSpec, source: Pipeline, labels: Labels, clock: StageClock) -> Records:
        class_names = class_names_of(labels)
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
                raw = by_raw_scores(answers)
                if raw is not None:
                    for case, row in zip(truth.cases, rows, strict=True):
                        row |= raw_columns(case, truth, answers, raw, parsed[case.text], overlap)
            if not spec.verdicts:
                return rows
            with clock.stage("verdicts"):
                evidence = FrameEvidence(truth, answers, confidence_of(spec))
                for case, row in zip(truth.cases, rows, strict=True):
                    mark, (query, problem) = spec.marks.get((row["frame"], case.id)), parsed[case.text]
                    row |= diagnosis_columns(
                        diagnose(evidence, case, parse_ok=row["parse_ok"], mark=mark, query=query, problem=problem)
                    )
            return rows

        return records


def confidence_of(spec: EvalSpec) -> float:
    """Score of an object that the oracle RECALL adds."""
    return DEFAULT_CONFIDENCE if spec.confidence is None else spec.confidence
