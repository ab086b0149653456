"""An editor: one person who corrects labels, what they see, what is saved, who changed what, what is not saved yet."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Sequence
from dataclasses import dataclass
from datetime import datetime, timezone
from functools import cached_property
from threading import Lock

from pipeline.corrections.journal.effective import Corrector
from pipeline.corrections.journal.effective_frame import EffectiveFrame
from pipeline.corrections.journal.events import Conflict, Edit, Event, NotSaved, Saved, new_ulid
from pipeline.corrections.journal.field_refs import LONGEST_NAME, FieldRef, plain_text, shown_value
from pipeline.corrections.journal.replay import history, redo, undo
from pipeline.corrections.journal_location import JournalLocation
from pipeline.corrections.unsaved import Waiting, decided
from pipeline.datasets import Dataset
from pipeline.labels.by_hand import NewLabels, grows, seen_with, with_frames
from pipeline.labels.reading import Labels
from pipeline.system.errors import InputError, require

NOT_IN_THE_JOURNAL = 2**62
"""Edits that wait to be saved come after every event of the journal."""
Outcome = Saved | Conflict | Waiting
"""What comes of saving."""


class LabelEditor:
    """What one person corrects. Not shared by threads, but for `news`, `saved` and `retry`; the journal behind it is.

    Parameters
    ----------
    labels : Labels
    location : JournalLocation
        Keeps also what waits: other desks of the same author see it.
    author : str
        Under whose name edits are saved.
    dataset : Dataset, optional
        Without it, what follows from new pixels and boxes is marked stale.
    """

    def __init__(self, labels: Labels, location: JournalLocation, author: str, dataset: Dataset | None = None) -> None:
        self.labels, self.location, self.author, self._dataset = labels, location, author, dataset
        self._events: dict[str, tuple[Event, ...]] = {}
        self._saved: tuple[Event, ...] = ()
        self._again: tuple[str, str] | None = None
        self._lock = Lock()

    @cached_property
    def corrector(self) -> Corrector:
        """The labels, read when they are first needed."""
        return Corrector(self.labels, self._dataset)

    def __contains__(self, frame: str) -> bool:
        """Whether the labels have a frame, or take it in: see `take_in`."""
        known, dataset = frame in self.corrector.index.of_frame, self._dataset
        return known or (dataset is not None and grows(self.labels) and frame in dataset.frame_ids)

    def take_in(self, frame: str) -> None:
        """Have a frame of the dataset among labels that were begun by hand; it is kept from the first edit on.

        Raises
        ------
        InputError
            The dataset cannot load it.
        """
        if frame not in self.corrector.index.of_frame and frame in self and self._dataset is not None:
            self.labels = seen_with(self.labels, self._dataset, frame)
            self.__dict__.pop("corrector", None)

    def keep_frames(self, frames: Iterable[str]) -> None:
        """Write frames that came in, where they are not written yet; InputError where they cannot be."""
        if isinstance(self.labels, NewLabels) and self._dataset is not None:
            with_frames(self.labels, self._dataset, dict.fromkeys(frames))

    @property
    def waiting(self) -> tuple[Waiting, ...]:
        """In the order in which they were made; frames show them as if they were saved."""
        return self.location.unsaved.waiting(self.author)

    @property
    def disputed(self) -> tuple[Conflict, ...]:
        """What this person has to decide, because others were faster; see `decide`."""
        return self.location.unsaved.disputed(self.author)

    def sign(self, author: str) -> None:
        """Save what follows under another name.

        Raises
        ------
        InputError
            As `check_name`.
        """
        self.author = self.check_name(author)

    def check_name(self, author: str) -> str:
        """A name as it is kept.

        Raises
        ------
        InputError
            It is no name, or what was done under the one before is not saved, or not decided, yet.
        """
        name = plain_text(author.strip(), "an author", LONGEST_NAME).strip()
        require(
            name == self.author or not self.waiting,
            f"edits of {self.author} are not saved yet",
            expected="save them or take them back first",
        )
        require(
            name == self.author or not self.disputed,
            f"{self.author} has not decided yet where somebody was faster",
            expected="decide first",
        )
        return name

    def frame(self, frame: str) -> EffectiveFrame:
        """A frame as this person sees it: with what everybody saved, and with what waits to be saved.

        Raises
        ------
        InputError
            The labels have no such frame, or the journal or the dataset cannot be read.
        """
        self.take_in(frame)
        # An event that waits is named by its group, so that one that was saved is another.
        return self.corrector.frame(frame, self.events(frame))

    def saved(self, frame: str) -> EffectiveFrame:
        """A frame with what everybody saved, made before it is looked at. Any thread may ask; raises as `frame`."""
        journal = self.location.to_read()
        return self.corrector.frame(frame, () if journal is None else journal.events(frame=frame))

    def corrected(self, frame: str) -> EffectiveFrame | None:
        """As `frame`; None where nobody has corrected anything in it."""
        return self.frame(frame) if self.events(frame) and frame in self else None

    def events(self, frame: str) -> list[Event]:
        """The events of a frame, then those that wait.

        Raises
        ------
        InputError
            The journal cannot be read, and never was.
        """
        found = self._read(frame)
        # Another thread may have saved what waits, and not have said so yet.
        groups = {e.group for e in found}
        return [*found, *(e for e in self._unsaved(frame) if e.group not in groups)]

    def _unsaved(self, frame: str) -> list[Event]:
        return [e for w in self.waiting for e in w.events(NOT_IN_THE_JOURNAL, "") if e.ref.frame == frame]

    def news(self, frame: str) -> tuple[Event, ...]:
        """What is saved in a frame that was not there when it was last looked at. Any thread may ask.

        Raises
        ------
        InputError
            The journal cannot be read.
        """
        return tuple(e for e in self._now(frame)[1] if not self.has_seen(e))

    def has_seen(self, event: Event) -> bool:
        """Whether an event was there when its frame was last looked at."""
        return any(e.ulid == event.ulid for e in self._events.get(event.ref.frame, ()))

    def replaced(self, frame: str) -> bool:
        """Whether the journal lacks what it had in a frame: it is another one now, such as a copy that was put back.

        Any thread may ask. A journal that cannot be read is not another one.
        """
        try:
            return bool(self._events.get(frame)) and not self._now(frame)[0]
        except InputError:
            return False

    def _now(self, frame: str) -> tuple[tuple[Event, ...], tuple[Event, ...]]:
        """What is known of a frame and still stands in the journal, and what came after it."""
        journal, known = self.location.to_read(), self._events.get(frame, ())
        if journal is None:
            return known, ()
        if known:
            # Nothing is ever taken out of a journal: with its newest event it has all that came before.
            last = known[-1]
            found = journal.events(frame=frame, after=last.id - 1)
            if found and found[0].ulid == last.ulid:
                return known, found[1:]
        return (), journal.events(frame=frame)

    def _read(self, frame: str) -> tuple[Event, ...]:
        known = self._events.get(frame)
        try:
            standing, newer = self._now(frame)
        except InputError:
            if known is None:
                raise
            # Who works on while the database is away sees what they saw, and their own edits.
            seen = {e.ulid for e in known}
            return (*known, *(e for e in self._saved if e.ref.frame == frame and e.ulid not in seen))
        found = self._events[frame] = (*standing, *newer)
        with self._lock:
            # What another thread saves after the reading is not in it; of a journal that was replaced, nothing is.
            last = found[-1].id if found else 0
            another = bool(known) and not standing
            self._saved = tuple(e for e in self._saved if e.ref.frame != frame or (e.id > last and not another))
        if self._again is not None and any(e.group == self._again[1] for e in found):
            # It was done after all, and is seen: whoever asks once more means the next.
            self._again = None
        return found

    def history(
        self,
        frame: str,
        *,
        objects: Collection[int] = (),
        pair: tuple[int, int] | None = None,
        expression: str | None = None,
    ) -> tuple[EventLine, ...]:
        """Who changed what of an object, a pair or an expression, the newest first, when the frame was last seen."""
        events = [*self._events.get(frame, ()), *self._unsaved(frame)]
        return event_lines(
            events,
            self.author,
            objects=objects,
            pair=pair,
            expression=expression,
            waiting=[w.group for w in self.waiting],
        )

    # ---- saving ---------------------------------------------------------------------

    def save(self, edits: Sequence[Edit]) -> Outcome:
        """Save an action; where that cannot be done now, keep it.

        Raises
        ------
        InputError
            It is no action: see `Journal.append`; or its frame cannot be taken in.
        """
        edits, self._again = tuple(edits), None
        self.keep_frames(e.ref.frame for e in edits)
        # Read once: another thread may save what waits at this moment.
        if waiting := self.waiting:
            # What is made on an edit that waits is saved after it.
            return self._keep(edits, new_ulid(), waiting[-1].problem)
        try:
            journal = self.location.to_write()
        except InputError as error:
            return self._keep(edits, new_ulid(), str(error))
        try:
            return self._kept(journal.append(edits, self.author))
        except NotSaved as error:
            return self._keep(edits, error.group, str(error))

    def _keep(self, edits: tuple[Edit, ...], group: str, problem: str) -> Waiting:
        action = Waiting(edits, self.author, group, datetime.now(timezone.utc), problem)
        self.location.unsaved.keep(action)
        return action

    def _kept(self, outcome: Saved | Conflict) -> Saved | Conflict:
        if isinstance(outcome, Saved):
            self._remember(outcome)
        else:
            self.location.unsaved.dispute(self.author, outcome)
        return outcome

    def _remember(self, outcome: Saved) -> None:
        """Until it is read, this is all that is known of it."""
        with self._lock:
            self._saved = (*self._saved, *outcome.events)

    def decide(self, conflict: Conflict, mine: Collection[int]) -> Outcome | None:
        """Settle a conflict: save one's own in the disputes that `mine` numbers, leave the others as they are.

        Returns
        -------
        Saved, Conflict, Waiting or None
            None where nothing of one's own is left. Conflict where somebody
            has changed one of its fields again: that is to be decided anew.
        """
        frames = {e.ref.frame for e in conflict.edits}
        edits = [e for name in frames for e in decided(conflict, self.frame(name), mine) if e.ref.frame == name]
        outcome = self.save(edits) if edits else None
        self.location.unsaved.settle(self.author, conflict)
        return outcome

    def retry(self) -> tuple[Outcome, ...]:
        """Try again to save what waits: see `Unsaved.retry`. Any thread may ask."""
        return self.location.unsaved.retry(self.author, self.location.to_write, self._remember)

    def undo(self, group: str | None = None) -> Outcome | None:
        """Take back this person's newest action, or the one of a group; one that waits is dropped.

        None where there is none.

        Raises
        ------
        NotSaved, InputError
            The journal cannot be read or written.
        """
        if waiting := self.waiting:
            require(
                group is None or group == waiting[-1].group,
                "newer edits wait to be saved",
                expected="save them or take them back first",
            )
            return self.location.unsaved.drop_last(self.author)
        return self._taken("undo", undo, group)

    def redo(self) -> Outcome | None:
        """Bring back what this person took back last; as `undo`."""
        return None if self.waiting else self._taken("redo", redo, None)

    def _taken(self, which: str, take: Callable[..., Saved | Conflict | None], group: str | None) -> Outcome | None:
        journal = self.location.to_read()
        if journal is None:
            return None
        # One whose answer was lost may have been saved: asked for again, it is not followed by the next.
        what = " ".join((which, self.author, group or ""))
        again = self._again[1] if self._again is not None and self._again[0] == what else None
        self._again = None
        try:
            outcome = take(journal, self.author, group=group, again=again)
        except NotSaved as error:
            self._again = what, error.group
            raise
        return None if outcome is None else self._kept(outcome)


@dataclass(frozen=True)
class EventLine:
    """One edit.

    Attributes
    ----------
    event : Event
    undone : Event or None
        What took it back, where it was not brought back since.
    group : str
        The action that the one who looks may take back with it; "" where it is not theirs, or taken back already.
    waiting : bool
        It is not saved yet.
    """

    event: Event
    undone: Event | None
    group: str
    waiting: bool = False

    @property
    def change(self) -> tuple[str, str]:
        """From what to what, in words."""
        e = self.event
        return shown_value(e.ref, e.before), shown_value(e.ref, e.after)


def event_lines(
    events: Sequence[Event],
    author: str,
    *,
    objects: Iterable[int] = (),
    pair: tuple[int, int] | None = None,
    expression: str | None = None,
    waiting: Iterable[str] = (),
) -> tuple[EventLine, ...]:
    """The edits of what is asked for, the newest first.

    Parameters
    ----------
    events : sequence of Event
        Of one frame, in the order of their saving.
    author : str
        Who looks.
    objects : iterable of int
    pair : tuple of int, optional
    expression : str, optional
    waiting : iterable of str
        Groups that are not saved yet.
    """
    numbers, unsaved = set(objects), set(waiting)
    mine = {members[0].group for members in history(e for e in events if e.author == author).done}
    root: dict[str, str] = {}
    newest: dict[str, Event] = {}
    for event in events:
        # An undo is of an edit or of a redo, a redo of an undo: in the end all are of one edit.
        taken = event.undo_of if event.action != "edit" else None
        root[event.ulid] = event.ulid if taken is None else root.get(taken, taken)
        newest[root[event.ulid]] = event

    def wanted(ref: FieldRef) -> bool:
        if ref.kind == "relation":
            return pair is not None and set(ref.numbers) == set(pair)
        return (ref.kind == "object" and ref.numbers[0] in numbers) or (
            ref.kind == "expression" and ref.key == expression
        )

    shown = [(e, newest[e.ulid]) for e in events if e.action == "edit" and wanted(e.ref)]
    return tuple(
        EventLine(e, last, "", e.group in unsaved) if last.action == "undo" else
        EventLine(e, None, last.group if last.group in mine else "", e.group in unsaved)
        for e, last in reversed(shown)
    )  # fmt: skip
