"""Jobs in other processes, none of which outlives its parent: many by a pool, or one, cancelled at any time.

Each computes on one thread: sums of a matrix product depend on the number of threads.
"""

from __future__ import annotations

import multiprocessing
import os
import signal
import sys
import threading
import time
from collections.abc import Callable, Generator, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager, suppress
from multiprocessing import resource_tracker
from multiprocessing.connection import Connection
from threading import Lock
from typing import Any, Generic, TypeVar

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


PATIENCE_S = 20.0
"""How long a job that is cancelled may take to tidy up."""


class Background:
    """Function running in another process; `start_background` starts one."""

    def __init__(self, process: Any) -> None:
        self._process, self.cancelled = process, False

    def cancel(self) -> None:
        """End the job; files half written are taken away first."""
        self.cancelled = True
        self._process.terminate()
        last = threading.Timer(PATIENCE_S, self._process.kill)
        last.daemon = True
        last.start()


def start_background(
    function: Callable[..., Any],
    *args: Any,
    on_progress: Callable[[Any], None],
    on_end: Callable[[Any, str], None],
) -> Background:
    """Run `function(*args, progress)` of a module, with picklable arguments and result, in another process.

    Threads of this process call `on_progress` with each value of `progress`, and `on_end` with (result, "") or
    (None, the problem).
    """
    context = multiprocessing.get_context("spawn")
    receiver, sender = context.Pipe(duplex=False)
    process = context.Process(target=_work_apart, args=(function, args, sender), daemon=True)
    with without_ctrl_c():
        process.start()
    sender.close()
    job = Background(process)

    def listen() -> None:
        kind, value = "progress", None
        with suppress(EOFError, OSError):
            while kind == "progress":
                kind, value = receiver.recv()
                if kind == "progress":
                    on_progress(value)
        process.join()
        if kind == "progress":
            kind, value = (
                "problem",
                "it ended without a result" + (f" ({process.exitcode})" if process.exitcode else ""),
            )
        result, problem = (value, "") if kind == "result" else (None, str(value))
        on_end(*((None, "cancelled") if job.cancelled else (result, problem)))

    threading.Thread(target=listen, daemon=True).start()
    return job


def _work_apart(function: Callable[..., Any], args: tuple[Any, ...], sender: Connection) -> None:
    # Ctrl-C in the terminal is for the process that waits: it ends this one.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, _leave)
    threading.Thread(target=leave_with_parent, args=(PATIENCE_S,), daemon=True).start()
    code = 0
    try:
        _send(function, args, sender)
    except SystemExit as left:
        code = left.code if isinstance(left.code, int) else 1
    finally:
        # Taking an interpreter with torch in it apart takes seconds, for which somebody waits.
        for stream in (sys.stdout, sys.stderr):
            with suppress(Exception):
                stream.flush()
        os._exit(code)


def _send(function: Callable[..., Any], args: tuple[Any, ...], sender: Connection) -> None:
    try:
        sender.send(("result", function(*args, lambda value: sender.send(("progress", value)))))
        return
    except InputError as error:
        problem = str(error)
    except Exception as error:  # Whatever it is, the one who waits must hear of it.
        problem = f"{type(error).__name__}: {error}"
    # Nobody may be there any more.
    with suppress(OSError):
        sender.send(("problem", problem))


def _leave(number: int, _: Any) -> None:
    """End by an error, so that temporary folders go."""
    signal.signal(signal.SIGTERM, signal.SIG_IGN)
    raise SystemExit(128 + number)


Seen = TypeVar("Seen")
"""What is known of the work: an immutable value that is replaced as a whole."""


class SharedJob(Generic[Seen]):
    """Work of one kind on one thing, shared by many threads; `seen` is the knowledge of it, from before to after."""

    def __init__(self, seen: Seen, background: Callable[..., Background] = start_background) -> None:
        self.seen, self.running = seen, False
        self._background = background
        self._job: Background | None = None
        self._ended = False
        self._listeners: list[Callable[[], None]] = []
        self._lock = Lock()

    def start(
        self,
        function: Callable[..., Any],
        argument: Any,
        *,
        begun: Callable[[Seen], Seen],
        heard: Callable[[Seen, Any], Seen],
        ended: Callable[[Seen, Any, str], Seen],
    ) -> bool:
        """Run `function(argument, progress)` as `start_background`; returns False if work runs already.

        `begun`, `heard` and `ended` make the new `seen` from the old: at the start, of each progress, of (result,
        problem) at the end.
        """

        def on_progress(value: Any) -> None:
            self.change(lambda seen: heard(seen, value))

        def on_end(result: Any, problem: str) -> None:
            with self._lock:
                self.running = False
                self.seen = ended(self.seen, result, problem)
            self._notify()

        with self._lock:
            if self.running or self._ended:
                return False
            self._job = self._background(function, argument, on_progress=on_progress, on_end=on_end)
            self.running = True
            self.seen = begun(self.seen)
        self._notify()
        return True

    def change(self, change: Callable[[Seen], Seen]) -> None:
        """Replace `seen`, and tell the listeners."""
        with self._lock:
            self.seen = change(self.seen)
        self._notify()

    def stop(self) -> None:
        """End the running work; the problem is then "cancelled"."""
        with self._lock:
            if self._job is not None and self.running:
                self._job.cancel()

    def end(self) -> None:
        """End the running work for good: nothing starts any more."""
        self._ended = True
        self.stop()

    def listen(self, listener: Callable[[], None]) -> Callable[[], None]:
        """Call a listener, on any thread, at every change of `seen`; returns the function to end this."""
        with self._lock:
            self._listeners.append(listener)

        def leave() -> None:
            with self._lock:
                self._listeners = [x for x in self._listeners if x is not listener]

        return leave

    def _notify(self) -> None:
        for listener in tuple(self._listeners):
            listener()
