"""Lookup of a query among known names: keys to look up, in order, and the keys of each name."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from functools import lru_cache
from string import ascii_lowercase
from typing import Literal

from pipeline.language.name_forms import HEAD_ENDS, base_of, forms_of, key_of, singular, spellings
from pipeline.language.name_table import Synonyms, default_synonyms
from pipeline.system.frozen import dataclass

How = Literal["exact", "synonym", "kind", "spelling"]

PACKAGING, PACKED = "packaging", "packed good"
"""Names of the table under which stand the things that others are sold in, and what is sold in them."""

_STEPS = 6
"""Steps up the table within which a name is a kind of another."""

_OF = re.compile(r"(.+?) of (.+)")
_AMOUNT = re.compile(
    "pair|stack|pile|set|bunch|heap|piece|slice|row|group|collection|couple|pack|roll|bundle|lot|number|type|kind"
    "|sort|part|bit|sheet|stick|loaf"
)
"""Words before `of` that say how much there is and not what."""


@dataclass(frozen=True)
class LookupKey:
    """A key to look up for a query."""

    tier: int  # Smaller ones come first
    # Among the names' own spellings, their forms, what they are kinds of, what they or their kind hold, they alone
    where: Literal["spelled", "form", "kind", "held", "packed"]
    key: str
    score: float  # For the nearest names; of kinds 0.05 less for each further step
    how: How
    via: str
    sharing: tuple[frozenset[str], ...] = ()  # Of each of these sets of words, the name must have one
    # Positions among the query's words of those that it leaves out and that are no part of a name of the table
    left: tuple[int, ...] = ()


@dataclass(frozen=True, eq=False)
class KnownNames:
    """Known names by the keys they answer to."""

    names: tuple[str, ...]  # Each once
    table: Synonyms
    # mapping of (where, key) to tuple of (int, int), positions of names, and the steps from the key to each
    found: Mapping[tuple[str, str], tuple[tuple[int, int], ...]]
    shares: tuple[frozenset[str], ...]  # The words that each name, and what it is a kind of, has before its head
    words: frozenset[str]  # The words of all names


@lru_cache(maxsize=4096)
def known_as(names: tuple[str, ...], table: Synonyms) -> KnownNames:
    """Index of known names, without repeats."""
    names = tuple(dict.fromkeys(names))
    found: dict[tuple[str, str], list[tuple[int, int]]] = {}
    shares: list[frozenset[str]] = []
    for i, name in enumerate(names):
        entries, shared = _entries(name, table)
        for entry, steps in entries:
            found.setdefault(entry, []).append((i, steps))
        shares.append(shared)
    words = frozenset(word for name in names for form in forms_of(name) for word in form.split())
    return KnownNames(names, table, {k: tuple(v) for k, v in found.items()}, tuple(shares), words)


@lru_cache(maxsize=65536)
def _entries(name: str, table: Synonyms) -> tuple[tuple[tuple[tuple[str, str], int], ...], frozenset[str]]:
    """Keys of a name with the steps to each, and the words before its heads."""
    found: dict[tuple[str, str], int] = {("spelled", key): 0 for key in spellings(name)}
    shared: set[str] = set()
    forms = forms_of(name)
    for form in forms:
        turned = _turned(form)
        for own in (form, *turned[:1]):
            found[("form", key_of(own))] = 0
        for more in (form, *turned):
            for upper, steps in ((more, 0), *above(more, table)):
                shared.update(upper.split()[:-1])
                if steps or more != form:
                    _least(found, ("kind", key_of(upper)), max(steps, 1))
                if content := _content(upper, table):
                    for held in _held(content, table):
                        _least(found, ("held", key_of(held)), steps + 1)
                        if not steps:
                            found["packed", key_of(held)] = 0
    return tuple(found.items()), frozenset(shared)


def _least(found: dict[tuple[str, str], int], entry: tuple[str, str], steps: int) -> None:
    found[entry] = min(steps, found.get(entry, steps))


def _turned(form: str) -> tuple[str, ...]:
    """Turn `box of tissues` into `tissue box`; of `stack of chairs` the content comes last, `chair`."""
    parts = _OF.fullmatch(base_of(form))
    if parts is None:
        return ()
    content = " ".join([*parts[2].split()[:-1], singular(parts[2].split()[-1])])
    return (f"{content} {parts[1]}", content) if _AMOUNT.fullmatch(parts[1]) else (f"{content} {parts[1]}",)


@lru_cache(maxsize=65536)
def above(form: str, table: Synonyms) -> tuple[tuple[str, int], ...]:
    """Generalisations of a name in normal form, with the steps to each.

    By the last words of its head and by the table, of synonyms too, which are not chained.
    """
    found = {form: 0}
    level = [form]
    for steps in range(_STEPS):
        upper: list[str] = []
        for name in level:
            aliases = [a for a in table.of(name) if a not in found]
            found |= dict.fromkeys(aliases, steps)
            upper += [g for one in (name, *aliases) for g in sorted(table.general(one))]
            if not table.is_exception(name):
                upper += _last_words(name)[:1]
        level = [u for u in dict.fromkeys(upper) if u not in found]
        found |= dict.fromkeys(level, steps + 1)
    return tuple((name, steps) for name, steps in found.items() if name != form)


def _last_words(form: str) -> list[str]:
    """Shorten a name: without the words after its head, then word by word from the front."""
    head = HEAD_ENDS.split(base_of(form), maxsplit=1)[0].split()
    ends = [" ".join(head[i:]) for i in range(len(head))]
    return [end for end in ends if end != form]


def _is_a(form: str, general: str, table: Synonyms) -> bool:
    return form == general or any(upper == general for upper, _ in above(form, table))


@lru_cache(maxsize=4096)
def is_packed(word: str) -> bool:
    """Test if a thing is a package or is sold in packages."""
    table = default_synonyms()
    return _is_a(word, PACKAGING, table) or _is_a(word, PACKED, table)


def _content(form: str, table: Synonyms) -> str:
    """Content of a package: `tomato soup` of `tomato soup can`; "" for anything else."""
    *first, head = form.split() or [""]
    content = " ".join(first)
    return content if content and _is_a(head, PACKAGING, table) and _is_a(content, PACKED, table) else ""


def _held(content: str, table: Synonyms) -> Iterator[str]:
    """Words for a content that stand for its package: itself, its synonyms, its last words and its words."""
    yield from table.of(content)
    for end in _last_words(content):
        yield from table.of(end)
    for word in content.split():
        if _is_a(word, PACKED, table):
            yield word


@lru_cache(maxsize=65536)
def lookups(query: str, table: Synonyms) -> tuple[LookupKey, ...]:
    """Keys to look up for a query in normal form, tier by tier; `meanings` lists the tiers."""
    return tuple(sorted(_unordered_lookups(query, table), key=lambda look: look.tier))


def _unordered_lookups(query: str, table: Synonyms) -> Iterator[LookupKey]:
    aliases = sorted(table.of(query) - {query})
    yield LookupKey(1, "spelled", key_of(query), 1.0, "exact", "")
    for alias in (query, *aliases):
        yield LookupKey(1, "form", key_of(alias), 0.9, "synonym", alias)
    variants = [v for v in dict.fromkeys(_variants(query, table)) if v != query and v not in aliases]
    for variant in variants:
        yield LookupKey(2, "form", key_of(variant), 0.85, "synonym", variant)
    for form in (query, *aliases, *variants):
        yield LookupKey(3, "kind", key_of(form), 0.8, "kind", form)
        yield LookupKey(4, "held", key_of(form), 0.7, "kind", form)
    ends = [] if table.is_exception(query) else list(_ends(query, table))
    # What stands behind a head (`painting of a forest`) is shared by no name that has it in another way, unless it is
    # what is in a package (`tin of coffee`).
    packed = next((turned for turned in _turned(query) if ends and _is_a(ends[-1], PACKAGING, table)), query)
    for end in ends if packed.endswith(tuple(ends)) else []:
        first = packed[: -len(end)].split()
        sharing = tuple(frozenset({word, *table.of(word)}) for word in first)
        for alias in sorted(table.of(end)):
            yield LookupKey(3, "kind", key_of(alias), 0.75, "kind", alias, sharing)
        if _is_a(end, PACKAGING, table):
            for alias in sorted(table.of(" ".join(first))):
                yield LookupKey(4, "held", key_of(alias), 0.7, "kind", alias)
        for general in sorted(table.general(" ".join(first))):
            yield LookupKey(4, "form", key_of(f"{general} {end}"), 0.7, "kind", f"{general} {end}")
    left = {end: _left_out(query, end, table) for end in ends}
    for dropped, end in enumerate(ends):
        for alias in sorted(table.of(end)):
            yield LookupKey(6 + dropped, "form", key_of(alias), 0.65, "kind", alias, left=left[end])
        yield LookupKey(6 + dropped, "held", key_of(end), 0.65, "kind", end, left=left[end])
    known = key_of(query) in table.keys
    for start in (query, *aliases, *ends):
        out = left.get(start, ())
        for general in sorted(table.general(start)):
            for alias in sorted(table.of(general)):
                yield LookupKey(20, "form", key_of(alias), 0.6, "kind", alias, left=out)
            # A bottle of mustard is French's; that a can of meat holds food makes it no apple.
            yield LookupKey(20, "packed", key_of(general), 0.6, "kind", general, left=out)
    for end in [] if known else ends:
        first = query[: -len(end)].split() if query.endswith(end) else query.split()
        if not any(_is_a(part, PACKED, table) for part in (" ".join(first), *first)):
            yield LookupKey(21, "kind", key_of(end), 0.55, "kind", end, left=left[end])
    for start in (query, *aliases, *([] if known else ends)):
        for other in sorted(table.taken_for(start)):
            yield LookupKey(22, "form", key_of(other), 0.5, "kind", other, left=left.get(start, ()))


def _left_out(query: str, end: str, table: Synonyms) -> tuple[int, ...]:
    """Positions of a query's words outside its end, and outside a name with it: `zorb` of `zorb coffee mug`, `mug`."""
    words, head = query.split(), HEAD_ENDS.split(base_of(query), maxsplit=1)[0].split()
    first, after = len(head) - len(end.split()), range(len(head), len(words))
    for start in range(first + 1):
        if key_of(" ".join(words[start:])) in table.keys:
            return tuple(range(start))
        if key_of(" ".join(head[start:])) in table.keys:
            return (*range(start), *after)
    return (*range(first), *after)


def _ends(query: str, table: Synonyms) -> Iterator[str]:
    """Ends of the query, the longest first, while the last words say what the thing is."""
    for end in _last_words(query):
        yield end
        if table.is_exception(end):
            return


def _variants(query: str, table: Synonyms) -> Iterator[str]:
    """Variants of the query: parts in another order, and with synonyms of its parts."""
    turned = _turned(query)
    for form in turned:
        yield from table.of(form)
    for form in (query, *turned):
        words = form.split()
        for i in range(1, len(words)):
            first, end = " ".join(words[:i]), " ".join(words[i:])
            for a in sorted(table.of(first)):
                for b in sorted(table.of(end)):
                    yield f"{a} {b}"


def respelled(query: str, known: KnownNames) -> str | None:
    """Query with misspelt words corrected; None where nothing is misspelt.

    Words of five letters and more that neither the known names nor the table have, and of which one word that they
    have is one letter away; of three and four letters only two of a known name may have changed places, or of four
    one be forgotten.
    """
    words = query.split()
    mended = [_mended(word, known.words, known.table) for word in words]
    return " ".join(mended) if mended != words else None


def _mended(word: str, words: frozenset[str], table: Synonyms) -> str:
    if len(word) < 3 or not word.isalpha() or word in words or word in table.words or singular(word) in table.words:
        return word
    short = len(word) < 5
    # A short word may be many others by a letter: only a letter forgotten, or two exchanged, and of the known names.
    near = two_swapped(word) if short else one_letter_away(word)
    if len(word) == 4:
        near |= {w for w in one_letter_away(word) if len(w) > len(word)}
    for among in (words,) if short else (words, table.words):
        candidates = [n for n in near if n in among]
        kept = [c for c in candidates if c[0] == word[0]] or candidates
        if len(kept) == 1:
            return kept[0]
    return word


@lru_cache(maxsize=1024)
def one_letter_away(word: str) -> frozenset[str]:
    """Words one letter more, less or other away, or with two letters swapped."""
    splits = [(word[:i], word[i:]) for i in range(len(word) + 1)]
    lost = {a + b[1:] for a, b in splits if b}
    changed = {a + c + b[1:] for a, b in splits if b for c in ascii_lowercase}
    added = {a + c + b for a, b in splits for c in ascii_lowercase}
    return frozenset((lost | two_swapped(word) | changed | added) - {word})


def two_swapped(word: str) -> frozenset[str]:
    """Words with two neighbouring letters swapped."""
    return frozenset(word[:k] + word[k + 1] + word[k] + word[k + 2 :] for k in range(len(word) - 1))
