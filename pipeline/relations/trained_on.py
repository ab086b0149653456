"""What a relation network has learnt from, so that it is not measured on it unawares."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from pipeline.metrics.splits import DROPPED, TRAIN, VALIDATION

if TYPE_CHECKING:
    from pipeline.labels.reading import Labels
    from pipeline.metrics.splits import FrameKey, SplitPlan


@dataclass(frozen=True)
class TrainedOn:
    """The part of a dataset that a network was trained and calibrated on.

    Attributes
    ----------
    dataset : str
        Name of its folder.
    input_hash : str
        Of the dataset's files, as the labels' manifest has it.
    content_hash : str
        Of the labels' table of frames.
    split : str
        "scene": `train` and `validation` name scenes. "blocks", "random": frames.
    train, validation : tuple of str
    scenes : tuple of str
        Of all frames in either.
    """

    dataset: str
    input_hash: str
    content_hash: str
    split: str
    train: tuple[str, ...]
    validation: tuple[str, ...]
    scenes: tuple[str, ...]

    @classmethod
    def of(cls, labels: Labels, plan: SplitPlan) -> TrainedOn:
        """What a network of these labels and this split learns from."""
        name, input_hash, content = identity(labels)
        inside = {part: [plan.frames[k] for k in plan.places(part)] for part in (TRAIN, VALIDATION)}
        whole = plan.kind == "scene"
        names = {part: tuple(dict.fromkeys(f.scene if whole else f.frame for f in frames))
                 for part, frames in inside.items()}  # fmt: skip
        scenes = tuple(sorted({f.scene for frames in inside.values() for f in frames}))
        return cls(name, input_hash, content, plan.kind, names[TRAIN], names[VALIDATION], scenes)

    def same_dataset(self, labels: Labels) -> bool:
        """Whether these labels are of the dataset that was learnt from."""
        name, input_hash, content = identity(labels)
        return (
            content == self.content_hash
            or (input_hash != "" and input_hash == self.input_hash)
            or (name != "" and name == self.dataset)
        )

    def parts(self, labels: Labels, frames: Sequence[FrameKey]) -> np.ndarray:
        """(F,) int8: TRAIN or VALIDATION where the network knows a frame; DROPPED where it has not seen it."""
        found = np.full(len(frames), DROPPED, np.int8)
        if not self.same_dataset(labels):
            return found
        train, validation = set(self.train), set(self.validation)
        for k, frame in enumerate(frames):
            name = frame.scene if self.split == "scene" else frame.frame
            if name in train:
                found[k] = TRAIN
            elif name in validation:
                found[k] = VALIDATION
        return found

    def to_json(self) -> str:
        """As one line of JSON."""
        return json.dumps({k: list(v) if isinstance(v, tuple) else v for k, v in vars(self).items()})

    @classmethod
    def from_json(cls, text: str) -> TrainedOn:
        """The reverse; KeyError, TypeError or ValueError where it is something else."""
        said = json.loads(text)
        texts: dict[str, Any] = {k: str(said[k]) for k in ("dataset", "input_hash", "content_hash", "split")}
        if not all(isinstance(said[k], list) for k in ("train", "validation", "scenes")):
            raise ValueError("what was learnt from must be lists of names")
        lists: dict[str, Any] = {k: tuple(map(str, said[k])) for k in ("train", "validation", "scenes")}
        return cls(**texts, **lists)


def identity(labels: Labels) -> tuple[str, str, str]:
    """Name of the dataset's folder, hash of its files ("" where the manifest has none), hash of the frames' table."""
    dataset = labels.manifest.dataset
    return (
        Path(str(dataset.get("path", ""))).name,
        str(dataset.get("input_hash", "")),
        labels.manifest.tables["frames"].content_hash,
    )
