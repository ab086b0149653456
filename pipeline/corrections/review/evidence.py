"""What speaks against a label besides the networks: the linter, a small margin, a doubt, another detector or run.

Each piece of evidence has a weight, the probability that the label is wrong if
there were nothing else. The networks' own is estimated (`confident`); the
weights here are judgements, ordered by what a finding proves.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass
from functools import reduce
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from pipeline.corrections.review.items import SETTLED, ItemKey, State
from pipeline.corrections.review.out_of_fold import Doubts
from pipeline.geometry.boxes import iou_2d
from pipeline.labels.check.view import Finding
from pipeline.labels.reading import Labels, read_table
from pipeline.language.relation_names import INVERSE
from pipeline.relations.pair_measures import NOT_JUDGED, F, T, U
from pipeline.training.label_data import LabelData, column_arrays, rows_of_frame

CONTRADICTED = 0.9
"""Of an error that names one label: the stored state contradicts the extents, an expression states what is F."""
ONE_OF_TWO = 0.5
"""Of two labels that cannot both be right; of n in a cycle each has 1 / n."""
WARNED = 0.2
DISPUTED = 0.5
"""Another detector or run says the opposite, or another class name."""
UNMATCHED = 0.3
"""Another detector or run does not see the object."""
UNDECIDED = 0.5
"""Times how sure the networks are of a label that is U."""
MARGIN_SIGMA_M = 0.01
"""Metres: what a margin may be off by, from depth noise and mask borders."""
SAME_BOX_IOU = 0.5


Reason = tuple[ItemKey, float, str]
"""What speaks against one item: its key, the weight, the words."""


class EvidenceRows(NamedTuple):
    """Rows of evidence against the items of a `QueueItems`."""

    item: np.ndarray
    """(E,) int64"""
    weight: np.ndarray
    """(E,) float64"""
    reason: np.ndarray
    """(E,) str"""


class QueueItems:
    """Numbers of all that can be doubted: first each cell of the relation labels, row by row, then other items.

    What people have settled is not doubted.
    """

    def __init__(self, cells: RelationLabels, states: Mapping[ItemKey, State]) -> None:
        self.cells, self.others = cells, dict[ItemKey, int]()
        self.settled = [key for key, state in states.items() if state in SETTLED]
        self.settled_cells = np.zeros(cells.states.size, np.bool_)
        self.settled_cells[cells.cells_of(self.settled)[0]] = True

    def rows(self, reasons: Iterable[Reason], settled: bool = False) -> EvidenceRows:
        """Reasons as rows of evidence, without settled and missing labels."""
        hidden = set() if settled else set(self.settled)
        found = [reason for reason in reasons if reason[0].plain not in hidden]
        numbers, cells = self.cells.cells_of([key for key, *_ in found])
        number = dict(zip(cells, numbers.tolist(), strict=True))
        for key, *_ in found:
            if key.kind != "relation":
                number[key] = self.cells.states.size + self.others.setdefault(key.plain, len(self.others))
        known = [(number[key], weight, words) for key, weight, words in found if key in number]
        item, weight, words = zip(*known, strict=True) if known else ((), (), ())
        return EvidenceRows(np.array(item, np.int64), np.array(weight, np.float64), np.array(words, object))

    def cell_rows(self, item: np.ndarray, weight: np.ndarray, reason: np.ndarray) -> EvidenceRows:
        """Evidence against cells, without settled ones."""
        kept = ~self.settled_cells[item]
        return EvidenceRows(item[kept], weight[kept], reason[kept].astype(object))


def network_evidence(items: QueueItems, probability: np.ndarray, wrong: np.ndarray, least: float) -> EvidenceRows:
    """Labels that out-of-fold networks find wrong with at least this probability."""
    item = np.flatnonzero(wrong >= least)
    states, p = items.cells.states.ravel()[item], probability.ravel()[item]
    reason = _joined(
        "the label is ",
        letters(states),
        ", and networks that have not learnt from it give it a probability of ",
        np.char.mod("%.2f", np.where(states == T, p, 1 - p)),
    )
    return items.cell_rows(item, wrong.ravel()[item], reason)


def undecided_evidence(items: QueueItems, probability: np.ndarray) -> EvidenceRows:
    """Undecided cells (U), weighted by the networks' certainty."""
    item = np.flatnonzero(items.cells.states == U)
    p = np.nan_to_num(probability.ravel()[item], nan=0.5)
    reason = _joined(
        "too close to call by the rule (U); networks that have not learnt from it say ",
        np.where(p > 0.5, "T", "F"),
        " with ",
        np.char.mod("%.2f", np.maximum(p, 1 - p)),
    )
    return items.cell_rows(item, UNDECIDED * np.abs(2 * p - 1), reason)


def margin_evidence(items: QueueItems, least: float) -> EvidenceRows:
    """Labels near a threshold of the rule, by half the chance of an error of MARGIN_SIGMA_M across: it leads to U
    and not to the opposite."""
    from scipy.special import ndtr

    near, states = np.abs(items.cells.margins.ravel()), items.cells.states.ravel()
    weight = np.where(np.isnan(near), 0.0, 0.5 * ndtr(-np.nan_to_num(near) / MARGIN_SIGMA_M))
    item = np.flatnonzero(((states == T) | (states == F)) & (weight >= least))
    mm = 1000 * near[item]
    told = np.where(mm < 0.05, "less than 0.1", np.char.add("only ", np.char.mod("%.1f", mm)))
    return items.cell_rows(item, weight[item], _joined(told, " mm from where the rule would be undecided"))


def linter_evidence(items: QueueItems, findings: Iterable[Finding]) -> tuple[EvidenceRows, int]:
    """Evidence of `check_labels`, and how many findings are of no single label: of files, frames and missing rows."""
    reasons: list[Reason] = []
    elsewhere = 0
    for found in findings:
        blamed = _blamed(found, items.cells.relations)
        elsewhere += not blamed
        reasons += [(key, weight, f"{found.rule}: {found.message}") for key, weight in blamed]
    relations = [key for key, *_ in reasons if key.kind == "relation"]
    return items.rows(reasons), elsewhere + len(relations) - len(items.cells.cells_of(relations)[1])


def _blamed(found: Finding, relations: Collection[str]) -> list[tuple[ItemKey, float]]:
    frame, group = found.frame, found.rule.split("/")[0]
    if frame is None:
        return []
    if group == "relation":
        most = 1.0 if found.severity == "error" else WARNED
        return [
            (ItemKey(frame, group, a, b, r), min(weight, most))
            for a, b, r, weight in _blamed_cells(found)
            if r in relations
        ]
    weight = CONTRADICTED if found.severity == "error" else WARNED
    if group == "object":
        weight = ONE_OF_TWO if len(found.objects) > 1 and found.severity == "error" else weight
        return [(ItemKey(frame, group, n, None, ""), weight) for n in found.objects]
    if group != "expression" or not found.objects:
        return []
    return [(ItemKey(frame, group, found.objects[0], None, str(found.figures.get("id", ""))), weight)]


def _blamed_cells(found: Finding) -> list[tuple[int, int, str, float]]:
    relation = found.figures.get("relation")
    if not isinstance(relation, str) or len(found.objects) < 2:
        return []
    a, b = found.objects[:2]
    if found.rule == "relation/geometry":
        return [(a, b, relation, CONTRADICTED)]
    inverse = INVERSE.get(relation, relation)
    if found.rule == "relation/cycle":
        return [(i, j, relation, 1 / len(found.objects)) for i, j in pairwise((*found.objects, found.objects[0]))]
    others = {
        "relation/inverse": (b, a, inverse),
        "relation/exclusive": (a, b, inverse),
        "relation/antisymmetry": (b, a, relation),
    }
    other = others.get(found.rule)
    return [] if other is None else [(a, b, relation, ONE_OF_TWO), (*other, ONE_OF_TWO)]


def disputed_evidence(items: QueueItems, labels: Labels, other: Labels) -> tuple[EvidenceRows, EvidenceRows]:
    """Differences from labels of the same dataset by another detector or run: of relations, of objects.

    Objects are the same where their 2D boxes overlap best, either way, with an
    IoU of at least SAME_BOX_IOU. Relations count where one says T and the other F.
    """
    cells, theirs = items.cells, read_relation_labels(other)
    shared = [r for r in cells.relations if r in theirs.relations]
    own_columns, their_columns = ([c.relations.index(r) for r in shared] for c in (cells, theirs))
    objects = [
        column_arrays(x.objects.select(["frame", "frame_index", "object", "label", "bbox"])) for x in (labels, other)
    ]
    frames = [
        dict(zip(x.frames.column("frame").to_pylist(), x.frames.column("frame_index").to_pylist(), strict=True))
        for x in (labels, other)
    ]
    found, reasons = [np.zeros(0, np.int64)], list[Reason]()
    for frame, index in frames[0].items():
        if frame not in frames[1]:
            continue
        mine = rows_of_frame(objects[0]["frame_index"], index)
        others = rows_of_frame(objects[1]["frame_index"], frames[1][frame])
        match = matched_boxes(objects[0]["bbox"][mine], objects[1]["bbox"][others])
        numbers, names = objects[0]["object"][mine], objects[1]["label"][others]
        for number, name, at in zip(numbers.tolist(), objects[0]["label"][mine], match.tolist(), strict=True):
            key = ItemKey(str(frame), "object", number, None, "")
            if at < 0:
                reasons.append((key, UNMATCHED, "the other labels have no object here"))
            elif names[at] != name:
                reasons.append((key, DISPUTED, f"the other labels call it {names[at]!r}"))
        if not shared or not len(numbers):
            continue
        own, foreign = rows_of_frame(cells.frame_index, index), rows_of_frame(theirs.frame_index, frames[1][frame])
        at = np.full((len(names),) * 2, -1, np.int64)
        i, j = (np.searchsorted(objects[1]["object"][others], x[foreign]) for x in (theirs.a, theirs.b))
        at[i, j] = np.arange(foreign.start, foreign.stop)
        i, j = (match[np.searchsorted(numbers, x[own])] for x in (cells.a, cells.b))
        row = np.where((i >= 0) & (j >= 0), at[i, j] if at.size else -1, -1)
        there = np.flatnonzero(row >= 0)
        turned = cells.states[own][there][:, own_columns] * theirs.states[row[there]][:, their_columns].astype(np.int64)
        r, c = np.nonzero(turned == -1)
        found.append((own.start + there[r]) * len(cells.relations) + np.array(own_columns, np.int64)[c])
    item = np.concatenate(found)
    told = _joined("the other labels of this frame say ", letters(-cells.states.ravel()[item]))
    return items.cell_rows(item, np.full(len(item), DISPUTED), told), items.rows(reasons)


def matched_boxes(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """(N,) int64: index of the matching second box of each first one, both (., 4) x0, y0, x1, y1; -1 without a
    match."""
    if not len(first) or not len(second):
        return np.full(len(first), -1, np.int64)
    iou = iou_2d(first, second)
    best = iou.argmax(axis=1)
    here = np.arange(len(first))
    mutual = (iou.argmax(axis=0)[best] == here) & (iou[here, best] >= SAME_BOX_IOU)
    return np.where(mutual, best, -1)


def letters(states: np.ndarray) -> np.ndarray:
    """T, F or U of each state."""
    return np.where(states == T, "T", np.where(states == F, "F", "U"))


def _joined(*parts: str | np.ndarray) -> np.ndarray:
    """Texts joined element by element."""
    return reduce(np.char.add, parts, np.array(""))


@dataclass(frozen=True, eq=False)
class RelationLabels:
    """The table of relations as arrays, in its order."""

    relations: tuple[str, ...]
    frame: np.ndarray
    """(P,) object: ids."""
    frame_index: np.ndarray
    a: np.ndarray
    b: np.ndarray
    """(P,) int64"""
    states: np.ndarray
    """(P, R) int8: T, U, F; NOT_JUDGED where there is none."""
    margins: np.ndarray
    """(P, R) float64: metres; NaN where there is none."""

    def __len__(self) -> int:
        return len(self.a)

    def cells_of(self, keys: Iterable[ItemKey]) -> tuple[np.ndarray, list[ItemKey]]:
        """Cell numbers (K,) int64, row by row, of the keys of relations of these labels, with the keys.

        Keys that the labels lack are left out.
        """
        wanted = [k for k in keys if k.kind == "relation" and k.what in self.relations]
        rows = self.rows_of([(k.frame, k.a, -1 if k.b is None else k.b) for k in wanted])
        columns = np.array([self.relations.index(k.what) for k in wanted], np.int64)
        there = rows >= 0
        return (rows * len(self.relations) + columns)[there], [
            k for k, known in zip(wanted, there, strict=True) if known
        ]

    def rows_of(self, keys: Collection[tuple[str, int, int]]) -> np.ndarray:
        """(K,) int64: row of each (frame id, a, b); -1 if absent."""
        of_them = np.flatnonzero(np.isin(self.frame, list({key[0] for key in keys})))
        rows = zip(self.frame[of_them], self.a[of_them].tolist(), self.b[of_them].tolist(), strict=True)
        index = dict(zip(rows, of_them.tolist(), strict=True))
        return np.array([index.get(key, -1) for key in keys], np.int64)


def read_relation_labels(labels: Labels) -> RelationLabels:
    """All relation labels of a folder.

    Raises InputError: the table is damaged.
    """
    relations = labels.relation_names
    margins = [f"{r}_margin" for r in relations]
    table = read_table(
        labels.root / "relations.parquet", "relations", ("frame", "frame_index", "a", "b", *relations, *margins)
    )
    table = table.take(np.lexsort([table.column(name).to_numpy() for name in ("b", "a", "frame_index")]))
    states = [table.column(r).fill_null(NOT_JUDGED).to_numpy().astype(np.int8) for r in relations]
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


def doubts_of_labels(cells: RelationLabels, data: LabelData, doubts: Doubts) -> tuple[np.ndarray, np.ndarray]:
    """Networks' probabilities for each cell.

    Returns `probability`, `wrong` (P, R) float64: NaN for pairs of which an object is not usable, and of `wrong` where
    the label is U.
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
