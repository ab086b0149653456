"""Labelling job: plan, label the shards that are missing, by processes of this machine or on Ray, and merge."""

from __future__ import annotations

import logging
import os
import pickle
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import closing
from dataclasses import replace
from functools import lru_cache
from importlib import import_module
from pathlib import Path
from time import perf_counter
from typing import Any, Literal, cast

import numpy as np

from pipeline.answering.objects import prepare_frame
from pipeline.answering.pipeline import Pipeline
from pipeline.datasets import given_expressions
from pipeline.datasets.base import scene_of
from pipeline.labels.instances import Instances, open_instances
from pipeline.labels.labelling import FrameLabels, broken_frame, label_objects
from pipeline.labels.merge import merge_labels
from pipeline.labels.plan import (
    BY_CONTENT,
    LabelConfig,
    Plan,
    Shard,
    SourceSpec,
    input_changed,
    load_plan,
    make_plan,
    part_of,
    save_plan,
)
from pipeline.labels.profiles import GIVEN, NONE, TRAINED, open_second_opinion
from pipeline.labels.reading import PART_TABLES, SENTENCES, Labels, arrow_schema, build_table, open_labels
from pipeline.labels.schema import Manifest
from pipeline.labels.selection import SelectConfig
from pipeline.labels.sentence_maker import make_sentences, sentence_rows
from pipeline.labels.store import PLAN_FILE, LabelStore
from pipeline.proposals.base import Proposals
from pipeline.relations.model import OnnxScorer
from pipeline.system.arrow import pa
from pipeline.system.detector_setup import with_files
from pipeline.system.errors import InputError, as_input_error, extra_module, first_line, require
from pipeline.system.frozen import dataclass
from pipeline.system.remote import is_url, list_anew, local_path
from pipeline.system.worker_pool import one_thread, results_of


@dataclass(frozen=True)
class LabelReport:
    """Frames and rows of a shard, or of a labelling run."""

    frames: int
    """Frames of the shards that were asked for."""
    reused: int = 0
    """Of those, frames whose shard was there already."""
    broken: int = 0
    """Frames that could not be used."""
    objects: int = 0
    pairs: int = 0
    candidates: int = 0
    seconds: float = 0.0
    manifest: Manifest | None = None
    """Of the merged labels; None where only a part was asked for."""

    def __repr__(self) -> str:
        return f"<LabelReport: {self.frames} frames, {self.objects} objects, {self.seconds:.1f} s>"


@dataclass(frozen=True)
class Labeller:
    """What a process opens once and labels many frames with."""

    config: LabelConfig
    source: Pipeline
    """The dataset and what finds objects in it."""
    network: OnnxScorer | None
    """The second opinion."""
    instances: Instances | None = None


def open_labeller(spec: SourceSpec, config: LabelConfig) -> Labeller:
    """Open the dataset and the models of a plan; raises as `open_pipeline`."""
    source = spec.open(config)
    instances = open_instances(config.map, source.needed_detector(), source.dataset) if config.map else None
    return Labeller(config, source, open_second_opinion(config.second_opinion), instances)


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
        if labeller.instances is not None and config.lift.boxes == "completed":
            objects = labeller.instances.completed(frame_id, objects, detector.exact, context.viewer)
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
        instances=None if labeller.instances is None else labeller.instances.of_frame.get(frame_id, {}),
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


def finished(shard: Shard, store: LabelStore) -> LabelReport | None:
    """Report of a finished shard, else None."""
    if not store.has_part(shard.name):
        return None
    record = store.part_record(shard.name)
    frames, objects, pairs, found = (int(record["files"].get(name, {}).get("rows", 0)) for name in PART_TABLES)
    return LabelReport(frames, frames, int(record.get("broken", 0)), objects, pairs, found)


def label_shard(
    shard: Shard, labeller: Labeller, store: LabelStore, found: Mapping[str, Proposals] | None = None
) -> LabelReport:
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
    frames, objects, pairs, candidates = (tables[name].num_rows for name in PART_TABLES)
    return LabelReport(frames, 0, broken, objects, pairs, candidates, seconds)


Done = Callable[[LabelReport], None]
"""Called with each shard's report when it is finished."""


def run_local(plan: Plan, shards: Sequence[Shard], store: LabelStore, workers: int, done: Done) -> None:
    """Label shards with so many processes; finished shards stay when the run is stopped.

    Raises InputError: a worker was killed.
    """
    # What is at a URL was listed by this process: its workers read the copy, and do not list again.
    spec = replace(plan.spec, path=str(local_path(plan.spec.path))) if is_url(plan.spec.path) else plan.spec
    reports = results_of(
        label_shard,
        shards,
        workers,
        prepare=_opened,
        arguments=(spec, plan.config, store.where),
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
    shard, store = pickle.loads(row["shard"]), LabelStore(row["where"])
    with one_thread():
        return {"report": pickle.dumps(label_shard(shard, _labeller(row["models"]), store, found))}


def run_ray(
    plan: Plan, shards: Sequence[Shard], store: LabelStore, workers: int, done: Done, *, gpus_a_detector: float = 0.0
) -> None:
    """Label shards on the connected Ray cluster, that of RAY_ADDRESS, else on this machine.

    The annotations of a dataset need no detector, and the first stage is left
    out. Where the labels go, and the dataset, must be reachable from every node.

    `workers`: processors of the cluster on this machine, and detector actors at most. `gpus_a_detector`: share of a GPU
    that each detector actor is given.

    Raises MissingExtra: ray is not installed.
    """
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
        address = os.environ.get("RAY_ADDRESS", "local")
        # A cluster that runs already has processors of its own.
        own = {"num_cpus": workers + 1, "include_dashboard": False} if address == "local" else {}
        with as_input_error("Ray cannot be reached", Exception, got=first_line, path=address):
            ray.init(address, log_to_driver=False, configure_logging=False, **own)
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
            done(pickle.loads(row["report"]))
    finally:
        if mine:
            ray.shutdown()


Engine = Literal["local", "ray"]
Progress = Callable[[int, int], None]
"""Called with (frames done, frames in all)."""


def label_dataset(
    spec: SourceSpec,
    out: str | Path,
    config: LabelConfig | None = None,
    selection: SelectConfig | None = None,
    *,
    engine: Engine = "local",
    workers: int = 1,
    part: tuple[int, int] | None = None,
    resume: bool = False,
    limit: int | None = None,
    frames_of: Sequence[str] = (),
    frames_a_shard: int | None = None,
    gpus_a_detector: float = 0.0,
    progress: Progress | None = None,
) -> LabelReport:
    """Label a dataset into a folder (or URL), and merge the shards.

    `out`: must be new or empty; with `resume` and `part` it may hold labels made with the same arguments. `engine`:
    "local" or "ray"; the rows are the same. `part`: only task k of n (from 1), for arrays of jobs that share `out`; the
    last to finish, or anyone after, merges. `resume`: go on in a folder where a run was stopped: finished shards are
    kept. `limit`: only the first so many frames. `frames_of`: only the frames of these splits of the dataset's own.

    Raises InputError: for a dataset that cannot be opened or changes meanwhile, a folder that holds something else.
    """
    config = config or LabelConfig()
    if config.second_opinion not in (NONE, TRAINED):
        config = replace(config, second_opinion=str(Path(config.second_opinion).absolute()))
    start = perf_counter()
    if not is_url(out):
        out = Path(out).expanduser().absolute()
    store = LabelStore(out)
    require(workers >= 1, "at least one worker is needed", got=workers)
    require(0 <= gpus_a_detector <= 1e3, "GPUs of a detector", got=gpus_a_detector, expected="a number from 0 to 1000")
    require(
        resume or part is not None or store.is_empty(),
        "the folder for the labels is not empty",
        cause="--resume goes on where a run was stopped",
        path=out,
    )
    require(
        not store.holds_something_else(),
        "the folder holds something else than labels",
        cause="use another folder",
        path=out,
    )
    like = BY_CONTENT if store.read_text(PLAN_FILE) is None else load_plan(store).input_hash
    chosen: dict[str, Any] = {"frames_a_shard": frames_a_shard, "limit": limit, "frames_of": frames_of}
    plan = make_plan(spec.absolute(), config, **chosen, out=out, like=like)
    open_second_opinion(config.second_opinion)
    if config.map:
        opened = plan.spec.open(config)
        open_instances(config.map, opened.needed_detector(), opened.dataset)
    if engine == "ray":
        extra_module("ray.data", "the engine ray", "cluster")

    def of_task(plan: Plan) -> tuple[Shard, ...]:
        return plan.shards if part is None else part_of(plan.shards, *part)

    total = sum(len(s.frames) for s in of_task(plan))
    reports: list[LabelReport] = []

    def done(report: LabelReport) -> None:
        reports.append(report)
        if progress is not None:
            progress(sum(r.frames for r in reports), total)

    # Readers tell what they cannot read: what the system refuses here is writing.
    with as_input_error(
        "the labels cannot be written",
        OSError,
        got=lambda e: e.strerror or str(e),
        cause="when there is room, --resume goes on where this ended",
        path=out,
    ):
        store.prepare()
        shards = of_task(save_plan(plan, store))
        store.clear_unfinished()
        try:
            if engine == "ray":
                run_ray(plan, shards, store, workers, done, gpus_a_detector=gpus_a_detector)
            else:
                run_local(plan, shards, store, workers, done)
        finally:
            store.clear_unfinished()
        list_anew()
        require(
            not input_changed(plan, out),
            "the dataset changed while it was labelled",
            cause="remove the labels, and label it again",
            path=out,
        )
        manifest = merge_labels(out, selection) if part is None else None
    counted = "reused", "broken", "objects", "pairs", "candidates"
    counts = {name: sum(getattr(report, name) for report in reports) for name in counted}
    return LabelReport(total, **counts, seconds=perf_counter() - start, manifest=manifest)


def label(
    dataset: str | Path,
    out: str | Path,
    *,
    config: LabelConfig | None = None,
    selection: SelectConfig | None = None,
    detector: str | None = None,
    segmenter: str | None = "depth",
    engine: Engine = "local",
    workers: int = 1,
    resume: bool = False,
    limit: int | None = None,
    progress: Progress | None = None,
    **options: Any,
) -> Labels:
    """Label a dataset: objects, all pairwise relations, and true sentences.

    Parameters
    ----------
    dataset : str or Path
        A folder, or "demo". Workers open it again: a dataset in memory cannot be labelled.
    out : str or Path
        Folder for the labels; new or empty, but for `resume`.
    config, selection
        How frames are labelled, and which sentences are kept; by default as on the command line.
    detector : str, optional
        What finds the objects. Default: the dataset's annotations.
    segmenter : str, optional
        Makes masks for boxes that have none.
    engine, workers, resume, limit, progress
        As for `label_dataset`. More than one worker needs a script that starts under `if __name__ == "__main__":`.
    options
        Further arguments of `open_pipeline`: model, min_score, up, intrinsics, ...

    Raises InputError as `label_dataset`.

    >>> import tempfile
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     label("demo", f"{folder}/labels", limit=1)
    <Labels labels: 1 frames, 20 objects, 380 relations, 40 expressions>
    """
    spec = SourceSpec(str(dataset), {"detector": detector, "segmenter": segmenter, **with_files(options, str)})
    label_dataset(
        spec, out, config, selection, engine=engine, workers=workers, resume=resume, limit=limit, progress=progress
    )
    return open_labels(out)
