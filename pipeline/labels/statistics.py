"""What labels contain, in numbers: counts, balance, doubt, ambiguity, margins and wording.

SQL by DuckDB straight over the Parquet files, in memory that does not grow with them.
"""

from __future__ import annotations

import glob
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

import numpy as np

from pipeline.labels.reading import Labels, read_table
from pipeline.labels.schema import TABLES
from pipeline.system.errors import as_input_error, first_line
from pipeline.system.sql import bounded_database

if TYPE_CHECKING:
    import duckdb

DISTANCE_EDGES = (0, 1, 2, 3, 5)
"""Metres: where the bins of an object's distance begin; the last has no end."""
DISTANCE_BINS = ("0-1", "1-2", "2-3", "3-5", "5+", "unknown")
MARGIN_SHARES = (0.05, 0.25, 0.5, 0.75, 0.95)
FARTHEST_MM = 10_000
"""Margins beyond 10 m count as 10 m."""
OCCLUDED_FROM = 0.1
"""Share of its border from which on an object counts as occluded."""


def label_statistics(labels: Labels) -> dict[str, Any]:
    """Statistics of merged labels.

    Tables are scanned, never held: memory does not grow with the number of
    frames. Shares are 0..1, or None where there is nothing to take a share of;
    distances are metres.

    Returns
    -------
    dict
        JSON-able, with the keys

        counts : frames, frames_usable, scenes, objects, objects_usable,
            unusable ({reason: objects}), pairs, expressions, candidates
            (expressions before selection, None where the manifest does not say)
        up_source : {source: usable frames}
        cells : T, U, F over all pairs and relations, u_share, positives_per_pair
            (mean number of relations that hold), pairs_without_T, and
            pairs_without_T_share
        relations : {relation: T, U, F, u_share, T_per_pair, expressions,
            ambiguous, ambiguous_share}, in the order of PAIRWISE
        margins : {relation: {"T" and "F": None or n, p05, p25, p50, p75, p95}},
            metres, nearest rank, to the millimetre
        classes : {class: objects, usable, as_target, as_reference (expressions)},
            most frequent first
        distance : {bin of metres: objects, cells, u_share (of the relation cells
            in which such an object is the first), expressions (with such a
            target)}
        ambiguity : expressions, ambiguous, share, set_sizes ({number of acceptable
            objects: expressions})
        occlusion : objects, mean (share of an object's border), occluded (objects
            with a tenth or more), occluded_share, touching_border_share
        text : sentences (distinct), questions (distinct target, relation and
            reference), sentences_per_question (mean)

    Raises InputError: a table is missing, damaged, or of another schema.
    """
    relations = labels.relation_names
    with open_database(labels) as database:
        by_relation, cells = relation_counts(database, relations)
        return {
            "counts": database.row(
                "SELECT count(*) frames, count(*) FILTER (ok) frames_usable, count(DISTINCT scene) scenes FROM frames"
            )
            | database.row("SELECT count(*) objects, count(*) FILTER (usable) objects_usable FROM objects")
            | {"unusable": _counted(database, "coalesce(reason, 'unknown')", "objects WHERE NOT usable")}
            | database.row("SELECT count(*) pairs FROM relations")
            | database.row("SELECT count(*) expressions FROM expressions")
            | {"candidates": labels.manifest.counts.get("candidates")},
            "up_source": _counted(database, "coalesce(up_source, 'unknown')", "frames WHERE ok"),
            "cells": cells,
            "relations": by_relation,
            "margins": {name: _margins(database, name) for name in relations},
            "classes": _classes(database),
            "distance": _distances(database, relations),
            "ambiguity": _ambiguity(database),
            "occlusion": _occlusion(database),
            "text": _text(database),
        }


def share(part: int, whole: int) -> float | None:
    """part / whole to six digits, None of nothing."""
    return round(part / whole, 6) if whole else None


def _counted(database: Database, what: str, of: str) -> dict[str, int]:
    rows = database.rows(f"SELECT {what}, count(*) FROM {of} GROUP BY 1 ORDER BY 2 DESC, 1")
    return {str(name): int(count) for name, count in rows}


def relation_counts(database: Database, relations: tuple[str, ...]) -> tuple[dict[str, Any], dict[str, Any]]:
    """`relations` and `cells` of `label_statistics`."""
    columns = [quoted(name) for name in relations]
    tallies = ", ".join(f"count(*) FILTER ({c} = {state})" for c in columns for state in (1, 0, -1))
    # Of several nulls the greatest is null.
    most = f"coalesce(greatest({', '.join(columns)}), -1)"
    ((pairs, without, *cells),) = database.rows(
        f"SELECT count(*), count(*) FILTER ({most} < 1), {tallies} FROM relations"
    )
    asked = database.rows("SELECT relation, count(*), count(*) FILTER (ambiguous) FROM expressions GROUP BY 1")
    of = {relation: counts for relation, *counts in asked}
    table: Any = np.reshape(cells, (-1, 3))
    found = {
        name: _states(*states)
        | {"T_per_pair": share(states[0], pairs), "expressions": expressions, "ambiguous": ambiguous}
        | {"ambiguous_share": share(ambiguous, expressions)}
        for name, states, (expressions, ambiguous) in zip(
            relations, table.tolist(), (of.get(name, [0, 0]) for name in relations), strict=True
        )
    }
    t, u, f = table.sum(axis=0).tolist()
    return found, _states(t, u, f) | {
        "positives_per_pair": share(t, pairs),
        "pairs_without_T": without,
        "pairs_without_T_share": share(without, pairs),
    }


def _states(t: int, u: int, f: int) -> dict[str, Any]:
    return {"T": t, "U": u, "F": f, "u_share": share(u, t + u + f)}


def margin_counts(database: Database, relation: str) -> dict[str, np.ndarray]:
    """Histogram of a relation's margins.

    Returns "state" (N,) 1 or -1; "mm" (N,) int, millimetres, ascending within a state; "n" (N,) how many pairs.
    """
    state, margin = quoted(relation), quoted(f"{relation}_margin")
    # Counted by the millimetre: exact enough, in memory that does not grow, and the same in whatever order it is read.
    return database.columns(
        f"SELECT {state} AS state,"
        f" CAST(round(greatest(-{FARTHEST_MM}, least({FARTHEST_MM}, {margin} * 1000))) AS INTEGER) AS mm,"
        f" count(*) AS n FROM relations WHERE {state} IN (1, -1) AND {margin} IS NOT NULL GROUP BY ALL ORDER BY ALL"
    )


def _margins(database: Database, relation: str) -> dict[str, Any]:
    counted = margin_counts(database, relation)
    found: dict[str, Any] = {}
    for letter, state in (("T", 1), ("F", -1)):
        mm, n = (counted[column][counted["state"] == state] for column in ("mm", "n"))
        named = zip(MARGIN_SHARES, quantiles(mm, n, MARGIN_SHARES) if len(n) else (), strict=False)
        percentiles = {f"p{round(100 * q):02d}": value / 1000 for q, value in named}
        found[letter] = {"n": int(n.sum()), **percentiles} if len(n) else None
    return found


def _classes(database: Database) -> dict[str, dict[str, int]]:
    found: dict[str, dict[str, int]] = {}
    for count, of in (
        ("objects", "label"),
        ("usable", "label"),
        ("as_target", "target"),
        ("as_reference", "reference"),
    ):
        table = {"objects": "objects", "usable": "objects WHERE usable"}.get(count, "expressions")
        for name, number in _counted(database, of, table).items():
            empty = {"objects": 0, "usable": 0, "as_target": 0, "as_reference": 0}
            found.setdefault(name, empty)[count] = number
    return found


def _bin_of(distance: str) -> str:
    whens = [f"WHEN {distance} < {end} THEN {k}" for k, end in enumerate(DISTANCE_EDGES[1:])]
    last = len(DISTANCE_EDGES) - 1
    unknown = f"{distance} IS NULL OR NOT isfinite({distance})"
    return f"CASE WHEN {unknown} THEN {last + 1} {' '.join(whens)} ELSE {last} END"


def _distances(database: Database, relations: tuple[str, ...]) -> dict[str, dict[str, Any]]:
    columns = [quoted(name) for name in relations]
    cells = " + ".join(f"count(r.{c})" for c in columns)
    undecided = " + ".join(f"count(*) FILTER (r.{c} = 0)" for c in columns)
    joined = "r JOIN objects o ON r.frame_index = o.frame_index AND o.object"
    of_parts = {
        f"{cells}, {undecided} FROM relations {joined} = r.a": [1, 2],
        f"count(*) FROM expressions {joined} = r.target_object": [3],
    }
    # objects, cells, undecided cells, expressions
    table = np.zeros((len(DISTANCE_BINS), 4), np.int64)
    for k, count in database.rows(f"SELECT {_bin_of('distance')}, count(*) FROM objects GROUP BY 1"):
        table[k, 0] = count
    for first, last in database.frame_ranges():
        within = f"r.frame_index BETWEEN {first} AND {last} AND o.frame_index BETWEEN {first} AND {last}"
        for counted, of in of_parts.items():
            for k, *counts in database.rows(f"SELECT {_bin_of('o.distance')}, {counted} WHERE {within} GROUP BY 1"):
                table[k, of] += counts
    return {
        name: {"objects": objects, "cells": cells, "u_share": share(doubted, cells), "expressions": expressions}
        for name, (objects, cells, doubted, expressions) in zip(DISTANCE_BINS, table.tolist(), strict=True)
    }


def _ambiguity(database: Database) -> dict[str, Any]:
    sizes = database.rows(
        "SELECT len(acceptable), count(*), count(*) FILTER (ambiguous) FROM expressions GROUP BY 1 ORDER BY 1"
    )
    expressions, ambiguous = sum(row[1] for row in sizes), sum(row[2] for row in sizes)
    of_sizes = {"share": share(ambiguous, expressions), "set_sizes": {str(size): count for size, count, _ in sizes}}
    return {"expressions": expressions, "ambiguous": ambiguous, **of_sizes}


def _occlusion(database: Database) -> dict[str, Any]:
    # Summed as whole millionths, so that the order of reading cannot change the mean.
    ((n, hidden, occluded, cut),) = database.rows(
        "SELECT count(*), coalesce(sum(CASE WHEN isfinite(occluded)"
        " THEN CAST(round(occluded * 1e6) AS BIGINT) END), 0),"
        f" count(*) FILTER (occluded >= CAST({OCCLUDED_FROM} AS FLOAT)),"
        " count(*) FILTER (touches_border) FROM objects"
    )
    shares = {"occluded_share": share(occluded, n), "touching_border_share": share(cut, n)}
    return {"objects": n, "mean": share(int(hidden), n * 1_000_000), "occluded": occluded, **shares}


def _text(database: Database) -> dict[str, Any]:
    ((sentences, questions, wordings),) = database.rows(
        "SELECT (SELECT count(DISTINCT text) FROM expressions), count(*), coalesce(sum(n), 0) FROM"
        " (SELECT count(DISTINCT text) n FROM expressions GROUP BY target, relation, reference)"
    )
    each = share(int(wordings), questions)
    return {"sentences": sentences, "questions": questions, "sentences_per_question": each}


FRAMES_AT_ONCE = 20_000
"""Frames whose tables are joined in one query: rows lie in the order of frames, so that each query reads its own part
of the files, and no join has to hold a whole table."""


class Database:
    """Merged labels as the views "frames", "objects", "relations" and "expressions".

    Open it with `open_database`.
    """

    def __init__(self, connection: duckdb.DuckDBPyConnection, labels: Labels) -> None:
        self._connection = connection
        self._labels = labels

    def rows(self, sql: str, **values: Any) -> list[tuple[Any, ...]]:
        """All rows of a query; meant for the few rows of an aggregate.

        Raises InputError: a file turned out to be damaged.
        """
        return self._asked(sql, values).fetchall()

    def row(self, sql: str, **values: Any) -> dict[str, Any]:
        """The only row of an aggregate, by column."""
        found = self._asked(sql, values)
        return dict(zip([column[0] for column in found.description or ()], found.fetchall()[0], strict=True))

    def columns(self, sql: str, **values: Any) -> dict[str, np.ndarray]:
        """Columns of a query of numbers without nulls, as arrays."""
        return {name: np.asarray(column) for name, column in self._asked(sql, values).fetchnumpy().items()}

    def frame_ranges(self) -> Iterator[tuple[int, int]]:
        """(first, last) values of `frame_index`, FRAMES_AT_ONCE at a time: for queries with joins."""
        last = self.rows("SELECT max(frame_index) FROM frames")[0][0]
        for first in range(0, 0 if last is None else last + 1, FRAMES_AT_ONCE):
            yield first, first + FRAMES_AT_ONCE - 1

    def _asked(self, sql: str, values: dict[str, Any]) -> duckdb.DuckDBPyConnection:
        import duckdb

        damage = duckdb.IOException, duckdb.InvalidInputException, duckdb.ConversionException
        with as_input_error("the tables of the labels cannot be read", *damage, got=first_line, path=self._labels.root):
            return self._connection.execute(sql, values or None)


@contextmanager
def open_database(labels: Labels) -> Iterator[Database]:
    """Views over the four tables; the schema of each file is checked first.

    Raises InputError: a table is missing, damaged, of another schema, or lacks a column.
    """
    with bounded_database() as connection:
        add_views(connection, labels, TABLES)
        yield Database(connection, labels)


def add_views(connection: duckdb.DuckDBPyConnection, labels: Labels, tables: Iterable[str]) -> None:
    """Views over these tables of labels; raises as `open_database`."""
    for name in tables:
        path = labels.root / f"{name}.parquet"
        # No column is asked for: this reads the footer alone, and checks it.
        read_table(path, name, [])
        connection.read_parquet(glob.escape(str(path))).create_view(name)


def quoted(name: str) -> str:
    """A column's name in SQL: several relations are key words."""
    return '"' + name.replace('"', '""') + '"'


def quantiles(values: np.ndarray, counts: np.ndarray, shares: tuple[float, ...]) -> list[float]:
    """Nearest-rank quantiles of counted values.

    `values` (N,) array: ascending. `counts` (N,) int: how often each occurs; at least one in all. `shares`: 0..1; the
    quantile of q is the least value that at least a share q does not exceed.
    """
    upto = np.cumsum(counts, dtype=np.int64)
    # Rounded, lest 0.05 * 100 ask for the sixth of a hundred.
    ranks = np.maximum(np.ceil(np.round(np.asarray(shares) * upto[-1], 6)), 1)
    return [float(v) for v in values[np.searchsorted(upto, ranks)]]
