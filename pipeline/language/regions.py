"""Sides and parts in an expression, `at the right end of the couch`, and clauses, `the shelf the jar stands on`."""

from __future__ import annotations

from dataclasses import replace

from pipeline.language import choices, lexicon
from pipeline.language.chain import Attach, ChainReader, Clause, OpenRelation
from pipeline.language.naming import DETERMINERS, is_compound, singular
from pipeline.language.nouns import Phrase
from pipeline.language.relation_names import MIRRORED
from pipeline.language.tokens import Token
from pipeline.language.tree import Choice, Span


class RegionReader(ChainReader):
    """A reader of sides, as choices, and of parts of things."""

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
            self._choice(Choice(choices.SIDES[found[0]["side"]], 1, found[0][0].strip()), at, found[1])  # type: ignore[arg-type]
            return found[1]
        if (bare := self._bare_side(at)) and self.chain.nouns and not self.opened:
            words = (bare[0][name] for name in ("only", "side", "two", "away", "last"))
            for order in choices.orders_of(next(filter(None, words))):
                self._choice(Choice(order, 1 if bare[0]["far"] else None, bare[0][0].strip()), at, bare[1])  # type: ignore[arg-type]
            return bare[1]
        found, region = self.match(choices.AT_SIDE, at), self.match(choices.REGION_OF, at)
        inside = region is not None and region[0]["side"] and region[0]["preposition"] != "to"
        if found is not None and region is not None and inside and region[1] > found[1]:
            return self._region(at)
        if found is None or not (found[0]["part"] or found[0]["most"] or self._ends(found[1])):
            return self._region(at)
        rank = 1 if found[0]["far"] or found[0]["most"] else None
        for order in choices.orders_of(found[0]["side"]):
            self._choice(Choice(order, rank, found[0][0].strip()), at, found[1])  # type: ignore[arg-type]
        return found[1]

    def _color_phrase(self, at: int) -> int | None:
        """Read a colour in a phrase behind the thing: `in red`, `of a red colour`, `painted green`."""
        found = None if self.opened else self._color_after(at)
        if found is None:
            return None
        look, words, end = found
        where = self.tokens[at].start, self.tokens[end - 1].end
        phrase = Phrase("", attributes=(look,), words=(words,), modifiers=((*where, "attribute"),))
        self._merge(phrase, len(self.chain.nouns) - 1)
        return end

    def _region(self, at: int) -> int | None:
        """Read a part of a thing: a relation to that thing, and a side."""
        found = self.match(choices.REGION_OF, at)
        if found is None or self.opened:
            return None
        if not self.chain.nouns:
            self._add_noun(Phrase(label="thing"), "target", (at, at))
        preposition, side, part = found[0]["preposition"], found[0]["side"], found[0]["part"]
        noun, end = self.noun(found[1])
        if noun is not None and noun.head_word in lexicon.STACKS and part in ("top", "bottom"):
            order = "high" if part == "top" else "low"
            self._choice(Choice(order, 1, self.words(at, end)), at, end)
            return end
        side = f"{side} {part}" if side and part in choices.SIDES else side
        attach = self._attach()
        for order in choices.orders_of(side or ""):
            choice = Choice(order, None, found[0][0].strip())  # type: ignore[arg-type]
            self.chain.clauses.append(Clause("", choice.text, (), attach=attach, choice=choice))
            attach = "same"
        scene = self._scene(found[1], named=preposition == "in")
        if scene is not None:
            if not side:
                self._note(at, scene, "where in the frame a corner or an edge is meant is not said")
            else:
                self.chain.spans.append(Span(self.tokens[at].start, self.tokens[scene - 1].end, "choice", 0))
            return scene
        relation = choices.REGION_RELATION.get(preposition, "near")
        if part == "top" or (relation == "in" and noun is not None and noun.head_word in lexicon.SURFACES):
            relation = "on"
        token = Token(found[0][0].strip(), self.tokens[at].start, self.tokens[found[1] - 1].end, relation)
        if not side:
            token = self._place_left_out(token, relation)
        self.opened.append(OpenRelation(token, self._take_negation(), attach))
        return found[1]

    def _choice(self, choice: Choice, at: int, end: int) -> None:
        if not self.chain.nouns:
            self._add_noun(Phrase(label="thing"), "target", (at, at))
        attach = self._attach()
        if self.opened:
            self.opened.pop()
        number = len(self.chain.nouns) if self.negated else 0
        span = Span(self.tokens[at].start, self.tokens[end - 1].end, "choice", number)
        if not any(s.start == span.start for s in self.chain.spans):
            self.chain.spans.append(span)
        if self.negated:
            # The things of the same name at that side are what it is not.
            root = self.chain.nouns[0]
            other = replace(root, choices=(*root.choices, choice), modifiers=(), where=(at, at), count=None)
            self.chain.nouns.append(other)
            self.chain.clauses.append(Clause("", "not", (number,), attach="root", negated=True, closed=True))
            self.negated = False
            return
        self.chain.clauses.append(Clause("", choice.text, (), attach=attach, choice=choice))

    def _scene(self, at: int, *, named: bool = False, whole: bool = False) -> int | None:
        """Skip `the room`, where the scene itself is the reference; None for a thing.

        `named`: the word may be a class too; `whole`: no picture, which may be a thing of the scene.
        """
        at += at < len(self.tokens) and self.tokens[at].plain in DETERMINERS
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
        if not (
            asked or (self.chain.nouns and not self.negated and not self.joined and (bare or word in lexicon.RELATIVE))
        ):
            return None
        start = at if bare else at + 1
        if not self._starts_noun(start):
            return None
        phrase, end = self._who_stands(start)
        if phrase is None or phrase.where[0] == phrase.where[1] or phrase.head_word in lexicon.SOMEBODY:
            return None
        negated = False
        while end < len(self.tokens) and self.tokens[end].plain in (
            lexicon.LINKING | lexicon.POSTURES | lexicon.NEGATIONS
        ):
            negated = negated or self.tokens[end].plain in lexicon.NEGATIONS
            end += 1
        token = self.tokens[end] if end < len(self.tokens) else None
        if token is None or token.relation not in (*MIRRORED, "on", "in"):
            return None
        if self._starts_noun(end + 1):
            return None
        if not self.chain.nouns:
            self._add_noun(Phrase(label="thing"), "target", (at, at))
        number = self._add_noun(self._resolved(phrase), "reference", phrase.where)
        self._relation_span(token)
        attach: Attach = "root" if asked else "nearest"
        self.chain.clauses.append(
            Clause(str(token.relation), token.text, (number,), not token.swapped, attach, closed=True, negated=negated)
        )
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
        whom = self.tokens[at + 1].plain if at + 1 < len(self.tokens) else None
        if whom not in ("which", "whom") or token.relation not in (*MIRRORED, "on", "in") or not self.chain.nouns:
            return None
        phrase, end = self._who_stands(at + 2)
        if phrase is None or phrase.where[0] == phrase.where[1]:
            return None
        while end < len(self.tokens) and self.tokens[end].plain in lexicon.LINKING | lexicon.POSTURES:
            end += 1
        number = self._add_noun(self._resolved(phrase), "reference", phrase.where)
        self._relation_span(token)
        clause = Clause(str(token.relation), token.text, (number,), not token.swapped, "nearest", closed=True)
        self.chain.clauses.append(clause)
        self._forget()
        return end

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
