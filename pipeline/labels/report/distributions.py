"""What the pictures show and the statistics do not list: counted in SQL, never held row by row."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pipeline.labels.statistics import Database, margin_counts, quantiles, quoted
from pipeline.language.relation_names import RELATIONS

SAMPLED_FRAMES = 5_000
"""Displacements are counted over about so many frames; of fewer, over all."""
CELL_M = 0.02
FARTHEST_M = 10.0
DISTANCE_STEP_M = 0.25


@dataclass(frozen=True)
class Displacements:
    """Where targets lie from their references: the middle of their extents, less that of the reference's."""

    across: np.ndarray
    along: np.ndarray
    """(N,) float64: metres to the right, and up or forward (see `in_plan`): middles of cells of CELL_M."""
    count: np.ndarray
    """(N,) int64: pairs in the cell."""


@dataclass(frozen=True)
class SizeRange:
    """Boxes of one class: metres of the longest edge (tenth, half, nine tenths of them), and of the shortest (half)."""

    label: str
    objects: int
    longest: tuple[float, float, float]
    shortest: float


@dataclass(frozen=True)
class Distributions:
    """All of it."""

    margins: dict[str, dict[str, np.ndarray]]
    """See `pipeline.labels.statistics.margin_counts`."""
    displacements: dict[str, Displacements]
    """Of the pairs of which the relation holds."""
    frames_sampled: bool
    """Displacements are of a sample of the frames."""
    distances: np.ndarray
    """(N,) int64: objects by distance, in steps of DISTANCE_STEP_M."""
    by_class: dict[tuple[str, str], int]
    """Expressions by (relation, class of the target)."""
    sizes: list[SizeRange]
    """Of the usable objects of the classes that were asked for."""


def distributions(
    database: Database, relations: Sequence[str], frames: int, classes: Sequence[str], sampled: int = SAMPLED_FRAMES
) -> Distributions:
    """Count everything the pictures need.

    `frames`: how many there are. `classes`: those whose sizes are shown. `sampled`: see SAMPLED_FRAMES.
    """
    return Distributions(
        {name: margin_counts(database, name) for name in relations},
        displacements(database, relations, frames, sampled),
        frames > sampled,
        _distances(database),
        {
            (str(relation), str(target)): int(count)
            for relation, target, count in database.rows(
                "SELECT relation, target, count(*) FROM expressions GROUP BY ALL"
            )
        },
        _sizes(database, classes),
    )


def displacements(
    database: Database, relations: Sequence[str], frames: int, sampled: int = SAMPLED_FRAMES
) -> dict[str, Displacements]:
    """Displacements of targets from references, by relation.

    Of many frames some are taken, spread evenly by a hash of their index, the
    same ones at every run.
    """
    apart = [f"(a.lo[{k}] + a.hi[{k}] - b.lo[{k}] - b.hi[{k}])" for k in (1, 2, 3)]
    edge = round(FARTHEST_M / CELL_M)
    clipped = [
        f"CAST(greatest(-{edge}, least({edge - 1}, floor({d} / {2 * CELL_M}))) AS INTEGER) AS {axis}"
        for d, axis in zip(apart, "xyz", strict=True)
    ]
    known = " AND ".join(f"isfinite({d})" for d in apart)
    # Knuth's multiplicative hash: multiples of the golden ratio lie evenly in the ring of 32 bits.
    part = min(sampled / max(frames, 1), 1) * 2**32
    taken = f"(CAST(r.frame_index AS BIGINT) * 2654435761) % 4294967296 < {part:.0f}"
    counts = " UNION ALL ".join(
        f"SELECT {k} AS relation, x, {'z' if in_plan(name) else 'y'} AS along, count(*) AS n"
        f" FROM pairs WHERE {quoted(name)} = 1 GROUP BY ALL"
        for k, name in enumerate(relations)
    )
    parts = []
    for first, last in database.frame_ranges():
        ranges = " AND ".join(f"{t}.frame_index BETWEEN {first} AND {last}" for t in "rab")
        parts.append(
            database.columns(
                f"WITH pairs AS MATERIALIZED (SELECT {', '.join('r.' + quoted(n) for n in relations)},"
                f" {', '.join(clipped)} FROM relations r"
                " JOIN objects a ON a.frame_index = r.frame_index AND a.object = r.a"
                " JOIN objects b ON b.frame_index = r.frame_index AND b.object = r.b"
                f" WHERE {ranges} AND {taken} AND {known})"
                f" SELECT relation, x, along, sum(n)::BIGINT AS n FROM ({counts}) GROUP BY 1, 2, 3 ORDER BY 1, 2, 3"
            )
        )
    found = {}
    for k, name in enumerate(relations):
        rows = [{column: v[part["relation"] == k] for column, v in part.items()} for part in parts]
        x, along, n = (np.concatenate([np.zeros(0, np.int64), *(r[k] for r in rows)]) for k in ("x", "along", "n"))
        found[name] = Displacements((x + 0.5) * CELL_M, (along + 0.5) * CELL_M, n.astype(np.int64))
    return found


def _distances(database: Database) -> np.ndarray:
    last = round(FARTHEST_M / DISTANCE_STEP_M)
    counts = np.zeros(last + 1, np.int64)
    for k, n in database.rows(
        f"SELECT CAST(floor(least(distance / {DISTANCE_STEP_M}, {last})) AS INTEGER) AS step, count(*)"
        " FROM objects WHERE distance >= 0 AND isfinite(distance) GROUP BY 1"
    ):
        counts[k] = n
    return counts


def _sizes(database: Database, classes: Sequence[str]) -> list[SizeRange]:
    counted = [
        database.columns(
            "SELECT list_position($classes, label) - 1 AS class,"
            f" CAST(round(least({edge}(size), 100) * 1000) AS INTEGER) AS mm, count(*) AS n FROM objects"
            " WHERE usable AND isfinite(list_sum(size)) AND list_contains($classes, label) GROUP BY 1, 2 ORDER BY 1, 2",
            classes=list(classes),
        )
        for edge in ("list_max", "list_min")
        if classes
    ]
    found = []
    for k, label in enumerate(classes):
        longest, shortest = ({column: v[c["class"] == k] for column, v in c.items()} for c in counted)
        if len(longest["n"]):
            low, half, high = (mm / 1000 for mm in quantiles(longest["mm"], longest["n"], (0.1, 0.5, 0.9)))
            (short,) = quantiles(shortest["mm"], shortest["n"], (0.5,))
            found.append(SizeRange(label, int(longest["n"].sum()), (low, half, high), short / 1000))
    return found


def in_plan(relation: str) -> bool:
    """Tell relations drawn from above rather than from the viewer's place."""
    return RELATIONS[relation].seen_from == "plan"
