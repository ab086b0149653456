"""What reviewers have said, against the labels as they are now: what is settled, and what they disagree on.

A relation is settled where people agree on it, or somebody has settled it, and
the label says so too. Settled labels are taken as true: nothing speaks against
them any more, no noise is estimated from them, and networks learn from them in
every pass, with the weight of any other label.

How far reviewers agree is told by Cohen's kappa (Educational and Psychological
Measurement 20, 1960), and how far a review has come by state, kind, person and day.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
import xxhash

from pipeline.corrections.journal.journal import Journal
from pipeline.corrections.journal.materialise import materialise
from pipeline.corrections.review.evidence import Reason, RelationLabels, read_relation_labels
from pipeline.corrections.review.items import (
    DISAGREED,
    KINDS,
    SETTLED,
    STATES,
    ItemKey,
    Judgement,
    Judgements,
    State,
    item_keys,
    item_of,
    judgements_of,
    key_stands,
    progress_counts,
    with_states,
)
from pipeline.corrections.review.out_of_fold import unstacked
from pipeline.datasets import Dataset
from pipeline.labels.reading import Labels, open_labels
from pipeline.labels.schema import Manifest, labels_version
from pipeline.metrics.intervals import Agreement, cohen_kappa
from pipeline.relations.relations import F, T, U
from pipeline.system.arrow import pa
from pipeline.system.errors import require
from pipeline.training.label_data import LabelData

DISAGREE = "reviewers disagree"
"""How the reason begins."""


@dataclass(frozen=True, eq=False)
class Reviewed:
    """Labels as people have left them, and what people said."""

    labels: Labels
    """Effective ones, as a folder."""
    judgements: Judgements = field(default_factory=lambda: Judgements({}, {}))


def reviewed_labels(labels: Labels, journal: Journal, folder: Path, dataset: Dataset | None = None) -> Reviewed:
    """Apply a journal to labels, and read the judgements in it.

    `folder`: a new or empty one, into which effective labels are written; it is left alone where there are no
    corrections.

    Raises InputError: the labels, the journal or a frame cannot be read.
    """
    events = journal.events()
    if not events:
        return Reviewed(labels)
    _, found = materialise(labels, journal, folder, dataset=dataset)
    # Where labels say by now what they were corrected to, the word on them holds.
    ignored = {u.event.ulid for u in found.unapplied if u.kind != "agreed"}
    automatic = relation_states(
        read_relation_labels(labels),
        {key for event in events if (key := item_of(event.ref)) is not None and key.kind == "relation"},
    )
    return Reviewed(open_labels(folder), judgements_of(events, automatic=automatic.get, ignored=ignored))


def relation_states(cells: RelationLabels, keys: set[ItemKey]) -> dict[ItemKey, int]:
    """T, U or F of the items with a state in the labels."""
    numbers, known = cells.cells_of(keys)
    states = cells.states.ravel()[numbers].tolist()
    return {key: state for key, state in zip(known, states, strict=True) if state in (T, U, F)}


def states_on_labels(judgements: Judgements, cells: RelationLabels) -> dict[ItemKey, State]:
    """The state of each item over all, see `Judgements.states_now`."""
    return judgements.states_now(relation_states(cells, set(judgements.states())).get)


def without_gone(queue: pa.Table, labels: Labels, states: Mapping[ItemKey, State]) -> pa.Table:
    """A stored queue without items that the labels have lost since.

    It is what `worklist.gone_items` finds frame by frame.

    `labels`: effective ones.
    """
    keys = item_keys(queue)
    pairs = set(read_relation_labels(labels).cells_of(keys)[1])
    frames = set(labels.frames.column("frame").to_pylist())
    objects, expressions = (
        set(zip(*(table.column(name).to_pylist() for name in ("frame", number)), strict=True))
        for table, number in ((labels.objects, "object"), (labels.expressions, "id"))
    )

    return queue.filter([key_stands(key, states, frames, pairs, objects, expressions) for key in keys])


def trusted_of_data(cells: RelationLabels, settled: np.ndarray, data: LabelData) -> tuple[np.ndarray, ...]:
    """(N, N, R) bool of each frame: settled cells in the order of the data's objects and relations."""
    columns = [cells.relations.index(r) for r in data.vocabulary]
    pairs = (
        [(f.key.frame, int(a), int(b)) for f in data.frames for a in f.objects for b in f.objects if a != b]
        if settled.any()
        else []
    )
    sizes = [len(f.objects) for f in data.frames]
    found = np.zeros((sum(n * (n - 1) for n in sizes), len(columns)), np.bool_)
    if pairs:
        rows = cells.rows_of(pairs)
        found[rows >= 0] = settled[rows[rows >= 0]][:, columns]
    return unstacked(found, sizes)


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


def automatic_version(manifest: Manifest) -> str:
    """Version of the automatic labels behind these: see `labels_version`."""
    stated = (manifest.corrections or {}).get("automatic")
    return str(stated) if stated else labels_version(manifest)


def left_for(
    queue: pa.Table,
    judgements: Judgements,
    states: dict[ItemKey, State],
    author: str,
    *,
    overlap: float = 0.0,
    second_opinion_of: str | None = None,
) -> pa.Table:
    """Rows of a queue left for a reviewer, in order, with a column `state` of the reviewer's own.

    What others said is not shown: a second opinion is worth something where it
    is independent. Items that this person has judged are not asked again, also
    where another says otherwise: they stand first in the queue of all.

    `states`: over all people. `overlap`: share, 0 to 1, of what others have settled that is asked again; which items
    these are depends on nothing but their names, so that it is the same share for each reviewer and every day. They are
    strewn among the others. `second_opinion_of`: instead: what this person has judged, and `author` has not; of these
    the share `overlap`, or all where it is 0.

    Raises InputError: the share is none, or somebody is to be their own second.
    """
    require(0 <= overlap <= 1, "the overlap is a share from 0 to 1", got=overlap)
    require(second_opinion_of != author, "a second opinion is another person's", got=author)
    own = judgements.states(author)
    keys = item_keys(queue)
    theirs = {} if second_opinion_of is None else judgements.states(second_opinion_of)
    share = overlap if second_opinion_of is None else overlap or 1.0
    by_another = states if second_opinion_of is None else theirs
    open_keys = [(index, key) for index, key in enumerate(keys) if own.get(key) not in SETTLED]
    again = [k for k, key in open_keys if by_another.get(key) in SETTLED and drawn(key) < share]
    rest = [] if second_opinion_of else [k for k, key in open_keys if states.get(key) not in SETTLED]
    unsure = [k for k in rest if own.get(keys[k]) == "unsure"]
    order = [*_strewn([k for k in rest if own.get(keys[k]) != "unsure"], again, keys), *unsure]
    return _without_others(with_states(queue, own).take(np.array(order, np.int64)))


def drawn(key: ItemKey) -> float:
    """Number from 0 to 1 by hash of the item's name."""
    return xxhash.xxh3_64_intdigest(key.text().encode("utf-8", "replace")) / 2**64


def _strewn(first: list[int], again: list[int], keys: list[ItemKey]) -> list[int]:
    where = {k: drawn(keys[k]._replace(frame=f"place {keys[k].frame}")) * len(first) for k in again}
    ranked = [(n + 0.5, 0, k) for n, k in enumerate(first)] + [(where[k], 1, k) for k in again]
    return [k for _, _, k in sorted(ranked)]


def _without_others(queue: pa.Table) -> pa.Table:
    at = queue.schema.get_field_index("reasons")
    reasons = [[r for r in row if not r.startswith(DISAGREE)] for row in queue.column("reasons").to_pylist()]
    field = queue.schema.field(at)
    return queue.set_column(at, field, pa.array(reasons, field.type))


@dataclass(frozen=True, eq=False)
class PairAgreement:
    """How far two people agree."""

    first: str
    second: str
    all: Agreement
    """On all items that both have judged."""
    kinds: dict[str, Agreement]
    """On those of a kind, where there are any."""
    differ: tuple[tuple[ItemKey, str, str], ...]
    """tuple of (ItemKey, str, str): items that they judge differently, and what each says, by frame and key."""

    def record(self) -> dict[str, Any]:
        """The agreement as JSON."""
        return {
            "reviewers": [self.first, self.second],
            **self.all.record(),
            "kinds": {kind: found.record() for kind, found in self.kinds.items()},
            "differ": [
                {"frame": k.frame, "kind": k.kind, "a": k.a, "b": k.b, "what": k.what, "said": [one, other]}
                for k, one, other in self.differ
            ],
        }


def pair_agreements(judgements: Judgements, inverse: Callable[[str], str | None]) -> tuple[PairAgreement, ...]:
    """Agreement of each two people with judged items in common.

    Compared is each one's newest word (`Judgement.verdict`); who is unsure, or has withdrawn a word, has not judged.
    A settlement is nobody's own word, and does not bear on it. "a left of b" and "b right of a" are one item, so that
    what one key press says counts once.

    `inverse`: what "b ... a" is called where "a RELATION b" is said, as of `Setting.inverse`; None where nothing is.
    """
    verdict = {
        author: {k: w.verdict for k, w in _folded(judgements.of(author), inverse).items() if w.status in SETTLED}
        for author in judgements.authors
    }
    found = []
    for first, second in combinations(verdict, 2):
        both = sorted(verdict[first].keys() & verdict[second].keys(), key=ItemKey.text)
        if not both:
            continue
        pairs = [(k, verdict[first][k], verdict[second][k]) for k in both]
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


def _folded(words: Mapping[ItemKey, Judgement], inverse: Callable[[str], str | None]) -> dict[ItemKey, Judgement]:
    found: dict[ItemKey, Judgement] = {}
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

    `queue`: of these labels, made now or stored before. `states`: over all people.

    Returns `progress_counts` of the queue, and: share (of the queue that is settled; None of an empty one), kinds (the
    counts by kind of item), reviewers (by person: items in each state, by their own words), days (by day, UTC: items by
    their newest word), disagreements (items on which reviewers say different things), estimated_wrong (relation labels
    that are still wrong by confident learning; None where no network was asked).
    """
    counts = progress_counts(queue, states)
    column = np.array(queue.column("kind").to_pylist(), object)
    kinds = {
        kind: progress_counts(queue.filter(column == kind), {k: s for k, s in states.items() if k.kind == kind})
        for kind in KINDS
    }
    opinions = {author: Counter(judgements.states(author).values()) for author in judgements.authors}
    newest = [max(words.values(), key=lambda w: w.at) for words in judgements.words.values()]
    days = Counter(w.time.date().isoformat() for w in newest if w.status != "unreviewed")
    return {
        **counts,
        "share": counts["settled"] / counts["items"] if counts["items"] else None,
        "kinds": kinds,
        "reviewers": {author: {s: n[s] for s in STATES if s != "unreviewed"} for author, n in opinions.items()},
        "days": dict(sorted(days.items())),
        "disagreements": sum(judgements.differ(key) for key in judgements.words),
        "estimated_wrong": wrong_left(queue, states),
    }


def wrong_left(queue: pa.Table, states: Mapping[ItemKey, State]) -> float | None:
    """Estimated wrong relation labels, times the share of doubts on labels still open; None without networks."""
    estimated = (queue.schema.metadata or {}).get(b"estimated_wrong")
    if estimated is None:
        return None
    wrong = np.nan_to_num(queue.column("wrong").to_numpy(zero_copy_only=False).astype(np.float64))
    is_open = np.array([states.get(key) not in SETTLED for key in item_keys(queue)], np.bool_)
    total = wrong.sum()
    return float(estimated) * float(wrong[is_open].sum() / total) if total > 0 else 0.0
