"""What only some datasets have: moves between frames, expressions of their own, splits, frames without annotations.

A dataset has one of them where it has the method of that name; the functions
here ask for it, and give nothing for a dataset without it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from pipeline.datasets.base import Dataset
from pipeline.geometry.frame import Frame

MOVES = ("rotate_ccw", "rotate_cw", "forward", "backward", "left", "right")
"""The moves of a robot from one frame to another, in the order in which they are always given:
turning left and right (seen from above, counter-clockwise is to the left), then stepping."""


@dataclass(frozen=True)
class GivenExpression:
    """A referring expression that the dataset itself gives for a frame.

    Attributes
    ----------
    text : str
        As the dataset says it: "mug on the left of a laptop".
    target, reference : str
        Class names.
    relation : str
        One of ours: "left", "right", "front", "behind", "on", "in".
    target_indices, reference_indices : tuple of int
        Every annotation (its `index`) that is meant; empty where none of them can be seen in the frame.
    """

    text: str
    target: str
    relation: str
    reference: str
    target_indices: tuple[int, ...] = ()
    reference_indices: tuple[int, ...] = ()


def has_moves(dataset: Dataset) -> bool:
    """Whether the dataset says which frame a move leads to."""
    return callable(getattr(dataset, "moves", None))


def moves(dataset: Dataset, frame_id: str) -> dict[str, str]:
    """Where the moves that are possible from a frame lead: move to frame id, in the order of `MOVES`.

    Raises
    ------
    InputError
        The dataset has moves, and no such frame.
    """
    found: dict[str, str] = _ask(dataset, "moves", {}, frame_id)
    return {move: found[move] for move in MOVES if move in found}


def given_expressions(dataset: Dataset, frame_id: str) -> tuple[GivenExpression, ...]:
    """The dataset's own expressions about a frame; empty for a dataset that gives none.

    Raises
    ------
    InputError
        The dataset gives expressions, and no such frame, or its file is broken.
    """
    return _ask(dataset, "given_expressions", (), frame_id)


def splits(dataset: Dataset) -> dict[str, tuple[str, ...]]:
    """The frames of each of the dataset's own splits by the split's name; empty for a dataset without any.

    Raises
    ------
    InputError
        A split file that cannot be read, or must not be.
    """
    return _ask(dataset, "splits", {})


def dataset_notes(dataset: Dataset) -> tuple[str, ...]:
    """What holds for every frame and no file states: a unit or a camera that the format is known for, each with the
    option that tells another; empty for a dataset whose files say all."""
    return getattr(dataset, "notes", ())


def load_picture(dataset: Dataset, frame_id: str) -> Frame:
    """A frame for those who need no annotations: without them where the dataset can leave them out, else whole.

    Raises
    ------
    InputError
        As `Dataset.load`.
    """
    method: Any = getattr(dataset, "load_picture", None)
    return dataset.load(frame_id) if method is None else method(frame_id)


def _ask(dataset: Dataset, capability: str, nothing: Any, *arguments: str) -> Any:
    method = getattr(dataset, capability, None)
    return method(*arguments) if callable(method) else nothing
