"""One frame's effective labels: the automatic ones, the journal's events, and all that follows from them."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from pipeline.corrections.journal.events import Event
from pipeline.corrections.journal.field_refs import FIELDS, FieldRef
from pipeline.corrections.journal.frame_rows import FrameRows, Pairs, Setting
from pipeline.corrections.journal.replay import Origin, Replayed, Unapplied

if TYPE_CHECKING:
    import pyarrow as pa

Row = dict[str, Any]
BOX_COLUMNS = ("center", "R", "size")


@dataclass(frozen=True)
class Withdrawn:
    """An expression that is left out of the effective labels.

    Attributes
    ----------
    frame, id, text : str
    reason : str
    row : dict
        As it would stand, with what people set.
    """

    frame: str
    id: str
    text: str
    reason: str
    row: Row = field(default_factory=dict, compare=False, repr=False)


@dataclass(eq=False)
class EffectiveFrame:
    """What is known of a frame now, and of each value where it comes from.

    `effective_frame` makes it; nothing changes it after that.

    Attributes
    ----------
    auto : FrameRows
    setting : Setting
    pairs : Pairs
        Of the objects that stand and take part in relations.
    last : int
        `id` of the newest event that is in it.
    row : dict
        Of the table `frames`.
    objects : dict of int to dict
        Those that stand.
    left_out : dict of int to dict
        Rejected ones: they can be brought back.
    expressions : dict of str to dict
        Those that stand, by id.
    withdrawn : tuple of Withdrawn
    marks : dict of str to str
        BAD_LABEL or BAD_BOX by the id of the expression, whether it stands or not.
    versions : dict of FieldRef to int
        Of the cells that have events.
    statuses : dict of FieldRef to JSON value
    unapplied : tuple of Unapplied
    origins : dict of (table, key, column) to (Origin, value that the labels had)
        Of values that are not the labeller's.
    geometry : dict of int to Event
        Objects whose pixels or box a person set, and the newest such event.
    boxes : dict of int to JSON value
        3D boxes that people set.
    human_bbox : set of int
        Objects whose 2D box a person set.
    renamed : dict of int to Event
        Objects with another class.
    stale : (N,) bool
        Objects of `pairs` whose relations do not follow from their geometry yet.
    related_anew : bool
        Anything of `pairs` differs from the automatic labels.
    """

    auto: FrameRows
    setting: Setting
    pairs: Pairs
    last: int = 0
    row: Row = field(default_factory=dict)
    objects: dict[int, Row] = field(default_factory=dict)
    left_out: dict[int, Row] = field(default_factory=dict)
    expressions: dict[str, Row] = field(default_factory=dict)
    withdrawn: tuple[Withdrawn, ...] = ()
    marks: dict[str, str] = field(default_factory=dict)
    versions: dict[FieldRef, int] = field(default_factory=dict)
    statuses: dict[FieldRef, Any] = field(default_factory=dict)
    unapplied: tuple[Unapplied, ...] = ()
    origins: dict[tuple[str, str, str], tuple[Origin, Any]] = field(default_factory=dict)
    geometry: dict[int, Event] = field(default_factory=dict)
    boxes: dict[int, Any] = field(default_factory=dict)
    human_bbox: set[int] = field(default_factory=set)
    renamed: dict[int, Event] = field(default_factory=dict)
    stale: np.ndarray = field(default_factory=lambda: np.zeros(0, np.bool_))
    related_anew: bool = False

    def note(self, events: Sequence[Event], replayed: Replayed) -> Replayed:
        """Keep the version of the cell of these events and what does not apply to it; the same is returned."""
        self.versions[events[0].ref] = replayed.version
        self.unapplied += replayed.unapplied
        return replayed

    def put(self, table: str, key: str, column: str, origin: Origin, was: Any = None) -> None:
        """Note where a value comes from, and what it was; the last word on a value counts."""
        self.origins[table, key, column] = origin, was

    def noted(self, table: str, key: str, column: str) -> Origin | None:
        """Where a value comes from; None where it is the labeller's."""
        return self.origins.get((table, key, column), (None,))[0]

    def provenance(self) -> list[Row]:
        """As rows of the provenance table."""
        return [
            {
                "table": table,
                "frame": self.frame,
                "frame_index": self.auto.index,
                "key": key,
                "column": column,
                "origin": origin.source,
                "author": origin.author,
                "time": origin.time,
                "event": origin.event,
                "reason": origin.reason,
                "was": json.dumps(was, ensure_ascii=False),
            }
            for (table, key, column), (origin, was) in self.origins.items()
        ]

    @property
    def frame(self) -> str:
        return self.auto.frame

    @property
    def stands(self) -> bool:
        """Whether the frame was not rejected as a whole."""
        return self.statuses.get(FieldRef("frame", self.frame, "", "status")) != "rejected"

    def value(self, ref: FieldRef) -> Any:
        """What a cell says now; None where there is no such entity."""
        if ref.field not in FIELDS[ref.kind]:
            return None
        if ref.kind in ("frame", "review") or ref.field.endswith("status"):
            return self.statuses.get(ref)
        if ref.kind == "object":
            row = self.object(ref.numbers[0])
            if ref.field == "exists":
                return None if row is None or ref.numbers[0] in self.auto.objects else self.statuses.get(ref)
            return None if row is None else object_value(row, ref.field)
        if ref.kind == "relation":
            return self.pairs.state(*ref.numbers, ref.field)  # pyright: ignore[reportCallIssue]
        if ref.field == "mark":
            return self.marks.get(ref.key)
        row = self.expression(ref.key)
        return None if row is None else row[ref.field]

    def object(self, number: int) -> Row | None:
        """The row of an object that stands, or was rejected; None where there is none."""
        return self.objects.get(number) or self.left_out.get(number)

    def expression(self, name: str) -> Row | None:
        """The row of an expression as it is now, also of one that was left out; None where there never was one."""
        left_out = (w.row for w in self.withdrawn if w.id == name)
        return self.expressions.get(name) or next(left_out, None) or self.auto.expressions.get(name)

    def version(self, ref: FieldRef) -> int:
        """How many events a cell has: what an edit of it is based on."""
        return self.versions.get(ref, 0)

    def origin(self, ref: FieldRef) -> Origin:
        """Where the value of a cell comes from."""
        found = self.noted(f"{ref.kind}s", ref.key, "center" if ref.field == "box" else ref.field)
        return found or Origin("auto", made_by=self.setting.made_by)

    def tables(self) -> dict[str, pa.Table]:
        """The frame's rows in each of the four tables, in canonical order."""
        from pipeline.labels.tables import arrow_schema, build_table

        chosen = {"frames": [self.row], "objects": self.objects.values(), "expressions": self.expressions.values()}
        found = {
            name: build_table(name, {column: [row[column] for row in rows] for column in arrow_schema(name).names})
            for name, rows in chosen.items()
        }
        return {**found, "relations": self.pairs.table(self.frame, self.auto.index, self.setting.relations)}


def object_value(row: Row, name: str) -> Any:
    """The value of an object's cell in a row of the table `objects`."""
    if name == "box":
        return None if row["center"] is None else {column: row[column] for column in BOX_COLUMNS}
    return None if name in ("status", "exists") else row[name]
