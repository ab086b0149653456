"""Work in another process that many look at: one runs at a time, and who comes later finds how far it is."""

from __future__ import annotations

from collections.abc import Callable
from threading import Lock
from typing import Any, Generic, TypeVar

from pipeline.system.background import Background, start_background

Seen = TypeVar("Seen")
"""What is known of the work: an immutable value that is replaced as a whole."""


class SharedJob(Generic[Seen]):
    """Work of one kind on one thing. Any thread may call any of it.

    Parameters
    ----------
    seen : Seen
        What is known before anything ran.
    background : callable, optional
        As `start_background`.

    Attributes
    ----------
    seen : Seen
        What is known now.
    running : bool
    """

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
        """Run `function(argument, progress)` in a process of its own, unless something runs already.

        Parameters
        ----------
        function, argument
            See `start_background`.
        begun, heard, ended : callable
            Make what is known from what was: at the start, of each progress, of (result, problem) at the end.
        then : callable, optional
            Called after the end, before the listeners: what it starts follows without a pause.

        Returns
        -------
        bool
            Whether it was started.
        """

        def on_progress(value: Any) -> None:
            self.change(lambda seen: heard(seen, value))

        def on_end(result: Any, problem: str) -> None:
            with self._lock:
                self.running = False
                self.seen = ended(self.seen, result, problem)
            if then is not None:
                then()
            self._tell()

        with self._lock:
            if self.running or self._ended:
                return False
            self._job = self._background(function, argument, on_progress=on_progress, on_end=on_end)
            self.running = True
            self.seen = begun(self.seen)
        self._tell()
        return True

    def change(self, change: Callable[[Seen], Seen]) -> None:
        """Replace what is known, and tell those who listen."""
        with self._lock:
            self.seen = change(self.seen)
        self._tell()

    def stop(self) -> None:
        """End what runs; its problem is then "cancelled"."""
        with self._lock:
            if self._job is not None and self.running:
                self._job.cancel()

    def end(self) -> None:
        """End what runs, for good: nothing starts any more."""
        self._ended = True
        self.stop()

    def listen(self, listener: Callable[[], None]) -> Callable[[], None]:
        """Have something called, on any thread, whenever `seen` is another; what is returned ends that."""
        with self._lock:
            self._listeners.append(listener)

        def leave() -> None:
            with self._lock:
                self._listeners = [x for x in self._listeners if x is not listener]

        return leave

    def _tell(self) -> None:
        for listener in tuple(self._listeners):
            listener()
