"""Where the corrections of labels are kept: opened when they are first needed, so that looking writes nothing.

What is not saved when a program ends is tried once more, and else written to a
file that can be saved later.
"""

from __future__ import annotations

import json
import re
import tempfile
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from threading import Lock

from pipeline.corrections.journal.connection import without_password
from pipeline.corrections.journal.events import new_ulid
from pipeline.corrections.journal.examining import DamagedJournal
from pipeline.corrections.journal.journal import JOURNAL_FILE, Journal, journal_of
from pipeline.corrections.review.label_jobs import LabelJobs
from pipeline.corrections.unsaved import Unsaved, unsaved_actions
from pipeline.labels.reading import Labels
from pipeline.system.errors import InputError
from pipeline.system.remote import is_url
from pipeline.system.whole_files import write_synced


class JournalLocation:
    """Journal of labels with all unsaved actions and jobs, shared by the editors of a process.

    `where` is a path or URL, by default beside the labels.
    """

    def __init__(self, labels: Labels, where: str | Path | None = None, project: str | None = None) -> None:
        self.labels, self.where, self.project = labels, where, project
        self.unsaved = Unsaved()
        self.jobs = LabelJobs()
        self._journal: Journal | None = None
        self._lock = Lock()

    def __str__(self) -> str:
        if self._journal is not None:
            return self._journal.location
        return str(self.labels.root / JOURNAL_FILE) if self.where is None else self.address

    @property
    def address(self) -> str:
        """Value of `--journal` without the password."""
        return "" if self.where is None else without_password(self.where)

    @property
    def words(self) -> tuple[str, ...]:
        """Command options for this journal."""
        return journal_words(self.where, self.project)

    def to_read(self) -> Journal | None:
        """Open the journal; None where nothing was ever corrected; InputError where opening fails."""
        if self._journal is None and (self.where is None or not is_url(self.where)):
            path = self.labels.root / JOURNAL_FILE if self.where is None else Path(self.where).expanduser()
            if not path.exists():
                return None
        return self.to_write()

    def to_write(self) -> Journal:
        """Open or make the journal; InputError on failure."""
        with self._lock:
            if self._journal is None:
                self._journal = journal_of(self.labels, self.where, project=self.project)
            return self._journal

    def check(self) -> str:
        """Open an existing journal; the reason where out of reach now, else ""; DamagedJournal for damage."""
        try:
            self.to_read()
        except DamagedJournal:
            raise
        except InputError as error:
            return str(error)
        return ""

    def close(self) -> None:
        """Let go of the database."""
        with self._lock:
            if self._journal is not None:
                self._journal.close()
            self._journal = None


def journal_words(where: str | Path | None, project: str | None = None) -> tuple[str, ...]:
    """Command options for a journal, without a password."""
    words = () if where is None else ("--journal", without_password(where))
    return words if project is None else (*words, "--project", project)


@dataclass(frozen=True)
class UnsavedDump:
    """Unsaved edits of one author, in words, and the files for `spatialviz correct LABELS --edits FILE --author
    AUTHOR`.
    """

    author: str
    problem: str  # reason
    edits: tuple[str, ...]
    files: tuple[Path, ...]  # empty where no folder could be written


def dump_unsaved(location: JournalLocation, folders: Sequence[Path] | None = None) -> tuple[UnsavedDump, ...]:
    """Save waiting actions; write the rest to the first writable folder (working, temporary)."""
    folders = (Path.cwd(), Path(tempfile.gettempdir())) if folders is None else folders
    found = []
    for author in location.unsaved.authors:
        location.unsaved.retry(author, location.to_write)
        waiting, disputed = location.unsaved.waiting(author), location.unsaved.disputed(author)
        lists = unsaved_actions(location.unsaved, author)
        if not lists:
            continue
        problem = waiting[0].problem if waiting else "somebody else was faster, and nobody has decided"
        edits = [e for w in waiting for e in w.edits] + [e for c in disputed for e in c.edits]
        texts = tuple(f"{e.ref}: {json.dumps(e.after, ensure_ascii=False)[:60]}" for e in edits)
        found.append(UnsavedDump(author, problem, texts, _written(lists, author, folders)))
    return tuple(found)


def _written(lists: list[list[dict]], author: str, folders: Sequence[Path]) -> tuple[Path, ...]:
    """Write the files into the first folder with room for all; else ()."""
    # Other authors' names may come down to the same letters.
    name, unique = re.sub(r"[^A-Za-z0-9]+", "_", author), new_ulid()[-6:]
    stem = f"unsaved-{name}-{datetime.now():%Y%m%d-%H%M%S}-{unique}"
    for folder in folders:
        files = tuple(folder / f"{stem}-{k}.json" for k in range(1, len(lists) + 1))
        try:
            for file, actions in zip(files, lists, strict=True):
                write_synced(file, json.dumps(actions, ensure_ascii=False, indent=1).encode())
            return files
        except OSError:
            for file in files:
                # A folder that takes no file may not let go of one either.
                with suppress(OSError):
                    file.unlink(missing_ok=True)
    return ()
