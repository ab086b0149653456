"""Long work on labels that are corrected, shared by everyone who does: their review queue, and retraining on them."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from time import perf_counter
from typing import Any

from pipeline.corrections.review.queue_job import QueueJob, Step, make_queue
from pipeline.corrections.review.retraining_run import RetrainingJob, retraining_in_background
from pipeline.corrections.review.worklist import Worklist, read_queue, worklist
from pipeline.system.errors import InputError
from pipeline.system.shared_job import SharedJob

CANCELLED = "cancelled"
"""The problem of what was stopped."""


@dataclass(frozen=True)
class Making:
    """A review queue that is being made, and the one that was made last.

    Attributes
    ----------
    running : bool
    job : QueueJob or None
        What is being made, or was last.
    step : Step or None
        How far it is; None before it tells.
    problem : str
        Why there is none, or no new one.
    made : dict or None
        What is known of the queue: `queue_job.make_queue`.
    work : Worklist or None
        The queue as it was made.
    """

    running: bool = False
    job: QueueJob | None = None
    step: Step | None = None
    problem: str = ""
    made: Mapping[str, Any] | None = None
    work: Worklist | None = None


@dataclass(frozen=True)
class Training:
    """How far a training is, and what came of it.

    Attributes
    ----------
    running : bool
    step : tuple of (str, int, int)
        What is being done, how far, of how much.
    record : dict or None
        Of `pipeline.corrections.review.retraining_run.Circle`.
    problem : str
    seconds : float
    installed : str
        The name under which the network was installed.
    """

    running: bool = False
    step: tuple[str, int, int] = ("labels", 0, 1)
    record: Mapping[str, Any] | None = None
    problem: str = ""
    seconds: float = 0.0
    installed: str = ""


class LabelJobs:
    """The jobs of one set of labels in one process.

    Attributes
    ----------
    queue : SharedJob of Making
    training : SharedJob of Training
    """

    def __init__(self) -> None:
        self.queue = SharedJob(Making())
        self.training = SharedJob(Training())

    def make(self, job_for: Callable[[Path], QueueJob]) -> bool:
        """Make the queue; whether it was started, see `SharedJob.start`.

        The first is made without networks and detector, so that there is something to begin with; what was asked for
        follows it.

        Parameters
        ----------
        job_for : callable
            Gives the job for a file that it is to write, which does not stay.
        """
        folder = tempfile.TemporaryDirectory(prefix="spatialviz-")
        job = job_for(Path(folder.name) / "queue.parquet")
        now = job if self.queue.seen.work is not None else replace(job, networks=False, detector=None)

        def begun(seen: Making) -> Making:
            return replace(seen, running=True, job=now, step=None, problem="")

        def heard(seen: Making, step: Step) -> Making:
            return replace(seen, step=step)

        def ended(seen: Making, record: Any, problem: str) -> Making:
            seen = replace(seen, running=False, step=None)
            try:
                if not problem:
                    return replace(seen, made=record, work=worklist(read_queue(now.out)))
            except InputError as error:
                problem = str(error)
            finally:
                folder.cleanup()
            return replace(seen, problem=problem)

        def then() -> None:
            if now != job and not self.queue.seen.problem:
                self.make(job_for)

        started = self.queue.start(make_queue, now, begun=begun, heard=heard, ended=ended, then=then)
        if not started:
            folder.cleanup()
        return started

    def train(self, job: RetrainingJob) -> bool:
        """Retrain; whether it was started, see `SharedJob.start`."""
        began = perf_counter()

        def heard(seen: Training, step: tuple[str, int, int]) -> Training:
            return replace(seen, step=step, seconds=perf_counter() - began)

        def ended(_: Training, record: Any, problem: str) -> Training:
            return Training(record=record, problem=problem, seconds=perf_counter() - began)

        return self.training.start(
            retraining_in_background, job, begun=lambda _: Training(running=True), heard=heard, ended=ended
        )

    def end(self) -> None:
        """End what runs, for good."""
        self.queue.end()
        self.training.end()
