"""What speaks against a label besides the networks: the linter, a small margin, a doubt, another detector or run.

Each piece of evidence has a weight, the probability that the label is wrong if
there were nothing else. The networks' own is estimated (`confident`); the
weights here are judgements, ordered by what a finding proves.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import reduce
from itertools import pairwise

import numpy as np

from pipeline.corrections.review.items import ItemKey
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


@dataclass(frozen=True, eq=False)
class RelationEvidence:
    """One kind of evidence against some cells.

    Attributes
    ----------
    rows, columns : (E,) int64
        Places of the cells.
    weight : (E,) float64
    reason : (E,) str
    """

    rows: np.ndarray
    columns: np.ndarray
    weight: np.ndarray
    reason: np.ndarray


@dataclass(frozen=True)
class ItemEvidence:
    """Evidence against an object or an expression.

    Attributes
    ----------
    key : ItemKey
    weight : float
    reason : str
    """

    key: ItemKey
    weight: float
    reason: str


def network_evidence(
    cells: RelationLabels, probability: np.ndarray, wrong: np.ndarray, least: float
) -> RelationEvidence:
    """Labels that networks which have not learnt from them find wrong with at least this probability."""
    rows, columns = np.nonzero(wrong >= least)
    states, p = cells.states[rows, columns], probability[rows, columns]
    reason = _joined(
        "the label is ", letters(states), ", and networks that have not learnt from it give it a probability of ",
        np.char.mod("%.2f", np.where(states == T, p, 1 - p)),
    )  # fmt: skip
    return RelationEvidence(rows, columns, wrong[rows, columns], reason)


def undecided_evidence(cells: RelationLabels, probability: np.ndarray) -> RelationEvidence:
    """Cells that the rule finds too close to call (U); the surer the networks are, the more is to be gained."""
    rows, columns = np.nonzero(cells.states == U)
    p = np.nan_to_num(probability[rows, columns], nan=0.5)
    reason = _joined(
        "too close to call by the rule (U); networks that have not learnt from it say ", np.where(p > 0.5, "T", "F"),
        " with ", np.char.mod("%.2f", np.maximum(p, 1 - p)),
    )  # fmt: skip
    return RelationEvidence(rows, columns, UNDECIDED * np.abs(2 * p - 1), reason)


def margin_evidence(cells: RelationLabels, least: float) -> RelationEvidence:
    """Labels near a threshold of the rule: half the chance that an error of MARGIN_SIGMA_M crosses it, for it leads to
    U and not to the opposite."""
    from scipy.special import ndtr

    near = np.abs(cells.margins)
    weight = np.where(np.isnan(near), 0.0, 0.5 * ndtr(-np.nan_to_num(near) / MARGIN_SIGMA_M))
    rows, columns = np.nonzero(((cells.states == T) | (cells.states == F)) & (weight >= least))
    mm = 1000 * near[rows, columns]
    told = np.where(mm < 0.05, "less than 0.1", np.char.add("only ", np.char.mod("%.1f", mm)))
    return RelationEvidence(
        rows, columns, weight[rows, columns], _joined(told, " mm from where the rule would be undecided")
    )


def linter_evidence(
    cells: RelationLabels, findings: Iterable[Finding]
) -> tuple[RelationEvidence, tuple[ItemEvidence, ...], int]:
    """The findings of `check_labels` by the labels that they are about.

    Returns
    -------
    cells : RelationEvidence
    items : tuple of ItemEvidence
        Objects and expressions.
    elsewhere : int
        Findings of files, frames and missing rows: nothing that a person settles label by label.
    """
    blamed: list[tuple[tuple[str, int, int], int, float, str]] = []
    items: list[ItemEvidence] = []
    elsewhere = 0
    for found in findings:
        group = found.rule.split("/")[0]
        known = [c for c in _blamed_cells(found) if c[2] in cells.relations] if group == "relation" else []
        if found.frame is not None and known:
            most, reason = 1.0 if found.severity == "error" else WARNED, f"{found.rule}: {found.message}"
            blamed += [((found.frame, a, b), cells.relations.index(r), min(w, most), reason) for a, b, r, w in known]
        elif found.frame is not None and group in ("object", "expression") and found.objects:
            items += _blamed_items(found)
        else:
            elsewhere += 1
    keys, columns, weights, reasons = zip(*blamed, strict=True) if blamed else ((), (), (), ())
    rows = cells.rows_of(keys)
    there = rows >= 0
    evidence = RelationEvidence(
        rows[there], np.array(columns, np.int64)[there], np.array(weights, np.float64)[there],
        np.array(reasons, object)[there],
    )  # fmt: skip
    return evidence, tuple(items), elsewhere + int((~there).sum())


def _blamed_cells(found: Finding) -> list[tuple[int, int, str, float]]:
    """(a, b, relation, weight) of the labels of which one is wrong."""
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


def _blamed_items(found: Finding) -> list[ItemEvidence]:
    assert found.frame is not None
    weight = CONTRADICTED if found.severity == "error" else WARNED
    reason = f"{found.rule}: {found.message}"
    if found.rule.startswith("object/"):
        if len(found.objects) > 1 and found.severity == "error":
            weight = ONE_OF_TWO
        return [ItemEvidence(ItemKey(found.frame, "object", n, None, ""), weight, reason) for n in found.objects]
    a, b = (*found.objects, None)[:2]
    assert a is not None
    return [ItemEvidence(ItemKey(found.frame, "expression", a, b, str(found.figures.get("id", ""))), weight, reason)]


def disputed_evidence(
    labels: Labels, cells: RelationLabels, other: Labels
) -> tuple[RelationEvidence, tuple[ItemEvidence, ...]]:
    """What labels of the same dataset by another detector or run say otherwise.

    Objects are the same where their 2D boxes overlap best, either way, with an
    IoU of at least SAME_BOX_IOU. Relations count where one says T and the other F.

    Parameters
    ----------
    labels : Labels
    cells : RelationLabels
        Of these.
    other : Labels
    """
    theirs = read_relation_labels(other)
    shared = [r for r in cells.relations if r in theirs.relations]
    own_columns, their_columns = ([c.relations.index(r) for r in shared] for c in (cells, theirs))
    objects = [column_arrays(x.objects.select(["frame", "frame_index", "object", "label", "bbox"]))
               for x in (labels, other)]  # fmt: skip
    frames = [dict(zip(x.frames.column("frame").to_pylist(), x.frames.column("frame_index").to_pylist(), strict=True))
              for x in (labels, other)]  # fmt: skip
    rows, columns, items = [], [], []
    for frame, index in frames[0].items():
        if frame not in frames[1]:
            continue
        mine = rows_of_frame(objects[0]["frame_index"], index)
        others = rows_of_frame(objects[1]["frame_index"], frames[1][frame])
        match = matched_boxes(objects[0]["bbox"][mine], objects[1]["bbox"][others])
        numbers = objects[0]["object"][mine], objects[1]["object"][others]
        items += _disputed_objects(
            str(frame), numbers[0], objects[0]["label"][mine], objects[1]["label"][others], match
        )
        if not shared or not len(numbers[0]):
            continue
        own, foreign = rows_of_frame(cells.frame_index, index), rows_of_frame(theirs.frame_index, frames[1][frame])
        at = np.full((len(numbers[1]),) * 2, -1, np.int64)
        i, j = (np.searchsorted(numbers[1], x[foreign]) for x in (theirs.a, theirs.b))
        at[i, j] = np.arange(foreign.start, foreign.stop)
        i, j = (match[np.searchsorted(numbers[0], x[own])] for x in (cells.a, cells.b))
        row = np.where((i >= 0) & (j >= 0), at[i, j] if at.size else -1, -1)
        there = np.flatnonzero(row >= 0)
        turned = cells.states[own][there][:, own_columns] * theirs.states[row[there]][:, their_columns].astype(np.int64)
        r, c = np.nonzero(turned == -1)
        rows.append(own.start + there[r])
        columns.append(np.array(own_columns, np.int64)[c])
    r, c = (np.concatenate([np.zeros(0, np.int64), *found]) for found in (rows, columns))
    reason = _joined("the other labels of this frame say ", letters(-cells.states[r, c]))
    return RelationEvidence(r, c, np.full(len(r), DISPUTED), reason), tuple(items)


def _disputed_objects(
    frame: str, numbers: np.ndarray, names: np.ndarray, others: np.ndarray, match: np.ndarray
) -> Iterable[ItemEvidence]:
    for number, name, at in zip(numbers.tolist(), names, match.tolist(), strict=True):
        key = ItemKey(frame, "object", int(number), None, "")
        if at < 0:
            yield ItemEvidence(key, UNMATCHED, "the other labels have no object here")
        elif others[at] != name:
            yield ItemEvidence(key, DISPUTED, f"the other labels call it {others[at]!r}")


def matched_boxes(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """(N,) int64: which of M second boxes each first one is, both (., 4) x0, y0, x1, y1; -1 where none is."""
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


def combined(parts: Sequence[RelationEvidence], shape: tuple[int, int]) -> np.ndarray:
    """`shape` float64: one less the product of (1 - weight) of all evidence against each cell."""
    right = np.zeros(shape)
    for part in parts:
        np.add.at(right, (part.rows, part.columns), np.log1p(-np.minimum(part.weight, 1 - 1e-12)))
    return -np.expm1(right)


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
        T, U, F; NOT_JUDGED where there is none.
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
        of_them = np.flatnonzero(np.isin(self.frame, list({key[0] for key in keys})))
        rows = zip(self.frame[of_them], self.a[of_them].tolist(), self.b[of_them].tolist(), strict=True)
        index = dict(zip(rows, of_them.tolist(), strict=True))
        return np.array([index.get(key, -1) for key in keys], np.int64)


def read_relation_labels(labels: Labels) -> RelationLabels:
    """All relation labels of a folder.

    Raises
    ------
    InputError
        The table is damaged.
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
