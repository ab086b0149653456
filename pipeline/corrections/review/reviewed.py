"""What reviewers have said, against the labels as they are now: what is settled, and what they disagree on.

A relation is settled where people agree on it, or somebody has settled it, and
the label says so too. Settled labels are taken as true: nothing speaks against
them any more, no noise is estimated from them, and networks learn from them in
every pass, with the weight of any other label.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from pipeline.corrections.journal.journal import Journal
from pipeline.corrections.journal.materialise import materialise
from pipeline.corrections.review.evidence import CellEvidence, ItemEvidence, RelationLabels, read_cells
from pipeline.corrections.review.items import DISAGREED, SETTLED, ItemKey, State, item_keys
from pipeline.corrections.review.out_of_fold import unstacked
from pipeline.corrections.review.states import Judgements, item_of, judgements_of
from pipeline.datasets import Dataset
from pipeline.labels.reading import Labels, open_labels
from pipeline.labels.schema import Manifest, labels_version
from pipeline.relations.relations import F, T, U, letter
from pipeline.training.label_data import LabelData

if TYPE_CHECKING:
    import pyarrow as pa



@dataclass(frozen=True, eq=False)
class Reviewed:
    """Labels as people have left them, and what people said.

    Attributes
    ----------
    labels : Labels
        Effective ones, as a folder.
    judgements : Judgements
    """

    labels: Labels
    judgements: Judgements = field(default_factory=lambda: Judgements({}, {}))


def reviewed_labels(labels: Labels, journal: Journal, folder: Path, dataset: Dataset | None = None) -> Reviewed:
    """Apply a journal to labels, and read what people said of them.

    Parameters
    ----------
    folder : Path
        A new or empty one, into which effective labels are written; it is left alone where there are no corrections.
    dataset : Dataset, optional
        As of `materialise`.

    Raises
    ------
    InputError
        The labels, the journal or a frame cannot be read.
    """
    events = journal.events()
    if not events:
        return Reviewed(labels)
    _, found = materialise(labels, journal, folder, dataset=dataset)
    # Where labels say by now what they were corrected to, the word on them holds.
    ignored = {u.event.ulid for u in found.unapplied if u.kind != "agreed"}
    keys = {key for event in events if (key := item_of(event.cell)) is not None and key.kind == "relation"}
    automatic = relation_states(read_cells(labels), keys)
    return Reviewed(open_labels(folder), judgements_of(events, automatic=automatic.get, ignored=ignored))


def relation_states(cells: RelationLabels, keys: set[ItemKey]) -> dict[ItemKey, int]:
    """T, U or F of those of the items that are relations of the labels and have a state."""
    wanted, rows, columns = _places(cells, keys)
    states = cells.states[rows, columns].tolist()
    return {key: state for key, state in zip(wanted, states, strict=True) if state in (T, U, F)}


def _places(cells: RelationLabels, keys: set[ItemKey]) -> tuple[list[ItemKey], np.ndarray, np.ndarray]:
    wanted = [k for k in keys if k.kind == "relation" and k.what in cells.relations]
    rows = cells.rows_of([(k.frame, k.a, -1 if k.b is None else k.b) for k in wanted])
    columns = np.array([cells.relations.index(k.what) for k in wanted], np.int64)
    there = rows >= 0
    return [k for k, known in zip(wanted, there.tolist(), strict=True) if known], rows[there], columns[there]


def states_on_labels(judgements: Judgements, cells: RelationLabels) -> dict[ItemKey, State]:
    """The state of each item over all; "unsure" of a relation whose label is not what people said of it.

    That is so where labels were made again, and where the only word on a label is that of a second opinion.
    """
    states = judgements.states()
    now = relation_states(cells, set(states))
    for key, state in now.items():
        said = judgements.said(key)
        if said in ("T", "U", "F") and said != letter(state):
            states[key] = "unsure"
    return states


def without_gone(queue: pa.Table, labels: Labels, states: Mapping[ItemKey, State]) -> pa.Table:
    """A queue that was made before, without items of which nothing is left in the labels as they are now.

    It is what `following.gone_items` finds frame by frame.

    Parameters
    ----------
    queue : pyarrow.Table
    labels : Labels
        Effective ones.
    states : mapping of ItemKey to str
        As of `states_on_labels`.
    """
    keys = item_keys(queue)
    pairs = set(_places(read_cells(labels), {k for k in keys if k.kind == "relation"})[0])
    frames = set(labels.frames.column("frame").to_pylist())
    objects, expressions = (
        set(zip(*(table.column(name).to_pylist() for name in ("frame", number)), strict=True))
        for table, number in ((labels.objects, "object"), (labels.expressions, "id"))
    )

    def stands(key: ItemKey) -> bool:
        if key.kind == "relation":
            return key in pairs
        if states.get(key) in SETTLED:
            return True
        if key.kind == "expression":
            return (key.frame, key.what) in expressions
        return key.frame in frames if key.a < 0 else (key.frame, key.a) in objects

    return queue.filter([stands(key) for key in keys])


def settled_cells(cells: RelationLabels, states: Mapping[ItemKey, State]) -> np.ndarray:
    """(P, R) bool: the relation labels that are settled."""
    found = np.zeros(cells.states.shape, np.bool_)
    _, rows, columns = _places(cells, {k for k, state in states.items() if state in SETTLED})
    found[rows, columns] = True
    return found


def trusted_of_data(cells: RelationLabels, settled: np.ndarray, data: LabelData) -> tuple[np.ndarray, ...]:
    """(N, N, R) bool of each frame: settled cells in the order of the data's objects and relations."""
    columns = [cells.relations.index(r) for r in data.vocabulary]
    pairs = [
        (f.key.frame, int(a), int(b)) for f in data.frames for a in f.objects for b in f.objects if a != b
    ] if settled.any() else []  # fmt: skip
    sizes = [len(f.objects) for f in data.frames]
    found = np.zeros((sum(n * (n - 1) for n in sizes), len(columns)), np.bool_)
    if pairs:
        rows = cells.rows_of(pairs)
        found[rows >= 0] = settled[rows[rows >= 0]][:, columns]
    return unstacked(found, sizes)


def without_settled(evidence: CellEvidence, settled: np.ndarray) -> CellEvidence:
    """The evidence against labels that are open."""
    kept = ~settled[evidence.rows, evidence.columns]
    return CellEvidence(evidence.rows[kept], evidence.columns[kept], evidence.weight[kept], evidence.reason[kept])


def disagreement_evidence(
    cells: RelationLabels, judgements: Judgements
) -> tuple[CellEvidence, tuple[ItemEvidence, ...]]:
    """Items on which reviewers say different things, and what each says."""
    differ = {key: _who_says(judgements, key) for key in judgements.words if judgements.differ(key)}
    keys, rows, columns = _places(cells, set(differ))
    reason = np.array([differ[key] for key in keys], object)
    items = tuple(ItemEvidence(k, DISAGREED, why) for k, why in differ.items() if k.kind != "relation")
    return CellEvidence(rows, columns, np.full(len(rows), DISAGREED), reason), items


def _who_says(judgements: Judgements, key: ItemKey) -> str:
    words = sorted((w for w in judgements.words[key].values() if w.status in SETTLED), key=lambda w: w.at)
    return f"{DISAGREE}: " + ", ".join(f"{w.author} says {w.said}" for w in words)


DISAGREE = "reviewers disagree"
"""How the reason begins."""


def automatic_version(manifest: Manifest) -> str:
    """Which automatic labels these are, or were made from by corrections: see `labels_version`."""
    stated = (manifest.corrections or {}).get("automatic")
    return str(stated) if stated else labels_version(manifest)
