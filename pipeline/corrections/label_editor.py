"""Editors of one person who corrects labels: what they see, what is saved, who changed what, what is not saved yet."""

from __future__ import annotations

import getpass
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from datetime import datetime, timezone
from functools import cached_property
from threading import Lock

from pipeline.answering.pipeline import Pipeline
from pipeline.corrections.journal.effective import Corrector
from pipeline.corrections.journal.effective_frame import EffectiveFrame
from pipeline.corrections.journal.events import Conflict, Edit, Event, NotSaved, Saved, new_ulid
from pipeline.corrections.journal.field_refs import LONGEST_NAME, FieldRef, plain_text
from pipeline.corrections.journal.replay import history, redo, undo
from pipeline.corrections.review.items import ItemKey
from pipeline.corrections.unsaved import JournalLocation, Waiting, decided
from pipeline.datasets import Dataset
from pipeline.labels.by_hand import NewLabels, grows, seen_with, with_frames
from pipeline.labels.reading import Labels
from pipeline.system.errors import InputError, require
from pipeline.system.frozen import dataclass

NOT_IN_THE_JOURNAL = 2**62
"""Edits that wait to be saved come after every event of the journal."""
Outcome = Saved | Conflict | Waiting
"""What comes of saving."""


class LabelEditor:
    """Corrections of one person: frames as seen, saving, undo, history, unsaved actions.

    Used by one thread, but for `news`, `saved` and `retry`. Without `dataset`, what follows from new pixels and boxes
    is marked stale.
    """

    def __init__(self, labels: Labels, location: JournalLocation, author: str, dataset: Dataset | None = None) -> None:
        self.labels, self.location, self.author, self._dataset = labels, location, author, dataset
        self._events: dict[str, tuple[Event, ...]] = {}
        self._saved: tuple[Event, ...] = ()
        self._again: tuple[str, str] | None = None
        self._lock = Lock()

    @cached_property
    def corrector(self) -> Corrector:
        """Labels, read when first needed."""
        return Corrector(self.labels, self._dataset)

    def __contains__(self, frame: str) -> bool:
        """True for a frame of the labels, or to take in: see `take_in`."""
        known, dataset = frame in self.corrector.index.of_frame, self._dataset
        return known or (dataset is not None and grows(self.labels) and frame in dataset.frame_ids)

    def take_in(self, frame: str) -> None:
        """Take a frame of the dataset into labels begun by hand; kept from the first edit on; InputError where it
        cannot be loaded.
        """
        if frame not in self.corrector.index.of_frame and frame in self and self._dataset is not None:
            self.labels = seen_with(self.labels, self._dataset, frame)
            self.__dict__.pop("corrector", None)

    def keep_frames(self, frames: Iterable[str]) -> None:
        """Write frames taken in; InputError where impossible."""
        if isinstance(self.labels, NewLabels) and self._dataset is not None:
            with_frames(self.labels, self._dataset, dict.fromkeys(frames))

    @property
    def waiting(self) -> tuple[Waiting, ...]:
        """Waiting actions in order, shown in frames as saved."""
        return self.location.unsaved.waiting(self.author)

    @property
    def disputed(self) -> tuple[Conflict, ...]:
        """Conflicts for this person to decide; see `decide`."""
        return self.location.unsaved.disputed(self.author)

    def sign(self, author: str) -> None:
        """Save under another name from now on; InputError as `check_name`."""
        self.author = self.check_name(author)

    def check_name(self, author: str) -> str:
        """Check a new name; InputError for none, or while something of the old name is unsaved or undecided."""
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
        """Frame with all saved and waiting edits; InputError for no such frame, or an unreadable journal or dataset."""
        self.take_in(frame)
        # An event that waits is named by its group, so that one that was saved is another.
        return self.corrector.frame(frame, self.events(frame))

    def saved(self, frame: str) -> EffectiveFrame:
        """Frame with all saved edits, made ahead; for any thread; raises as `frame`."""
        journal = self.location.to_read()
        return self.corrector.frame(frame, () if journal is None else journal.events(frame=frame))

    def corrected(self, frame: str) -> EffectiveFrame | None:
        """Frame as of `frame`; None without corrections."""
        return self.frame(frame) if self.events(frame) and frame in self else None

    def events(self, frame: str) -> list[Event]:
        """Events of a frame, then waiting edits; InputError where the journal was never readable."""
        found = self._read(frame)
        # Another thread may have saved what waits, and not have said so yet.
        groups = {e.group for e in found}
        return [*found, *(e for e in self._unsaved(frame) if e.group not in groups)]

    def _unsaved(self, frame: str) -> list[Event]:
        return [e for w in self.waiting for e in w.events(NOT_IN_THE_JOURNAL, "") if e.ref.frame == frame]

    def news(self, frame: str) -> tuple[Event, ...]:
        """Events saved in a frame since the last look; for any thread; InputError where the journal cannot be read."""
        return tuple(e for e in self._now(frame)[1] if not self.has_seen(e))

    def has_seen(self, event: Event) -> bool:
        """True for an event present at the last look."""
        return any(e.ulid == event.ulid for e in self._events.get(event.ref.frame, ()))

    def replaced(self, frame: str) -> bool:
        """True where the journal lacks former events of a frame: another file; for any thread."""
        try:
            return bool(self._events.get(frame)) and not self._now(frame)[0]
        except InputError:
            return False

    def _now(self, frame: str) -> tuple[tuple[Event, ...], tuple[Event, ...]]:
        """Known events of a frame still in the journal, and newer events."""
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
        """Events of an object, a pair or an expression at the last look, newest first."""
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
        """Save an action, or keep it until possible; InputError as `Journal.append`, or for a frame that cannot be
        taken in.
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
        """Keep saved events until read."""
        with self._lock:
            self._saved = (*self._saved, *outcome.events)

    def decide(self, conflict: Conflict, mine: Collection[int]) -> Outcome | None:
        """Settle a conflict: save own edits in the disputes numbered by `mine`.

        None where nothing of one's own is left; Conflict where a field changed again.
        """
        frames = {e.ref.frame for e in conflict.edits}
        edits = [e for name in frames for e in decided(conflict, self.frame(name), mine) if e.ref.frame == name]
        outcome = self.save(edits) if edits else None
        self.location.unsaved.settle(self.author, conflict)
        return outcome

    def retry(self) -> tuple[Outcome, ...]:
        """Save waiting actions again: see `Unsaved.retry`; for any thread."""
        return self.location.unsaved.retry(self.author, self.location.to_write, self._remember)

    def undo(self, group: str | None = None) -> Outcome | None:
        """Take back the newest action, or the action of a group; a waiting action is dropped; None for no action.

        NotSaved or InputError where the journal cannot be written or read.
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
        """Bring back the action taken back last; as `undo`."""
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
    """Edit in a history."""

    event: Event
    undone: Event | None  # event that took it back
    group: str  # action to take back; "" for none
    waiting: bool = False  # not saved yet


def event_lines(
    events: Sequence[Event],
    author: str,
    *,
    objects: Iterable[int] = (),
    pair: tuple[int, int] | None = None,
    expression: str | None = None,
    waiting: Iterable[str] = (),
) -> tuple[EventLine, ...]:
    """Edits of objects, a pair or an expression, newest first, of a frame's events.

    `waiting` are groups not saved yet; `author` is who looks.
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
        EventLine(e, last, "", e.group in unsaved)
        if last.action == "undo"
        else EventLine(e, None, last.group if last.group in mine else "", e.group in unsaved)
        for e, last in reversed(shown)
    )


@dataclass(frozen=True)
class Target:
    """Objects, relation and queue item to look at."""

    frame: str
    objects: tuple[int, ...] = ()  # one object, or a pair
    relation: str | None = None
    item: ItemKey | None = None  # of the review queue


ANYTHING = Target("")
"""No frame in particular."""


class LabelEditors:
    """Editors of one person for the labels of several sources, by name."""

    def __init__(
        self, journals: Mapping[str, JournalLocation], sources: Mapping[str, Pipeline], author: str | None
    ) -> None:
        self._journals, self._sources = journals, sources
        self._open: dict[str, LabelEditor] = {}
        self._author = author or login_name()
        self._given, self._of_token = author is not None, False
        self.wanted: Target | None = None
        self.said: tuple[str, bool] = "", False
        self.on_saved: list[Callable[[tuple[Event, ...]], object]] = []

    def of(self, source: str) -> LabelEditor | None:
        """Editor of a source, opened when first needed; None without labels."""
        if source not in self._open and source in self._journals:
            location = self._journals[source]
            dataset = self._sources[source].dataset
            self._open[source] = LabelEditor(location.labels, location, self._author, dataset)
        return self._open.get(source)

    def opened(self, source: str) -> LabelEditor | None:
        """Editor of a source where open; for any thread."""
        return self._open.get(source)

    def corrected(self, source: str, frame: str) -> EffectiveFrame | None:
        """The labels of a frame as they were corrected by now; None where nobody has corrected any."""
        editor = self.of(source)
        return None if editor is None else editor.corrected(frame)

    def greet(self, author: str) -> None:
        """Take a name used before, unless given; raises as `sign`."""
        if author and not self._given:
            self.sign(author)

    def sign_for_token(self, author: str) -> None:
        """Correct under a token's name; `sign` cannot change it."""
        self.sign(author)
        self._given = self._of_token = True

    def sign(self, author: str) -> None:
        """Save what follows under another name; InputError as `LabelEditor.sign`, and where a token has the name."""
        name = plain_text(author.strip(), "an author", LONGEST_NAME).strip()
        require(not self._of_token, "corrections are under the name of your token", got=name, expected=self._author)
        # All of them, or none.
        for step in (LabelEditor.check_name, LabelEditor.sign):
            for editor in self._open.values():
                step(editor, name)
        self._author = name


def login_name() -> str:
    """Login name of the user; "somebody" for none."""
    try:
        return getpass.getuser()
    except (OSError, KeyError):  # A container may know no name of its user.
        return "somebody"
