"""The review queue: labels ranked by how probably they are wrong, each with the reasons in words.

Each piece of evidence has a weight, the probability that the label is wrong if
there were nothing else. The networks' own is estimated (`doubts`); the weights
of the linter, small margins and reviewers who differ are judgements, ordered by
what a finding proves.

A relation is settled where people agree on it, or somebody has settled it, and the label says so too. It is taken as
true then: nothing speaks against it, no noise is estimated from it, and networks learn from it in every pass.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from functools import reduce
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from pipeline.corrections.journal.journal import Journal
from pipeline.corrections.journal.materialise import materialise
from pipeline.corrections.review.doubts import DoubtConfig, doubt_labels
from pipeline.corrections.review.items import DISAGREED, SETTLED, ItemKey, Judgements, State, item_of, judgements_of
from pipeline.datasets import Dataset
from pipeline.labels.check.linter import check_labels
from pipeline.labels.check.view import Finding
from pipeline.labels.reading import Labels, open_labels, read_table
from pipeline.labels.schema import Manifest, labels_version
from pipeline.language.relation_names import INVERSE
from pipeline.relations.pair_measures import NOT_JUDGED, F, T, U
from pipeline.system.arrow import pa
from pipeline.system.frozen import dataclass
from pipeline.training.label_data import LabelledFrame, read_label_data, rows_of_frame

if TYPE_CHECKING:
    from pipeline.labels.check.other_masks import OtherMasks

_TEXT, _NUMBER, _REAL = pa.string(), pa.int32(), pa.float64()
QUEUE_COLUMNS = {
    "frame": _TEXT,
    "frame_index": _NUMBER,
    "kind": _TEXT,
    "a": _NUMBER,
    "b": _NUMBER,
    "relation": _TEXT,
    "expression": _TEXT,
    "place": _TEXT,
    "label": _TEXT,
    "probability": _REAL,
    "wrong": _REAL,
    "score": _REAL,
}
"""Columns of a queue with their types, besides `reasons`."""
LEAST = 0.02
"""Evidence that is weaker is not worth a reason, and a label without any is not in the queue."""


CONTRADICTED = 0.9
"""Of an error that names one label: the stored state contradicts the extents, an expression states what is F."""
ONE_OF_TWO = 0.5
"""Of two labels that cannot both be right; of n in a cycle each has 1 / n."""
MASK_DOUBTS = 2.0
"""Times the doubt of a mask that other views contradict: of planted errors and sound masks with one of .3 to .4 two of
three were errors, with more 96 %."""
WARNED = 0.2
UNDECIDED = 0.5
"""Times how sure the networks are of a label that is U."""
MARGIN_SIGMA_M = 0.01
"""Metres: what a margin may be off by, from depth noise and mask borders."""
DISAGREE = "reviewers disagree"
"""How the reason begins."""
Reason = tuple[ItemKey, float, str]
"""What speaks against one item: its key, the weight, the words."""


def review_queue(
    labels: Labels,
    doubts: DoubtConfig | None = None,
    *,
    judgements: Judgements | None = None,
    masks: OtherMasks | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> pa.Table:
    """Rank labels by the probability of an error, the worst first.

    `doubts`: of the networks that are asked; None: without. `judgements`: what people said of these labels, which are
    effective ones then: see `reviewed_labels`. What is settled has no evidence against it, and stands last, with a
    score of 0. `masks`: see `check_labels`.

    Returns one row an item: frame (string), frame_index (int32), kind ("relation", "object", "expression"), a, b
    (int32, numbers of objects; b null for objects), relation, expression (its id), place, label (T, U or F; the class
    name; the text), probability (float64, that the relation holds, by networks that have not learnt from it; null
    without), wrong (float64, that the label is wrong by confident learning alone; null for U, for what is settled, and
    without networks), score (float64, the same by all evidence), reasons (list of string, the strongest first).
    Metadata: `estimated_wrong` relation labels of those that are not settled; `labels_version`, the automatic labels
    that it is of. Where an object may be missing (queues of
    earlier versions) `place` is x0,y0,x1,y1 and `a` is -1. The label of an object that was left out is null.

    Raises InputError: the labels are damaged, or hold nothing to learn from.
    Raises MissingExtra: torch is not installed.
    """
    cells = read_relation_labels(labels)
    probability, wrong = np.full((2, *cells.states.shape), np.nan)
    evidence = Evidence(cells, {} if judgements is None else states_on_labels(judgements, cells))
    metadata = {"labels_version": automatic_version(labels.manifest)}
    if doubts is not None:
        settled = evidence.settled_cells.reshape(cells.states.shape)
        data = read_label_data(labels, doubts.train.features, labels.relation_names)
        columns = [cells.relations.index(relation) for relation in data.vocabulary]
        rows = [cells.rows_of_pairs(frame) for frame in data.frames]
        trusted = [(at >= 0)[..., None] & settled[at][..., columns] for at in rows]
        asked = doubt_labels(data, doubts, trusted=trusted, progress=progress)
        for at, p, w in zip(rows, asked.probabilities, asked.wrong, strict=True):
            known = at[at >= 0][:, None], columns
            probability[known], wrong[known] = p[at >= 0], w[at >= 0]
        wrong[settled] = np.nan
        network_evidence(evidence, probability, wrong)
        metadata["estimated_wrong"] = f"{sum(n.wrong for n in asked.noise.values()):.0f}"
    evidence.of_items(blamed_by_linter(check_labels(labels, masks=masks), cells.relations))
    margin_evidence(evidence)
    undecided_evidence(evidence, probability)
    if judgements is not None:
        evidence.of_items(disagreements(judgements))
        evidence.of_items(((k, 0.0, "") for k in evidence.settled if k.kind != "relation"), settled=True)
    doubted = {"probability": probability.ravel(), "wrong": wrong.ravel()}
    return _ranked(labels, evidence, doubted).replace_schema_metadata(metadata)


class Evidence:
    """What speaks against labels: their numbers, and rows of (number, weight, reason), as arrays of equal length.

    Numbered are first the cells of the relation labels, row by row, then other items. What people have settled is not
    doubted.
    """

    def __init__(self, cells: RelationLabels, states: Mapping[ItemKey, State]) -> None:
        self.cells, self.others = cells, dict[ItemKey, int]()
        self.settled = {key for key, state in states.items() if state in SETTLED}
        self.settled_cells = np.zeros(cells.states.size, np.bool_)
        self.settled_cells[cells.cells_of(self.settled)[0]] = True
        self.found = [(np.zeros(0, np.int64), np.zeros(0), np.zeros(0, object))]

    def of_items(self, reasons: Iterable[Reason], settled: bool = False) -> None:
        """Add reasons against items; settled and missing labels are left out."""
        found = [reason for reason in reasons if settled or reason[0].plain not in self.settled]
        numbers, cells = self.cells.cells_of([key for key, *_ in found])
        number = dict(zip(cells, numbers.tolist(), strict=True))
        for key, *_ in found:
            if key.kind != "relation":
                number[key] = self.cells.states.size + self.others.setdefault(key.plain, len(self.others))
        known = [(number[key], weight, words) for key, weight, words in found if key in number]
        item, weight, words = zip(*known, strict=True) if known else ((), (), ())
        self.found.append((np.array(item, np.int64), np.array(weight, np.float64), np.array(words, object)))

    def of_cells(self, item: np.ndarray, weight: np.ndarray, reason: np.ndarray) -> None:
        """Add evidence against cells; settled ones are left out."""
        kept = ~self.settled_cells[item]
        self.found.append((item[kept], weight[kept], reason[kept].astype(object)))


def network_evidence(evidence: Evidence, probability: np.ndarray, wrong: np.ndarray) -> None:
    """Add labels that out-of-fold networks find wrong."""
    item = np.flatnonzero(wrong >= LEAST)
    states, p = evidence.cells.states.ravel()[item], probability.ravel()[item]
    reason = _joined(
        "the label is ",
        letters(states),
        ", and networks that have not learnt from it give it a probability of ",
        np.char.mod("%.2f", np.where(states == T, p, 1 - p)),
    )
    evidence.of_cells(item, wrong.ravel()[item], reason)


def undecided_evidence(evidence: Evidence, probability: np.ndarray) -> None:
    """Add undecided cells (U), weighted by the networks' certainty."""
    item = np.flatnonzero(evidence.cells.states == U)
    p = np.nan_to_num(probability.ravel()[item], nan=0.5)
    reason = _joined(
        "too close to call by the rule (U); networks that have not learnt from it say ",
        np.where(p > 0.5, "T", "F"),
        " with ",
        np.char.mod("%.2f", np.maximum(p, 1 - p)),
    )
    evidence.of_cells(item, UNDECIDED * np.abs(2 * p - 1), reason)


def margin_evidence(evidence: Evidence) -> None:
    """Add labels near a threshold of the rule, by half the chance of an error of MARGIN_SIGMA_M across: it leads to U
    and not to the opposite."""
    from scipy.special import ndtr

    near, states = np.abs(evidence.cells.margins.ravel()), evidence.cells.states.ravel()
    weight = np.where(np.isnan(near), 0.0, 0.5 * ndtr(-np.nan_to_num(near) / MARGIN_SIGMA_M))
    item = np.flatnonzero(((states == T) | (states == F)) & (weight >= LEAST))
    mm = 1000 * near[item]
    told = np.where(mm < 0.05, "less than 0.1", np.char.add("only ", np.char.mod("%.1f", mm)))
    evidence.of_cells(item, weight[item], _joined(told, " mm from where the rule would be undecided"))


def blamed_by_linter(findings: Iterable[Finding], relations: Collection[str]) -> Iterator[Reason]:
    """Reasons of `check_labels`; what is of no single label (files, frames, missing rows) is left out."""
    for found in findings:
        for key, weight in _blamed(found, relations):
            yield key, weight, f"{found.rule}: {found.message}"


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
        if found.rule in ("object/other-views", "object/other-places"):
            weight = CONTRADICTED * float(found.figures["views"]) / float(found.figures["of"])
        if found.rule == "object/other-masks":
            weight = min(MASK_DOUBTS * float(found.figures["doubt"]), CONTRADICTED)
        return [(ItemKey(frame, group, n, None, ""), weight) for n in found.objects]
    if group != "expression" or not found.objects:
        return []
    return [(ItemKey(frame, group, found.objects[0], None, str(found.figures.get("id", ""))), weight)]


def _blamed_cells(found: Finding) -> list[tuple[int, int, str, float]]:
    relation = found.figures.get("relation")
    if not isinstance(relation, str) or len(found.objects) < 2:
        return []
    a, b = found.objects[:2]
    if found.rule in ("relation/geometry", "relation/other-views"):
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


def reviewed_labels(
    labels: Labels, journal: Journal, folder: Path, dataset: Dataset | None = None
) -> tuple[Labels, Judgements]:
    """Apply a journal to labels, and read the judgements in it.

    `folder`: a new or empty one, into which effective labels are written; it is left alone where there are no
    corrections.

    Raises InputError: the labels, the journal or a frame cannot be read.
    """
    events = journal.events()
    if not events:
        return labels, Judgements()
    _, found = materialise(labels, journal, folder, dataset=dataset)
    # Where labels say by now what they were corrected to, the word on them holds.
    ignored = {u.event.ulid for u in found.unapplied if u.kind != "agreed"}
    keys = {key for event in events if (key := item_of(event.ref)) is not None}
    automatic = relation_states(read_relation_labels(labels), keys)
    return open_labels(folder), judgements_of(events, automatic=automatic.get, ignored=ignored)


def disagreements(judgements: Judgements) -> list[Reason]:
    """Items judged differently by reviewers, with each verdict."""
    words = {
        key: sorted((w for w in opinions.values() if w.status in SETTLED), key=lambda w: w.at)
        for key, opinions in judgements.words.items()
        if judgements.differ(key)
    }
    return [
        (key, DISAGREED, f"{DISAGREE}: " + ", ".join(f"{w.author} says {w.verdict}" for w in opinions))
        for key, opinions in words.items()
    ]


def states_on_labels(judgements: Judgements, cells: RelationLabels) -> dict[ItemKey, State]:
    """The state of each item over all, see `Judgements.states_now`."""
    return judgements.states_now(relation_states(cells, judgements.states()).get)


def relation_states(cells: RelationLabels, keys: Iterable[ItemKey]) -> dict[ItemKey, int]:
    """T, U or F of the items with a state in the labels."""
    numbers, known = cells.cells_of(keys)
    states = cells.states.ravel()[numbers].tolist()
    return {key: state for key, state in zip(known, states, strict=True) if state in (T, U, F)}


def automatic_version(manifest: Manifest) -> str:
    """Version of the automatic labels behind these: see `labels_version`."""
    stated = (manifest.corrections or {}).get("automatic")
    return str(stated) if stated else labels_version(manifest)


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
        of_them = np.flatnonzero(np.isin(self.frame, list({k.frame for k in wanted})))
        pairs = zip(self.frame[of_them], self.a[of_them].tolist(), self.b[of_them].tolist(), strict=True)
        index = dict(zip(pairs, of_them.tolist(), strict=True))
        rows = np.array([index.get((k.frame, k.a, k.b), -1) for k in wanted], np.int64)
        columns = np.array([self.relations.index(k.what) for k in wanted], np.int64)
        there = rows >= 0
        return (rows * len(self.relations) + columns)[there], [
            k for k, known in zip(wanted, there, strict=True) if known
        ]

    def rows_of_pairs(self, frame: LabelledFrame) -> np.ndarray:
        """(N, N) int64: row of each pair of a frame's objects; -1 for none."""
        mine, known = rows_of_frame(self.frame_index, frame.key.index), frame.objects
        a, b = self.a[mine], self.b[mine]
        i, j = (np.minimum(np.searchsorted(known, x), len(known) - 1) for x in (a, b))
        there = np.flatnonzero((known[i] == a) & (known[j] == b) & (i != j))
        rows = np.full((len(known), len(known)), -1, np.int64)
        rows[i[there], j[there]] = mine.start + there
        return rows


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
    frame_index, a, b = (table.column(name).to_numpy().astype(np.int64) for name in ("frame_index", "a", "b"))
    margin_columns = [table.column(m).to_numpy().astype(np.float64) for m in margins]
    frame = table.column("frame").to_numpy().astype(object)
    # A damaged manifest may name no relation.
    none = np.zeros((table.num_rows, 0))
    found = (np.stack(columns, axis=1) if columns else none for columns in (states, margin_columns))
    return RelationLabels(relations, frame, frame_index, a, b, *found)


def letters(states: np.ndarray) -> np.ndarray:
    """T, F or U of each state."""
    return np.where(states == T, "T", np.where(states == F, "F", "U"))


def _joined(*parts: str | np.ndarray) -> np.ndarray:
    """Texts joined element by element."""
    return reduce(np.char.add, parts, np.array(""))


def _ranked(labels: Labels, evidence: Evidence, doubted: Mapping[str, np.ndarray]) -> pa.Table:
    cells, others = evidence.cells, list(evidence.others)
    at, weight, reason = (np.concatenate(parts) for parts in zip(*evidence.found, strict=True))
    right = np.zeros(cells.states.size + len(others))
    np.add.at(right, at, np.log1p(-np.minimum(weight, 1 - 1e-12)))
    score = -np.expm1(right)
    cell = np.flatnonzero((score[: cells.states.size] >= LEAST) | evidence.settled_cells)
    row, column = np.divmod(cell, max(len(cells.relations), 1))
    columns = {
        "frame": cells.frame[row],
        "frame_index": cells.frame_index[row],
        "kind": np.full(len(row), "relation", object),
        "a": cells.a[row],
        "b": cells.b[row],
        "relation": np.array(cells.relations, object)[column],
        "label": letters(cells.states.ravel()[cell]).astype(object),
        **{name: values[cell] for name, values in doubted.items()},
    }
    arrays = [
        pa.array(columns[name], kind, from_pandas=True, safe=False) if name in columns else pa.nulls(len(row), kind)
        for name, kind in QUEUE_COLUMNS.items()
    ]
    schema = pa.schema(list(QUEUE_COLUMNS.items()))
    rows = pa.concat_tables(
        [pa.Table.from_arrays(arrays, schema=schema), pa.Table.from_pylist(_other_rows(labels, others), schema)]
    ).combine_chunks()
    item = np.append(cell, cells.states.size + np.arange(len(others)))
    rows = rows.set_column(rows.schema.get_field_index("score"), "score", pa.array(score[item]))
    keys = (rows.column(name).fill_null(-1).to_numpy() for name in ("b", "a", "frame_index"))
    order = np.lexsort((np.append(column, np.full(len(others), -1)), *keys, -score[item]))
    rank = np.full(len(score), -1, np.int64)
    rank[item[order]] = np.arange(len(order))
    # A label whose evidence is all too weak has no row: its place is -1.
    at = rank[at]
    kept = np.flatnonzero((at >= 0) & (weight >= LEAST))
    kept = kept[np.lexsort((-weight[kept], at[kept]))]
    offsets = np.concatenate([[0], np.cumsum(np.bincount(at[kept], minlength=len(order)))])
    reasons = pa.ListArray.from_arrays(pa.array(offsets, pa.int32()), pa.array(reason[kept], pa.string()))
    return rows.take(order).append_column("reasons", reasons)


def _other_rows(labels: Labels, keys: Sequence[ItemKey]) -> list[dict[str, Any]]:
    """Rows of objects and expressions."""
    if not keys:
        return []
    objects, sentences, frames = (
        {tuple(row[name] for name in ("frame", *number)): row for row in table.select(["frame", *columns]).to_pylist()}
        for table, number, columns in (
            (labels.objects, ["object"], ["object", "label"]),
            (labels.expressions, ["id"], ["id", "text", "target_object", "reference_object"]),
            (labels.frames, [], ["frame_index"]),
        )
    )
    found: list[dict[str, Any]] = []
    for k in keys:
        index = frames.get((k.frame,), {"frame_index": 0})["frame_index"]
        row = {"frame": k.frame, "kind": k.kind, "frame_index": index, "a": k.a, "b": k.b}
        if k.kind == "object":
            label = objects.get((k.frame, k.a), {}).get("label")
            found.append({**row, "place": k.what or None, "label": label})
        else:
            said = sentences.get((k.frame, k.what), {})
            ends = {"a": said.get("target_object", k.a), "b": said.get("reference_object", k.b)}
            found.append({**row, **ends, "expression": k.what, "label": said.get("text")})
    return found
