"""Which relation was asked, and in which the answer really stands."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from pipeline.evaluation.records_file import some_rows, text_codes
from pipeline.labels.reading import Labels
from pipeline.labels.statistics import add_views, quoted
from pipeline.language.relation_names import PAIRWISE, PHRASE
from pipeline.metrics.tables import Row, Table
from pipeline.relations.relations import F, T, U
from pipeline.system.errors import InputError, require
from pipeline.system.frozen import dataclass
from pipeline.system.sql import bounded_database

if TYPE_CHECKING:
    from pipeline.evaluation.records_file import Records

UNDECIDED, NOTHING, UNJUDGED, UNLABELLED, NO_ANSWER = "in doubt", "none", "not judged", "no such objects", "no answer"
OTHERS = (UNDECIDED, NOTHING, UNJUDGED, UNLABELLED, NO_ANSWER)


@dataclass(frozen=True)
class Confusion:
    """Counts of what was meant against what came."""

    key: str
    title: str
    # rows, columns: relations that were meant; relations, and other outcomes, that came
    rows: tuple[str, ...]
    columns: tuple[str, ...]
    # counts (R, C) int64: each expression, or each relation of a pair, stands in one cell: a row sums to all of its
    # relation
    counts: np.ndarray
    note: str  # the rule by which a cell is chosen

    def record(self) -> dict[str, Any]:
        """Convert to JSON."""
        return {
            "title": self.title,
            "rows": list(self.rows),
            "columns": list(self.columns),
            "counts": self.counts.tolist(),
            "note": self.note,
        }

    def table(self) -> Table:
        """Format as a table of counts."""
        rows = tuple(
            Row(PHRASE.get(name, name), (*map(int, line), int(line.sum())))
            for name, line in zip(self.rows, self.counts, strict=True)
        )
        heads = tuple(PHRASE.get(c, c) for c in self.columns)
        return Table(self.key, self.title, (*heads, "sum"), rows, self.note)


@dataclass(frozen=True)
class Standings:
    """In which relation the answer of each expression stands."""

    names: tuple[str, ...]  # the relations of the labels
    meant: np.ndarray  # (E,) int64: which of `names` was asked
    cell: np.ndarray  # (E,) int64: which of `columns` the answer stands in

    @property
    def columns(self) -> tuple[str, ...]:
        """The relations, then the other outcomes."""
        return (*self.names, *OTHERS)

    def take(self, rows: np.ndarray) -> Standings:
        """The same of some expressions."""
        return replace(self, meant=self.meant[rows], cell=self.cell[rows])

    def column(self) -> list[str]:
        """The outcome of each expression as a text, for a search."""
        columns = self.columns
        return [columns[k] for k in self.cell.tolist()]


def answer_standings(records: Records, labels: Labels, content_hash: str | None = None) -> Standings:
    """Relation between the two objects of each answer by their labels; see `count_standings`.

    `labels`: the labels that the run was made with. `content_hash`: of their expressions when the run was made; other
    labels are refused.

    Raises InputError: the labels are damaged, or not those of the run.
    """
    require(
        content_hash is None or labels.manifest.tables["expressions"].content_hash == content_hash,
        "these are not the labels that the run was made with",
        path=labels.root,
    )
    names = tuple(r for r in PAIRWISE if r in labels.relation_names)
    asked, meant = text_codes(some_rows(records, None, ["relation"], coded=True).column(0))
    for name in sorted(map(str, asked)):
        require(name in names, "the run asks for a relation that the labels do not have", got=name, path=labels.root)
    index, states, margins = _pairs_of_answers(records, labels, names)
    answered = records.column("box").is_valid().to_numpy(zero_copy_only=False)
    matched = np.ones(records.num_rows, np.bool_)
    for name in ("matched_target", "matched_reference"):
        matched &= records.column(name).is_valid().to_numpy(zero_copy_only=False)
    other = {name: len(names) + k for k, name in enumerate(OTHERS)}
    meant = np.array([names.index(str(r)) for r in asked], np.int64)[meant]
    cell = np.full(records.num_rows, other[NO_ANSWER], np.int64)
    cell[answered] = other[UNLABELLED]
    cell[answered & matched] = other[UNJUDGED]
    cell[index] = stands_in(states, margins, meant[index], other[UNDECIDED], other[NOTHING])
    return Standings(names, meant, cell)


def count_standings(found: Standings) -> Confusion:
    """Count expressions by asked and by standing relation."""
    counts = np.zeros((len(found.names), len(found.columns)), np.int64)
    np.add.at(counts, (found.meant, found.cell), 1)
    return Confusion(
        "confusion",
        "The relation that was asked, and the one in which the answer stands",
        found.names,
        found.columns,
        counts,
        "Expressions. The diagonal: the labels say that the asked relation holds of the answer's two objects; in "
        "doubt: that it may. Else the pair stands in the column of the relation that holds of it by the largest "
        f"margin, or under “{NOTHING}”. “{UNJUDGED}”: a pair without labels; “{UNLABELLED}”: target or reference is no "
        "labelled object of the class that was asked. A row sums to all expressions of its relation.",
    )


def stands_in(states: np.ndarray, margins: np.ndarray, meant: np.ndarray, undecided: int, nothing: int) -> np.ndarray:
    """Column of each pair: the meant relation if true, `undecided` if in doubt, else the clearest other relation.

    `states` (P, R) int8: 1 holds, 0 in doubt, -1 does not hold. `margins` (P, R) float: NaN counts as 0; of equal ones
    the first wins. `meant` (P,) int: column of the relation that was asked. `doubt`, `nothing`: columns where the asked
    one is in doubt, and where none holds.

    Returns (P,) int64.
    """
    every = np.arange(len(meant))
    held = np.where(states == T, np.nan_to_num(np.asarray(margins, np.float64)), -np.inf)
    clearest = np.where((states == T).any(axis=1), held.argmax(axis=1) if held.size else 0, nothing)
    own = states[every, meant]
    return np.where(own == T, meant, np.where(own == U, undecided, clearest)).astype(np.int64)


def _pairs_of_answers(
    records: Records, labels: Labels, names: tuple[str, ...]
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(P,) rows of answers with a judged pair, their (P, R) states and (P, R) margins."""
    import duckdb

    rows = records.select(["frame_index", "matched_target", "matched_reference"])
    rows = rows.append_column("row", [np.arange(records.num_rows)])
    with bounded_database() as connection:
        add_views(connection, labels, ("objects", "relations"))
        connection.register("run", rows)
        told = ", ".join(
            f"coalesce(l.{quoted(n)}, {F}) AS s{k}, coalesce(l.{quoted(f'{n}_margin')}, 0) AS m{k}"
            for k, n in enumerate(names)
        )
        try:
            # The records count the objects of a frame as the labels order them.
            found = connection.execute(
                "WITH numbered AS (SELECT frame_index, object,"
                " row_number() OVER (PARTITION BY frame_index ORDER BY object) - 1 AS number FROM objects"
                " WHERE frame_index IN (SELECT frame_index FROM run))"
                f" SELECT r.row, {told} FROM run r"
                " JOIN numbered a ON a.frame_index = r.frame_index AND a.number = r.matched_target"
                " JOIN numbered b ON b.frame_index = r.frame_index AND b.number = r.matched_reference"
                " JOIN relations l ON l.frame_index = r.frame_index AND l.a = a.object AND l.b = b.object"
            ).fetchnumpy()
        except duckdb.Error as error:
            reason = str(error).split("\n")[0]
            raise InputError("the tables of the labels cannot be read", got=reason, path=labels.root) from error

    states, margins = (np.stack([found[f"{letter}{k}"] for k in range(len(names))], axis=1) for letter in "sm")
    return found["row"].astype(np.int64), states, margins
