"""The journal: an append-only table of corrections, in which nobody overwrites what they have not seen."""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import fields
from datetime import datetime, timezone
from pathlib import Path
from types import TracebackType
from typing import Any

from pipeline.corrections.journal.chain import STORED, Head, Run, Store, chained, head_of, rows, write_rows
from pipeline.corrections.journal.connection import (
    DATABASE_ERRORS,
    likely_cause,
    prepare,
    reading,
    reason_of,
    store_at,
)
from pipeline.corrections.journal.events import Action, Conflict, Edit, Event, NotSaved, Rival, Saved, new_ulid
from pipeline.corrections.journal.examining import DamagedJournal, examine, is_empty, require_content
from pipeline.corrections.journal.field_refs import LONGEST_NAME, FieldRef, Kind, plain_text
from pipeline.corrections.journal.sqlite_file import network_file_system
from pipeline.labels.reading import Labels
from pipeline.labels.schema import labels_version
from pipeline.system.errors import InputError, require
from pipeline.system.frozen import dataclass
from pipeline.system.remote import is_url, url_of

JOURNAL_FILE = "journal.sqlite"
_AT_ONCE = 500
"""Cells asked for in one query: databases bound the number of a query's values."""
_PLAIN = [f.name for f in fields(Event) if f.name != "ref"]


@dataclass(frozen=True)
class Journal:
    """Open journal of one project, from `open_journal`; shared by threads, and a context manager.

    Journals of several projects may share a database. `labels` (see `labels_version`) is kept with each event.
    """

    store: Store
    project: str = ""
    labels: str = ""
    warnings: tuple[str, ...] = ()

    @property
    def location(self) -> str:
        """Place, without a password."""
        return self.store.location

    def close(self) -> None:
        """Close the database."""
        self.store.close()

    def __enter__(self) -> Journal:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self.close()

    def append(self, edits: Iterable[Edit], author: str, *, group: str | None = None) -> Saved | Conflict:
        """Save the edits of an action, all or none; on return on the disk.

        `group` is that of `NotSaved` on a retry: an action that reached the journal is not saved twice. Conflict where
        a cell changed since the author saw it. InputError for no edit, two of one cell, or no author. NotSaved for a
        full disk, a read-only folder, a database that is away.
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
        """Save edits as `append`, `undo` and `redo` do; raises as `append`."""
        author = plain_text(author, "an author", LONGEST_NAME).strip()
        again, group = group is not None, group or new_ulid()
        wanted: list[dict[str, Any]] = [
            {
                "ulid": new_ulid(),
                "project": self.project,
                "author": author,
                "time": datetime.now(timezone.utc),
                **vars(edit.ref),
                "before": edit.before,
                "after": edit.after,
                "base": edit.base,
                "version": edit.base + 1,
                "labels": self.labels,
                "reason": edit.reason,
                "group": group,
                "action": action,
                "undo_of": taken_back,
                "anchor": edit.anchor,
            }
            for edit, taken_back in zip(edits, undo_of or [None] * len(edits), strict=True)
        ]
        try:
            with self.store.writing() as run:
                saved = self._select(run, 'AND "group" = ? ORDER BY id', group) if again else ()
                if saved:
                    return Saved(saved)
                heads = self._heads(run, [e.ref for e in edits])
                rivals = tuple(
                    Rival(e, heads.get(e.ref))
                    for e in edits
                    if e.base != (heads[e.ref].version if e.ref in heads else 0)
                )
                if rivals:
                    return Conflict(rivals, tuple(edits))
                last = _last(run)
                made = write_rows(
                    self.store, run, ({**row, "id": last.last + k} for k, row in enumerate(wanted, 1)), last
                )
            return Saved(self._read_back(group, last.hash, [row["hash"] for row in made]))
        except (*DATABASE_ERRORS, InputError) as error:
            reason = error.what if isinstance(error, InputError) else reason_of(error, self.location)
            cause = error.examined.help if isinstance(error, DamagedJournal) else likely_cause(reason)
            raise NotSaved(
                "the edit could not be saved",
                edits if action == "edit" else (),
                group,
                got=reason,
                cause=cause,
                path=self.location,
            ) from error

    def _read_back(self, group: str, previous: str, hashes: Sequence[str]) -> tuple[Event, ...]:
        """Read a saved action anew; InputError for another content."""
        # What is kept in memory would say what was written, and not what is there.
        with reading(self.store, fresh=True) as run:
            where = 'WHERE project = ? AND "group" = ? ORDER BY id'
            found = rows(self.store, run, where, self.project, group, names=STORED)
        written = [row["hash"] for row in found]
        same = written == list(hashes) == [row["hash"] for row in chained(previous, found)]
        require(same, "what was written cannot be read back: the disk, or the journal, is damaged")
        return tuple([_event(row) for row in found])

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
        last: int | None = None,
    ) -> tuple[Event, ...]:
        """Select events in the order of their saving; InputError where the journal cannot be read.

        `after` bounds the `id`, exclusive; `last` takes only the newest so many.
        """
        named = {"author": author, "kind": kind, "frame": frame, "key": key, "field": field, "group": group}
        wanted: dict[str, Any] = {f'AND "{name}" = ?': value for name, value in named.items() if value is not None}
        wanted["AND id > ?"] = after
        wanted["ORDER BY id" if last is None else "ORDER BY id DESC LIMIT ?"] = last
        values = [value for value in wanted.values() if value is not None]
        with reading(self.store) as run:
            return self._select(run, " ".join(wanted), *values)[:: 1 if last is None else -1]

    def count(self) -> int:
        """Count events; InputError where the journal cannot be read."""
        with reading(self.store) as run:
            return int(run("SELECT count(*) FROM events WHERE project = ?", self.project)[0][0])

    def heads(self, refs: Sequence[FieldRef]) -> dict[FieldRef, Event]:
        """Newest event of each cell; InputError where the journal cannot be read."""
        with reading(self.store) as run:
            return self._heads(run, refs)

    def _heads(self, run: Run, refs: Sequence[FieldRef]) -> dict[FieldRef, Event]:
        found: dict[FieldRef, Event] = {}
        for first in range(0, len(refs), _AT_ONCE):
            some = refs[first : first + _AT_ONCE]
            newest = (
                'AND id IN (SELECT max(id) FROM events WHERE project = ? AND (kind, frame, "key", field) IN '
                f'(VALUES {", ".join(["(?, ?, ?, ?)"] * len(some))}) GROUP BY kind, frame, "key", field)'
            )
            cells = [value for c in some for value in (c.kind, c.frame, c.key, c.field)]
            found |= {e.ref: e for e in self._select(run, newest, self.project, *cells)}
        return found

    def _select(self, run: Run, more: str, *values: Any) -> tuple[Event, ...]:
        found = rows(self.store, run, f"WHERE project = ? {more}", self.project, *values)
        return tuple([_event(row) for row in found])


def _last(run: Run) -> Head:
    """Head before the next event; InputError for another last event than saved."""
    head, newest = head_of(run), run("SELECT id, hash FROM events ORDER BY id DESC LIMIT 1")
    if head is None or [tuple(row) for row in newest] != ([(head.last, head.hash)] if head.events else []):
        raise InputError("the journal is damaged: its last event is not the one that was saved last")
    return head


def _event(row: dict[str, Any]) -> Event:
    ref = FieldRef(row.pop("kind"), row.pop("frame"), row.pop("key"), row.pop("field"))
    return Event(ref=ref, **{name: row[name] for name in _PLAIN})


def open_journal(where: str | Path, *, project: str = "", labels: str = "", must_exist: bool = False) -> Journal:
    """Open or make a journal; all events are checked first.

    `where` is an SQLite path or a URL "postgresql://user@host/database" (extra: postgres). A version 1 journal is
    chained, and the original kept beside. InputError where it cannot be opened or made, or of a newer release;
    DamagedJournal says what is damaged, which events are intact, and how to go on.

    >>> from tempfile import TemporaryDirectory
    >>> from pipeline.corrections import Edit, object_ref, undo
    >>> with TemporaryDirectory() as folder, open_journal(f"{folder}/journal.sqlite") as journal:
    ...     saved = journal.append([Edit(object_ref("kitchen/0", 3, "label"), "mug", "cup")], "ann")
    ...     taken = undo(journal, "ann")
    ...     [(event.action, event.after) for event in journal.events()]
    [('edit', 'cup'), ('undo', 'mug')]
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
        if must_exist:
            require_content(path)
        if is_empty(path):
            warnings.append(
                f"{path} was an empty file, and a new journal begins in it: if edits were there, "
                "put a copy in its place"
            )
        elif path.exists():
            examine(path).believe()
    store = store_at(where)
    try:
        warnings += prepare(store)
    except BaseException:
        store.close()
        raise
    return Journal(store, project, labels, tuple(warnings))


def journal_place(labels: Labels, where: str | Path | None) -> str | Path:
    """Place of the journal of labels, by default beside the labels.

    Raises InputError: the labels are at a URL, and no other place is named.
    """
    if where is not None:
        return where
    url = url_of(labels.root)
    require(
        url is None,
        "labels at a URL have no journal beside them",
        expected="--journal FILE or postgresql://...",
        cause="their copy on this machine is no place for one: it may be cleared",
        path=url,
    )
    return labels.root / JOURNAL_FILE


def journal_of(
    labels: Labels, where: str | Path | None = None, *, project: str | None = None, must_exist: bool = False
) -> Journal:
    """Open the journal of labels, by default beside the labels; raises as `open_journal`.

    In a shared database the project is by default the name of the dataset's folder.
    """
    where = journal_place(labels, where)
    if project is None:
        project = Path(str(labels.manifest.dataset.get("path", ""))).name if is_url(where) else ""
    return open_journal(
        where,
        project=project,
        labels=labels_version(labels.manifest),
        must_exist=must_exist,
    )
