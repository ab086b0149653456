"""What is left for one reviewer: what is open, and a share of what others have settled, so that agreement is known."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import xxhash

from pipeline.corrections.review.items import SETTLED, ItemKey, State, item_keys, with_states
from pipeline.corrections.review.reviewed import DISAGREE
from pipeline.corrections.review.states import Judgements
from pipeline.system.errors import InputError

if TYPE_CHECKING:
    import pyarrow as pa


def left_for(
    queue: pa.Table,
    judgements: Judgements,
    states: dict[ItemKey, State],
    author: str,
    *,
    overlap: float = 0.0,
    second_opinion_of: str | None = None,
) -> pa.Table:
    """The rows of a queue that a reviewer is to look at, in its order, with a column `state` of their own.

    What others said is not shown: a second opinion is worth something where it
    is independent. Items that this person has judged are not asked again, also
    where another says otherwise: they stand first in the queue of all.

    Parameters
    ----------
    queue : pyarrow.Table
    judgements : Judgements
    states : dict of ItemKey to str
        Over all people.
    author : str
    overlap : float
        Share, 0 to 1, of what others have settled that is asked again; which items these are depends on nothing but
        their names, so that it is the same share for each reviewer and every day. They are strewn among the others.
    second_opinion_of : str, optional
        Instead: what this person has judged, and `author` has not; of these the share `overlap`, or all where it is 0.

    Raises
    ------
    InputError
        The share is none, or somebody is to be their own second.
    """
    if not 0 <= overlap <= 1:
        raise InputError("the overlap is a share from 0 to 1", got=overlap)
    if second_opinion_of == author:
        raise InputError("a second opinion is another person's", got=author)
    own = judgements.states(author)
    keys = item_keys(queue)
    theirs = {} if second_opinion_of is None else judgements.states(second_opinion_of)
    share = overlap if second_opinion_of is None else overlap or 1.0
    first, again = [], []
    for place, key in enumerate(keys):
        if own.get(key, "unreviewed") in SETTLED:
            continue
        by_another = theirs.get(key) in SETTLED if second_opinion_of is not None else states.get(key) in SETTLED
        if by_another and drawn(key) < share:
            again.append(place)
        elif second_opinion_of is None and not by_another:
            first.append(place)
    unsure = [k for k in first if own.get(keys[k]) == "unsure"]
    first = [k for k in first if own.get(keys[k]) != "unsure"]
    order = [*_strewn(first, again, keys), *unsure]
    return _without_others(with_states(queue, own).take(np.array(order, np.int64)))


def drawn(key: ItemKey) -> float:
    """A number from 0 to 1 that hangs on the item's name alone."""
    return xxhash.xxh3_64_intdigest(key.text().encode("utf-8", "replace")) / 2**64


def _strewn(first: list[int], again: list[int], keys: list[ItemKey]) -> list[int]:
    """`again` among `first`, each at a place that hangs on its name: at the end they would be known for others'."""
    where = {k: drawn(keys[k]._replace(frame=f"place {keys[k].frame}")) * len(first) for k in again}
    ranked = [(n + 0.5, 0, k) for n, k in enumerate(first)] + [(where[k], 1, k) for k in again]
    return [k for _, _, k in sorted(ranked)]


def _without_others(queue: pa.Table) -> pa.Table:
    """The queue without the reasons that tell what people said."""
    import pyarrow as pa

    at = queue.schema.get_field_index("reasons")
    reasons = [[r for r in row if not r.startswith(DISAGREE)] for row in queue.column("reasons").to_pylist()]
    field = queue.schema.field(at)
    return queue.set_column(at, field, pa.array(reasons, field.type))
