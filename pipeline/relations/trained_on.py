"""What a relation network has learnt from, so that it is not measured on it unawares."""

from __future__ import annotations

import json
from dataclasses import dataclass
from typing import Any


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
