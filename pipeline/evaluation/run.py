"""Running an evaluation: every expression of the labels through the pipeline, frame by frame, in many processes."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Literal

import numpy as np

from pipeline.answering.answering import FrameAnswers, StageClock
from pipeline.answering.ask import propose
from pipeline.answering.imported import ImportedPipeline, open_source
from pipeline.answering.objects import PreparedFrame, prepare_frame
from pipeline.answering.opening import Pipeline
from pipeline.datasets.base import load_picture
from pipeline.diagnosis.decision import diagnose
from pipeline.diagnosis.frame_evidence import DEFAULT_CONFIDENCE, FrameEvidence, matched
from pipeline.evaluation.imported_rows import imported_rows, told_cases
from pipeline.evaluation.records import (
    COLUMNS,
    asked_columns,
    by_raw_scores,
    diagnosis_columns,
    overlaps,
    raw_columns,
    record,
    records_schema,
)
from pipeline.evaluation.relation_cases import RelationSpec, frames_in, spread
from pipeline.evaluation.relation_records import RelationPass
from pipeline.evaluation.vlm.questions import GroundingConfig, ground_many
from pipeline.geometry.boxes import iou_2d
from pipeline.geometry.frame import Frame
from pipeline.labels.cases import HIT, Case, FrameCases, read_cases, read_query
from pipeline.labels.reading import Labels, open_labels, read_table
from pipeline.language.tree import Query
from pipeline.proposals.base import Detector, detect_expression, reads_annotations
from pipeline.system.arrow import pa
from pipeline.system.chat import ChatClient
from pipeline.system.errors import InputError, require
from pipeline.system.worker_pool import results_of

LOOKED_AT = 64
"""Frames that are looked at, spread evenly over those with expressions: to detect in all would double the cost."""

FRAMES_A_BLOCK = 24
System = Literal["pipeline", "referring", "vlm"]
Progress = Callable[[int, int], None]
"""Called with (expressions done, expressions in all)."""


@dataclass(frozen=True)
class EvalSpec:
    """What is evaluated on what, as plain values that a process can be given.

    Attributes
    ----------
    dataset : str
    labels : str
    options : dict
        Arguments of `open_pipeline`: detector, model, srm, config, ...
    system : str
        "pipeline"; "referring", the detector fed the whole expression; or "vlm".
    vlm : VlmOptions or None
        The model behind the system "vlm".
    limit : int or None
        Only so many expressions, spread evenly over the frames.
    grounding : bool
        Answer the expressions.
    relations : RelationSpec or None
        Measure relations alone too, and how.
    confidence : float or None
        Score of an object that the oracle RECALL adds: the median of the run's right detections.
    verdicts : bool
        Say of each expression which module failed; without, the evaluation is a third cheaper.
    marks : dict
        Labels that a person marked: (frame, id of the expression) -> "BAD_LABEL" or "BAD_BOX".
    """

    dataset: str
    labels: str
    options: dict[str, Any] = field(default_factory=dict)
    system: System = "pipeline"
    vlm: VlmOptions | None = None
    limit: int | None = None
    grounding: bool = True
    relations: RelationSpec | None = None
    confidence: float | None = None
    verdicts: bool = True
    marks: dict[tuple[str, str], str] = field(default_factory=dict)

    def open(self) -> tuple[Pipeline, Labels]:
        """The dataset with its models, and the labels."""
        return open_source(self.dataset, **self.options), open_labels(self.labels)


class Evaluator:
    """What a process opens once.

    Parameters
    ----------
    spec : EvalSpec
    """

    def __init__(self, spec: EvalSpec) -> None:
        self.spec = spec
        self.source, self.labels = spec.open()
        self.class_names = class_names_of(self.labels)
        self.whole: Referring | Vlm | None = None
        if spec.grounding and spec.system == "referring":
            self.whole = Referring(self.source.needed_detector())
        if spec.grounding and spec.system == "vlm":
            if spec.vlm is None:
                raise InputError("no model is named", expected="the address of a server and a model")
            self.whole = Vlm(spec.vlm)
        self.clock = StageClock()
        self.relations: RelationPass | None = None
        if spec.relations is not None:
            chosen = frames_in(self.labels, "relations", spec.relations.frames)
            self.relations = RelationPass(spec.relations, spec.options, self.labels, chosen.tolist())
        self._chosen = chosen_ids(self.labels, spec.limit)
        self.parsed: dict[str, tuple[Query | None, InputError | None]] = {}

    def frame(self, truth: FrameCases, context: PreparedFrame | None = None) -> list[dict[str, Any]]:
        """The records of a frame's expressions; the frame is loaded where it is not given.

        Raises
        ------
        InputError
            The dataset has no such frame, or it cannot be used any more.
        """
        if self._chosen is not None:
            kept = tuple(c for c in truth.cases if (truth.frame_index, c.id) in self._chosen)
            truth = replace(truth, cases=kept)
        if isinstance(self.source, ImportedPipeline):
            truth = told_cases(self.source, truth)
        if not truth.cases:
            return []
        if context is not None:
            frame = context.frame
        else:
            with self.clock.stage("read"):
                # Where nobody looks at the annotations, their masks are the most of what there would be to decode.
                bare = self.whole is None and not reads_annotations(self.source.needed_detector())
                dataset = self.source.dataset
                frame = load_picture(dataset, truth.frame) if bare else dataset.load(truth.frame)
        truth.check_picture(frame)
        if self.whole is not None:
            pointed = self.whole.point(frame, [case.text for case in truth.cases])
            return [record_whole(c, truth, p) for c, p in zip(truth.cases, pointed, strict=True)]
        if context is None:
            # No answer depends on 3D boxes: features that are made of boxes fit them to the points themselves.
            boxes = isinstance(self.source, ImportedPipeline)
            with self.clock.stage("lift"):
                context = prepare_frame(self.source.dataset, frame, self.source.config.lift, boxes=boxes)
        if isinstance(self.source, ImportedPipeline):
            spec = self.spec
            return imported_rows(
                self.source, truth, context, self.class_names, confidence=spec.confidence, marks=spec.marks,
                verdicts=spec.verdicts, clock=self.clock,
            )  # fmt: skip
        names = dict.fromkeys(name for case in truth.cases for name in (case.target, case.reference))
        relations = {case.relation for case in truth.cases}
        answers = FrameAnswers(self.source, context, tuple(names), relations, self.clock)
        with self.clock.stage("parse"):
            for case in truth.cases:
                if case.text not in self.parsed:
                    self.parsed[case.text] = read_query(case, self.class_names)
        with self.clock.stage("records"):
            overlap = iou_2d(answers.boxes, truth.boxes)
            rows = [record(case, truth, answers, self.parsed[case.text], overlap) for case in truth.cases]
            raw = by_raw_scores(answers)
            if raw is not None:
                for case, row in zip(truth.cases, rows, strict=True):
                    row |= raw_columns(case, truth, answers, raw, self.parsed[case.text], overlap)
        if not self.spec.verdicts:
            return rows
        with self.clock.stage("verdicts"):
            confidence = DEFAULT_CONFIDENCE if self.spec.confidence is None else self.spec.confidence
            evidence = FrameEvidence(truth, answers, confidence)
            for case, row in zip(truth.cases, rows, strict=True):
                mark, (query, problem) = self.spec.marks.get((row["frame"], case.id)), self.parsed[case.text]
                row |= diagnosis_columns(
                    diagnose(evidence, case, parse_ok=row["parse_ok"], mark=mark, query=query, problem=problem)
                )
        return rows

    def block(self, first: int, stop: int) -> tuple[pa.Table, pa.Table | None]:
        """The records of the frames from index `first` up to `stop`: of expressions, and of pairs where asked for."""
        with self.clock.stage("read"):
            cases = {t.frame_index: t for t in read_cases(self.labels, first, stop)} if self.spec.grounding else {}
            pairs = {} if self.relations is None else self.relations.cases(first, stop)
        rows: list[dict[str, Any]] = []
        tables = []
        for index in sorted(cases.keys() | pairs.keys()):
            context = None
            if self.relations is not None and index in pairs:
                if self.relations.needs_frames:
                    frame = self.source.dataset.load(pairs[index].key.frame)
                    context = prepare_frame(self.source.dataset, frame, self.source.config.lift)
                tables.append(self.relations.table(self.source, pairs[index], context))
            if index in cases:
                rows += self.frame(cases[index], context)
        with self.clock.stage("records"):
            return table_of(rows), pa.concat_tables(tables) if tables else None


def class_names_of(labels: Labels) -> tuple[str, ...]:
    """The class names of the labelled objects, in order."""
    column = read_table(labels.root / "objects.parquet", "objects", ["label"]).column("label")
    return tuple(sorted(column.unique().to_pylist()))


def chosen_ids(labels: Labels, limit: int | None) -> set[tuple[int, str]] | None:
    """Which expressions are asked under a limit, evenly over all of them; None for all."""
    if limit is None:
        return None
    rows = read_table(labels.root / "expressions.parquet", "expressions", ["frame_index", "id"])
    chosen = rows.take(spread(rows.num_rows, limit))
    return set(zip(chosen.column("frame_index").to_pylist(), chosen.column("id").to_pylist(), strict=True))


def table_of(rows: Sequence[dict[str, Any]]) -> pa.Table:
    """Records as an Arrow table."""
    return pa.table({name: [row[name] for row in rows] for name in COLUMNS}, records_schema())


def blocks_of(index: np.ndarray, frames: int = FRAMES_A_BLOCK) -> tuple[tuple[int, int], ...]:
    """Runs of these frame indices (rising) that are evaluated together."""
    parts = [index[k : k + frames] for k in range(0, len(index), frames)]
    return tuple((int(p[0]), int(p[-1]) + 1) for p in parts)


def evaluate_labels(
    spec: EvalSpec,
    *,
    workers: int = 1,
    progress: Progress | None = None,
    relations: Callable[[pa.Table], None] | None = None,
    frames_a_block: int = FRAMES_A_BLOCK,
) -> Iterator[pa.Table]:
    """The records of all expressions, block by block, in the labels' order.

    The rows do not depend on the number of workers, nor on how many frames make a block.

    Parameters
    ----------
    spec : EvalSpec
    workers : int
    progress : callable, optional
        Counts expressions; frames where no expression is asked.
    relations : callable, optional
        Is given the relation records (see `relation_records`), block by block. Without it there are none.

    Raises
    ------
    InputError
        Nothing can be evaluated, a frame of the labels cannot be used, or a worker was killed.
    """
    spec = spec if relations is not None else replace(spec, relations=None)
    _, labels = spec.open()
    asked = frames_in(labels, "expressions") if spec.grounding else np.zeros(0, np.int64)
    require(not (spec.grounding and not len(asked)), "these labels have no expressions", path=labels.root)
    paired = np.zeros(0, np.int64)
    if spec.relations is not None:
        paired = frames_in(labels, "relations", spec.relations.frames)
        require(len(paired), "these labels have no pairs of objects", path=labels.root)
    index = np.union1d(asked, paired)
    total = len(index)
    if spec.grounding:
        total = min(labels.manifest.counts["expressions"], spec.limit or labels.manifest.counts["expressions"])
    # A server is asked by threads of one process.
    workers = 1 if spec.system == "vlm" else workers
    done = 0
    blocks = blocks_of(index, frames_a_block)
    tables = results_of(_block, blocks, workers, prepare=_opened, arguments=(spec,))
    for (first, stop), (table, pairs) in zip(blocks, tables, strict=True):
        if relations is not None and pairs is not None:
            relations(pairs)
        done += table.num_rows if spec.grounding else int(((index >= first) & (index < stop)).sum())
        if progress is not None:
            progress(done, total)
        yield table


def _opened(spec: EvalSpec) -> tuple[Evaluator]:
    return (Evaluator(spec),)


def _block(block: tuple[int, int], evaluator: Evaluator) -> tuple[pa.Table, pa.Table | None]:
    return evaluator.block(*block)


def right_scores(source: Pipeline, context: PreparedFrame, truth: FrameCases) -> np.ndarray:
    """(M,) float64: scores of all candidates that are objects of the class that was asked for, over a frame's names."""
    detector = source.needed_detector()
    calibration = None if detector.exact else source.config.score_calibration
    asked = {case.target: case.target_object for case in truth.cases}
    asked |= {case.reference: case.reference_object for case in truth.cases}
    found = [np.zeros(0)]
    for name, example in asked.items():
        try:
            proposals = propose(context, detector, name, source.config.k)
        except InputError:
            continue
        hit = (iou_2d(proposals.boxes, truth.boxes[truth.alike[example]]) >= HIT).any(axis=1)
        scores = proposals.scores[hit].astype(np.float64)
        found.append(scores if calibration is None else calibration.apply(scores))
    return np.concatenate(found)


def median_confidence(source: Pipeline, labels: Labels, looked_at: int = LOOKED_AT) -> tuple[float | None, int]:
    """The median score of right candidates and how many there were; None where there was none.

    Parameters
    ----------
    source : Pipeline
    labels : Labels
    looked_at : int
        Frames that are looked at, spread evenly.
    """
    found = [np.zeros(0)]
    for index in frames_in(labels, "expressions", looked_at).tolist():
        for truth in read_cases(labels, index, index + 1):
            try:
                context = prepare_frame(source.dataset, source.dataset.load(truth.frame), source.config.lift)
                found.append(right_scores(source, context, truth))
            except InputError:
                continue
    scores = np.concatenate(found)
    return (float(np.median(scores)) if len(scores) else None), len(scores)


@dataclass(frozen=True)
class Pointed:
    """Where a system says that an expression's target is.

    Attributes
    ----------
    box : (4,) float or None
        x0, y0, x1, y1, pixels.
    score : float or None
    problem : str or None
        Why there is no box.
    """

    box: np.ndarray | None
    score: float | None = None
    problem: str | None = None


@dataclass(frozen=True)
class Referring:
    """The detector fed the whole expression, as a sentence or as a class name: its best box is the answer."""

    detector: Detector

    def point(self, frame: Frame, texts: Sequence[str]) -> list[Pointed]:
        """One answer for each expression, in order."""
        found = []
        for text in texts:
            try:
                proposals = detect_expression(self.detector, frame, text)
            except InputError as error:
                found.append(Pointed(None, problem=str(error)))
                continue
            if not len(proposals):
                found.append(Pointed(None, problem="nothing detected"))
                continue
            best = int(np.argmax(proposals.scores))
            found.append(Pointed(proposals.boxes[best].astype(np.float64), float(proposals.scores[best])))
        return found


@dataclass(frozen=True)
class VlmOptions:
    """A vision-language model behind an OpenAI-compatible server.

    Attributes
    ----------
    url, model : str
    requests_per_minute : float or None
    timeout_s : float
    workers : int
        Questions in flight at once.
    box_scale : str or float
        See `pipeline.evaluation.vlm.answers.parse_box`.
    """

    url: str
    model: str
    requests_per_minute: float | None = None
    timeout_s: float = 120.0
    workers: int = 4
    box_scale: Any = "auto"


class Vlm:
    """A vision-language model, asked LLaVA's question for the box of a sentence.

    Parameters
    ----------
    options : VlmOptions

    Attributes
    ----------
    client : ChatClient
        Its `requests` are counted.
    """

    def __init__(self, options: VlmOptions) -> None:
        self.client = ChatClient(
            options.url,
            options.model,
            timeout_s=options.timeout_s,
            requests_per_minute=options.requests_per_minute,
        )
        self._config = GroundingConfig(box_scale=options.box_scale, workers=options.workers, keep_going=True)

    def point(self, frame: Frame, texts: Sequence[str]) -> list[Pointed]:
        """One answer for each expression, in order."""
        found = ground_many(self.client, frame, texts, config=self._config)
        return [Pointed(g.box, problem=g.reason if g.box is None else None) for g in found]


def record_whole(case: Case, truth: FrameCases, pointed: Pointed) -> dict[str, Any]:
    """The row of one expression: only what a system that gives one box can be measured by."""
    box = pointed.box
    overlap = iou_2d(np.zeros((0, 4)) if box is None else box[None], truth.boxes)
    iou, strict, lenient = overlaps(None if box is None else 0, case, overlap)
    row = asked_columns(case, truth) | {
        "parse_ok": True, "problem": pointed.problem, "iou": iou, "strict_iou": strict, "set_iou": lenient,
        "correct": iou >= HIT, "strict_correct": strict >= HIT, "set_correct": lenient >= HIT,
    }  # fmt: skip
    if box is not None:
        index = int(matched(overlap, truth.alike[[case.target_object]])[0])
        row |= {"box": box.tolist(), "p_target": pointed.score, "matched_target": None if index < 0 else index}
    return row
