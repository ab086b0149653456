"""Accuracy and verdicts of parts of a run: by relation, class, distance and so on."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from pipeline.diagnosis.verdict import VERDICTS, shown_verdicts
from pipeline.evaluation.grounding_tables import clusters_of, coded_texts
from pipeline.evaluation.records_file import some_rows, text_codes
from pipeline.evaluation.search import quote
from pipeline.evaluation.summary import has_verdicts
from pipeline.language.relation_names import PAIRWISE, PHRASE
from pipeline.metrics.intervals import BootstrapConfig, Estimate, bootstrap, ratio
from pipeline.metrics.tables import Cell, Row, Table
from pipeline.system.arrow import pa, pc
from pipeline.system.errors import InputError
from pipeline.system.frozen import dataclass

if TYPE_CHECKING:
    from pipeline.evaluation.records_file import Records

UNKNOWN = "unknown"
MEASURES = ("set_correct", "correct", "lucky")
MOST_CELLS = 2**21
"""Clusters times values that are listed; of more those that meet are sorted, which takes longer and less memory."""


@dataclass(frozen=True)
class Dimension:
    """What a run is cut by."""

    name: str  # also the field of a search
    title: str
    column: str  # of the records
    edges: tuple[float, ...] = ()  # where the bins of a number begin; the last has no end. Empty for a text.
    unit: str = ""
    # order: texts by "count", by "name", or relations in their own order
    order: Literal["count", "name", "relation"] = "count"


DIMENSIONS: dict[str, Dimension] = {
    d.name: d
    for d in (
        Dimension("relation", "relation", "relation", order="relation"),
        Dimension("kind", "kind of sentence", "kind"),
        Dimension("class", "target class", "target"),
        Dimension("reference", "reference class", "reference"),
        Dimension("distance", "distance of the target", "object_distance", (0, 1, 2, 3, 5), "m"),
        Dimension("size", "longest edge of the target", "object_size", (0, 0.1, 0.2, 0.4, 0.8, 1.6), "m"),
        Dimension("occlusion", "hidden share of the target's border", "object_occluded", (0, 0.01, 0.1, 0.25, 0.5)),
        Dimension("same_class", "objects of the target's class", "same_class", (1, 2, 3, 4, 6)),
        Dimension("label_margin", "margin of the label", "label_margin", (0, 0.05, 0.1, 0.2, 0.4), "m"),
        Dimension("scene", "scene", "scene", order="name"),
        Dimension("frame", "frame", "frame", order="name"),
    )
}
"""All dimensions by name."""


@dataclass(frozen=True)
class Slice:
    """One part of a run."""

    system: str
    name: str
    # query: the search that finds just its expressions (`search.find_rows`); None for the others taken together
    query: str | None
    n: int
    # set_correct, correct: accuracy: set-valued, and of the labelled target alone
    set_correct: Estimate
    correct: Estimate
    lucky: Estimate | None  # share of CORRECT with a pair that is not acceptable; None without verdicts
    verdicts: dict[str, Estimate]  # shares of the slice, which sum to one; empty without verdicts
    counts: dict[str, int]  # expressions by verdict

    def record(self) -> dict[str, Any]:
        """Convert to JSON."""
        return {
            "system": self.system,
            "name": self.name,
            "query": self.query,
            "n": self.n,
            "set_correct": self.set_correct.record(),
            "correct": self.correct.record(),
            "lucky": None if self.lucky is None else self.lucky.record(),
            "verdicts": {v: {"count": self.counts[v], "share": e.record()} for v, e in self.verdicts.items()},
        }


@dataclass(frozen=True)
class Slices:
    """A run, or several, cut by one dimension."""

    dimension: Dimension
    slices: tuple[Slice, ...]  # system by system; those of one system hold each of its expressions once
    unit: str  # what intervals are drawn over

    def record(self) -> dict[str, Any]:
        """Convert to JSON."""
        d = self.dimension
        return {
            "dimension": d.name,
            "title": d.title,
            "edges": list(d.edges),
            "unit": d.unit,
            "clusters": self.unit,
            "slices": [s.record() for s in self.slices],
        }


FIGURE_COLUMNS = tuple(
    dict.fromkeys(
        (*MEASURES, "verdict", "detail", "right_with", "untold", "parse_ok", *(d.column for d in DIMENSIONS.values()))
    )
)
"""Columns of the records that summaries and slices are made of."""


def figure_rows(records: Records, rows: np.ndarray | None = None) -> pa.Table:
    """FIGURE_COLUMNS of all rows, or of some ((K,) int64)."""
    names = [name for name in FIGURE_COLUMNS if name in records.column_names]
    return some_rows(records, rows, names, coded=True)


def dimension_named(name: str) -> Dimension:
    """A dimension.

    Raises InputError: there is none of that name.
    """
    found = DIMENSIONS.get(name.strip().lower())
    if found is None:
        raise InputError("a run cannot be cut by this", got=repr(name), expected=f"one of {', '.join(DIMENSIONS)}")
    return found


def slice_by(
    systems: Mapping[str, Records],
    dimension: str | Dimension,
    config: BootstrapConfig | None = None,
    most: int | None = None,
) -> Slices:
    """Cut runs by one dimension.

    `systems`: records by system. `config`: intervals come from resamples of whole scenes (frames, where the run has one
    scene) among those in which a slice occurs: the same figures as of its rows alone. A slice of one scene has none.
    `most`: of texts only so many, the most frequent; the rest is one slice, "N others".

    Raises InputError: an unknown dimension, or a run that lacks its column.
    """
    cut = dimension_named(dimension) if isinstance(dimension, str) else dimension
    found: list[Slice] = []
    unit = "scene"
    for system, records in systems.items():
        if cut.column not in records.column_names:
            cause = "it was made by an older release; run `eval` again"
            raise InputError(f"the run {system} cannot be cut by {cut.name}", cause=cause)
        read = dict.fromkeys((*MEASURES, "verdict", "right_with", cut.column))
        rows = some_rows(records, None, [n for n in read if n in records.column_names], coded=True)
        clusters, unit = clusters_of(records)
        found += _sliced(system, rows, clusters, cut, config, most)
    return Slices(cut, tuple(found), unit)


def _sliced(
    system: str,
    records: pa.Table,
    index: np.ndarray,
    cut: Dimension,
    config: BootstrapConfig | None,
    most: int | None,
) -> list[Slice]:
    if not records.num_rows:
        return []
    judged = has_verdicts(records)
    found = coded(records, cut)
    values = len(found.parts)
    cell = index * values + found.code
    # Of many scenes and frames few meet.
    if (int(index.max()) + 1) * values > MOST_CELLS:
        meeting, cell = np.unique(cell, return_inverse=True)
    else:
        there = np.bincount(cell) > 0
        meeting, cell = np.flatnonzero(there), (np.cumsum(there) - 1)[cell]
    # (M, K): of each cluster and value that meet how many expressions, and how many of each kind.
    kinds = [np.bincount(cell, minlength=len(meeting))]
    kinds += [np.bincount(cell[_flag(records, m, judged)], minlength=len(meeting)) for m in MEASURES]
    of_verdicts = np.zeros((len(meeting), len(VERDICTS)), np.int64)
    if judged:
        names, verdict = coded_texts(records, "verdict")
        place = np.array([VERDICTS.index(v) if v in VERDICTS else len(VERDICTS) for v in names], np.int64)
        width = len(VERDICTS) + 1
        of_verdicts = np.bincount(cell * width + place[verdict], minlength=len(meeting) * width)
        of_verdicts = of_verdicts.reshape(-1, width)[:, :-1]
    sums = np.concatenate([np.stack(kinds, axis=1), of_verdicts], axis=1)
    cluster, value = np.divmod(meeting, values)
    by_value = np.argsort(value, kind="stable")
    ends = np.cumsum(np.bincount(value, minlength=values))
    own = [rows.astype(float) for rows in np.split(sums[by_value], ends[:-1])]
    counts = np.stack([rows.sum(axis=0) for rows in own])
    names, queries = [n for n, _ in found.parts], [q for _, q in found.parts]
    order = [k for k in range(values) if counts[k, 0]]
    if not cut.edges and cut.order == "count":
        order.sort(key=lambda k: (found.keys[k] is None, -counts[k, 0], names[k]))
    parts: list[tuple[str, str | None, np.ndarray]] = [(names[k], queries[k], own[k]) for k in order]
    if most is not None and not cut.edges and len(order) > most:
        ranked = sorted(order, key=lambda k: (-counts[k, 0], names[k]))
        kept, rest = set(ranked[:most]), ranked[most:]
        parts = [part for k, part in zip(order, parts, strict=True) if k in kept]
        left = np.isin(value, rest)
        together = np.zeros((int(index.max()) + 1, sums.shape[1]))
        np.add.at(together, cluster[left], sums[left])
        parts.append((f"{len(rest)} others", None, together))
    occurring = [v for v, n in zip(VERDICTS, counts[:, 1 + len(MEASURES) :].sum(axis=0), strict=True) if n]
    kinds = shown_verdicts(occurring) if judged else ()
    estimates = _estimates([rows for *_, rows in parts], config)
    return [_slice(system, *part, shares, kinds) for part, shares in zip(parts, estimates, strict=True)]


def _estimates(sums: Sequence[np.ndarray], config: BootstrapConfig | None) -> list[list[Estimate]]:
    """Estimate the K ratios of each slice's (C, 1 + K) sums, by resamples of the slice's clusters."""
    own = [rows[rows[:, 0] > 0] for rows in sums]
    found: list[list[Estimate]] = [[] for _ in own]
    # Of as many clusters the same are drawn.
    for clusters in dict.fromkeys(map(len, own)):
        alike = [k for k, rows in enumerate(own) if len(rows) == clusters]

        def ratios(total: np.ndarray) -> np.ndarray:
            return ratio(total[..., 1:], total[..., :1]).reshape(len(total), -1)

        together = np.stack([own[k] for k in alike], axis=1)
        shares, width = bootstrap(together, np.arange(clusters), ratios, config=config), together.shape[2] - 1
        for at, k in enumerate(alike):
            found[k] = shares[at * width : (at + 1) * width]
    return found


def _flag(records: pa.Table, measure: str, judged: bool) -> np.ndarray:
    """(N,) bool: null is not true, and nothing is lucky without verdicts."""
    if measure == "lucky" and not judged:
        return np.zeros(records.num_rows, np.bool_)
    return records.column(measure).cast("bool").combine_chunks().fill_null(False).to_numpy(zero_copy_only=False)


@dataclass(frozen=True)
class Coded:
    """A column as numbers: expression `row[k]`, or k itself, has value `code[k]`."""

    cut: Dimension
    # keys: values, or of a number its bins, in the order in which they are shown; unknown ones, None or -1, come last
    keys: list[Any]
    parts: tuple[tuple[str, str], ...]  # the name of each value, and the search that finds it
    row: np.ndarray | None  # (N,) int64; None where each expression has one value, in their order
    code: np.ndarray  # (N,) int, as narrow as the values allow: a long run has twenty of these

    def counts(self, chosen: np.ndarray) -> np.ndarray:
        """(V,) int64: how many of the chosen expressions ((N,) bool) have each value."""
        return np.bincount(self.code[chosen if self.row is None else chosen[self.row]], minlength=len(self.parts))


YES_NO = ("yes", "no")


def coded(records: Records, cut: Dimension, known: Sequence[str] = ()) -> Coded:
    """Code the values of a column; `known` values come first, an expression has several codes in a list column."""
    row = None
    column = some_rows(records, None, [cut.column], coded=True).column(0)
    if cut.edges:
        numbers = column.combine_chunks().cast("float64").to_numpy(zero_copy_only=False)
        # An edge means the number nearest to it that the column can hold, as in a search.
        code = np.searchsorted(np.array(cut.edges, np.float32).astype(np.float64), numbers, side="right")
        keys: list[Any] = [*range(len(cut.edges) + 1), -1]
        code = np.where(np.isnan(numbers), len(keys) - 1, code)
        return Coded(cut, keys, tuple(part_of(cut, k) for k in keys), row, code.astype(np.min_scalar_type(len(keys))))
    several = "list" in str(column.type)
    if several:
        lists = column.combine_chunks()
        row = np.repeat(np.arange(len(lists)), np.diff(lists.offsets.to_numpy()))
        column = pa.chunked_array([lists.flatten()])
    elif str(column.type) == "bool":
        column = pc.if_else(column, *YES_NO)  # pyright: ignore[reportAttributeAccessIssue]
    keys, codes = text_codes(column)
    rank = {name: k for k, name in enumerate(known or (PAIRWISE if cut.order == "relation" else ()))}
    order = sorted(range(len(keys)), key=lambda k: (keys[k] is None, rank.get(keys[k], len(rank)), str(keys[k])))
    place = np.argsort(order).astype(np.min_scalar_type(len(order)))[codes]
    operator = ":" if several or known else "="
    parts = tuple(part_of(cut, keys[k], operator) for k in order)
    return Coded(cut, [keys[k] for k in order], parts, row, place)


def part_of(cut: Dimension, key: Any, operator: str = "=") -> tuple[str, str]:
    """Name of a value, and the search for the value's expressions."""
    if key is None or (cut.edges and key < 0):
        return UNKNOWN, f"{cut.name}:none"
    if cut.order == "relation":
        return str(PHRASE.get(key, key)), f"{cut.name}:{key}"
    if not cut.edges:
        return str(key), f"{cut.name}{operator}{quote(key)}"
    unit, bounds = f" {cut.unit}" if cut.unit else "", (None, *cut.edges, None)
    low, high = bounds[key], bounds[key + 1]
    if low is None:
        return f"< {high:g}{unit}", f"{cut.name}<{high:g}"
    if high is None:
        return f"{low:g}+{unit}", f"{cut.name}>={low:g}"
    # Counts of objects are whole.
    last = high - 1 if cut.column == "same_class" else high
    return f"{low:g}" if low == last else f"{low:g}-{last:g}{unit}", f"{cut.name}>={low:g} {cut.name}<{high:g}"


def _slice(
    system: str,
    name: str,
    query: str | None,
    sums: np.ndarray,
    found: Sequence[Estimate],
    kinds: Sequence[str],
) -> Slice:
    count, *numbers = sums.sum(axis=0).astype(int).tolist()
    shares, first = [replace(e, n=count) for e in found], len(MEASURES)
    of_verdicts = [(v, e, n) for v, e, n in zip(VERDICTS, shares[first:], numbers[first:], strict=True) if v in kinds]
    return Slice(
        system,
        name,
        query,
        count,
        shares[0],
        shares[1],
        shares[2] if kinds else None,
        {v: e for v, e, _ in of_verdicts},
        {v: n for v, _, n in of_verdicts},
    )


def slice_table(found: Slices, intervals: bool = True) -> Table:
    """Format slices as a table of accuracies and verdict shares, bare without `intervals`."""
    shown = [v for v in VERDICTS if any(s.counts.get(v) for s in found.slices)]
    several = len({s.system for s in found.slices}) > 1
    rows = []
    for s in found.slices:
        cells: list[Cell] = [s.n, s.set_correct, s.correct]
        shares = [s.verdicts.get(v) for v in shown]
        cells += shares if intervals else [None if e is None else e.value for e in shares]
        rows.append(Row(f"{s.system}: {s.name}" if several else s.name, tuple(cells)))
    d = found.dimension
    edges = f"Bins begin at {', '.join(f'{e:g}' for e in d.edges)}{f' {d.unit}' if d.unit else ''}. " if d.edges else ""
    return Table(
        f"slice-{d.name}",
        f"By {d.title}",
        ("n", "set-valued", "single truth", *shown),
        tuple(rows),
        f"Percent of the n expressions of each row. {edges}Verdicts of a row sum to 100. Brackets: 95 % bootstrap "
        f"intervals over {found.unit}s; a row within one {found.unit} has none.",
    )
