"""Parametrized cases of which the first few run always, and the rest with the slow tests."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

import pytest
from _pytest.mark.structures import ParameterSet


def mostly_slow(cases: Iterable[Any], fast: Sequence[int] = (0,), several: bool = False) -> list[ParameterSet]:
    """Cases for `pytest.mark.parametrize`.

    Parameters
    ----------
    cases
        Values; tuples of them where a test takes `several`.
    fast
        Places of the cases that are not slow.
    """
    marks = {False: [pytest.mark.slow], True: []}
    return [
        pytest.param(*(case if several else [case]), marks=marks[place in fast]) for place, case in enumerate(cases)
    ]
