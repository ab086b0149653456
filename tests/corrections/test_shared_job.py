"""Work that many look at, and the queue that is made so."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

from pipeline.corrections import CANCELLED, QueueJob, QueueProgress
from pipeline.corrections.review.label_jobs import LabelJobs
from pipeline.labels import Labels
from pipeline.system import InputError, SharedJob


class Held:
    """In place of another process: it waits until a test runs it, or cancels it."""

    def __init__(self) -> None:
        self.waiting: list[Held.Job] = []

    class Job:
        def __init__(
            self,
            function: Callable[..., Any],
            argument: Any,
            on_progress: Callable[[Any], None],
            on_end: Callable[[Any, str], None],
        ) -> None:
            self.work, self.argument, self.on_progress, self.on_end = function, argument, on_progress, on_end

        def run(self) -> None:
            try:
                result = self.work(self.argument, self.on_progress)
            except InputError as error:
                self.on_end(None, str(error))
            else:
                self.on_end(result, "")

    def start(self, function: Callable[..., Any], argument: Any, **heard: Any) -> Any:
        self.waiting.append(Held.Job(function, argument, **heard))
        return self.waiting[-1]

    def run(self) -> None:
        self.waiting.pop(0).run()


def counted(to: int, report: Callable[[Any], None]) -> str:
    for n in range(to):
        report(n)
    return "counted"


def test_one_runs_at_a_time_and_who_comes_later_finds_it() -> None:
    held = Held()
    job: SharedJob[tuple[Any, ...]] = SharedJob((), held.start)

    def start(to: int) -> bool:
        return job.start(
            counted,
            to,
            begun=lambda seen: (*seen, "begun"),
            heard=lambda seen, n: (*seen, n),
            ended=lambda seen, result, problem: (*seen, result or problem),
        )

    first: list[Any] = []
    leave = job.listen(lambda: first.append(job.seen[-1]))
    assert start(2)
    assert not start(5), "another page asked for the same"
    assert (job.running, job.seen) == (True, ("begun",))
    late: list[Any] = []
    job.listen(lambda: late.append(job.seen[-1]))
    leave()
    held.run()
    assert (job.running, job.seen) == (False, ("begun", 0, 1, "counted"))
    assert first == ["begun"]
    assert late == [0, 1, "counted"]
    job.change(lambda seen: (*seen, "noted"))
    assert late[-2:] == ["counted", "noted"]
    job.end()
    assert not start(1)
    assert held.waiting == []


def test_a_queue_stays_where_no_new_one_is_made(demo_labels: Labels, tmp_path: Path) -> None:
    held, jobs = Held(), LabelJobs()
    jobs.queue = SharedJob(QueueProgress(), held.start)
    job = QueueJob(demo_labels.root, str(tmp_path / "none.sqlite"), networks=False)

    def damaged(job: QueueJob, report: Callable[[Any], None]) -> None:
        raise InputError("the labels are damaged")

    assert jobs.make(job)
    assert not jobs.make(job)
    held.run()
    seen = jobs.queue.seen
    assert not seen.running
    assert seen.work is not None
    assert len(seen.work) > 0
    assert jobs.make(job)
    held.waiting[0].work = damaged
    held.run()
    seen = jobs.queue.seen
    assert not seen.running
    assert "damaged" in seen.problem
    assert seen.work is not None, "the queue that there was stays"
    assert jobs.make(job)
    held.waiting.pop().on_end(None, CANCELLED)
    now = jobs.queue.seen
    assert (now.running, now.problem) == (False, CANCELLED)
    assert now.work is seen.work
