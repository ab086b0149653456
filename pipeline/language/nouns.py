"""Noun phrases of an expression: the thing, its attributes, choices among several, and their number."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import replace

from pipeline.language import choices, lexicon
from pipeline.language.attribute_reader import MODALS, AttributeReader, Phrase
from pipeline.language.attributes import attribute
from pipeline.language.naming import DETERMINERS, is_compound, singular
from pipeline.language.relation_names import MIRRORED
from pipeline.language.tokens import Token, is_known, label_of
from pipeline.language.tree import Choice

QUANTIFIERS = frozenset(
    {"all", "both", "each", "every", "same", "whichever", "whatever", "either", "only", "several", "few", "many"}
)
_JUST = frozenset({"just", "directly", "right", "immediately", "slightly", "exactly", "straight", "almost", "very"})
_LONGEST_CHOICE = 3
_NO_PART_OF_A_NAME = lexicon.LINKING | lexicon.NEGATIONS | lexicon.UNKNOWN_RELATIONS | lexicon.VERBS
ALTERNATIVES = "of alternatives only the first is judged"


class NounReader(AttributeReader):
    """A cursor that reads noun phrases."""

    asks_what = False
    stop: int | None = None
    negated = False

    # ---- one noun phrase -------------------------------------------------------------------------------------------

    def noun(self, at: int, *, stop_at_and: bool = False, predicate: bool = False) -> tuple[Phrase | None, int]:
        """Read a noun phrase at a token, with the token after; None without a noun phrase.

        With `stop_at_and` an `and` never belongs to the name; as a `predicate` adjectives may stand alone: `is red`.
        """
        draft = Phrase(predicate=predicate)
        at = self._before(self._determiners(at), draft)
        if draft.choices or draft.ordinal or draft.words:
            at = self._of_several(at, draft)
        end = self._head_end(at, draft, stop_at_and=stop_at_and)
        after = self._ordinal_end(end, draft)
        end = self._attributes_after(at, end, draft)
        head = self.tokens[at:end]
        if len(head) > 2 and head[0].plain in lexicon.STACKS and head[1].plain == "of":
            head = head[2:]  # the books of `pile of books`
        if not head and not (draft.attributes or draft.choices or draft.count or draft.lacks):
            return None, after
        start = _first_word(draft, self.tokens, at if not head else end - len(head))
        name, cut = "thing", end
        if head:
            cut = next((k for k, t in enumerate(head) if k and t.plain in lexicon.WITH), len(head))
            name = head[0].text if head[0].text in lexicon.ANYTHING and len(head) == 1 else label_of(self.text, head)
        label = " ".join([*draft.words, name])
        alone = label_of(self.text, head[:cut]) if head and cut < len(head) else name
        return replace(
            draft,
            label=label,
            head=alone if alone != label else "",
            named=len(head) == 1 and head[0].name is not None,
            where=(start, end) if head else (end, end),
            modifiers=tuple(
                m
                for m in draft.modifiers
                if not head
                or (m[2] == "choice" and m[0] != self.tokens[start].start)
                or not self.tokens[start].start <= m[0] < self.tokens[end - 1].end
            ),
        ), after

    def _determiners(self, at: int) -> int:
        while at < len(self.tokens):
            found = self.match(lexicon.SEEMS, at) or self.match(lexicon.PARTITIVE, at)
            if found is None and self.tokens[at].plain not in DETERMINERS | QUANTIFIERS:
                break
            at = found[1] if found else at + 1
        return at

    def _before(self, at: int, draft: Phrase) -> int:
        """Read choices, numbers and attributes before the head."""
        start = at
        while at < len(self.tokens):
            token = self.tokens[at]
            if (ranked := self._ranked(at, draft)) is not None:
                at = ranked
                continue
            end = self._choice_before(at, draft) or self._attribute(at, draft)
            superlative = at + 1 < len(self.tokens) and self.tokens[at + 1].text in lexicon.BEFORE_NOUNS
            if end is None and token.plain in choices.NUMBERS and (superlative or not self._ends(at + 1)):
                draft.count, end = choices.NUMBERS[token.plain], at + 1
            if end is None and token.plain == "one" and at == start and self._starts_noun(at + 1):
                end = None if self._ends(at + 1) or self.plain(at + 1) in ("of", *choices.ORDINALS) else at + 1
            following = attribute(self._text(at + 1)) or attribute(self._meant(at + 1, draft) or "")
            listed = token.plain in ("and", "&") and draft.attributes and following
            if end is None and (listed or (token.plain in lexicon.OTHER and not self._ends(at + 1))):
                end = at + 1
            if end is None and token.plain == "or" and draft.attributes and following and not self.negated:
                end = at + 2
                self.left_out[at] = token.start, self.tokens[at + 1].end, ALTERNATIVES
            if end is None and token.plain == "not" and following and at == start:
                end = at + 2
                draft.lacks += ((following, self._text(at + 1)),)
                draft.mark(token.start, self.tokens[at + 1].end, "choice")
            if end is None or (at > start and self.breaks[at] and not draft.attributes):
                break
            at = end
        return at

    def _ranked(self, at: int, draft: Phrase) -> int | None:
        """Read a side of several, a rank from the last, or a number: `left of the two`, `second to last`."""
        token = self.tokens[at]
        if found := self.match(lexicon.OF_SEVERAL, at):
            draft.choose(choices.SIDES[found[0]["side"]], found[0]["side"])
            draft.mark(token.start, token.end, "choice")
            return self._determiners(found[1])
        if token.plain == "very" and self._text(at + 1) in choices.ORDINALS:
            return at + 1
        if found := self.match(choices.FROM_LAST, at):
            draft.ordinal = -choices.ORDINALS.get(found[0]["rank"] or "second", 2), found[0][0].strip()
            draft.mark(token.start, self.tokens[found[1] - 1].end, "choice")
            return found[1]
        return self._numbered(at, draft)

    def _numbered(self, at: int, draft: Phrase | None = None) -> int | None:
        """Skip `number 2`, `no. two` or `#2`, an ordinal; None elsewhere."""
        if at >= len(self.tokens):
            return None
        sign = self.text[self.tokens[at].start - 1 : self.tokens[at].start] == "#"
        last = at if sign else at + 1
        word = self.plain(last) or ""
        rank = choices.NUMBERS.get(word, 1 if word in ("1", "one") else None)
        if rank is None or not (sign or self.tokens[at].plain in ("number", "no", "nr", "num")):
            return None
        if draft is not None:
            draft.ordinal = rank, self.words(at, last + 1).lower()
            draft.mark(self.tokens[at].start, self.tokens[last].end, "choice")
        return last + 1

    def _choice_before(self, at: int, draft: Phrase) -> int | None:
        if self.breaks[at] and at and draft.choices:
            return None
        for size in range(_LONGEST_CHOICE, 0, -1):
            if at + size > len(self.tokens) or any(self.breaks[at + 1 : at + size]):
                continue
            words = [self._text(k) for k in range(at, at + size)]
            if not all(words):
                continue
            text = " ".join(words)
            first, _, last = text.partition(" ")
            if last in choices.EXTREMES and (first == "next" or (size == 1 and first in choices.ORDINALS)):
                draft.ordinal, text = (choices.ORDINALS.get(first, 2), first), last
            order = choices.EXTREMES.get(text)
            sided = size > 1 and words[-1] == "side" and self._starts_noun(at + size) and self._text(at + size) != "of"
            sides = choices.orders_of(" ".join(words[:-1]) if sided else text)
            if sides and order == "low" and self._text(at + size) in choices.SIDES:
                order = None  # `lower left chair`
            rank = choices.ORDINALS.get(text) if size == 1 else None
            if order is None and not sides and rank is None:
                continue
            after = at + size
            if self._compound(at) or (size == 1 and not self._may_choose(text, after, draft, bool(sides))):
                return None
            if rank is not None:
                draft.ordinal = rank, text
            elif order is not None:
                draft.choose(order, text)
                word = self.tokens[at].text
                if word in lexicon.SUPERLATIVES or text in lexicon.NEARER:
                    draft.superlative = replace(
                        self.tokens[at], relation=lexicon.NEARER.get(word, self.tokens[at].relation)
                    )
            else:
                for side in sides:
                    draft.choose(side, text, None)
            draft.mark(self.tokens[at].start, self.tokens[after - 1].end, "choice")
            return after
        return None

    def _may_choose(self, text: str, after: int, draft: Phrase, side: bool) -> bool:
        """Test if a word that could be part of a name chooses: before more words, or alone for the thing."""
        following = self.plain(after)
        if text in choices.COMPARATIVES and following == "than":
            return False
        alone = side and following != "of" and self._ends(after)
        return not alone or bool(draft.choices) or bool(draft.attributes)

    def _of_several(self, at: int, draft: Phrase) -> int:
        """Skip `of the two` in `the taller (one) of the two boxes`."""
        if found := self.match(lexicon.PARTITIVE, at):
            return self._before(self._determiners(found[1]), draft)
        if self.plain(at) != "of":
            return at
        if self._filler(at) and (found := self.match(lexicon.FILLER, at)):
            return found[1]
        if draft.choices and all(c.rank is None for c in draft.choices):
            # `the back of the chair` is a part of it, `the middle of the chairs` one of them.
            whole, _ = self.noun(at + 1)
            if whole is None or not (whole.count or singular(whole.head_word) != whole.head_word):
                return at
        return self._before(self._determiners(at + 1), draft)

    def _head_end(self, at: int, draft: Phrase, *, stop_at_and: bool) -> int:
        end = at
        while end < len(self.tokens):
            token, word = self.tokens[end], self.tokens[end].plain
            if token.relation is not None or (end > at and self.breaks[end]):
                break
            before = self.plain(end - 1) if end > at else None
            if end == self.stop or (word is not None and self._stops(end, at, word, before, stop_at_and)):
                break
            end += 1
        return end

    def _stops(self, end: int, at: int, word: str, before: str | None, stop_at_and: bool) -> bool:
        if word in DETERMINERS:
            return end > at and before not in lexicon.ARTICLE_BEARING
        if (word == "of" and end > at and self._sided(end + 1)) or (
            word in ("of", "with") and end > at and (self._color_after(end) is not None or self._filler(end))
        ):
            return True
        if word in lexicon.WITH:
            return word != "with" or end == at or not self._starts_noun(end + 1) or self._with_relation(end + 1)
        if word in lexicon.AND:
            if any(is_compound([t.text for t in self.tokens[at:k]]) for k in (end + 2, end + 3)):
                return False
            return (
                stop_at_and or word == "but" or end == at or self._ends(end + 1) or self.plain(end + 1) in DETERMINERS
            )
        if word in lexicon.ARTICLE_BEARING:
            return end == at or (word == "or" and self._ends(end + 1))
        if end == at:
            return word in lexicon.COPULAS or word in lexicon.NEGATIONS or word in lexicon.UNKNOWN_RELATIONS
        if (
            word in lexicon.SOMEBODY
            or (word in choices.ORDINALS and self._orders(end + 1))
            or self._numbered(end) is not None
            or self.match(lexicon.EXCEPT, end) is not None
            or self._color_after(end) is not None
        ):
            return True
        if word.endswith("ed") and not is_known(word) and end + 1 < len(self.tokens):
            # `flanked by`
            return self.relation(end + 1) is not None
        if self._bare_side(end) is not None:
            return True
        if word in _JUST:
            return self._ends(end + 1)
        if word in MODALS:
            return self.plain(end + 1) in ("be", "see", "been")
        if word in lexicon.POSTURES:
            # `tv stands` are things; `the tv stands` is one that does.
            verb = any(self.tokens[k].plain in DETERMINERS for k in range(max(at - 3, 0), at))
            return (
                (verb or (self.asks_what and at < 3))
                and (self._ends(end + 1) or self.plain(end + 1) in ("high", "low"))
                and not is_compound([self.tokens[end - 1].text, singular(word)])
            )
        if word in ("it", "this") or self.match(choices.EXTREME_AT_SIDE, end) or self._filler(end):
            return True
        if word in ("up", "down", "out", "back", "over", "high", "low"):
            after = end + 1 + (self.plain(end + 1) in ("up", "down"))
            if self.relation(after) is not None or self.match(choices.AT_SIDE, end + 1) is not None:
                return True
        if word in ("left", "right"):
            return not self._compound(end - 1)
        if self.match(choices.AT_SIDE, end) is not None or self._counts_from(end) is not None:
            return True
        looks = before in lexicon.ARTICLE_BEARING and word.endswith("ed") and not self._ends(end + 1)
        return word in _NO_PART_OF_A_NAME and not looks

    def _counts_from(self, at: int) -> tuple[re.Match[str], int] | None:
        """Match the start of counting of an ordinal; `on the top` of `on the top shelf` is none."""
        found = self.match(choices.FROM_SIDE, at)
        return None if found is None or ("from" not in found[0][0] and not self._ends(found[1])) else found

    def _sided(self, at: int) -> bool:
        """Test if `the left one` begins here, and no word of a name."""
        at += self.plain(at) in DETERMINERS
        return (
            self._text(at) in ("left", "right", *choices.ORDINALS) and not self._ends(at + 1) and not self._compound(at)
        )

    def _orders(self, at: int) -> bool:
        """Test if an order follows an ordinal: `(second) from the left`, `(second) closest`."""
        text = self._text(at)
        extreme = text in choices.EXTREMES and text not in choices.SIDES
        return extreme or self.relation(at) in ("closest", "farthest") or self._counts_from(at) is not None

    def _filler(self, at: int) -> bool:
        found = self.match(lexicon.FILLER, at)
        return found is not None and " " in found[0][0].strip() and self._goes_on(found[1])

    def _with_relation(self, at: int) -> bool:
        """Test if `with a lamp on top` follows, and no part of the thing."""
        end = self.past(self.noun(at)[1], lexicon.LINKING - DETERMINERS)
        return end < len(self.tokens) and self._with_tail(end) is not None

    def _with_tail(self, at: int) -> int | None:
        """Skip `on top (of it)`; None where no relation of two things ends the clause."""
        token = self.tokens[at]
        # Only what can be said from the other side, by another name or by a phrase of its own.
        if token.relation not in MIRRORED and token.relation not in lexicon.SAYS_SWAPPED:
            return None
        if self.plain(at + 1) in lexicon.PLACE_PRONOUNS:
            return at + 2
        bare = token.text in lexicon.BARE_TAILS or token.text in ("on", "in")
        return at + 1 if bare and not self._starts_noun(at + 1) else None

    def _ordinal_end(self, end: int, draft: Phrase) -> int:
        """Read `from the left` after an ordinal: the start of counting."""
        if draft.ordinal is None:
            end = self._numbered(end, draft) or end
        if draft.ordinal is None:
            return end
        found = self._counts_from(end)
        rank, text = draft.ordinal
        draft.ordinal = None
        order, after = "left", end
        if found is not None:
            order, after = choices.SIDES[found[0]["side"]], found[1]
            text = f"{text} {found[0][0].strip()}"
            draft.mark(self.tokens[end].start, self.tokens[after - 1].end, "choice")
            if rank == -1 and found[0][0].startswith(("on", "at", "to")):
                rank = 1
        if rank < 0:
            order, rank = choices.OPPOSITE.get(order, order), -rank
        draft.choices += (Choice(order, rank, text),)  # type: ignore[arg-type]
        return after


def _first_word(draft: Phrase, tokens: Sequence[Token], head: int) -> int:
    """First token of the thing and of the attributes right before."""
    starts = {start for start, _, role in draft.modifiers if role == "attribute"}
    first = head
    for k in range(head - 1, -1, -1):
        if tokens[k].start in starts:
            first = k
        elif tokens[k].plain not in lexicon.AND and not any(m[0] < tokens[k].start < m[1] for m in draft.modifiers):
            break
    return first
