"""The local engine: shards labelled by processes of this machine, one thread of arithmetic each."""

from __future__ import annotations

import multiprocessing
import os
import threading
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool

from pipeline.labels.config import LabelConfig
from pipeline.labels.plan import Plan, Shard, SourceSpec
from pipeline.labels.shard import Labeller, ShardReport, label_shard, open_labeller
from pipeline.labels.store import Store
from pipeline.system.errors import InputError
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
