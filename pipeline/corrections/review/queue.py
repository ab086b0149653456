"""The review queue: labels ranked by how probably they are wrong, each with the reasons in words."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from pipeline.corrections.review.evidence import (
    ItemEvidence,
    RelationEvidence,
    RelationLabels,
    combined,
    disputed_evidence,
    doubts_of_labels,
    letters,
    linter_evidence,
    margin_evidence,
    network_evidence,
    read_relation_labels,
    undecided_evidence,
)
from pipeline.corrections.review.items import SETTLED, Judgements
from pipeline.corrections.review.out_of_fold import DoubtConfig, Doubts, doubt_labels
from pipeline.corrections.review.reviewed import (
    automatic_version,
    disagreement_evidence,
    settled_relations,
    states_on_labels,
    trusted_of_data,
    without_settled,
)
from pipeline.labels.check.linter import check_labels
from pipeline.labels.reading import Labels
from pipeline.system.arrow import pa
from pipeline.training.label_data import LabelData, read_label_data

LEAST = 0.02
"""Evidence that is weaker is not worth a reason, and a label without any is not in the queue."""


@dataclass(frozen=True)
class QueueConfig:
    """What a queue is made from.

    Attributes
    ----------
    doubts : DoubtConfig or None
        None: without networks.
    linter, margins, undecided : bool
        Whether findings of `check_labels`, small margins, and U cells are looked at.
    limit : int or None
        At most so many items.
    """

    doubts: DoubtConfig | None = field(default_factory=DoubtConfig)
    linter: bool = True
    margins: bool = True
    undecided: bool = True
    limit: int | None = None


def review_queue(
    labels: Labels,
    config: QueueConfig | None = None,
    *,
    other: Labels | None = None,
    judgements: Judgements | None = None,
    doubts: tuple[LabelData, Doubts] | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> pa.Table:
    """The labels that are most probably wrong, the worst first.

    Parameters
    ----------
    labels : Labels
    config : QueueConfig, optional
    other : Labels, optional
        Of the same dataset, by another detector or run: what they say otherwise counts too.
    judgements : Judgements, optional
        What people said of these labels, which are effective ones then: see `reviewed_labels`. What is settled has no
        evidence against it, and stands last, with a score of 0.
    doubts : (LabelData, Doubts), optional
        Where the networks were already asked.
    progress : callable, optional
        Called with (networks trained, of how many).

    Returns
    -------
    pyarrow.Table
        One row an item: frame (string), frame_index (int32), kind ("relation", "object", "expression"), a, b (int32,
        numbers of objects; b null for objects), relation, expression (its id), place, label (T, U or F; the class
        name; the text), probability (float64, that the relation holds, by networks that have not learnt from it; null
        without), wrong (float64, that the label is wrong by confident learning alone; null for U, for what is settled,
        and without networks), score (float64, the same by all evidence), reasons (list of string, the strongest first).
        Metadata: `estimated_wrong` relation labels of those that are not settled; `elsewhere`, findings that are of no
        single label; `labels_version`, the automatic labels that it is of. Where an object may be missing, `row_of`
        tells where (x0,y0,x1,y1), `a` is -1, and the label is the class. The label of an object that was left out is
        null.

    Raises
    ------
    InputError
        The labels are damaged, or hold nothing to learn from.
    MissingExtra
        torch is not installed.
    """
    config = config or QueueConfig()
    cells = read_relation_labels(labels)
    probability = wrong = np.full(cells.states.shape, np.nan)
    parts: list[RelationEvidence] = []
    items: list[ItemEvidence] = []
    metadata = {"elsewhere": "0", "labels_version": automatic_version(labels.manifest)}
    states = {} if judgements is None else states_on_labels(judgements, cells)
    settled = settled_relations(cells, states)
    if doubts is None and config.doubts is not None:
        data = read_label_data(labels, config.doubts.train.features, labels.relation_names)
        trusted = trusted_of_data(cells, settled, data)
        doubts = data, doubt_labels(data, config.doubts, trusted=trusted, progress=progress)
    if doubts is not None:
        probability, wrong = doubts_of_labels(cells, *doubts)
        wrong = np.where(settled, np.nan, wrong)
        parts.append(network_evidence(cells, probability, wrong, LEAST))
        metadata["estimated_wrong"] = f"{sum(n.wrong for n in doubts[1].noise.values()):.0f}"
    if config.linter:
        found, of_items, elsewhere = linter_evidence(cells, check_labels(labels))
        parts.append(found)
        items += of_items
        metadata["elsewhere"] = str(elsewhere)
    if config.margins:
        parts.append(margin_evidence(cells, LEAST))
    if config.undecided:
        parts.append(undecided_evidence(cells, probability))
    if other is not None:
        found, of_items = disputed_evidence(labels, cells, other)
        parts.append(found)
        items += of_items
    if judgements is not None:
        parts = [without_settled(part, settled) for part in parts]
        items = [item for item in items if states.get(item.key.plain) not in SETTLED]
        found, of_items = disagreement_evidence(cells, judgements)
        parts.append(found)
        items += of_items
        items += [ItemEvidence(k, 0.0, "") for k, s in states.items() if s in SETTLED and k.kind != "relation"]
    return _ranked(
        _merged(_relation_rows(cells, parts, probability, wrong, settled), _item_rows(labels, items)),
        config.limit,
        metadata,
    )


def _relation_rows(
    cells: RelationLabels,
    parts: Sequence[RelationEvidence],
    probability: np.ndarray,
    wrong: np.ndarray,
    settled: np.ndarray,
) -> dict[str, Any]:
    score = combined(parts, (len(cells), len(cells.relations)))
    row, column = np.nonzero((score >= LEAST) | settled)
    number = np.full(score.shape, -1, np.int64)
    number[row, column] = np.arange(len(row))
    return {
        "frame": cells.frame[row],
        "frame_index": cells.frame_index[row],
        "kind": np.full(len(row), "relation", object),
        "a": cells.a[row],
        "b": cells.b[row].astype(np.float64),
        "relation": np.array(cells.relations, object)[column],
        "expression": np.full(len(row), None, object),
        "place": np.full(len(row), None, object),
        "label": letters(cells.states[row, column]).astype(object),
        "probability": probability[row, column],
        "wrong": wrong[row, column],
        "score": score[row, column],
        "order": column,
        "evidence": [(number[p.rows, p.columns], p.weight, p.reason.astype(object)) for p in parts],
    }


def _item_rows(labels: Labels, items: Sequence[ItemEvidence]) -> dict[str, Any]:
    """One row an object or expression, whatever the number of findings."""
    keys = list(dict.fromkeys(item.key.plain for item in items))
    row_of = {key: row for row, key in enumerate(keys)}
    at = np.array([row_of[item.key.plain] for item in items], np.int64)
    weight = np.array([item.weight for item in items], np.float64)
    right = np.zeros(len(keys))
    np.add.at(right, at, np.log1p(-weight))
    index = _looked_up(labels.frames, "frame_index") if keys else {}
    names = _looked_up(labels.objects, "label", "object") if keys else {}
    sentences = {
        column: _looked_up(labels.expressions, column, "id") if keys else {}
        for column in ("text", "target_object", "reference_object")
    }
    known = [(k.frame, k.a if k.kind == "object" else k.what) for k in keys]
    of = {"object": names, "expression": sentences["text"]}
    label = [of[k.kind].get(name) for k, name in zip(keys, known, strict=True)]
    numbers = [
        (sentences["target_object"].get(n, k.a), sentences["reference_object"].get(n, k.b))
        if k.kind == "expression" else (k.a, k.b) for k, n in zip(keys, known, strict=True)
    ]  # fmt: skip
    nothing = np.full(len(keys), np.nan)
    return {
        "frame": _objects([k.frame for k in keys]),
        "frame_index": np.array([index.get((k.frame,), 0) for k in keys], np.int64),
        "kind": _objects([k.kind for k in keys]),
        "a": np.array([a for a, _ in numbers], np.int64),
        "b": np.array([np.nan if b is None else b for _, b in numbers], np.float64),
        "relation": np.full(len(keys), None, object),
        "expression": _objects([k.what if k.kind == "expression" else None for k in keys]),
        "place": _objects([k.what if k.kind == "object" and k.what else None for k in keys]),
        "label": _objects(label),
        "probability": nothing,
        "wrong": nothing,
        "score": -np.expm1(right),
        "order": np.full(len(keys), -1, np.int64),
        "evidence": [(at, weight, _objects([item.reason for item in items]))],
    }


def _looked_up(table: pa.Table, value: str, *key: str) -> dict[tuple[Any, ...], Any]:
    """A column of a table of labels, by the frame and what names the row there."""
    columns = (table.column(name).to_pylist() for name in (value, "frame", *key))
    return {tuple(named): found for found, *named in zip(*columns, strict=True)}


def _objects(values: Sequence[Any]) -> np.ndarray:
    found = np.empty(len(values), object)
    found[:] = values
    return found


def _merged(first: dict[str, Any], second: dict[str, Any]) -> dict[str, Any]:
    shift = len(first["a"])
    merged = {k: np.concatenate([first[k], second[k]]) for k in first if k != "evidence"}
    return {
        **merged,
        "evidence": [*first["evidence"], *((at + shift, weight, reason) for at, weight, reason in second["evidence"])],
    }


def _ranked(columns: dict[str, Any], limit: int | None, metadata: dict[str, str]) -> pa.Table:
    keys = ("order", "b", "a", "frame_index", "score")
    order = np.lexsort([-columns[k] if k == "score" else np.nan_to_num(columns[k], nan=-1) for k in keys])
    order = order if limit is None else order[: max(limit, 0)]
    rank = np.full(len(columns["a"]), -1, np.int64)
    rank[order] = np.arange(len(order))
    # That of items is always there, if empty.
    index, weight, texts = (np.concatenate([e[k] for e in columns["evidence"]]) for k in range(3))
    # A label whose evidence is all too weak has no row: its place is -1.
    at = rank[index]
    kept = np.flatnonzero((at >= 0) & (weight >= LEAST))
    kept = kept[np.lexsort((-weight[kept], at[kept]))]
    offsets = np.concatenate([[0], np.cumsum(np.bincount(at[kept], minlength=len(order)))])
    reasons = pa.ListArray.from_arrays(pa.array(offsets, pa.int32()), pa.array(texts[kept], pa.string()))
    kinds = {"frame_index": pa.int32(), "a": pa.int32(), "b": pa.int32()}
    arrays = {}
    for name in ("frame", "frame_index", "kind", "a", "b", "relation", "expression", "place", "label", "probability",
                 "wrong", "score"):  # fmt: skip
        values = columns[name][order]
        kind = kinds.get(name, pa.string() if values.dtype == object else pa.float64())
        arrays[name] = pa.array(values, kind, from_pandas=True, safe=False)
    return pa.table({**arrays, "reasons": reasons}).replace_schema_metadata(metadata)
