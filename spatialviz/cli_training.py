"""The command that trains relation networks."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from tyro.conf import Positional

from pipeline.system.errors import InputError
from spatialviz.exits import FINE
from spatialviz.options import print_json

if TYPE_CHECKING:
    from pipeline.training.train import TrainConfig

ROOMS = "rooms"


@dataclass(frozen=True)
class Train:
    """Train a relation network on labels or on rendered rooms, calibrate it, and measure it on what it has not seen."""

    labels: Positional[str]
    """Labels folder of `spatialviz label`; or the word "rooms", for rooms rendered on the spot."""
    out: Path
    """ONNX file to write; its card goes beside it as JSON, and the class vectors of +lang as .vectors.npz."""
    features: Literal["2d", "2d+lang", "3d", "3d+lang", "canon", "rel14", "rel14+lang", "rel26"] | None = None
    """What the network is given of a pair: 2D boxes | the paper's PCA boxes | these, canonical | relative extents |
    these, with sizes, places and cuts by the border; +lang adds the vectors of both class names. Default: rel14 on
    labels, rel26 on rooms."""
    vocabulary: Literal["avd", "semantic-abstraction"] = "avd"
    """avd: six relations that may hold together (binary cross entropy, U masked); semantic-abstraction: six of which
    one fits (cross entropy; the class prior is divided out in ranking)."""
    epochs: int = 10
    """The learning rate, 1e-3, is halved every 3."""
    batch: int | None = None
    """Pairs in a step. Default: 256, less where there are few pairs, so that there are at least 290 steps an epoch."""
    seed: int = 0
    """The same seed gives the same network."""
    vectors: Path | None = None
    """Text vectors for +lang: .vec, .vec.gz, .bin, .npz or .json."""
    normalised: bool = False
    """Divide word vectors by their lengths before a name's mean is taken."""
    split: Literal["scene", "blocks", "random"] | None = None
    """Default: scene where there are at least three, else blocks of camera positions. random leaks."""
    pairs: int | None = None
    """Learn from at most so many pairs, drawn at random. Default: all."""
    rooms: int | None = None
    """Rooms, 150: 7 in 10 to learn from, 1 to calibrate, 2 to measure; and as many scattered ones to learn from."""
    views: int | None = None
    """Views of each room, 4."""
    width: int | None = None
    """Of the rooms' views, 480 pixels."""
    height: int | None = None
    """Of the rooms' views, 360 pixels."""
    workers: int = os.cpu_count() or 1
    """Rooms made at once, each by a process of its own. The network does not depend on it."""
    json: bool = False
    """Print the card."""

    def run(self) -> int:
        from spatialviz.printing_training import print_label_training, print_training

        on_rooms = self.labels == ROOMS
        card = self._on_rooms() if on_rooms else self._on_labels()
        if self.json:
            print_json(card)
        elif on_rooms:
            print_training(card, self.out)
        else:
            print_label_training(card, self.out)
        return FINE

    def _config(self) -> TrainConfig:
        from pipeline.relations.features import CLI_FEATURES
        from pipeline.training.train import TrainConfig

        features = self.features or ("rel26" if self.labels == ROOMS else "rel14")
        return TrainConfig(
            CLI_FEATURES[features], self.vocabulary, batch=self.batch, epochs=self.epochs, seed=self.seed
        )

    def _on_labels(self) -> dict:
        from pipeline.training.label_training import LabelTraining, train_on_labels
        from spatialviz.printing_training import epoch_bar

        self._refuse("the word rooms", ("rooms", "views", "width", "height"))
        config = self._config()
        job = LabelTraining(Path(self.labels), config, self.split, self.vectors, self.normalised, self.pairs)
        with epoch_bar(self.epochs) as tell:
            return train_on_labels(job, self.out, tell)

    def _on_rooms(self) -> dict:
        from pipeline.training.card import RoomConfig, train_on_rooms
        from spatialviz.printing import progress_bars

        self._refuse("a labels folder", ("vectors", "split", "pairs", "normalised"))
        names = ("rooms", "views", "width", "height")
        given = {name: getattr(self, name) for name in names if getattr(self, name) is not None}
        config = self._config()
        with progress_bars() as advance:
            return train_on_rooms(
                self.out, RoomConfig(**given, seed=self.seed), config, workers=self.workers, progress=advance
            )

    def _refuse(self, place: str, names: tuple[str, ...]) -> None:
        """Options that say nothing about what is trained on are a mistake, not to be passed over."""
        for name in names:
            if getattr(self, name) not in (None, False):
                raise InputError(f"--{name} belongs to training on {place}", got=f"training on {self.labels!r}")
