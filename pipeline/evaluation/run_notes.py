"""What people note about a run, in one small file: marks of its expressions, and searches kept under a name."""

from __future__ import annotations

import hashlib
import json
import os
import re
from collections.abc import Callable, Iterable
from dataclasses import field, replace
from pathlib import Path

from platformdirs import user_data_path
from pydantic import TypeAdapter

from pipeline.datasets.demo import demo_run
from pipeline.system.errors import InputError, as_input_error, require
from pipeline.system.frozen import dataclass
from pipeline.system.reading import checked
from pipeline.system.safe_files import read_bytes
from pipeline.system.whole_files import alone, write_whole

MARKS = "marks"
"""The column, and the field of a search, of the marks of an expression."""
FILE = "notes.json"
FORMAT = "spatialviz-notes-1"
LONGEST_NAME = 40
Key = tuple[str, str]
"""(frame, id) of an expression."""
_MARK = re.compile(r"\w[\w.+-]*")


@dataclass(frozen=True)
class Notes:
    """What stands in the file."""

    marks: dict[str, list[Key]] = field(default_factory=dict)  # by mark the expressions that have it, as (frame, id)
    filters: dict[str, str] = field(default_factory=dict)  # searches by the names that they are kept under
    format: str = FORMAT

    def marks_of(self, keys: Iterable[Key]) -> list[list[str]]:
        """The marks of each of these expressions, in the order of their names."""
        found: dict[Key, list[str]] = {}
        for name in sorted(self.marks):
            for key in self.marks[name]:
                found.setdefault(key, []).append(name)
        return [found.get(key, []) for key in keys]


_READ = TypeAdapter(Notes)


def notes_path(run: Path) -> Path:
    """Place of a run's notes: the run's folder, or the user's data folder for a read-only or bundled run."""
    run = Path(run).resolve()
    own = os.access(run, os.W_OK) and not run.is_relative_to(demo_run().parent.resolve())
    name = f"{run.name}-{hashlib.sha256(str(run).encode()).hexdigest()[:12]}.json"
    return run / FILE if own else user_data_path("spatialviz") / "notes" / name


def read_notes(path: Path) -> Notes:
    """Read the notes of a file; none without a file.

    Raises InputError: it cannot be read.
    """
    try:
        text = read_bytes(path, "text")
    except FileNotFoundError:
        return Notes()
    except OSError as error:
        raise InputError("the notes of the run cannot be read", got=error, path=path) from error
    found = checked(_READ.validate_json, text, "the notes of the run cannot be read, at {}", path)
    require(found.format == FORMAT, "the notes are of another release", got=found.format, expected=FORMAT, path=path)
    return found


def mark(path: Path, keys: Iterable[Key], name: str, on: bool = True) -> Notes:
    """Mark expressions, or remove a mark; returns the notes.

    Raises InputError: the name is no mark, or the file cannot be read or written.
    """
    name = name.strip().lower()
    require(
        _MARK.fullmatch(name) is not None and name != "none" and len(name) <= LONGEST_NAME,
        "a mark is one word",
        got=repr(name),
        expected="letters, digits, _ . + - and not none",
    )
    given = dict.fromkeys(keys)

    def change(notes: Notes) -> Notes:
        kept = [key for key in notes.marks.get(name, []) if on or key not in given]
        marks = notes.marks | {name: list(dict.fromkeys([*kept, *given])) if on else kept}
        return replace(notes, marks={n: found for n, found in sorted(marks.items()) if found})

    return _changed(path, change)


def keep_filter(path: Path, name: str, query: str | None) -> Notes:
    """Keep a search under a name, or forget the search; returns the notes.

    Raises InputError: the name is empty or too long, or the file cannot be read or written.
    """
    name = " ".join(name.split())
    require(0 < len(name) <= LONGEST_NAME, f"a filter has a name of up to {LONGEST_NAME} characters", got=repr(name))

    def change(notes: Notes) -> Notes:
        others = {n: q for n, q in notes.filters.items() if n != name}
        return replace(notes, filters=others if query is None else dict(sorted({**others, name: query}.items())))

    return _changed(path, change)


def _changed(path: Path, change: Callable[[Notes], Notes]) -> Notes:
    """Write a change, and keep concurrent notes of others."""
    with (
        as_input_error("the notes cannot be written", OSError, got=lambda e: e.strerror, path=path),
        alone(path.parent),
    ):
        notes = change(read_notes(path))
        text = json.dumps(_READ.dump_python(notes, mode="json"), ensure_ascii=False, indent=1)
        write_whole(path, f"{text}\n".encode(), "the notes")
    return notes
