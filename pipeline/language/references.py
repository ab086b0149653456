"""Things of an expression after the first: references, parts of things, sides, pairs, exclusions, further names."""

from __future__ import annotations

from dataclasses import replace

from pipeline.language import choices, lexicon
from pipeline.language.attribute_reader import Phrase, is_name
from pipeline.language.chain import ChainReader, Clause, OpenRelation, not_known, unreadable
from pipeline.language.naming import DETERMINERS, is_compound, singular
from pipeline.language.relation_names import MIRRORED
from pipeline.language.tokens import Token
from pipeline.language.tree import Choice, Span
from pipeline.system.errors import InputError, require

NO_RANK = "only the closest and the farthest to a thing are judged"


class ReferenceReader(ChainReader):
    """A reader of sides, as choices, of parts of things, and of the things after the first."""

    renamed = False

    def _side(self, at: int) -> int | None:
        """Read a side that chooses: `on the left`, `furthest to the right`; None elsewhere."""
        if not self.chain.nouns and not self.asks_what:
            return None
        if " " in self.tokens[at].text:
            # `in front row`, whose first words else are a relation.
            row = self.match(choices.AT_SIDE, at)
            if row is None or not row[0]["part"] or self.tokens[at].text not in lexicon.BARE_SIDES:
                return None
        if found := self.match(choices.EXTREME_AT_SIDE, at):
            return self._choice(Choice(choices.SIDES[found[0]["side"]], 1, found[0][0].strip()), at, found[1])  # type: ignore[arg-type]
        if (bare := self._bare_side(at)) and self.chain.nouns and not self.opened:
            words = (bare[0][name] for name in ("only", "side", "two", "away", "last"))
            for order in choices.orders_of(next(filter(None, words))):
                self._choice(Choice(order, 1 if bare[0]["far"] else None, bare[0][0].strip()), at, bare[1])  # type: ignore[arg-type]
            return bare[1]
        found, region = self.match(choices.AT_SIDE, at), self.match(choices.REGION_OF, at)
        if found is None or not (found[0]["part"] or found[0]["most"] or self._ends(found[1])):
            return self._region(at)
        inside = region is not None and region[0]["side"] and region[0]["preposition"] != "to"
        if region is not None and inside and region[1] > found[1]:
            return self._region(at)
        rank = 1 if found[0]["far"] or found[0]["most"] else None
        for order in choices.orders_of(found[0]["side"]):
            self._choice(Choice(order, rank, found[0][0].strip()), at, found[1])  # type: ignore[arg-type]
        return found[1]

    def _color_phrase(self, at: int) -> int | None:
        """Read a colour in a phrase behind the thing: `in red`, `of a red colour`, `painted green`."""
        found = self._color_after(at) if self.chain.nouns and not self.opened else None
        if found is None:
            return None
        look, words, end = found
        phrase = Phrase("", attributes=(look,), words=(words,))
        phrase.mark(self.tokens[at].start, self.tokens[end - 1].end, "attribute")
        self._merge(phrase, len(self.chain.nouns) - 1)
        return end

    def _region(self, at: int) -> int | None:
        """Read a part of a thing: a relation to that thing, and a side."""
        found = self.match(choices.REGION_OF, at)
        if found is None or self.opened:
            return None
        self._any_target(at)
        preposition, side, part = found[0]["preposition"], found[0]["side"], found[0]["part"]
        noun, end = self.noun(found[1])
        if noun is not None and noun.head_word in lexicon.STACKS and part in ("top", "bottom"):
            order = "high" if part == "top" else "low"
            return self._choice(Choice(order, 1, self.words(at, end)), at, end)
        side = f"{side} {part}" if side and part in choices.SIDES else side
        attach = self._attach()
        for order in choices.orders_of(side or ""):
            choice = Choice(order, None, found[0][0].strip())  # type: ignore[arg-type]
            self.chain.clauses.append(Clause("", choice.text, (), attach=attach, choice=choice))
            attach = "same"
        scene = self._scene(found[1], named=preposition == "in")
        if scene is not None:
            if not side:
                return self._note(at, scene, "where in the frame a corner or an edge is meant is not said")
            self.chain.spans.append(self._span((at, scene), "choice", 0))
            return scene
        relation = choices.REGION_RELATION.get(preposition, "near")
        if part == "top" or (relation == "in" and noun is not None and noun.head_word in lexicon.SURFACES):
            relation = "on"
        token = Token(found[0][0].strip(), self.tokens[at].start, self.tokens[found[1] - 1].end, relation)
        if not side:
            token = self._place_left_out(token, relation)
        self.opened.append(OpenRelation(token, self._take_negation(), attach))
        return found[1]

    def _choice(self, choice: Choice, at: int, end: int) -> int:
        self._any_target(at)
        attach = self._attach()
        if self.opened:
            self.opened.pop()
        number = len(self.chain.nouns) if self.negated else 0
        span = self._span((at, end), "choice", number)
        if not any(s.start == span.start for s in self.chain.spans):
            self.chain.spans.append(span)
        if self.negated:
            # The things of the same name at that side are what it is not.
            root = self.chain.nouns[0]
            other = replace(root, choices=(*root.choices, choice), modifiers=(), where=(at, at), count=None)
            self._exclude(other, (at, at))
            self.negated = False
        else:
            self.chain.clauses.append(Clause("", choice.text, (), attach=attach, choice=choice))
        return end

    def _scene(self, at: int, *, named: bool = False, whole: bool = False) -> int | None:
        """Skip `the room`, where the scene itself is the reference; None for a thing.

        `named`: the word may be a class too; `whole`: no picture, which may be a thing of the scene.
        """
        at += self.plain(at) in DETERMINERS
        word = self.tokens[at].plain or (self.tokens[at].text if named else None) if at < len(self.tokens) else None
        if word in (lexicon.SCENE - lexicon.PICTURES if whole else lexicon.SCENE) and self._ends(at + 1):
            return at + 1
        return None

    # ---- object clauses -----------------------------------------------------------------------------------------

    def _object_clause(self, at: int) -> int | None:
        """Read `the shelf (that) the jar stands on`: a relation from the inner thing; None elsewhere."""
        word = self.tokens[at].plain
        bare = word in DETERMINERS - lexicon.RELATIVE and not self._predicative(at) and not self.breaks[at]
        asked = self.asks_what and (word in ("is", "are") if self.chain.nouns else bare)
        if self.opened or not (
            asked or (self.chain.nouns and not self.negated and not self.joined and (bare or word in lexicon.RELATIVE))
        ):
            return None
        start = at if bare else at + 1
        if not self._starts_noun(start):
            return None
        phrase, end = self._who_stands(start)
        if phrase is None or phrase.where[0] == phrase.where[1] or phrase.head_word in lexicon.SOMEBODY:
            return None
        start, end = end, self.past(end, lexicon.LINKING | lexicon.POSTURES | lexicon.NEGATIONS)
        negated = any(t.plain in lexicon.NEGATIONS for t in self.tokens[start:end])
        token = self.tokens[end] if end < len(self.tokens) else None
        if token is None or token.relation not in (*MIRRORED, "on", "in") or self._starts_noun(end + 1):
            return None
        self._any_target(at)
        self._relate(token, token.text, self._resolved(phrase), "root" if asked else "nearest", negated=negated)
        self._forget()
        return end + 1

    def _who_stands(self, at: int) -> tuple[Phrase | None, int]:
        """Read the subject of an object clause: of `the plant stands`, elsewhere a name, the plant."""
        phrase, end = self.noun(at, stop_at_and=True)
        if phrase is not None and self.tokens[end - 1].plain in lexicon.POSTURES and end - 1 > phrase.where[0]:
            self.stop = end - 1
            phrase, end = self.noun(at, stop_at_and=True)
            self.stop = None
        return phrase, end

    def _fronted(self, at: int) -> int | None:
        """Read `the table on which the lamp stands`: a relation from the later thing; None elsewhere."""
        token = self.tokens[at]
        if (
            self.plain(at + 1) not in ("which", "whom")
            or token.relation not in (*MIRRORED, "on", "in")
            or not self.chain.nouns
        ):
            return None
        phrase, end = self._who_stands(at + 2)
        if phrase is None or phrase.where[0] == phrase.where[1]:
            return None
        self._relate(token, token.text, self._resolved(phrase), "nearest", negated=False)
        self._forget()
        return self.past(end, lexicon.LINKING | lexicon.POSTURES)

    def _predicative(self, at: int) -> bool:
        """Test if a predicate begins here: `is red`, `is not the red one`, and not `there is`."""
        at -= 1
        while at > 0 and (self.tokens[at].plain in lexicon.NEGATIONS or self.tokens[at].plain in lexicon.DEGREES):
            at -= 1
        copula = self.tokens[at].plain in lexicon.BE | lexicon.POSTURES
        return bool(self.chain.nouns) and copula and self.tokens[at - 1].plain != "there"

    def _whole(self, at: int, phrase: Phrase) -> Phrase:
        """Replace a part by its whole: `the bookcase` for `the lowest shelf of the bookcase`, with a note."""
        start, end = phrase.where
        of = next((k for k in range(start, end) if self.tokens[k].plain == "of"), end)
        if phrase.named or of + 1 >= end or singular(self.tokens[of - 1].text) not in lexicon.PARTS:
            return phrase
        whole, after = self.noun(of + 1)
        if whole is None or after != end:
            return phrase
        compound = [singular(whole.head_word), singular(self.tokens[of - 1].text)]
        if self.tokens[of + 1].plain not in DETERMINERS and is_compound(compound):
            return phrase  # `shelf of books`
        self._note(at, of + 1, "which part of a thing is meant is not judged")
        return whole

    def _resolved(self, phrase: Phrase, other: Phrase | None = None, *, implied: bool = False) -> Phrase:
        """Resolve `the yellow one` to the last named thing; an implied thing too."""
        if not phrase.anything or not (implied or phrase.head_word in ("one", "ones")) or not self.chain.nouns:
            return phrase
        named = other if other is not None and not other.anything else self.chain.nouns[-1]
        words, tail = list(phrase.words), phrase.label.partition(phrase.name)[2]
        return replace(phrase, label=" ".join([*words, named.name + tail]), head=named.name if words or tail else "")

    # ---- things after the first -------------------------------------------------------------------------------------

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
        viewer = Phrase(label=self.tokens[end].text, viewer=True)
        self._refer(self._add_noun(viewer, "reference", (end, end + 1)))
        return end + 1

    def _reference(self, at: int, phrase: Phrase, end: int) -> int:
        if self._is_pronoun(phrase):
            self._forget()
            return self._refused(self._names_nothing("reference", phrase), at, end, self.opened.pop().token)
        token, root = self.opened[-1].token, self.chain.nouns[0]
        if phrase.head_word in lexicon.STACKS and not phrase.named and token.relation == "on":
            # Of a stack the thing on top of it is the highest.
            self.chain.spans.append(Span(token.start, token.end, "choice", 0))
            return self._choice(Choice("high", 1, f"{token.text} {self.words(at, end)}"), at, end)
        order = lexicon.SCENE_ORDER.get(str(token.relation))
        again = singular(phrase.head_word) == singular(root.head_word) and not phrase.attributes
        others = any(t.plain in lexicon.OTHER for t in self.tokens[at:end])
        several = not others and (phrase.name in choices.NUMBERS or (phrase.count and again))
        ends = end >= len(self.tokens) or self.breaks[end]
        if order is not None and several and ends and " of" in token.text and not self.chain.clauses:
            # `the mug on the left of the two (mugs)`
            rank = 1 if order == "middle" or (phrase.count or choices.NUMBERS.get(phrase.name)) == 2 else None
            self.chain.spans.append(Span(token.start, token.end, "choice", 0))
            return self._choice(Choice(order, rank, f"{token.text} {self.words(at, end)}"), at, end)  # type: ignore[arg-type]
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

    def _later_and(self, at: int) -> int | None:
        """Next `and` before a noun, behind words about the first of a pair."""
        if self.opened[-1].token.text.endswith(" of"):
            return None
        ahead = (k for k in range(at, len(self.tokens)) if self.tokens[k].plain == "and" and self._starts_noun(k + 1))
        return next(ahead, None)

    def _second(self, first: Phrase, number: int, end: int) -> tuple[int | None, int]:
        """Read the other reference of `between`; `the two chairs` are both."""
        if (side := self.match(choices.AT_SIDE, end)) is not None and self.plain(side[1]) in lexicon.AND:
            for order in choices.orders_of(side[0]["side"]):
                choice = Choice(order, None, side[0][0].strip())  # type: ignore[arg-type]
                self.chain.nouns[number] = replace(first, choices=(*first.choices, choice))
            self.chain.spans.append(self._span((end, side[1]), "choice", number))
            end = side[1]
        elif self.plain(end) not in lexicon.AND and (later := self._later_and(end)) is not None:
            end = self._note(end, later, "words within a pair are not read")
        if self.plain(end) in lexicon.AND and not (first.count == 2 and self._ends(end + 1)):
            phrase, after = self.noun(end + 1)
            if phrase is None and " of" in self.opened[-1].token.text:
                return None, end
            self._relation_span(self.tokens[end])
            if phrase is None:
                raise self._missing_reference("and")
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
                self._exclude(self._resolved(one, root, implied=implied), where)
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
        if viewer is not None:
            return viewer
        reference, end = self.noun(at)
        if reference is None:
            raise self._missing_reference(self.opened[-1].token.text)
        return self._reference(at, reference, end)
