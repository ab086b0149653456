"""The command that compares feature contracts on rendered rooms."""

from __future__ import annotations

import os
from dataclasses import dataclass
from typing import Literal

from spatialviz.exits import FINE
from spatialviz.options import print_json


@dataclass(frozen=True)
class BenchSrm:
    """Train relation networks on rendered rooms, and measure them in other rooms and from other cameras."""

    rooms: int = 120
    """One in three is measured on."""
    views: int = 2
    """Views of each room."""
    pairs: tuple[int, ...] = (1000, 0)
    """Numbers of pairs to learn from; 0 for all."""
    features: tuple[Literal["2d", "3d", "canon", "rel14", "rel26"], ...] = ("2d", "3d", "rel14")
    """What the networks are given of a pair."""
    networks: int = 3
    """Networks of each kind, each with its own seed and its own draw of pairs."""
    labels: Literal["exact", "seen"] = "exact"
    """exact: the rule on whole objects as they are | seen: on the noisy parts that are seen, as auto-labels are."""
    batch: int | None = None
    """Pairs in a step. Default: 256, less where there are few pairs, so that there are at least 290 steps an epoch."""
    epochs: int = 10
    """The learning rate, 1e-3, is halved every 3 of 10."""
    seed: int = 0
    """Another seed makes other rooms and networks."""
    workers: int = os.cpu_count() or 1
    """Rooms made at once. The figures do not depend on it."""
    json: bool = False
    """Print one JSON object."""

    def run(self) -> int:
        from pipeline.relations.features import CLI_FEATURES
        from pipeline.training.ablation import AblationConfig, compare_features
        from pipeline.training.train import TrainConfig
        from spatialviz.printing import progress_bars
        from spatialviz.printing_eval import print_table, table_record

        config = AblationConfig(
            rooms=self.rooms,
            views=self.views,
            pairs=self.pairs,
            features=tuple(CLI_FEATURES[name] for name in self.features),
            networks=self.networks,
            labels=self.labels,
            train=TrainConfig(batch=self.batch, epochs=self.epochs, seed=self.seed),
        )
        with progress_bars() as advance:
            table = compare_features(config, workers=self.workers, progress=advance)
        if self.json:
            print_json(table_record(table))
        else:
            print_table(table)
        return FINE
