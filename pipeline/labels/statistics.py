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
from pipeline.system.errors import InputError
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

    Raises
    ------
    InputError
        A table is missing, damaged, or of another schema.
    """
    relations = labels.relation_names
    with open_database(labels) as database:
        counts = _counts(database)
        counts["candidates"] = labels.manifest.counts.get("candidates")
        by_relation, cells = _relations(database, relations)
        return {
            "counts": counts,
            "up_source": _pairs_of(
                database,
                "SELECT coalesce(up_source, 'unknown'), count(*) FROM frames WHERE ok GROUP BY 1 ORDER BY 2 DESC, 1",
            ),
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


def _pairs_of(database: Database, sql: str) -> dict[str, int]:
    return {str(name): int(count) for name, count in database.rows(sql)}


def _counts(database: Database) -> dict[str, Any]:
    return {
        **database.row("SELECT count(*) frames, count(*) FILTER (ok) frames_usable FROM frames"),
        **database.row("SELECT count(DISTINCT scene) scenes FROM frames"),
        **database.row("SELECT count(*) objects, count(*) FILTER (usable) objects_usable FROM objects"),
        "unusable": _pairs_of(
            database,
            "SELECT coalesce(reason, 'unknown'), count(*) FROM objects WHERE NOT usable GROUP BY 1 ORDER BY 2 DESC, 1",
        ),
        **database.row("SELECT count(*) pairs FROM relations"),
        **database.row("SELECT count(*) expressions FROM expressions"),
    }


def _relations(database: Database, relations: tuple[str, ...]) -> tuple[dict[str, Any], dict[str, Any]]:
    asked = {
        str(name): (int(count), int(ambiguous))
        for name, count, ambiguous in database.rows(
            "SELECT relation, count(*), count(*) FILTER (ambiguous) FROM expressions GROUP BY 1"
        )
    }
    columns = [quoted(name) for name in relations]
    tallies = ", ".join(f"count(*) FILTER ({c} = {state})" for c in columns for state in (1, 0, -1))
    # Of several nulls the greatest is null.
    most = f"coalesce(greatest({', '.join(columns)}), -1)"
    ((pairs, without, *cells),) = database.rows(
        f"SELECT count(*), count(*) FILTER ({most} < 1), {tallies} FROM relations"
    )
    found = {}
    for name, (t, u, f) in zip(relations, np.reshape(cells, (-1, 3)).tolist(), strict=True):
        expressions, ambiguous = asked.get(name, (0, 0))
        found[name] = {
            "T": t,
            "U": u,
            "F": f,
            "u_share": share(u, t + u + f),
            "T_per_pair": share(t, pairs),
            "expressions": expressions,
            "ambiguous": ambiguous,
            "ambiguous_share": share(ambiguous, expressions),
        }
    t, u, f = (sum(entry[state] for entry in found.values()) for state in ("T", "U", "F"))
    return found, {
        "T": t,
        "U": u,
        "F": f,
        "u_share": share(u, t + u + f),
        "positives_per_pair": share(t, pairs),
        "pairs_without_T": without,
        "pairs_without_T_share": share(without, pairs),
    }


def margin_counts(database: Database, relation: str) -> dict[str, np.ndarray]:
    """How often a relation has which margin.

    Returns
    -------
    dict
        "state" (N,) 1 or -1; "mm" (N,) int, millimetres, ascending within a
        state; "n" (N,) how many pairs.
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
        rows = counted["state"] == state
        n, found[letter] = counted["n"][rows], None
        if len(n):
            named = {
                f"p{round(100 * q):02d}": mm / 1000
                for q, mm in zip(MARGIN_SHARES, quantiles(counted["mm"][rows], n, MARGIN_SHARES), strict=True)
            }
            found[letter] = {"n": int(n.sum()), **named}
    return found


def _classes(database: Database) -> dict[str, dict[str, int]]:
    found = {
        str(name): {"objects": int(objects), "usable": int(usable), "as_target": 0, "as_reference": 0}
        for name, objects, usable in database.rows(
            "SELECT label, count(*), count(*) FILTER (usable) FROM objects GROUP BY 1 ORDER BY 2 DESC, 1"
        )
    }
    for role in ("target", "reference"):
        for name, count in database.rows(f"SELECT {role}, count(*) FROM expressions GROUP BY 1 ORDER BY 2 DESC, 1"):
            empty = {"objects": 0, "usable": 0, "as_target": 0, "as_reference": 0}
            found.setdefault(str(name), empty)[f"as_{role}"] = int(count)
    return found


def _bin_of(distance: str) -> str:
    whens = [f"WHEN {distance} < {end} THEN {k}" for k, end in enumerate(DISTANCE_EDGES[1:])]
    last = len(DISTANCE_EDGES) - 1
    unknown = f"{distance} IS NULL OR NOT isfinite({distance})"
    return f"CASE WHEN {unknown} THEN {last + 1} {' '.join(whens)} ELSE {last} END"


def _distances(database: Database, relations: tuple[str, ...]) -> dict[str, dict[str, Any]]:
    # objects, cells, undecided cells, expressions
    table = np.zeros((len(DISTANCE_BINS), 4), np.int64)
    for k, count in database.rows(f"SELECT {_bin_of('distance')}, count(*) FROM objects GROUP BY 1"):
        table[k, 0] = count
    columns = [quoted(name) for name in relations]
    cells = " + ".join(f"count(r.{c})" for c in columns)
    undecided = " + ".join(f"count(*) FILTER (r.{c} = 0)" for c in columns)
    for first, last in database.frame_ranges():
        within = "{0}.frame_index BETWEEN $first AND $last AND o.frame_index BETWEEN $first AND $last"
        for k, some, doubted in database.rows(
            f"SELECT {_bin_of('o.distance')}, {cells}, {undecided} FROM relations r"
            f" JOIN objects o ON o.frame_index = r.frame_index AND o.object = r.a"
            f" WHERE {within.format('r')} GROUP BY 1",
            first=first,
            last=last,
        ):
            table[k, 1:3] += (some, doubted)
        for k, count in database.rows(
            f"SELECT {_bin_of('o.distance')}, count(*) FROM expressions e"
            f" JOIN objects o ON o.frame_index = e.frame_index AND o.object = e.target_object"
            f" WHERE {within.format('e')} GROUP BY 1",
            first=first,
            last=last,
        ):
            table[k, 3] += count
    return {
        name: {"objects": objects, "cells": cells, "u_share": share(doubted, cells), "expressions": expressions}
        for name, (objects, cells, doubted, expressions) in zip(DISTANCE_BINS, table.tolist(), strict=True)
    }


def _ambiguity(database: Database) -> dict[str, Any]:
    sizes = database.rows(
        "SELECT len(acceptable), count(*), count(*) FILTER (ambiguous) FROM expressions GROUP BY 1 ORDER BY 1"
    )
    expressions, ambiguous = sum(row[1] for row in sizes), sum(row[2] for row in sizes)
    return {
        "expressions": expressions,
        "ambiguous": ambiguous,
        "share": share(ambiguous, expressions),
        "set_sizes": {str(size): count for size, count, _ in sizes},
    }


def _occlusion(database: Database) -> dict[str, Any]:
    found = database.row(
        # Summed as whole millionths, so that the order of reading cannot change the mean.
        "SELECT count(*) n, coalesce(sum(CASE WHEN isfinite(occluded)"
        " THEN CAST(round(occluded * 1e6) AS BIGINT) END), 0) occluded_sum,"
        f" count(*) FILTER (occluded >= CAST({OCCLUDED_FROM} AS FLOAT)) occluded,"
        " count(*) FILTER (touches_border) cut FROM objects"
    )
    n = found["n"]
    return {
        "objects": n,
        "mean": share(int(found["occluded_sum"]), n * 1_000_000),
        "occluded": found["occluded"],
        "occluded_share": share(found["occluded"], n),
        "touching_border_share": share(found["cut"], n),
    }


def _text(database: Database) -> dict[str, Any]:
    sentences = database.rows("SELECT count(DISTINCT text) FROM expressions")[0][0]
    questions, wordings = database.rows(
        "SELECT count(*), coalesce(sum(n), 0) FROM"
        " (SELECT count(DISTINCT text) n FROM expressions GROUP BY target, relation, reference)"
    )[0]
    return {
        "sentences": sentences,
        "questions": questions,
        "sentences_per_question": share(int(wordings), questions),
    }


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

        Raises
        ------
        InputError
            A file turned out to be damaged.
        """
        with self._plain_errors():
            return self._connection.execute(sql, values or None).fetchall()

    def row(self, sql: str, **values: Any) -> dict[str, Any]:
        """The only row of an aggregate, by column."""
        with self._plain_errors():
            found = self._connection.execute(sql, values or None)
            (only,) = found.fetchall()
            return dict(zip([column[0] for column in found.description or ()], only, strict=True))

    def columns(self, sql: str, **values: Any) -> dict[str, np.ndarray]:
        """All rows of a query whose columns hold numbers without nulls, as arrays."""
        with self._plain_errors():
            found = self._connection.execute(sql, values or None).fetchnumpy()
        return {name: np.asarray(column) for name, column in found.items()}

    def frame_ranges(self) -> Iterator[tuple[int, int]]:
        """(first, last) values of `frame_index`, FRAMES_AT_ONCE at a time: for queries that join tables."""
        last = self.rows("SELECT max(frame_index) FROM frames")[0][0]
        for first in range(0, 0 if last is None else last + 1, FRAMES_AT_ONCE):
            yield first, first + FRAMES_AT_ONCE - 1

    @contextmanager
    def _plain_errors(self) -> Iterator[None]:
        import duckdb

        try:
            yield
        except (duckdb.IOException, duckdb.InvalidInputException, duckdb.ConversionException) as error:
            reason = str(error).split("\n")[0]
            raise InputError("the tables of the labels cannot be read", got=reason, path=self._labels.root) from error


@contextmanager
def open_database(labels: Labels) -> Iterator[Database]:
    """Views over the four tables; the schema of each file is checked first.

    Raises
    ------
    InputError
        A table is missing, damaged, of another schema, or lacks a column.
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

    Parameters
    ----------
    values : (N,) array
        Ascending.
    counts : (N,) int
        How often each occurs; at least one in all.
    shares : tuple of float
        0..1; the quantile of q is the least value that at least a share q does not exceed.
    """
    upto = np.cumsum(counts, dtype=np.int64)
    # Rounded, lest 0.05 * 100 ask for the sixth of a hundred.
    ranks = np.maximum(np.ceil(np.round(np.asarray(shares) * upto[-1], 6)), 1)
    return [float(v) for v in values[np.searchsorted(upto, ranks)]]
