"""What people set in corrected labels, read back from the provenance that stands beside the tables."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from pipeline.system.errors import InputError

PROVENANCE_FILE = "provenance.parquet"
MARKS_FILE = "marks.json"
STATUSES_FILE = "statuses.json"
"""What reviewers said of frames, objects, relations and expressions, and notes: kind, frame, key, field, value."""


@dataclass(frozen=True)
class Corrections:
    """Values that people set: the linter does not hold them against the rules that made the other ones.

    Attributes
    ----------
    relations : frozenset of (str, int, int, str)
        Frame, a, b, relation: set by a person, or ruled out by what a person set.
    expressions : frozenset of (str, str)
        Frame and id of those whose text or answers a person set.
    """

    relations: frozenset[tuple[str, int, int, str]] = frozenset()
    expressions: frozenset[tuple[str, str]] = frozenset()


def read_corrections(root: Path) -> Corrections:
    """The corrections of a labels folder; none where it has no provenance.

    Raises
    ------
    InputError
        The file is damaged.
    """
    path = root / PROVENANCE_FILE
    if not path.exists():
        return Corrections()
    import pyarrow as pa
    import pyarrow.parquet as pq

    try:
        rows = pq.read_table(path, columns=["table", "frame", "key", "column", "origin", "was"]).to_pylist()
        relations, expressions = set(), set()
        for row in rows:
            # A relation that was ruled out follows from no geometry, and neither does its pair's.
            if row["table"] == "relations" and row["origin"] in ("human", "recomputed"):
                a, b = (int(n) for n in row["key"].split(","))
                if row["origin"] == "human" or row["was"] == "1":
                    relations.add((row["frame"], a, b, row["column"]))
            elif row["table"] == "expressions" and row["origin"] == "human":
                expressions.add((row["frame"], row["key"]))
    except (pa.ArrowException, OSError, ValueError, KeyError, TypeError, AttributeError) as error:
        raise InputError("the provenance of the labels is damaged", got=str(error).split("\n")[0], path=path) from error
    return Corrections(frozenset(relations), frozenset(expressions))
