"""One frame's effective labels: the automatic ones, the journal's events, and all that follows from them."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from pipeline.corrections.journal.effective_expressions import Withdrawn, correct_expressions
from pipeline.corrections.journal.effective_objects import (
    BOX_COLUMNS,
    DERIVED,
    OF_BOX,
    CorrectedObjects,
    correct_objects,
    correct_pairs,
    object_value,
    unusable,
)
from pipeline.corrections.journal.events import Event
from pipeline.corrections.journal.field_refs import FIELDS, FieldRef
from pipeline.corrections.journal.frame_rows import FrameRows, Pairs, Setting
from pipeline.corrections.journal.replay import (
    Corrected,
    Origin,
    Origins,
    Unapplied,
    by_ref,
    replay,
    replayed_judgement,
)

if TYPE_CHECKING:
    import pyarrow as pa

Row = dict[str, Any]


Relift = Callable[[FrameRows, Mapping[int, Row], Mapping[int, Any], Iterable[int]], tuple[dict[int, Row], Pairs]]
"""Lifts and judges the objects of a frame anew, from the dataset: of its automatic rows, all standing objects, the 3D
boxes (JSON values) that people set, and the objects whose 2D box is not to follow from their mask."""


@dataclass(frozen=True, eq=False)
class EffectiveFrame:
    """What is known of a frame now, and of each value where it comes from.

    Attributes
    ----------
    auto : FrameRows
    row : dict
        Of the table `frames`.
    objects : dict of int to dict
        Those that stand.
    left_out : dict of int to dict
        Rejected ones: they can be brought back.
    pairs : Pairs
    expressions : dict of str to dict
    withdrawn : tuple of Withdrawn
    marks : dict of str to str
        By the id of the expression.
    versions : dict of FieldRef to int
        Of the cells that have events.
    statuses : dict of FieldRef to str
    unapplied : tuple of Unapplied
    origins : Origins
    setting : Setting
    last : int
        `id` of the newest event that is in it.
    """

    auto: FrameRows
    row: Row
    objects: dict[int, Row]
    left_out: dict[int, Row]
    pairs: Pairs
    expressions: dict[str, Row]
    withdrawn: tuple[Withdrawn, ...]
    marks: dict[str, str]
    versions: dict[FieldRef, int]
    statuses: dict[FieldRef, Any]
    unapplied: tuple[Unapplied, ...]
    origins: Origins
    setting: Setting
    last: int

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
            row = self.objects.get(ref.numbers[0]) or self.left_out.get(ref.numbers[0])
            if ref.field == "exists":
                return None if row is None or ref.numbers[0] in self.auto.objects else self.statuses.get(ref)
            return None if row is None else object_value(row, ref.field)
        if ref.kind == "relation":
            return self.pairs.state(*ref.numbers, ref.field)  # pyright: ignore[reportCallIssue]
        if ref.field == "mark":
            return self.marks.get(ref.key)
        row = self.expression(ref.key)
        return None if row is None else row[ref.field]

    def expression(self, name: str) -> Row | None:
        """The row of an expression as it is now, also of one that was left out; None where there never was one."""
        left_out = (w.row for w in self.withdrawn if w.id == name)
        return self.expressions.get(name) or next(left_out, None) or self.auto.expressions.get(name)

    def version(self, ref: FieldRef) -> int:
        """How many events a cell has: what an edit of it is based on."""
        return self.versions.get(ref, 0)

    def origin(self, ref: FieldRef) -> Origin:
        """Where the value of a cell comes from."""
        table = {"object": "objects", "relation": "relations", "expression": "expressions", "frame": "frames",
                 "review": "reviews"}  # fmt: skip
        column = "center" if ref.field == "box" else ref.field
        found = self.origins.get(table[ref.kind], ref.key, column)
        return found or Origin("auto", made_by=self.setting.made_by)

    def tables(self) -> dict[str, pa.Table]:
        """The frame's rows in each of the four tables, in canonical order."""
        from pipeline.labels.tables import arrow_schema, build_table

        found = {}
        chosen = {"frames": [self.row], "objects": self.objects.values(), "expressions": self.expressions.values()}
        for name, rows in chosen.items():
            names = arrow_schema(name).names
            found[name] = build_table(name, {column: [row[column] for row in rows] for column in names})
        found["relations"] = self.pairs.table(self.frame, self.auto.index, self.setting.relations)
        return found


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
    origins = Origins(auto.frame, auto.index)
    objects = correct_objects(auto, refs, setting, origins)
    relifted = _lift(auto, objects, setting, origins, relift)
    _rename(auto, objects, setting, origins)
    pairs = correct_pairs(auto, objects, relifted, refs, setting, origins)
    concerned = {*objects.versions, *pairs.versions}
    cause = max((e for e in events if e.ref in concerned), key=lambda e: e.id, default=None)
    expressions = correct_expressions(auto, objects, pairs, refs, setting, origins, cause)
    rest = Corrected()
    known = {n: row["bbox"] for n, row in auto.objects.items()}
    for ref, members in refs.items():
        if ref.kind == "review":
            # A judgement is of labels, and never one itself: nothing follows from it.
            after = replayed_judgement(ref, members, known, {*objects.rows, *objects.left_out}, auto.expressions)
        elif ref.kind == "frame":
            after = replay(None, members)
        else:
            continue
        if rest.note(ref, after).value is not None:
            rest.statuses[ref] = after.value
            if ref.kind == "frame" and after.event is not None:
                origins.put("frames", "", ref.field, Origin.of("human", after.event))
    parts = (objects, pairs, expressions, rest)
    return EffectiveFrame(
        auto,
        {**auto.row, "objects": len(objects.rows)},
        objects.rows,
        objects.left_out,
        pairs.pairs,
        expressions.rows,
        tuple(expressions.withdrawn),
        expressions.marks,
        {ref: version for part in parts for ref, version in part.versions.items()},
        {ref: value for part in parts for ref, value in part.statuses.items()},
        tuple(sorted((u for part in parts for u in part.unapplied), key=lambda u: u.event.id)),
        origins,
        setting,
        events[-1].id if events else 0,
    )


def _lift(
    auto: FrameRows, objects: CorrectedObjects, setting: Setting, origins: Origins, relift: Relift | None
) -> Pairs | None:
    """Bring up to date what follows from pixels and boxes, or mark it stale; the relations where they were judged."""
    background = setting.config.is_background
    newly_related = any(
        n in auto.objects and background(auto.objects[n]["label"]) and not background(objects.rows[n]["label"])
        for n in objects.renamed
        if n in objects.rows
    )
    if not objects.geometry and not newly_related:
        return None
    lifted: dict[int, Row] = {}
    relifted = None
    if relift is not None:
        lifted, relifted = relift(auto, objects.rows, objects.boxes, objects.human_bbox)
    for number, event in objects.geometry.items():
        if number not in objects.rows:
            continue
        row, key = objects.rows[number], str(number)
        only_box = number in objects.boxes and origins.get("objects", key, "mask") is None and number in auto.objects
        follows = OF_BOX if only_box else DERIVED
        origin = Origin.of("stale" if relift is None else "recomputed", event)
        new = {**row, **{c: lifted[number][c] for c in (*DERIVED, "mask", "mask_source", "bbox")}} if lifted else row
        for column in (*follows, *({"mask", "mask_source", "bbox"} - {c for c in row if new[c] == row[c]})):
            noted = origins.get("objects", key, column)
            if noted is not None and noted.source == "human" and (number in auto.objects or column == "label"):
                continue
            if column in BOX_COLUMNS and number in objects.boxes:
                continue
            was = auto.objects[number][column] if number in auto.objects else None
            origins.put("objects", key, column, origin, was)
        if objects.rows[number]["mask_source"] == "human" and number not in objects.human_bbox:
            was = auto.objects[number]["bbox"] if number in auto.objects else None
            origins.put("objects", key, "bbox", Origin.of("recomputed", event), was)
        objects.rows[number] = new
    return relifted


def _rename(auto: FrameRows, objects: CorrectedObjects, setting: Setting, origins: Origins) -> None:
    """Background classes are not asked for; what was one may be."""
    for number, event in objects.renamed.items():
        row = objects.rows.get(number)
        if row is None or row["reason"] == "not lifted yet":
            continue
        reason = unusable(row, setting)
        if reason != row["reason"] and "background" in (reason, row["reason"]):
            for column, value in (("usable", reason is None), ("reason", reason)):
                origins.put("objects", str(number), column, Origin.of("recomputed", event), row[column])
                row[column] = value
