"""Effective labels of a frame, and of each value where it comes from."""

from __future__ import annotations

import json
from collections.abc import Collection, Sequence
from copy import copy
from dataclasses import field, fields
from functools import cached_property
from itertools import chain
from operator import attrgetter
from typing import Any

import numpy as np

from pipeline.corrections.journal.events import Event
from pipeline.corrections.journal.field_refs import FieldRef
from pipeline.corrections.journal.frame_rows import AT, BOX_COLUMNS, Asked, FrameRows, Pairs, Row
from pipeline.corrections.journal.replay import ORIGIN_FIELDS, Origin, Replayed, Unapplied
from pipeline.geometry.cleaning import LiftConfig
from pipeline.labels.check.relations import MIRRORED_PROFILES
from pipeline.labels.exports.base import made_by
from pipeline.labels.plan import LabelConfig
from pipeline.labels.reading import Labels, table_of_rows
from pipeline.language.relation_names import MIRRORED
from pipeline.system.arrow import pa
from pipeline.system.errors import as_input_error
from pipeline.system.frozen import dataclass

_TABLES = ("objects", "relations", "expressions", "frames")


@dataclass(frozen=True)
class Withdrawn:
    """Expression left out of the effective labels, with its row as it would stand."""

    frame: str
    id: str
    text: str
    reason: str
    row: Row = field(default_factory=dict, compare=False, repr=False)  # as it would stand


@dataclass(eq=False)
class EffectiveFrame:
    """Labels of a frame now, and where each value comes from.

    Made by `effective.effective_frame` from the frame before, and not changed after.
    """

    auto: FrameRows
    setting: Setting
    pairs: Pairs  # standing objects that take part in relations
    related: Pairs  # with what follows from `moved`, before corrections of relations
    asked: Asked  # automatic expressions
    row: Row = field(default_factory=dict)  # of the table `frames`
    objects: dict[int, Row] = field(default_factory=dict)
    left_out: dict[int, Row] = field(default_factory=dict)  # rejected, to be brought back
    outcomes: dict[str, Row | Withdrawn] = field(default_factory=dict)  # every expression by id
    expressions: dict[str, Row] = field(default_factory=dict)
    withdrawn: tuple[Withdrawn, ...] = ()
    marks: dict[str, str] = field(default_factory=dict)  # BAD_LABEL or BAD_BOX by id
    cells: dict[FieldRef, Replayed] = field(default_factory=dict)  # with events
    statuses: dict[FieldRef, Any] = field(default_factory=dict)
    # By (table, key, column), with the automatic value.
    origins: dict[tuple[str, str, str], tuple[Origin, Any]] = field(default_factory=dict)
    geometry: dict[int, Event] = field(default_factory=dict)  # objects with other pixels or box, newest such event
    boxes: dict[int, Any] = field(default_factory=dict)  # 3D boxes that people set
    human_bbox: set[int] = field(default_factory=set)  # objects with a 2D box that people set
    renamed: dict[int, Event] = field(default_factory=dict)  # objects with another class
    moved: dict[int, Event] = field(default_factory=dict)  # objects whose relations are not the automatic ones
    # (N,) bool, of `pairs`: relations wait for the dataset.
    stale: np.ndarray = field(default_factory=lambda: np.zeros(0, np.bool_))
    cause: Event | None = None  # newest correction of an object or relation
    # The same frame after corrections of objects alone, and their ULIDs: other corrections begin there.
    stage: EffectiveFrame | None = None
    made_of: tuple[str, ...] = ()
    ulids: tuple[str, ...] = ()  # of all events
    said: dict[str, dict[FieldRef, list[Event]]] = field(default_factory=dict)  # events by kind and cell
    answers: Any = None  # of the expressions, by the pairs
    # Rows of objects, and the objects made of them for display: see `scene.labelled_objects`.
    shown: tuple[tuple[Row, ...], tuple[Any, ...]] = ((), ())

    @classmethod
    def untouched(cls, auto: FrameRows, setting: Setting) -> EffectiveFrame:
        """Start from the automatic labels of a frame."""
        background = setting.config.is_background
        pairs = auto.pairs.of_objects(n for n, row in auto.objects.items() if not background(row["label"]))
        asked = Asked(auto, pairs.numbers)
        found = cls(auto, setting, pairs, pairs, asked, objects=dict(sorted(auto.objects.items())))
        found.stale = np.zeros(len(pairs.numbers), np.bool_)
        return found

    def successor(self) -> EffectiveFrame:
        """Copy for changes; rows, events and matrices are shared."""
        found = copy(self)
        vars(found).update({n: v.copy() for n, v in vars(self).items() if isinstance(v, (dict, set))})
        return found

    @property
    def unapplied(self) -> tuple[Unapplied, ...]:
        """Events without effect on these labels, by id."""
        return tuple(
            sorted(chain.from_iterable(cell.unapplied for cell in self.cells.values()), key=attrgetter("event.id"))
        )

    def note(self, events: Sequence[Event], replayed: Replayed) -> Replayed:
        """Keep a replayed cell; return it."""
        self.cells[events[0].ref] = replayed
        return replayed

    def put(self, table: str, key: str, column: str, origin: Origin, was: Any = None) -> None:
        """Note the origin and the automatic value of a value; the last call counts."""
        self.origins[table, key, column] = origin, was

    def forget(self, table: str, keys: Collection[str]) -> None:
        """Drop the origins of entities."""
        self.origins = {at: found for at, found in self.origins.items() if at[0] != table or at[1] not in keys}

    def noted(self, table: str, key: str, column: str) -> Origin | None:
        """Origin of a value; None for the labeller's."""
        found = self.origins.get((table, key, column))
        if found is not None:
            return found[0]
        return self.followed.get(key) if table == "relations" and column in self.setting.relations else None

    @cached_property
    def followed(self) -> dict[str, Origin]:
        """Origins of the relations that follow from other pixels or boxes, by pair."""
        found: dict[str, Origin] = {}
        source = "stale" if self.stale.any() else "recomputed"
        labelled = self.auto.pairs.of_objects(self.pairs.numbers)
        for i, j in zip(*np.nonzero(self.related.present | labelled.present), strict=True):
            a, b = int(self.pairs.numbers[i]), int(self.pairs.numbers[j])
            causes = [self.moved[n] for n in (a, b) if n in self.moved]
            if causes:
                found[f"{a},{b}"] = Origin.of(source, max(causes, key=attrgetter("id")))
        return found

    def all_origins(self) -> dict[tuple[str, str, str], tuple[Origin, Any]]:
        """Origins of all values that are not the labeller's, with the automatic value."""
        found = {
            ("relations", key, relation): (origin, self.auto.pairs.state(*map(int, key.split(",")), relation))  # pyright: ignore
            for key, origin in self.followed.items()
            for relation in self.setting.relations
        }
        return found | self.origins

    def provenance(self) -> list[Row]:
        """Rows of the provenance table."""
        entries = sorted(self.all_origins().items(), key=lambda entry: _TABLES.index(entry[0][0]))
        rows = (
            (
                table,
                self.frame,
                self.auto.index,
                key,
                column,
                origin.source,
                origin.author,
                origin.time,
                origin.event,
                origin.reason,
                json.dumps(was, ensure_ascii=False),
            )
            for (table, key, column), (origin, was) in entries
        )
        return [dict(zip(ORIGIN_FIELDS, row, strict=True)) for row in rows]

    @property
    def frame(self) -> str:
        return self.auto.frame

    @property
    def size(self) -> tuple[int, int]:
        """Height and width of the picture."""
        return int(self.auto.row["height"]), int(self.auto.row["width"])

    @property
    def stands(self) -> bool:
        """False for a rejected frame."""
        return self.statuses.get(FieldRef("frame", self.frame, "", "status")) != "rejected"

    def value(self, ref: FieldRef) -> Any:
        """Value of a cell now; None for no such entity."""
        if ref.kind in ("frame", "review") or ref.field == "exists" or ref.field.endswith("status"):
            return self.statuses.get(ref)
        if ref.kind == "relation":
            return self.pairs.state(*ref.numbers, ref.field)  # pyright: ignore[reportCallIssue]
        if ref.field == "mark":
            return self.marks.get(ref.key)
        row = self.object(ref.numbers[0]) if ref.kind == "object" else self.expression(ref.key)
        return None if row is None else object_value(row, ref.field)

    def object(self, number: int) -> Row | None:
        """Row of a standing or rejected object; None for no such object."""
        return self.objects.get(number) or self.left_out.get(number)

    def expression(self, name: str) -> Row | None:
        """Row of an expression now, also of a withdrawn expression; None for no such id."""
        found = self.outcomes.get(name)
        return found.row if isinstance(found, Withdrawn) else found

    @property
    def sentences(self) -> tuple[str, ...]:
        """Ids of all expressions, also of withdrawn expressions."""
        return tuple(self.outcomes)

    def version(self, ref: FieldRef) -> int:
        """Number of events of a cell: the base of an edit."""
        return self.cells[ref].version if ref in self.cells else 0

    def origin(self, ref: FieldRef) -> Origin:
        """Origin of a cell's value."""
        found = self.noted(f"{ref.kind}s", ref.key, "center" if ref.field == "box" else ref.field)
        return found or Origin("auto", made_by=self.setting.made_by)

    def tables(self) -> dict[str, pa.Table]:
        """Rows of the frame in each of the four tables, in canonical order."""
        chosen: dict[str, Collection[Row]] = {"frames": [self.row], "objects": self.objects.values()}
        chosen["expressions"] = sorted(
            self.expressions.values(),
            key=lambda r: (AT[r["relation"]], r["target_object"], r["reference_object"]),
        )
        found = {name: table_of_rows(name, rows) for name, rows in chosen.items()}
        return {**found, "relations": self.pairs.table(self.frame, self.auto.index, self.setting.relations)}


def object_value(row: Row, name: str) -> Any:
    """Value of an object's cell in a row of the table `objects`."""
    if name == "box":
        return None if row["center"] is None else {column: row[column] for column in BOX_COLUMNS}
    return None if name in ("status", "exists") else row[name]


@dataclass(frozen=True)
class Setting:
    """Common settings of the labels of a run."""

    config: LabelConfig
    relations: tuple[str, ...]  # labelled ones, in the order of PAIRWISE
    class_names: tuple[str, ...]  # sentences must not be mistaken for any
    made_by: str  # detector and rule profile, for provenance
    exact: bool  # numbered as the dataset's annotations

    def inverse(self, relation: str) -> str | None:
        """Name of "b ... a" for "a RELATION b"; None where the profile has none."""
        found = MIRRORED.get(relation) if self.config.profile in MIRRORED_PROFILES else None
        return found if found in self.relations else None


def setting_of(labels: Labels) -> Setting:
    """Read the settings from the manifest; InputError for labels beyond this release."""
    manifest, record = labels.manifest, labels.manifest.config
    names = labels.objects.column("label").unique().to_pylist()
    what, made = (
        "the labels' settings are not those of this release",
        {"lift": lambda kept: LiftConfig(**kept), "background": tuple},
    )
    with as_input_error(what, TypeError, AttributeError, got=str, path=labels.root):
        known = [f.name for f in fields(LabelConfig) if f.name in record]
        config = LabelConfig(**{name: made[name](record[name]) if name in made else record[name] for name in known})
    exact = str(manifest.models.get("detector", "")).startswith("annotations")
    return Setting(config, labels.relation_names, tuple(sorted(names)), made_by(manifest), exact)
