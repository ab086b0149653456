"""The cluster engine on Ray Data (extra: cluster): detectors as actors, geometry as tasks behind them."""

from __future__ import annotations

import logging
import pickle
from collections.abc import Sequence
from dataclasses import asdict
from functools import lru_cache
from importlib import import_module
from typing import Any, cast

from pipeline.labels.local import Done
from pipeline.labels.plan import Plan, Shard
from pipeline.labels.shard import Labeller, ShardReport, detect_shard, finished, label_shard, open_labeller
from pipeline.labels.store import Store
from pipeline.system.errors import MissingExtra
from pipeline.system.threads import one_thread

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
