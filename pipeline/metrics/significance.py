"""Whether two systems that answered the same questions differ."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from pipeline.metrics.inputs import checked_flags
from pipeline.system.errors import InputError


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
