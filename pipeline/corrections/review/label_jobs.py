"""Long work on corrected labels, shared by everyone who corrects them: building their review queue, and retraining.

Retraining goes from corrections to a new relation network, and what it does to the answers: the labels with their
corrections become a folder of their own, a network is learnt from them and compared with the one learnt from the labels
before, and a run is made again with the mended labels, once with its own relation scorer and once with the new network.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import field, replace
from pathlib import Path
from time import perf_counter
from typing import Any

from pipeline.corrections.journal.journal import journal_of
from pipeline.corrections.journal.materialise import MARKS_FILE, materialise
from pipeline.corrections.review.doubts import DoubtConfig
from pipeline.corrections.review.items import Judgements
from pipeline.corrections.review.queue import read_relation_labels, review_queue, reviewed_labels, states_on_labels
from pipeline.corrections.review.retraining import RetrainConfig, Retraining, compare_networks, retrain, shared_split
from pipeline.corrections.review.worklist import (
    NOTHING,
    Mark,
    Worklist,
    by_frame,
    item_keys,
    mark_of,
    worklist,
)
from pipeline.datasets import Dataset
from pipeline.diagnosis.marks import read_marks
from pipeline.evaluation.comparing import Comparison
from pipeline.evaluation.job import evaluate_dataset
from pipeline.evaluation.leakage import scorer_share
from pipeline.evaluation.run_folder import Run, open_run
from pipeline.labels.check.other_masks import OtherMasks, other_masks
from pipeline.labels.provenance import makers_of
from pipeline.labels.reading import Labels, labelled_dataset, open_labels
from pipeline.relations import shipped_network
from pipeline.relations.model import OnnxScorer
from pipeline.system.arrow import pa
from pipeline.system.errors import InputError, require
from pipeline.system.frozen import dataclass
from pipeline.system.whole_files import scratch_folder, staged_folder
from pipeline.system.worker_pool import SharedJob
from pipeline.training.label_data import read_label_data

Step = tuple[str, int, int]
"""What is asked ("networks"), how many are done, of how many."""
CANCELLED = "cancelled"
"""The problem of what was stopped."""
MOST_COMPARED = 300
"""Masks of more frames are not compared with those of other views: each takes a third of a second."""


@dataclass(frozen=True)
class CorrectedLabelsJob:
    """Work on corrected labels, for a process of its own."""

    labels: str | Path
    """As they were made."""
    journal: str | None = None
    project: str | None = None
    """See `journal_of`."""
    dataset: str | None = None
    """For what follows from corrected pixels and boxes; without it, as the labels name it."""
    options: dict[str, Any] = field(default_factory=dict)
    """Of the dataset, for `labelled_dataset`: intrinsics, depth_scale."""

    def corrected_dataset(self, labels: Labels) -> Dataset | None:
        """Dataset of the labels; None where it is not at hand, and values by new pixels are stale."""
        try:
            return labelled_dataset(labels.manifest, self.dataset, **self.options)
        except InputError:
            return None


@dataclass(frozen=True)
class QueueJob(CorrectedLabelsJob):
    """What a queue is made of."""

    networks: bool = True
    """Ask networks that have not learnt from a label; that takes the most time."""


def make_queue(job: QueueJob, report: Callable[[Step], None]) -> tuple[pa.Table, Mark]:
    """Make the queue, ordered for working through, with a column `state`; and the newest event that counts in it.

    Raises InputError: the labels or the journal cannot be read, or hold nothing to learn from.
    Raises MissingExtra: torch is not installed, and networks are to be asked.
    """
    labels = open_labels(job.labels)
    with scratch_folder() as folder:
        (reviewed, judgements), last = _reviewed(job, labels, Path(folder) / "labels")
        queue = review_queue(
            reviewed,
            DoubtConfig() if job.networks else None,
            judgements=judgements,
            masks=_masks(job, reviewed),
            progress=lambda done, of: report(("networks", done, of)),
        )
        states = states_on_labels(judgements, read_relation_labels(reviewed))
    queue = by_frame(queue)
    found = [states.get(key, "unreviewed") for key in item_keys(queue)]
    return queue.append_column("state", pa.array(found, pa.string())), last


def _masks(job: QueueJob, labels: Labels) -> OtherMasks | None:
    """Comparison of the masks; None for many frames, or where the labels or the dataset allow none."""
    if labels.frames.num_rows > MOST_COMPARED:
        return None
    with suppress(InputError):
        return other_masks(labels, job.corrected_dataset(labels))
    return None


def _reviewed(job: QueueJob, labels: Labels, folder: Path) -> tuple[tuple[Labels, Judgements], Mark]:
    try:
        journal = journal_of(labels, job.journal, project=job.project, must_exist=True)
    except InputError:
        return (labels, Judgements()), NOTHING
    with journal:
        newest = journal.events(last=1)
        return reviewed_labels(labels, journal, folder, job.corrected_dataset(labels)), mark_of(newest)


@dataclass(frozen=True)
class QueueProgress:
    """A review queue that is being made, and the one that was made last."""

    running: bool = False
    step: Step | None = None
    """How far it is; None before it tells."""
    problem: str = ""
    """Why there is none, or no new one."""
    work: Worklist | None = None
    """The queue as it was made."""
    last: Mark = NOTHING
    """The newest event that counts in it."""


@dataclass(frozen=True)
class TrainingProgress:
    """How far a training is, and what came of it."""

    running: bool = False
    step: tuple[str, int, int] = ("labels", 0, 1)
    """What is being done, how far, of how much."""
    record: Mapping[str, Any] | None = None
    """Of `pipeline.corrections.review.label_jobs.RetrainingRun`."""
    problem: str = ""
    seconds: float = 0.0
    installed: str = ""
    """The name under which the network was installed."""


class LabelJobs:
    """The jobs of one set of labels in one process."""

    def __init__(self) -> None:
        self.queue = SharedJob(QueueProgress())
        self.training = SharedJob(TrainingProgress())

    def make(self, job: QueueJob) -> bool:
        """Make the queue; returns True if started, see `SharedJob.start`."""

        def ended(seen: QueueProgress, made: tuple[pa.Table, Mark] | None, problem: str) -> QueueProgress:
            work, last = (seen.work, seen.last) if made is None else (worklist(made[0]), made[1])
            return QueueProgress(problem=problem, work=work, last=last)

        return self.queue.start(
            make_queue,
            job,
            begun=lambda seen: replace(seen, running=True, problem=""),
            heard=lambda seen, step: replace(seen, step=step),
            ended=ended,
        )

    def train(self, job: RetrainingJob) -> bool:
        """Retrain; returns True if started, see `SharedJob.start`."""
        began = perf_counter()
        return self.training.start(
            retraining_in_background,
            job,
            begun=lambda _: TrainingProgress(running=True),
            heard=lambda seen, step: replace(seen, step=step, seconds=perf_counter() - began),
            ended=lambda _, record, problem: TrainingProgress(
                record=record, problem=problem, seconds=perf_counter() - began
            ),
        )

    def end(self) -> None:
        """End running jobs for good."""
        self.queue.end()
        self.training.end()


LABELS, NETWORK, BEFORE, AFTER = "labels", "network.onnx", "run-before", "run-after"
MARK = "network.comparison.json"
"""Tells a folder that this wrote."""
Progress = Callable[[str, int, int], None]
"""Called with what is being done ("labels", "before", "after", "replay"), how far it is, and of how much."""


@dataclass(frozen=True)
class RetrainingJob(CorrectedLabelsJob):
    """What is retrained on."""

    out: Path = field(kw_only=True)
    """Folder to write."""
    run: Path | None = None
    """The run that is made again."""
    config: RetrainConfig = field(default_factory=RetrainConfig)
    workers: int = 1


@dataclass(frozen=True)
class RetrainingRun:
    """What came of it."""

    folder: Path
    """`labels/`, `network.onnx` with its card and comparison, and where a run was made again `run-before/` and
    `run-after/`."""
    corrections: dict[str, Any]
    """Of the manifest of the mended labels: events, values by people, recomputed."""
    retraining: Retraining
    """Networks learnt from the labels before and after."""
    in_use: Retraining | None
    """The network that is in use, beside the one after, on the same held-out pairs; None where it cannot be
    compared."""
    mended: Comparison | None
    """The run as it was, beside the same on the mended labels: what the labels alone changed."""
    replay: Comparison | None
    """The run on the mended labels with its own relations, beside the same with the new network."""

    @property
    def network(self) -> Path:
        return self.folder / NETWORK

    def record(self) -> dict[str, Any]:
        """The outcome as JSON."""
        parts = {"in_use": self.in_use, "mended": self.mended, "replay": self.replay}
        return {
            "folder": str(self.folder),
            "network": str(self.network),
            "corrections": self.corrections,
            "retraining": self.retraining.record(),
            **{name: None if part is None else part.record() for name, part in parts.items()},
        }


def run_retraining(job: RetrainingJob, progress: Progress | None = None) -> RetrainingRun:
    """Mend, retrain, compare, and make the run again; the folder appears whole or not at all.

    Raises InputError: nothing was corrected, the labels cannot be learnt from, or the run cannot be opened.
    Raises MissingExtra: torch or onnx is not installed.
    """
    tell = progress or (lambda what, done, of: None)
    labels = open_labels(job.labels)
    run = None if job.run is None else open_run(job.run, labels=str(labels.root))
    with staged_folder(job.out, overwrite=False, mark=MARK) as folder:
        tell("labels", 0, 1)
        with journal_of(labels, job.journal, project=job.project, must_exist=True) as journal:
            manifest, found = materialise(labels, journal, folder / LABELS, dataset=job.corrected_dataset(labels))
        cause = "is this the journal of these labels?"
        require(found.events, "nothing was corrected yet", cause=cause, path=labels.root)
        mended = open_labels(folder / LABELS)
        tell("labels", 1, 1)
        epochs = job.config.train.epochs
        retraining = retrain(
            labels,
            mended,
            folder / NETWORK,
            job.config,
            progress=lambda name, epoch: tell(name, epoch.number, epochs),
        )
        # The network in use: the run's, else the shipped one.
        current = OnnxScorer(shipped_network()) if run is None else run.source.scorer
        in_use = None
        if isinstance(current, OnnxScorer):
            in_use = compare_with(current, folder / NETWORK, labels, mended, job.config, retraining.cards[1])
        comparisons = (None, None) if run is None else _replay(run, folder, job.workers, tell)
    return RetrainingRun(Path(job.out), dict(manifest.corrections or {}), retraining, in_use, *comparisons)


def compare_with(
    current: OnnxScorer, network: Path, before: Labels, after: Labels, config: RetrainConfig, card: dict[str, Any]
) -> Retraining | None:
    """Compare the network in use with a new network, on pairs unseen in training; see `Retraining`.

    None where the two do not judge the same relations, or either knows class names.
    """
    new = OnnxScorer(network)
    contract = current.contract
    same = (contract.output, contract.vocabulary) == (new.contract.output, new.contract.vocabulary)
    if not same or any(c.language is not None for c in (contract, new.contract)):
        return None
    was, now = (read_label_data(x, config.train.features, contract.vocabulary) for x in (before, after))
    fed = now if contract.features == now.features else read_label_data(after, contract.features, contract.vocabulary)
    plan = shared_split(was, now, config)
    found = compare_networks(
        current, new, was, now, plan, ({**card, "file": str(current.name)}, card), config.bootstrap, fed_before=fed
    )
    share = scorer_share(makers_of(after.manifest), current.path.stem, current)
    return found if share is None else replace(found, caveats=(f"before: {share.sentence}",))


def _replay(run: Run, folder: Path, workers: int, tell: Progress) -> tuple[Comparison | None, Comparison | None]:
    """Make a run again on the mended labels: as it was, and with the new network."""
    require(
        run.system == "pipeline",
        "only a run of the pipeline can be made again",
        got=run.system,
        path=run.folder,
    )
    marks = {**run.spec.marks, **read_marks(folder / LABELS / MARKS_FILE)}
    spec = replace(run.spec, labels=str(folder / LABELS), marks=marks)
    steps = (
        (BEFORE, spec, run.folder, run.name),
        (
            AFTER,
            replace(spec, options={**spec.options, "srm": folder / NETWORK, "vectors": None}),
            folder / BEFORE,
            f"{run.name}, retrained",
        ),
    )
    found = []
    for number, (name, wanted, against, title) in enumerate(steps):
        report = evaluate_dataset(
            wanted,
            folder / name,
            name=title,
            workers=workers,
            against=against,
            plots=False,
            progress=lambda done, of, number=number: tell("replay", number * of + done, len(steps) * of),
        )
        found.append(report.comparison)
    return found[0], found[1]


def retraining_in_background(job: RetrainingJob, report: Callable[[tuple[str, int, int]], None]) -> dict[str, Any]:
    """Record of `run_retraining`, for `pipeline.system.worker_pool`."""
    return run_retraining(job, lambda what, done, of: report((what, done, of))).record()
