"""What tests of review states share."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from journal_world import FRAME

from pipeline.corrections import Corrector, EffectiveFrame, FieldRef, ItemKey, Journal, State
from pipeline.corrections.review.items import judgements_of
from pipeline.relations import T


def states_of(journal: Journal, author: str | None = None) -> dict[ItemKey, State]:
    """The state of every reviewed item, over all or by one person."""
    return judgements_of(journal).states(author)


@pytest.fixture
def frame(bare_corrector: Corrector, journal: Journal) -> Any:
    """The frame as it is each time it is asked for."""
    return lambda: bare_corrector.frame(FRAME, journal)


def some_pairs(frame: EffectiveFrame, count: int) -> list[tuple[int, int]]:
    """Pairs of which the first is left of the second, no two of the same two objects."""
    k = 0
    places = np.argwhere(frame.pairs.present & (frame.pairs.states[..., k] == T))[:count]
    return [(int(a), int(b)) for a, b in frame.pairs.numbers[places]]


def left(a: int, b: int) -> ItemKey:
    return ItemKey(FRAME, "relation", a, b, "left")


def status_cell(a: int, b: int) -> FieldRef:
    return FieldRef("relation", FRAME, f"{a},{b}", "left.status")
