"""The engines: shards labelled by processes of this machine, one thread of arithmetic each, or on a Ray cluster.

On Ray Data (extra: cluster) detectors are actors, and geometry follows them as tasks.
"""

from __future__ import annotations

import logging
import multiprocessing
import os
import pickle
import threading
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from dataclasses import asdict
from functools import lru_cache
from importlib import import_module
from typing import Any, cast

from pipeline.labels.config import LabelConfig
from pipeline.labels.plan import Plan, Shard, SourceSpec
from pipeline.labels.shard import Labeller, ShardReport, detect_shard, finished, label_shard, open_labeller
from pipeline.labels.store import Store
from pipeline.system.errors import InputError, MissingExtra
from pipeline.system.threads import one_thread, threads_in_children

Done = Callable[[ShardReport], None]
"""Called with each shard's report when it is finished."""


_PATIENCE_S = 5.0
"""How long a worker that is told to end may take."""


def run_local(plan: Plan, shards: Sequence[Shard], store: Store, workers: int, done: Done) -> None:
    """Label shards with so many processes; what is finished stays when the run is stopped.

    Raises
    ------
    InputError
        A worker was killed.
    """
    if workers <= 1 or len(shards) <= 1:
        with one_thread():
            labeller = open_labeller(plan.spec, plan.config)
            for shard in shards:
                done(label_shard(shard, labeller, store))
        return
    with threads_in_children():
        models = plan.spec, plan.config, store.where
        pool = ProcessPoolExecutor(min(workers, len(shards)), multiprocessing.get_context("spawn"), _start, models)
        try:
            for future in as_completed([pool.submit(_label, shard) for shard in shards]):
                done(future.result())
        except BrokenProcessPool as error:
            raise InputError(
                "a worker process died", cause="out of memory? finished shards are kept: run again with --resume"
            ) from error
        except BaseException:
            ours = list((pool._processes or {}).values())
            pool.shutdown(wait=False, cancel_futures=True)
            for process in ours:
                process.terminate()
            for process in ours:
                process.join(_PATIENCE_S)
            raise
        pool.shutdown()


_worker: tuple[Labeller, Store] | Exception | None = None
"""What a worker process opened when it started, or why it could not."""


def _start(spec: SourceSpec, config: LabelConfig, where: str) -> None:
    global _worker
    import signal

    import cv2

    # Ctrl-C reaches the whole group; the parent alone decides what to do.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_end_with_parent, daemon=True).start()
    cv2.setNumThreads(1)
    try:
        _worker = open_labeller(spec, config), Store(where)
    except Exception as error:
        # Raised here it would only be told as a broken pool.
        _worker = error


def _end_with_parent() -> None:
    """A worker whose parent was killed would wait for shards for ever."""
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)


def _label(shard: Shard) -> ShardReport:
    if isinstance(_worker, Exception):
        raise _worker
    assert _worker is not None
    labeller, store = _worker
    return label_shard(shard, labeller, store)


LEAST_FRAMES_A_BLOCK = 64
"""Ray Data costs milliseconds a block: smaller ones would be felt."""


@lru_cache(maxsize=1)
def _labeller(models: bytes) -> Labeller:
    """What this process has opened; the next shard that comes to it finds it open."""
    return open_labeller(*pickle.loads(models))


class DetectShards:
    """Runs the detector on the frames of a shard, in an actor that holds the model for as long as the run lasts."""

    def __call__(self, row: dict[str, Any]) -> dict[str, Any]:
        shard = pickle.loads(row["shard"])
        if Store(row["where"]).has_part(shard.name):
            return {**row, "found": b""}
        return {**row, "found": pickle.dumps(detect_shard(shard, _labeller(row["models"]).source))}


def label_row(row: dict[str, Any]) -> dict[str, Any]:
    """Labels a shard, from what was detected where a detector ran before."""
    found = pickle.loads(row["found"]) if row.get("found") else None
    with one_thread():
        return asdict(label_shard(pickle.loads(row["shard"]), _labeller(row["models"]), Store(row["where"]), found))


def needed_ray() -> None:
    """Raise MissingExtra where Ray is not installed."""
    try:
        import_module("ray.data")
    except ImportError as error:
        raise MissingExtra("the engine ray", "cluster") from error


def run_ray(
    plan: Plan, shards: Sequence[Shard], store: Store, workers: int, done: Done, *, gpus_a_detector: float = 0.0
) -> None:
    """Label shards on a Ray cluster: the one that is connected, else one on this machine.

    The annotations of a dataset need no detector, and the first stage is left
    out. Where the labels go, and the dataset, must be reachable from every node.

    Parameters
    ----------
    workers : int
        Processors of the cluster on this machine, and detector actors at most.
    gpus_a_detector : float
        Share of a GPU that each detector actor is given.

    Raises
    ------
    MissingExtra
        Ray is not installed.
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
