"""Attributes in an expression: before the thing, after it, misspelt, or naming a thing themselves."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, field

from pipeline.language import choices, lexicon
from pipeline.language.attributes import BASIC_COLORS, FURTHER_COLORS, Attribute, attribute
from pipeline.language.cursor import Cursor
from pipeline.language.name_lookup import is_packed
from pipeline.language.naming import default_synonyms, is_compound, key_of, known_words, singular
from pipeline.language.normal import normal_form
from pipeline.language.spelling import attribute_meant
from pipeline.language.tokens import Token
from pipeline.language.tree import Choice, Role


@dataclass
class DraftPhrase:
    """A noun phrase under construction."""

    attributes: list[Attribute]
    words: list[str]
    choices: list[Choice]
    modifiers: list[tuple[int, int, Role]]
    count: int | None = None
    ordinal: tuple[int, str] | None = None
    superlative: Token | None = None
    predicate: bool = False
    lacks: list[tuple[Attribute, str]] = field(default_factory=list)

    def choose(self, order: str, text: str, rank: int | None = 1) -> None:
        if self.ordinal is not None and rank == 1:
            rank, self.ordinal = self.ordinal[0], None
            if rank < 0:
                order, rank = choices.OPPOSITE.get(order, order), -rank
        self.choices.append(Choice(order, rank, text))  # type: ignore[arg-type]


class AttributeReader(Cursor):
    """A cursor that reads attributes."""

    def __init__(self, text: str, tokens: Sequence[Token], own: Collection[str] = ()) -> None:
        super().__init__(text, tokens, own)
        self.respelled: dict[int, tuple[int, int, str]] = {}
        """Misspelt words by token: where each stands, and what it was read as."""
        self.left_out: dict[int, tuple[int, int, str]] = {}
        """Words of noun phrases that are not judged, by token: where they stand, and why."""

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
        words: list[str] = []
        for k in range(at, min(at + 4, len(self.tokens))):
            if self.tokens[k].plain is None:
                return False
            words.append(self.tokens[k].text)
            if len(words) > 1 and is_compound(words):
                return True
        return False

    def _attribute(self, at: int, draft: DraftPhrase) -> int | None:
        for size in (3, 2, 1):
            if at + size > len(self.tokens) or any(self.breaks[at + 1 : at + size]):
                continue
            text = " ".join(self._text(k) for k in range(at, at + size)).strip()
            if (size > 1 and text.count(" ") < size - 1) or not text or (size == 3 and self._text(at + 1) != "of"):
                continue
            if size == 1 and " and " in text and all(looks := [attribute(part) for part in text.split(" and ")]):
                draft.attributes += [look for look in looks if look is not None]
                draft.words += text.split(" and ")
                draft.modifiers.append((self.tokens[at].start, self.tokens[at].end, "attribute"))
                return at + 1
            if size == 1 and text.startswith("non ") and (other := attribute(text[4:])):
                draft.lacks.append((other, text[4:]))
                draft.modifiers.append((self.tokens[at].start, self.tokens[at].end, "choice"))
                return at + 1
            than = at + size < len(self.tokens) and self.tokens[at + size].plain == "than"
            found = attribute(text) or (None if than else _degree_of(text))
            if found is None and size == 1 and (meant := self._meant(at, draft)):
                found, text = attribute(meant), meant
                self.respelled[at] = self.tokens[at].start, self.tokens[at].end, meant
            if found is None or (size == 1 and (self._compound(at) or self._is_the_thing(at, draft, found))):
                continue
            if self._is_content(at + size - 1, found) or (size > 1 and self._compound(at + size - 1)):
                continue
            draft.attributes.append(found)
            draft.words.append(text)
            draft.modifiers.append((self.tokens[at].start, self.tokens[at + size - 1].end, "attribute"))
            return at + size
        return None

    def _meant(self, at: int, draft: DraftPhrase) -> str | None:
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

    def _attributes_after(self, at: int, end: int, draft: DraftPhrase) -> int:
        """End of the thing before attributes that follow: `something yellow`, `mug small and red`."""
        start = end
        if self.tokens[end].plain in ("to", "for", "by", "as", "of") if end < len(self.tokens) else False:
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
                draft.attributes.append(found)
                draft.words.append(self.tokens[k].text)
                draft.modifiers.append((self.tokens[k].start, self.tokens[k].end, "attribute"))
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

    def _is_the_thing(self, at: int, draft: DraftPhrase, found: Attribute) -> bool:
        """Test if `orange`, `glass` or `light` names the thing, with no other thing behind."""
        same_kind = any(a.kind == found.kind for a in draft.attributes)
        word = self.tokens[at].text
        if draft.predicate or same_kind or not (is_name(word) or (found.kind == "material" and word in known_words())):
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


def _degree_of(word: str) -> Attribute | None:
    """Attribute of `darkest`, `most dark` and `darker`: dark, since looks are judged by degrees."""
    if word.startswith("most "):
        return attribute(word[5:])
    size = 3 if word.endswith("est") else 2 if word.endswith("er") and word not in known_words() else 0
    if not size or len(word) < size + 3:
        return None
    stems = (word[:-size], word[: 1 - size], word[: -size - 1], f"{word[: -size - 1]}y")
    return next((found for stem in stems if (found := attribute(stem)) is not None), None)


def is_name(word: str) -> bool:
    """Test if one word in lower case is a name of the project's table: `glass`, and not `red`."""
    return key_of(normal_form(word)) in default_synonyms().keys
