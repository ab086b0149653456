"""The subsets that the relation method is reported on, picked expression by expression from a dataset's splits."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Protocol

from pipeline.datasets import GivenExpression
from pipeline.datasets.semantic_abstraction_splits import (
    _OTHER_NAMES,
    NOVEL_CLASSES,
    RANDOMIZED_ROOMS,
    ROOMS,
    SYNONYM_ROOMS,
)


class SplitDataset(Protocol):
    """What the subsets are made of: `base.splits` and `base.given_expressions`."""

    def splits(self) -> dict[str, tuple[str, ...]]: ...

    def given_expressions(self, frame_id: str) -> tuple[GivenExpression, ...]: ...


@dataclass(frozen=True)
class SubsetExpression:
    """One expression of a reported subset.

    Attributes
    ----------
    split : str
        The split it comes from: "unseen_instances", "unseen_instances_dr", "unseen_instances_synonyms".
    frame_id : str
    expression : GivenExpression
    """

    split: str
    frame_id: str
    expression: GivenExpression


def novel_room(dataset: SplitDataset, file: str = "vool") -> Iterator[SubsetExpression]:
    """Expressions about rooms that no training view shows, without the novel classes."""
    return _chosen(dataset, file, (ROOMS,), lambda e: not has_novel_class(e))


def novel_visual(dataset: SplitDataset, file: str = "vool") -> Iterator[SubsetExpression]:
    """The same of views with randomised materials; their frame ids load the randomised picture.

    As in the published evaluation the novel classes are left out here too.
    """
    return _chosen(dataset, file, (RANDOMIZED_ROOMS,), lambda e: not has_novel_class(e))


def novel_vocabulary(dataset: SplitDataset, file: str = "vool") -> Iterator[SubsetExpression]:
    """Expressions whose target or reference is called by its synonym."""
    return _chosen(dataset, file, (SYNONYM_ROOMS,), lambda e: bool({e.target, e.reference} & _OTHER_NAMES))


def novel_class(dataset: SplitDataset, file: str = "vool") -> Iterator[SubsetExpression]:
    """Expressions of all unseen splits whose target or reference is of a class that no training view shows."""
    return _chosen(dataset, file, (ROOMS, RANDOMIZED_ROOMS, SYNONYM_ROOMS), has_novel_class)


def has_novel_class(expression: GivenExpression) -> bool:
    """Whether the target or the reference is of one of the `NOVEL_CLASSES`."""
    return expression.target in NOVEL_CLASSES or expression.reference in NOVEL_CLASSES


def _chosen(
    dataset: SplitDataset, file: str, names: tuple[str, ...], keep: Callable[[GivenExpression], bool]
) -> Iterator[SubsetExpression]:
    splits = dataset.splits()
    for name in names:
        for frame_id in splits.get(f"{file}/{name}", ()):
            for expression in dataset.given_expressions(frame_id):
                if keep(expression):
                    yield SubsetExpression(name, frame_id, expression)
