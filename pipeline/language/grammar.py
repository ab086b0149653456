"""The grammar of spatial expressions: tokens to a chain of nouns and relations, or an error that says why not.

    query  := [view [","]] [verb | "is"] noun clause+ [view] ["?"]
    clause := [linking] relation noun | [linking] "between" noun "and" noun | "with" noun relation ["it"]
    noun   := [article] word+ | [article] superlative noun ("to" | "from") noun

The chain says which noun follows which relation; which earlier noun a relation modifies is left open here, and
`pipeline.language.expression` enumerates it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Literal

from pipeline.language import lexicon
from pipeline.language.naming import DETERMINERS
from pipeline.language.relation_names import MIRRORED
from pipeline.language.tokens import EXAMPLE, Token, Vocabulary, label_of, tokenize
from pipeline.language.unreadable import FORM, check_judged, check_noun, no_relation, other_view, unreadable
from pipeline.system.errors import InputError

Role = Literal["target", "relation", "reference"]
Attach = Literal["any", "nearest", "same"]


@dataclass(frozen=True)
class Span:
    """A stretch of the expression and what it is there for.

    Attributes
    ----------
    start, end : int
        Character range in the expression as it was typed.
    role : {"target", "relation", "reference"}
    index : int
        The number of the noun (0 is the target), or of the relation, in order of mention.
    """

    start: int
    end: int
    role: Role
    index: int


@dataclass(frozen=True)
class Clause:
    """One relation of the chain with its references.

    Attributes
    ----------
    relation : str
        Canonical name.
    phrase : str
        The words that said it.
    references : tuple of int
        Numbers of the nouns; two for `between`.
    swapped : bool
        Whether the relation holds from the reference to the target.
    attach : {"any", "nearest", "same"}
        Which noun it may modify: any on the right frontier; only the one before it (`the nearest chair to`); or the
        one that the relation before it modifies (`left of a and behind b`).
    closed : bool
        Whether nothing later may modify its references, as in `table with a lamp on top`.
    """

    relation: str
    phrase: str
    references: tuple[int, ...]
    swapped: bool = False
    attach: Attach = "any"
    closed: bool = False


@dataclass
class Chain:
    """What the grammar read: nouns in order of mention, relations between them, and where each stands."""

    nouns: list[str] = field(default_factory=list)
    clauses: list[Clause] = field(default_factory=list)
    spans: list[Span] = field(default_factory=list)


def read_chain(text: str, known: Vocabulary) -> Chain:
    """Read an expression that `tokens.check_text` let pass.

    Raises
    ------
    InputError
        With the reason, and with suggestions where a relation is close to a known one.
    """
    tokens = tokenize(text, known)
    try:
        return _Reader(text).read(tokens)
    except InputError as first:
        # `pillow on bed` may be a class, and yet here the pillow that lies on a bed is meant.
        if not any(t.guards for t in tokens):
            raise
        try:
            return _Reader(text).read(tokenize(text, known, hold_names=False))
        except InputError:
            raise first from None


class _Reader:
    """One pass over one expression, adding to its chain."""

    def __init__(self, text: str) -> None:
        self.text = text
        self.chain = Chain()

    def read(self, tokens: list[Token]) -> Chain:
        while tokens and tokens[-1].plain in lexicon.CLOSING:
            tokens = tokens[:-1]
        tokens = _without_leading(_without_view(tokens, self.text))
        check_judged(tokens, self.text)
        phrases = [t for t in tokens if t.relation is not None]
        if not phrases:
            raise no_relation(tokens, self.text)
        segments: list[list[Token]] = [[]]
        for token in tokens:
            if token.relation is None:
                segments[-1].append(token)
            else:
                segments.append([])
        self._read_segments(segments, phrases)
        return self.chain

    def _read_segments(self, segments: list[list[Token]], phrases: list[Token]) -> None:
        """Words stand in segments[k] before phrases[k]; the last segment ends the expression."""
        opened: Token | None = None
        early: Token | None = None
        attach: Attach = "any"
        in_tail = False
        for k, segment in enumerate(segments):
            after = phrases[k] if k < len(phrases) else None
            body, joined = _without_linking(segment) if after is not None else (segment, False)
            if after is not None and early is None and not body and after.text in lexicon.SUPERLATIVES:
                early = after
                continue
            if in_tail:
                # What is left here is the `it` of `with a lamp on it`, or nothing.
                if body and body[-1].plain not in lexicon.PLACE_PRONOUNS:
                    raise unreadable(body[-1].text, self.text)
                in_tail = False
            elif early is not None:
                self._nearest_noun(opened, attach, early, body)
                early = None
            else:
                split = _with_clause(body, after, segments[k + 1]) if after is not None else None
                self._place(opened, attach, split[0] if split else body)
                if split and after is not None:
                    self._with_tail(after, *split)
                    in_tail = True
            opened = None if in_tail else after
            attach = "same" if joined and self.chain.clauses else "any"

    def _place(self, opened: Token | None, attach: Attach, body: list[Token]) -> None:
        """Add the target, or the reference or references of the relation that `opened` them."""
        if opened is None:
            self._noun(body, None)
            return
        if opened.text in lexicon.POSSESSIVE_TAILS:
            raise unreadable(opened.text, self.text)
        phrase = self._relation_span(opened)
        if opened.relation == "between":
            cut = next((i for i, t in enumerate(body) if t.plain in lexicon.AND), None)
            if cut is None:
                raise InputError(
                    f"'{opened.text}' needs two references",
                    got=f"'{self.text}'",
                    expected="TARGET between REFERENCE and REFERENCE",
                )
            first = self._noun(body[:cut], phrase)
            self._relation_span(body[cut])
            references = (first, self._noun(body[cut + 1 :], "and"))
        else:
            references = (self._noun(body, phrase),)
        relation = str(opened.relation)
        self.chain.clauses.append(Clause(relation, phrase, references, opened.swapped, attach))

    def _nearest_noun(self, opened: Token | None, attach: Attach, early: Token, body: list[Token]) -> None:
        """`the nearest chair to the door`: the relation stands before the noun that it modifies."""
        cut = next((i for i, t in enumerate(body) if t.plain in ("to", "from")), None)
        if cut is None:
            raise InputError(
                f"'{early.text}' names no reference",
                got=f"'{self.text}'",
                expected=f"TARGET {lexicon.wording(str(early.relation))} REFERENCE",
            )
        self._place(opened, attach, body[:cut])
        phrase = self._relation_span(early)
        self._relation_span(body[cut])
        reference = self._noun(body[cut + 1 :], f"{phrase} {body[cut].text}")
        clause = Clause(str(early.relation), f"{phrase} {body[cut].text}", (reference,), attach="nearest")
        self.chain.clauses.append(clause)

    def _with_tail(self, after: Token, head: list[Token], link: Token, item: list[Token]) -> None:
        """`table with a lamp on top`: the relation holds from the lamp to the table."""
        self._relation_span(link)
        reference = self._noun(item, link.text)
        self._relation_span(after)
        phrase = f"{link.text} ... {after.text}"
        relation = str(after.relation)
        swapped = not after.swapped
        self.chain.clauses.append(Clause(relation, phrase, (reference,), swapped, attach="nearest", closed=True))

    def _relation_span(self, token: Token) -> str:
        self.chain.spans.append(Span(token.start, token.end, "relation", len(self.chain.clauses)))
        return token.text

    def _noun(self, tokens: list[Token], after: str | None) -> int:
        """Add the noun that the tokens write; its number. `after` is the phrase before it, None for the target."""
        role: Role = "target" if after is None else "reference"
        while tokens and (tokens[0].plain in DETERMINERS or (tokens[0].plain in lexicon.OTHER and len(tokens) > 1)):
            tokens = tokens[1:]
        if not tokens:
            where = "before the relation" if after is None else f"after '{after}'"
            raise InputError(f"the {role} is missing {where}", got=f"'{self.text}'", expected=FORM, cause=EXAMPLE)
        check_noun(tokens, role, self.text)
        label, number = label_of(self.text, tokens), len(self.chain.nouns)
        self.chain.nouns.append(label)
        self.chain.spans.append(Span(tokens[0].start, tokens[-1].end, role, number))
        return number


def _without_view(tokens: list[Token], text: str) -> list[Token]:
    """Drop the camera's view, which is the default; refuse views from elsewhere."""
    words = {t.text for t in tokens}
    if not words.isdisjoint(lexicon.VIEW_WORDS):
        joined, starts, ends = _joined(tokens)
        first = lexicon.VIEW_FIRST.match(joined)
        if first and first.end() in ends:
            tokens = tokens[ends.index(first.end()) + 1 :]
            joined, starts, ends = _joined(tokens)
        last = lexicon.VIEW_LAST.search(joined)
        if last and last.start() in starts:
            tokens = tokens[: starts.index(last.start())]
    singles = {w for t in tokens for w in t.text.split()}
    if not singles.isdisjoint(lexicon.OBJECT_VIEW_WORDS):
        found = lexicon.OBJECT_VIEW.search(_joined(tokens)[0])
        if found:
            raise other_view(found[0].strip(), text)
    if "'" in text or "’" in text:
        joined, _, ends = _joined(tokens)
        for owned in lexicon.SIDE_OF_OWNER.finditer(joined):
            following = ends.index(owned.end()) + 1 if owned.end() in ends else None
            if following is not None and _says_no_noun(tokens[following : following + 1]):
                raise other_view(owned[0], text)
    return tokens


def _says_no_noun(tokens: Sequence[Token]) -> bool:
    return all(t.relation is not None or t.plain in lexicon.LINKING or t.plain in lexicon.AND for t in tokens)


def _joined(tokens: Sequence[Token]) -> tuple[str, list[int], list[int]]:
    """The words as one string, with where each token starts and ends in it; names are hidden from patterns."""
    words = ["_" if t.name is not None else t.text for t in tokens]
    starts, at = [], 0
    for word in words:
        starts.append(at)
        at += len(word) + 1
    return " ".join(words), starts, [s + len(w) for s, w in zip(starts, words, strict=True)]


def _without_leading(tokens: list[Token]) -> list[Token]:
    """Drop `please find me` and the like, as long as a noun is left before the relation."""
    while tokens:
        for n in (5, 4, 3, 2, 1):
            run = tokens[:n]
            if len(run) == n and " ".join(t.text for t in run) in lexicon.LEADING:
                if any(t.bound or t.name is not None for t in run):
                    continue
                if len(tokens) > n and tokens[n].relation is None:
                    tokens = tokens[n:]
                    break
        else:
            return tokens
    return tokens


def _without_linking(segment: list[Token]) -> tuple[list[Token], bool]:
    """A segment before a relation without its `that is` and `and`; whether there was an `and`."""
    end, joined = len(segment), False
    while end:
        word = segment[end - 1].plain
        before = segment[end - 2].plain if end > 1 else None
        if word in lexicon.AND:
            joined = True
        elif word not in lexicon.LINKING and not (word in lexicon.POSTURES and before in lexicon.RELATIVE):
            break
        end -= 1
    return segment[:end], joined


def _with_clause(
    body: list[Token], after: Token, following: list[Token]
) -> tuple[list[Token], Token, list[Token]] | None:
    """Head, `with`, item where the words before a phrase and those after it say `HEAD with ITEM on top (of it)`."""
    cut = next((i for i, t in enumerate(body) if i and t.plain in lexicon.WITH), None)
    if cut is None or cut + 1 == len(body):
        return None
    # Only what can be said from the other side, by another name or by a phrase of its own.
    if after.relation not in MIRRORED and after.relation not in lexicon.SAYS_SWAPPED:
        return None
    rest, _ = _without_linking(following)
    pronoun = len(rest) == 1 and rest[0].plain in lexicon.PLACE_PRONOUNS
    bare = after.text in lexicon.BARE_TAILS and not rest and not any(t.plain in lexicon.ARTICLES for t in following)
    if not pronoun and not bare:
        return None
    return _without_linking(body[:cut])[0], body[cut], body[cut + 1 :]
