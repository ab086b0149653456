"""Sides and parts of an expression: `on the left`, `at the right end of the couch`, `in the middle of the room`."""

from __future__ import annotations

from pipeline.language import choices, lexicon
from pipeline.language.chain import ChainReader, Clause, Opened
from pipeline.language.naming import DETERMINERS
from pipeline.language.nouns import Phrase
from pipeline.language.tokens import Token
from pipeline.language.tree import Choice, Span


class RegionReader(ChainReader):
    """Reads sides, as choices, and parts of things."""

    asks_what = False

    def _side(self, at: int) -> int | None:
        """A side that chooses: `on the left`, `furthest to the right`; None where there is none here."""
        if (not self.chain.nouns and not self.asks_what) or " " in self.tokens[at].text:
            return None
        if found := self.match(choices.EXTREME_AT_SIDE, at):
            self._choice(Choice(choices.SIDES[found[0]["side"]], 1, found[0][0].strip()), at, found[1])  # type: ignore[arg-type]
            return found[1]
        if (bare := self.match(choices.BARE_SIDE, at)) and self.chain.nouns and not self.opened and self._ends(bare[1]):
            for order in choices.orders_of(bare[0]["only"] or bare[0]["side"] or bare[0]["two"]):
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

    def _region(self, at: int) -> int | None:
        """A part of a thing: it stands in a relation to that thing, and at a side."""
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
        self.opened.append(Opened(token, self._take_negation(), attach))
        return found[1]

    def _choice(self, choice: Choice, at: int, end: int) -> None:
        if not self.chain.nouns:
            self._add_noun(Phrase(label="thing"), "target", (at, at))
        attach = self._attach()
        if self.opened:
            self.opened.pop()
        if self.negated:
            self._note(at, end, "a side that is not meant is not judged")
            self.negated = False
            return
        span = Span(self.tokens[at].start, self.tokens[end - 1].end, "choice", 0)
        if not any(s.start == span.start for s in self.chain.spans):
            self.chain.spans.append(span)
        self.chain.clauses.append(Clause("", choice.text, (), attach=attach, choice=choice))

    def _scene(self, at: int, *, named: bool = False) -> int | None:
        """Past `the room`, where the scene itself is the reference; None where a thing is."""
        at += at < len(self.tokens) and self.tokens[at].plain in DETERMINERS
        word = self.tokens[at].plain or (self.tokens[at].text if named else None) if at < len(self.tokens) else None
        if word in lexicon.SCENE and self._ends(at + 1):
            return at + 1
        return None
