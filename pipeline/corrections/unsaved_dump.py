"""What is not saved when a program ends: tried once more, and else written to a file that can be saved later."""

from __future__ import annotations

import json
import re
import tempfile
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from datetime import datetime
from itertools import count
from pathlib import Path

from pipeline.corrections.journal_place import JournalPlace
from pipeline.corrections.unsaved import unsaved_actions
from pipeline.system.whole_files import temporary_beside, write_synced


@dataclass(frozen=True)
class UnsavedDump:
    """What could not be saved of one author.

    Attributes
    ----------
    author : str
    problem : str
        Why.
    edits : tuple of str
        In words.
    files : tuple of Path
        Lists of actions for `spatialviz correct LABELS --edits FILE --author AUTHOR`, one after the other; empty where
        no folder could be written.
    """

    author: str
    problem: str
    edits: tuple[str, ...]
    files: tuple[Path, ...]


def dump_unsaved(place: JournalPlace, folders: Sequence[Path] | None = None) -> tuple[UnsavedDump, ...]:
    """Save what waits; what cannot be saved is written to the first folder that can be written.

    Parameters
    ----------
    place : JournalPlace
    folders : sequence of Path, optional
        By default the working folder and the one for temporary files.
    """
    folders = (Path.cwd(), Path(tempfile.gettempdir())) if folders is None else folders
    found = []
    for author in place.unsaved.authors:
        place.unsaved.retry(author, place.to_write)
        waiting, disputed = place.unsaved.waiting(author), place.unsaved.disputed(author)
        lists = unsaved_actions(place.unsaved, author)
        if not lists:
            continue
        problem = waiting[0].problem if waiting else "somebody else was faster, and nobody has decided"
        edits = [e for w in waiting for e in w.edits] + [e for c in disputed for e in c.edits]
        said = tuple(f"{e.cell}: {json.dumps(e.after, ensure_ascii=False)[:60]}" for e in edits)
        found.append(UnsavedDump(author, problem, said, _written(lists, author, folders)))
    return tuple(found)


def _written(lists: list[list[dict]], author: str, folders: Sequence[Path]) -> tuple[Path, ...]:
    """The files; nothing where no folder takes all of them. A file that is there is left alone."""
    stem = "-".join(("unsaved", re.sub(r"[^A-Za-z0-9]+", "_", author), datetime.now().strftime("%Y%m%d-%H%M%S")))
    for folder in folders:
        files: list[Path] = []
        temporary = None
        try:
            for k, actions in enumerate(lists, start=1):
                files.append(_free(folder, stem if len(lists) == 1 else f"{stem}-{k}"))
                temporary = temporary_beside(files[-1])
                write_synced(temporary, json.dumps(actions, ensure_ascii=False, indent=1).encode())
                temporary.replace(files[-1])
        except OSError:
            for path in (*files, *([] if temporary is None else [temporary])):
                # A folder that takes no file may not let go of one either.
                with suppress(OSError):
                    path.unlink(missing_ok=True)
            continue
        return tuple(files)
    return ()


def _free(folder: Path, stem: str) -> Path:
    """A new empty file: other authors' names may come down to the same letters."""
    for number in count(1):
        path = folder / f"{stem}{'' if number == 1 else f'-{number}'}.json"
        with suppress(FileExistsError):
            path.open("xb").close()
            return path
    raise AssertionError
