"""Relations as the dataset itself gives them, by its own referring expressions."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from pipeline.datasets import GivenExpression
from pipeline.labels.profiles import Judged
from pipeline.language.relation_names import PAIRWISE
from pipeline.relations.relations import F, T


def as_given(judged: Judged, numbers: Sequence[int], given: Sequence[GivenExpression]) -> Judged:
    """The judgements with the states that a dataset's expressions say.

    An expression that means one target and one reference makes its relation T,
    and what no expression says of that pair F. Where several references (or
    targets) may be meant, their pairs stay U in that relation. A pair of which
    nothing is said stays U throughout: it may have been passed over.

    Parameters
    ----------
    judged : Judged
        Of N objects; its states are U where nothing is given.
    numbers : sequence of N
        The objects' places in the dataset's own list of annotations.
    given : sequence of GivenExpression

    Returns
    -------
    Judged
        Margins are 0: no geometry was asked.
    """
    place = {number: k for k, number in enumerate(numbers)}
    sure, told = np.zeros(judged.states.shape, np.bool_), np.zeros(judged.states.shape, np.bool_)
    for expression in given:
        column = PAIRWISE.index(expression.relation)
        ends = [(a, b) for a in expression.target_indices for b in expression.reference_indices if a != b]
        for a, b in ends:
            if a in place and b in place:
                (sure if len(ends) == 1 else told)[place[a], place[b], column] = True
    states = judged.states.copy()
    states[sure.any(axis=2) & ~np.eye(len(numbers), dtype=np.bool_)] = F
    states[told & ~sure] = judged.states[told & ~sure]
    states[sure] = T
    return replace(judged, states=states, margins=np.zeros(judged.margins.shape))
