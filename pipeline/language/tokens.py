"""Tokens of an expression: words, relation phrases, and class names of the user's vocabulary."""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

from pipeline.language.lexicon import AND, LINKING, STRUCTURAL, VIEW, WITH, phrase_table
from pipeline.language.naming import DETERMINERS, Synonyms
from pipeline.language.spelling import mended_words
from pipeline.system.errors import InputError, require

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
            raise InputError(f"the expression holds {what}", got=f"{found[0]!a} at position {found.start()}")
    return text


EXAMPLE = "for example 'mug left of the laptop'"


def tokenize(text: str, known: NameIndex, *, hold_names: bool = True) -> list[Token]:
    """Split a checked text into tokens by longest match: names of the vocabulary, relation phrases, then single words.

    Words joined by a hyphen or an underscore are matched as a whole only: `left-of` is a relation, the `in` of
    `built-in oven` is none. Without `hold_names`, names with grammar in them (`pillow on bed`) are split.
    """
    found = list(_WORD.finditer(text))
    words = [m[0].lower().replace("’", "'") for m in found]
    words, _ = mended_words(words, known.words)
    words = [
        "with" if w == "w" and text[m.end() : m.end() + 1] == "/" else w for w, m in zip(words, found, strict=True)
    ]
    starts = [m.start() for m in found]
    ends = [m.end() for m in found]
    opens = [i == 0 or _BREAKS.search(text, ends[i - 1], starts[i]) is not None for i in range(len(found))]
    opens.append(True)
    quotes = {m.start(1): m for m in _QUOTED.finditer(text)} if _QUOTED.search(text) else {}

    tokens: list[Token] = []
    i = 0
    while i < len(words):
        if quotes and (quoted := _quoted(quotes, starts, ends, i)):
            label = _label(text, starts[i], ends[quoted - 1])
            tokens.append(Token(" ".join(words[i:quoted]), starts[i], ends[quoted - 1], name=label))
            i = quoted
            continue
        name = _longest(known.names.get(words[i]), words, opens, i)
        if name is not None and name[2] and not hold_names:
            name = None
        # A phrase does not reach into quotes: in `in the "front of house"` it is `in`.
        free = _next_quote(quotes, starts, i)
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
        last = i + len(best[0])
        joined = " ".join(best[0])
        if best is name:
            tokens.append(Token(joined, starts[i], ends[last - 1], name=best[1], guards=best[2]))
        else:
            tokens.append(Token(joined, starts[i], ends[last - 1], relation=best[1], swapped=best[2]))
        i = last
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
    between = text[ends[last - 1] : starts[last]].strip()
    following = words[last]
    if between or following in DETERMINERS or following in STRUCTURAL or following in _PHRASES:
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


def _next_quote(quotes: dict[int, re.Match[str]], starts: list[int], at: int) -> int:
    """Number of the first word behind word `at` that begins a quoted name, or the number of words."""
    ahead = min((q.start() for q in quotes.values() if q.start() > starts[at]), default=None)
    return len(starts) if ahead is None else next((k for k in range(at, len(starts)) if starts[k] > ahead), len(starts))


def _quoted(quotes: dict[int, re.Match[str]], starts: list[int], ends: list[int], at: int) -> int | None:
    """Number of the word after a quoted name that starts at word `at`, or None."""
    for quote in quotes.values():
        if quote.start(1) <= starts[at] and (at == 0 or ends[at - 1] <= quote.start()) and ends[at] <= quote.end(1):
            return next((k for k in range(at, len(ends)) if starts[k] >= quote.end(1)), len(ends))
    return None


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
