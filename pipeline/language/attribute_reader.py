"""A cursor over the tokens of an expression: boundaries of names, and attributes before and after the thing."""

from __future__ import annotations

import re
from collections.abc import Collection, Sequence
from itertools import takewhile

from pipeline.language import choices, lexicon
from pipeline.language.attributes import BASIC_COLORS, FURTHER_COLORS, Attribute, attribute
from pipeline.language.name_lookup import is_packed
from pipeline.language.naming import DETERMINERS, default_synonyms, is_compound, key_of, normal_form, singular
from pipeline.language.tokens import Token, attribute_meant, joined_words
from pipeline.language.tree import Choice, Role
from pipeline.system.frozen import dataclass

MODALS = frozenset({"can", "could", "may", "should", "would", "might", "must", "will", "shall"})


@dataclass
class Phrase:
    """A noun phrase, under construction and as the grammar reads it; a reader that has one changes it no more."""

    label: str = ""  # The thing with its attributes
    head: str = ""  # The thing alone, where there are attributes
    attributes: tuple[Attribute, ...] = ()
    words: tuple[str, ...] = ()  # Each attribute as it was written
    choices: tuple[Choice, ...] = ()
    count: int | None = None
    viewer: bool = False
    named: bool = False  # The vocabulary holds the name together
    where: tuple[int, int] = (0, 0)  # The tokens of the thing
    # tuple of (int, int, str), character ranges separate from the thing: its choices, and attributes without a thing
    modifiers: tuple[tuple[int, int, Role], ...] = ()
    superlative: Token | None = None  # `nearest` and the like, which may be a relation: `the nearest chair to the door`
    # tuple of (Attribute, str), attributes that it does not have, and the words: `the not red mug`
    lacks: tuple[tuple[Attribute, str], ...] = ()
    ordinal: tuple[int, str] | None = None  # Rank and words, until the order that it counts in is read
    predicate: bool = False  # Adjectives may stand alone: `is red`

    @property
    def name(self) -> str:
        """Thing alone."""
        return self.head or self.label

    @property
    def head_word(self) -> str:
        """Last word of the thing."""
        return self.name.split()[-1] if self.name else ""

    @property
    def anything(self) -> bool:
        """Test if the name says only that there is a thing."""
        return self.name in lexicon.ANYTHING and not self.named

    def mark(self, start: int, end: int, role: Role) -> None:
        self.modifiers = (*self.modifiers, (start, end, role))

    def choose(self, order: str, text: str, rank: int | None = 1) -> None:
        if self.ordinal is not None and rank == 1:
            rank, self.ordinal = self.ordinal[0], None
            if rank < 0:
                order, rank = choices.OPPOSITE.get(order, order), -rank
        self.choices += (Choice(order, rank, text),)  # type: ignore[arg-type]


class AttributeReader:
    """A cursor over the tokens of an expression: patterns, boundaries of names, and attributes.

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
        self.respelled: dict[int, tuple[int, int, str]] = {}
        """Misspelt words by token: where each stands, and what it was read as."""
        self.left_out: dict[int, tuple[int, int, str]] = {}
        """Words of noun phrases that are not judged, by token: where they stand, and why."""

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

    def plain(self, at: int) -> str | None:
        """Single free word at a token; None elsewhere and behind the end."""
        return self.tokens[at].plain if at < len(self.tokens) else None

    def relation(self, at: int) -> str | None:
        """Relation of the phrase at a token; None elsewhere and behind the end."""
        return self.tokens[at].relation if at < len(self.tokens) else None

    def past(self, at: int, words: Collection[str]) -> int:
        """First token from `at` on that is none of some words."""
        ahead = range(at, len(self.tokens))
        return next((k for k in ahead if self.tokens[k].plain not in words), max(at, len(self.tokens)))

    # ---- boundaries ------------------------------------------------------------------------------------------------

    def _structural(self, at: int) -> bool:
        """Test if a token is grammar, and no word of a name."""
        if at >= len(self.tokens) or self.tokens[at].relation is not None:
            return True
        word = self.tokens[at].plain
        if word in MODALS:
            return self.plain(at + 1) in ("be", "been")
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
        return self.tokens[at - 1].plain in choices.NUMBERS and self.plain(at + 1) not in DETERMINERS | {None}

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
        reference = at + 1 < len(self.tokens) and self.tokens[at].plain in ("to", "from")
        return at + 1 if reference and not self.match(choices.AT_SIDE, at) else None

    def _text(self, at: int) -> str:
        """Word as in the tables of choices and attributes; empty for names and phrases."""
        if at >= len(self.tokens):
            return ""
        token = self.tokens[at]
        if token.name is not None or (token.relation is not None and token.text not in lexicon.SUPERLATIVES):
            return ""
        return token.text.replace("-", " ")

    def _compound(self, at: int) -> bool:
        """Test if a known name of several words begins at a token: `white board`, `front door`."""
        words = [t.text for t in takewhile(lambda t: t.plain is not None, self.tokens[at : at + 4])]
        return any(is_compound(words[:n]) for n in range(2, len(words) + 1))

    def _attribute(self, at: int, draft: Phrase) -> int | None:
        for size in (3, 2, 1):
            if at + size > len(self.tokens) or any(self.breaks[at + 1 : at + size]):
                continue
            text = " ".join(self._text(k) for k in range(at, at + size)).strip()
            if (size > 1 and text.count(" ") < size - 1) or not text or (size == 3 and self._text(at + 1) != "of"):
                continue
            if size == 1 and " and " in text and all(looks := [attribute(part) for part in text.split(" and ")]):
                draft.attributes += tuple(look for look in looks if look is not None)
                draft.words += tuple(text.split(" and "))
                draft.mark(self.tokens[at].start, self.tokens[at].end, "attribute")
                return at + 1
            if size == 1 and text.startswith("non ") and (other := attribute(text[4:])):
                draft.lacks += ((other, text[4:]),)
                draft.mark(self.tokens[at].start, self.tokens[at].end, "choice")
                return at + 1
            found = attribute(text) or (None if self.plain(at + size) == "than" else _degree_of(text))
            if found is None and size == 1 and (meant := self._meant(at, draft)):
                found, text = attribute(meant), meant
                self.respelled[at] = self.tokens[at].start, self.tokens[at].end, meant
            if found is None or (size == 1 and (self._compound(at) or self._is_the_thing(at, draft, found))):
                continue
            if self._is_content(at + size - 1, found) or (size > 1 and self._compound(at + size - 1)):
                continue
            draft.attributes += (found,)
            draft.words += (text,)
            draft.mark(self.tokens[at].start, self.tokens[at + size - 1].end, "attribute")
            return at + size
        return None

    def _meant(self, at: int, draft: Phrase) -> str | None:
        """Attribute meant by a misspelt word before a thing or in a predicate: `pruple chair`; else None."""
        token = self.tokens[at] if at < len(self.tokens) else None
        if (
            token is None
            or token.plain is None
            or token.text in self.own
            or (self._ends(at + 1) and not draft.predicate)
        ):
            return None
        meant = attribute_meant(token.text)
        following = self.tokens[at + 1].text if at + 1 < len(self.tokens) else ""
        return None if meant is None or is_compound([meant, following]) else meant

    def _attributes_after(self, at: int, end: int, draft: Phrase) -> int:
        """End of the thing before attributes that follow: `something yellow`, `mug small and red`."""
        start = end
        if self.plain(end) in ("to", "for", "by", "as", "of"):
            return end
        while start > at + 1 and not any(t.plain in lexicon.WITH for t in self.tokens[at:end]):
            word, before = self.tokens[start - 1], self.tokens[start - 2]
            found = attribute(word.plain or "")
            if found is None or is_name(word.text) or self._compound(start - 2):
                break
            start -= 1
            if before.plain in lexicon.AND and start > at + 2 and attribute(self.tokens[start - 2].plain or ""):
                start -= 1
        head = self.tokens[start - 1].plain
        if start == end or head is None or not (head in lexicon.ANYTHING or is_name(singular(head))):
            return end
        for k in range(start, end):
            if found := attribute(self.tokens[k].plain or ""):
                draft.attributes += (found,)
                draft.words += (self.tokens[k].text,)
                draft.mark(self.tokens[k].start, self.tokens[k].end, "attribute")
        return start

    def _color_after(self, at: int) -> tuple[Attribute, str, int] | None:
        """Colour in a phrase behind a thing, with words and the next token: `in red`, `of a red colour`."""
        found = self.match(lexicon.LOOK_AFTER, at)
        if found is None or not self._ends(found[1]):
            return None
        words, color_word = found[0]["look"], found[0]["says"] or found[0]["color"]
        look, (first, _, last) = attribute(words), words.partition(" ")
        if look is None and last and found[0]["color"] and (look := attribute(last)) is not None:
            k = next(k for k in range(at, found[1]) if self.tokens[k].text == first)
            self.left_out[k] = self.tokens[k].start, self.tokens[k].end, "this word was not used"
            words = last
        if look is None or look.kind != "color" or (not color_word and (is_name(words) or found[0]["part"])):
            return None
        return look, words, found[1]

    def _is_the_thing(self, at: int, draft: Phrase, found: Attribute) -> bool:
        """Test if `orange`, `glass` or `light` names the thing, with no other thing behind."""
        same_kind = any(a.kind == found.kind for a in draft.attributes)
        word = self.tokens[at].text
        if (
            draft.predicate
            or same_kind
            or not (is_name(word) or (found.kind == "material" and word in default_synonyms().words))
        ):
            return False
        after = at + 1
        if after >= len(self.tokens) or self.tokens[after].plain == "of":
            return True
        # `orange, white and blue flags`
        listed = after + (self.tokens[after].plain in lexicon.AND)
        return self._ends(after) and attribute(self._text(listed)) is None

    def _is_content(self, at: int, found: Attribute) -> bool:
        """Test for `peach` in `peach jar`: a colour that first names a thing, before a package of such things."""
        word, following = self._text(at), singular(self._text(at + 1))
        named = (
            found.kind == "color" and word not in (*BASIC_COLORS, *FURTHER_COLORS, "grey", "light") and is_name(word)
        )
        return named and (is_packed(following) or is_name(f"{word} {following}"))


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


def _degree_of(word: str) -> Attribute | None:
    """Attribute of `darkest`, `most dark` and `darker`: dark, since looks are judged by degrees."""
    if word.startswith("most "):
        return attribute(word[5:])
    size = 3 if word.endswith("est") else 2 if word.endswith("er") and word not in default_synonyms().words else 0
    if not size or len(word) < size + 3:
        return None
    stems = (word[:-size], word[: 1 - size], word[: -size - 1], f"{word[: -size - 1]}y")
    return next((found for stem in stems if (found := attribute(stem)) is not None), None)


def is_name(word: str) -> bool:
    """Test if one word in lower case is a name of the project's table: `glass`, and not `red`."""
    return key_of(normal_form(word)) in default_synonyms().keys
