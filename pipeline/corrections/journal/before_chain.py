"""Events of version 1, which have no hashes: judged by what is possible in them, and by what they say of each other."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from datetime import datetime, timedelta, timezone
from typing import Any, get_args

from pipeline.corrections.journal.chain import Row, Verdict
from pipeline.corrections.journal.events import CROCKFORD, Action
from pipeline.corrections.journal.field_refs import LONGEST_NAME, LONGEST_TEXT, FieldRef, checked, plain_text
from pipeline.system.errors import InputError

_APART = timedelta(seconds=2)
"""An event's two times were taken one right after the other."""
_BEGAN = datetime(2020, 1, 1, tzinfo=timezone.utc)
_LOOSE = ("relation", "review")
"""Kinds whose values are so short that an ordinary change of one is a change of one bit."""


def judged_alone(rows: Sequence[tuple[int, Row | None]]) -> Verdict:
    """Which events can be as they were saved.

    A bit that makes another possible value of a text goes unseen where no
    other event speaks of it: that is what the chain is for.

    Parameters
    ----------
    rows : sequence of (int, dict or None)
        As `chain.judged`.
    """
    intact: list[Row] = []
    damage: list[str] = []
    known: dict[str, Row] = {}
    heads: dict[tuple[Any, ...], Row] = {}
    groups: dict[str, Row] = {}
    for number, row in rows:
        said = "it cannot be read" if row is None else _wrong(row)
        if row is not None and said is None:
            cell = row["project"], row["kind"], row["frame"], row["key"], row["field"]
            said = _against(row, known, heads.get(cell), groups.get(row["group"]))
            if said is None:
                known[row["ulid"]] = heads[cell] = groups[row["group"]] = row
                intact.append(row)
        if said is not None:
            damage.append(f"event {number}: {said}")
    return Verdict(tuple(intact), tuple(damage))


def _wrong(row: Row) -> str | None:
    """What is impossible in one event."""
    try:
        cell = FieldRef(row["kind"], row["frame"], row["key"], row["field"])
        for value in (row["after"], *([] if row["before"] is None else [row["before"]])):
            if checked(cell, value) != value:
                return "a value is not as it is kept"
        if plain_text(row["author"], "an author", LONGEST_NAME).strip() != row["author"]:
            return "its author is no name"
        for name in ("reason", "project", "labels"):
            if row[name] != "":
                plain_text(row[name], name, LONGEST_TEXT)
    except InputError as error:
        return error.what
    except (TypeError, ValueError, AttributeError, RecursionError):
        return "it cannot be read"
    if row["action"] not in get_args(Action) or (row["action"] == "edit") != (row["undo_of"] is None):
        return "there is no such action"
    numbers = row["base"], row["version"]
    if any(type(n) is not int for n in numbers) or row["base"] < 0 or row["version"] != row["base"] + 1:
        return "its version does not follow"
    times = [_made(row["ulid"]), _made(row["group"])]
    if times[0] is None or times[1] is None or (row["undo_of"] is not None and _made(row["undo_of"]) is None):
        return "its ULID is none"
    if abs(row["time"] - times[0]) > _APART or times[1] > times[0] + _APART or row["time"] < _BEGAN:
        return "its time is not that of its ULID"
    return None if _is_anchor(row["anchor"]) else "its anchor is none"


def _against(row: Row, known: Mapping[str, Row], head: Row | None, group: Row | None) -> str | None:
    """What contradicts the events before it."""
    if row["ulid"] in known:
        return "its ULID stands twice"
    if row["version"] != (1 if head is None else head["version"] + 1):
        return "its version does not follow"
    if head is not None and row["kind"] not in _LOOSE and _one_bit_apart(head["after"], row["before"]):
        return "what it was made on is not what was saved before it"
    if group is not None:
        alike = all(row[name] == group[name] for name in ("project", "author", "action", "labels"))
        if not alike:
            return "it is not of its action"
    if row["undo_of"] is None:
        return None
    source = known.get(row["undo_of"])
    if source is None:
        return "what it takes back is not there"
    same = ("project", "kind", "frame", "key", "field", "author", "reason", "anchor")
    turned = row["before"] == source["after"] and row["after"] == source["before"]
    if not turned or any(row[name] != source[name] for name in same):
        return "it is not the reverse of what it takes back"
    return None


def _made(ulid: Any) -> datetime | None:
    """When a ULID was made; None where it is none."""
    if not isinstance(ulid, str) or len(ulid) != 26 or any(c not in CROCKFORD for c in ulid):
        return None
    number = 0
    for c in ulid[:10]:
        number = number << 5 | CROCKFORD.index(c)
    try:
        return datetime.fromtimestamp(number / 1000, timezone.utc)
    except (OverflowError, ValueError, OSError):
        return None


def _is_anchor(value: Any) -> bool:
    return isinstance(value, dict) and all(
        name.isdecimal() and isinstance(box, list) and len(box) == 4
        and all(isinstance(x, (int, float)) and math.isfinite(x) for x in box)
        for name, box in value.items()
    )  # fmt: skip


def _one_bit_apart(a: Any, b: Any) -> bool:
    """Whether the JSON of two values differs in one bit, as it does where one was flipped."""
    one, other = (json.dumps(v).encode() for v in (a, b))
    if len(one) != len(other):
        return False
    return sum((x ^ y).bit_count() for x, y in zip(one, other, strict=True)) == 1
