"""Whether two systems that answered the same questions differ, and how far two people agree (Cohen's kappa)."""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from dataclasses import dataclass
from typing import Any, TypeVar

import numpy as np

from pipeline.metrics.inputs import checked_flags
from pipeline.system.errors import InputError

Key = TypeVar("Key", bound=Hashable)


@dataclass(frozen=True)
class McNemar:
    """McNemar's exact test.

    Attributes
    ----------
    n : int
        Questions.
    b, c : int
        Questions that only the first, only the second system answered rightly.
    p_value : float
        Two-sided; 1 where the systems never disagree.
    """

    n: int
    b: int
    c: int
    p_value: float


def mcnemar(first: Any, second: Any) -> McNemar:
    """McNemar's exact test: the binomial probability of a split of the b + c disagreements at least as uneven.

    It takes the questions as independent. Questions about one scene are not, so
    that its p-value is too small where scenes differ; the clustered interval of
    the difference (`pipeline.metrics.intervals`) does not need that.

    Parameters
    ----------
    first, second : (N,) bool
        Whether each question was answered rightly.

    Raises
    ------
    InputError
        Lengths differ, or values are neither true nor false.
    """
    first, second = checked_flags(first, "answers of the first"), checked_flags(second, "answers of the second")
    if first.shape != second.shape:
        raise InputError("paired systems must have answered the same questions", got=second.shape, expected=first.shape)
    b, c = int((first & ~second).sum()), int((~first & second).sum())
    return McNemar(len(first), b, c, _two_sided(b, c))


def _two_sided(b: int, c: int) -> float:
    if b == c:
        return 1.0
    from scipy.special import bdtr

    # Under one half the distribution is symmetric, so that both tails weigh the same.
    return min(1.0, 2 * float(bdtr(min(b, c), b + c, 0.5)))


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
