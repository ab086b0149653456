"""Where the corrections of labels are kept: opened when they are first needed, so that looking writes nothing."""

from __future__ import annotations

import time
from concurrent.futures import Future
from concurrent.futures import TimeoutError as NotYet
from pathlib import Path
from threading import Lock, Thread

import sqlalchemy as sa
from sqlalchemy.exc import ArgumentError

from pipeline.corrections.journal.connection import is_url
from pipeline.corrections.journal.examining import DamagedJournal
from pipeline.corrections.journal.journal import JOURNAL_FILE, Journal, journal_of
from pipeline.corrections.label_jobs import LabelJobs
from pipeline.corrections.unsaved import Unsaved
from pipeline.labels.reading import Labels
from pipeline.system.errors import InputError

PATIENCE_S = 3.0
"""How long anybody waits for a journal that is being opened; it goes on being opened after that."""


class JournalPlace:
    """The journal of labels, shared by everyone who corrects them in one process.

    Parameters
    ----------
    labels : Labels
    where : str or Path, optional
        Path or URL; beside the labels by default.
    project : str, optional
        See `journal_of`.

    Attributes
    ----------
    unsaved : Unsaved
        What could not be saved yet, of everyone.
    jobs : LabelJobs
        Of these labels, of everyone.
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
            return self._journal.place
        return str(self.labels.root / JOURNAL_FILE) if self.where is None else self.address

    @property
    def address(self) -> str:
        """What `--journal` takes to open it again; of a URL without the password."""
        return "" if self.where is None else address_without_password(self.where)

    @property
    def words(self) -> tuple[str, ...]:
        """The options by which a command finds this journal."""
        return journal_words(self.where, self.project)

    def to_read(self) -> Journal | None:
        """The journal; None where nothing was ever corrected.

        Raises
        ------
        InputError
            It is there and cannot be opened.
        """
        if self._journal is None and (self.where is None or not is_url(self.where)):
            path = self.labels.root / JOURNAL_FILE if self.where is None else Path(self.where).expanduser()
            if not path.exists():
                return None
        return self.to_write()

    def to_write(self) -> Journal:
        """The journal, made where there is none.

        Raises
        ------
        InputError
            It cannot be opened or made, or not yet.
        """
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

    def check(self) -> None:
        """Open the journal where there is one; one that cannot be reached now may be later.

        Raises
        ------
        DamagedJournal
            It is not as it was saved.
        """
        try:
            self.to_read()
        except DamagedJournal:
            raise
        except InputError:
            return

    def _open(self) -> Future[Journal]:
        """Open it on a thread of its own, so that a database that says nothing holds nobody up for long."""
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
                opening.set_exception(problem)
            else:
                opening.set_result(journal)
            if journal is not None and not wanted:
                journal.close()

        Thread(target=work, daemon=True, name="journal-open").start()
        return opening

    def close(self) -> None:
        """Let go of the database."""
        with self._lock:
            if self._journal is not None:
                self._journal.close()
            self._journal = self._opening = None


def address_without_password(where: str | Path) -> str:
    """What `--journal` takes to open a journal again."""
    if not is_url(where):
        return str(where)
    try:
        url = sa.make_url(str(where))
    except (ArgumentError, ValueError):
        return str(where).rpartition("@")[2].partition("?")[0]
    # `set` takes no password away.
    url = url._replace(password=None)
    secret = [name for name in url.query if "password" in name.lower()]
    return url.difference_update_query(secret).render_as_string(hide_password=True)


def journal_words(where: str | Path | None, project: str | None = None) -> tuple[str, ...]:
    """The options by which a command finds a journal, without a password."""
    words = () if where is None else ("--journal", address_without_password(where))
    return words if project is None else (*words, "--project", project)
