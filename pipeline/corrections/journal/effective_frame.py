"""Effective labels of a frame, and of each value where it comes from."""

from __future__ import annotations

import json
from collections.abc import Collection, Sequence
from copy import copy
from dataclasses import dataclass, field, fields
from itertools import chain
from operator import attrgetter
from typing import Any

import numpy as np

from pipeline.corrections.journal.events import Event
from pipeline.corrections.journal.field_refs import FIELDS, FieldRef
from pipeline.corrections.journal.frame_rows import BOX_COLUMNS, Answered, Asked, FrameRows, Pairs, Row
from pipeline.corrections.journal.replay import ORIGIN_FIELDS, Origin, Replayed, Unapplied
from pipeline.geometry.lifting import LiftConfig
from pipeline.labels.check.relations import MIRRORED_PROFILES
from pipeline.labels.plan import LabelConfig
from pipeline.labels.reading import Labels, table_of_rows
from pipeline.language.relation_names import MIRRORED, PAIRWISE
from pipeline.system.arrow import pa
from pipeline.system.errors import InputError


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
    """A frame's labels now, and of each value where it comes from.

    `effective.effective_frame` makes it, of the one before where there is one; nothing changes it after that.

    Attributes
    ----------
    auto : FrameRows
    setting : Setting
    pairs : Pairs
        Of the objects that stand and take part in relations.
    last : int
        `id` of the newest event that is in it; `count` is how many are.
    row : dict
        Of the table `frames`.
    objects, left_out : dict of int to dict
        Those that stand, and rejected ones, which can be brought back.
    outcomes : dict of str to dict or Withdrawn
        Every expression by id.
    marks : dict of str to str
        BAD_LABEL or BAD_BOX by the id of the expression, whether it stands or not.
    versions : dict of FieldRef to int
        Of the cells that have events.
    statuses : dict of FieldRef to JSON value
    origins : dict of (table, key, column) to (Origin, value that the labels had)
        Of values that are not the labeller's.
    said : dict of (kind, entity) to dict of FieldRef to list of Event
        The events of each entity: an object by its number, the relations of two objects by both, ascending.
    ignored : dict of FieldRef to tuple of Unapplied
    geometry : dict of int to Event
        Objects whose pixels or box a person set, and the newest such event.
    boxes : dict of int to JSON value
        3D boxes that people set.
    human_bbox : set of int
        Objects whose 2D box a person set.
    renamed : dict of int to Event
        Objects with another class.
    moved : dict of int to Event
        Objects whose relations do not follow from the automatic ones.
    labelled, related : Pairs
        As `pairs`: by the automatic labels, and by what follows from `moved`, before any word on a relation.
    stale : (N,) bool
        Objects of `pairs` whose relations do not follow from their geometry yet.
    cause : Event or None
        The newest correction of an object or a relation.
    answered : Answered or None
        By the pairs; None where nothing follows for expressions.
    """

    auto: FrameRows
    setting: Setting
    pairs: Pairs
    labelled: Pairs
    related: Pairs
    last: int = 0
    count: int = 0
    row: Row = field(default_factory=dict)
    objects: dict[int, Row] = field(default_factory=dict)
    left_out: dict[int, Row] = field(default_factory=dict)
    outcomes: dict[str, Row | Withdrawn] = field(default_factory=dict)
    expressions: dict[str, Row] = field(default_factory=dict)
    withdrawn: tuple[Withdrawn, ...] = ()
    marks: dict[str, str] = field(default_factory=dict)
    versions: dict[FieldRef, int] = field(default_factory=dict)
    statuses: dict[FieldRef, Any] = field(default_factory=dict)
    origins: dict[tuple[str, str, str], tuple[Origin, Any]] = field(default_factory=dict)
    said: dict[tuple[str, Any], dict[FieldRef, list[Event]]] = field(default_factory=dict)
    ignored: dict[FieldRef, tuple[Unapplied, ...]] = field(default_factory=dict)
    geometry: dict[int, Event] = field(default_factory=dict)
    boxes: dict[int, Any] = field(default_factory=dict)
    human_bbox: set[int] = field(default_factory=set)
    renamed: dict[int, Event] = field(default_factory=dict)
    moved: dict[int, Event] = field(default_factory=dict)
    stale: np.ndarray = field(default_factory=lambda: np.zeros(0, np.bool_))
    cause: Event | None = None
    caused: tuple[Origin, Origin] | None = None
    asked: Asked | None = None
    answered: Answered | None = None

    @classmethod
    def untouched(cls, auto: FrameRows, setting: Setting) -> EffectiveFrame:
        """The automatic labels of a frame."""
        background = setting.config.is_background
        pairs = auto.pairs.of_objects(n for n, row in auto.objects.items() if not background(row["label"]))
        found = cls(auto, setting, pairs, pairs, pairs, objects=dict(sorted(auto.objects.items())))
        found.outcomes |= auto.expressions
        found.stale = np.zeros(len(pairs.numbers), np.bool_)
        return found

    def successor(self) -> EffectiveFrame:
        """A copy that may be changed; rows, events and matrices are shared."""
        found = copy(self)
        vars(found).update({n: v.copy() for n, v in vars(self).items() if isinstance(v, (dict, set))})
        return found

    @property
    def unapplied(self) -> tuple[Unapplied, ...]:
        """Events that say nothing of these labels, in the order of their saving."""
        return tuple(sorted(chain.from_iterable(self.ignored.values()), key=attrgetter("event.id")))

    def note(self, events: Sequence[Event], replayed: Replayed) -> Replayed:
        """Keep the version of the cell of these events and what does not apply to it; the same is returned."""
        ref = events[0].ref
        self.versions[ref], self.ignored[ref] = replayed.version, replayed.unapplied
        self.statuses.pop(ref, None)
        return replayed

    def put(self, table: str, key: str, column: str, origin: Origin, was: Any = None) -> None:
        """Note where a value comes from, and what it was; the last word on a value counts."""
        self.origins[table, key, column] = origin, was

    def forget(self, table: str, keys: Collection[str]) -> None:
        """Take back what was put of these entities."""
        self.origins = {at: found for at, found in self.origins.items() if at[0] != table or at[1] not in keys}

    def noted(self, table: str, key: str, column: str) -> Origin | None:
        """Where a value comes from; None where it is the labeller's."""
        return self.origins.get((table, key, column), (None,))[0]

    def provenance(self) -> list[Row]:
        """As rows of the provenance table."""
        rows = (
            (table, self.frame, self.auto.index, key, column, origin.source, origin.author, origin.time, origin.event,
             origin.reason, json.dumps(was, ensure_ascii=False))
            for (table, key, column), (origin, was) in self.origins.items()
        )  # fmt: skip
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
        """Whether the frame was not rejected as a whole."""
        return self.statuses.get(FieldRef("frame", self.frame, "", "status")) != "rejected"

    def value(self, ref: FieldRef) -> Any:
        """What a cell says now; None where there is no such entity."""
        if ref.field not in FIELDS[ref.kind]:
            return None
        sentence = (ref.kind, ref.field) == ("expression", "exists")
        if sentence or ref.kind in ("frame", "review") or ref.field.endswith("status"):
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
        found = self.outcomes.get(name)
        return found.row if isinstance(found, Withdrawn) else found

    @property
    def sentences(self) -> tuple[str, ...]:
        """The ids of all expressions, also of those that people added and of those that were left out."""
        return tuple(self.outcomes)

    def version(self, ref: FieldRef) -> int:
        """How many events a cell has: what an edit of it is based on."""
        return self.versions.get(ref, 0)

    def origin(self, ref: FieldRef) -> Origin:
        """Where the value of a cell comes from."""
        found = self.noted(f"{ref.kind}s", ref.key, "center" if ref.field == "box" else ref.field)
        return found or Origin("auto", made_by=self.setting.made_by)

    def tables(self) -> dict[str, pa.Table]:
        """The frame's rows in each of the four tables, in canonical order."""
        chosen: dict[str, Collection[Row]] = {"frames": [self.row], "objects": self.objects.values()}
        chosen["expressions"] = sorted(
            self.expressions.values(),
            key=lambda r: (PAIRWISE.index(r["relation"]), r["target_object"], r["reference_object"]),
        )
        found = {name: table_of_rows(name, rows) for name, rows in chosen.items()}
        return {**found, "relations": self.pairs.table(self.frame, self.auto.index, self.setting.relations)}


def object_value(row: Row, name: str) -> Any:
    """The value of an object's cell in a row of the table `objects`."""
    if name == "box":
        return None if row["center"] is None else {column: row[column] for column in BOX_COLUMNS}
    return None if name in ("status", "exists") else row[name]


@dataclass(frozen=True)
class Setting:
    """What the labels of a run have in common.

    Attributes
    ----------
    config : LabelConfig
    relations : tuple of str
        Those that were labelled, in the order of PAIRWISE.
    class_names : tuple of str
        All names of the labels: sentences must not be mistaken for any of them.
    made_by : str
        Detector and rule profile, for provenance.
    exact : bool
        Objects are numbered as the dataset's own annotations.
    """

    config: LabelConfig
    relations: tuple[str, ...]
    class_names: tuple[str, ...]
    made_by: str
    exact: bool

    def inverse(self, relation: str) -> str | None:
        """What "b ... a" is called where "a RELATION b" is said; None where the profile has no such relation."""
        found = MIRRORED.get(relation) if self.config.profile in MIRRORED_PROFILES else None
        return found if found in self.relations else None


def setting_of(labels: Labels) -> Setting:
    """Read it from the manifest.

    Raises
    ------
    InputError
        The manifest is of labels that this release cannot make.
    """
    manifest = labels.manifest
    detector = str(manifest.models.get("detector", ""))
    names = labels.objects.column("label").unique().to_pylist()
    return Setting(
        _config(manifest.config, labels),
        labels.relation_names,
        tuple(sorted(names)),
        ", ".join(part for part in (detector, str(manifest.profile.get("name", ""))) if part),
        detector.startswith("annotations"),
    )


def _config(record: dict[str, Any], labels: Labels) -> LabelConfig:
    known = {f.name for f in fields(LabelConfig)}
    values = {name: value for name, value in record.items() if name in known}
    try:
        if "lift" in values:
            values["lift"] = LiftConfig(**values["lift"])
        if "background" in values:
            values["background"] = tuple(values["background"])
        return LabelConfig(**values)
    except (TypeError, AttributeError) as error:
        what = "the labels' settings are not those of this release"
        raise InputError(what, got=str(error), path=labels.root) from error
