"""What reviewers have said, against the labels as they are now: what is settled, and what they disagree on.

A relation is settled where people agree on it, or somebody has settled it, and
the label says so too. Settled labels are taken as true: nothing speaks against
them any more, no noise is estimated from them, and networks learn from them in
every pass, with the weight of any other label.

How far reviewers agree is told by Cohen's kappa (Educational and Psychological
Measurement 20, 1960).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import combinations
from pathlib import Path
from typing import Any

from pipeline.corrections.journal.journal import Journal
from pipeline.corrections.journal.materialise import materialise
from pipeline.corrections.review.items import (
    KINDS,
    SETTLED,
    ItemKey,
    Judgement,
    Judgements,
    item_of,
    judgements_of,
)
from pipeline.corrections.review.queue import read_relation_labels, relation_states
from pipeline.datasets import Dataset
from pipeline.labels.reading import Labels, open_labels
from pipeline.metrics.intervals import Agreement, cohen_kappa


@dataclass(frozen=True, eq=False)
class Reviewed:
    """Labels as people have left them, and what people said."""

    labels: Labels
    """Effective ones, as a folder."""
    judgements: Judgements = field(default_factory=Judgements)


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
        both = sorted(verdict[first].keys() & verdict[second].keys(), key=str)
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
