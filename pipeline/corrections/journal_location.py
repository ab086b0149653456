"""Where the corrections of labels are kept: opened when they are first needed, so that looking writes nothing.

What is not saved when a program ends is tried once more, and else written to a
file that can be saved later.
"""

from __future__ import annotations

import json
import re
import tempfile
import time
from collections.abc import Sequence
from concurrent.futures import Future
from concurrent.futures import TimeoutError as NotYet
from contextlib import suppress
from dataclasses import dataclass
from datetime import datetime
from itertools import count
from pathlib import Path
from threading import Lock, Thread

from pipeline.corrections.journal.connection import is_url
from pipeline.corrections.journal.examining import DamagedJournal
from pipeline.corrections.journal.journal import JOURNAL_FILE, Journal, journal_of
from pipeline.corrections.journal.postgres import without_password
from pipeline.corrections.review.label_jobs import LabelJobs
from pipeline.corrections.unsaved import Unsaved, unsaved_actions
from pipeline.labels.reading import Labels
from pipeline.system.errors import InputError
from pipeline.system.whole_files import temporary_sibling, write_synced

PATIENCE_S = 3.0
"""How long anybody waits for a journal that is being opened; it goes on being opened after that."""


class JournalLocation:
    """Journal of labels with all unsaved actions and jobs, shared by the editors of a process.

    `where` is a path or URL, by default beside the labels.
    """

    def __init__(self, labels: Labels, where: str | Path | None = None, project: str | None = None) -> None:
        self.labels, self.where, self.project = labels, where, project
        self.unsaved = Unsaved()
        self.jobs = LabelJobs()
        self._journal: Journal | None = None
        self._opening: tuple[float, Future[Journal]] | None = None
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
        """Open or make the journal; InputError on failure, or while opening."""
        if self._journal is not None:
            return self._journal
        with self._lock:
            if self._opening is None:
                self._opening = time.monotonic(), self._open()
            began, opening = self._opening
        try:
            return opening.result(max(0.0, began + PATIENCE_S - time.monotonic()))
        except NotYet:
            raise InputError("the journal cannot be opened", got="it does not answer yet", path=str(self)) from None

    def check(self) -> str:
        """Open an existing journal; the reason where out of reach now, else ""; DamagedJournal for damage."""
        try:
            self.to_read()
        except InputError as error:
            if isinstance(error, DamagedJournal):
                raise
            return str(error)
        return ""

    def _open(self) -> Future[Journal]:
        """Open on a thread: a silent database holds nobody up."""
        opening: Future[Journal] = Future()

        def work() -> None:
            journal = problem = None
            try:
                journal = journal_of(self.labels, self.where, project=self.project)
            except BaseException as error:  # Whatever it is, those who wait must hear of it.
                problem = error
            with self._lock:
                wanted = self._opening is not None and self._opening[1] is opening
                if wanted:
                    self._journal, self._opening = journal, None
            if journal is None:
                return opening.set_exception(problem)
            opening.set_result(journal)
            if not wanted:
                journal.close()

        Thread(target=work, daemon=True, name="journal-open").start()
        return opening

    def close(self) -> None:
        """Let go of the database."""
        with self._lock:
            if self._journal is not None:
                self._journal.close()
            self._journal = self._opening = None


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
    stem = "-".join(("unsaved", re.sub(r"[^A-Za-z0-9]+", "_", author), datetime.now().strftime("%Y%m%d-%H%M%S")))
    for folder in folders:
        files: list[Path] = []
        temporary = None
        try:
            for k, actions in enumerate(lists, start=1):
                files.append(_free(folder, stem if len(lists) == 1 else f"{stem}-{k}"))
                temporary = temporary_sibling(files[-1])
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
