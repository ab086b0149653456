"""A run to look through: found by words and facets, read by range, with marks, kept searches and a second run."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from pipeline.evaluation.comparing import CHANGE, SECOND, SECOND_COLUMNS, with_second
from pipeline.evaluation.facets import Facet, Facets
from pipeline.evaluation.run_notes import MARKS, Key, keep_filter, mark, notes_path, read_notes
from pipeline.evaluation.search import find_rows
from pipeline.labels.reading import Labels, read_table
from pipeline.system.arrow import pa
from pipeline.system.errors import require

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

    `second`: records of a run to compare with.

    Raises InputError: the two have no expression in common, or the notes of the run cannot be read.
    """

    def __init__(self, records: pa.Table, folder: Path, second: pa.Table | None = None) -> None:
        self._bare = records if second is None else with_second(records, second)
        self.path = notes_path(folder)
        self.notes = read_notes(self.path)
        self.records = self._marked()
        self._facets = Facets(self.records)
        self.stamp = 0
        """Another number after every mark."""

    def _marked(self) -> pa.Table:
        return self._bare.append_column(MARKS, pa.array(self.notes.marks_of(self.keys), pa.list_(pa.string())))

    @cached_property
    def keys(self) -> list[Key]:
        """(frame, id) of every expression."""
        columns = (self._bare.column(name).to_pylist() for name in ("frame", "id"))
        return list(zip(*columns, strict=True))

    @cached_property
    def _index(self) -> dict[Key, int]:
        return {key: k for k, key in enumerate(self.keys)}

    @cached_property
    def _words(self) -> dict[Key, int]:
        columns = (self._bare.column(name).to_pylist() for name in ("frame", "text"))
        return {key: k for k, key in reversed(list(enumerate(zip(*columns, strict=True))))}

    def asked(self, frame: str, text: str) -> int | None:
        """First row of a frame with these words as its expression."""
        return self._words.get((frame, text))

    def number(self, frame: str, expression: str) -> int | None:
        """The row of an expression."""
        return self._index.get((frame, expression))

    def add_column(self, name: str, values: Sequence[Any]) -> None:
        """Add a column to search by."""
        self._bare = self._bare.append_column(name, pa.array(values))
        self.records = self._marked()

    def find(self, query: str) -> np.ndarray:
        """(F,) int64: rows of a search; InputError where the search cannot be read."""
        return find_rows(self.records, query)

    def facets(self, query: str) -> tuple[Facet, ...]:
        """Facets under a search; InputError where the search cannot be read."""
        return self._facets.of(query)

    def read(self, rows: np.ndarray) -> list[dict[str, Any]]:
        """Read the columns of these rows for a list."""
        names = [name for name in SHOWN if name in self.records.column_names]
        return self.records.select(names).take(pa.array(rows)).to_pylist()

    def mark(self, rows: Iterable[int], name: str, on: bool = True) -> None:
        """Mark rows, or remove a mark; raises InputError as `run_notes.mark`."""
        self.notes = mark(self.path, [self.keys[k] for k in rows], name, on)
        self.records = self._marked()
        self._facets = self._facets.marked(self.records)
        self.stamp += 1

    def keep(self, name: str, query: str | None) -> None:
        """Keep a search under a name, or forget the search; raises InputError as `run_notes.keep_filter`."""
        self.notes = keep_filter(self.path, name, query)
