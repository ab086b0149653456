"""What a file claims that the export it came from did not say."""

from __future__ import annotations

import hashlib
import json
from collections import Counter
from dataclasses import dataclass, field
from typing import Any

from pipeline.corrections.journal.effective_frame import EffectiveFrame
from pipeline.corrections.journal.field_refs import FIRST_NEW_OBJECT, FieldRef, checked, object_cell, same_value
from pipeline.corrections.journal.incoming.states import States
from pipeline.labels.exports.provenance import ExportedFrom
from pipeline.system.errors import InputError

MOST_PROBLEMS = 1_000
"""A file with more of them is not one of ours; reading goes no further."""


class TooManyProblems(Exception):
    """Reading on would tell nothing new."""


@dataclass(frozen=True)
class Claim:
    """A value that is not the one that was exported.

    Attributes
    ----------
    where : str
        File, and line or annotation.
    cell : FieldRef
    value : JSON value
    base : ExportedFrom
        What it is a correction of.
    """

    where: str
    cell: FieldRef
    value: Any
    base: ExportedFrom


@dataclass
class Claims:
    """Everything that reading a file brings.

    Attributes
    ----------
    states : States
    found : dict of Cell to Claim
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

    def base(self, frame: str, state: ExportedFrom) -> EffectiveFrame:
        """A frame as it was exported."""
        return self.states.frame(frame, state)

    def say(self, where: str, cell: FieldRef, value: Any, state: ExportedFrom) -> None:
        """A cell's value in the file; kept where it is not the exported one."""
        try:
            value = checked(cell, value)
        except InputError as error:
            self.problem(where, f"{cell.field}: {error}")
            return
        if not same_value(value, self.base(cell.frame, state).value(cell)):
            self.put(Claim(where, cell, value, state))

    def put(self, claim: Claim) -> None:
        """Keep a claim; a second one on the same cell must say the same."""
        before = self.found.setdefault(claim.cell, claim)
        if before is not claim and not same_value(before.value, claim.value):
            self.problem(claim.where, f"says otherwise of {claim.cell} than {before.where}")

    def say_new(self, where: str, frame: str, seed: dict[str, Any], state: ExportedFrom) -> None:
        """An object that was not exported. Its number follows from what is said of it: a second import adds nothing."""
        try:
            seed = checked(object_cell(frame, FIRST_NEW_OBJECT, "exists"), seed)
        except InputError as error:
            self.problem(where, error)
            return
        text = json.dumps([frame, seed], sort_keys=True, ensure_ascii=True)
        digest = int(hashlib.sha256(text.encode()).hexdigest()[:15], 16)
        number = FIRST_NEW_OBJECT + digest % (2**31 - FIRST_NEW_OBJECT)
        self.put(Claim(where, object_cell(frame, number, "exists"), seed, state))

    def say_deleted(self, where: str, frame: str, seen: set[int], state: ExportedFrom) -> None:
        """Reject the exported objects of a frame that the file lacks."""
        for number in self.base(frame, state).objects.keys() - seen:
            self.put(Claim(where, object_cell(frame, number, "status"), "rejected", state))
