"""Things of an expression after the first: references of relations, pairs, `one`, exclusions, and further names."""

from __future__ import annotations

from dataclasses import replace

from pipeline.language import choices, lexicon
from pipeline.language.attribute_reader import is_name
from pipeline.language.chain import Clause, OpenRelation
from pipeline.language.naming import DETERMINERS, singular
from pipeline.language.nouns import Phrase
from pipeline.language.regions import RegionReader
from pipeline.language.tokens import EXAMPLE
from pipeline.language.tree import Choice, Span
from pipeline.language.unreadable import FORM, not_known, unreadable
from pipeline.system.errors import InputError, require

NO_RANK = "only the closest and the farthest to a thing are judged"


class ReferenceReader(RegionReader):
    """A reader of the things after the first."""

    renamed = False

    def _relates(self, at: int) -> bool:
        return at < len(self.tokens) and self.tokens[at].relation is not None and not self.breaks[at]

    def _viewer(self, at: int) -> int | None:
        end = at + (self.tokens[at].plain in DETERMINERS)
        if end >= len(self.tokens) or self.tokens[end].plain not in lexicon.VIEWERS or not self._ends(end + 1):
            return None
        require(
            self.opened[-1].token.relation != "between",
            f"'{self.opened[-1].token.text}' needs two references that are seen, and the viewer is none",
            got=f"'{self.text}'",
            expected="TARGET between REFERENCE and REFERENCE",
        )
        phrase = Phrase(label=self.tokens[end].text, viewer=True)
        self._refer(self._add_noun(phrase, "reference", (end, end + 1)))
        return end + 1

    def _reference(self, at: int, phrase: Phrase, end: int) -> int:
        if self._is_pronoun(phrase):
            self.problems.append(self._names_nothing("reference", phrase))
            self._note(at, end, self.problems[-1].what, self.opened.pop().token)
            self._forget()
            return end
        if phrase.head_word in lexicon.STACKS and not phrase.named and self.opened[-1].token.relation == "on":
            # Of a stack the thing on top of it is the highest.
            token = self.opened[-1].token
            self._choice(Choice("high", 1, f"{token.text} {self.words(at, end)}"), at, end)
            self.chain.spans.append(Span(token.start, token.end, "choice", 0))
            return end
        token, root = self.opened[-1].token, self.chain.nouns[0]
        order = lexicon.SCENE_ORDER.get(str(token.relation))
        again = singular(phrase.head_word) == singular(root.head_word) and not phrase.attributes
        others = any(t.plain in lexicon.OTHER for t in self.tokens[at:end])
        several = not others and (phrase.name in choices.NUMBERS or (phrase.count and again))
        ends = end >= len(self.tokens) or self.breaks[end]
        if order is not None and several and ends and " of" in token.text and not self.chain.clauses:
            # `the mug on the left of the two (mugs)`
            rank = 1 if order == "middle" or (phrase.count or choices.NUMBERS.get(phrase.name)) == 2 else None
            self._choice(Choice(order, rank, f"{token.text} {self.words(at, end)}"), at, end)  # type: ignore[arg-type]
            self.chain.spans.append(Span(token.start, token.end, "choice", 0))
            return end
        bare = phrase.name in ("other", "others") and not phrase.named
        if bare or self.words(at, end).lower() in lexicon.RECIPROCAL:
            phrase = replace(phrase, label=self.chain.nouns[0].label, head=self.chain.nouns[0].head)
        phrase = self._whole(at, self._resolved(phrase))
        first = self._add_noun(phrase, "reference", phrase.where)
        if self.opened[-1].token.relation == "between":
            second, end = self._second(phrase, first, end)
            if second is None and " of" in self.opened[-1].token.text:
                # In the middle of one thing: on it, and the place there is not judged.
                opened = self.opened.pop()
                self.opened.append(replace(opened, token=self._place_left_out(opened.token, "on")))
                self._refer(first)
            elif second is None:
                raise InputError(
                    f"'{self.opened[-1].token.text}' needs two references",
                    got=f"'{self.text}'",
                    expected="TARGET between REFERENCE and REFERENCE",
                )
            else:
                self._refer(first, second)
        else:
            self._refer(first)
        return end

    def _joins(self, at: int) -> bool:
        return at < len(self.tokens) and self.tokens[at].plain in lexicon.AND

    def _later_and(self, at: int) -> int | None:
        """Next `and` before a noun, behind words about the first of a pair."""
        if self.opened[-1].token.text.endswith(" of"):
            return None
        ahead = (k for k in range(at, len(self.tokens)) if self.tokens[k].plain == "and" and self._starts_noun(k + 1))
        return next(ahead, None)

    def _second(self, first: Phrase, number: int, end: int) -> tuple[int | None, int]:
        """Read the other reference of `between`; `the two chairs` are both."""
        if (side := self.match(choices.AT_SIDE, end)) is not None and self._joins(side[1]):
            for order in choices.orders_of(side[0]["side"]):
                choice = Choice(order, None, side[0][0].strip())  # type: ignore[arg-type]
                self.chain.nouns[number] = replace(first, choices=(*first.choices, choice))
            span = Span(self.tokens[end].start, self.tokens[side[1] - 1].end, "choice", number)
            self.chain.spans.append(span)
            end = side[1]
        elif not self._joins(end) and (later := self._later_and(end)) is not None:
            self._note(end, later, "words within a pair are not read")
            end = later
        if (
            end < len(self.tokens)
            and self.tokens[end].plain in lexicon.AND
            and not (first.count == 2 and self._ends(end + 1))
        ):
            phrase, after = self.noun(end + 1)
            if phrase is None and " of" in self.opened[-1].token.text:
                return None, end
            self._relation_span(self.tokens[end])
            if phrase is None:
                raise InputError(
                    "the reference is missing after 'and'", got=f"'{self.text}'", expected=FORM, cause=EXAMPLE
                )
            return self._add_noun(self._resolved(phrase, first), "reference", phrase.where), after
        if first.count == 2 or (first.count is None and first.head_word != singular(first.head_word)):
            self.chain.nouns.append(first)
            return number + 1, end
        return None, end

    def _further(self, at: int, phrase: Phrase, end: int) -> int:
        """Read a noun without a relation before: the target once more, an exclusion, or nothing of use."""
        root = self.chain.nouns[0]
        if self.negated:
            where = phrase.where
            implied = root.anything and root.where[0] == root.where[1]
            tail = root.label.partition(root.name)[2]
            if root.anything and (root.head_word == "one" or implied) and not phrase.anything and not tail:
                bare = replace(phrase, attributes=(), words=(), modifiers=(), choices=())
                self._merge(bare, named=True)
                where = (end, end)
                root = self.chain.nouns[0]
            several = phrase.name in choices.NUMBERS and self._goes_on(end)
            placed = self._relates(end) or self.match(choices.AT_SIDE, end) is not None
            same = placed and singular(phrase.name) == singular(root.name)
            again = phrase.anything or several or same
            if again and not (phrase.attributes or phrase.choices):
                # `not the ones on the stool`: what follows is negated.
                self.at_root = True
                self.chain.spans += [self._span(self._tail_noted(phrase), "target", 0)] if same else []
                return end
            implied = phrase.where[0] == phrase.where[1]
            listed = self.joined or any(self.breaks[k] for k in range(at + 1, end))
            each = list(zip(phrase.attributes, phrase.words, strict=True)) if implied and listed else []
            # `neither red, green nor blue` is none of them, `not the small red one` not what is both.
            several = [replace(phrase, label=f"{w} thing", attributes=(a,), words=(w,)) for a, w in each] or [phrase]
            for one in several:
                number = self._add_noun(self._resolved(one, root, implied=implied), "reference", where)
                self.chain.clauses.append(Clause("", "not", (number,), attach="root", negated=True, closed=True))
            self.negated, self.at_root = False, True
            return end
        clauses = self.chain.clauses
        if self.joined and not self.linked and clauses and clauses[-1].references and not phrase.anything:
            last = clauses[-1]
            number = self._add_noun(self._resolved(phrase), "reference", phrase.where)
            clauses.append(replace(last, references=(number, *last.references[1:]), attach="same"))
            self._forget()
            return end
        same = phrase.name == root.name or phrase.anything or phrase.name in root.name.split()
        predicative = self._predicative(at)
        noun = self.tokens[at].plain in DETERMINERS or is_name(singular(phrase.head_word))
        named = predicative and noun and (root.anything or phrase.name.endswith(f" {root.name}"))
        copula_before = any(t.plain in lexicon.BE for t in self.tokens[:at])
        if self.joined and not copula_before and not clauses and not same:
            joint = "and the" if self.tokens[at].plain in DETERMINERS else "and"
            raise InputError(f"'{joint}' names a second target", got=f"'{self.text}'", expected="one target a relation")
        if same or named or (predicative and (phrase.attributes or phrase.choices)):
            relative = {self.tokens[at - 1].plain, self.tokens[at - 2].plain} & lexicon.RELATIVE_COPULAS
            number = len(self.chain.nouns) - 1 if relative and same else 0
            if not (same or named):
                self._note(*phrase.where, "another name for the same thing")
                phrase = replace(phrase, where=(end, end))
            self.renamed = self.renamed or (named and not same)
            self._merge(phrase, number, named=named and not same)
            self.at_root = number == 0
        else:
            self.problems.append(
                not_known(self.tokens, max(at - 1, 1), self.text) if at else unreadable(phrase.label, self.text)
            )
            self._note(at, end, "a second thing without a relation to the first")
        self._forget()
        return end

    def _nearest_noun(self, phrase: Phrase, end: int, at: int) -> int:
        """Read `the nearest chair to the door`: the relation stands before the noun."""
        early = phrase.superlative
        assert early is not None
        others = tuple(c for c in phrase.choices if c.text != early.text)
        if any(c.text == early.text and c.rank != 1 for c in phrase.choices):
            before = [m for m in phrase.modifiers if m[1] <= early.start]
            self.chain.spans += [Span(m[0], m[1], "unused", 0, NO_RANK) for m in before[-1:]]
            phrase = replace(phrase, modifiers=tuple(m for m in phrase.modifiers if m not in before[-1:]))
        modifiers = tuple(m for m in phrase.modifiers if m[0] != early.start)
        phrase = replace(phrase, superlative=None, choices=others, modifiers=modifiers)
        if self.opened:
            self._refer(self._add_noun(phrase, "reference", phrase.where))
        elif not self.chain.nouns:
            self._add_noun(phrase, "target", phrase.where)
        else:
            self._merge(phrase)
        link = self.tokens[end]
        self._relation_span(early)
        self.opened.append(
            OpenRelation(replace(link, text=f"{early.text} {link.text}", relation=early.relation), False, "nearest")
        )
        viewer = self._viewer(at)
        return self._reference(at, *self._required(at)) if viewer is None else viewer

    def _required(self, at: int) -> tuple[Phrase, int]:
        phrase, end = self.noun(at)
        if phrase is None:
            raise self._missing_reference(self.opened[-1].token.text)
        return phrase, end
