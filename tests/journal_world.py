"""What tests of corrections do to the demo's labels; the labels themselves are fixtures."""

from __future__ import annotations

import random
from typing import Any

import numpy as np

from pipeline.corrections import (
    Edit,
    EffectiveFrame,
    Event,
    FieldRef,
    Journal,
    Saved,
    object_ref,
    redo,
    relation_ref,
    undo,
)
from pipeline.geometry import decode_run_length, encode_run_length

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


def work_of(journal: Journal, events: int, seed: int = 0) -> None:
    """Let three people correct labels until there are so many events: names, relations, sentences, undo and redo."""
    rng = random.Random(seed)
    seen: dict[FieldRef, tuple[int, Any]] = {}
    mask = encode_run_length(np.eye(96, 128, dtype=bool))
    made = 0
    while made < events:
        author = rng.choice(["ann", "ben", "椅子"])
        frame = f"{rng.randrange(3):06d}/{rng.randrange(20):06d}"
        turn = rng.random()
        if turn < 0.15:
            done = (undo if turn < 0.1 else redo)(journal, author)
        else:
            cells = {object_ref(frame, rng.randrange(40), "label"): rng.choice(["mug", "cup", "desk lamp", "椅"])}
            if turn < 0.6:
                a, b = rng.sample(range(40), 2)
                cells = {relation_ref(frame, a, b, "left"): rng.choice([-1, 0, 1])}
                cells[relation_ref(frame, b, a, "right")] = rng.choice([-1, 0, 1])
            elif turn < 0.63:
                cells = {object_ref(frame, rng.randrange(40), "mask"): mask}
            elif turn < 0.7:
                cells = {
                    FieldRef("expression", frame, f"{rng.getrandbits(64):016x}", "text"): "the mug left of the lamp"
                }
            reason = "x" * 1_900 if rng.random() < 0.02 else rng.choice(["", "it has no handle", "steht auf dem Tisch"])
            automatic = {"label": "cup", "left": 0, "right": 0, "mask": mask, "text": "the cup left of the lamp"}
            edits = []
            for cell, value in cells.items():
                version, before = seen.get(cell, (0, automatic[cell.field]))
                edits.append(Edit(cell, before, value, version, reason, {"3": [1.0, 2.5, 30.0, 1 / 3 + 9]}))
            done = journal.append(edits, author)
        if isinstance(done, Saved):
            made += len(done.events)
            seen |= {e.ref: (e.version, e.after) for e in done.events}
