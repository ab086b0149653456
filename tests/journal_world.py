"""What tests of corrections do to the demo's labels; the labels themselves are fixtures."""

from __future__ import annotations

from typing import Any

import numpy as np

from pipeline.journal.effective_frame import EffectiveFrame
from pipeline.journal.events import Event, Saved
from pipeline.journal.journal import Journal
from pipeline.run_length import decode_run_length

FRAME = "000001/000000"


def saved(journal: Journal, made: tuple[Any, ...], author: str = "ann") -> tuple[Event, ...]:
    done = journal.append(made, author)
    assert isinstance(done, Saved), done
    return done.events


def an_expression(frame: EffectiveFrame) -> dict[str, Any]:
    """One of a directional relation."""
    return next(row for row in frame.expressions.values() if row["relation"] in ("left", "right", "front", "behind"))


def half_of(frame: EffectiveFrame, number: int) -> tuple[np.ndarray, np.ndarray]:
    """The left and the right half of an object's pixels."""
    mask = decode_run_length((frame.row["height"], frame.row["width"]), frame.objects[number]["mask"])
    columns = np.flatnonzero(mask.any(axis=0))
    left = mask.copy()
    left[:, columns[len(columns) // 2] :] = False
    return left, mask & ~left


def widest(frame: EffectiveFrame) -> int:
    return max(frame.pairs.numbers.tolist(), key=lambda n: frame.objects[n]["mask_pixels"])
