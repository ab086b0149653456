"""How far two reviewers agree: Cohen's kappa (Educational and Psychological Measurement 20, 1960)."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Any, TypeVar

import numpy as np

from pipeline.corrections.review.items import KINDS, SETTLED, ItemKey
from pipeline.corrections.review.states import Judgements, Word
from pipeline.system.errors import InputError

Key = TypeVar("Key", bound=Hashable)


@dataclass(frozen=True, eq=False)
class Agreement:
    """Two reviewers' judgements of the same items.

    Attributes
    ----------
    judgements : tuple of str
        What either said, sorted: the order of rows and columns.
    table : (J, J) int64
        Items by what the first said (rows) and the second (columns).
    observed, expected : float
        Share of items judged alike, and the share by chance with each one's own habits; NaN without items.
    kappa : float
        (observed - expected) / (1 - expected); NaN where both always said the same one thing.
    """

    judgements: tuple[str, ...]
    table: np.ndarray
    observed: float
    expected: float
    kappa: float

    @property
    def items(self) -> int:
        return int(self.table.sum())

    def record(self) -> dict[str, Any]:
        """As JSON; None where a figure has no meaning."""
        figures = {name: float(getattr(self, name)) for name in ("observed", "expected", "kappa")}
        return {
            "items": self.items,
            **{name: value if np.isfinite(value) else None for name, value in figures.items()},
            "judgements": list(self.judgements),
            "table": self.table.tolist(),
        }


def cohen_kappa(first: Sequence[str], second: Sequence[str]) -> Agreement:
    """Agreement on items that both judged, in the same order.

    Raises
    ------
    InputError
        Not one judgement of each for every item.
    """
    if len(first) != len(second):
        raise InputError("both reviewers must have judged the same items", got=f"{len(first)} and {len(second)}")
    names, codes = np.unique(np.array([*first, *second], np.str_), return_inverse=True)
    table = np.zeros((len(names), len(names)), np.int64)
    np.add.at(table, (codes[: len(first)], codes[len(first) :]), 1)
    judgements = tuple(str(name) for name in names)
    if not len(first):
        return Agreement(judgements, table, float("nan"), float("nan"), float("nan"))
    share = table / table.sum()
    observed = float(np.trace(share))
    expected = float(share.sum(axis=1) @ share.sum(axis=0))
    kappa = (observed - expected) / (1 - expected) if expected < 1 else float("nan")
    return Agreement(judgements, table, observed, expected, kappa)


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
