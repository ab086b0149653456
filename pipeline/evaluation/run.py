"""Running an evaluation: every expression of the labels through the pipeline, frame by frame, in many processes."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from pipeline.answering.ask import propose
from pipeline.answering.batch import StageClock
from pipeline.answering.objects import PreparedFrame, prepare_frame
from pipeline.answering.pipeline import Pipeline
from pipeline.evaluation.records import COLUMNS, records_schema
from pipeline.evaluation.relation_cases import frames_in, spread
from pipeline.evaluation.relation_records import RelationPass
from pipeline.evaluation.systems import EvalSpec, system_of
from pipeline.geometry.boxes import iou_2d
from pipeline.labels.cases import HIT, FrameCases, read_cases
from pipeline.labels.reading import Labels, read_table
from pipeline.system.arrow import pa
from pipeline.system.errors import InputError, require
from pipeline.system.worker_pool import results_of

LOOKED_AT = 64
"""Frames that are looked at, spread evenly over those with expressions: to detect in all would double the cost."""

FRAMES_A_BLOCK = 24
Progress = Callable[[int, int], None]
"""Called with (expressions done, expressions in all)."""


class Evaluator:
    """What a process opens once."""

    def __init__(self, spec: EvalSpec) -> None:
        self.spec = spec
        self.source, self.labels = spec.open()
        self.clock = StageClock()
        self.records = system_of(spec).open(spec, self.source, self.labels, self.clock) if spec.grounding else None
        self.relations: RelationPass | None = None
        if spec.relations is not None:
            chosen = frames_in(self.labels, "relations", spec.relations.frames)
            self.relations = RelationPass(spec.relations, spec.options, self.labels, chosen.tolist())
        self._chosen = chosen_ids(self.labels, spec.limit)

    def frame(self, truth: FrameCases, context: PreparedFrame | None = None) -> list[dict[str, Any]]:
        """Records of a frame's expressions; the frame is loaded unless given.

        Raises InputError: the dataset has no such frame, or it cannot be used any more.
        """
        if self._chosen is not None:
            kept = tuple(c for c in truth.cases if (truth.frame_index, c.id) in self._chosen)
            truth = replace(truth, cases=kept)
        return self.records(truth, context) if truth.cases and self.records is not None else []

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


def chosen_ids(labels: Labels, limit: int | None) -> set[tuple[int, str]] | None:
    """Expressions to ask under a limit, evenly over all; None for all."""
    if limit is None:
        return None
    rows = read_table(labels.root / "expressions.parquet", "expressions", ["frame_index", "id"])
    chosen = rows.take(spread(rows.num_rows, limit))
    return set(zip(chosen.column("frame_index").to_pylist(), chosen.column("id").to_pylist(), strict=True))


def table_of(rows: Sequence[dict[str, Any]]) -> pa.Table:
    """Records as an Arrow table."""
    return pa.table({name: [row[name] for row in rows] for name in COLUMNS}, records_schema())


def blocks_of(index: np.ndarray, frames: int = FRAMES_A_BLOCK) -> tuple[tuple[int, int], ...]:
    """Split frame indices (rising) into blocks to evaluate together."""
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

    `relations`: is given the relation records (see `relation_records`), block by block. Without it there are none.

    Raises InputError: nothing can be evaluated, a frame of the labels cannot be used, or a worker was killed.
    """
    spec = spec if relations is not None else replace(spec, relations=None)
    _, labels = spec.open()
    asked = frames_in(labels, "expressions") if spec.grounding else np.zeros(0, np.int64)
    require(
        not spec.grounding or len(asked),
        "these labels have no expressions",
        expected="some made by `label`, or kept on the page: ask, then press *This pair is correct*",
        path=labels.root,
    )
    paired = np.zeros(0, np.int64)
    if spec.relations is not None:
        paired = frames_in(labels, "relations", spec.relations.frames)
        require(len(paired), "these labels have no pairs of objects", path=labels.root)
    index = np.union1d(asked, paired)
    total = len(index)
    if spec.grounding:
        total = min(labels.manifest.counts["expressions"], spec.limit or labels.manifest.counts["expressions"])
    workers = workers if system_of(spec).processes else 1
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
    """(M,) float64: scores of candidates of the right class, over a frame's names."""
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
    """Median score of right candidates, None without any, and their number.

    `looked_at`: frames that are looked at, spread evenly.
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
