"""The commands that review labels, train on mended ones, and measure both."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

from tyro.conf import OmitArgPrefixes, Positional, arg

from pipeline.errors import InputError
from spatialviz.cli_journal import DatasetOptions, JournalOptions
from spatialviz.exits import FINE, NO
from spatialviz.options import four_numbers, print_json

Features = Literal["2d", "3d", "canon", "rel14"]


@dataclass(frozen=True)
class Review:
    """Rank labels by how probably they are wrong, each with the reasons."""

    labels: Positional[Path]
    """Labels folder."""
    limit: int = 50
    """Show so many; --out holds all."""
    out: Path | None = None
    """Write the whole queue as Parquet."""
    other: Path | None = None
    """Labels of the same dataset by another detector or run: what they say otherwise counts too."""
    networks: bool = True
    """Ask networks that have not learnt from a label (confident learning)."""
    linter: bool = True
    """Count what `spatialviz check` finds."""
    features: Features = "rel14"
    """What the networks are given of a pair."""
    folds: int = 5
    """Each network learns from all scenes but those of one fold, or from all blocks of camera positions but one."""
    passes: int = 1
    """2: train once more without the labels that were found wrong; somewhat better, for twice the time."""
    seed: int = 0
    """Of folds and networks."""
    json: bool = False
    """Print one JSON object an item."""

    def run(self) -> int:
        from pipeline.labels.reading import open_labels
        from pipeline.labels.tables import write_table
        from pipeline.review.out_of_fold import EPOCHS, REVIEWED, DoubtConfig
        from pipeline.review.queue import QueueConfig, review_queue
        from pipeline.srm.features import CLI_FEATURES
        from pipeline.srm.train import TrainConfig
        from spatialviz.printing import progress_bars
        from spatialviz.printing_review import print_queue

        if self.limit < 0:
            raise InputError("--limit must not be negative", got=self.limit)
        train = TrainConfig(CLI_FEATURES[self.features], REVIEWED, epochs=EPOCHS, seed=self.seed)
        doubts = DoubtConfig(self.folds, self.passes, train) if self.networks else None
        other = None if self.other is None else open_labels(self.other)
        labels = open_labels(self.labels)
        with progress_bars() as advance:
            queue = review_queue(
                labels,
                QueueConfig(doubts, linter=self.linter),
                other=other,
                progress=lambda done, of: advance("networks", done, of),
            )
        if self.out is not None:
            self.out.parent.mkdir(parents=True, exist_ok=True)
            write_table(queue, self.out)
        if self.json:
            for row in queue.slice(0, self.limit).to_pylist():
                print_json(row)
        else:
            print_queue(queue, self.limit, self.out)
        return FINE if queue.num_rows else NO


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
        from pipeline.labels.reading import open_labels
        from pipeline.review.circle import CircleJob, run_circle
        from pipeline.review.retraining import RetrainConfig, retrain
        from pipeline.srm.features import CLI_FEATURES
        from pipeline.srm.train import TrainConfig
        from spatialviz.printing import progress_bars
        from spatialviz.printing_review import print_circle, print_retraining

        train = TrainConfig(CLI_FEATURES[self.features], epochs=self.epochs, batch=self.batch, seed=self.seed)
        config = RetrainConfig(train, self.split)
        if self.after is None:
            options = {
                "intrinsics": four_numbers(self.source.intrinsics), "depth_scale": self.source.depth_scale
            }
            job = CircleJob(
                self.labels, self.out, self.journal.journal, self.journal.project, self.source.dataset, options,
                self.run_folder, config, self.workers,
            )  # fmt: skip
            with progress_bars() as advance:
                circle = run_circle(job, advance)
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
        from pipeline.srm.installed import install_network

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
    passes: int = 1
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
        from pipeline.review.bench import ReviewBenchConfig, bench_review
        from pipeline.review.out_of_fold import EPOCHS, REVIEWED, DoubtConfig
        from pipeline.srm.train import TrainConfig
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
