"""What the stages of an evaluation cost."""

from __future__ import annotations

from time import process_time


class StageClock:
    """Processor seconds of this process by stage; time within an inner stage does not count for the outer one.

    Attributes
    ----------
    seconds : dict of str to float
    """

    def __init__(self) -> None:
        self.seconds: dict[str, float] = {}
        self._running: list[str] = []
        self._since = 0.0

    def stage(self, name: str) -> _Stage:
        """A context: what runs in it is time of this stage."""
        return _Stage(self, name)

    def enter(self, name: str) -> None:
        self._settle()
        self._running.append(name)

    def leave(self) -> None:
        self._settle()
        self._running.pop()

    def _settle(self) -> None:
        now = process_time()
        if self._running:
            name = self._running[-1]
            self.seconds[name] = self.seconds.get(name, 0.0) + now - self._since
        self._since = now


class _Stage:
    # Entered for every expression: a generator's context would cost several times as much.
    __slots__ = ("_clock", "_name")

    def __init__(self, clock: StageClock, name: str) -> None:
        self._clock, self._name = clock, name

    def __enter__(self) -> None:
        self._clock.enter(self._name)

    def __exit__(self, *_: object) -> None:
        self._clock.leave()
