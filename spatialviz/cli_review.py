"""The commands that review labels, train on mended ones, and measure both."""

from __future__ import annotations

import os
import sys
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from tyro.conf import OmitArgPrefixes, Positional, arg

from pipeline.system.errors import InputError, MissingExtra
from spatialviz.cli_journal import DatasetOptions, JournalOptions
from spatialviz.exits import FINE, NO
from spatialviz.options import print_json, warn_skipped
from spatialviz.source_options import SecondDetectorOptions

if TYPE_CHECKING:
    import pyarrow as pa

    from pipeline.corrections.review.evidence import ItemEvidence
    from pipeline.corrections.review.items import ItemKey, State
    from pipeline.corrections.review.reviewed import Reviewed
    from pipeline.labels.reading import Labels

Features = Literal["2d", "3d", "canon", "rel14", "rel26"]


@dataclass(frozen=True)
class Review:
    """Rank labels by how probably they are wrong, each with the reasons; tell how far a review of them has come."""

    labels: Positional[Path]
    """Labels folder."""
    limit: int = 50
    """Show so many; --out holds all."""
    out: Path | None = None
    """Write the whole queue as Parquet: with what is settled."""
    queue: Path | None = None
    """Read a queue that --out wrote, and do not make it anew."""
    all: bool = False
    """Show what is settled too."""
    author: str | None = None
    """What is left for this reviewer, without what others said."""
    overlap: float = 0.0
    """With --author: ask again this share of what others have settled, so that agreement can be measured."""
    second_opinion_of: str | None = None
    """With --author: only what this person has judged."""
    agreement: bool = False
    """Print how far each two reviewers agree (Cohen's kappa), and on what they differ; exit status 1 where no two have
    judged the same item."""
    progress: bool = False
    """Print how far the review has come."""
    journal: OmitArgPrefixes[JournalOptions] = JournalOptions()
    other: Path | None = None
    """Labels of the same dataset by another detector or run: what they say otherwise counts too."""
    second: OmitArgPrefixes[SecondDetectorOptions] = SecondDetectorOptions()
    source: OmitArgPrefixes[DatasetOptions] = DatasetOptions()
    networks: bool = True
    """Ask networks that have not learnt from a label (confident learning)."""
    linter: bool = True
    """Count what `spatialviz check` finds."""
    features: Features = "rel14"
    """What the networks are given of a pair."""
    folds: int = 5
    """Each network learns from all scenes but those of one fold, or from all blocks of camera positions but one."""
    passes: int = 3
    """Training again without the labels that were found wrong, so often in all. 1 is three times as fast, and worse."""
    seed: int = 0
    """Of folds and networks."""
    json: bool = False
    """Print one JSON object an item."""

    def run(self) -> int:
        from pipeline.corrections.journal.frame_rows import setting_of
        from pipeline.corrections.review.evidence import read_relation_labels
        from pipeline.corrections.review.reviewed import (
            pair_agreements,
            review_progress,
            states_on_labels,
            without_gone,
        )
        from pipeline.corrections.review.worklist import write_queue
        from pipeline.labels.reading import open_labels
        from spatialviz.printing_review import print_agreement, print_progress, print_queue

        self._check()
        labels = open_labels(self.labels)
        with tempfile.TemporaryDirectory(prefix="spatialviz-") as folder:
            reviewed = self._reviewed(labels, Path(folder) / "labels")
            if self.agreement:
                pairs = pair_agreements(reviewed.judgements, setting_of(labels).inverse)
                if self.json:
                    for pair in pairs:
                        print_json(pair.record())
                else:
                    print_agreement(pairs, self.limit)
                return FINE if pairs else NO
            queue = self._queue(reviewed, labels)
            states = states_on_labels(reviewed.judgements, read_relation_labels(reviewed.labels))
            if self.queue is not None:
                queue = without_gone(queue, reviewed.labels, states)
        if self.out is not None:
            write_queue(queue, self.out)
        if self.progress:
            record = review_progress(queue, reviewed.judgements, states)
            print_json(record) if self.json else print_progress(record)
            return FINE
        shown = self._shown(queue, reviewed, states)
        if self.json:
            for row in shown.slice(0, self.limit).to_pylist():
                print_json(row)
        else:
            print_queue(shown, self.limit, self.out, settled=queue.num_rows - shown.num_rows)
        return FINE if shown.num_rows else NO

    def _check(self) -> None:
        if self.limit < 0:
            raise InputError("--limit must not be negative", got=self.limit)
        self.second.check()
        if self.author is None and (self.overlap or self.second_opinion_of is not None):
            raise InputError("--overlap and --second-opinion-of need --author", cause="whose second opinion?")
        if self.author is not None and self.all:
            raise InputError("--all and --author exclude each other")
        if self.queue is not None and (self.other is not None or self.second.detector is not None):
            raise InputError("--queue is a queue that was made before", cause="leave out --queue, or the other options")

    def _reviewed(self, labels: Labels, folder: Path) -> Reviewed:
        from pipeline.corrections.journal.journal import JOURNAL_FILE
        from pipeline.corrections.review.reviewed import Reviewed, reviewed_labels

        named = self.journal.journal is not None
        if not named and not (labels.root / JOURNAL_FILE).exists():
            return Reviewed(labels)
        with self.journal.open(labels, must_exist=True) as journal:
            return reviewed_labels(labels, journal, folder, self.source.open(labels))

    def _queue(self, reviewed: Reviewed, labels: Labels) -> pa.Table:
        from pipeline.corrections.review.out_of_fold import EPOCHS, REVIEWED, DoubtConfig
        from pipeline.corrections.review.queue import QueueConfig, review_queue
        from pipeline.corrections.review.reviewed import automatic_version
        from pipeline.corrections.review.worklist import read_queue
        from pipeline.labels.reading import open_labels
        from pipeline.relations.features import CLI_FEATURES
        from pipeline.training.train import TrainConfig, need_torch
        from spatialviz.printing import progress_bars

        if self.queue is not None:
            return read_queue(self.queue, automatic_version(labels.manifest))
        train = TrainConfig(CLI_FEATURES[self.features], REVIEWED, epochs=EPOCHS, seed=self.seed)
        networks = self.networks
        if networks and (why := MissingExtra.missing(need_torch)):
            networks = False
            print(f"spatialviz: the networks are left out, as with --no-networks: {why}", file=sys.stderr)
        doubts = DoubtConfig(self.folds, self.passes, train) if networks else None
        other = None if self.other is None else open_labels(self.other)
        with progress_bars() as advance:
            return review_queue(
                reviewed.labels,
                QueueConfig(doubts, linter=self.linter),
                other=other,
                found_elsewhere=self._seen(reviewed.labels, labels, advance),
                judgements=reviewed.judgements,
                progress=lambda done, of: advance("networks", done, of),
            )

    def _seen(
        self, labels: Labels, automatic: Labels, advance: Callable[[str, int, int], None]
    ) -> tuple[ItemEvidence, ...]:
        from pipeline.corrections.review.detector_evidence import detector_evidence
        from pipeline.language.naming import Synonyms

        setup = self.second.setup()
        if setup is None:
            return ()
        dataset = self.source.open(automatic)
        if dataset is None:
            raise InputError("--detector needs the pictures", expected="--dataset DATASET")
        table = Synonyms.load(setup.synonyms)
        detector = setup.open(dataset.class_names, table)
        found = detector_evidence(
            labels, dataset, detector, synonyms=table, progress=lambda n, of: advance("frames", n, of)
        )
        for frame, reason in found.skipped.items():
            warn_skipped(frame, reason)
        return found.items

    def _shown(self, queue: pa.Table, reviewed: Reviewed, states: dict[ItemKey, State]) -> pa.Table:
        from pipeline.corrections.review.items import left_to_review, with_states
        from pipeline.corrections.review.reviewed import left_for

        if self.author is not None:
            return left_for(
                queue, reviewed.judgements, states, self.author, overlap=self.overlap,
                second_opinion_of=self.second_opinion_of,
            )  # fmt: skip
        return with_states(queue, states) if self.all else left_to_review(queue, states)


@dataclass(frozen=True)
class Retrain:
    """Train relation networks on labels before and after they were mended, and compare them on held-out frames.

    The labels after are those of the folder AFTER, or LABELS with the corrections of their journal; with --run, the run
    is made again with the mended labels and the new network."""

    labels: Positional[Path]
    """Labels folder as it was made."""
    after: Positional[Path | None] = None
    """Labels folder as it is. Default: the labels with the journal's corrections."""
    out: Path = Path("retrained")
    """With AFTER an ONNX file, beside which its card and the comparison are written; else a new folder, which gets the
    mended labels and the runs, too."""
    run_folder: Annotated[Path | None, arg(name="run")] = None
    """A run that `eval` wrote on these labels, made again."""
    source: OmitArgPrefixes[DatasetOptions] = DatasetOptions()
    journal: OmitArgPrefixes[JournalOptions] = JournalOptions()
    features: Features = "rel14"
    """What the networks are given of a pair."""
    epochs: int = 10
    """The learning rate, 1e-3, is halved every 3."""
    batch: int | None = None
    """Pairs in a step. Default: 256, less where there are few pairs."""
    split: Literal["scene", "blocks", "random"] | None = None
    """Default: scene where there are at least three, else blocks of camera positions. random leaks."""
    seed: int = 0
    """Of the split and of both networks."""
    workers: int = os.cpu_count() or 1
    """Processes at once, with --run."""
    json: bool = False
    """Print one JSON object."""

    def run(self) -> int:
        from pipeline.corrections.review.retraining import RetrainConfig, retrain
        from pipeline.corrections.review.retraining_run import RetrainingJob, run_retraining
        from pipeline.labels.reading import open_labels
        from pipeline.relations.features import CLI_FEATURES
        from pipeline.training.train import TrainConfig
        from spatialviz.printing import progress_bars
        from spatialviz.printing_review import print_circle, print_retraining

        train = TrainConfig(CLI_FEATURES[self.features], epochs=self.epochs, batch=self.batch, seed=self.seed)
        config = RetrainConfig(train, self.split)
        if self.after is None:
            options = self.source.camera()
            job = RetrainingJob(
                self.labels, self.out, self.journal.journal, self.journal.project, self.source.dataset, options,
                self.run_folder, config, self.workers,
            )  # fmt: skip
            with progress_bars() as advance:
                circle = run_retraining(job, advance)
            if self.json:
                print_json(circle.record())
            else:
                print_circle(circle)
            return FINE
        if self.run_folder is not None:
            raise InputError("--run goes with the labels' own journal, not with AFTER")
        if self.out.suffix != ".onnx":
            raise InputError("with AFTER, --out is the ONNX file to write", got=str(self.out))
        with progress_bars() as advance:
            found = retrain(
                open_labels(self.labels),
                open_labels(self.after),
                self.out,
                config,
                progress=lambda name, epoch: advance(f"epochs {name}", epoch.number, self.epochs),
            )
        if self.json:
            print_json(found.record())
        else:
            print_retraining(found, self.out)
        return FINE


@dataclass(frozen=True)
class Install:
    """Install a relation network under a name that --srm takes."""

    network: Positional[Path]
    """ONNX file that `train` or `retrain` wrote."""
    name: str
    """Letters, digits, and . _ -"""
    overwrite: bool = False
    """Replace a network of that name."""
    json: bool = False
    """Print one JSON object."""

    def run(self) -> int:
        from pipeline.relations.installed import install_network

        done = install_network(self.network, self.name, overwrite=self.overwrite)
        if self.json:
            print_json({"name": done.name, "path": str(done.path)})
        else:
            print(f"--srm {done.name} is now {done.path}")
        return FINE


@dataclass(frozen=True)
class BenchReview:
    """Plant wrong relation labels in rendered rooms: how many the queue finds, and what mending them is worth."""

    rooms: int = 90
    """One in three only measures."""
    views: int = 2
    """Views of each room."""
    share: float = 0.1
    """Of the labels that are T or F, turned into the opposite, each for itself."""
    top: float = 0.1
    """Share of the labels that is looked at first."""
    again: float = 0.01
    """Share that is looked at once those are mended and the queue is made again."""
    labels: Literal["exact", "seen"] = "seen"
    """exact: the rule on whole objects as they are | seen: on the noisy parts that are seen, as auto-labels are."""
    folds: int = 5
    passes: int = 3
    """As of `review`."""
    networks: int = 2
    """Trained on each set of labels, F1 averaged."""
    batch: int | None = None
    """Pairs in a step. Default: 256, less where there are few pairs."""
    seeds: int = 3
    """Repetitions with other errors and other networks in the same rooms."""
    seed: int = 0
    """Another seed makes other rooms."""
    workers: int = os.cpu_count() or 1
    """Rooms made at once. The figures do not depend on it."""
    json: bool = False
    """Print one JSON object."""

    def run(self) -> int:
        from pipeline.corrections.review.bench import ReviewBenchConfig, bench_review
        from pipeline.corrections.review.out_of_fold import EPOCHS, REVIEWED, DoubtConfig
        from pipeline.training.train import TrainConfig
        from spatialviz.printing import progress_bars
        from spatialviz.printing_review import print_review_bench

        config = ReviewBenchConfig(
            rooms=self.rooms,
            views=self.views,
            share=self.share,
            top=self.top,
            again=self.again,
            labels=self.labels,
            networks=self.networks,
            seeds=self.seeds,
            seed=self.seed,
            doubts=DoubtConfig(
                self.folds, self.passes, TrainConfig(vocabulary=REVIEWED, epochs=EPOCHS, batch=self.batch)
            ),
            train=TrainConfig(batch=self.batch),
        )
        with progress_bars() as advance:
            record = bench_review(config, workers=self.workers, progress=advance)
        if self.json:
            print_json(record)
        else:
            print_review_bench(record)
        return FINE
