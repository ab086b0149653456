"""Long work in another process."""

from __future__ import annotations

import tempfile
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from waiting import LONG_S

from pipeline.system import InputError
from pipeline.system.worker_pool import start_background


def counted(to: int, report: Callable[[Any], None]) -> str:
    for n in range(to):
        report(n)
    return f"counted to {to}"


def refused(report: Callable[[Any], None]) -> None:
    raise InputError("there is no such thing", got="nonsense")


def broken(report: Callable[[Any], None]) -> None:
    raise ZeroDivisionError("one by nought")


def endless(report: Callable[[Any], None]) -> None:
    report("begun")
    while True:
        time.sleep(0.05)


def writing(folder: str, report: Callable[[Any], None]) -> None:
    with tempfile.TemporaryDirectory(dir=folder):
        endless(report)


def lasting(path: str, report: Callable[[Any], None]) -> str:
    """What takes long to be taken apart leaves a file then."""
    import atexit

    atexit.register(Path(path).touch)
    return "done"


def gone(report: Callable[[Any], None]) -> None:
    import os

    os._exit(7)


class Heard:
    """What came of a job."""

    def __init__(self) -> None:
        self.steps: list[Any] = []
        self.end: tuple[Any, str] | None = None
        self._step, self._ended = threading.Event(), threading.Event()

    def step(self, value: Any) -> None:
        self.steps.append(value)
        self._step.set()

    def ended(self, result: Any, problem: str) -> None:
        self.end = result, problem
        self._ended.set()

    def run(self, function: Callable[..., Any], *args: Any, cancel: bool = False) -> tuple[Any, str]:
        job = start_background(function, *args, on_progress=self.step, on_end=self.ended)
        if cancel:
            assert self._step.wait(LONG_S)
            job.cancel()
        assert self._ended.wait(LONG_S)
        assert self.end is not None
        return self.end


def test_a_result_comes_after_every_step() -> None:
    heard = Heard()
    assert heard.run(counted, 5) == ("counted to 5", "")
    assert heard.steps == [0, 1, 2, 3, 4]


def test_nobody_waits_for_an_interpreter_that_is_taken_apart(tmp_path: Path) -> None:
    assert Heard().run(lasting, str(tmp_path / "late")) == ("done", "")
    assert not list(tmp_path.iterdir())


def test_problems_come_in_words() -> None:
    assert Heard().run(refused) == (None, "there is no such thing; got nonsense")
    assert Heard().run(broken) == (None, "ZeroDivisionError: one by nought")
    result, problem = Heard().run(gone)
    assert result is None
    assert "ended without a result" in problem


def test_a_job_can_be_ended() -> None:
    assert Heard().run(endless, cancel=True) == (None, "cancelled")


def test_a_job_that_is_ended_leaves_nothing_behind(tmp_path: Path) -> None:
    assert Heard().run(writing, str(tmp_path), cancel=True) == (None, "cancelled")
    assert list(tmp_path.iterdir()) == []


def test_what_is_cancelled_has_no_result_also_where_it_was_ready() -> None:
    heard, held = Heard(), threading.Event()
    job = start_background(counted, 1, on_progress=lambda _: print(held.wait(LONG_S)), on_end=heard.ended)
    job._process.join(LONG_S)
    job.cancel()
    held.set()
    assert heard._ended.wait(LONG_S)
    assert heard.end == (None, "cancelled")
