"""Labelling a shard, and the engines that run it: processes of this machine with one thread each, or a Ray cluster.

On Ray Data (extra: cluster) detectors are actors, and geometry follows them as tasks.
"""

from __future__ import annotations

import logging
import pickle
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import closing
from dataclasses import asdict, dataclass, replace
from functools import lru_cache
from importlib import import_module
from time import perf_counter
from typing import Any, cast

import numpy as np

from pipeline.answering.objects import prepare_frame
from pipeline.answering.pipeline import Pipeline
from pipeline.datasets import given_expressions
from pipeline.datasets.base import scene_of
from pipeline.labels.labelling import FrameLabels, broken_frame, label_objects
from pipeline.labels.plan import LabelConfig, Plan, Shard, SourceSpec
from pipeline.labels.profiles import GIVEN, open_second_opinion
from pipeline.labels.reading import CANDIDATES, PART_TABLES, SENTENCES, arrow_schema, build_table
from pipeline.labels.sentence_maker import make_sentences, sentence_rows
from pipeline.labels.store import LabelStore
from pipeline.proposals.base import Proposals
from pipeline.relations.model import OnnxScorer
from pipeline.system.arrow import pa
from pipeline.system.errors import InputError, extra_module
from pipeline.system.worker_pool import one_thread, results_of


@dataclass(frozen=True)
class ShardReport:
    """What became of a shard."""

    name: str
    """Of its part."""
    frames: int
    objects: int = 0
    pairs: int = 0
    candidates: int = 0
    """Rows written."""
    broken: int = 0
    """Frames that could not be used."""
    seconds: float = 0.0
    """0 where it was there already."""
    reused: bool = False


@dataclass(frozen=True)
class Labeller:
    """What a process opens once and labels many frames with."""

    config: LabelConfig
    source: Pipeline
    """The dataset and what finds objects in it."""
    network: OnnxScorer | None
    """The second opinion."""


def open_labeller(spec: SourceSpec, config: LabelConfig) -> Labeller:
    """Open the dataset and the models of a plan; raises as `open_source`."""
    return Labeller(config, spec.open(config), open_second_opinion(config.second_opinion))


def label_frame(labeller: Labeller, frame_id: str, frame_index: int, found: Proposals | None = None) -> FrameLabels:
    """Label a frame; a broken frame becomes a row with the reason.

    `found` is what the detector found in the frame, where another process ran it.
    """
    source, config = labeller.source, labeller.config
    scene = scene_of(source.dataset, frame_id)
    detector = source.needed_detector()
    try:
        given = given_expressions(source.dataset, frame_id) if config.profile == GIVEN else ()
        context = prepare_frame(source.dataset, source.dataset.load(frame_id), config.lift)
        found = detector.detect(context.frame, None) if found is None else found
        if (np.diff(found.ids) < 0).any():
            found = found.take(np.argsort(found.ids, kind="stable"))
        objects = context.lift(found, detector)
    except InputError as error:
        return broken_frame(frame_id, frame_index, scene, str(error))
    labels = label_objects(
        context,
        objects,
        config,
        frame_index=frame_index,
        scene=scene,
        exact=detector.exact,
        network=labeller.network,
        given=given,
    )
    if not config.sentences:
        return labels
    class_names = source.dataset.class_names or (detector.vocabulary or ())
    made = make_sentences(context, objects, labels, config, class_names)
    return replace(labels, sentences=sentence_rows(made, frame_id, objects, detector.exact))


def detect_shard(shard: Shard, source: Pipeline) -> dict[str, Proposals]:
    """Detections in the frames of a shard; broken frames are left to the labelling."""
    detector = source.needed_detector()
    found = {}
    for frame_id in shard.frames:
        try:
            found[frame_id] = detector.detect(prepare_frame(source.dataset, source.dataset.load(frame_id)).frame, None)
        except InputError:
            continue
    return found


def shard_tables(labels: Iterable[FrameLabels], names: Sequence[str] = PART_TABLES) -> dict[str, pa.Table]:
    """The rows of many frames as Arrow tables."""
    found: dict[str, list[pa.Table]] = {name: [] for name in names}
    for frame in labels:
        for name, columns in frame.tables().items():
            if columns:
                found[name].append(build_table(name, columns))
    return {
        name: pa.concat_tables(tables).combine_chunks() if tables else arrow_schema(name).empty_table()
        for name, tables in found.items()
    }


def finished(shard: Shard, store: LabelStore) -> ShardReport | None:
    """Report of a finished shard, else None."""
    if not store.has_part(shard.name):
        return None
    record = store.part_record(shard.name)
    rows = {name: int(record["files"].get(name, {}).get("rows", 0)) for name in PART_TABLES}
    return ShardReport(shard.name, *rows.values(), broken=int(record.get("broken", 0)), reused=True)


def label_shard(
    shard: Shard, labeller: Labeller, store: LabelStore, found: Mapping[str, Proposals] | None = None
) -> ShardReport:
    """Label the frames of a shard and write a part; finished shards are left alone.

    The rows depend on the plan alone: not on the engine, nor on what else runs.
    `found` is what the detector found in its frames, where another process ran it.
    """
    there = finished(shard, store)
    if there is not None:
        return there
    start = perf_counter()
    found = found or {}
    tables = shard_tables(
        (label_frame(labeller, frame, shard.first + k, found.get(frame)) for k, frame in enumerate(shard.frames)),
        (*PART_TABLES, SENTENCES) if labeller.config.sentences else PART_TABLES,
    )
    seconds = perf_counter() - start
    broken = sum(not ok for ok in tables["frames"].column("ok").to_pylist())
    store.write_part(
        shard.name, tables, {"shard": shard.index, "key": shard.key, "broken": broken, "seconds": round(seconds, 3)}
    )
    return ShardReport(
        shard.name,
        len(shard.frames),
        tables["objects"].num_rows,
        tables["relations"].num_rows,
        tables[CANDIDATES].num_rows,
        broken,
        seconds,
    )


Done = Callable[[ShardReport], None]
"""Called with each shard's report when it is finished."""


def run_local(plan: Plan, shards: Sequence[Shard], store: LabelStore, workers: int, done: Done) -> None:
    """Label shards with so many processes; finished shards stay when the run is stopped.

    Raises InputError: a worker was killed.
    """
    reports = results_of(
        label_shard,
        shards,
        workers,
        prepare=_opened,
        arguments=(plan.spec, plan.config, store.where),
        ordered=False,
        cause="out of memory? finished shards are kept: run again with --resume",
    )
    with closing(reports):
        for report in reports:
            done(report)


def _opened(spec: SourceSpec, config: LabelConfig, where: str) -> tuple[Labeller, LabelStore]:
    return open_labeller(spec, config), LabelStore(where)


LEAST_FRAMES_A_BLOCK = 64
"""Ray Data costs milliseconds a block: smaller ones would be felt."""


@lru_cache(maxsize=1)
def _labeller(models: bytes) -> Labeller:
    return open_labeller(*pickle.loads(models))


class DetectShards:
    """Runs the detector on the frames of a shard, in an actor that holds the model for as long as the run lasts."""

    def __call__(self, row: dict[str, Any]) -> dict[str, Any]:
        shard = pickle.loads(row["shard"])
        if LabelStore(row["where"]).has_part(shard.name):
            return {**row, "found": b""}
        return {**row, "found": pickle.dumps(detect_shard(shard, _labeller(row["models"]).source))}


def label_row(row: dict[str, Any]) -> dict[str, Any]:
    """Labels a shard, from what was detected where a detector ran before."""
    found = pickle.loads(row["found"]) if row.get("found") else None
    with one_thread():
        return asdict(
            label_shard(pickle.loads(row["shard"]), _labeller(row["models"]), LabelStore(row["where"]), found)
        )


def needed_ray() -> None:
    """Raise MissingExtra where Ray is not installed."""
    extra_module("ray.data", "the engine ray", "cluster")


def run_ray(
    plan: Plan, shards: Sequence[Shard], store: LabelStore, workers: int, done: Done, *, gpus_a_detector: float = 0.0
) -> None:
    """Label shards on the connected Ray cluster, else on this machine.

    The annotations of a dataset need no detector, and the first stage is left
    out. Where the labels go, and the dataset, must be reachable from every node.

    `workers`: processors of the cluster on this machine, and detector actors at most. `gpus_a_detector`: share of a GPU
    that each detector actor is given.

    Raises MissingExtra: ray is not installed.
    """
    needed_ray()
    ray: Any = import_module("ray")
    import_module("ray.data")
    for shard in list(shards):
        there = finished(shard, store)
        if there is not None:
            done(there)
    waiting = [shard for shard in shards if not store.has_part(shard.name)]
    if not waiting:
        return
    mine = not ray.is_initialized()
    if mine:
        # Ray tells of its own workings on the terminal; what goes wrong comes back as an exception.
        for name in ("ray", "ray.data"):
            logging.getLogger(name).setLevel(logging.ERROR)
        ray.init(num_cpus=workers + 1, include_dashboard=False, log_to_driver=False, configure_logging=False)
    try:
        context = ray.data.DataContext.get_current()
        context.enable_progress_bars = False
        a_block = max(1, -(-LEAST_FRAMES_A_BLOCK // plan.frames_a_shard))
        models = pickle.dumps((plan.spec, plan.config))
        rows = [{"shard": pickle.dumps(s), "models": models, "where": store.where} for s in waiting]
        stream = ray.data.from_items(rows, override_num_blocks=max(1, -(-len(rows) // a_block)))
        if not plan.exact:
            pool = ray.data.ActorPoolStrategy(min_size=1, max_size=max(1, workers))
            stream = stream.map(cast(Any, DetectShards), compute=pool, num_gpus=gpus_a_detector or None)
        for row in stream.map(label_row).iter_rows():
            done(ShardReport(**row))
    finally:
        if mine:
            ray.shutdown()
