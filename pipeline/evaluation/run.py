"""Running an evaluation: every expression of the labels through the pipeline, frame by frame, in many processes."""

from __future__ import annotations

import multiprocessing
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from pipeline.errors import InputError
from pipeline.evaluation.answering import FrameAnswers
from pipeline.evaluation.cases import FrameCases, read_cases
from pipeline.evaluation.raw_scores import by_raw_scores, raw_columns
from pipeline.evaluation.records import COLUMNS, read_query, record, records_schema
from pipeline.evaluation.whole_expression import Referring, Vlm, VlmOptions, WholeExpression, record_whole
from pipeline.expression import Query
from pipeline.jobs import Source, open_source
from pipeline.labels.local import one_thread, threads_in_children
from pipeline.labels.reading import Labels, open_labels
from pipeline.objects import FrameContext

if TYPE_CHECKING:
    import pyarrow as pa

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
        Arguments of `jobs.open_source`: detector, model, srm, config, ...
    system : str
        "pipeline"; "referring", the detector fed the whole expression; or "vlm".
    vlm : VlmOptions or None
        The model behind the system "vlm".
    limit : int or None
        Only so many expressions, spread evenly over the frames.
    """

    dataset: str
    labels: str
    options: dict[str, Any] = field(default_factory=dict)
    system: System = "pipeline"
    vlm: VlmOptions | None = None
    limit: int | None = None

    def open(self) -> tuple[Source, Labels]:
        """The dataset with its models, and the labels."""
        return open_source(self.dataset, **self.options), open_labels(self.labels)


class Evaluator:
    """What a process opens once.

    Parameters
    ----------
    spec : EvalSpec
    """

    def __init__(self, spec: EvalSpec) -> None:
        self.source, self.labels = spec.open()
        self.class_names = class_names_of(self.labels)
        self.whole: WholeExpression | None = None
        if spec.system == "referring":
            self.whole = Referring(self.source.needed_detector())
        elif spec.system == "vlm":
            if spec.vlm is None:
                raise InputError("no model is named", expected="the address of a server and a model")
            self.whole = Vlm(spec.vlm)
        self._chosen = chosen_ids(self.labels, spec.limit)
        self._parsed: dict[str, tuple[Query | None, str | None]] = {}

    def frame(self, truth: FrameCases) -> list[dict[str, Any]]:
        """The records of a frame's expressions.

        Raises
        ------
        InputError
            The dataset has no such frame, or it cannot be used any more.
        """
        if self._chosen is not None:
            kept = tuple(c for c in truth.cases if (truth.frame_index, c.id) in self._chosen)
            truth = replace(truth, cases=kept)
        if not truth.cases:
            return []
        frame = self.source.dataset.load(truth.frame)
        if self.whole is not None:
            pointed = self.whole.point(frame, [case.text for case in truth.cases])
            return [record_whole(c, truth, p) for c, p in zip(truth.cases, pointed, strict=True)]
        context = FrameContext(frame, self.source.config.lift)
        names = dict.fromkeys(name for case in truth.cases for name in (case.target, case.reference))
        relations = {case.relation for case in truth.cases}
        answers = FrameAnswers(self.source, context, tuple(names), relations)
        raw = by_raw_scores(answers)
        rows = []
        for case in truth.cases:
            if case.text not in self._parsed:
                self._parsed[case.text] = read_query(case, self.class_names)
            rows.append(record(case, truth, answers, self._parsed[case.text]))
            if raw is not None:
                rows[-1] |= raw_columns(case, truth, answers, raw, self._parsed[case.text])
        return rows

    def block(self, first: int, stop: int) -> pa.Table:
        """The records of the frames from index `first` up to `stop`."""
        return table_of([row for truth in read_cases(self.labels, first, stop) for row in self.frame(truth)])


def class_names_of(labels: Labels) -> tuple[str, ...]:
    """The class names of the labelled objects, in order."""
    import pyarrow.parquet as pq

    column = pq.read_table(labels.root / "objects.parquet", columns=["label"]).column("label")
    return tuple(sorted(column.unique().to_pylist()))


def chosen_ids(labels: Labels, limit: int | None) -> set[tuple[int, str]] | None:
    """Which expressions are asked under a limit, evenly over all of them; None for all."""
    import pyarrow.parquet as pq

    if limit is None:
        return None
    rows = pq.read_table(labels.root / "expressions.parquet", columns=["frame_index", "id"])
    at = np.unique(np.linspace(0, rows.num_rows - 1, min(max(limit, 1), rows.num_rows)).astype(int))
    chosen = rows.take(at)
    return set(zip(chosen.column("frame_index").to_pylist(), chosen.column("id").to_pylist(), strict=True))


def table_of(rows: Sequence[dict[str, Any]]) -> pa.Table:
    """Records as an Arrow table."""
    import pyarrow as pa

    return pa.table({name: [row[name] for row in rows] for name in COLUMNS}, records_schema())


def frames_with_expressions(labels: Labels) -> np.ndarray:
    """Indices of the frames that are asked something, in order."""
    import pyarrow.parquet as pq

    column = pq.read_table(labels.root / "expressions.parquet", columns=["frame_index"]).column("frame_index")
    return np.unique(column.to_numpy())


def blocks_of(labels: Labels, only: np.ndarray | None = None) -> tuple[tuple[int, int], ...]:
    """Runs of frame indices that are evaluated together."""
    index = frames_with_expressions(labels)
    if only is not None:
        index = index[np.isin(index, only)]
    parts = [index[k : k + FRAMES_A_BLOCK] for k in range(0, len(index), FRAMES_A_BLOCK)]
    return tuple((int(p[0]), int(p[-1]) + 1) for p in parts)


def evaluate_labels(spec: EvalSpec, *, workers: int = 1, progress: Progress | None = None) -> Iterator[pa.Table]:
    """The records of all expressions, block by block, in the labels' order.

    The rows do not depend on the number of workers.

    Raises
    ------
    InputError
        Nothing can be evaluated, a frame of the labels cannot be used, or a worker was killed.
    """
    _, labels = spec.open()
    blocks = blocks_of(labels)
    if not blocks:
        raise InputError("these labels have no expressions", path=labels.root)
    total = min(labels.manifest.counts["expressions"], spec.limit or labels.manifest.counts["expressions"])
    # A server is asked by threads of one process.
    workers = 1 if spec.system == "vlm" else workers
    done = 0
    for table in _tables(spec, blocks, workers):
        done += table.num_rows
        if progress is not None:
            progress(done, total)
        yield table


def _tables(spec: EvalSpec, blocks: Sequence[tuple[int, int]], workers: int) -> Iterator[pa.Table]:
    if workers <= 1 or len(blocks) <= 1:
        with one_thread():
            evaluator = Evaluator(spec)
            for block in blocks:
                yield evaluator.block(*block)
        return
    with threads_in_children():
        pool = ProcessPoolExecutor(
            min(workers, len(blocks)), multiprocessing.get_context("spawn"), _start, (spec,)
        )
        try:
            yield from pool.map(_block, blocks)
        except BrokenProcessPool as error:
            raise InputError("a worker process died", cause="out of memory? use fewer workers") from error
        finally:
            pool.shutdown(wait=False, cancel_futures=True)


_evaluator: Evaluator | None = None
"""What a worker process opened when it started."""


def _start(spec: EvalSpec) -> None:
    global _evaluator
    import signal

    import cv2

    signal.signal(signal.SIGINT, signal.SIG_IGN)
    cv2.setNumThreads(1)
    _evaluator = Evaluator(spec)


def _block(block: tuple[int, int]) -> pa.Table:
    assert _evaluator is not None
    return _evaluator.block(*block)


def write_records(tables: Iterator[pa.Table], path: Path) -> int:
    """Write records as they come, whole or not at all; how many."""
    import os

    import pyarrow.parquet as pq

    temporary = path.with_name(f".{path.name}.{os.getpid()}.tmp")
    rows = 0
    try:
        with pq.ParquetWriter(temporary, records_schema(), compression="zstd") as writer:
            for table in tables:
                writer.write_table(table)
                rows += table.num_rows
        os.replace(temporary, path)
    finally:
        temporary.unlink(missing_ok=True)
    return rows
