"""Evaluation: what verdicts cost, what answering by frames saves, and searching a large run."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from time import perf_counter, process_time
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq

from pipeline.answering import open_pipeline, record_detections
from pipeline.bench.clock import Figure, Setup, least, resident_mb
from pipeline.datasets import demo_run
from pipeline.evaluation import EvalSpec, RunRows, open_run
from pipeline.evaluation.relation_cases import frames_in, spread
from pipeline.evaluation.run import Evaluator, blocks_of
from pipeline.labels import SourceSpec, label_dataset, open_labels
from pipeline.system.whole_files import scratch_folder
from pipeline.system.worker_pool import one_thread

try:
    from pipeline.evaluation.records_file import open_records
except ImportError:

    def open_records(run: Path) -> Any:
        """Records of a run by a tree that reads them whole."""
        return open_run(run).records


GOAL, CORES, RECORDS = 50_000, 2, 500_000
SINGLY = 48
P_TOLERANCE = 1e-5
"""Records keep probabilities as float32, and a network's sums depend on how many pairs it is given at once."""
SEARCH = "verdict:SRM relation:behind margin<0.5 sort:margin"
SQL = "SELECT id FROM read_parquet(?) WHERE verdict = 'SRM' AND relation = 'behind' AND margin < 0.5 ORDER BY margin"


def measure(setup: Setup) -> Iterator[Figure]:
    """Measure evaluation of recorded proposals in processor seconds, scaled to 50,000 expressions on two cores."""
    with scratch_folder() as folder:
        # First, while this process holds little else.
        yield from search(folder, RECORDS // 10 if setup.quick else RECORDS, setup)
        with one_thread():
            spec = made(folder, 300 if setup.quick else None)
            evaluator, records, seconds, alone = answered(spec)
            scale = GOAL / records.num_rows / CORES
            yield "eval.verdicts", seconds * scale, alone * scale
            rate, differing = asked_singly(evaluator, records, setup.times(SINGLY, 8))
            if differing:
                yield "eval.singly", f"{len(differing)} of {SINGLY} answers differ", None
            else:
                yield "eval.singly", records.num_rows / alone, rate


def made(folder: Path, limit: int | None = None, frames: int | None = None) -> EvalSpec:
    """Labels and recorded proposals (simulated detector) of the demo."""
    labels, recording = folder / "labels", folder / "recording"
    label_dataset(SourceSpec("demo"), labels, limit=frames)
    source = open_pipeline("demo", detector="simulated", srm="rule")
    asked = open_labels(labels).expressions.column("frame").unique().to_pylist()
    record_detections(source, recording, source.dataset.class_names, frame_ids=asked)
    return EvalSpec("demo", str(labels), {"detector": "recorded", "model": recording}, limit=limit)


def answered(spec: EvalSpec) -> tuple[Evaluator, pa.Table, float, float]:
    """Every expression, with verdicts and without, block by block: the evaluator, the records, seconds of each."""
    both = [Evaluator(replace(spec, verdicts=verdicts)) for verdicts in (True, False)]
    blocks = blocks_of(frames_in(both[0].labels, "expressions"), 1)
    seconds, tables = [0.0, 0.0], []
    for k, block in enumerate([blocks[0], *blocks]):
        for at, evaluator in enumerate(both):
            start = process_time()
            table, _ = evaluator.block(*block)
            # The first frame pays for imports and for the network's own preparations.
            if k:
                seconds[at] += process_time() - start
                tables += [table] if at == 0 else []
    return both[0], pa.concat_tables(tables), seconds[0], seconds[1]


def asked_singly(evaluator: Evaluator, records: pa.Table, count: int) -> tuple[float, list[str]]:
    """Expressions a second asked by `ask`, each with its frame read anew; ids of answers unlike those of the records.

    An expression that is not read as the labels mean it has no answer in the records and is left out.
    """
    source = evaluator.source
    read = records.filter(records.column("parse_ok"))
    chosen = read.take(spread(read.num_rows, count)).to_pylist()
    seconds, differ = 0.0, []
    for row in chosen:
        start = process_time()
        trace = source.ask(source.dataset.load(row["frame"]), row["text"])
        seconds += process_time() - start
        if not _same_answer(row, trace):
            differ.append(row["id"])
    return len(chosen) / seconds, differ


def _same_answer(row: dict[str, Any], trace: Any) -> bool:
    """Whether an answer of `ask` has the boxes of a record, and its relation the probability."""
    if trace.ranking is None:
        return row["box"] is None
    if trace.ranking.degenerate:
        return row["degenerate"] and row["box"] == trace.objects[trace.ranking.pairs[0].target].bbox.tolist()
    best = trace.ranking.pairs[0]
    boxes = [trace.objects[k].bbox.tolist() for k in (best.target, best.reference)]
    return [row["box"], row["reference_box"]] == boxes and abs(row["p_relation"] - best.p_relation) < P_TOLERANCE


def search(folder: Path, rows: int, setup: Setup) -> Iterator[Figure]:
    """Measure a search of so many records, scaled to 500,000, beside DuckDB on their file; and their memory."""
    import duckdb

    run, file = folder / "run", folder / "run" / "records.parquet"
    large_run(run, rows)
    before, scale = resident_mb(), RECORDS / rows
    found = RunRows(open_records(run), run)
    hits = len(found.find(SEARCH))
    held = resident_mb() - before
    ours = least(lambda: found.find(SEARCH), setup.times(9), perf_counter)
    with duckdb.connect(config={"threads": 1}) as link:
        theirs = least(lambda: link.execute(SQL, [str(file)]).fetchall(), setup.times(9), perf_counter)
        assert len(link.execute(SQL, [str(file)]).fetchall()) == hits
    yield "eval.search", ours * 1000 * scale, theirs * 1000 * scale
    yield "eval.memory", held * scale, file.stat().st_size / 2**20 * scale


def large_run(run: Path, rows: int) -> None:
    """Write the demo's run with its records again and again until there are so many; ids stay apart."""
    source = Path(demo_run())
    run.mkdir()
    (run / "run.json").write_bytes((source / "run.json").read_bytes())
    table = pq.read_table(source / "records.parquet")
    at, ids = table.schema.get_field_index("id"), table.column("id").to_pylist()
    with pq.ParquetWriter(run / "records.parquet", table.schema) as writer:
        # As large as those that an evaluation writes.
        copies = -(-4096 // len(ids))
        names = [name for _ in range(copies) for name in ids]
        block = pa.concat_tables([table] * copies)
        for first in range(0, rows, len(names)):
            own = [f"{first + k}.{name}" for k, name in enumerate(names)]
            writer.write_table(block.set_column(at, "id", [own]).slice(0, rows - first))
