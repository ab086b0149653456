"""The labels as they were exported and as they are now, and what a file claims that was not exported."""

from __future__ import annotations

import hashlib
import json
from bisect import bisect_right
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from functools import lru_cache
from typing import Any

from pipeline.corrections.journal.effective import Corrector
from pipeline.corrections.journal.effective_frame import EffectiveFrame
from pipeline.corrections.journal.events import Event, grouped
from pipeline.corrections.journal.field_refs import FIRST_NEW_OBJECT, FieldRef, checked, object_ref, same_value
from pipeline.datasets import Dataset
from pipeline.labels.exports.row_provenance import ExportedFrom
from pipeline.labels.reading import Labels
from pipeline.labels.schema import labels_version
from pipeline.system.errors import InputError, require

FRAMES_KEPT = 16
_OF_PIXELS = ("mask", "bbox", "box", "exists", "label")
MOST_PROBLEMS = 1_000
"""A file with more of them is not one of ours; reading goes no further."""


class States:
    """States of labels that a journal has been through.

    `events` are all of the journal in the order of their saving; `open_dataset` gives the dataset or None, when needed.
    """

    def __init__(
        self, labels: Labels, events: Sequence[Event], open_dataset: Callable[[], Dataset | None] | None = None
    ) -> None:
        self.labels = labels
        self.version = labels_version(labels.manifest)
        self._events = grouped(events, lambda e: e.ref.frame)
        self._last = events[-1] if events else None
        self._id_of = {e.ulid: e.id for e in events}
        self._pixels = any(e.ref.kind == "object" and e.ref.field in _OF_PIXELS for e in events)
        self._bare = Corrector(labels)
        self.index = self._bare.index
        self._open = open_dataset
        self._full: Corrector | None = None
        self._frame_after = lru_cache(maxsize=FRAMES_KEPT)(self._computed)

    @property
    def now(self) -> ExportedFrom:
        """Newest state; with the dataset where a correction needs it."""
        full = self._pixels and self._corrector(True) is not None
        return ExportedFrom(self.version, None if self._last is None else self._last.ulid, full)

    def check(self, state: ExportedFrom) -> None:
        """Refuse a state of other labels or another journal, or one that needs the missing dataset."""
        require(
            state.labels == self.version, "the file was exported from other automatic labels", got=state.labels,
            expected=self.version, cause="were the labels made again since?", path=self.labels.root,
        )  # fmt: skip
        require(
            state.event is None or state.event in self._id_of, "the file was exported with another journal",
            got=f"no event {state.event}", cause="is --journal right?",
        )  # fmt: skip
        require(
            not (state.relifted and self._pixels) or self._corrector(True) is not None, "the dataset is needed",
            cause="what follows from corrected pixels is in the file", expected="--dataset says where it is",
        )  # fmt: skip

    def frame(self, frame: str, state: ExportedFrom) -> EffectiveFrame:
        """Frame in a checked state."""
        return self._at(frame, 0 if state.event is None else self._id_of[state.event], state.relifted)

    def frame_now(self, frame: str, like: ExportedFrom) -> EffectiveFrame:
        """Frame with all corrections, computed as in that state."""
        return self._at(frame, 0 if self._last is None else self._last.id, like.relifted)

    def newest(self, frame: str, ref: object) -> Event | None:
        """Newest event of a cell."""
        return next((e for e in reversed(self._events.get(frame, ())) if e.ref == ref), None)

    def _at(self, frame: str, last: int, relifted: bool) -> EffectiveFrame:
        return self._frame_after(
            frame, bisect_right([e.id for e in self._events.get(frame, [])], last), relifted and self._pixels
        )

    def _computed(self, frame: str, count: int, full: bool) -> EffectiveFrame:
        corrector = self._corrector(full)
        assert corrector is not None
        return corrector.frame(frame, self._events.get(frame, [])[:count])

    def _corrector(self, full: bool) -> Corrector | None:
        if not full:
            return self._bare
        if self._full is None and self._open is not None:
            dataset, self._open = self._open(), None
            self._full = None if dataset is None else Corrector(self.labels, dataset)
        return self._full


class TooManyProblems(Exception):
    """Stop of a reading that tells nothing new."""


@dataclass(frozen=True)
class Claim:
    """Value that differs from the exported one; `where` is file and line or annotation, `base` the exported state."""

    where: str
    ref: FieldRef
    value: Any
    base: ExportedFrom


@dataclass
class Claims:
    """Result of reading a file; `compared` counts rows and annotations."""

    states: States
    found: dict[FieldRef, Claim] = field(default_factory=dict)
    problems: list[str] = field(default_factory=list)
    ignored: Counter[str] = field(default_factory=Counter)  # differing values that cannot be corrected, by column
    notes: Counter[str] = field(default_factory=Counter)
    compared: int = 0

    def problem(self, where: str, what: object) -> None:
        """Note a fault of the file."""
        self.problems.append(f"{where}: {what}")
        if len(self.problems) >= MOST_PROBLEMS:
            raise TooManyProblems

    @contextmanager
    def reading(self, where: str) -> Iterator[None]:
        """Turn an InputError inside the block into a problem of the file."""
        try:
            yield
        except InputError as error:
            self.problem(where, error)

    @contextmanager
    def stopping(self) -> Iterator[None]:
        """End the block after too many problems, and note so."""
        try:
            yield
        except TooManyProblems:
            self.notes[f"reading stopped after {MOST_PROBLEMS} problems"] += 1

    def say(self, where: str, ref: FieldRef, value: Any, state: ExportedFrom) -> None:
        """Claim a cell's value unless it is the exported one."""
        try:
            value = checked(ref, value)
        except InputError as error:
            return self.problem(where, f"{ref.field}: {error}")
        if not same_value(value, self.states.frame(ref.frame, state).value(ref)):
            self.put(Claim(where, ref, value, state))

    def say_fields(
        self, where: str, row: Mapping[str, Any], ref: FieldRef, fields: Iterable[str], state: ExportedFrom
    ) -> None:
        """Claim the fields that a row has."""
        for name in fields:
            if name in row:
                self.say(where, replace(ref, field=name), row[name], state)

    def put(self, claim: Claim) -> None:
        """Keep a claim; a second one of the same cell must agree."""
        before = self.found.setdefault(claim.ref, claim)
        if before is not claim and not same_value(before.value, claim.value):
            self.problem(claim.where, f"says otherwise of {claim.ref} than {before.where}")

    def say_new(self, where: str, frame: str, seed: dict[str, Any], state: ExportedFrom) -> None:
        """Claim a new object; its number follows from its content, so that a second import adds nothing."""
        try:
            seed = checked(object_ref(frame, FIRST_NEW_OBJECT, "exists"), seed)
        except InputError as error:
            return self.problem(where, error)
        text = json.dumps([frame, seed], sort_keys=True, ensure_ascii=True)
        digest = int(hashlib.sha256(text.encode()).hexdigest()[:15], 16)
        number = FIRST_NEW_OBJECT + digest % (2**31 - FIRST_NEW_OBJECT)
        self.put(Claim(where, object_ref(frame, number, "exists"), seed, state))

    def say_deleted(self, where: str, frame: str, seen: set[int], state: ExportedFrom) -> None:
        """Reject the exported objects of a frame that the file lacks."""
        for number in self.states.frame(frame, state).objects.keys() - seen:
            self.put(Claim(where, object_ref(frame, number, "status"), "rejected", state))
