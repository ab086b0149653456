"""A run to look through: facets, completion of searches, and rows by range, with marks and a second run.

A facet counts, by one property, how many expressions have which value, of those that the rest of a search leaves.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from pipeline.diagnosis.oracles import ALL_ORACLES
from pipeline.diagnosis.verdict import VERDICTS
from pipeline.evaluation.comparing import CHANGE, CHANGES, SECOND, SECOND_COLUMNS, with_second
from pipeline.evaluation.records_file import rows_where, some_rows
from pipeline.evaluation.row_stories import READ, row_head
from pipeline.evaluation.run_notes import MARKS, Key, keep_filter, mark, notes_path, read_notes
from pipeline.evaluation.search import (
    SORT,
    Field,
    Term,
    Value,
    fields_of,
    find_rows,
    quote,
    read_terms,
    terms_of,
)
from pipeline.evaluation.slices import DIMENSIONS, YES_NO, Coded, Dimension, coded
from pipeline.labels.reading import Labels, read_table
from pipeline.language.expression import UNREAD
from pipeline.language.relation_names import PAIRWISE
from pipeline.language.tree import QUERY_KINDS
from pipeline.system.arrow import pa, pc
from pipeline.system.errors import require
from pipeline.system.frozen import dataclass
from pipeline.system.recent import Recent

if TYPE_CHECKING:
    from pipeline.evaluation.records_file import Records

_ASKED = 64
"""Expressions whose rows are remembered: a page asks for the one that it shows at every drawing."""
_OPEN_WORD = re.compile(r'(?:[^\s"]|"(?:[^"\\]|\\.)*(?:"|$))+')
"""A quote that is open or closed belongs to its word, blanks included."""
_VERDICT, _CHANGE, _SECOND, _MARKS = (
    Dimension(name, title, name)
    for name, title in (
        ("verdict", "verdict"),
        (CHANGE, "in the second run"),
        (f"{SECOND}verdict", "verdict of the second run"),
        (MARKS, "marks"),
    )
)
FACETS = (
    _CHANGE,
    _VERDICT,
    _SECOND,
    DIMENSIONS["relation"],
    DIMENSIONS["kind"],
    DIMENSIONS["class"],
    DIMENSIONS["reference"],
    _MARKS,
    Dimension("detail", "detail of the verdict", "detail"),
    Dimension("mends", "one oracle that alone mends it", "mends"),
    Dimension("lucky", "correct by luck", "lucky"),
    Dimension("parse_ok", "read as it was meant", "parse_ok"),
    Dimension("ambiguous", "several correct answers", "ambiguous"),
    DIMENSIONS["distance"],
    DIMENSIONS["size"],
    DIMENSIONS["occlusion"],
    DIMENSIONS["same_class"],
    DIMENSIONS["scene"],
    DIMENSIONS["frame"],
)
"""What a run is looked at by, in this order; what it has no column for is left out."""
_ORDERS = {
    "verdict": VERDICTS,
    f"{SECOND}verdict": VERDICTS,
    CHANGE: tuple(CHANGES),
    "relation": PAIRWISE,
    "kind": (*QUERY_KINDS, UNREAD),
    "mends": ALL_ORACLES,
    "lucky": YES_NO,
    "parse_ok": YES_NO,
    "ambiguous": YES_NO,
}


@dataclass(frozen=True)
class FacetValue:
    """One value of a facet."""

    name: str
    term: str  # the search for it
    count: int  # expressions that have it, of those that the rest of the search leaves
    state: int = 0  # 1 where the search asks for it, -1 where it asks for what has it not, else 0


@dataclass(frozen=True)
class Facet:
    """One property of the expressions."""

    name: str
    title: str
    values: tuple[FacetValue, ...]  # those that occur, and those that are asked for
    ranges: bool = False  # its values are ranges of a number: one at a time

    def record(self) -> dict[str, Any]:
        """Convert to JSON."""
        return asdict(self)


def coded_columns(records: Records) -> dict[str, Coded]:
    """Columns of the facets of a run's records, by column; with `change` and `marks` where there are any."""
    return {d.column: _coded(records, d) for d in FACETS if d.column in records.column_names}


def facets_of(records: Records, query: str = "", columns: Mapping[str, Coded] | None = None) -> tuple[Facet, ...]:
    """The facets of a run's records under a search; `columns` as by `coded_columns`.

    Raises InputError: the search cannot be read.
    """
    terms = terms_of(query, records.schema)
    left: dict[str, np.ndarray] = {}
    found = []
    for one in (coded_columns(records) if columns is None else columns).values():
        own = [term for column, term in terms if column == one.cut.column]
        rest = " ".join(t.written for column, t in terms if column not in ("", one.cut.column))
        if rest not in left:
            left[rest] = np.zeros(records.num_rows, np.bool_)
            left[rest][find_rows(records, rest)] = True
        # What is the same of all says nothing.
        if len(one.parts) > 1 or one.cut is _MARKS:
            found.append(_facet(one, one.counts(left[rest]), own))
    return tuple(f for f in found if f.values)


def _coded(records: Records, cut: Dimension) -> Coded:
    return coded(records, cut, known=_ORDERS.get(cut.name, ()))


def _facet(found: Coded, counts: np.ndarray, own: Sequence[Term]) -> Facet:
    values = [
        FacetValue(name, term, int(n), _state(term, own)) for (name, term), n in zip(found.parts, counts, strict=True)
    ]
    cut = found.cut
    if not cut.edges and cut.name not in _ORDERS and cut.order == "count":
        values.sort(key=lambda v: (-v.count, v.name))
    return Facet(cut.name, cut.title, tuple(v for v in values if v.count or v.state), bool(cut.edges))


def _state(term: str, own: Sequence[Term]) -> int:
    """State of a value: 1 asked for, -1 excluded, else 0."""
    first, *more = read_terms(term)
    if more or first.operator not in (":", "="):
        written = {t.written for t in own}
        return int(written == {t.written for t in (first, *more)})
    value = first.values[0].text.lower()
    for t in own:
        # A flag may stand alone, as a free word.
        texts = ["yes"] if t.field is None else [v.text.lower() for v in t.values]
        if t.operator in (":", "=") and value in texts:
            return -1 if t.negated else 1
    return 0


def with_value(query: str, term: str, schema: pa.Schema, without: bool = False) -> str:
    """Add a value of a facet to a search, or remove a value already there; `without` excludes the value.

    Raises InputError: one of the two cannot be read.
    """
    terms = terms_of(query, schema)
    wanted = terms_of(term, schema)
    column = wanted[0][0]
    own = [t for c, t in terms if c == column]
    state = _state(term, own)
    ranged = len(wanted) > 1 or wanted[0][1].operator not in (":", "=")
    value = wanted[0][1].values[0]
    if ranged:
        kept = [] if state == 1 else [t for _, t in wanted]
    else:
        # Of the terms of this field those stay that go on to mean something beside the new one.
        kept = [_less(t, value) for t in own if t.operator in (":", "=") and t.field is not None]
        kept = [t for t in kept if t is not None and t.negated == without]
        if state != (-1 if without else 1):
            kept = _more(kept, replace(wanted[0][1], negated=without))
    first = next((k for k, (c, _) in enumerate(terms) if c == column), len(terms))
    others = [(k, t) for k, (c, t) in enumerate(terms) if c != column]
    parts = [t for k, t in others if k < first] + kept + [t for k, t in others if k > first]
    # An order comes last.
    parts.sort(key=lambda t: t.field is not None and t.field.lower() == "sort")
    return " ".join(t.written for t in parts)


def _less(term: Term, value: Value) -> Term | None:
    values = tuple(v for v in term.values if v.text.lower() != value.text.lower())
    return replace(term, values=values) if values else None


def _more(terms: list[Term], term: Term) -> list[Term]:
    """Join alternatives of a field in one term; of `=` and `:` the exact operator wins."""
    if not terms:
        return [term]
    operator = "=" if "=" in (term.operator, *(t.operator for t in terms)) else ":"
    values = (*(v for t in terms for v in t.values), *term.values)
    return [replace(term, operator=operator, values=values)]


def completions(records: Records, most: int = 200) -> tuple[Field, ...]:
    """List the fields of a run with their values, for completion."""
    found = fields_of(records.schema).values()
    return tuple(replace(f, values=_occurring(f, records.column(f.column), most)) for f in found)


def _occurring(field: Field, column: Any, most: int) -> tuple[str, ...]:
    """The values of a field, as `Field.values`."""
    # Ids are not chosen from a list.
    if field.kind == "text" and field.column != "id":
        counts = column.drop_null().value_counts().to_pylist()
        return tuple(quote(c["values"]) for c in sorted(counts, key=lambda c: (-c["counts"], c["values"]))[:most])
    if field.kind == "flag":
        return ("yes", "no")
    if field.kind == "names":
        flat = column.drop_null().combine_chunks().flatten()
        return tuple(sorted(str(v) for v in flat.unique().to_pylist() if v is not None))
    if field.kind == "number" and column.null_count < len(column):
        ends = pc.min_max(column).as_py()  # pyright: ignore[reportAttributeAccessIssue]
        return (f"{ends['min']:.6g}", f"{ends['max']:.6g}")
    return ()


def complete(typed: str, fields: Sequence[Field], most: int = 20) -> list[str]:
    """Complete the last word of a search, each offer as the whole word."""
    words = list(_OPEN_WORD.finditer(typed))
    word = words[-1][0] if words and words[-1].end() == len(typed) else ""
    minus, bare = ("-", word[1:]) if word.startswith("-") else ("", word)
    name, colon, value = bare.partition(":")
    if not colon:
        ends = {"flag": "", "number": "<"}
        offered = [f"{minus}{f.name}{ends.get(f.kind, ':')}" for f in fields if f.name.startswith(bare.lower())]
        return [*offered, *([f"{SORT}:"] if SORT.startswith(bare.lower()) else [])][:most]
    if name.lower() == SORT:
        down = "-" if value.startswith("-") else ""
        return [f"{SORT}:{down}{f.name}" for f in fields if f.name.startswith(value.removeprefix("-").lower())][:most]
    before, comma, last = value.rpartition(",")
    start = last.lstrip('"').lower()
    chosen = [f for f in fields if f.name == name.lower() and f.kind not in ("number", "words")]
    return [
        f"{minus}{name}:{before}{comma}{v}" for f in chosen for v in f.values if v.lstrip('"').lower().startswith(start)
    ][:most]


TRY = ("margin<0.1", "lucky:yes", "sort:margin")


def examples(facets: Sequence[Facet]) -> tuple[str, ...]:
    """Terms of a search to try: the most frequent class and relation, and a term of each other kind."""
    often = {f.name: max(f.values, key=lambda v: v.count).term for f in facets if f.name in ("class", "relation")}
    return (*(often[name] for name in ("class", "relation") if name in often), *TRY)


SHOWN = (
    "id",
    "frame",
    "text",
    "target",
    "relation",
    "reference",
    "verdict",
    "detail",
    "lucky",
    "said",
    "repair",
    "margin",
    "p_target",
    "p_reference",
    "p_relation",
    "object_distance",
    "box",
    "reference_box",
    "set_correct",
    MARKS,
    CHANGE,
    *(f"{SECOND}{name}" for name in SECOND_COLUMNS),
)
"""Columns of a row that is shown."""


def shown_columns(names: Sequence[str]) -> list[str]:
    """Columns that rows are shown by, of those that a run has."""
    return [name for name in dict.fromkeys((*SHOWN, *READ)) if name in names]


def shown_rows(records: pa.Table) -> list[dict[str, Any]]:
    """Rows as they are shown: SHOWN, with the `tone` and `head` of their stories."""
    rows = records.select(shown_columns(records.column_names)).to_pylist()
    found: list[dict[str, Any]] = []
    for row in rows:
        tone, head = row_head(row)
        found.append({name: value for name, value in row.items() if name in SHOWN} | {"tone": tone, "head": head})
    return found


def labelled_boxes(records: pa.Table, labels: Labels) -> np.ndarray:
    """(N, 2, 4) float64: the labelled target's and reference's box of each expression; x0, y0, x1, y1, pixels.

    Raises InputError: the labels are damaged, or not those of the run.
    """
    objects = read_table(labels.root / "objects.parquet", "objects", ["frame_index", "bbox"])
    frame = objects.column("frame_index").to_numpy()
    boxes = objects.column("bbox").combine_chunks().flatten().to_numpy(zero_copy_only=False).reshape(-1, 4)
    index = records.column("frame_index").to_numpy()
    ends = [records.column(name).to_numpy() for name in ("target_object", "reference_object")]
    # The records count the objects of a frame as the labels order them.
    at = np.searchsorted(frame, index)[:, None] + np.stack(ends, axis=1)
    known = (at < len(frame)) & (frame[np.minimum(at, len(frame) - 1)] == index[:, None])
    require(known.all(), "these are not the labels that the run was made with", path=labels.root)
    return boxes[at]


class RunRows:
    """The expressions of a run, by their numbers in its records.

    `records`, and `second` of a run to compare with: a table, or those of `open_records`, read as they are asked for.

    Raises InputError: the two have no expression in common, or the notes of the run cannot be read.
    """

    def __init__(self, records: Records, folder: Path, second: Records | None = None) -> None:
        self._bare = records if second is None else with_second(records, second)
        self._asked: Recent[Key, list[int]] = Recent(_ASKED)
        self.path = notes_path(folder)
        self.notes = read_notes(self.path)
        self.records = self._marked()
        self.stamp = 0
        """Another number after every mark."""

    def _marked(self) -> Records:
        marks = dict[int, list[str]]()
        for name in sorted(self.notes.marks):
            for row in self._numbers(self.notes.marks[name]):
                marks.setdefault(row, []).append(name)
        count = np.zeros(self._bare.num_rows + 1, np.int32)
        rows = sorted(marks)
        count[np.array(rows, np.int64) + 1] = [len(marks[row]) for row in rows]
        values = pa.array([name for row in rows for name in marks[row]], pa.string())
        return self._bare.append_column(
            MARKS, pa.ListArray.from_arrays(pa.array(np.cumsum(count, dtype=np.int32)), values)
        )

    @cached_property
    def _coded(self) -> dict[str, Coded]:
        return coded_columns(self.records)

    def _numbers(self, keys: Sequence[Key]) -> list[int]:
        """Rows of some expressions, by frame and id; those that the run does not have are left out."""
        if not keys:
            return []
        where = "(frame, id) IN (SELECT unnest(CAST(? AS VARCHAR[])), unnest(CAST(? AS VARCHAR[])))"
        given = [list(part) for part in zip(*keys, strict=True)]
        return rows_where(self._bare, where, given, ("frame", "id")).tolist()

    def keys(self, rows: np.ndarray) -> list[Key]:
        """(frame, id) of some rows."""
        columns = (column.to_pylist() for column in some_rows(self._bare, rows, ["frame", "id"]).columns)
        return list(zip(*columns, strict=True))

    def asked(self, frame: str, text: str) -> int | None:
        """First row of a frame with these words as its expression."""

        def find() -> list[int]:
            return rows_where(self._bare, "frame = ? AND text = ?", (frame, text), ("frame", "text")).tolist()

        return next(iter(self._asked.get((frame, text), find)), None)

    def number(self, frame: str, expression: str) -> int | None:
        """The row of an expression."""
        return next(iter(self._numbers([(frame, expression)])), None)

    def add_column(self, name: str, values: Sequence[Any]) -> None:
        """Add a column to search by."""
        self._bare = self._bare.append_column(name, pa.array(values))
        self.records = self._marked()

    def find(self, query: str) -> np.ndarray:
        """(F,) int64: rows of a search; InputError where the search cannot be read."""
        return find_rows(self.records, query)

    def facets(self, query: str) -> tuple[Facet, ...]:
        """Facets under a search; InputError where the search cannot be read."""
        return facets_of(self.records, query, self._coded)

    def read(self, rows: np.ndarray) -> list[dict[str, Any]]:
        """Read the columns of these rows for a list."""
        return shown_rows(some_rows(self.records, rows, shown_columns(self.records.column_names)))

    def filled(self, rows: np.ndarray, names: Iterable[str]) -> list[str]:
        """Columns of `names` that say something of any of these rows."""
        found = some_rows(self.records, rows, [n for n in names if n in self.records.column_names])
        empty = {n: c.null_count == len(c) for n, c in zip(found.column_names, found.columns, strict=True)}
        if MARKS in empty:
            empty[MARKS] = not any(found.column(MARKS).to_pylist())
        return [name for name, nothing in empty.items() if not nothing]

    @cached_property
    def widest_frame(self) -> int:
        """Characters of the longest id of a frame."""
        return max(map(len, self.frames[0]), default=0)

    @cached_property
    def frames(self) -> tuple[list[str], np.ndarray]:
        """Frames of the run, and (N,) int32: the frame of each row, a place among them."""
        coded = self._bare.column("frame").combine_chunks().dictionary_encode()
        return coded.dictionary.to_pylist(), coded.indices.to_numpy()

    def mark(self, rows: Iterable[int], name: str, on: bool = True) -> None:
        """Mark rows, or remove a mark; raises InputError as `run_notes.mark`."""
        self.notes = mark(self.path, self.keys(np.array(list(rows), np.int64)), name, on)
        self.records = self._marked()
        self._coded[MARKS] = _coded(self.records, _MARKS)
        self.stamp += 1

    def keep(self, name: str, query: str | None) -> None:
        """Keep a search under a name, or forget the search; raises InputError as `run_notes.keep_filter`."""
        self.notes = keep_filter(self.path, name, query)
