"""From corrections to a new relation network, and what it does to the answers: mend, retrain, replay.

The labels with their corrections become a folder of their own, a network is
learnt from them and compared with the one learnt from the labels before, and a
run is made again with the mended labels, once with its own relation scorer and
once with the new network.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from pipeline.corrections.journal.journal import journal_of
from pipeline.corrections.journal.materialise import MARKS_FILE, materialise
from pipeline.corrections.review.retraining import RetrainConfig, Retraining, compare_networks, retrain, shared_split
from pipeline.datasets import Dataset
from pipeline.diagnosis.verdict import read_marks
from pipeline.evaluation.compare import Comparison
from pipeline.evaluation.job import evaluate_dataset
from pipeline.evaluation.run_folder import Run, open_run
from pipeline.evaluation.shared_makers import scorer_share
from pipeline.labels.makers import makers_of
from pipeline.labels.reading import Labels, labelled_dataset, open_labels
from pipeline.relations import shipped_network
from pipeline.relations.model import OnnxScorer
from pipeline.system.errors import InputError, require
from pipeline.system.staging import staged_folder
from pipeline.training.label_data import read_label_data

LABELS, NETWORK, BEFORE, AFTER = "labels", "network.onnx", "run-before", "run-after"
MARK = "network.comparison.json"
"""Tells a folder that this wrote."""
Progress = Callable[[str, int, int], None]
"""Called with what is being done ("labels", "before", "after", "replay"), how far it is, and of how much."""


@dataclass(frozen=True)
class CorrectedLabelsJob:
    """Work on corrected labels, for a process of its own.

    Attributes
    ----------
    labels : Path
        As they were made.
    out : Path
        File or folder to write.
    journal, project : str or None
        See `journal_of`.
    dataset : str or None
        For what follows from corrected pixels and boxes; without it, as the labels name it.
    options : dict
        Of the dataset, for `labelled_dataset`: intrinsics, depth_scale.
    """

    labels: Path
    out: Path
    journal: str | None = None
    project: str | None = None
    dataset: str | None = None
    options: dict[str, Any] = field(default_factory=dict)

    def corrected_dataset(self, labels: Labels) -> Dataset | None:
        """The labels' dataset; None where it is not at hand, and what follows from new pixels is stale."""
        try:
            return labelled_dataset(labels.manifest, self.dataset, **self.options)
        except InputError:
            return None


@dataclass(frozen=True)
class RetrainingJob(CorrectedLabelsJob):
    """What is retrained on.

    Attributes
    ----------
    run : Path or None
        The run that is made again.
    config : RetrainConfig
    workers : int
    """

    run: Path | None = None
    config: RetrainConfig = field(default_factory=RetrainConfig)
    workers: int = 1


@dataclass(frozen=True)
class RetrainingRun:
    """What came of it.

    Attributes
    ----------
    folder : Path
        `labels/`, `network.onnx` with its card and comparison, and where a run was made again `run-before/` and
        `run-after/`.
    corrections : dict
        Of the manifest of the mended labels: events, values by people, recomputed.
    retraining : Retraining
        Networks learnt from the labels before and after.
    in_use : Retraining or None
        The network that is in use, beside the one after, on the same held-out pairs; None where it cannot be compared.
    mended : Comparison or None
        The run as it was, beside the same on the mended labels: what the labels alone changed.
    replay : Comparison or None
        The run on the mended labels with its own relations, beside the same with the new network.
    """

    folder: Path
    corrections: dict[str, Any]
    retraining: Retraining
    in_use: Retraining | None
    mended: Comparison | None
    replay: Comparison | None

    @property
    def network(self) -> Path:
        return self.folder / NETWORK

    def record(self) -> dict[str, Any]:
        """As JSON."""
        return {
            "folder": str(self.folder),
            "network": str(self.network),
            "corrections": self.corrections,
            "retraining": self.retraining.record(),
            "in_use": None if self.in_use is None else self.in_use.record(),
            "mended": None if self.mended is None else self.mended.record(),
            "replay": None if self.replay is None else self.replay.record(),
        }


def run_retraining(job: RetrainingJob, progress: Progress | None = None) -> RetrainingRun:
    """Mend, retrain, compare, and make the run again; the folder appears whole or not at all.

    Raises
    ------
    InputError
        Nothing was corrected, the labels cannot be learnt from, or the run cannot be opened.
    MissingExtra
        torch or onnx is not installed.
    """
    tell = progress or (lambda what, done, of: None)
    labels = open_labels(job.labels)
    run = None if job.run is None else open_run(job.run, labels=str(labels.root))
    with staged_folder(job.out, overwrite=False, mark=MARK) as folder:
        tell("labels", 0, 1)
        mended, corrections = _mend(job, labels, folder / LABELS)
        tell("labels", 1, 1)
        epochs = job.config.train.epochs
        retraining = retrain(
            labels, mended, folder / NETWORK, job.config,
            progress=lambda name, epoch: tell(name, epoch.number, epochs),
        )  # fmt: skip
        # The network in use: the run's, else the shipped one.
        current = OnnxScorer(shipped_network()) if run is None else run.source.scorer
        in_use = None
        if isinstance(current, OnnxScorer):
            in_use = compare_with(current, folder / NETWORK, labels, mended, job.config, retraining.cards[1])
        comparisons = (None, None) if run is None else _replay(run, folder, job.workers, tell)
    return RetrainingRun(Path(job.out), corrections, retraining, in_use, *comparisons)


def _mend(job: RetrainingJob, labels: Labels, folder: Path) -> tuple[Labels, dict[str, Any]]:
    with journal_of(labels, job.journal, project=job.project, must_exist=True) as journal:
        manifest, found = materialise(labels, journal, folder, dataset=job.corrected_dataset(labels))
    require(found.events, "nothing was corrected yet", cause="is this the journal of these labels?", path=labels.root)
    return open_labels(folder), dict(manifest.corrections or {})


def compare_with(
    current: OnnxScorer, network: Path, before: Labels, after: Labels, config: RetrainConfig, card: dict[str, Any]
) -> Retraining | None:
    """A network that is in use beside a new one, on the pairs that the new one has not seen; see `Retraining`.

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
    cards = ({**card, "file": str(current.name)}, card)
    found = compare_networks(current, new, was, now, plan, cards, config.bootstrap, fed_before=fed)
    share = scorer_share(makers_of(after.manifest), current.path.stem, current)
    return found if share is None else replace(found, caveats=(f"before: {share.sentence}",))


def _replay(run: Run, folder: Path, workers: int, tell: Progress) -> tuple[Comparison | None, Comparison | None]:
    """Make a run again on the mended labels: as it was, and with the new network."""
    require(
        run.spec.system == "pipeline",
        "only a run of the pipeline can be made again",
        got=run.spec.system,
        path=run.folder,
    )
    marks = {**run.spec.marks, **read_marks(folder / LABELS / MARKS_FILE)}
    spec = replace(run.spec, labels=str(folder / LABELS), marks=marks)
    steps = (
        (BEFORE, spec, run.folder, run.name),
        (AFTER, replace(spec, options={**spec.options, "srm": folder / NETWORK, "vectors": None}), folder / BEFORE,
         f"{run.name}, retrained"),
    )  # fmt: skip
    found = []
    for number, (name, wanted, against, title) in enumerate(steps):
        report = evaluate_dataset(
            wanted, folder / name, name=title, workers=workers, against=against, plots=False,
            progress=lambda done, of, number=number: tell("replay", number * of + done, len(steps) * of),
        )  # fmt: skip
        found.append(report.comparison)
    return found[0], found[1]


def retraining_in_background(job: RetrainingJob, report: Callable[[tuple[str, int, int]], None]) -> dict[str, Any]:
    """`run_retraining` for `pipeline.system.background`: its record."""
    return run_retraining(job, lambda what, done, of: report((what, done, of))).record()
