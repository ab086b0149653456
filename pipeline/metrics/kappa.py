"""Cohen's kappa of two people's states."""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from dataclasses import dataclass
from typing import Any, TypeVar

import numpy as np

from pipeline.system.errors import InputError

Key = TypeVar("Key", bound=Hashable)


@dataclass(frozen=True, eq=False)
class Agreement:
    """Two reviewers' judgements of the same items.

    Attributes
    ----------
    judgements : tuple of str
        What either said, sorted: the order of rows and columns.
    table : (J, J) int64
        Items by what the first said (rows) and the second (columns).
    observed, expected : float
        Share of items judged alike, and the share by chance with each one's own habits; NaN without items.
    kappa : float
        (observed - expected) / (1 - expected); NaN where both always said the same one thing.
    """

    judgements: tuple[str, ...]
    table: np.ndarray
    observed: float
    expected: float
    kappa: float

    @property
    def items(self) -> int:
        return int(self.table.sum())

    def record(self) -> dict[str, Any]:
        """As JSON; None where a figure has no meaning."""
        figures = {name: float(getattr(self, name)) for name in ("observed", "expected", "kappa")}
        return {
            "items": self.items,
            **{name: value if np.isfinite(value) else None for name, value in figures.items()},
            "judgements": list(self.judgements),
            "table": self.table.tolist(),
        }


def cohen_kappa(first: Sequence[str], second: Sequence[str]) -> Agreement:
    """Agreement on items that both judged, in the same order.

    Raises
    ------
    InputError
        Not one judgement of each for every item.
    """
    if len(first) != len(second):
        raise InputError("both reviewers must have judged the same items", got=f"{len(first)} and {len(second)}")
    names, codes = np.unique(np.array([*first, *second], np.str_), return_inverse=True)
    table = np.zeros((len(names), len(names)), np.int64)
    np.add.at(table, (codes[: len(first)], codes[len(first) :]), 1)
    judgements = tuple(str(name) for name in names)
    if not len(first):
        return Agreement(judgements, table, float("nan"), float("nan"), float("nan"))
    share = table / table.sum()
    observed = float(np.trace(share))
    expected = float(share.sum(axis=1) @ share.sum(axis=0))
    kappa = (observed - expected) / (1 - expected) if expected < 1 else float("nan")
    return Agreement(judgements, table, observed, expected, kappa)
