"""Journal of labels, opened on first need, and its unsaved actions: kept until saved, given up, or written to a file.

They belong to the process and to the author, not to a page: a page that is
loaded again finds them, and two pages of one author share them. Where two people
have changed the same fields, the second decides, field by field.
"""

from __future__ import annotations

import json
import re
import tempfile
from collections.abc import Callable, Collection, Iterable, Sequence
from contextlib import suppress
from dataclasses import replace
from datetime import datetime
from pathlib import Path
from threading import Lock
from typing import TYPE_CHECKING, Any

from pipeline.corrections.journal.connection import without_password
from pipeline.corrections.journal.effective_expressions import SETS
from pipeline.corrections.journal.effective_frame import EffectiveFrame, Setting
from pipeline.corrections.journal.events import Conflict, Edit, Event, Rival, Saved, grouped, new_ulid
from pipeline.corrections.journal.examining import DamagedJournal
from pipeline.corrections.journal.field_refs import FieldRef, shown_value
from pipeline.corrections.journal.journal import JOURNAL_FILE, Journal, journal_of, journal_place
from pipeline.labels.reading import Labels
from pipeline.language.relation_names import PAIRWISE
from pipeline.system.errors import InputError, require
from pipeline.system.frozen import dataclass
from pipeline.system.remote import is_url
from pipeline.system.whole_files import write_synced

if TYPE_CHECKING:
    from pipeline.corrections.review.label_jobs import LabelJobs


@dataclass(frozen=True)
class Waiting:
    """Action kept until it can be saved."""

    edits: tuple[Edit, ...]
    author: str
    group: str  # keeps it from being saved twice
    time: datetime
    problem: str  # why not saved

    def events(self, first: int, labels: str) -> list[Event]:
        """Events as saved, numbered from `first`."""
        return [
            Event(
                first + k,
                f"{self.group}-{k}",
                self.author,
                self.time,
                e.ref,
                e.before,
                e.after,
                e.base,
                e.base + 1,
                labels,
                e.reason,
                self.group,
                "edit",
                None,
                e.anchor,
            )
            for k, e in enumerate(self.edits)
        ]


class Unsaved:
    """Waiting and disputed actions of all authors of a process; shared by threads."""

    def __init__(self) -> None:
        self._waiting: dict[str, tuple[Waiting, ...]] = {}
        self._disputed: dict[str, tuple[Conflict, ...]] = {}
        self._lock = Lock()
        self._saving = Lock()

    @property
    def authors(self) -> tuple[str, ...]:
        """Authors with something unsaved."""
        with self._lock:
            return tuple(sorted({a for kept in (self._waiting, self._disputed) for a, some in kept.items() if some}))

    def waiting(self, author: str) -> tuple[Waiting, ...]:
        """Waiting actions of an author, in order."""
        return self._waiting.get(author, ())

    def disputed(self, author: str) -> tuple[Conflict, ...]:
        """Conflicts for an author to decide."""
        return self._disputed.get(author, ())

    def keep(self, action: Waiting) -> None:
        """Keep an action until saved."""
        with self._lock:
            self._waiting[action.author] = (*self.waiting(action.author), action)

    def dispute(self, author: str, conflict: Conflict) -> None:
        """Keep an action until the author decides."""
        with self._lock:
            self._disputed[author] = (*self.disputed(author), conflict)

    def settle(self, author: str, conflict: Conflict) -> None:
        """A conflict was decided."""
        with self._lock:
            self._disputed[author] = tuple(c for c in self.disputed(author) if c is not conflict)

    def drop_last(self, author: str) -> Waiting | None:
        """Give up the newest waiting action; None for no action; InputError during saving."""
        require(self._saving.acquire(timeout=1.0), "it is being saved at this moment", expected="try again")
        try:
            with self._lock:
                kept = self.waiting(author)
                self._waiting[author] = kept[:-1]
                return kept[-1] if kept else None
        finally:
            self._saving.release()

    def retry(
        self, author: str, journal: Callable[[], Journal], saved: Callable[[Saved], None] = lambda _: None
    ) -> tuple[Saved | Conflict | Waiting, ...]:
        """Save waiting actions of an author again, oldest first, until a failure.

        A conflict no longer waits: the author decides, with later actions on the same fields, which were made on it.
        Nothing is tried while another thread does. `saved` is called before an action stops waiting.
        """
        if not self._saving.acquire(blocking=False):
            return ()
        done: list[Saved | Conflict | Waiting] = []
        try:
            while self.waiting(author):
                first = self.waiting(author)[0]
                try:
                    outcome = journal().append(first.edits, first.author, group=first.group)
                except InputError as error:
                    self._replace(author, replace(first, problem=str(error)))
                    return (*done, self.waiting(author)[0])
                if isinstance(outcome, Conflict):
                    outcome = self._disputed_with_later(author, outcome)
                else:
                    saved(outcome)
                    self._replace(author, None)
                done.append(outcome)
        finally:
            self._saving.release()
        return tuple(done)

    def _disputed_with_later(self, author: str, conflict: Conflict) -> Conflict:
        """Move the first waiting action, with all later actions on the same fields, to the disputes.

        Saved alone, later versions could hit those of somebody else.
        """
        with self._lock:
            first, *rest = self.waiting(author)
            edits, left = list(conflict.edits or first.edits), []
            refs = {e.ref for e in edits}
            for action in rest:
                if refs.isdisjoint(e.ref for e in action.edits):
                    left.append(action)
                else:
                    edits += action.edits
                    refs |= {e.ref for e in action.edits}
            wanted = {e.ref: e for e in _merged(edits)}
            rivals = tuple(Rival(wanted[r.edit.ref], r.event) for r in conflict.rivals)
            whole = Conflict(rivals, tuple(wanted.values()))
            self._waiting[author] = tuple(left)
            self._disputed[author] = (*self.disputed(author), whole)
        return whole

    def _replace(self, author: str, first: Waiting | None) -> None:
        with self._lock:
            rest = self.waiting(author)[1:]
            self._waiting[author] = rest if first is None else (first, *rest)


def unsaved_actions(unsaved: Unsaved, author: str) -> list[list[dict[str, Any]]]:
    """Unsaved edits of an author as lists of actions for `spatialviz correct`, in order.

    Fields of new objects follow in a second list, disputes last.
    """
    waiting = _merged(e for w in unsaved.waiting(author) for e in w.edits)
    new = {(e.ref.frame, n) for e in waiting if e.ref.field == "exists" for n in e.ref.numbers}
    later = [e for e in waiting if e.ref.field != "exists" and new & {(e.ref.frame, n) for n in e.ref.numbers}]
    lists = [[e for e in waiting if e not in later], later, *(_merged(c.edits) for c in unsaved.disputed(author))]
    return [
        [
            {
                "edit": "value",
                "frame": e.ref.frame,
                "kind": e.ref.kind,
                "key": e.ref.key,
                "field": e.ref.field,
                "to": e.after,
                "base": e.base,
                "reason": e.reason,
            }
            for e in edits
        ]
        for edits in lists
        if edits
    ]


def _merged(edits: Iterable[Edit]) -> tuple[Edit, ...]:
    """Merge the edits of each cell."""
    found: dict[FieldRef, Edit] = {}
    for edit in edits:
        first = found.get(edit.ref)
        found[edit.ref] = edit if first is None else replace(first, after=edit.after, reason=edit.reason)
    return tuple(found.values())


def disputes(conflict: Conflict, setting: Setting) -> tuple[Conflict, ...]:
    """Disputed fields of an action: a relation goes with the inverse, and all answers of an expression together."""
    groups = grouped(conflict.edits or tuple(r.edit for r in conflict.rivals), lambda e: _together(e.ref, setting))
    rivals = grouped(conflict.rivals, lambda r: _together(r.edit.ref, setting))
    return tuple(Conflict(tuple(rivals[key]), tuple(members)) for key, members in groups.items() if key in rivals)


def decided(conflict: Conflict, frame: EffectiveFrame, mine: Collection[int]) -> tuple[Edit, ...]:
    """Edits to save after all: undisputed, and of the disputes numbered by `mine`.

    They are made on what the person was shown: another change is a conflict again.
    """
    found = disputes(conflict, frame.setting)
    disputed = {e.ref for d in found for e in d.edits}
    rivals = {r.edit.ref: r for d in found for r in d.rivals}
    wanted = (e for k, d in enumerate(found) if k in mine for e in d.edits)
    return (
        *(e for e in conflict.edits if e.ref not in disputed),
        *(_instead(e, rivals.get(e.ref), frame) for e in wanted),
    )


def _instead(edit: Edit, rival: Rival | None, frame: EffectiveFrame) -> Edit:
    if rival is None:
        return edit
    event, now = rival.event, frame.value(edit.ref)
    if event is None:
        return replace(edit, before=now, base=0)
    before = now if event.version == frame.version(edit.ref) else event.after
    over = f"instead of {event.author}'s {shown_value(edit.ref, event.after)}"
    return replace(edit, before=before, base=event.version, reason="; ".join(filter(None, (edit.reason, over))))


def _together(ref: FieldRef, setting: Setting) -> Any:
    if ref.kind == "expression" and ref.field in SETS:
        return ref.kind, ref.key, SETS
    if ref.kind == "relation" and ref.field in PAIRWISE:
        a, b = ref.numbers
        return ref.kind, min((a, b, ref.field), (b, a, setting.inverse(ref.field) or ref.field))
    return ref


class JournalLocation:
    """Journal of labels with all unsaved actions and jobs, shared by the editors of a process.

    `where` is a path or URL, by default beside the labels.
    """

    def __init__(self, labels: Labels, where: str | Path | None = None, project: str | None = None) -> None:
        self.labels, self.where, self.project = labels, where, project
        self.unsaved = Unsaved()
        self._jobs: LabelJobs | None = None
        self._journal: Journal | None = None
        self._lock = Lock()

    def __str__(self) -> str:
        if self._journal is not None:
            return self._journal.location
        return str(self.labels.root / JOURNAL_FILE) if self.where is None else self.address

    @property
    def jobs(self) -> LabelJobs:
        """Jobs on the labels, of all that correct them. Training and evaluation are loaded when somebody may ask."""
        from pipeline.corrections.review.label_jobs import LabelJobs

        with self._lock:
            self._jobs = self._jobs or LabelJobs()
            return self._jobs

    def end_jobs(self) -> None:
        """End running jobs for good."""
        if self._jobs is not None:
            self._jobs.end()

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
            journal_place(self.labels, self.where)
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
