"""How far a review has come: by state, by kind of item, by reviewer, by day, and how many labels are still wrong."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from pipeline.corrections.review.items import KINDS, SETTLED, STATES, ItemKey, State, item_keys, progress_counts
from pipeline.corrections.review.states import Judgements

if TYPE_CHECKING:
    import pyarrow as pa


def review_progress(queue: pa.Table, judgements: Judgements, states: Mapping[ItemKey, State]) -> dict[str, Any]:
    """Counts as JSON.

    Parameters
    ----------
    queue : pyarrow.Table
        Of these labels, made now or stored before.
    judgements : Judgements
    states : mapping of ItemKey to str
        Over all people.

    Returns
    -------
    dict
        `progress_counts` of the queue, and: share (of the queue that is settled; None of an empty one), kinds (the
        counts by kind of item), reviewers (by person: items in each state, by their own words), days (by day, UTC:
        items by their newest word), disagreements (items on which reviewers say different things), estimated_wrong
        (relation labels that are still wrong by confident learning; None where no network was asked).
    """
    counts = progress_counts(queue, states)
    column = np.array(queue.column("kind").to_pylist(), object)
    kinds = {}
    for kind in KINDS:
        of_kind: dict[ItemKey, State] = {key: state for key, state in states.items() if key.kind == kind}
        kinds[kind] = progress_counts(queue.filter(column == kind), of_kind)
    reviewers = {}
    for author in judgements.authors:
        of_author = Counter(judgements.states(author).values())
        reviewers[author] = {state: of_author.get(state, 0) for state in STATES if state != "unreviewed"}
    newest = [max(words.values(), key=lambda w: w.at) for words in judgements.words.values()]
    days = Counter(w.time.date().isoformat() for w in newest if w.status != "unreviewed")
    return {
        **counts,
        "share": counts["settled"] / counts["items"] if counts["items"] else None,
        "kinds": kinds,
        "reviewers": reviewers,
        "days": dict(sorted(days.items())),
        "disagreements": sum(judgements.differ(key) for key in judgements.words),
        "estimated_wrong": wrong_left(queue, states),
    }


def wrong_left(queue: pa.Table, states: Mapping[ItemKey, State]) -> float | None:
    """How many relation labels are still wrong: what confident learning estimated when the queue was made, times the
    share of its doubts that is on labels still open. None where no network was asked."""
    estimated = (queue.schema.metadata or {}).get(b"estimated_wrong")
    if estimated is None:
        return None
    wrong = np.nan_to_num(queue.column("wrong").to_numpy(zero_copy_only=False).astype(np.float64))
    is_open = np.array([states.get(key) not in SETTLED for key in item_keys(queue)], np.bool_)
    total = wrong.sum()
    return float(estimated) * float(wrong[is_open].sum() / total) if total > 0 else 0.0
