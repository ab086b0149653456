"""Meanings of class names: the names of a dataset or a detector that a query stands for, with scores."""

from __future__ import annotations

import difflib
from collections.abc import Iterable, Sequence
from dataclasses import replace
from functools import lru_cache
from itertools import groupby

from pipeline.language.name_forms import (
    CAMEL_CASE,
    DETERMINERS,
    HEAD_ENDS,
    QUALIFIER,
    key_of,
    normal_form,
    singular,
    spellings,
)
from pipeline.language.name_lookup import How, KnownNames, known_as, lookups, respelled
from pipeline.language.name_table import Synonyms, default_synonyms
from pipeline.system.frozen import dataclass

__all__ = [
    "CAMEL_CASE",
    "DETERMINERS",
    "GENERIC",
    "HEAD_ENDS",
    "QUALIFIER",
    "Meaning",
    "Synonyms",
    "default_synonyms",
    "is_compound",
    "is_named",
    "match",
    "meanings",
    "normal_form",
    "same_class",
    "same_or_kind",
    "singular",
    "suggest",
]

GENERIC = frozenset({"thing", "object", "item", "one", "stuff", "piece", "something", "anything"})
"""Words, in the singular, that mean a thing of any class; to `meanings` they are words like others."""

RELATING = frozenset(
    {
        "left",
        "right",
        "behind",
        "above",
        "below",
        "under",
        "over",
        "on",
        "in",
        "inside",
        "near",
        "next",
        "to",
        "from",
        "between",
        "front",
        "that",
        "is",
        "than",
    }
)
LONGEST_NAME = 6
"""Words; a longer query, or one with a word that relates two things, means only what it names in full."""
_SURE, _MENDED = 0.7, 0.85
"""Below the first score a misspelt word is looked for; the second is the factor of what is found by mending it."""


@dataclass(frozen=True)
class Meaning:
    """A known name that a query may stand for."""

    name: str  # As it is spelled among the known names
    score: float  # 1 for the very name, less the less surely the query means it; `meanings` lists the values
    # By its own spelling; by another name of it; as a kind of the query, as what it holds, or as the nearest more
    # general or similar thing; the same after a misspelt word was corrected
    how: How
    # The word, of the query or of the table, at which the name was found: `mug` where `coffee mug` is taken for `mug`,
    # `cup` where a `cup` is taken for a `mug`; for a misspelt query, as it is spelled right; "" for exact
    via: str
    # Positions among the query's words in normal form of those that the name says nothing of: 0 where `zorb mug` is
    # taken for `mug`. None of a name that the table knows (`coffee mug`)
    left: tuple[int, ...] = ()


def same_class(a: str, b: str, synonyms: Synonyms | None = None) -> bool:
    """Test if two names mean the same class: one spelling, or synonyms. `box` and `cracker box` do not.

    >>> from pipeline.language import same_class
    >>> same_class("garbage bin", "TrashCan"), same_class("box", "cracker box")
    (True, False)
    """
    return (synonyms or default_synonyms()).same(normal_form(a), normal_form(b))


def is_named(query: str, name: str, synonyms: Synonyms | None = None) -> bool:
    """Test if a query names this very class, by a spelling or a synonym, and not by a more general word.

    `Monitor` names `Monitor/TV`, and `bus` names `bus (vehicle)`.
    """
    return key_of(normal_form(query)) in spellings(name) or same_class(query, name, synonyms)


def same_or_kind(a: str, b: str, synonyms: Synonyms | None = None) -> bool:
    """Test if two names fit one thing: one class, or surely a kind of the other.

    `cracker box` and `box`, `mug` and `cup`; not merely near it (`monitor` and `tv`).
    """
    if same_class(a, b, synonyms):
        return True
    found = [meanings(*pair, synonyms) for pair in ((a, (b,)), (b, (a,)))]
    return any(one[0].score >= _SURE and one[0].how != "spelling" for one in found if one)


def match(query: str, names: Sequence[str], synonyms: Synonyms | None = None) -> tuple[str, ...]:
    """Match a query with known class names: the best tier of `meanings`; a misspelt query (`chiar`) matches nothing.

    Names come out as they are spelled in `names`, without repeats, the very name before synonyms, and in their order
    among those of one kind. The table of `synonyms` is the project's own by default.

    >>> from pipeline.language import match
    >>> match("cup", ["coffee_mug", "laptop", "teacup"]), match("zorb", ["laptop"])
    (('coffee_mug', 'teacup'), ())
    """
    # A misspelt query is unknown, so that the user hears of it. The very name stands before its synonyms.
    found = _walk(normal_form(query), known_as(tuple(names), synonyms or default_synonyms()))
    return tuple(m.name for m in sorted(found[0], key=lambda m: m.how != "exact")) if found else ()


def meanings(query: str, names: Sequence[str], synonyms: Synonyms | None = None) -> tuple[Meaning, ...]:
    """Known names that a query may stand for, best first, each with a score and how the name was found.

    Found in tiers; a name counts in the first that has it, and `match` gives the first that has any:

    1. the same spelling, of a name such as `cup or mug` or `Monitor/TV` either half (1.0), and synonyms (0.9);
    2. synonyms of parts, and the parts in another order: `jello box` -> `gelatin box`, `block of wood` -> `wood
       block` (0.85);
    3. kinds (0.8, and 0.05 less for each step more down the table): names that end in the query (`box` -> `cracker
       box`, `box of tissues`; `table` -> `dining table` and not `table lamp`, nor `can` -> `trash can`: the table's
       exceptions), kinds of it by the table (`cup` -> `mug`, `furniture` -> `office chair`), and such as share its
       other words too (`mustard container` -> `mustard bottle`);
    4. what is packed, for its package: `sugar` -> `sugar box` (0.7);
    5. the same tiers after one letter of a word that nothing knows was corrected (each score times 0.85);
    6. the query without words before its head: `wall clock` -> `clock` (0.65);
    7. one step up: `armchair` -> `chair`, `mug` -> `cup` (0.6);
    8. of a query that the table does not know, kinds of its head: `kitchen table` -> `dining table` (0.55); not where
       its first words say what is inside, so `cheese box` never is a `sugar box`;
    9. what is often taken for it: `monitor` -> `tv` (0.5).

    >>> from pipeline.language import meanings
    >>> [(m.name, m.score, m.how) for m in meanings("office chiar", ["chair", "desk"])]
    [('chair', 0.552, 'spelling')]
    """
    known = known_as(tuple(names), synonyms or default_synonyms())
    found = _tiers(normal_form(query), known)
    return tuple(sorted((m for tier in found for m in tier), key=lambda m: -m.score))


def spelt(query: str, names: Sequence[str], synonyms: Synonyms | None = None) -> str:
    """Query with a misspelt word corrected (`chiar`) where a known name is meant the more surely; else unchanged."""
    found = meanings(query, names, synonyms)[:1]
    return found[0].via if found and found[0].how == "spelling" else query


def _tiers(wanted: str, known: KnownNames) -> tuple[tuple[Meaning, ...], ...]:
    """Tiers of `_walk`; where nothing is as sure, preceded by those of the query with misspelt words corrected."""
    found = _walk(wanted, known)
    if not wanted or (found and found[0][0].score >= _SURE):
        return found
    mended = respelled(wanted, known)
    again = _walk(mended, known)[:1] if mended else ()
    if not again:
        return found
    # Of `coffe mug` a misspelt word says something, and is not left out as one that nobody knows.
    sure = bool(found) and again[0][0].score * _MENDED <= found[0][0].score
    if sure and len(again[0][0].left) >= len(found[0][0].left):
        return found
    better = tuple(replace(m, score=round(m.score * _MENDED, 3), how="spelling", via=mended or "") for m in again[0])
    taken = {m.name for m in better}
    rest = (tuple(m for m in tier if m.name not in taken) for tier in found)
    return (better, *(tier for tier in rest if tier))


@lru_cache(maxsize=65536)
def _walk(wanted: str, known: KnownNames) -> tuple[tuple[Meaning, ...], ...]:
    """Tiers of known names for a query in normal form, best first; names of a tier in their own order."""
    plan = lookups(wanted, known.table) if wanted else ()
    # A whole sentence is no name, whatever its last word is.
    words = wanted.split()
    long = len(words) > LONGEST_NAME or any(w in RELATING for w in words[1:])
    here = [look for look in plan if (look.where, look.key) in known.found and not (long and look.score < _SURE)]
    tiers: list[tuple[Meaning, ...]] = []
    taken: set[int] = set()
    for _, looks in groupby(here, lambda look: look.tier):
        best: dict[int, Meaning] = {}
        for look in looks:
            for i, steps in known.found[look.where, look.key]:
                # Nothing below the tier of kinds may come near it.
                score = max(round(look.score - 0.05 * max(steps - 1, 0), 3), min(look.score, 0.71))
                shares = all(not words.isdisjoint(known.shares[i]) for words in look.sharing)
                if i not in taken and shares and (i not in best or best[i].score < score):
                    best[i] = Meaning(known.names[i], score, look.how, look.via, look.left)
        if best:
            taken |= set(best)
            tiers.append(tuple(best[i] for i in sorted(best)))
    return tuple(tiers)


def is_compound(words: Sequence[str]) -> bool:
    """Test if two or more words in lower case are exactly a name of the table: `wall clock`, `white board`."""
    return len(words) > 1 and key_of(normal_form(" ".join(words))) in default_synonyms().keys


def suggest(query: str, names: Iterable[str], n: int = 3) -> tuple[str, ...]:
    """Known names nearest to an unknown name, at most `n`, best first: by letters, and by words in common.

    >>> from pipeline.language import suggest
    >>> suggest("labtop", ["chair", "lamp", "laptop"])
    ('laptop', 'lamp')
    """
    wanted = normal_form(query)
    words = set(wanted.split())
    scored = []
    for name in dict.fromkeys(names):
        form = normal_form(name)
        letters = difflib.SequenceMatcher(None, wanted, form).ratio()
        shared = words & set(form.split())
        score = max(letters, 0.6 + 0.4 * len(shared) / len(words.union(form.split())) if shared else 0.0)
        if score >= 0.6:
            scored.append((-score, name))
    return tuple(name for _, name in sorted(scored)[:n])
