"""A frame's labels laid out to be corrected, the automatic and the effective ones: rows, and pairs as matrices."""

from __future__ import annotations

import json
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from typing import Any

import numpy as np

from pipeline.corrections.journal.events import Event
from pipeline.corrections.journal.field_refs import FIELDS, FieldRef
from pipeline.corrections.journal.replay import ORIGIN_FIELDS, Origin, Replayed, Unapplied
from pipeline.geometry.lifting import LiftConfig
from pipeline.labels.check.relations import MIRRORED_PROFILES
from pipeline.labels.plan import LabelConfig
from pipeline.labels.reading import Labels, build_table, table_of_rows
from pipeline.language.relation_names import MIRRORED, PAIRWISE
from pipeline.relations.pair_measures import NOT_JUDGED
from pipeline.system.arrow import pa
from pipeline.system.errors import InputError

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

    `effective.effective_frame` makes it; nothing changes it after that.

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
        return (
            self.expressions.get(name)
            or next((w.row for w in self.withdrawn if w.id == name), None)
            or self.auto.expressions.get(name)
        )

    @property
    def sentences(self) -> tuple[str, ...]:
        """The ids of all expressions, also of those that people added and of those that were left out."""
        return tuple(dict.fromkeys((*self.auto.expressions, *self.expressions, *(w.id for w in self.withdrawn))))

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


MATRICES = ("present", "states", "margins", "distance", "doubted")


@dataclass(frozen=True)
class Pairs:
    """All ordered pairs of N objects.

    Attributes
    ----------
    numbers : (N,) int64
        The objects' numbers, ascending.
    present : (N, N) bool
        Pairs that have a row.
    states : (N, N, 9) int8
        In the order of PAIRWISE; NOT_JUDGED where there is none.
    margins : (N, N, 9) float64
        Metres; NaN where there is none.
    distance : (N, N) float64
        Metres; NaN where there is none.
    doubted : (N, N) int32
    """

    numbers: np.ndarray
    present: np.ndarray
    states: np.ndarray
    margins: np.ndarray
    distance: np.ndarray
    doubted: np.ndarray

    @classmethod
    def empty(cls, numbers: Iterable[int]) -> Pairs:
        """Pairs of these objects, none of which has a row."""
        ids = np.array(sorted(numbers), np.int64)
        n, r = len(ids), len(PAIRWISE)
        return cls(
            ids, np.zeros((n, n), np.bool_), np.full((n, n, r), NOT_JUDGED, np.int8), np.full((n, n, r), np.nan),
            np.full((n, n), np.nan), np.zeros((n, n), np.int32),
        )  # fmt: skip

    @classmethod
    def of_columns(cls, numbers: Iterable[int], columns: Mapping[str, Any]) -> Pairs:
        """From columns of the table `relations`; rows of objects that are not among `numbers` are left out."""
        found = cls.empty(numbers)
        a, b = (np.asarray(columns[end], np.int64) for end in ("a", "b"))
        known = np.isin(a, found.numbers) & np.isin(b, found.numbers)
        i, j = np.searchsorted(found.numbers, a[known]), np.searchsorted(found.numbers, b[known])
        found.present[i, j] = True
        for k, relation in enumerate(PAIRWISE):
            found.states[i, j, k] = filled(columns.get(relation), len(a), NOT_JUDGED)[known]
            found.margins[i, j, k] = filled(columns.get(f"{relation}_margin"), len(a), np.nan)[known]
        found.distance[i, j] = filled(columns["distance"], len(a), np.nan)[known]
        found.doubted[i, j] = filled(columns["doubted"], len(a), 0)[known]
        return found

    def of_objects(self, numbers: Iterable[int]) -> Pairs:
        """The same for other objects: pairs of those that are new have no row yet."""
        found = Pairs.empty(numbers)
        kept = np.isin(found.numbers, self.numbers)
        to, at = np.flatnonzero(kept), np.searchsorted(self.numbers, found.numbers[kept])
        for name in MATRICES:
            getattr(found, name)[np.ix_(to, to)] = getattr(self, name)[np.ix_(at, at)]
        return found

    def copy(self) -> Pairs:
        """One whose matrices may be written to."""
        return replace(self, **{name: getattr(self, name).copy() for name in MATRICES})

    def index_of(self, number: int | None) -> int | None:
        """Where an object is among the pairs; None where it, or an object at all, is none of them."""
        return None if number is None else self._index_by_number.get(number)

    @cached_property
    def _index_by_number(self) -> dict[int, int]:
        return {number: at for at, number in enumerate(self.numbers.tolist())}

    def state(self, a: int, b: int | None, relation: str) -> int | None:
        """The state of a relation by the objects' numbers; None where it has none."""
        i, j = self.index_of(a), self.index_of(b)
        if i is None or j is None or not self.present[i, j]:
            return None
        found = int(self.states[i, j, PAIRWISE.index(relation)])
        return None if found == NOT_JUDGED else found

    def table(self, frame: str, frame_index: int, relations: Sequence[str]) -> pa.Table:
        """As rows of the table `relations`, in canonical order."""
        a, b = np.nonzero(self.present)
        columns: dict[str, Any] = {
            "frame": [frame] * len(a),
            "frame_index": np.full(len(a), frame_index, np.int32),
            "a": self.numbers[a].astype(np.int32),
            "b": self.numbers[b].astype(np.int32),
            "distance": self.distance[a, b].astype(np.float32),
            "doubted": self.doubted[a, b],
        }
        for k, relation in enumerate(PAIRWISE):
            if relation in relations:
                states = self.states[a, b, k]
                columns[relation] = [None if s == NOT_JUDGED else s for s in states.tolist()]
                columns[f"{relation}_margin"] = self.margins[a, b, k].astype(np.float32)
        return build_table("relations", columns)


def filled(values: Any, length: int, empty: float) -> np.ndarray:
    """A column as an array, with `empty` where it is null."""
    if values is None:
        return np.full(length, empty)
    return (
        values
        if isinstance(values, np.ndarray) and values.dtype != object
        else np.array([empty if v is None else v for v in values], np.float64)
    )


@dataclass(frozen=True)
class FrameRows:
    """The automatic labels of a frame.

    Attributes
    ----------
    row : dict
        Of the table `frames`.
    objects, expressions : dict of int or str to dict
        Rows by number, and by id, in canonical order.
    pairs : Pairs
    """

    row: dict[str, Any]
    objects: dict[int, dict[str, Any]]
    expressions: dict[str, dict[str, Any]]
    pairs: Pairs

    @property
    def frame(self) -> str:
        return self.row["frame"]

    @property
    def index(self) -> int:
        return self.row["frame_index"]


class FrameIndex:
    """Where the rows of each frame lie in the tables: rows of a frame are next to one another.

    Parameters
    ----------
    tables : mapping of str to pyarrow.Table
        The four tables of labels, in canonical order.
    """

    def __init__(self, tables: Mapping[str, pa.Table]) -> None:
        self.tables = tables
        self._index = {name: table.column("frame_index").to_numpy() for name, table in tables.items()}
        names = tables["frames"].column("frame").to_pylist()
        self.of_frame = dict(zip(names, self._index["frames"].tolist(), strict=True))
        self.name_of = {index: name for name, index in self.of_frame.items()}

    def span(self, table: str, index: int) -> tuple[int, int]:
        """First row of a frame, and the one after its last."""
        first, stop = np.searchsorted(self._index[table], [index, index + 1])
        return int(first), int(stop)

    def rows(self, frame: str) -> FrameRows:
        """The labels of a frame that there is."""
        spans = {name: self.span(name, self.of_frame[frame]) for name in self.tables}
        tables = {n: t.slice(spans[n][0], spans[n][1] - spans[n][0]) for n, t in self.tables.items()}
        (row,) = tables["frames"].to_pylist()
        objects = {r["object"]: r for r in tables["objects"].to_pylist()}
        expressions = {r["id"]: r for r in tables["expressions"].to_pylist()}
        relations = tables["relations"].drop_columns(["frame", "frame_index"])
        columns = {
            name: column.to_pylist() if column.null_count else column.to_numpy()
            for name, column in zip(relations.column_names, relations.columns, strict=True)
        }
        return FrameRows(row, objects, expressions, Pairs.of_columns(objects, columns))


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
