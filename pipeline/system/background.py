"""Background jobs: long work in another process, cancelled at any time, alone or shared by several listeners."""

from __future__ import annotations

import multiprocessing
import os
import signal
import sys
import threading
from collections.abc import Callable
from contextlib import suppress
from multiprocessing.connection import Connection
from threading import Lock
from typing import Any, Generic, TypeVar

from pipeline.system.errors import InputError
from pipeline.system.worker_pool import leave_with_parent, without_ctrl_c

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
    process = context.Process(target=_work, args=(function, args, sender), daemon=True)
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


def _work(function: Callable[..., Any], args: tuple[Any, ...], sender: Connection) -> None:
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
        then: Callable[[], None] | None = None,
    ) -> bool:
        """Run `function(argument, progress)` as `start_background`; returns False if work runs already.

        `begun`, `heard` and `ended` make the new `seen` from the old: at the start, of each progress, of (result,
        problem) at the end. `then` is called after the end, before the listeners: work started by it follows without a
        pause.
        """

        def on_progress(value: Any) -> None:
            self.change(lambda seen: heard(seen, value))

        def on_end(result: Any, problem: str) -> None:
            with self._lock:
                self.running = False
                self.seen = ended(self.seen, result, problem)
            if then is not None:
                then()
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
