"""Automatic labels of a frame laid out to be corrected: rows, pairs as matrices, and what pairs answer."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from functools import cached_property, lru_cache
from typing import Any

import numpy as np

from pipeline.labels.reading import build_table
from pipeline.language.noun_phrase import same_names
from pipeline.language.relation_names import PAIRWISE
from pipeline.relations.pair_measures import NOT_JUDGED, T, U
from pipeline.system.arrow import pa
from pipeline.system.frozen import dataclass

Row = dict[str, Any]
BOX_COLUMNS = ("center", "R", "size")

AT = {relation: k for k, relation in enumerate(PAIRWISE)}
"""Place of a relation in the matrices."""
_NAMES = ("frame", "frame_index")
_EMPTY = {**dict.fromkeys(PAIRWISE, NOT_JUDGED), "a": 0, "b": 0, "doubted": 0}
"""What stands for a null; NaN in the other columns of the table `relations`."""
MATRICES = ("present", "states", "margins", "distance", "doubted")


@dataclass(frozen=True)
class Pairs:
    """All ordered pairs of N objects, of R relations in the order of PAIRWISE."""

    numbers: np.ndarray  # (N,) int64, ascending
    present: np.ndarray  # (N, N) bool: has a row
    states: np.ndarray  # (N, N, R) int8, or NOT_JUDGED
    margins: np.ndarray  # (N, N, R) float64, metres or NaN
    distance: np.ndarray  # (N, N) float64, metres or NaN
    doubted: np.ndarray  # (N, N) int32, bits by relation

    @classmethod
    def empty(cls, numbers: Iterable[int]) -> Pairs:
        """Pairs of objects without any row."""
        ids = np.array(sorted(numbers), np.int64)
        n, r = len(ids), len(PAIRWISE)
        return cls(
            ids,
            np.zeros((n, n), np.bool_),
            np.full((n, n, r), NOT_JUDGED, np.int8),
            np.full((n, n, r), np.nan),
            np.full((n, n), np.nan),
            np.zeros((n, n), np.int32),
        )

    @classmethod
    def of_table(cls, numbers: Iterable[int], table: pa.Table) -> Pairs:
        """Pairs from rows of the table `relations`; rows of other objects are left out."""
        found, names = cls.empty(numbers), table.column_names
        values = {n: table.column(n).fill_null(_EMPTY.get(n, np.nan)).to_numpy() for n in names if n not in _NAMES}
        a, b = (values[end].astype(np.int64) for end in ("a", "b"))
        known = np.isin(a, found.numbers) & np.isin(b, found.numbers)
        i, j = np.searchsorted(found.numbers, a[known]), np.searchsorted(found.numbers, b[known])
        found.present[i, j] = True
        for k, relation in enumerate(PAIRWISE):
            if relation in names:
                found.states[i, j, k] = values[relation][known]
                found.margins[i, j, k] = values[f"{relation}_margin"][known]
        found.distance[i, j], found.doubted[i, j] = values["distance"][known], values["doubted"][known]
        return found

    def of_objects(self, numbers: Iterable[int]) -> Pairs:
        """Select other objects; pairs of new objects have no row."""
        found = Pairs.empty(numbers)
        kept = np.isin(found.numbers, self.numbers)
        to, at = np.flatnonzero(kept), np.searchsorted(self.numbers, found.numbers[kept])
        for name in MATRICES:
            getattr(found, name)[np.ix_(to, to)] = getattr(self, name)[np.ix_(at, at)]
        return found

    def copy(self) -> Pairs:
        """Copy with separate matrices."""
        return replace(self, **{name: getattr(self, name).copy() for name in MATRICES})

    def index_of(self, number: int | None) -> int | None:
        """Index of an object among the pairs; None for any other."""
        return self._index_by_number.get(number)

    @cached_property
    def _index_by_number(self) -> dict[int | None, int]:
        return {number: at for at, number in enumerate(self.numbers.tolist())}

    def state(self, a: int, b: int | None, relation: str) -> int | None:
        """State of a relation by object numbers; None for none."""
        i, j = self._index_by_number.get(a), self._index_by_number.get(b)
        if i is None or j is None or not self.present[i, j]:
            return None
        found = int(self.states[i, j, AT[relation]])
        return None if found == NOT_JUDGED else found

    def table(self, frame: str, frame_index: int, relations: Sequence[str]) -> pa.Table:
        """Rows of the table `relations`, in canonical order."""
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


@dataclass(frozen=True)
class FrameRows:
    """Automatic labels of a frame, rows by number and by id in canonical order."""

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
    """Index of the rows of each frame in the four tables, where they are adjacent."""

    def __init__(self, tables: Mapping[str, pa.Table]) -> None:
        self.tables = tables
        self._index = {name: table.column("frame_index").to_numpy() for name, table in tables.items()}
        names = tables["frames"].column("frame").to_pylist()
        self.of_frame = dict(zip(names, self._index["frames"].tolist(), strict=True))
        self.name_of = {index: name for name, index in self.of_frame.items()}

    def rows(self, frame: str) -> FrameRows:
        """Labels of a frame."""
        tables = {}
        for name, table in self.tables.items():
            first, stop = np.searchsorted(self._index[name], [self.of_frame[frame], self.of_frame[frame] + 1])
            tables[name] = table.slice(first, stop - first)
        (row,) = tables["frames"].to_pylist()
        objects = {r["object"]: r for r in tables["objects"].to_pylist()}
        expressions = {r["id"]: r for r in tables["expressions"].to_pylist()}
        return FrameRows(row, objects, expressions, Pairs.of_table(objects, tables["relations"]))


_kinds_of = lru_cache(maxsize=64)(same_names)


class Asked:
    """Automatic expressions of a frame, E of them, as columns."""

    def __init__(self, auto: FrameRows, numbers: Iterable[int]) -> None:
        rows = list(auto.expressions.values())
        self.ids = list(auto.expressions)
        self.index = {name: at for at, name in enumerate(self.ids)}
        self.ends = np.array([(r["target_object"], r["reference_object"]) for r in rows], np.int64).reshape(-1, 2)
        self.relations = np.array([AT[r["relation"]] for r in rows], np.int64)
        self.margins = np.array([np.nan if r["margin"] is None else r["margin"] for r in rows], np.float64)
        pairs = auto.pairs.of_objects(numbers)
        self.before = Answered.of(self, pairs, tuple([auto.objects[n]["label"] for n in pairs.numbers.tolist()]))


@dataclass(frozen=True)
class Answered:
    """Answers of E expressions by the pairs of N objects."""

    numbers: np.ndarray  # (N,) int64
    sets: np.ndarray  # (E, 2, N) bool: answers beyond doubt, with doubt
    related: np.ndarray  # (E,) bool: both own objects take part in relations
    holds: np.ndarray  # (E,) bool: true of its own objects
    margins: np.ndarray  # (E,) float64, metres
    kin: np.ndarray  # (E, N) bool: of the kind of an own object
    changed: np.ndarray  # (E,) bool: the row, or whether it stands, may follow

    @classmethod
    def of(cls, asked: Asked, pairs: Pairs, labels: tuple[str, ...]) -> Answered:
        """Answer expressions by pairs and their objects' class names; nothing is `changed`."""
        numbers, e, n = pairs.numbers, len(asked.ids), len(pairs.numbers)
        sets, kin = np.zeros((e, 2, n), np.bool_), np.zeros((e, n), np.bool_)
        holds, margins, related = np.zeros(e, np.bool_), np.full(e, np.nan), np.zeros(e, np.bool_)
        if n and e:
            at = np.minimum(np.searchsorted(numbers, asked.ends), n - 1)
            related = (numbers[at] == asked.ends).all(axis=1)
            (i, j), k, same = at[related].T, asked.relations[related], _kinds_of(labels)
            states = np.where(pairs.present[..., None], pairs.states, -1).transpose(2, 0, 1)
            for level, least in enumerate((T, U)):
                # By relation, object, and any object of the kind of the reference.
                satisfied = (states >= least).astype(np.float32) @ same.astype(np.float32) > 0
                sets[related, level] = same[i] & satisfied[k, :, j]
            holds[related] = states[k, i, j] == T
            margins[related], kin[related] = pairs.margins[i, j, k], same[i] | same[j]
        return cls(numbers, sets, related, holds, margins, kin, np.zeros(e, np.bool_))

    def differs(self, other: Answered) -> np.ndarray:
        """Compare (E,) bool with the answers of other pairs, of any objects."""
        one, two = self.sets, other.sets
        if not np.array_equal(self.numbers, other.numbers):
            numbers = np.union1d(self.numbers, other.numbers)
            one, two = (_spread(x.sets, np.searchsorted(numbers, x.numbers), len(numbers)) for x in (self, other))
        return (one != two).any(axis=(1, 2)) | (self.related != other.related)


def _spread(sets: np.ndarray, columns: np.ndarray, count: int) -> np.ndarray:
    found = np.zeros((*sets.shape[:2], count), np.bool_)
    found[..., columns] = sets
    return found
