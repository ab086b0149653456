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
    """The states of labels that a journal has been through.

    Parameters
    ----------
    labels : Labels
        The automatic ones.
    events : sequence of Event
        All of the journal, in the order of their saving.
    open_dataset : callable, optional
        Gives the dataset, or None where it is not at hand; called when it is needed.
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
        """The newest state; computed with the dataset where any correction needs it and it is at hand."""
        full = self._pixels and self._corrector(True) is not None
        return ExportedFrom(self.version, None if self._last is None else self._last.ulid, full)

    def check(self, state: ExportedFrom) -> None:
        """Refuse a state that these labels and their journal have never been in, or that cannot be computed again.

        Raises
        ------
        InputError
            Labels that were made again since, another journal, or the dataset is needed and not at hand.
        """
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
        """A frame as it was in a state that `check` let pass."""
        return self._at(frame, 0 if state.event is None else self._id_of[state.event], state.relifted)

    def frame_now(self, frame: str, like: ExportedFrom) -> EffectiveFrame:
        """A frame with all corrections, computed in the same way as that state."""
        return self._at(frame, 0 if self._last is None else self._last.id, like.relifted)

    def newest(self, frame: str, ref: object) -> Event | None:
        """The newest event of a cell."""
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
    """Reading on would tell nothing new."""


@dataclass(frozen=True)
class Claim:
    """A value that is not the one that was exported.

    Attributes
    ----------
    where : str
        File, and line or annotation.
    ref : FieldRef
    value : JSON value
    base : ExportedFrom
        What it is a correction of.
    """

    where: str
    ref: FieldRef
    value: Any
    base: ExportedFrom


@dataclass
class Claims:
    """Everything that reading a file brings.

    Attributes
    ----------
    states : States
    found : dict of FieldRef to Claim
    problems : list of str
        Each names its place in the file.
    ignored : Counter of str
        Values that differ and cannot be corrected, by column.
    notes : Counter of str
    compared : int
        Rows or annotations that were read.
    """

    states: States
    found: dict[FieldRef, Claim] = field(default_factory=dict)
    problems: list[str] = field(default_factory=list)
    ignored: Counter[str] = field(default_factory=Counter)
    notes: Counter[str] = field(default_factory=Counter)
    compared: int = 0

    def problem(self, where: str, what: object) -> None:
        """Note what is wrong with the file."""
        self.problems.append(f"{where}: {what}")
        if len(self.problems) >= MOST_PROBLEMS:
            raise TooManyProblems

    @contextmanager
    def reading(self, where: str) -> Iterator[None]:
        """What cannot be read inside of the block is a problem of the file there."""
        try:
            yield
        except InputError as error:
            self.problem(where, error)

    @contextmanager
    def stopping(self) -> Iterator[None]:
        """Too many problems end the block, and are noted."""
        try:
            yield
        except TooManyProblems:
            self.notes[f"reading stopped after {MOST_PROBLEMS} problems"] += 1

    def say(self, where: str, ref: FieldRef, value: Any, state: ExportedFrom) -> None:
        """A cell's value in the file; kept where it is not the exported one."""
        try:
            value = checked(ref, value)
        except InputError as error:
            return self.problem(where, f"{ref.field}: {error}")
        if not same_value(value, self.states.frame(ref.frame, state).value(ref)):
            self.put(Claim(where, ref, value, state))

    def say_fields(
        self, where: str, row: Mapping[str, Any], ref: FieldRef, fields: Iterable[str], state: ExportedFrom
    ) -> None:
        """Those of the fields of a cell's entity that a row of the file has."""
        for name in fields:
            if name in row:
                self.say(where, replace(ref, field=name), row[name], state)

    def put(self, claim: Claim) -> None:
        """Keep a claim; a second one on the same cell must say the same."""
        before = self.found.setdefault(claim.ref, claim)
        if before is not claim and not same_value(before.value, claim.value):
            self.problem(claim.where, f"says otherwise of {claim.ref} than {before.where}")

    def say_new(self, where: str, frame: str, seed: dict[str, Any], state: ExportedFrom) -> None:
        """An object that was not exported. Its number follows from what is said of it: a second import adds nothing."""
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
