"""The commands that measure the program itself."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from tyro.conf import OmitArgPrefixes, Positional

from spatialviz.options import CPUS, Batch, DatasetArg, Epochs, Features, FramesOptions, Output, SourceOptions, Workers


@dataclass(frozen=True)
class Bench(Output):
    """Time the stages on a dataset: milliseconds a frame, and ratios measured in one run."""

    dataset: DatasetArg = "demo"
    source: OmitArgPrefixes[SourceOptions] = SourceOptions()
    repeat: int = 5
    """Passes; the fastest counts."""


@dataclass(frozen=True)
class BenchLabel(Output):
    """Time labelling: lifting and relations beside the usual Open3D recipe, and the whole job on a dataset."""

    dataset: Positional[str] = "demo"
    """What the whole job labels."""
    views: int = 12
    """Rendered views for the comparison (extra: render; open3d for the recipe)."""
    repeat: int = 3
    """Passes; the fastest counts."""
    workers: int = CPUS
    """Processes of the whole job."""


@dataclass(frozen=True)
class BenchEval(Output):
    """Time evaluation with recorded proposals, stage by stage and beside asking one by one, and training."""

    dataset: DatasetArg = "demo"
    labels: Path | None = None
    """Its labels folder. Default: the dataset is labelled for the occasion."""
    recording: Path | None = None
    """Recorded proposals. Default: those of the simulated detector."""
    workers: int = CPUS
    """Processes of the whole job."""
    singly: int = 48
    """Expressions that are also asked one by one."""
    pairs: int = 75_000
    """Training pairs; the labels' own are repeated until there are so many."""


@dataclass(frozen=True)
class BenchSrm(Output):
    """Train relation networks on rendered rooms, and measure them in other rooms and from other cameras."""

    rooms: int = 120
    """One in three is measured on."""
    views: int = 2
    """Views of each room."""
    pairs: tuple[int, ...] = (1000, 0)
    """Numbers of pairs to learn from; 0 for all."""
    features: tuple[Features, ...] = ("2d", "3d", "rel14")
    """What the networks are given of a pair."""
    networks: int = 3
    """Networks of each kind, each with its own seed and its own draw of pairs."""
    labels: Literal["exact", "seen"] = "exact"
    """exact: the rule on whole objects as they are | seen: on the noisy parts that are seen, as auto-labels are."""
    batch: Batch = None
    epochs: Epochs = 10
    seed: int = 0
    """Another seed makes other rooms and networks."""
    workers: Workers = CPUS


@dataclass(frozen=True)
class BenchReview(Output):
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
    """Share that is looked at once those are mended and the queue is built again."""
    labels: Literal["exact", "seen"] = "seen"
    """exact: the rule on whole objects as they are | seen: on the noisy parts that are seen, as auto-labels are."""
    folds: int = 5
    passes: int = 3
    """As of `review`."""
    networks: int = 2
    """Trained on each set of labels, F1 averaged."""
    batch: Batch = None
    seeds: int = 3
    """Repetitions with other errors and other networks in the same rooms."""
    seed: int = 0
    """Another seed makes other rooms."""
    workers: Workers = CPUS


@dataclass(frozen=True)
class BenchDetect(Output):
    """Run a detector over a dataset's frames again and again: frames a second, and how much memory it holds."""

    dataset: DatasetArg
    source: OmitArgPrefixes[FramesOptions] = FramesOptions()
    count: int = 1000
    """Pictures, each different to the detector and its cache."""
