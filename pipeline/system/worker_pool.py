"""Jobs in worker processes: each opens once the needs of its jobs, and none outlives its parent.

Each computes on one thread: sums of a matrix product depend on the number of threads.
"""

from __future__ import annotations

import multiprocessing
import os
import signal
import threading
import time
from collections.abc import Callable, Generator, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from multiprocessing import resource_tracker
from typing import Any, TypeVar

from pipeline.system.errors import InputError

Job = TypeVar("Job")
Result = TypeVar("Result")
_PATIENCE_S = 5.0
"""How long a worker that is told to end may take."""


def results_of(
    do: Callable[..., Result],
    jobs: Sequence[Job],
    workers: int,
    *,
    prepare: Callable[..., tuple[Any, ...]] = tuple,
    arguments: tuple[Any, ...] = (),
    ordered: bool = True,
    cause: str = "out of memory? use fewer workers",
) -> Generator[Result, None, None]:
    """Run `do(job, *opened)`, of the top level of a module, for each job in spawned processes of one thread.

    Parameters
    ----------
    workers : int
        Processes at most; with one, or one job, this process does the work.
    prepare : callable
        `prepare(*arguments)` is opened once by each process, as a tuple; its errors are raised here.
    ordered : bool
        Order of the jobs, and not of their ends.
    cause : str
        Help for a killed worker, an InputError.
    """
    if min(workers, len(jobs)) <= 1:
        with one_thread():
            opened = prepare(*arguments)
            for job in jobs:
                yield do(job, *opened)
        return
    with threads_in_children():
        pool = ProcessPoolExecutor(
            min(workers, len(jobs)), multiprocessing.get_context("spawn"), _start, (do, prepare, arguments)
        )
        try:
            with without_ctrl_c():
                futures = [pool.submit(_work, job) for job in jobs]
            if ordered:
                # Each is let go with its result; `pool.map` would cancel the rest, see below.
                futures.reverse()
                while futures:
                    yield futures.pop().result()
            else:
                yield from (future.result() for future in as_completed(futures))
        except BrokenProcessPool as error:
            raise InputError("a worker process died", cause=cause) from error
        except BaseException:
            ours = list((pool._processes or {}).values())
            # Without cancelling: Python's own thread would complain of a cancelled job whose worker is gone.
            pool.shutdown(wait=False)
            for process in ours:
                process.terminate()
            for process in ours:
                process.join(_PATIENCE_S)
            raise
        pool.shutdown()


_do: Callable[..., Any]
_opened: tuple[Any, ...] | Exception
"""What a worker process does, and what it opened when it started, or why it could not."""


def _start(do: Callable[..., Any], prepare: Callable[..., tuple[Any, ...]], arguments: tuple[Any, ...]) -> None:
    global _do, _opened
    import cv2

    # Where it is not held back, as on Windows.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=leave_with_parent, daemon=True).start()
    cv2.setNumThreads(1)
    _do = do
    try:
        _opened = prepare(*arguments)
    except Exception as error:
        # Raised here it would only be told as a broken pool.
        _opened = error


@contextmanager
def without_ctrl_c() -> Iterator[None]:
    """Keep Ctrl-C from processes started in the block: the parent alone decides.

    Ignoring it themselves would come too late: while they import they would die of it, with a traceback.
    """
    if not hasattr(signal, "pthread_sigmask"):  # Windows.
        yield
        return
    # Its own start lets Ctrl-C through again.
    resource_tracker.ensure_running()
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def leave_with_parent(patience_s: float = _PATIENCE_S) -> None:
    """End this process with the parent process."""
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os.kill(os.getpid(), signal.SIGTERM)
        time.sleep(patience_s)
        os._exit(1)


def _work(job: Any) -> Any:
    if isinstance(_opened, Exception):
        raise _opened
    return _do(job, *_opened)


THREAD_VARIABLES = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "VECLIB_MAXIMUM_THREADS")


@contextmanager
def one_thread() -> Iterator[None]:
    """Run arithmetic of this process on one thread, for equal sums everywhere."""
    import cv2
    from threadpoolctl import threadpool_limits

    threads = cv2.getNumThreads()
    cv2.setNumThreads(1)
    try:
        with threadpool_limits(1):
            yield
    finally:
        cv2.setNumThreads(threads)


@contextmanager
def threads_in_children() -> Iterator[None]:
    """Set one thread in the environment of children: numpy reads the count when it is loaded."""
    before = {name: os.environ.get(name) for name in THREAD_VARIABLES}
    os.environ.update(dict.fromkeys(THREAD_VARIABLES, "1"))
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                os.environ.pop(name, None)
            else:
                os.environ[name] = value
