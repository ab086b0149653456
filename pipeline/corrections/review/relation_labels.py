"""Relation labels as one array of cells, with what the review knows of each."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from pipeline.corrections.review.out_of_fold import Doubts
from pipeline.labels.check.stream import UNKNOWN
from pipeline.labels.reading import Labels
from pipeline.labels.tables import read_table
from pipeline.training.label_data import LabelData, column_arrays, rows_of_frame

if TYPE_CHECKING:
    import pyarrow as pa


@dataclass(frozen=True, eq=False)
class RelationLabels:
    """The table of relations as arrays, in its order.

    Attributes
    ----------
    relations : tuple of str
    frame : (P,) object
        Ids.
    frame_index, a, b : (P,) int64
    states : (P, R) int8
        T, U, F; UNKNOWN where there is none.
    margins : (P, R) float64
        Metres; NaN where there is none.
    """

    relations: tuple[str, ...]
    frame: np.ndarray
    frame_index: np.ndarray
    a: np.ndarray
    b: np.ndarray
    states: np.ndarray
    margins: np.ndarray

    def __len__(self) -> int:
        return len(self.a)

    def rows_of(self, keys: Iterable[tuple[str, int, int]]) -> np.ndarray:
        """(K,) int64: the row of each (frame id, a, b); -1 where there is none."""
        keys = list(keys)
        place: dict[tuple[str, int, int], int] = {}
        if keys:
            wanted = {key[0] for key in keys}
            of_them = np.flatnonzero(np.isin(self.frame, list(wanted)))
            rows = zip(self.frame[of_them], self.a[of_them].tolist(), self.b[of_them].tolist(), strict=True)
            place = dict(zip(rows, of_them.tolist(), strict=True))
        return np.array([place.get(key, -1) for key in keys], np.int64)


def read_cells(labels: Labels) -> RelationLabels:
    """All relation labels of a folder.

    Raises
    ------
    InputError
        The table is damaged.
    """
    relations = labels.relation_names
    margins = [f"{r}_margin" for r in relations]
    names = ("frame", "frame_index", "a", "b", *relations, *margins)
    table = read_table(labels.root / "relations.parquet", "relations", names)
    table = table.take(_order(table))
    states = [table.column(r).fill_null(UNKNOWN).to_numpy().astype(np.int8) for r in relations]
    found = column_arrays(table.select(["frame", "frame_index", "a", "b"]))
    shape = (table.num_rows, len(relations))
    margin_columns = [table.column(m).to_numpy().astype(np.float64) for m in margins]
    return RelationLabels(
        relations,
        found["frame"].astype(object),
        found["frame_index"].astype(np.int64),
        found["a"].astype(np.int64),
        found["b"].astype(np.int64),
        np.stack(states, axis=1) if states else np.zeros(shape, np.int8),
        np.stack(margin_columns, axis=1) if margins else np.zeros(shape),
    )


def _order(table: pa.Table) -> np.ndarray:
    return np.lexsort([table.column(name).to_numpy() for name in ("b", "a", "frame_index")])


def doubts_of_cells(cells: RelationLabels, data: LabelData, doubts: Doubts) -> tuple[np.ndarray, np.ndarray]:
    """What the networks say of each cell.

    Returns
    -------
    probability, wrong : (P, R) float64
        NaN for pairs of which an object is not usable, and of `wrong` where the label is U.
    """
    found = np.full((2, *cells.states.shape), np.nan)
    columns = [cells.relations.index(relation) for relation in doubts.vocabulary]
    for frame, p, wrong in zip(data.frames, doubts.probabilities, doubts.wrong, strict=True):
        mine = rows_of_frame(cells.frame_index, frame.key.index)
        a, b = cells.a[mine], cells.b[mine]
        i, j = (np.minimum(np.searchsorted(frame.objects, x), len(frame.objects) - 1) for x in (a, b))
        there = np.flatnonzero((frame.objects[i] == a) & (frame.objects[j] == b) & (i != j))
        for k, matrix in enumerate((p, wrong)):
            found[k][np.ix_(mine.start + there, columns)] = matrix[i[there], j[there]]
    return found[0], found[1]
