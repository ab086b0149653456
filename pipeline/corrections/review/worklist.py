"""A stored queue with what became of its items, also while people go on saving: what a reviewer is shown next."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np

from pipeline.corrections.journal.effective import Corrector
from pipeline.corrections.journal.effective_frame import EffectiveFrame
from pipeline.corrections.journal.events import Event, grouped
from pipeline.corrections.journal.journal import Journal
from pipeline.corrections.review.items import (
    KINDS,
    SETTLED,
    STATES,
    ItemKey,
    State,
    checked_states,
    disputed_rows,
    item_keys,
    item_of,
    judgements_of,
    key_stands,
)
from pipeline.corrections.review.queue import QUEUE_COLUMNS
from pipeline.labels.reading import write_table
from pipeline.system.arrow import pa
from pipeline.system.errors import as_input_error, first_line, needed, require
from pipeline.system.safe_files import read_parquet

VERSION_KEY = b"labels_version"
_UNREVIEWED, _UNSURE = STATES.index("unreviewed"), STATES.index("unsure")
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
    """dict of str to (K,) int64: the indices of each frame's items."""
    gone: np.ndarray
    """(N,) bool: items of which nothing is left, since what they are about was left out: not shown and not counted,
    until they come back."""

    def __len__(self) -> int:
        return len(self.keys)

    @cached_property
    def tally(self) -> tuple[int, ...]:
        """Number of items in each of STATES, without lost ones."""
        return tuple(np.bincount(self.codes[~self.gone], minlength=len(STATES)).tolist())

    @property
    def counts(self) -> dict[str, int]:
        """Number of `items`, of each state, and `settled`, without lost items."""
        by_state = dict(zip(STATES, self.tally, strict=True))
        return {"items": sum(self.tally), **by_state, "settled": sum(by_state[s] for s in SETTLED)}

    @cached_property
    def frame_counts(self) -> dict[str, tuple[int, int]]:
        """Settled and open items of each frame, without lost ones."""
        places = list(self.frames.values())
        number = np.repeat(np.arange(len(places)), [len(indices) for indices in places])
        items = np.concatenate(places or [np.zeros(0, np.int64)])
        settled = np.isin(self.codes[items], [STATES.index(s) for s in SETTLED])
        kept = ~self.gone[items]
        counts = (np.bincount(number[kept & those], minlength=len(places)).tolist() for those in (settled, ~settled))
        return dict(zip(self.frames, zip(*counts, strict=True), strict=True))

    def state(self, key: ItemKey) -> State:
        """The state of an item; InputError where the queue has no such item."""
        return STATES[self.codes[self._index(key)]]

    def is_disputed(self, key: ItemKey) -> bool:
        """Tell items with differing judgements and no settlement since."""
        index = self.indices.get(key.plain)
        return index is not None and bool(self.disputed[index]) and self.codes[index] == _UNSURE

    def is_gone(self, key: ItemKey) -> bool:
        """Tell lost items; InputError where the queue has no such item."""
        return bool(self.gone[self._index(key)])

    def row(self, key: ItemKey) -> dict:
        """Row of the item in the queue; InputError if absent."""
        return self.queue.slice(self._index(key), 1).to_pylist()[0]

    def with_states(self, states: Mapping[ItemKey, State]) -> Worklist:
        """List after changes of states. Nothing is ranked anew: a byte an item is copied.

        An item that the queue does not hold changes nothing: people also edit what nobody doubted.

        Raises InputError: there is no such state.
        """
        codes = _codes(self.codes, self.indices, states)
        return self if (codes == self.codes).all() else replace(self, codes=codes)

    @property
    def touched(self) -> tuple[str, ...]:
        """Frames with reviewed or lost items."""
        marked = (self.codes != _UNREVIEWED) | self.gone
        return tuple(frame for frame, indices in self.frames.items() if marked[indices].any())

    def with_gone(self, frame: str, gone: Collection[ItemKey]) -> Worklist:
        """List with exactly these items of a frame lost."""
        if frame not in self.frames:
            return self
        indices = self.frames[frame]
        now = np.array([self.keys[index] in gone for index in indices.tolist()], np.bool_)
        if (now == self.gone[indices]).all():
            return self
        marks = self.gone.copy()
        marks[indices] = now
        return replace(self, gone=marks)

    def next_item(
        self, after: ItemKey | None = None, skip: Collection[ItemKey] = (), kind: str | None = None
    ) -> ItemKey | None:
        """Next open item behind `after`, else from the top; undisputed unsure items come last. None at the end.

        `after`: None, and one that the queue does not hold, stand before the first. `skip`: put off: not shown. `kind`:
        only items of this kind.
        """
        start = -1 if after is None else self.indices.get(after.plain, -1)
        shown = ~self.gone if kind is None else ~self.gone & (self.kinds == KINDS.index(kind))
        shown[[self.indices[k.plain] for k in skip if k.plain in self.indices]] = False
        unsure = self.codes == _UNSURE
        for wanted in ((self.codes == _UNREVIEWED) | (unsure & self.disputed), unsure & ~self.disputed):
            # The item itself comes last: it is shown again only where it is the only one.
            found = np.roll(wanted & shown, -start - 1)
            if found.any():
                return self.keys[(int(found.argmax()) + start + 1) % len(self)]
        return None

    def previous(self, before: ItemKey | None = None) -> ItemKey | None:
        """Item above, whatever its state, to look again at settled work; None above the first.

        None, and one that the queue does not hold, stand behind the last.
        """
        index = len(self) if before is None else self.indices.get(before.plain, len(self))
        above = np.flatnonzero(~self.gone[:index])
        return self.keys[above[-1]] if len(above) else None

    def _index(self, key: ItemKey) -> int:
        return needed(self.indices.get(key.plain), "the queue holds no such item", got=key.text())


def worklist(queue: pa.Table, states: Mapping[ItemKey, State] | None = None) -> Worklist:
    """List of a queue with the states of items; unreviewed if not in the mapping.

    Without a mapping they are those of the queue's column `state`, where it has one.

    Raises InputError: a state is none, or the queue holds an item twice.
    """
    keys = tuple(item_keys(queue))
    if states is None:
        stored = queue.column("state").to_pylist() if "state" in queue.column_names else []
        states = dict(zip(keys, stored, strict=False))
    indices = {key: k for k, key in enumerate(keys)}
    require(
        len(indices) >= len(keys),
        "the queue holds an item twice",
        got=f"{len(keys) - len(indices)} of {len(keys)} items",
    )
    codes = _codes(np.full(len(keys), _UNREVIEWED, np.int8), indices, states)
    kinds = np.array([KINDS.index(key.kind) for key in keys], np.int8)
    frames = {
        frame: np.array(found, np.int64) for frame, found in grouped(range(len(keys)), lambda k: keys[k].frame).items()
    }
    return Worklist(queue, keys, indices, codes, kinds, disputed_rows(queue), frames, np.zeros(len(keys), np.bool_))


def _codes(codes: np.ndarray, indices: Mapping[ItemKey, int], states: Mapping[ItemKey, State]) -> np.ndarray:
    """The codes with other states, where there are such items."""
    checked_states(states)
    found = codes.copy()
    for key, state in states.items():
        if (index := indices.get(key.plain)) is not None:
            found[index] = STATES.index(state)
    return found


def write_queue(queue: pa.Table, path: Path) -> None:
    """Store a queue as Parquet, whole or not at all, with the labels' version.

    Raises InputError: it cannot be written.
    """
    with as_input_error("the queue cannot be written", OSError, got=lambda e: e.strerror or str(e), path=path):
        path.parent.mkdir(parents=True, exist_ok=True)
        write_table(queue, path)


def read_queue(path: str | Path, version: str | None = None) -> pa.Table:
    """A stored queue.

    `version`: of the automatic labels that it must be of: see `reviewed.automatic_version`.

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
    _check_columns(queue, path)
    return queue


def _check_columns(queue: pa.Table, path: Path) -> None:
    text = pa.string()
    for name, kind in {**QUEUE_COLUMNS, "reasons": pa.list_(text)}.items():
        require(len(queue.schema.get_all_field_indices(name)) == 1, f"the queue lacks the column {name!r}", path=path)
        have = queue.schema.field(name).type
        same = pa.types.is_list(have) and have.value_type == text if name == "reasons" else have == kind
        require(
            same or (pa.types.is_null(have) and not queue.num_rows),
            f"the queue's column {name!r} is damaged",
            got=have,
            expected=kind,
            path=path,
        )
    for name in ("frame", "kind", "a", "score"):
        require(
            not queue.column(name).null_count,
            f"the queue's column {name!r} has gaps",
            got=queue.column(name).null_count,
            path=path,
        )
    strange = next((k for k in queue.column("kind").unique().to_pylist() if k not in KINDS), None)
    require(strange is None, "the queue holds an unknown kind of item", got=repr(strange)[:60], path=path)
    keys = item_keys(queue)
    require(len(set(keys)) >= len(keys), "the queue holds an item twice", path=path)


def frame_states(frame: EffectiveFrame, events: Sequence[Event]) -> dict[ItemKey, State]:
    """States of a frame's items over all people, as by `reviewed.states_on_labels` for all frames.

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


def gone_items(frame: EffectiveFrame, keys: Collection[ItemKey], states: Mapping[ItemKey, State]) -> frozenset[ItemKey]:
    """Items of a frame absent from a queue made now: see `key_stands`."""
    name, stood = frame.frame, frame.stands
    objects, expressions = ({(name, key) for key in rows if stood} for rows in (frame.objects, frame.expressions))
    pairs = {k for k in keys if k.kind == "relation" and stood and frame.pairs.state(k.a, k.b, k.what) is not None}
    frames = [name] if stood else []
    return frozenset(key for key in keys if not key_stands(key, states, frames, pairs, objects, expressions))
