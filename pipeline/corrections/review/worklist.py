"""The review queue while people work: its items with what became of them, which is next, and what settles them."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from pipeline.corrections.journal.edits import Edits, judge_both_ways, set_status
from pipeline.corrections.journal.effective import Corrector
from pipeline.corrections.journal.effective_frame import EffectiveFrame
from pipeline.corrections.journal.events import Event, grouped
from pipeline.corrections.journal.field_refs import FieldRef, object_ref
from pipeline.corrections.journal.journal import Journal
from pipeline.corrections.review.items import (
    DISAGREED,
    KINDS,
    NOBODY,
    SETTLED,
    STATES,
    ItemKey,
    State,
    item_of,
    judgements_of,
)
from pipeline.corrections.review.queue import QUEUE_COLUMNS
from pipeline.labels.reading import write_table
from pipeline.system.arrow import pa
from pipeline.system.errors import InputError, as_input_error, first_line, needed, require
from pipeline.system.frozen import dataclass
from pipeline.system.safe_files import read_parquet

VERSION_KEY = b"labels_version"
_UNREVIEWED, _UNSURE = STATES.index("unreviewed"), STATES.index("unsure")
_SETTLED = [STATES.index(s) for s in SETTLED]
BLOCK = 60
"""Items that are as good as equally undecided: what differs little in rank may be looked at in any order."""
MOST = 1000
"""Items that one action settles: more would not have been looked at."""
Mark = tuple[int, str]
"""An event of a journal: `id` and `ulid`. The second tells a journal from one that was put in its place."""
NOTHING: Mark = (0, "")
"""Stands before the first event."""


@dataclass(frozen=True, eq=False)
class Worklist:
    """The items of a queue in their order, and their states; `worklist` makes one."""

    queue: pa.Table
    keys: tuple[ItemKey, ...]
    """Of its rows."""
    indices: Mapping[ItemKey, int]
    """The reverse."""
    codes: np.ndarray
    """(N,) int8: states as indices in STATES."""
    kinds: np.ndarray
    """(N,) int8: places in KINDS."""
    disputed: np.ndarray
    """(N,) bool: what reviewers judged differently when the queue was made."""
    frames: Mapping[str, np.ndarray]
    """Places of the items of each frame, (K,) int64."""
    gone: np.ndarray
    """(N,) bool: items of which nothing is left, since what they are about was left out: not shown and not counted,
    until they come back."""

    def __len__(self) -> int:
        return len(self.keys)

    @property
    def counts(self) -> dict[str, int]:
        """Number of `items`, of each state, and `settled`, without lost items."""
        tally = np.bincount(self.codes[~self.gone], minlength=len(STATES)).tolist()
        by_state = dict(zip(STATES, tally, strict=True))
        return {"items": sum(tally), **by_state, "settled": sum(by_state[s] for s in SETTLED)}

    @cached_property
    def frame_counts(self) -> dict[str, tuple[int, int]]:
        """Settled and open items of each frame, without lost ones."""
        places = list(self.frames.values())
        number = np.repeat(np.arange(len(places)), [len(indices) for indices in places])
        items = np.concatenate(places or [np.zeros(0, np.int64)])
        settled, kept = np.isin(self.codes[items], _SETTLED), ~self.gone[items]
        counts = (np.bincount(number[kept & those], minlength=len(places)).tolist() for those in (settled, ~settled))
        return dict(zip(self.frames, zip(*counts, strict=True), strict=True))

    def state(self, key: ItemKey) -> State:
        """The state of an item; InputError where the queue has no such item."""
        return STATES[self.codes[self._index(key)]]

    def row(self, key: ItemKey) -> dict[str, Any]:
        """Row of the item in the queue; InputError if absent."""
        return self.rows([self._index(key)])[0]

    def rows(self, places: Sequence[int]) -> list[dict[str, Any]]:
        """Rows of the queue, with the `state` of each."""
        rows = self.queue.take(pa.array(places, pa.int64())).to_pylist()
        return [{**row, "state": STATES[self.codes[place]]} for place, row in zip(places, rows, strict=True)]

    def with_states(self, states: Mapping[ItemKey, State]) -> Worklist:
        """List after changes of states. Nothing is ranked anew: a byte an item is copied.

        An item that the queue does not hold changes nothing: people also edit what nobody doubted.

        Raises InputError: there is no such state.
        """
        codes = self.codes.copy()
        for key, state in states.items():
            require(state in STATES, f"no such state of review item {key}", got=state, expected=" | ".join(STATES))
            if (index := self.indices.get(key.plain)) is not None:
                codes[index] = STATES.index(state)
        return self if (codes == self.codes).all() else replace(self, codes=codes)

    def of_reviewer(self, own: Mapping[ItemKey, State]) -> Worklist:
        """List by one reviewer's own states, without what others have settled: a second opinion is independent."""
        nothing = np.zeros_like(self.gone)
        unseen = replace(self, codes=np.full_like(self.codes, _UNREVIEWED), disputed=nothing)
        return replace(unseen.with_states(own), gone=self.gone | np.isin(self.codes, _SETTLED))

    @property
    def touched(self) -> tuple[str, ...]:
        """Frames with reviewed or lost items."""
        marked = (self.codes != _UNREVIEWED) | self.gone
        return tuple(frame for frame, indices in self.frames.items() if marked[indices].any())

    def with_gone(self, frame: str, gone: Collection[ItemKey]) -> Worklist:
        """List with exactly these items of a frame lost."""
        indices = self.frames.get(frame, np.zeros(0, np.int64))
        now = np.array([self.keys[index] in gone for index in indices.tolist()], np.bool_)
        if (now == self.gone[indices]).all():
            return self
        marks = self.gone.copy()
        marks[indices] = now
        return replace(self, gone=marks)

    def left(self, kind: str | None = None) -> np.ndarray:
        """Places (K,) int64 of open items of a kind, in order; undisputed unsure ones last."""
        unsure = (self.codes == _UNSURE) & ~self.disputed
        places = np.flatnonzero(~np.isin(self.codes, _SETTLED) & self._shown(kind))
        return places[np.argsort(unsure[places], kind="stable")]

    def next_item(self, after: ItemKey | None = None, kind: str | None = None) -> ItemKey | None:
        """Next open item of a kind behind `after`, else from the top; undisputed unsure items last. None at the end.

        `after`: None, and one that the queue does not hold, stand before the first.
        """
        start = -1 if after is None else self.indices.get(after.plain, -1)
        shown, unsure = self._shown(kind), self.codes == _UNSURE
        for wanted in ((self.codes == _UNREVIEWED) | (unsure & self.disputed), unsure & ~self.disputed):
            # The item itself comes last: it is shown again only where it is the only one.
            found = np.roll(wanted & shown, -start - 1)
            if found.any():
                return self.keys[(int(found.argmax()) + start + 1) % len(self)]
        return None

    def previous(self, before: ItemKey | None = None, kind: str | None = None) -> ItemKey | None:
        """Item of a kind above, whatever its state, to look again at settled work; None above the first.

        None, and one that the queue does not hold, stand behind the last.
        """
        index = len(self) if before is None else self.indices.get(before.plain, len(self))
        above = np.flatnonzero(self._shown(kind)[:index])
        return self.keys[above[-1]] if len(above) else None

    def _shown(self, kind: str | None) -> np.ndarray:
        return ~self.gone if kind is None else ~self.gone & (self.kinds == KINDS.index(kind))

    def _index(self, key: ItemKey) -> int:
        return needed(self.indices.get(key.plain), "the queue holds no such item", got=str(key))

    def found(
        self, words: Callable[[dict[str, Any]], str], text: str, kind: str | None = None, settled: bool = False
    ) -> list[int]:
        """Places of open items of a kind, in order, with each word of a text in words, reasons or frame.

        `words`: what the label of a row of the queue says. `settled`: of settled items, too.
        """
        places = (np.flatnonzero(self._shown(kind)) if settled else self.left(kind)).tolist()
        wanted = text.casefold().split()
        if not wanted:
            return places
        texts = (" ".join((words(row), row["frame"], *row["reasons"])).casefold() for row in self.rows(places))
        return [k for k, said in zip(places, texts, strict=True) if all(w in said for w in wanted)]


def worklist(queue: pa.Table, states: Mapping[ItemKey, State] | None = None) -> Worklist:
    """List of a queue with the states of items; unreviewed if not in the mapping.

    Without a mapping they are those of the queue's column `state`, where it has one.

    Raises InputError: a state is none, or the queue holds an item twice.
    """
    keys = item_keys(queue)
    if states is None:
        stored = queue.column("state").to_pylist() if "state" in queue.column_names else []
        states = dict(zip(keys, stored, strict=False))
    indices = {key: k for k, key in enumerate(keys)}
    twice = len(keys) - len(indices)
    require(not twice, "the queue holds an item twice", got=f"{twice} of {len(keys)} items")
    disputed = np.zeros(len(keys), np.bool_)
    if "score" in queue.column_names:
        disputed = queue.column("score").to_numpy() >= DISAGREED
    kinds = np.array([KINDS.index(key.kind) for key in keys], np.int8)
    of_frame = grouped(range(len(keys)), lambda place: keys[place].frame)
    frames = {frame: np.array(places, np.int64) for frame, places in of_frame.items()}
    codes, gone = np.full(len(keys), _UNREVIEWED, np.int8), np.zeros(len(keys), np.bool_)
    return Worklist(queue, tuple(keys), indices, codes, kinds, disputed, frames, gone).with_states(states)


def item_keys(queue: pa.Table) -> list[ItemKey]:
    """The keys of a queue's rows, in their order; of expressions without their objects, see `ItemKey.plain`."""
    names = ("frame", "kind", "a", "b", "relation", "expression", "place")
    absent = [None] * queue.num_rows
    known = set(queue.column_names)
    columns = (queue.column(name).to_pylist() if name in known else absent for name in names)
    return [
        ItemKey(f, k, NOBODY, None, e or "") if k == "expression" else ItemKey(f, k, a, b, r or p or "")
        for f, k, a, b, r, e, p in zip(*columns, strict=True)
    ]


def by_frame(queue: pa.Table, block: int = BLOCK) -> pa.Table:
    """The queue with the items of a frame next to each other within every `block` items.

    Frames stand in the order of their first item of the block, and the items of
    a frame, pair by pair, in the order in which the pair's first one stood.
    """
    first: dict[tuple[Any, ...], int] = {}
    frames, *ends = (queue.column(name).to_pylist() for name in ("frame", "a", "b"))
    order = []
    for rank, (frame, a, b) in enumerate(zip(frames, *ends, strict=True)):
        part = rank // block
        pair = (part, frame, *sorted((a, -1 if b is None else b)))
        order.append((part, first.setdefault((part, frame), rank), first.setdefault(pair, rank), rank))
    return queue.take(pa.array([rank for *_, rank in sorted(order)], pa.int64()))


def write_queue(queue: pa.Table, path: Path) -> None:
    """Store a queue as Parquet, whole or not at all, with the labels' version.

    Raises InputError: it cannot be written.
    """
    with as_input_error("the queue cannot be written", OSError, got=lambda e: e.strerror or str(e), path=path):
        path.parent.mkdir(parents=True, exist_ok=True)
        write_table(queue, path)


def read_queue(path: str | Path, version: str | None = None) -> pa.Table:
    """A stored queue.

    `version`: of the automatic labels that it must be of: see `queue.automatic_version`.

    Raises InputError: it is no queue, damaged, or of other labels.
    """
    path = Path(path)
    with as_input_error("the queue cannot be read", pa.ArrowException, OSError, ValueError, got=first_line, path=path):
        queue = read_parquet(path)
    metadata = queue.schema.metadata or {}
    require(
        VERSION_KEY in metadata, "not a review queue", cause="was it written by `spatialviz review --out`?", path=path
    )
    found = metadata[VERSION_KEY].decode("utf-8", "replace")
    require(
        version is None or found == version,
        "the queue is of other labels",
        got=found,
        expected=version,
        cause="were the labels made again? then build the queue again: spatialviz review LABELS --out",
        path=path,
    )
    for name, kind in {**QUEUE_COLUMNS, "reasons": pa.list_(pa.string())}.items():
        have = [column.type for column in queue.schema if column.name == name]
        same = have == [kind] or (have == [pa.null()] and not queue.num_rows)
        require(same, f"the queue's column {name!r} is missing or damaged", got=have, expected=kind, path=path)
        gaps = name in ("frame", "kind", "a", "score", "reasons") and queue.column(name).null_count
        require(not gaps, f"the queue's column {name!r} has gaps", got=gaps, path=path)
    strange = sorted(set(queue.column("kind").to_pylist()) - {*KINDS})
    require(not strange, "the queue holds an unknown kind of item", got=strange[:3], path=path)
    keys = item_keys(queue)
    require(len(set(keys)) >= len(keys), "the queue holds an item twice", path=path)
    return queue


def frame_states(frame: EffectiveFrame, events: Sequence[Event]) -> dict[ItemKey, State]:
    """States of a frame's items over all people, as by `queue.states_on_labels` for all frames.

    `events`: all of it, in the order of their saving.
    """
    ignored = {u.event.ulid for u in frame.unapplied if u.kind != "agreed"}
    judgements = judgements_of(events, automatic=lambda k: frame.auto.pairs.state(k.a, k.b, k.what), ignored=ignored)
    return judgements.states_now(lambda k: frame.pairs.state(k.a, k.b, k.what))


def refreshed_worklist(work: Worklist, corrector: Corrector, journal: Journal, after: Mark) -> tuple[Worklist, Mark]:
    """Update states and lost items of a list after an event, whoever saved it.

    `after`: the newest event that is known already. Where the journal lacks it, that is another one now, such as a copy
    that was put back: then nothing of what was known holds. Returns `newest`: the newest event.

    Raises InputError: the journal or a frame cannot be read.
    """
    fresh, standing = _since(journal, after)
    names = [e.ref.frame for e in fresh]
    if not standing:
        names += work.touched
        # As nobody has reviewed it.
        work = replace(work, codes=np.full_like(work.codes, _UNREVIEWED), gone=np.zeros_like(work.gone))
    for name in [name for name in dict.fromkeys(names) if name in corrector.index.of_frame]:
        events = journal.events(frame=name)
        frame = corrector.frame(name, events)
        known = frame_states(frame, events)
        about = (item_of(e.ref) for e in events)
        states: dict[ItemKey, State] = {key: known.get(key, "unreviewed") for key in about if key is not None}
        keys = [work.keys[index] for index in work.frames.get(name, ())]
        work = work.with_states(states).with_gone(name, gone_items(frame, keys, states))
    return work, mark_of(fresh) if fresh or not standing else after


def mark_of(events: Sequence[Event]) -> Mark:
    """The newest of events in the order of their saving."""
    return (events[-1].id, events[-1].ulid) if events else NOTHING


def _since(journal: Journal, after: Mark) -> tuple[Sequence[Event], bool]:
    if after == NOTHING:
        return journal.events(), True
    # Nothing is ever taken out of a journal: with that event it has all that came before.
    found = journal.events(after=after[0] - 1)
    if found and found[0].ulid == after[1]:
        return found[1:], True
    return journal.events(), False


def gone_items(frame: EffectiveFrame, keys: Iterable[ItemKey], states: Mapping[ItemKey, State]) -> frozenset[ItemKey]:
    """Items of a frame with nothing left to be right or wrong.

    A relation goes with its pair, an expression with its objects, everything with its frame. An object or expression
    that somebody has settled, by leaving it out for one, stays.
    """

    def stands(key: ItemKey) -> bool:
        if key.kind == "relation":
            return frame.stands and frame.pairs.state(key.a, key.b, key.what) is not None
        if states.get(key.plain) in SETTLED:
            return True
        of_kind = key.what in frame.expressions if key.kind == "expression" else key.a < 0 or key.a in frame.objects
        return frame.stands and of_kind

    return frozenset(key for key in keys if not stands(key))


def say_of_item(frame: EffectiveFrame, item: ItemKey, status: str, author: str) -> Edits:
    """Edits of a reviewer's word: "accepted", "rejected" or "unsure"; InputError for a rejected relation."""
    if item.kind == "relation":
        require(status != "rejected", "a relation is not rejected", expected="T, U or F")
        return judge_both_ways(frame, status_ref(item), status, author)
    return set_status(frame, status_ref(item), status, author=author)


def status_ref(item: ItemKey) -> FieldRef:
    """Cell of an item's status."""
    if item.kind == "relation":
        return FieldRef("relation", item.frame, f"{item.a},{item.b}", f"{item.what}.status")
    if item.kind == "object":
        return object_ref(item.frame, item.a, "status")
    return FieldRef("expression", item.frame, item.what, "status")


def accept_all(items: Collection[ItemKey], frame_of: Callable[[str], EffectiveFrame], author: str) -> Edits:
    """Edits of one action for all these items, of whatever frames; undo takes all of them back.

    Items that have gone since they were found are left out.

    Raises InputError: there are none, or more than a person can have looked at.
    """
    require(items, "no open item is found: there is nothing to accept")
    require(len(items) <= MOST, "too many items at once", got=len(items), expected=f"at most {MOST}: filter them")
    made: dict[FieldRef, Any] = {}
    problem: InputError | None = None
    for name, of_frame in grouped(items, lambda key: key.frame).items():
        frame = frame_of(name)
        for item in of_frame:
            try:
                made |= {e.ref: e for e in say_of_item(frame, item, "accepted", author)}
            except InputError as error:
                problem = error
    if not made and problem is not None:
        raise problem
    return tuple(made.values())
