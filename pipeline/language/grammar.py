"""The grammar of spatial expressions: tokens to noun phrases and relations, or an error with the reason.

    query  := [frame] [view [","]] noun part* ["."] (("it" | "this") "is" part+)*
    part   := [linking] [neg] relation noun | [linking] [neg] "between" noun "and" noun | "with" noun relation ["it"]
            | side | [","] ["not"] noun | "and" part
    noun   := [article] (choice | attribute | number)* word* ["of the" number [word+]] ["from the" side]
            | [article] superlative noun ("to" | "from") noun

The tokens are read once, from left to right. Which earlier noun a part modifies is left open here, and
`pipeline.language.expression` enumerates it. Words of no use are noted, with the reason; only where
nothing is left that tells the thing meant is that an error.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable
from dataclasses import replace

from pipeline.language import choices, lexicon
from pipeline.language.attribute_reader import Phrase, is_name
from pipeline.language.attributes import attribute
from pipeline.language.chain import FORM, NOT_EXACT, PART, Attach, Chain, OpenRelation, not_known, unreadable
from pipeline.language.naming import DETERMINERS, singular
from pipeline.language.nouns import ALTERNATIVES
from pipeline.language.references import NO_RANK, ReferenceReader
from pipeline.language.relation_names import MIRRORED
from pipeline.language.tokens import NameIndex, Token, tokenize
from pipeline.language.tree import Choice, Span
from pipeline.language.views import address_removed, closing_removed, leading_removed, thing_first, without_view
from pipeline.system.errors import InputError, Unsupported


def read_chain(text: str, known: NameIndex) -> Chain:
    """Read an expression passed by `tokens.check_text`; InputError suggests a known relation close to the words."""
    tokens = tokenize(text, known)
    # `pillow on bed` may be a class, and yet here the pillow that lies on a bed is meant.
    split = [tokenize(text, known, hold_names=False)] if any(t.guards for t in tokens) else []
    problem = None
    for held in (tokens, *split):
        try:
            chain = _GrammarReader(text, held, known.words).read()
        except InputError as error:
            problem = problem or error
        else:
            if chain.clauses or held is not tokens or not split:
                return chain
    assert problem is not None
    raise problem


def with_unused(text: str, known: NameIndex, spans: Iterable[Span]) -> tuple[Span, ...]:
    """Spans of another reader, in order, with the meaningful words left over."""
    reader = _GrammarReader(text, tokenize(text, known), known.words)
    reader.chain.spans += spans
    reader.note_dropped()
    return tuple(sorted(reader.chain.spans, key=lambda s: s.start))


def _meant_first(tokens: list[Token], text: str) -> list[Token]:
    """Move the meant thing to the front: `not the mug on the desk but the one on the shelf`."""
    for k in range(1, len(tokens) - 1):
        if tokens[k].plain == "but":
            return tokens[k + 1 :] + tokens[:k]
        comma = any(c in text[tokens[k - 1].end : tokens[k].start] for c in ",;:.")
        if comma and tokens[k].plain in DETERMINERS - lexicon.RELATIVE:
            return tokens[k:] + tokens[:k]
    return tokens


_NOT_JUDGED = (
    (lexicon.DEIXIS, "words that point to a place say nothing without a pointer"),
    (lexicon.DOING, "what somebody does with a thing is not judged"),
    (lexicon.PURPOSE, "what a thing is for is not judged"),
)


class _GrammarReader(ReferenceReader):
    """One pass over one expression, adding to its chain."""

    def __init__(self, text: str, tokens: list[Token], own: Collection[str] = ()) -> None:
        tokens = without_view(closing_removed(address_removed(tokens, text)), text)
        tokens, self.asks_what = leading_removed(tokens)
        if tokens and tokens[0].plain in lexicon.NEGATIONS:
            tokens = _meant_first(tokens, text)
        if not self.asks_what:
            tokens = thing_first(tokens, text)
        super().__init__(text, tokens, own)

    def read(self) -> Chain:
        at = 0
        while at < len(self.tokens):
            at = self._step(at)
        for opened in self.opened:
            self._missing(opened)
        chain = self.chain
        if self.negated:
            self._drop_negation()
        chain.spans += [Span(*where, "unused", 0, why) for *where, why in self.left_out.values()]  # type: ignore[arg-type]
        self.note_dropped()
        words = [word for noun in chain.nouns for word in noun.words]
        chain.mended += [m for m in self.respelled.values() if m[2] in words]
        if not chain.nouns:
            raise self.problems[0] if self.problems else self._no_target()
        identified = self.renamed or chain.clauses or any(n.attributes or n.choices for n in chain.nouns)
        if self.problems and not identified:
            raise self.problems[0]
        return chain

    def _drop_negation(self) -> None:
        """Note a negation with nothing behind."""
        last = max((k for k, t in enumerate(self.tokens) if t.plain in lexicon.NEGATIONS), default=None)
        if last is not None:
            self.chain.spans = [s for s in self.chain.spans if s.start != self.tokens[last].start]
            self._note(last, last + 1, "what is not meant is not said")

    # ---- one step --------------------------------------------------------------------------------------------------

    def _step(self, at: int) -> int:
        token, word = self.tokens[at], self.tokens[at].plain
        if self.chain.nouns and self.breaks[at] and word in ("it", "this", "they") and not self.opened:
            self.at_root = True
            return at + 1
        if word == "without" and self.chain.nouns and not self.opened:
            self.negated = True
            return self._with(at)
        if word in ("where", "wherein") and self.chain.nouns and not self.opened:
            start = self.past(at + 1, lexicon.BE | {"there", "there's"})
            if self._starts_noun(start) and self._with_relation(start):
                return self._with(start - 1)
        if self.chain.nouns and not self.opened and (found := self.match(lexicon.EXCEPT, at)):
            self.negated = True
            self.chain.spans.append(self._span((at, found[1]), "relation", len(self.chain.clauses)))
            return found[1]
        ordered = word in choices.ORDINALS and self.relation(at + 1) in ("closest", "farthest")
        if ordered and not self.is_superlative_noun(at + 1):
            return self._note(at, at + 1, NO_RANK)
        if self.opened and word in ("neither", "not", "no") and self._starts_noun(at + 1):
            # `near neither the bed nor the desk`, `on no table`
            self.opened[-1] = replace(self.opened[-1], negated=True)
            self._relation_span(token)
            return at + 1
        clauses = self.chain.clauses
        excluded = bool(clauses) and clauses[-1].negated
        if word in ("nor", "or") and excluded and clauses[-1].relation and self._starts_noun(at + 1):
            self.joined = True
            return at + 1
        if word in lexicon.NEGATIONS:
            self.negated = self.linked = True
            self.joined = self.joined or word == "nor"
            self._relation_span(token)
            return at + 1
        if word == "or" and self.chain.nouns and not excluded:
            return self._alternative(at)
        if word == "whose" and self.chain.nouns:
            end = next((k for k in range(at + 1, len(self.tokens)) if self.breaks[k] or self._relates(k)), None)
            return self._note(at, end or len(self.tokens), PART)
        if word in lexicon.AND or word in ("or", "nor", "plus"):
            self.joined = True
            if word == "but" and any(t.plain in lexicon.EVERY for t in self.tokens[: min(at, 3)]):
                self.negated = self.linked = True
            self.negated = self.negated or (excluded and (word in ("or", "nor") or self._excludes_another(at + 1)))
            return at + 1
        behind = self._side(at) or self._color_phrase(at) or self._object_clause(at)
        if behind is not None:
            return behind
        loose = self.chain.nouns and not self.opened and (token.relation is None or token.text == "in")
        filler = self.match(lexicon.FILLER, at) if loose else None
        if filler is not None and self._goes_on(filler[1]):
            return filler[1]
        if self.chain.nouns and not self.opened and not self._predicative(at):
            for pattern, why in _NOT_JUDGED:
                if (found := self.match(pattern, at)) and self._goes_on(found[1]):
                    # In `that I put on the table` the table says where it is.
                    end = found[1] - (self.tokens[found[1] - 1].relation is not None and self._starts_noun(found[1]))
                    return self._refused(Unsupported(why, got=f"'{self.words(at, end)}'"), at, end)
        if (
            word in ("high", "low")
            and at
            and self.tokens[at - 1].plain in lexicon.POSTURES | lexicon.LYING | {"hanging"}
        ):
            return self._note(at, at + 1, NOT_EXACT)
        if self._links(at):
            if word in lexicon.HOW_EXACTLY and self.chain.nouns and self._relates(at + 1):
                self._note(at, at + 1, NOT_EXACT)
            self.linked = True
            return at + 1
        if self.opened and (viewer := self._viewer(at)) is not None:
            return viewer
        if token.relation is not None and not self.is_superlative_noun(at):
            return self._relation(at)
        if word in lexicon.WITH and self.chain.nouns and not self.opened:
            return self._with(at)
        if (
            self.chain.nouns
            and not self.opened
            and word in ("left", "right")
            and not self.negated
            and at + 1 < len(self.tokens)
        ):
            self.opened.append(OpenRelation(replace(token, relation=word), self._take_negation(), self._attach()))
            return at + 1
        if word in lexicon.ACTIONS and not at and len(self.tokens) > 1 and self.tokens[1].plain in DETERMINERS:
            raise Unsupported(
                f"'{word}' asks to do something, and only a thing can be asked for",
                got=f"'{self.text}'",
                expected=FORM,
                cause="not a known relation or name",
            )
        if word in lexicon.UNKNOWN_RELATIONS or self._acts(at):
            return self._unused(at, not_known(self.tokens, at, self.text))
        return self._noun(at)

    def _excludes_another(self, at: int) -> bool:
        """Test for another excluded thing behind `and`: `except the left one and the red one`."""
        determined = at + 1 < len(self.tokens) and self.tokens[at].plain in DETERMINERS - lexicon.RELATIVE
        if not determined or not self.chain.clauses:
            return False
        one = self.tokens[at].plain == "those" or any(t.plain in ("one", "ones") for t in self.tokens[at + 1 : at + 3])
        return one or not (self.chain.clauses[-1].relation or self.chain.clauses[-1].choice)

    def _acts(self, at: int) -> bool:
        """Test if a word behind a thing is a command, and no state: `that is open`."""
        word = self.tokens[at].plain
        state = self._predicative(at) and attribute(word or "") is not None
        return word in lexicon.ACTIONS and bool(self.chain.nouns) and not self.opened and not state

    def _alternative(self, at: int) -> int:
        """Skip `or` and the words behind, which are not judged."""
        ahead = range(at + 1, len(self.tokens))
        skipped = lexicon.LINKING - DETERMINERS
        end = next((k for k in ahead if not self._relates(k) and self.tokens[k].plain not in skipped), len(self.tokens))
        end = max(self.noun(end, predicate=True)[1] if end < len(self.tokens) else end, at + 1)
        return self._note(at, end, ALTERNATIVES)

    def _links(self, at: int) -> bool:
        """Test if a word only links a noun to the next part."""
        word, following = self.tokens[at].plain, self.tokens[at + 1] if at + 1 < len(self.tokens) else None
        if word is None or word in DETERMINERS - lexicon.RELATIVE:
            return False
        if not self.chain.nouns or self.opened:
            return word in lexicon.COPULAS or (
                word in lexicon.LINKING and following is not None and following.relation is not None
            )
        if word == "right" or word in lexicon.POSTURES:
            chosen = following is not None and following.text in choices.EXTREMES
            return following is None or chosen or following.relation is not None or self._structural(at + 1)
        return word in lexicon.LINKING or word in lexicon.PLACE_PRONOUNS

    def _relation(self, at: int) -> int:
        token = self.tokens[at]
        if (fronted := self._fronted(at)) is not None:
            return fronted
        if not self.chain.nouns:
            opens = token.relation in ("closest", "farthest") or token.text.split()[0] in lexicon.LINKING
            if not (opens or self.asks_what or self.linked or self.joined):
                raise self._no_target()
            self._any_target(at)
        # Below the picture on the wall is another thing than at the bottom of the picture.
        sided = token.relation in choices.OF_THE_SCENE and (
            token.relation in ("left", "right", "between") or token.text.split()[0] in ("on", "at", "in", "to")
        )
        scene = self._scene(at + 1) if sided or self._scene(at + 1, whole=True) else None
        if scene is not None:
            order = lexicon.SCENE_ORDER.get(str(token.relation))
            if order is None:
                return self._note(at, scene, "all of the frame is there")
            return self._choice(Choice(order, None, token.text), at, scene)  # type: ignore[arg-type]
        order = lexicon.BARE_SIDES.get(token.text)
        it = self.plain(at + 1) in lexicon.PLACE_PRONOUNS
        if order is not None and not it and not self._starts_noun(at + 1):
            first = token.text == "on top" or token.text in lexicon.SUPERLATIVES
            end = self.past(at + 1, ("away", "back", "by", "off")) if first else at + 1
            return self._choice(Choice(order, 1 if first else None, self.words(at, end).lower()), at, end)  # type: ignore[arg-type]
        if token.text in lexicon.POSSESSIVE_TAILS:
            return self._refused(unreadable(token.text, self.text), at, at + 1)
        if self.opened and not self.joined:
            self._missing(self.opened.pop())
        self.opened.append(OpenRelation(token, self._take_negation(), self._attach()))
        return at + 1

    def _with(self, at: int) -> int:
        """Read `table with a lamp on top`, a relation from the lamp to the table, or note a part."""
        if (first := self._place_first(at)) is not None:
            return first
        without = self.plain(at + 1) == "no"
        self.negated = self.negated or without
        phrase, end = self.noun(at + 1 + without)
        end = self.past(end, lexicon.LINKING - DETERMINERS)
        after = self.tokens[end] if end < len(self.tokens) else None
        tail = None if after is None or phrase is None else self._with_tail(end)
        if phrase is not None and tail is None and (carried := self._carries(at, phrase, end)) is not None:
            return carried
        if phrase is None or after is None or tail is None:
            why = "what a thing does not have is not judged" if self.negated else PART
            return self._unused(at, why, 1 + without)
        if phrase.head_word == "nothing":
            phrase, self.negated = replace(phrase, label="thing", head=""), True
        self._relation_span(self.tokens[at])
        words = f"{self.tokens[at].text} ... {after.text}"
        # `has` after no `that` is said of the target; `with` and `that has` of any thing before.
        relative = self.tokens[at - 1].plain in lexicon.RELATIVE or self.tokens[at].plain in ("with", "without")
        attach: Attach = "same" if self.joined and self.chain.clauses else "any" if relative else "root"
        self._relate(after, words, phrase, attach, negated=self._take_negation())
        return tail

    def _place_first(self, at: int) -> int | None:
        """Read `that has on top (of it) a lamp` as `with a lamp on top`."""
        token = self.tokens[at + 1] if at + 1 < len(self.tokens) else None
        if token is None or (token.relation not in MIRRORED and token.relation not in lexicon.SAYS_SWAPPED):
            return None
        it = self.plain(at + 2) in lexicon.PLACE_PRONOUNS
        if not (it or token.text in lexicon.BARE_TAILS) or not self._starts_noun(at + 2 + it):
            return None
        phrase, end = self.noun(at + 2 + it)
        if phrase is None:
            return None
        words = f"{self.tokens[at].text} {token.text}"
        self._relate(token, words, phrase, "any", negated=self._take_negation())
        return end

    def _carries(self, at: int, phrase: Phrase, end: int) -> int | None:
        """Read `the table without a lamp`: nothing of a thing known to the detector stands on a surface."""
        surface = self.chain.nouns[-1]
        things = singular(phrase.head_word) in self.own and phrase.head_word not in lexicon.PARTS
        if not (self.negated and things and surface.head_word in lexicon.SURFACES):
            return None
        token = self.tokens[at]
        self._relate(replace(token, relation="on"), token.text, phrase, "nearest", negated=self._take_negation())
        return end

    # ---- nouns -----------------------------------------------------------------------------------------------------

    def _noun(self, at: int) -> int:
        excluded = self.joined and self.negated and bool(self.chain.clauses) and not self.chain.clauses[-1].relation
        named = self.opened or self.tokens[at].plain in DETERMINERS
        predicate = not named and (excluded or self._predicative(at))
        phrase, end = self.noun(at, stop_at_and=bool(self.opened), predicate=predicate)
        if phrase is None:
            if end > at + 1 or self.tokens[at].plain not in DETERMINERS:
                self._note(at, max(end, at + 1), "these words have no place here")
            return max(end, at + 1)
        if phrase.superlative is not None and (reference := self._superlative_reference(end)) is not None:
            return self._nearest_noun(phrase, end, reference)
        if self.opened:
            return self._reference(at, phrase, end)
        if not self.chain.nouns:
            if self._is_pronoun(phrase) and not self.asks_what:
                self.problems.append(self._names_nothing("target", phrase))
                phrase = replace(phrase, label="thing", head="")
            alone = phrase.where == (at, at + 1) and not phrase.named and not is_name(singular(phrase.head_word))
            following = end < len(self.tokens) and not self.breaks[end] and self.tokens[end].plain
            if alone and not phrase.anything and following in DETERMINERS - lexicon.RELATIVE:
                # `gran the mug`: a verb that nobody knows.
                return self._note(at, end, "this word is not known")
            for k in range(at + 1, phrase.where[0] if phrase.where[1] > phrase.where[0] else end):
                if self.tokens[k].plain == "other" and self.tokens[at].plain != "a":
                    self._note(k, k + 1, "than which other is not said")
            if self.negated and phrase.attributes and self.tokens[at].plain not in DETERMINERS:
                # `not red mug`
                lacks = tuple(zip(phrase.attributes, phrase.words, strict=True))
                phrase = replace(phrase, label=phrase.name, head="", attributes=(), words=(), lacks=lacks)
                self.negated = False
            elif self.negated:
                self._forget()
                return self._refused(Unsupported("only what is not meant is said", got=f"'{self.text}'"), at, end)
            self._add_noun(phrase, "target", phrase.where)
            for look, word in phrase.lacks:
                self._exclude(Phrase(f"{word} {phrase.name}", phrase.name, (look,), (word,)), (end, end))
            self._forget()
            return end
        return self._further(at, phrase, end)
