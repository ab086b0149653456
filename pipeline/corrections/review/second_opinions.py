"""What is left for one reviewer: what is open, and a share of what others have settled, so that agreement is known."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import TYPE_CHECKING, Any

import numpy as np
import xxhash

from pipeline.corrections.review.items import (
    KINDS,
    SETTLED,
    STATES,
    ItemKey,
    State,
    item_keys,
    progress_counts,
    with_states,
)
from pipeline.corrections.review.reviewed import DISAGREE
from pipeline.corrections.review.states import Judgements, Word
from pipeline.metrics.kappa import Agreement, cohen_kappa
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


@dataclass(frozen=True, eq=False)
class PairAgreement:
    """How far two people agree.

    Attributes
    ----------
    first, second : str
    all : Agreement
        On all items that both have judged.
    kinds : dict of str to Agreement
        On those of a kind, where there are any.
    differ : tuple of (ItemKey, str, str)
        Items that they judge differently, and what each says, by frame and key.
    """

    first: str
    second: str
    all: Agreement
    kinds: dict[str, Agreement]
    differ: tuple[tuple[ItemKey, str, str], ...]

    def record(self) -> dict[str, Any]:
        """As JSON."""
        return {
            "reviewers": [self.first, self.second],
            **self.all.record(),
            "kinds": {kind: found.record() for kind, found in self.kinds.items()},
            "differ": [
                {"frame": k.frame, "kind": k.kind, "a": k.a, "b": k.b, "what": k.what, "said": [one, other]}
                for k, one, other in self.differ
            ],
        }


def pair_agreements(
    judgements: Judgements, inverse: Callable[[str], str | None]
) -> tuple[PairAgreement, ...]:
    """Each two people who have judged an item in common.

    Compared is each one's newest word, as of `Word.said`; who is unsure, or has withdrawn a word, has not judged.
    A settlement is nobody's own word, and does not bear on it. "a left of b" and "b right of a" are one item, so that
    what one key press says counts once.

    Parameters
    ----------
    judgements : Judgements
    inverse : callable
        What "b ... a" is called where "a RELATION b" is said, as of `Setting.inverse`; None where nothing is.
    """
    said = {
        author: {k: w.said for k, w in _folded(judgements.of(author), inverse).items() if w.status in SETTLED}
        for author in judgements.authors
    }
    found = []
    for first, second in combinations(said, 2):
        both = sorted(said[first].keys() & said[second].keys(), key=ItemKey.text)
        if not both:
            continue
        pairs = [(k, said[first][k], said[second][k]) for k in both]
        kinds = {kind: [p for p in pairs if p[0].kind == kind] for kind in KINDS}
        found.append(
            PairAgreement(
                first,
                second,
                _of_pairs(pairs),
                {kind: _of_pairs(of_kind) for kind, of_kind in kinds.items() if of_kind},
                tuple(p for p in pairs if p[1] != p[2]),
            )
        )
    return tuple(found)


def _folded(words: Mapping[ItemKey, Word], inverse: Callable[[str], str | None]) -> dict[ItemKey, Word]:
    """Words by one key for a relation and its mirror image: of the two the newer."""
    found: dict[ItemKey, Word] = {}
    for key, word in words.items():
        mirrored = inverse(key.what) if key.kind == "relation" else None
        if mirrored is not None and key.b is not None:
            key = min(key, key._replace(a=key.b, b=key.a, what=mirrored))
        if key not in found or word.at > found[key].at:
            found[key] = word
    return found


def _of_pairs(pairs: Sequence[tuple[ItemKey, str, str]]) -> Agreement:
    return cohen_kappa([p[1] for p in pairs], [p[2] for p in pairs])


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
