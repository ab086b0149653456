"""Events of a trace: parts of predictions, written during a run, joined to a line for each expression.

An event has `frame`, `text` and any further fields of a line. One that only says what is asked, and how its words are
read, begins an expression: anew, where it was asked before. Its answer, or the problem why there is none, ends it.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

from pipeline.system.errors import require

_ASKED = {"frame", "text", "target", "relation", "reference"}
_BY_NAME = ("proposals", "boxes_3d", "relations", "attributes")
"""Fields whose parts, by name or by id, may come in events of their own."""
OPEN = "no answer was recorded"
"""The problem of an expression that a trace leaves without one."""
Numbered = tuple[int, Any]
"""A line's number in the file, and its JSON."""


def joined_events(events: Iterable[Numbered], path: Path) -> Iterator[Numbered]:
    """Join events to predictions, in the order of the file, with the numbers of their first lines.

    An expression without an end keeps its proposals, and has the problem `OPEN`: the rest may be incomplete. InputError
    for a field given twice and differently names both lines.
    """
    lines: dict[tuple[str, str], Numbered] = {}
    for number, event in events:
        key = (str(event.get("frame")), str(event.get("text"))) if isinstance(event, dict) else ("", f"{number}")
        if key not in lines or event.keys() <= _ASKED:
            lines.pop(key, None)
            lines[key] = number, event
            continue
        first, line = lines[key]
        for field, value in event.items():
            known = line.get(field)
            if field in _BY_NAME and isinstance(value, dict) and isinstance(known, dict):
                both = {name: _both(known.get(name), part) for name, part in value.items()}
                wrong, value = [f"{field}.{name}" for name, part in both.items() if part is Ellipsis], known | both
            else:
                value = _both(known, value)
                wrong = [field] if value is Ellipsis else []
            told = f"of the expression that line {first} begins"
            require(not wrong, f"line {number}, {', '.join(wrong)}: told before, and otherwise, {told}", path=path)
            line[field] = value
    for number, line in lines.values():
        if isinstance(line, dict) and not {"answer", "problem"} & line.keys():
            line = {k: v for k, v in line.items() if k in _ASKED or k == "proposals"} | {"problem": OPEN}
        yield number, line


def _both(known: Any, more: Any) -> Any:
    """Field of two events: lists are joined; `...` for a contradiction."""
    if known is None or known == more:
        return more
    return [*known, *more] if isinstance(known, list) and isinstance(more, list) else ...
