"""A desk: one person who corrects labels, what they see, what is saved, and what could not be saved yet."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from datetime import datetime, timezone

from pipeline.correcting.journal_place import JournalPlace
from pipeline.datasets import Dataset
from pipeline.errors import InputError
from pipeline.journal.effective import Corrector
from pipeline.journal.effective_frame import EffectiveFrame
from pipeline.journal.events import Conflict, Edit, Event, NotSaved, Saved, new_ulid
from pipeline.journal.undo import redo, undo
from pipeline.labels.reading import Labels

_NOT_IN_THE_JOURNAL = 2**62
"""Edits that wait to be saved come after every event of the journal."""


@dataclass(frozen=True)
class Waiting:
    """An action that could not be saved, kept until it can be.

    Attributes
    ----------
    edits : tuple of Edit
    author, group : str
        The group keeps an action from being saved twice.
    time : datetime
    problem : str
        Why it could not be saved.
    """

    edits: tuple[Edit, ...]
    author: str
    group: str
    time: datetime
    problem: str

    def events(self, first: int, labels: str) -> list[Event]:
        """As they will stand in the journal, numbered from `first` on."""
        return [
            Event(first + k, f"{self.group}-{k}", self.author, self.time, e.cell, e.before, e.after, e.base, e.base + 1,
                  labels, e.reason, self.group, "edit", None, e.anchor)
            for k, e in enumerate(self.edits)
        ]  # fmt: skip


Outcome = Saved | Conflict | Waiting
"""What comes of saving."""


class Desk:
    """What one person corrects. Not shared by threads; the journal behind it is.

    Parameters
    ----------
    labels : Labels
    place : JournalPlace
    author : str
        Under whose name edits are saved.
    dataset : Dataset, optional
        Without it, what follows from new pixels and boxes is marked stale.

    Attributes
    ----------
    corrector : Corrector
    waiting : tuple of Waiting
        In the order in which they were made; frames show them as if they were saved.
    """

    def __init__(self, labels: Labels, place: JournalPlace, author: str, dataset: Dataset | None = None) -> None:
        self.labels, self.place, self.author = labels, place, author
        self.corrector = Corrector(labels, dataset)
        self.waiting: tuple[Waiting, ...] = ()
        self._events: dict[str, tuple[Event, ...]] = {}
        self._seen: tuple[str, tuple[int, int], EffectiveFrame] | None = None

    def __contains__(self, frame: str) -> bool:
        return frame in self.corrector.index.of_frame

    def frame(self, frame: str) -> EffectiveFrame:
        """A frame as this person sees it: with what everybody saved, and with what waits to be saved.

        Raises
        ------
        InputError
            The labels have no such frame, or the journal or the dataset cannot be read.
        """
        events = self._read(frame)
        mine = [e for w in self.waiting for e in w.events(_NOT_IN_THE_JOURNAL, "") if e.cell.frame == frame]
        state = len(events), len(mine)
        if self._seen is None or self._seen[0] != frame or self._seen[1] != state:
            self._seen = frame, state, self.corrector.frame(frame, [*events, *mine])
        return self._seen[2]

    def news(self, frame: str) -> bool:
        """Whether others have saved something in a frame since it was last looked at."""
        known = len(self._events.get(frame, ()))
        return len(self._read(frame)) != known

    def events(self, frame: str) -> tuple[Event, ...]:
        """What everybody saved in a frame, in the order of the saving; InputError where the journal cannot be read."""
        return self._read(frame)

    def _read(self, frame: str) -> tuple[Event, ...]:
        known = self._events.get(frame, ())
        journal = self.place.to_read()
        if journal is not None:
            known = (*known, *journal.events(frame=frame, after=known[-1].id if known else 0))
            self._events[frame] = known
        return known

    # ---- saving ---------------------------------------------------------------------

    def save(self, edits: Sequence[Edit]) -> Outcome:
        """Save an action; where that cannot be done now, keep it.

        Raises
        ------
        InputError
            It is no action: see `Journal.append`.
        """
        edits = tuple(edits)
        if self.waiting:
            # What is made on an edit that waits is saved after it.
            return self._keep(edits, new_ulid(), self.waiting[-1].problem)
        try:
            journal = self.place.to_write()
        except InputError as error:
            return self._keep(edits, new_ulid(), str(error))
        try:
            return journal.append(edits, self.author)
        except NotSaved as error:
            return self._keep(edits, error.group, str(error))

    def _keep(self, edits: tuple[Edit, ...], group: str, problem: str) -> Waiting:
        kept = Waiting(edits, self.author, group, datetime.now(timezone.utc), problem)
        self.waiting = (*self.waiting, kept)
        return kept

    def retry(self) -> tuple[Outcome, ...]:
        """Try again to save what waits, oldest first, until one fails.

        What others have changed in the meantime is a conflict: it no longer
        waits, and is handed back for the person to decide.
        """
        done: list[Outcome] = []
        while self.waiting:
            first, rest = self.waiting[0], self.waiting[1:]
            try:
                done.append(self.place.to_write().append(first.edits, first.author, group=first.group))
            except InputError as error:
                self.waiting = (Waiting(first.edits, first.author, first.group, first.time, str(error)), *rest)
                return (*done, self.waiting[0])
            self.waiting = rest
        return tuple(done)

    def undo(self) -> Outcome | None:
        """Take back this person's newest action; one that waits is dropped. None where there is none.

        Raises
        ------
        NotSaved, InputError
            The journal cannot be read or written.
        """
        if self.waiting:
            last, self.waiting = self.waiting[-1], self.waiting[:-1]
            return last
        return self._taken(undo)

    def redo(self) -> Outcome | None:
        """Bring back what this person took back last; as `undo`."""
        return None if self.waiting else self._taken(redo)

    def _taken(self, take: Callable[..., Saved | Conflict | None]) -> Outcome | None:
        journal = self.place.to_read()
        return None if journal is None else take(journal, self.author)
