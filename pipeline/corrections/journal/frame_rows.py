"""The automatic labels, laid out to be corrected: rows of a frame, pairs as matrices, and how the labels were made."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from pipeline.geometry.lifting import LiftConfig
from pipeline.labels.check.relations import MIRRORED_PROFILES
from pipeline.labels.config import LabelConfig
from pipeline.labels.reading import Labels
from pipeline.labels.tables import build_table
from pipeline.language.relation_names import MIRRORED, PAIRWISE
from pipeline.system.errors import InputError

if TYPE_CHECKING:
    import pyarrow as pa

NO_STATE = -128
"""Stands for null in matrices of states."""
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
        In the order of PAIRWISE; NO_STATE where there is none.
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
            ids, np.zeros((n, n), np.bool_), np.full((n, n, r), NO_STATE, np.int8), np.full((n, n, r), np.nan),
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
            found.states[i, j, k] = filled(columns.get(relation), len(a), NO_STATE)[known]
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
        return None if number is None else self._places.get(number)

    @cached_property
    def _places(self) -> dict[int, int]:
        return {number: at for at, number in enumerate(self.numbers.tolist())}

    def state(self, a: int, b: int | None, relation: str) -> int | None:
        """The state of a relation by the objects' numbers; None where it has none."""
        i, j = self.index_of(a), self.index_of(b)
        if i is None or j is None or not self.present[i, j]:
            return None
        found = int(self.states[i, j, PAIRWISE.index(relation)])
        return None if found == NO_STATE else found

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
                columns[relation] = [None if s == NO_STATE else s for s in states.tolist()]
                columns[f"{relation}_margin"] = self.margins[a, b, k].astype(np.float32)
        return build_table("relations", columns)


def filled(values: Any, length: int, empty: float) -> np.ndarray:
    """A column as an array, with `empty` where it is null."""
    if values is None:
        return np.full(length, empty)
    if isinstance(values, np.ndarray) and values.dtype != object:
        return values
    return np.array([empty if v is None else v for v in values], np.float64)


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


def frame_rows(tables: Mapping[str, pa.Table]) -> FrameRows:
    """From the rows of one frame in each of the four tables."""
    (row,) = tables["frames"].to_pylist()
    objects = {r["object"]: r for r in tables["objects"].to_pylist()}
    relations = tables["relations"]
    columns = {
        name: relations.column(name).to_pylist()
        if relations.column(name).null_count
        else relations.column(name).to_numpy()
        for name in relations.column_names
        if name not in ("frame", "frame_index")
    }
    expressions = {r["id"]: r for r in tables["expressions"].to_pylist()}
    return FrameRows(row, objects, expressions, Pairs.of_columns(objects, columns))


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
        index = self.of_frame[frame]
        spans = {name: self.span(name, index) for name in self.tables}
        return frame_rows({n: t.slice(spans[n][0], spans[n][1] - spans[n][0]) for n, t in self.tables.items()})


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
        if self.config.profile not in MIRRORED_PROFILES:
            return None
        found = MIRRORED.get(relation)
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
