"""Tokens of an expression: words spelled right, relation phrases, and class names of the user's vocabulary."""

from __future__ import annotations

import re
import unicodedata
from bisect import bisect, bisect_left
from collections.abc import Collection, Sequence
from functools import lru_cache
from itertools import pairwise

from pipeline.language import choices
from pipeline.language.attributes import INTENSIFIERS, SINGLE_WORDS, attribute
from pipeline.language.lexicon import (
    AND,
    CONTRACTIONS,
    GRAMMAR_WORDS,
    LINKING,
    SHORTHAND,
    STRUCTURAL,
    VIEW,
    WITH,
    phrase_table,
)
from pipeline.language.name_lookup import one_letter_away, two_swapped
from pipeline.language.naming import DETERMINERS, Synonyms, default_synonyms, singular
from pipeline.system.errors import InputError, require
from pipeline.system.frozen import dataclass

_CHOICE_WORDS = {
    w for phrase in (*choices.EXTREMES, *choices.SIDES, *choices.ORDINALS) for w in phrase.split() if len(w) > 4
} - {"background", "foreground", "distance"}
_OFTEN = (
    "left right behind front between beside besides under above below next near bottom middle closest nearest farthest "
    "furthest leftmost rightmost inside beneath underneath infront against across corner standing sitting hanging "
    "lying neither without something anything which where thing things object objects item camera viewer stack"
)
_MISSPELT = tuple(dict.fromkeys([*_OFTEN.split(), *sorted(_CHOICE_WORDS)]))
"""Words of the grammar that are taken for what a misspelt word should be."""
_OF_THE_GRAMMAR = GRAMMAR_WORDS.union(
    (w for phrase in phrase_table() for w in phrase.split()), _MISSPELT, choices.NUMBERS, choices.ORDINALS, INTENSIFIERS
)
_SLIPS = {"th": "the"} | {
    word[:k] + word[k + 1] + word[k] + word[k + 2 :]: word
    for word in ("the", "that", "this", "and", "with", "which", "from")
    for k in range(len(word) - 1)
    if word != "from" or k != 1
}
"""Two letters of a small word that changed places: `teh`; `form` is a word of its own."""


@lru_cache(maxsize=4096)
def spelling_corrected(word: str) -> str:
    """Correct a misspelt word of the grammar: a letter more, less or two swapped, no apostrophe, or shorthand.

    A word that is known is left alone (`whats` and `plz` are corrected); in long ones one letter may be another.
    """
    found = _SLIPS.get(word) or CONTRACTIONS.get(word) or SHORTHAND.get(word)
    if found is not None:
        return found
    if len(word) < 3 or is_known(word):
        return word
    near = (m for m in _MISSPELT if abs(len(word) - len(m)) <= 1 and word[0] == m[0])
    return next((m for m in near if _one_slip(word, m)), word)


def homophones_corrected(words: Sequence[str]) -> list[str]:
    """Correct words that sound like a small word of the grammar: `next too the`, `left off`."""
    found = list(words)
    for k, word in enumerate(words):
        before, after = words[k - 1] if k else "", words[k + 1] if k + 1 < len(words) else ""
        if word == "too" and (before in ("next", "close", "closest", "nearest", "near") or after in ("the", "a", "my")):
            found[k] = "to"
        elif word == "off" and before in ("left", "right", "front", "top"):
            found[k] = "of"
        elif word == "then" and before in choices.COMPARATIVES:
            found[k] = "than"
    return found


@lru_cache(maxsize=4096)
def is_known(word: str) -> bool:
    """Test if a word in lower case is of the grammar, an adjective or in a name of the table."""
    words = default_synonyms().words
    return word in _OF_THE_GRAMMAR or word in words or singular(word) in words or attribute(word) is not None


@lru_cache(maxsize=4096)
def attribute_meant(word: str) -> str | None:
    """Adjective meant by an unknown word: `purple` for `pruple`; None for none or several.

    Two letters that changed places and a letter too few come before a letter too many, and that before another letter;
    which short words are not. The ends stay: other words differ there (`pasted` and `pastel`).
    """
    if len(word) < 3 or not word.isalpha() or is_known(word):
        return None
    swapped = two_swapped(word) if len(word) > 3 else frozenset[str]()
    away = {w for w in one_letter_away(word) if w[0] == word[0]}
    longer = {w for w in away if len(w) > len(word)}
    shorter = {w for w in away if len(w) < len(word) and (w != word[:-1] or word[-1] == word[-2])}
    if len(word) == 4:
        shorter = {w for w in shorter if any(a == b for a, b in pairwise(word))}
    other = {w for w in away if len(w) == len(word) and w[-1] == word[-1]}
    for near in (swapped | longer, shorter, other if len(word) > 4 else frozenset[str]()):
        meant = sorted(near & SINGLE_WORDS)
        if meant:
            return meant[0] if len({attribute(w) for w in meant}) == 1 else None
    return None


def mended_words(words: Sequence[str], own: Collection[str]) -> tuple[list[str], list[bool]]:
    """Correct words in lower case, with a flag for each misspelt word; words of the user's `own` names stay."""
    read = homophones_corrected([word if word in own else spelling_corrected(word) for word in words])
    short = CONTRACTIONS.keys() | SHORTHAND.keys()
    return read, [a != b and a not in short for a, b in zip(words, read, strict=True)]


def _one_slip(word: str, meant: str) -> bool:
    start = next((k for k, (a, b) in enumerate(zip(word, meant, strict=False)) if a != b), min(len(word), len(meant)))
    a, b = word[start:], meant[start:]
    swapped = a[:2] == b[1::-1] and a[2:] == b[2:] and len(a) > 1
    other = len(word) > 6 and a[1:] == b[1:]
    return swapped or a[1:] == b or a == b[1:] or other


MAX_LENGTH = 300
"""Characters; a spatial expression is a phrase, not a page."""

_SEPARATORS = r"\s\-_‐-―,;:?!\"“”„«»()\[\]/&+%#.'’‘$"
_WORD = re.compile(rf"[^{_SEPARATORS}]+(?:['’.][^{_SEPARATORS}]+)*|&")
_STRANGE = re.compile(rf"[^\w{_SEPARATORS}]|[\x00-\x08\x0b\x0c\x0e-\x1f\x7f-\x9f]")
_QUOTED = re.compile(r"[\"“„«]([^\"“”„«»]+)[\"”“»]")
_BREAKS = re.compile(r"[\s,;:?!\"“”„«»]")


@dataclass(frozen=True)
class Token:
    """A word, a relation phrase or a protected name, and its range in the text."""

    text: str  # Lower case, single spaces
    start: int  # Character range in the expression as it was typed
    end: int
    relation: str | None = None  # The canonical relation of a phrase
    swapped: bool = False  # The phrase says it from the other side
    name: str | None = None  # The class name as the vocabulary spells it, where the token is one
    guards: bool = False  # The name holds words together that would otherwise be read as grammar
    bound: bool = False  # A hyphen or the like joins a single word to its neighbour, which makes it part of a name

    @property
    def plain(self) -> str | None:
        """Word, if single and free; None for names, phrases and parts of compounds."""
        return None if self.bound or self.name is not None or self.relation is not None else self.text


@dataclass(frozen=True)
class NameIndex:
    """Known names by their first word, longest first, as (words, spelling, guards)."""

    names: dict[str, tuple[tuple[tuple[str, ...], str, bool], ...]]
    words: frozenset[str] = frozenset()
    """The words of the user's own names, which are spelled as they are."""


def _phrases_by_first_word() -> dict[str, tuple[tuple[tuple[str, ...], str, bool], ...]]:
    table: dict[str, list[tuple[tuple[str, ...], str, bool]]] = {}
    known = phrase_table()
    for phrase, (relation, swapped) in known.items():
        words = tuple(phrase.split())
        # People run them together: `infront of`, `nextto`, `ontopof`.
        joined = [("".join(words[:n]), *words[n:]) for n in range(2, len(words) + 1)]
        for form in (words, *(f for f in joined if " ".join(f) not in known)):
            table.setdefault(form[0], []).append((form, relation, swapped))
    return {first: tuple(sorted(entries, key=lambda e: -len(e[0]))) for first, entries in table.items()}


_PHRASES = _phrases_by_first_word()


def mended(text: str, known: NameIndex) -> tuple[tuple[int, int, str], ...]:
    """Misspelt words of the grammar: range in the text, and correction."""
    found = list(_WORD.finditer(text))
    read, wrong = mended_words([m[0].lower().replace("’", "'") for m in found], known.words)
    return tuple((m.start(), m.end(), word) for m, word, is_wrong in zip(found, read, wrong, strict=True) if is_wrong)


def words_of(name: str) -> tuple[str, ...]:
    """Words of a name in lower case, as the tokeniser splits them."""
    return tuple(m[0].lower().replace("’", "'") for m in _WORD.finditer(name))


@lru_cache(maxsize=64)
def vocabulary(class_names: tuple[str, ...], synonyms: Synonyms) -> NameIndex:
    """Names to hold together: the user's, and those synonyms of them that contain words of the grammar."""
    found: dict[tuple[str, ...], str] = {}
    for name in class_names:
        if not isinstance(name, str):
            raise InputError("a class name is no text", got=type(name).__name__)
        found.setdefault(words_of(name), str(name))
    # With no vocabulary given, every synonym could be meant.
    meant = frozenset[str]().union(*(synonyms.of(n) for n in class_names))
    for name in sorted(frozenset[str]().union(*synonyms.groups)):
        if (not class_names or name in meant) and _speaks_grammar(words_of(name)):
            found.setdefault(words_of(name), name)
    by_first: dict[str, list[tuple[tuple[str, ...], str, bool]]] = {}
    for words, name in found.items():
        if words:
            by_first.setdefault(words[0], []).append((words, name, _speaks_grammar(words)))
    own = frozenset(word for name in class_names for word in words_of(name))
    return NameIndex({first: tuple(sorted(e, key=lambda x: -len(x[0]))) for first, e in by_first.items()}, own)


def _speaks_grammar(words: tuple[str, ...]) -> bool:
    return any(w in _PHRASES or w in AND or w in WITH for w in words)


def check_text(text: object) -> str:
    """Check an expression; InputError if no text, empty, longer than 300 characters, or with control characters."""
    if not isinstance(text, str):
        raise InputError("an expression must be text", got=type(text).__name__)
    require(text.strip(), "the expression is empty", expected="TARGET RELATION REFERENCE", cause=EXAMPLE)
    require(
        len(text) <= MAX_LENGTH,
        "the expression is too long",
        got=f"{len(text)} characters",
        expected=f"at most {MAX_LENGTH}",
    )
    for found in _STRANGE.finditer(text):
        if not unicodedata.category(found[0]).startswith("M"):
            control = unicodedata.category(found[0])[0] in "CZ"
            what = "a control character" if control else "a character that cannot be read"
            raise InputError(f"the expression holds {what}: {found[0]!a} at position {found.start()}")
    return text


EXAMPLE = "for example 'mug left of the laptop'"


def tokenize(text: str, known: NameIndex, *, hold_names: bool = True) -> list[Token]:
    """Split a checked text into tokens by longest match: names of the vocabulary, relation phrases, then single words.

    Words joined by a hyphen or an underscore are matched as a whole only: `left-of` is a relation, the `in` of
    `built-in oven` is none. Without `hold_names`, names with grammar in them (`pillow on bed`) are split.
    """
    found = list(_WORD.finditer(text))
    words, _ = mended_words([m[0].lower().replace("’", "'") for m in found], known.words)
    words = [
        "with" if w == "w" and text[m.end() : m.end() + 1] == "/" else w for w, m in zip(words, found, strict=True)
    ]
    starts = [m.start() for m in found]
    ends = [m.end() for m in found]
    opens = [i == 0 or _BREAKS.search(text, ends[i - 1], starts[i]) is not None for i in range(len(found))]
    opens.append(True)
    # The first word inside quotes, and the word behind them.
    quotes = [(bisect(starts, m.start()), bisect_left(starts, m.end(1))) for m in _QUOTED.finditer(text)]
    quoted = {first: after for first, after in quotes if after > first}

    tokens: list[Token] = []
    i = 0
    while i < len(words):
        if i in quoted:
            end = ends[quoted[i] - 1]
            tokens.append(Token(" ".join(words[i : quoted[i]]), starts[i], end, name=_label(text, starts[i], end)))
            i = quoted[i]
            continue
        name = _longest(known.names.get(words[i]), words, opens, i)
        if name is not None and name[2] and not hold_names:
            name = None
        # A phrase does not reach into quotes: in `in the "front of house"` it is `in`.
        free = min((first for first, _ in quotes if first > i), default=len(words))
        phrase = _longest(_PHRASES.get(words[i]), words[:free], opens, i)
        if phrase is not None and len(phrase[0]) > 1:
            phrase = _before_a_name(phrase, known, words, opens, i)
            later = _longest(_PHRASES.get(words[i + 1]), words[:free], opens, i + 1)
            phrase = _before_a_view(_before_a_side(phrase, words, text, ends, starts, i), words, i)
            if phrase is not None and words[i] in LINKING and later is not None and len(later[0]) >= len(phrase[0]):
                phrase = None  # `sitting` says nothing in `sitting on top of`.
        best = name if phrase is None or (name is not None and len(name[0]) > len(phrase[0])) else phrase
        if best is None:
            tokens.append(Token(words[i], starts[i], ends[i], bound=not (opens[i] and opens[i + 1])))
            i += 1
            continue
        span = " ".join(best[0]), starts[i], ends[i + len(best[0]) - 1]
        if best is name:
            tokens.append(Token(*span, name=best[1], guards=best[2]))
        else:
            tokens.append(Token(*span, relation=best[1], swapped=best[2]))
        i += len(best[0])
    return tokens


def _longest(
    entries: Sequence[tuple[tuple[str, ...], str, bool]] | None, words: list[str], opens: list[bool], at: int
) -> tuple[tuple[str, ...], str, bool] | None:
    if entries is None or not opens[at]:
        return None
    for entry in entries:
        last = at + len(entry[0])
        if last <= len(words) and opens[last] and (last == at + 1 or tuple(words[at:last]) == entry[0]):
            return entry
    return None


def _before_a_name(
    phrase: tuple[tuple[str, ...], str, bool], known: NameIndex, words: list[str], opens: list[bool], at: int
) -> tuple[tuple[str, ...], str, bool]:
    """Shorten a phrase where a known name begins inside and ends behind: `in` (`the`) `front door`."""
    for entry in _PHRASES[words[at]]:
        size = len(entry[0])
        if size >= len(phrase[0]) or tuple(words[at : at + size]) != entry[0]:
            continue
        begin = at + size + (words[at + size] in DETERMINERS)
        name = _longest(known.names.get(words[begin]), words, opens, begin) if begin < len(words) else None
        if name is not None and begin + len(name[0]) > at + len(phrase[0]):
            return entry
    return phrase


def _before_a_side(
    phrase: tuple[tuple[str, ...], str, bool], words: list[str], text: str, ends: list[int], starts: list[int], at: int
) -> tuple[tuple[str, ...], str, bool]:
    """Shorten `on (the) top` to `on` before a thing at the top: `on the top shelf`."""
    last = at + len(phrase[0])
    if phrase[0] not in (("on", "top"), ("on", "the", "top")) or last >= len(words):
        return phrase
    if text[ends[last - 1] : starts[last]].strip() or words[last] in DETERMINERS | STRUCTURAL | _PHRASES.keys():
        return phrase
    return next(entry for entry in _PHRASES["on"] if entry[0] == ("on",))


def _before_a_view(
    phrase: tuple[tuple[str, ...], str, bool], words: list[str], at: int
) -> tuple[tuple[str, ...], str, bool] | None:
    """Drop the `from` of a phrase before a viewer: `on the left from the camera`."""
    last = at + len(phrase[0])
    looked = phrase[0][-1] == "from" and phrase[1] not in ("closest", "farthest")
    if not looked or VIEW.match(" ".join(words[last - 1 :])) is None:
        return phrase
    return next(
        (e for e in _PHRASES[words[at]] if e[0] == tuple(words[at : at + len(e[0])]) and e[0][-1] != "from"), None
    )


def _label(text: str, start: int, end: int) -> str:
    """Label in a stretch of the text: lower case, single spaces, no punctuation, a parenthesis closed."""
    piece = text[start:end]
    if piece.count("(") > piece.count(")") and text[end : end + 1] == ")":
        piece += ")"
    return " ".join(_BREAKS.sub(" ", piece).lower().split())


def label_of(text: str, tokens: Sequence[Token]) -> str:
    """Name of a run of tokens: as the vocabulary spells it where the run is exactly one known name."""
    if len(tokens) == 1 and tokens[0].name is not None:
        return tokens[0].name
    return _label(text, tokens[0].start, tokens[-1].end)


def joined_words(tokens: Sequence[Token]) -> tuple[str, list[int], list[int]]:
    """Join words to a string, with the start and end of each token; names are hidden from patterns."""
    words = ["_" if t.name is not None else t.text for t in tokens]
    starts, at = [], 0
    for word in words:
        starts.append(at)
        at += len(word) + 1
    return " ".join(words), starts, [s + len(w) for s, w in zip(starts, words, strict=True)]
