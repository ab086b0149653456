"""What is reviewed, item by item: its key, its state, the order it is worked through, and how far a review has come."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Literal, NamedTuple, get_args

import numpy as np

from pipeline.system.errors import InputError, require

if TYPE_CHECKING:
    import pyarrow as pa

Kind = Literal["relation", "object", "expression"]
State = Literal["unreviewed", "accepted", "corrected", "rejected", "unsure"]
KINDS: tuple[Kind, ...] = get_args(Kind)
STATES: tuple[State, ...] = get_args(State)
DISAGREED = 1 - 1e-6
"""The weight of an item on which reviewers say different things: above all that machines find."""
SETTLED: tuple[State, ...] = ("accepted", "corrected", "rejected")
"""Nothing is left to do; an item that a reviewer is unsure of may be asked of another."""
NOBODY = -1
"""In place of an object's number where there is none."""
BLOCK = 60
"""Items that are as good as equally undecided: what differs little in rank may be looked at in any order."""


class ItemKey(NamedTuple):
    """What names a label in every version of a dataset's labels.

    Attributes
    ----------
    frame : str
        The frame's id.
    kind : str
        "relation", "object" or "expression".
    a : int
        Number of the object; of a pair, of the one that is said to be somewhere. NOBODY of an expression, and where
        an object may be missing.
    b : int or None
        The other object of a pair.
    what : str
        The relation, or the expression's id; empty for objects. Where one may be missing, the place: see
        `missing_object`.
    """

    frame: str
    kind: str
    a: int
    b: int | None
    what: str

    def text(self) -> str:
        """As one line of JSON; equal keys have equal texts."""
        return json.dumps(list(self), ensure_ascii=False, separators=(",", ":"))

    @property
    def plain(self) -> ItemKey:
        """The same; of an expression without its objects: its id names it, and a journal knows no more."""
        return self._replace(a=NOBODY, b=None) if self.kind == "expression" else self

    @classmethod
    def read(cls, text: str) -> ItemKey:
        """The reverse.

        Raises
        ------
        InputError
            It is no key.
        """
        try:
            frame, kind, a, b, what = json.loads(text)
        except (ValueError, TypeError) as error:
            raise InputError("not the key of a review item", got=repr(text)[:80]) from error
        numbers = type(a) is int and (b is None or type(b) is int)
        require(
            isinstance(frame, str) and kind in KINDS and numbers and isinstance(what, str),
            "not the key of a review item",
            got=repr(text)[:80],
        )
        return cls(frame, kind, a, b, what)


def missing_object(frame: str, bbox: Sequence[float]) -> ItemKey:
    """The key of a place (x0, y0, x1, y1, pixels) where an object may be missing."""
    return ItemKey(frame, "object", NOBODY, None, ",".join(str(round(float(x))) for x in bbox))


def item_keys(queue: pa.Table) -> list[ItemKey]:
    """The keys of a queue's rows, in their order; of expressions without their objects, see `ItemKey.plain`."""
    names = ("frame", "kind", "a", "b", "relation", "expression", "place")
    absent = [None] * queue.num_rows
    known = set(queue.column_names)
    frame, kind, a, b, relation, expression, place = (
        queue.column(name).to_pylist() if name in known else absent for name in names
    )
    what = [r or e or p or "" for r, e, p in zip(relation, expression, place, strict=True)]
    return [
        ItemKey(f, k, NOBODY, None, w) if k == "expression" else ItemKey(f, k, i, j, w)
        for f, k, i, j, w in zip(frame, kind, a, b, what, strict=True)
    ]


def with_states(queue: pa.Table, states: Mapping[ItemKey, State]) -> pa.Table:
    """The queue with a column `state`; what the mapping lacks is unreviewed.

    Raises
    ------
    InputError
        A state is none of STATES.
    """
    import pyarrow as pa

    checked_states(states)
    if "state" in queue.column_names:
        queue = queue.drop_columns(["state"])
    column = [states.get(key, "unreviewed") for key in item_keys(queue)]
    return queue.append_column("state", pa.array(column, pa.string()))


def left_to_review(queue: pa.Table, states: Mapping[ItemKey, State]) -> pa.Table:
    """The rows that are not settled, in the order of the queue; those that someone is unsure of last.

    What reviewers judge differently is unsure, too, but stays where it is: at the top.
    """
    import pyarrow as pa

    known = with_states(queue, states)
    column, disputed = known.column("state").to_pylist(), disputed_rows(known)
    last = [state == "unsure" and not first for state, first in zip(column, disputed.tolist(), strict=True)]
    is_open = [k for k, state in enumerate(column) if state not in SETTLED]
    return known.take(pa.array(sorted(is_open, key=lambda k: last[k]), pa.int64()))


def disputed_rows(queue: pa.Table) -> np.ndarray:
    """(N,) bool: what reviewers judge differently, by its score."""
    if "score" not in queue.column_names:
        return np.zeros(queue.num_rows, np.bool_)
    score = queue.column("score").to_numpy(zero_copy_only=False).astype(np.float64)
    return score >= DISAGREED


def progress_counts(queue: pa.Table, states: Mapping[ItemKey, State]) -> dict[str, int]:
    """How many items there are, in each state, settled, and not in the queue any more though they have a state."""
    keys = item_keys(queue)
    checked_states(states)
    counts = dict.fromkeys(STATES, 0)
    for key in keys:
        counts[states.get(key, "unreviewed")] += 1
    settled = sum(counts[state] for state in SETTLED)
    return {"items": len(keys), **counts, "settled": settled, "elsewhere": len(set(states) - set(keys))}


def checked_states(states: Mapping[ItemKey, str]) -> None:
    """Raise InputError for a state that is none."""
    for key, state in states.items():
        if state not in STATES:
            raise InputError(f"no such state of review item {key.text()}", got=repr(state), expected=" | ".join(STATES))


def by_frame(queue: pa.Table, block: int = BLOCK) -> pa.Table:
    """The queue with the items of a frame next to each other within every `block` items.

    Frames stand in the order of their first item of the block, and the items of
    a frame, pair by pair, in the order in which the pair's first one stood.
    """
    if not queue.num_rows:
        return queue
    rank = np.arange(queue.num_rows)
    part = rank // max(block, 1)
    frame = np.unique(queue.column("frame").to_numpy(zero_copy_only=False), return_inverse=True)[1]
    a = queue.column("a").to_numpy().astype(np.int64)
    b = np.nan_to_num(queue.column("b").to_numpy(zero_copy_only=False).astype(np.float64), nan=-1).astype(np.int64)
    of_frame = _first(rank, part, frame)
    of_pair = _first(rank, part, frame, np.minimum(a, b), np.maximum(a, b))
    return queue.take(np.lexsort((rank, of_pair, of_frame, part)))


def _first(rank: np.ndarray, *keys: np.ndarray) -> np.ndarray:
    """(N,) int: the rank of the first row that agrees in all keys."""
    _, group = np.unique(np.stack(keys, axis=1), axis=0, return_inverse=True)
    first = np.full(int(group.max()) + 1, len(rank), np.int64)
    np.minimum.at(first, group.ravel(), rank)
    return first[group.ravel()]
