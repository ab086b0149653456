"""The review queue: labels ranked by how probably they are wrong, each with the reasons in words."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from pipeline.corrections.review.evidence import (
    EvidenceRows,
    QueueItems,
    disputed_evidence,
    doubts_of_labels,
    letters,
    linter_evidence,
    margin_evidence,
    network_evidence,
    read_relation_labels,
    undecided_evidence,
)
from pipeline.corrections.review.items import ItemKey, Judgements
from pipeline.corrections.review.out_of_fold import DoubtConfig, Doubts, doubt_labels
from pipeline.corrections.review.reviewed import automatic_version, disagreements, states_on_labels, trusted_of_data
from pipeline.labels.check.linter import check_labels
from pipeline.labels.reading import Labels
from pipeline.system.arrow import pa
from pipeline.training.label_data import LabelData, read_label_data

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


@dataclass(frozen=True)
class QueueConfig:
    """What a queue is made from."""

    doubts: DoubtConfig | None = field(default_factory=DoubtConfig)
    """None: without networks."""
    linter: bool = True
    margins: bool = True
    undecided: bool = True
    """Whether findings of `check_labels`, small margins, and U cells are looked at."""


def review_queue(
    labels: Labels,
    config: QueueConfig | None = None,
    *,
    other: Labels | None = None,
    judgements: Judgements | None = None,
    doubts: tuple[LabelData, Doubts] | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> pa.Table:
    """Rank labels by the probability of an error, the worst first.

    `other`: of the same dataset, by another detector or run: what they say otherwise counts too. `judgements`: what
    people said of these labels, which are effective ones then: see `reviewed_labels`. What is settled has no evidence
    against it, and stands last, with a score of 0. `doubts`: where the networks were already asked.

    Returns one row an item: frame (string), frame_index (int32), kind ("relation", "object", "expression"), a, b
    (int32, numbers of objects; b null for objects), relation, expression (its id), place, label (T, U or F; the class
    name; the text), probability (float64, that the relation holds, by networks that have not learnt from it; null
    without), wrong (float64, that the label is wrong by confident learning alone; null for U, for what is settled, and
    without networks), score (float64, the same by all evidence), reasons (list of string, the strongest first).
    Metadata: `estimated_wrong` relation labels of those that are not settled; `elsewhere`, findings that are of no
    single label; `labels_version`, the automatic labels that it is of. Where an object may be missing, `row_of` tells
    where (x0,y0,x1,y1), `a` is -1, and the label is the class. The label of an object that was left out is null.

    Raises InputError: the labels are damaged, or hold nothing to learn from.
    Raises MissingExtra: torch is not installed.
    """
    config = config or QueueConfig()
    cells = read_relation_labels(labels)
    probability = wrong = np.full(cells.states.shape, np.nan)
    metadata = {"elsewhere": "0", "labels_version": automatic_version(labels.manifest)}
    items = QueueItems(cells, {} if judgements is None else states_on_labels(judgements, cells))
    settled = items.settled_cells.reshape(cells.states.shape)
    evidence: list[EvidenceRows] = []
    if doubts is None and config.doubts is not None:
        data = read_label_data(labels, config.doubts.train.features, labels.relation_names)
        trusted = trusted_of_data(cells, settled, data)
        doubts = data, doubt_labels(data, config.doubts, trusted=trusted, progress=progress)
    if doubts is not None:
        probability, wrong = doubts_of_labels(cells, *doubts)
        wrong = np.where(settled, np.nan, wrong)
        evidence.append(network_evidence(items, probability, wrong, LEAST))
        metadata["estimated_wrong"] = f"{sum(n.wrong for n in doubts[1].noise.values()):.0f}"
    if config.linter:
        found, elsewhere = linter_evidence(items, check_labels(labels))
        evidence.append(found)
        metadata["elsewhere"] = str(elsewhere)
    if config.margins:
        evidence.append(margin_evidence(items, LEAST))
    if config.undecided:
        evidence.append(undecided_evidence(items, probability))
    if other is not None:
        evidence += disputed_evidence(items, labels, other)
    if judgements is not None:
        evidence.append(items.rows(disagreements(judgements)))
        evidence.append(items.rows(((k, 0.0, "") for k in items.settled if k.kind != "relation"), settled=True))
    doubted = {"probability": probability.ravel(), "wrong": wrong.ravel()}
    return _ranked(labels, items, doubted, evidence).replace_schema_metadata(metadata)


def _ranked(
    labels: Labels, items: QueueItems, doubted: Mapping[str, np.ndarray], evidence: Sequence[EvidenceRows]
) -> pa.Table:
    cells, others = items.cells, list(items.others)
    none = EvidenceRows(np.zeros(0, np.int64), np.zeros(0), np.zeros(0, object))
    at, weight, reason = (np.concatenate(parts) for parts in zip(none, *evidence, strict=True))
    right = np.zeros(cells.states.size + len(others))
    np.add.at(right, at, np.log1p(-np.minimum(weight, 1 - 1e-12)))
    score = -np.expm1(right)
    cell = np.flatnonzero((score[: cells.states.size] >= LEAST) | items.settled_cells)
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
    frames = _by_key(labels.frames, ("frame",), "frame_index")
    objects = _by_key(labels.objects, ("frame", "object"), "label")
    sentences = _by_key(labels.expressions, ("frame", "id"), "text", "target_object", "reference_object")
    found: list[dict[str, Any]] = []
    for k in keys:
        row = {"frame": k.frame, "kind": k.kind, "frame_index": 0, "a": k.a, "b": k.b, **frames.get((k.frame,), {})}
        if k.kind == "object":
            found.append({**row, "place": k.what or None, **objects.get((k.frame, k.a), {})})
            continue
        said = sentences.get((k.frame, k.what), {})
        ends = {"a": said.get("target_object", k.a), "b": said.get("reference_object", k.b)}
        found.append({**row, **ends, "expression": k.what, "label": said.get("text")})
    return found


def _by_key(table: pa.Table, key: tuple[str, ...], *columns: str) -> dict[tuple[Any, ...], dict[str, Any]]:
    rows = table.select(list(columns)).to_pylist()
    return dict(zip(zip(*(table.column(name).to_pylist() for name in key), strict=True), rows, strict=True))
