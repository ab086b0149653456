"""A cursor over the tokens of an expression: patterns, and boundaries of names."""

from __future__ import annotations

import re
from collections.abc import Collection, Sequence

from pipeline.language import choices, lexicon
from pipeline.language.naming import DETERMINERS, is_compound
from pipeline.language.tokens import Token, joined_words

MODALS = frozenset({"can", "could", "may", "should", "would", "might", "must", "will", "shall"})


class Cursor:
    """A position in the tokens of an expression: patterns, and boundaries of names.

    Words joined by hyphens are one token; `own` holds words of the user's own names, which stay as spelled; `breaks`
    flags tokens behind punctuation.
    """

    def __init__(self, text: str, tokens: Sequence[Token], own: Collection[str] = ()) -> None:
        self.text, self.own = text, own
        self.tokens = _hyphens_joined(text, tokens)
        self.breaks = [
            k > 0 and any(c in text[self.tokens[k - 1].end : t.start] for c in ",;:.!?()")
            for k, t in enumerate(self.tokens)
        ]
        self.line, self._starts, ends = joined_words(self.tokens)
        self._after = {end: k + 1 for k, end in enumerate(ends)}

    def match(self, pattern: re.Pattern[str], at: int) -> tuple[re.Match[str], int] | None:
        """Match a pattern at a token, with the token after, where the match ends with a word."""
        found = pattern.match(self.line, self._starts[at]) if at < len(self.tokens) else None
        end = None if found is None else self._after.get(self._starts[at] + len(found[0].rstrip()))
        if found is None or end is None or any(self.breaks[k] for k in range(at + 1, end)):
            return None
        return found, end

    def words(self, at: int, end: int) -> str:
        """Tokens as typed."""
        return self.text[self.tokens[at].start : self.tokens[min(end, len(self.tokens)) - 1].end]

    # ---- boundaries ------------------------------------------------------------------------------------------------

    def _structural(self, at: int) -> bool:
        """Test if a token is grammar, and no word of a name."""
        if at >= len(self.tokens):
            return True
        token = self.tokens[at]
        if token.relation is not None:
            return True
        word = token.plain
        if word in MODALS:
            return at + 1 < len(self.tokens) and self.tokens[at + 1].plain in ("be", "been")
        if word is not None and word.endswith("ing") and at and self._after_number(at):
            return False
        if word == "right":
            return self._structural(at + 1) or self.breaks[at + 1]
        return word is not None and (
            word in lexicon.AND
            or word in lexicon.WITH
            or word in lexicon.NEGATIONS
            or word in lexicon.LINKING
            or word in lexicon.RELATIVE
            or word in lexicon.UNKNOWN_RELATIONS
            or word in lexicon.VERBS
        )

    def _after_number(self, at: int) -> bool:
        """Test for `hanging` in `three hanging towels`."""
        word = self.tokens[at + 1].plain if at + 1 < len(self.tokens) else None
        return self.tokens[at - 1].plain in choices.NUMBERS and word is not None and word not in DETERMINERS

    def _ends(self, at: int) -> bool:
        """Test if a noun phrase or a side may end before a token."""
        return (
            at >= len(self.tokens)
            or self.breaks[at]
            or self._structural(at)
            or (self.tokens[at].plain in lexicon.POSTURES or self.tokens[at].plain in ("or", "nor", "it", "this"))
            or self.match(choices.AT_SIDE, at) is not None
        )

    def _bare_side(self, at: int) -> tuple[re.Match[str], int] | None:
        """Match a side behind a thing without a preposition: `plant left`, not `that was left`, nor `table centre`."""
        found = self.match(choices.BARE_SIDE, at)
        if found is None or not self._ends(found[1]):
            return None
        before = self.tokens[at - 1].plain if at else None
        linked = before is not None and (before in lexicon.LINKING or before in lexicon.SOMEBODY)
        compound = at > 0 and is_compound([self.tokens[at - 1].text, self.tokens[at].text])
        return None if found[0]["last"] and (linked or compound) else found

    def _goes_on(self, at: int) -> bool:
        """Test if a relation, a side or the end follows."""
        return at >= len(self.tokens) or self._structural(at) or self.match(choices.AT_SIDE, at) is not None

    def _starts_noun(self, at: int) -> bool:
        """Test if a noun phrase may begin at a token."""
        if at >= len(self.tokens) or self.breaks[at]:
            return False
        word = self.tokens[at].plain
        return word in DETERMINERS or not (self._structural(at) or word in lexicon.PLACE_PRONOUNS)

    def is_superlative_noun(self, at: int) -> bool:
        """Test if `nearest` stands before a noun, as in `the nearest chair`."""
        return (
            self.tokens[at].text in lexicon.BEFORE_NOUNS
            and self._starts_noun(at + 1)
            and (
                at == 0
                or self.tokens[at - 1].plain in DETERMINERS | choices.ORDINALS.keys() | choices.NUMBERS.keys()
                or self.tokens[at - 1].text == "next"
                or self.tokens[at - 1].relation is not None
            )
        )

    def _superlative_reference(self, at: int) -> int | None:
        """Token after `to` or `from` where the reference of `nearest` follows; else None."""
        if (
            at + 1 < len(self.tokens)
            and self.tokens[at].plain in ("to", "from")
            and not self.match(choices.AT_SIDE, at)
        ):
            return at + 1
        return None


def _hyphens_joined(text: str, tokens: Sequence[Token]) -> list[Token]:
    """Join tokens with hyphens between, outside the tables of single words."""
    found: list[Token] = []
    for k, token in enumerate(tokens):
        last = found[-1] if found else None
        if token.bound and last is not None and tokens[k - 1].bound and text[last.end : token.start].strip(" ") != "":
            found[-1] = Token(text[last.start : token.end].lower(), last.start, token.end, bound=True)
        else:
            found.append(token)
    return found
