"""Speed of evaluation and training: stage by stage, beside asking each expression by itself, and the whole job.

Stages are processor seconds of one thread, so that another program on the
machine disturbs them little; the job is measured on the wall clock, with its
processes and their memory. What is scaled to the sizes of the goal is marked as extrapolated.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from time import perf_counter, process_time
from typing import Any

import numpy as np
from benchmarks.peak_memory import PeakMemory

from pipeline.answering.detector_runs import record_detections
from pipeline.answering.pipeline import open_pipeline
from pipeline.evaluation.grounding_tables import make_tables
from pipeline.evaluation.relation_cases import frames_in, spread
from pipeline.evaluation.run import (
    FRAMES_A_BLOCK,
    Evaluator,
    blocks_of,
    evaluate_labels,
)
from pipeline.evaluation.systems import EvalSpec
from pipeline.labels.job import label_dataset, one_thread
from pipeline.labels.plan import SourceSpec
from pipeline.labels.reading import Labels, open_labels
from pipeline.language.relation_names import VOCABULARIES
from pipeline.system.arrow import pa
from pipeline.system.errors import MissingExtra, require
from pipeline.system.whole_files import scratch_folder
from pipeline.training.label_data import pair_set, read_label_data
from pipeline.training.train import TrainConfig, train_pairs

GOAL_EXPRESSIONS, GOAL_PAIRS = 50_000, 75_000
GOAL_CLUSTERS = 500
STAGES = ("read", "parse", "opm", "lift", "srm", "rank", "records", "verdicts", "tables")
P_TOLERANCE = 1e-5
"""Records keep probabilities as float32, and a network's sums depend on how many pairs it is given at once."""


def bench_evaluation(
    dataset: str = "demo",
    labels: Path | None = None,
    *,
    recording: Path | None = None,
    workers: int = 1,
    singly: int = 48,
    pairs: int = GOAL_PAIRS,
) -> dict[str, Any]:
    """Measure evaluation with recorded proposals, and training.

    Parameters
    ----------
    dataset : str
        Folder, or "demo".
    labels : Path, optional
        Its labels; made for the occasion where there are none.
    recording : Path, optional
        Recorded proposals; made with the simulated detector, K = 10, where there are none.
    workers : int
        Processes of the whole job.
    singly : int
        Expressions that are also asked one by one, spread evenly.
    pairs : int
        Training pairs; the labels' own are repeated until there are so many.

    Returns
    -------
    dict
        Counts; stages (processor seconds; `tables` at the goal's 50,000 rows); expressions_per_s;
        asked_singly with its ratio and agreement; job; training; extrapolated.

    Raises
    ------
    InputError
        Dataset, labels or recording cannot be used.
    """
    require(
        min(singly, workers) >= 1 and pairs >= 2,
        "at least one worker, one expression and two pairs are needed",
        got=f"{workers}, {singly}, {pairs}",
    )
    with _inputs(dataset, labels, recording) as spec:
        # The job first: later this process also holds what only the other measurements load.
        job = _job(spec, workers)
        with one_thread():
            evaluator, stages, records = _by_stages(spec)
            alone = _asked_singly(evaluator, records, singly)
            training = _training(evaluator.labels, pairs)
    expressions = records.num_rows
    answering = sum(seconds for name, seconds in stages.items() if name != "tables")
    rate = expressions / answering
    alone["ratio"] = round(rate / alone["expressions_per_s"], 1)
    start = max(job["seconds"] - answering / job["workers"], 0.0)
    return {
        "frames": len(records.column("frame").unique()),
        "expressions": expressions,
        "k": evaluator.source.config.k,
        "scorer": evaluator.source.scorer.name,
        "stages_s": {name: round(stages.get(name, 0.0), 4) for name in STAGES},
        "expressions_per_s": round(rate, 1),
        "asked_singly": alone,
        "job": job,
        "training": training,
        "extrapolated": {
            "workers": job["workers"],
            f"seconds_for_{GOAL_EXPRESSIONS}_expressions": round(
                start + GOAL_EXPRESSIONS / rate / job["workers"] + stages["tables"], 1
            ),
            f"seconds_for_{GOAL_PAIRS}_pairs": (
                round(GOAL_PAIRS / training["pairs_per_s"], 1) if "pairs_per_s" in training else None
            ),
        },
    }


@contextmanager
def _inputs(dataset: str, labels: Path | None, recording: Path | None) -> Iterator[EvalSpec]:
    """What is evaluated; what was not given is made in a folder that is thrown away."""
    with scratch_folder() as folder:
        if labels is None:
            labels = Path(folder) / "labels"
            label_dataset(SourceSpec(dataset), labels)
        if recording is None:
            recording = Path(folder) / "recording"
            source = open_pipeline(dataset, detector="simulated", srm="rule")
            asked = open_labels(labels).expressions.column("frame").unique().to_pylist()
            record_detections(source, recording, source.dataset.class_names, frame_ids=asked)
        yield EvalSpec(dataset, str(labels), {"detector": "recorded", "model": recording})


def _by_stages(spec: EvalSpec) -> tuple[Evaluator, dict[str, float], pa.Table]:
    """Every expression in this process, with what each stage took."""
    evaluator = Evaluator(spec)
    blocks = blocks_of(frames_in(evaluator.labels, "expressions"))
    require(blocks, "these labels have no expressions", path=evaluator.labels.root)
    # The first frame pays for imports and for the network's own preparations.
    evaluator.block(blocks[0][0], blocks[0][0] + 1)
    evaluator.clock.seconds.clear()
    records = pa.concat_tables([evaluator.block(*block)[0] for block in blocks])
    stages = dict(evaluator.clock.seconds)
    start = process_time()
    make_tables({"system": _as_many(records, GOAL_EXPRESSIONS, GOAL_CLUSTERS)})
    stages["tables"] = process_time() - start
    return evaluator, stages, records


def _as_many(records: pa.Table, rows: int, clusters: int) -> pa.Table:
    """The records repeated to so many rows in so many scenes."""
    many = records.take(np.arange(rows) % records.num_rows)
    scenes = pa.array([f"{k * clusters // rows:06d}" for k in range(rows)])
    return many.set_column(many.schema.get_field_index("scene"), "scene", scenes)


def _asked_singly(evaluator: Evaluator, records: pa.Table, count: int) -> dict[str, Any]:
    """Expressions asked by `ask`, each with its frame read anew, and whether the answers are those of the records.

    An expression that is not read as the labels mean it has no answer in the records and is left out.
    """
    source = evaluator.source
    read = records.filter(records.column("parse_ok"))
    chosen = read.take(spread(read.num_rows, count)).to_pylist()
    require(chosen, "none of the expressions can be read", path=evaluator.labels.root)
    seconds, differ = 0.0, []
    for row in chosen:
        start = process_time()
        trace = source.ask(source.dataset.load(row["frame"]), row["text"])
        seconds += process_time() - start
        if not _same_answer(row, trace):
            differ.append(row["id"])
    return {
        "expressions": len(chosen),
        "expressions_per_s": round(len(chosen) / seconds, 2),
        "same_answers": len(chosen) - len(differ),
        "differ": differ,
    }


def _same_answer(row: dict[str, Any], trace: Any) -> bool:
    """Whether an answer of `ask` has the boxes of a record, and its relation the probability."""
    if trace.ranking is None:
        return row["box"] is None
    if trace.ranking.degenerate:
        return row["degenerate"] and row["box"] == trace.objects[trace.ranking.pairs[0].target].bbox.tolist()
    best = trace.ranking.pairs[0]
    boxes = [trace.objects[k].bbox.tolist() for k in (best.target, best.reference)]
    return [row["box"], row["reference_box"]] == boxes and abs(row["p_relation"] - best.p_relation) < P_TOLERANCE


def _job(spec: EvalSpec, workers: int) -> dict[str, Any]:
    """The whole evaluation by so many processes, on the wall clock, with the memory of all of them."""
    frames = len(frames_in(open_labels(spec.labels), "expressions"))
    workers = max(1, min(workers, frames))
    # A small dataset is cut into smaller blocks, so that each process has some.
    a_block = max(1, min(FRAMES_A_BLOCK, frames // (2 * workers)))
    start = perf_counter()
    with PeakMemory() as memory:
        rows = sum(t.num_rows for t in evaluate_labels(spec, workers=workers, frames_a_block=a_block))
    seconds = perf_counter() - start
    return {
        "workers": workers,
        "seconds": round(seconds, 2),
        "expressions_per_s": round(rows / seconds, 1),
        "peak_memory_mb": None if memory.megabytes is None else round(memory.megabytes),
        "processes": memory.processes,
    }


def _training(labels: Labels, count: int) -> dict[str, Any]:
    """A network of relative extents (rel14), with the default schedule, on the labels' pairs."""
    config = TrainConfig()
    start = process_time()
    data = read_label_data(labels, config.features, VOCABULARIES[config.vocabulary])
    own = pair_set(data.frames, data.features, config.output, limit=count, seed=config.seed)
    reading = process_time() - start
    learnt = own.take(np.arange(count) % len(own))
    try:
        train_pairs(own.take(np.arange(2)), config)  # The first call pays for the import.
        start = process_time()
        model = train_pairs(learnt, config)
    except MissingExtra as error:
        return {"skipped": str(error)}
    seconds = process_time() - start
    return {
        "features": config.features,
        "pairs": model.pairs,
        "of_labels": len(own),
        "epochs": config.epochs,
        "reading_s": round(reading, 2),
        "seconds": round(seconds, 2),
        "pairs_per_s": round(model.pairs / seconds, 1),
        "last_loss": round(model.curve[-1].loss, 4),
    }


if __name__ == "__main__":
    # cd tests && python -m benchmarks.evaluation_stages [DATASET]
    import json
    import sys

    print(json.dumps(bench_evaluation((sys.argv[1:] or ["demo"])[0]), indent=2))
