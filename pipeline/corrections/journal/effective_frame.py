"""One frame's effective labels: the automatic ones, the journal's events, and all that follows from them."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from pipeline.corrections.journal.effective_expressions import Withdrawn, correct_expressions
from pipeline.corrections.journal.effective_objects import (
    BOX_COLUMNS,
    DERIVED,
    OF_BOX,
    correct_objects,
    correct_pairs,
    object_value,
    unusable,
)
from pipeline.corrections.journal.events import Event
from pipeline.corrections.journal.field_refs import FIELDS, FieldRef
from pipeline.corrections.journal.frame_rows import FrameRows, Pairs, Setting
from pipeline.corrections.journal.replay import Origin, Replayed, Unapplied, by_ref, replay, replayed_judgement

if TYPE_CHECKING:
    import pyarrow as pa

Row = dict[str, Any]
Relift = Callable[[FrameRows, Mapping[int, Row], Mapping[int, Any], Iterable[int]], tuple[dict[int, Row], Pairs]]
"""Lifts and judges the objects of a frame anew, from the dataset: of its automatic rows, all standing objects, the 3D
boxes (JSON values) that people set, and the objects whose 2D box is not to follow from their mask."""


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


def effective_frame(
    auto: FrameRows, events: Iterable[Event], setting: Setting, relift: Relift | None = None
) -> EffectiveFrame:
    """Apply the events of a frame to its automatic labels.

    Parameters
    ----------
    auto : FrameRows
    events : iterable of Event
        Of this frame, in the order of their saving.
    setting : Setting
    relift : Relift, optional
        Without it, what follows from new pixels or boxes is marked stale.

    Raises
    ------
    InputError
        The dataset was asked for, and the frame cannot be loaded.
    """
    events = tuple(events)
    refs = by_ref(events)
    frame = EffectiveFrame(auto, setting, auto.pairs, events[-1].id if events else 0)
    correct_objects(frame, refs)
    relifted = _lift(frame, relift)
    _rename(frame)
    correct_pairs(frame, refs, relifted)
    cause = max((e for e in events if e.ref in frame.versions), key=lambda e: e.id, default=None)
    correct_expressions(frame, refs, cause)
    known = {n: row["bbox"] for n, row in auto.objects.items()}
    for ref, members in refs.items():
        if ref.kind == "review":
            # A judgement is of labels, and never one itself: nothing follows from it.
            after = replayed_judgement(ref, members, known, {*frame.objects, *frame.left_out}, auto.expressions)
        elif ref.kind == "frame":
            after = replay(None, members)
        else:
            continue
        if frame.note(members, after).value is not None:
            frame.statuses[ref] = after.value
            if ref.kind == "frame" and after.event is not None:
                frame.put("frames", "", ref.field, Origin.of("human", after.event))
    frame.row = {**auto.row, "objects": len(frame.objects)}
    frame.unapplied = tuple(sorted(frame.unapplied, key=lambda u: u.event.id))
    return frame


def _lift(frame: EffectiveFrame, relift: Relift | None) -> Pairs | None:
    """Bring up to date what follows from pixels and boxes, or mark it stale; the relations where they were judged."""
    auto, background = frame.auto, frame.setting.config.is_background
    newly_related = any(
        n in auto.objects and background(auto.objects[n]["label"]) and not background(frame.objects[n]["label"])
        for n in frame.renamed
        if n in frame.objects
    )
    if not frame.geometry and not newly_related:
        return None
    lifted: dict[int, Row] = {}
    relifted = None
    if relift is not None:
        lifted, relifted = relift(auto, frame.objects, frame.boxes, frame.human_bbox)
    pixels = {"mask", "mask_source", "bbox"}
    for number, event in frame.geometry.items():
        if number not in frame.objects:
            continue
        row, key, was = frame.objects[number], str(number), auto.objects.get(number, {})
        origin = Origin.of("stale" if relift is None else "recomputed", event)
        only_box = number in frame.boxes and frame.noted("objects", key, "mask") is None and number in auto.objects
        new = {**row, **{c: lifted[number][c] for c in (*DERIVED, *pixels)}} if lifted else row
        for column in (*(OF_BOX if only_box else DERIVED), *(pixels - {c for c in row if new[c] == row[c]})):
            noted = frame.noted("objects", key, column)
            by_hand = noted is not None and noted.source == "human" and (number in auto.objects or column == "label")
            if not by_hand and not (column in BOX_COLUMNS and number in frame.boxes):
                frame.put("objects", key, column, origin, was.get(column))
        if row["mask_source"] == "human" and number not in frame.human_bbox:
            frame.put("objects", key, "bbox", Origin.of("recomputed", event), was.get("bbox"))
        frame.objects[number] = new
    return relifted


def _rename(frame: EffectiveFrame) -> None:
    """Background classes are not asked for; what was one may be."""
    for number, event in frame.renamed.items():
        row = frame.objects.get(number)
        if row is None or row["reason"] == "not lifted yet":
            continue
        reason = unusable(row, frame.setting)
        if reason != row["reason"] and "background" in (reason, row["reason"]):
            for column, value in (("usable", reason is None), ("reason", reason)):
                frame.put("objects", str(number), column, Origin.of("recomputed", event), row[column])
                row[column] = value
