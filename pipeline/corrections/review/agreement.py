"""How far two reviewers agree: Cohen's kappa (Educational and Psychological Measurement 20, 1960)."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Any

from pipeline.corrections.review.items import KINDS, SETTLED, ItemKey
from pipeline.corrections.review.states import Judgements, Word
from pipeline.metrics.significance import Agreement, Key, cohen_kappa


def agreement_of(first: Mapping[Key, str], second: Mapping[Key, str]) -> Agreement:
    """Agreement on the items that both have reviewed: "unreviewed" is no judgement."""
    none = "unreviewed"
    both = [key for key, said in first.items() if said != none and second.get(key, none) != none]
    return cohen_kappa([first[key] for key in both], [second[key] for key in both])


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
