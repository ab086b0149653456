"""The chain: each event carries a hash of the one before it and of all that is in it, so that no change goes unseen."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from datetime import timezone
from typing import Any

FIRST = "0" * 64
"""What the first event is chained to."""
CONTENT = (
    "id", "ulid", "project", "author", "time", "kind", "frame", "key", "field", "before", "after", "base", "version",
    "labels", "reason", "group", "action", "undo_of", "anchor",
)  # fmt: skip
"""All columns but the hash, in the order in which they are hashed."""
Row = Mapping[str, Any]
_JSON = json.JSONEncoder(sort_keys=True, separators=(",", ":"))


def link(previous: str, row: Row) -> str:
    """The hash of an event: SHA-256 of the JSON of the hash before it and its columns, 64 hexadecimal digits.

    The JSON is the same whichever database it comes from: ASCII, keys sorted, times in UTC to the microsecond.

    Raises
    ------
    TypeError, ValueError, AttributeError
        A column holds what is no value of it.
    """
    time = row["time"].astimezone(timezone.utc).isoformat(timespec="microseconds")
    told = [previous, *(time if name == "time" else row[name] for name in CONTENT)]
    return hashlib.sha256(_JSON.encode(told).encode()).hexdigest()


def chained(previous: str, rows: Iterable[Row]) -> list[dict[str, Any]]:
    """Rows with their hashes, in the order of their ids."""
    found = []
    for row in rows:
        previous = link(previous, row)
        found.append({**row, "hash": previous})
    return found


@dataclass(frozen=True)
class Head:
    """What the journal says of its last event.

    Attributes
    ----------
    events : int
        How many there are.
    last : int
        The last one's id; 0 where there is none.
    hash : str
        The last one's.
    """

    events: int
    last: int
    hash: str


@dataclass(frozen=True)
class Verdict:
    """What a chain says of its events.

    Attributes
    ----------
    intact : tuple of dict
        Events that are as they were saved.
    damage : tuple of str
        What is wrong, each in a clause; empty where nothing is.
    """

    intact: tuple[Row, ...]
    damage: tuple[str, ...]


def judged(rows: Sequence[tuple[int, Row | None]], head: Head | None) -> Verdict:
    """Compare events with their hashes and with the head.

    An event is intact where its hash is that of the event before it and its
    own content, or where the next one's hash says so: then only the hash was
    damaged.

    Parameters
    ----------
    rows : sequence of (int, dict or None)
        Ids, and what could be read of each, in the order of the ids.
    head : Head or None
        None where it cannot be read.
    """
    intact: list[Row] = []
    damage: list[str] = []
    # The hashes that the event before may have had: as it is kept, and as it is computed.
    before: tuple[str, ...] = (FIRST,)
    waiting: tuple[Row, str] | None = None
    for number, row in rows:
        made = [] if row is None else [_link(p, row) for p in before]
        if row is not None and row["hash"] in made:
            if waiting is not None and made[before.index(waiting[1])] == row["hash"]:
                intact.append({**waiting[0], "hash": waiting[1]})
            intact.append(row)
            before, waiting = (str(row["hash"]),), None
            continue
        damage.append(f"event {number} cannot be read" if row is None else f"event {number} is not as it was saved")
        computed = made[0] if made else None
        waiting = None if row is None or computed is None or len(before) > 1 else (row, computed)
        kept = None if row is None else row["hash"]
        before = tuple(h for h in (kept, computed) if isinstance(h, str))
    if waiting is not None and head is not None and head.hash == waiting[1]:
        intact.append({**waiting[0], "hash": waiting[1]})
    if head is None:
        damage.append("which event is the last cannot be read")
    elif len(rows) != head.events or (rows[-1][0] if rows else 0) != head.last:
        gone = head.events - len(rows)
        damage.append(f"{gone} of {head.events} events are gone" if gone > 0 else "the head names another last event")
    elif head.hash not in (before if rows else (FIRST,)):
        damage.append("the head's hash is not that of the last event")
    return Verdict(tuple(intact), tuple(damage))


def _link(previous: str, row: Row) -> str | None:
    try:
        return link(previous, row)
    except (TypeError, ValueError, AttributeError, RecursionError):
        return None
