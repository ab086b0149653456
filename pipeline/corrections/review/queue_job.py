"""Long work on corrected labels, shared by everyone who corrects them: making their review queue, and retraining."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from time import perf_counter
from typing import Any

from pipeline.answering.opening import Pipeline
from pipeline.corrections.journal.frame_rows import setting_of
from pipeline.corrections.journal.journal import journal_of
from pipeline.corrections.review.detector_evidence import SecondDetector, detector_evidence
from pipeline.corrections.review.evidence import read_relation_labels
from pipeline.corrections.review.items import by_frame, with_states
from pipeline.corrections.review.out_of_fold import DoubtConfig
from pipeline.corrections.review.queue import QueueConfig, review_queue
from pipeline.corrections.review.retraining_run import CorrectedLabelsJob, RetrainingJob, retraining_in_background
from pipeline.corrections.review.reviewed import Reviewed, pair_agreements, reviewed_labels, states_on_labels
from pipeline.corrections.review.worklist import NOTHING, Mark, Worklist, mark_of, read_queue, worklist, write_queue
from pipeline.labels.pictures import labelled_dataset
from pipeline.labels.reading import Labels, open_labels
from pipeline.language.naming import Synonyms
from pipeline.proposals.registry import DetectorSetup, made_by
from pipeline.system.background import SharedJob
from pipeline.system.errors import InputError

Step = tuple[str, int, int]
"""What is asked ("frames" of a detector, "networks"), how many are done, of how many."""
CANCELLED = "cancelled"
"""The problem of what was stopped."""


@dataclass(frozen=True)
class QueueJob(CorrectedLabelsJob):
    """What a queue is made of; `out` is the Parquet file to write.

    Attributes
    ----------
    networks : bool
        Ask networks that have not learnt from a label; that takes the most time.
    detector : DetectorSetup or None
        Asked about the labelled frames too; see `second_setup`.
    called : str or None
        What the detector is called. Default: its own name.
    """

    networks: bool = True
    detector: DetectorSetup | None = None
    called: str | None = None


def second_setup(source: Pipeline, labels: Labels) -> tuple[str, DetectorSetup] | None:
    """The detector that can say something new of labels: the one beside the source's, else the source's own.

    One that the labels were made from is none; None where there is no other.

    Returns
    -------
    (its name, see `Pipeline.sides`; what it is made from)
    """
    maker = labels.manifest.models.get("detector")
    own, other = source.sides
    known = ((other, source.beside, source.beside_setup), (own, source.detector, source.setup))
    for name, detector, setup in known:
        if detector is not None and setup is not None and not made_by(maker, detector):
            return name, setup
    return None


def make_queue(job: QueueJob, report: Callable[[Step], None]) -> dict[str, Any]:
    """Make the queue, ordered for working through, and store it.

    Parameters
    ----------
    report : callable
        Called with a Step.

    Returns
    -------
    dict
        items (how many), detector (the one that was asked: its name, frames it looked at, skipped ones with the reason;
        None without one), estimated_wrong (relation labels that networks hold for wrong; None without networks),
        agreement (each two reviewers, how many items both have judged, and Cohen's kappa; None where it means nothing),
        and last (the newest event that surely counts in it, a `worklist.Mark`). The states of the items then are the
        queue's column `state`.

    Raises
    ------
    InputError
        The labels or the journal cannot be read, or hold nothing to learn from; the detector cannot be made, or
        could look at no frame.
    MissingExtra
        torch is not installed, and networks are to be asked.
    """
    labels = open_labels(job.labels)
    with tempfile.TemporaryDirectory(prefix="spatialviz-") as folder:
        reviewed, last = _reviewed(job, labels, Path(folder) / "labels")
        config = QueueConfig(DoubtConfig() if job.networks else None)
        name, seen = _seen(job, labels, reviewed.labels, report)
        queue = review_queue(
            reviewed.labels,
            config,
            found_elsewhere=() if seen is None else seen.items,
            judgements=reviewed.judgements,
            progress=lambda done, of: report(("networks", done, of)),
        )
        states = states_on_labels(reviewed.judgements, read_relation_labels(reviewed.labels))
    metadata = queue.schema.metadata
    write_queue(with_states(by_frame(queue), states).replace_schema_metadata(metadata), job.out)
    wrong = (metadata or {}).get(b"estimated_wrong")
    pairs = [pair.record() for pair in pair_agreements(reviewed.judgements, setting_of(labels).inverse)]
    return {
        "items": queue.num_rows,
        "last": last,
        "detector": None if seen is None else {"name": name, "frames": seen.frames, "skipped": seen.skipped},
        "estimated_wrong": None if wrong is None else float(wrong),
        "agreement": [{key: pair[key] for key in ("reviewers", "items", "kappa")} for pair in pairs],
    }


def _seen(
    job: QueueJob, automatic: Labels, labels: Labels, report: Callable[[Step], None]
) -> tuple[str, SecondDetector | None]:
    if job.detector is None:
        return "", None
    dataset = labelled_dataset(automatic.manifest, job.dataset, **job.options)
    table = Synonyms.load(job.detector.synonyms)
    detector = job.detector.open(dataset.class_names, table)
    name = job.called or detector.name
    found = detector_evidence(
        labels, dataset, detector, synonyms=table, progress=lambda n, of: report(("frames", n, of)), name=name
    )
    return name, found


def _reviewed(job: QueueJob, labels: Labels, folder: Path) -> tuple[Reviewed, Mark]:
    try:
        journal = journal_of(labels, job.journal, project=job.project, must_exist=True)
    except InputError:
        return Reviewed(labels), NOTHING
    with journal:
        newest = journal.events(last=1)
        return reviewed_labels(labels, journal, folder, job.corrected_dataset(labels)), mark_of(newest)


@dataclass(frozen=True)
class QueueProgress:
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
class TrainingProgress:
    """How far a training is, and what came of it.

    Attributes
    ----------
    running : bool
    step : tuple of (str, int, int)
        What is being done, how far, of how much.
    record : dict or None
        Of `pipeline.corrections.review.retraining_run.RetrainingRun`.
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
    queue : SharedJob of QueueProgress
    training : SharedJob of TrainingProgress
    """

    def __init__(self) -> None:
        self.queue = SharedJob(QueueProgress())
        self.training = SharedJob(TrainingProgress())

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

        def begun(seen: QueueProgress) -> QueueProgress:
            return replace(seen, running=True, job=now, step=None, problem="")

        def heard(seen: QueueProgress, step: Step) -> QueueProgress:
            return replace(seen, step=step)

        def ended(seen: QueueProgress, record: Any, problem: str) -> QueueProgress:
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

        def heard(seen: TrainingProgress, step: tuple[str, int, int]) -> TrainingProgress:
            return replace(seen, step=step, seconds=perf_counter() - began)

        def ended(_: TrainingProgress, record: Any, problem: str) -> TrainingProgress:
            return TrainingProgress(record=record, problem=problem, seconds=perf_counter() - began)

        return self.training.start(
            retraining_in_background, job, begun=lambda _: TrainingProgress(running=True), heard=heard, ended=ended
        )

    def end(self) -> None:
        """End what runs, for good."""
        self.queue.end()
        self.training.end()
