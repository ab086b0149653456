"""The journal: an append-only table of corrections, in which nobody overwrites what they have not seen."""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, fields
from datetime import datetime, timezone
from pathlib import Path
from types import TracebackType
from typing import Any

import sqlalchemy as sa
from sqlalchemy.exc import IntegrityError

from pipeline.corrections.journal.chain import CONTENT, EVENTS, HEAD, Head, link
from pipeline.corrections.journal.connection import (
    DATABASE_ERRORS,
    is_url,
    likely_cause,
    location_of,
    make_engine,
    prepare,
    reading,
    reason_of,
    write_rows,
    writing,
)
from pipeline.corrections.journal.events import Action, Conflict, Edit, Event, NotSaved, Rival, Saved, new_ulid
from pipeline.corrections.journal.examining import DamagedJournal, empty_file, examine, is_empty
from pipeline.corrections.journal.field_refs import LONGEST_NAME, FieldRef, Kind, plain_text
from pipeline.corrections.journal.sqlite_file import network_file_system
from pipeline.labels.reading import Labels
from pipeline.labels.schema import labels_version
from pipeline.system.errors import InputError, require

JOURNAL_FILE = "journal.sqlite"
_CONTENT = tuple(EVENTS.c[name] for name in CONTENT)
_AT_ONCE = 500
"""Cells asked for in one query: databases bound the number of a query's values."""
_PLAIN = [f.name for f in fields(Event) if f.name != "ref"]


@dataclass(frozen=True)
class Journal:
    """An open journal; `open_journal` makes one. It may be shared by threads, and used in a `with` statement.

    Attributes
    ----------
    engine : sqlalchemy.Engine
    project : str
        Journals of several datasets may share a database; each sees its own project.
    labels : str
        The automatic labels that edits are made on, see `labels_version`; kept with each event.
    warnings : tuple of str
        What the user should know of the place where it is kept.
    """

    engine: sa.Engine
    project: str = ""
    labels: str = ""
    warnings: tuple[str, ...] = ()

    @property
    def location(self) -> str:
        """Where it is, without a password."""
        return location_of(self.engine)

    def close(self) -> None:
        """Let go of the database."""
        self.engine.dispose()

    def __enter__(self) -> Journal:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self.close()

    def append(self, edits: Iterable[Edit], author: str, *, group: str | None = None) -> Saved | Conflict:
        """Save what was done in one action: all of it, or nothing.

        When it returns, the events are on the disk.

        Parameters
        ----------
        edits : iterable of Edit
            At least one, of different cells.
        author : str
        group : str, optional
            From `NotSaved`, where this is another try: what was saved after all is not saved again.

        Returns
        -------
        Saved or Conflict
            Conflict where somebody changed a cell since the author saw it.

        Raises
        ------
        InputError
            Nothing to save, two edits of one cell, no author.
        NotSaved
            A full disk, a folder that cannot be written, a database that is away.
        """
        edits = tuple(edits)
        require(edits, "there is nothing to save")
        (ref, times), *_ = Counter(e.ref for e in edits).most_common(1)
        require(times == 1, "two edits of one cell in one action", got=str(ref))
        return self.write(edits, author, "edit", group=group)

    def write(
        self,
        edits: Sequence[Edit],
        author: str,
        action: Action,
        *,
        group: str | None = None,
        undo_of: Sequence[str | None] | None = None,
    ) -> Saved | Conflict:
        """`append`, `undo` and `redo` come down to this; raises as `append`."""
        author = plain_text(author, "an author", LONGEST_NAME).strip()
        again, group = group is not None, group or new_ulid()
        rows = [
            self._row(edit, author, action, group, taken_back)
            for edit, taken_back in zip(edits, undo_of or [None] * len(edits), strict=True)
        ]
        try:
            with writing(self.engine) as connection:
                saved = self._select(connection, EVENTS.c.group == group) if again else ()
                if saved:
                    return Saved(saved)
                heads = self._heads(connection, [e.ref for e in edits])
                rivals = tuple(
                    Rival(e, heads.get(e.ref))
                    for e in edits
                    if e.base != (heads[e.ref].version if e.ref in heads else 0)
                )
                if rivals:
                    return Conflict(rivals, tuple(edits))
                last = _last(connection)
                made = write_rows(connection, ({**row, "id": last.last + k} for k, row in enumerate(rows, 1)), last)
            return Saved(self._read_back(group, last.hash, [row["hash"] for row in made]))
        except IntegrityError:
            # Writers take turns; a writer that does not, for it is of another program, is caught here.
            heads = self.heads([e.ref for e in edits])
            return Conflict(tuple(Rival(e, heads.get(e.ref)) for e in edits), tuple(edits))
        except (*DATABASE_ERRORS, InputError) as error:
            reason = error.what if isinstance(error, InputError) else reason_of(error, self.location)
            cause = error.examined.help if isinstance(error, DamagedJournal) else likely_cause(reason)
            raise NotSaved(
                "the edit could not be saved", edits if action == "edit" else (), group, got=reason,
                cause=cause, path=self.location,
            ) from error  # fmt: skip

    def _read_back(self, group: str, previous: str, hashes: Sequence[str]) -> tuple[Event, ...]:
        """An action that was saved, read anew; InputError where it is not what was written."""
        with reading(self.engine) as connection:
            if self.engine.dialect.name == "sqlite":
                # What is kept in memory would say what was written, and not what is there.
                connection.exec_driver_sql("PRAGMA shrink_memory")
            wanted = sa.select(EVENTS).where(EVENTS.c.project == self.project, EVENTS.c.group == group)
            rows = connection.execute(wanted.order_by(EVENTS.c.id)).mappings().all()
        for row, made in zip(rows, hashes, strict=False):
            previous = link(previous, dict(row))
            if not previous == made == row["hash"]:
                break
        else:
            if len(rows) == len(hashes):
                return tuple(_event(row) for row in rows)
        raise InputError("what was written cannot be read back: the disk, or the journal, is damaged")

    def _row(self, edit: Edit, author: str, action: Action, group: str, undo_of: str | None) -> dict[str, Any]:
        return {
            "ulid": new_ulid(),
            "project": self.project,
            "author": author,
            "time": datetime.now(timezone.utc),
            "kind": edit.ref.kind,
            "frame": edit.ref.frame,
            "key": edit.ref.key,
            "field": edit.ref.field,
            "before": edit.before,
            "after": edit.after,
            "base": edit.base,
            "version": edit.base + 1,
            "labels": self.labels,
            "reason": edit.reason,
            "group": group,
            "action": action,
            "undo_of": undo_of,
            "anchor": edit.anchor,
        }

    def events(
        self,
        *,
        author: str | None = None,
        kind: Kind | None = None,
        frame: str | None = None,
        key: str | None = None,
        field: str | None = None,
        group: str | None = None,
        after: int = 0,
        before: int | None = None,
        last: int | None = None,
    ) -> tuple[Event, ...]:
        """Events in the order of their saving, of all or of what is asked for.

        Parameters
        ----------
        after : int
            Only those with a greater `id`: what is new since then.
        before : int, optional
            Only those with a smaller `id`.
        last : int, optional
            Only the newest so many.

        Raises
        ------
        InputError
            The journal cannot be read.
        """
        named = {"author": author, "kind": kind, "frame": frame, "key": key, "field": field, "group": group}
        wanted = [EVENTS.c[name] == value for name, value in named.items() if value is not None]
        if before is not None:
            wanted.append(EVENTS.c.id < before)
        with reading(self.engine) as connection:
            return self._select(connection, EVENTS.c.id > after, *wanted, last=last)

    def count(self) -> int:
        """How many events there are; InputError where the journal cannot be read."""
        with reading(self.engine) as connection:
            wanted = sa.select(sa.func.count()).select_from(EVENTS).where(EVENTS.c.project == self.project)
            return int(connection.execute(wanted).scalar_one())

    def heads(self, refs: Sequence[FieldRef]) -> dict[FieldRef, Event]:
        """The newest event of each of the cells that has any; InputError where the journal cannot be read."""
        with reading(self.engine) as connection:
            return self._heads(connection, refs)

    def _heads(self, connection: sa.Connection, refs: Sequence[FieldRef]) -> dict[FieldRef, Event]:
        named = sa.tuple_(EVENTS.c.kind, EVENTS.c.frame, EVENTS.c.key, EVENTS.c.field)
        found: dict[FieldRef, Event] = {}
        for first in range(0, len(refs), _AT_ONCE):
            wanted = [(c.kind, c.frame, c.key, c.field) for c in refs[first : first + _AT_ONCE]]
            newest = (
                sa.select(sa.func.max(EVENTS.c.id))
                .where(EVENTS.c.project == self.project, named.in_(wanted))
                .group_by(EVENTS.c.kind, EVENTS.c.frame, EVENTS.c.key, EVENTS.c.field)
            )
            found |= {e.ref: e for e in self._select(connection, EVENTS.c.id.in_(newest))}
        return found

    def _select(
        self, connection: sa.Connection, *conditions: sa.ColumnElement[bool], last: int | None = None
    ) -> tuple[Event, ...]:
        query = sa.select(*_CONTENT).where(EVENTS.c.project == self.project, *conditions)
        newest_first = query.order_by(EVENTS.c.id.desc()).limit(last)
        rows = connection.execute(query.order_by(EVENTS.c.id) if last is None else newest_first).mappings()
        return tuple(_event(row) for row in rows)[:: 1 if last is None else -1]


_TIP = sa.select(
    HEAD.c.events, HEAD.c.last, HEAD.c.hash, EVENTS.c.hash.label("kept"),
    sa.select(sa.func.max(EVENTS.c.id)).scalar_subquery().label("newest"),
).select_from(HEAD.outerjoin(EVENTS, EVENTS.c.id == HEAD.c.last))  # fmt: skip


def _last(connection: sa.Connection) -> Head:
    """What the next event is chained to; InputError where the journal is not as it was left."""
    row = connection.execute(_TIP).one_or_none()
    if row is None or (row.kept, row.newest) != ((row.hash, row.last) if row.events else (None, None)):
        raise InputError("the journal is damaged: its last event is not the one that was saved last")
    return Head(row.events, row.last, row.hash)


def _event(row: sa.RowMapping) -> Event:
    ref = FieldRef(row["kind"], row["frame"], row["key"], row["field"])
    return Event(ref=ref, **{name: row[name] for name in _PLAIN})


def open_journal(where: str | Path, *, project: str = "", labels: str = "", must_exist: bool = False) -> Journal:
    """Open a journal, and make it where there is none.

    All that is in it is checked first. One of the release before is chained, and kept beside as it was.

    Parameters
    ----------
    where : str or Path
        The path of an SQLite file, or a URL "postgresql://user@host/database" (extra: postgres).
    project, labels : str
        See `Journal`.
    must_exist : bool
        Do not make an SQLite file.

    Raises
    ------
    InputError
        It cannot be opened or made, or was written by a newer release.
    DamagedJournal
        It is not as it was saved: what is damaged, which events are intact, and how to go on.
    """
    warnings: list[str] = []
    if not is_url(where):
        path = Path(where).expanduser()
        require(
            not path.is_dir() and path.parent.is_dir(), "the journal is a file in a folder that is there", path=path
        )
        if not path.exists() and (must_exist or not os.access(path.parent, os.W_OK)):
            cause = None if must_exist else "the folder cannot be written"
            raise InputError("no journal here" if must_exist else "no journal can be made", cause=cause, path=path)
        kind = network_file_system(path)
        if kind is not None:
            warnings.append(
                f"{path} is on a network file system ({kind}): only one machine may write to it; "
                "for a team use --journal postgresql://..."
            )
        if is_empty(path):
            if must_exist:
                raise empty_file(path)
            warnings.append(f"{path} was an empty file, and a new journal begins in it: if edits were there, "
                            "put a copy in its place")  # fmt: skip
        elif path.exists():
            examine(path).believe()
    engine = make_engine(where)
    try:
        warnings += prepare(engine)
    except BaseException:
        engine.dispose()
        raise
    return Journal(engine, project, labels, tuple(warnings))


def journal_of(
    labels: Labels, where: str | Path | None = None, *, project: str | None = None, must_exist: bool = False
) -> Journal:
    """The journal of labels: beside them by default, or where it is said to be; raises as `open_journal`.

    In a database that is shared, the project is the name of the dataset's folder unless another is given.
    """
    if project is None:
        project = Path(str(labels.manifest.dataset.get("path", ""))).name if where is not None and is_url(where) else ""
    return open_journal(
        labels.root / JOURNAL_FILE if where is None else where,
        project=project,
        labels=labels_version(labels.manifest),
        must_exist=must_exist,
    )
