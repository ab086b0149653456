"""Accuracy and verdicts of parts of a run: by relation, class, distance and so on."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np

from pipeline.diagnosis.verdict import VERDICTS, shown_verdicts
from pipeline.evaluation.grounding_tables import clusters_of
from pipeline.evaluation.search_words import quote
from pipeline.evaluation.summary import has_verdicts
from pipeline.language.relation_names import PAIRWISE, PHRASE
from pipeline.metrics.intervals import BootstrapConfig, Estimate, bootstrap, ratio
from pipeline.metrics.tables import Cell, Row, Table
from pipeline.system.arrow import pa
from pipeline.system.errors import InputError

UNKNOWN = "unknown"
MEASURES = ("set_correct", "correct", "lucky")


@dataclass(frozen=True)
class Dimension:
    """What a run is cut by.

    Attributes
    ----------
    name : str
        Also the field of a search.
    title : str
    column : str
        Of the records; "" for the system.
    edges : tuple of float
        Where the bins of a number begin; the last has no end. Empty for a text.
    unit : str
    order : str
        Texts by "count", by "name", or relations in their own order.
    """

    name: str
    title: str
    column: str
    edges: tuple[float, ...] = ()
    unit: str = ""
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
        Dimension("system", "system", ""),
    )
}
"""All dimensions by name."""


@dataclass(frozen=True)
class Slice:
    """One part of a run.

    Attributes
    ----------
    system, name : str
    query : str or None
        The search that finds just its expressions (`search.find_rows`); None for the others taken together.
    n : int
    set_correct, correct : Estimate
        Accuracy: set-valued, and of the labelled target alone.
    lucky : Estimate or None
        Share of CORRECT with a pair that is not acceptable; None without verdicts.
    verdicts : dict of str to Estimate
        Shares of the slice, which sum to one; empty without verdicts.
    counts : dict of str to int
        Expressions by verdict.
    """

    system: str
    name: str
    query: str | None
    n: int
    set_correct: Estimate
    correct: Estimate
    lucky: Estimate | None
    verdicts: dict[str, Estimate]
    counts: dict[str, int]

    def record(self) -> dict[str, Any]:
        """As JSON."""
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
    """A run, or several, cut by one dimension.

    Attributes
    ----------
    dimension : Dimension
    slices : tuple of Slice
        System by system; those of one system hold each of its expressions once.
    unit : str
        What intervals are drawn over.
    """

    dimension: Dimension
    slices: tuple[Slice, ...]
    unit: str

    def record(self) -> dict[str, Any]:
        """As JSON."""
        d = self.dimension
        return {
            "dimension": d.name,
            "title": d.title,
            "edges": list(d.edges),
            "unit": d.unit,
            "clusters": self.unit,
            "slices": [s.record() for s in self.slices],
        }


def dimension_named(name: str) -> Dimension:
    """A dimension.

    Raises
    ------
    InputError
        There is none of that name.
    """
    found = DIMENSIONS.get(name.strip().lower())
    if found is None:
        raise InputError("a run cannot be cut by this", got=repr(name), expected=f"one of {', '.join(DIMENSIONS)}")
    return found


def slice_by(
    systems: Mapping[str, pa.Table],
    dimension: str | Dimension,
    config: BootstrapConfig | None = None,
    most: int | None = None,
) -> Slices:
    """Cut runs by one dimension.

    Parameters
    ----------
    systems : mapping of str to pyarrow.Table
        Records by system.
    dimension : str or Dimension
    config : BootstrapConfig, optional
        Intervals come from resamples of whole scenes (frames, where the run has one scene) among those in which a
        slice occurs: the same figures as of its rows alone. A slice of one scene has none.
    most : int, optional
        Of texts only so many, the most frequent; the rest is one slice, "N others".

    Raises
    ------
    InputError
        An unknown dimension, or a run that lacks its column.
    """
    cut = dimension_named(dimension) if isinstance(dimension, str) else dimension
    found: list[Slice] = []
    unit = "scene"
    for system, records in systems.items():
        if cut.column and cut.column not in records.column_names:
            cause = "it was made by an older release; run `eval` again"
            raise InputError(f"the run {system} cannot be cut by {cut.name}", cause=cause)
        clusters, unit = clusters_of(records)
        found += _sliced(system, records, clusters, cut, config, most)
    return Slices(cut, tuple(found), unit)


def _sliced(
    system: str,
    records: pa.Table,
    clusters: np.ndarray,
    cut: Dimension,
    config: BootstrapConfig | None,
    most: int | None,
) -> list[Slice]:
    if not records.num_rows:
        return []
    judged = has_verdicts(records)
    keys, names, queries, sums = _sums(system, records, clusters, cut, judged)
    # (C, V, M): of each cluster and value how many expressions, and how many of each kind.
    counts = sums.sum(axis=0)
    order = _order(cut, keys, names, counts[:, 0])
    if most is not None and not cut.edges and len(order) > most:
        ranked = sorted(order, key=lambda k: (-counts[k, 0], names[k]))
        kept, rest = [k for k in order if k in set(ranked[:most])], ranked[most:]
        sums = np.concatenate([sums, sums[:, rest].sum(axis=1, keepdims=True)], axis=1)
        counts = sums.sum(axis=0)
        names, queries = [*names, f"{len(rest)} others"], [*queries, None]
        order = [*kept, len(names) - 1]
    occurring = [v for v, n in zip(VERDICTS, counts[:, 1 + len(MEASURES) :].sum(axis=0), strict=True) if n]
    kinds = shown_verdicts(occurring) if judged else ()
    return [_slice(system, names[k], queries[k], counts[k], _estimates(sums[:, k], config), kinds) for k in order]


def _sums(
    system: str, records: pa.Table, clusters: np.ndarray, cut: Dimension, judged: bool
) -> tuple[list[Any], list[str], list[str | None], np.ndarray]:
    """Values, their names and searches, and (C, V, 1 + measures + verdicts) float64 sums by cluster."""
    _, index = np.unique(clusters, return_inverse=True)
    keys, place = _parts(records, cut)
    none = np.zeros(records.num_rows, np.bool_)
    flags = [_is_true(records.column(m)) if judged or m != "lucky" else none for m in MEASURES]
    said = records.column("verdict").to_numpy(zero_copy_only=False) if judged else None
    flags += [none if said is None else said == v for v in VERDICTS]
    count = int(index.max()) + 1
    # One cell for each cluster and value, counted over all rows and over those with each flag.
    cell = index * len(keys) + place
    sums = [np.bincount(cell, flag, count * len(keys)) for flag in (None, *flags)]
    parts = [part_of(cut, key, system) for key in keys]
    found = np.stack(sums, axis=1).reshape(count, len(keys), len(sums)).astype(np.float64)
    return keys, [name for name, _ in parts], [query for _, query in parts], found


def _is_true(flags: pa.ChunkedArray) -> np.ndarray:
    """(N,) bool: null is not true."""
    return flags.fill_null(False).to_numpy(zero_copy_only=False).astype(np.bool_)


def _parts(records: pa.Table, cut: Dimension) -> tuple[list[Any], np.ndarray]:
    """The values that occur, in order, the unknown one last, and the index of that of each row: (N,) int64.

    Of numbers the value is the bin, -1 for unknown ones.
    """
    if not cut.column:
        return [""], np.zeros(records.num_rows, np.int64)
    column = records.column(cut.column)
    if cut.edges:
        # An edge means the number nearest to it that the column can hold, as in a search.
        edges = np.array(cut.edges, np.float32).astype(np.float64)
        numbers = column.cast("float64").fill_null(np.nan).to_numpy(zero_copy_only=False)
        bins = np.where(np.isnan(numbers), -1, np.searchsorted(edges, numbers, side="right"))
        keys, place = np.unique(bins, return_inverse=True)
        return keys.tolist(), place
    coded = column.cast("string").combine_chunks().dictionary_encode()
    values = coded.dictionary.to_pylist()
    order = sorted(range(len(values)), key=values.__getitem__)
    rank = np.empty(len(values) + 1, np.int64)
    rank[[*order, -1]] = np.arange(len(values) + 1)
    place = rank[coded.indices.fill_null(len(values)).to_numpy(zero_copy_only=False)]
    return [*(values[k] for k in order), *([None] if column.null_count else [])], place


def part_of(cut: Dimension, key: Any, system: str) -> tuple[str, str]:
    """The name of a value, and the search that finds it."""
    if not cut.column:
        return system, ""
    if key is None or (cut.edges and key < 0):
        return UNKNOWN, f"{cut.name}:none"
    if cut.order == "relation":
        return str(PHRASE.get(key, key)), f"{cut.name}:{key}"
    if not cut.edges:
        return str(key), f"{cut.name}={quote(key)}"
    unit, bounds = f" {cut.unit}" if cut.unit else "", (None, *cut.edges, None)
    low, high = bounds[key], bounds[key + 1]
    if low is None:
        return f"< {high:g}{unit}", f"{cut.name}<{high:g}"
    if high is None:
        return f"{low:g}+{unit}", f"{cut.name}>={low:g}"
    # Counts of objects are whole.
    last = high - 1 if cut.column == "same_class" else high
    return f"{low:g}" if low == last else f"{low:g}-{last:g}{unit}", f"{cut.name}>={low:g} {cut.name}<{high:g}"


def _order(cut: Dimension, keys: Sequence[Any], names: Sequence[str], counts: np.ndarray) -> list[int]:
    """Indices of the values as they are shown; the unknown one comes last."""
    if cut.edges:
        return sorted(range(len(keys)), key=lambda k: keys[k] if keys[k] >= 0 else len(cut.edges) + 1)
    rank = {r: k for k, r in enumerate(PAIRWISE)}
    by = {"relation": lambda k: rank.get(keys[k], len(rank)), "name": lambda k: 0, "count": lambda k: -counts[k]}
    return sorted(range(len(keys)), key=lambda k: (keys[k] is None, by[cut.order](k), names[k]))


def _estimates(sums: np.ndarray, config: BootstrapConfig | None) -> list[Estimate]:
    """Of one value's (C, 1 + K) sums the K ratios, by resamples of the clusters that it occurs in."""
    own = sums[sums[:, 0] > 0]
    found = bootstrap(own, np.arange(len(own)), lambda total: ratio(total[:, 1:], total[:, :1]), config=config)
    return [replace(e, n=int(own[:, 0].sum())) for e in found]


def _slice(
    system: str, name: str, query: str | None, counts: np.ndarray, own: list[Estimate], kinds: Sequence[str]
) -> Slice:
    first = len(MEASURES)
    shares = dict(zip(VERDICTS, own[first:], strict=True))
    numbers = dict(zip(VERDICTS, counts[1 + first :].astype(int).tolist(), strict=True))
    return Slice(
        system,
        name,
        query,
        int(counts[0]),
        own[0],
        own[1],
        own[2] if kinds else None,
        {v: shares[v] for v in kinds},
        {v: numbers[v] for v in kinds},
    )


def slice_table(found: Slices, intervals: bool = True) -> Table:
    """Slices as a table: accuracies, and the share of every verdict that occurs, without `intervals` as bare shares."""
    shown = [v for v in VERDICTS if any(s.counts.get(v) for s in found.slices)]
    several = len({s.system for s in found.slices}) > 1 and found.dimension.column
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
