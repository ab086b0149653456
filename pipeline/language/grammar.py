"""The grammar of spatial expressions: tokens to noun phrases and the relations between them, or an error that says why.

    query  := [frame] [view [","]] noun part* ["."] (("it" | "this") "is" part+)*
    part   := [linking] [neg] relation noun | [linking] [neg] "between" noun "and" noun | "with" noun relation ["it"]
            | side | [","] ["not"] noun | "and" part
    noun   := [article] (choice | attribute | number)* word* ["of the" number [word+]] ["from the" side]
            | [article] superlative noun ("to" | "from") noun

It goes through the tokens once, from left to right. Which earlier noun a part modifies is left open here, and
`pipeline.language.expression` enumerates it. What it cannot use it notes, with the reason, and goes on; only where
nothing is left that tells the thing meant is that an error.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable
from dataclasses import replace

from pipeline.language import choices, lexicon
from pipeline.language.chain import Attach, Chain, Clause, Opened
from pipeline.language.looks import is_name
from pipeline.language.naming import DETERMINERS, singular
from pipeline.language.nouns import Phrase
from pipeline.language.regions import RegionReader
from pipeline.language.tokens import EXAMPLE, Token, Vocabulary, tokenize
from pipeline.language.tree import Choice, Span
from pipeline.language.unreadable import FORM, NOT_EXACT, not_known, unreadable
from pipeline.language.views import closing_removed, leading_removed, without_view
from pipeline.system.errors import InputError, Unsupported, require


def read_chain(text: str, known: Vocabulary) -> Chain:
    """Read an expression that `tokens.check_text` let pass.

    Raises
    ------
    InputError
        With the reason, and with suggestions where a relation is close to a known one.
    """
    tokens = tokenize(text, known)
    # `pillow on bed` may be a class, and yet here the pillow that lies on a bed is meant.
    apart = tokenize(text, known, hold_names=False) if any(t.guards for t in tokens) else None
    problem = None
    for held in (tokens, apart):
        if held is None:
            continue
        try:
            chain = _Reader(text, held, known.words).read()
        except InputError as error:
            problem = problem or error
        else:
            if chain.clauses or held is apart or apart is None:
                return chain
    if problem is None:
        return _Reader(text, tokens, known.words).read()
    raise problem


def with_unused(text: str, known: Vocabulary, spans: Iterable[Span]) -> tuple[Span, ...]:
    """What another reader took of a sentence, in order, with the words that it left over and that say something."""
    reader = _Reader(text, tokenize(text, known), known.words)
    reader.chain.spans += spans
    reader.note_dropped()
    return tuple(sorted(reader.chain.spans, key=lambda s: s.start))


_NOT_JUDGED = (
    (lexicon.DEIXIS, "words that point to a place say nothing without a pointer"),
    (lexicon.DOING, "what somebody does with a thing is not judged"),
)


class _Reader(RegionReader):
    """One pass over one expression, adding to its chain."""

    def __init__(self, text: str, tokens: list[Token], own: Collection[str] = ()) -> None:
        tokens = closing_removed(tokens)
        tokens = without_view(tokens, text)
        tokens, self.asks_what = leading_removed(tokens)
        contrast = next((k for k, t in enumerate(tokens) if t.plain == "but" and k + 1 < len(tokens)), None)
        if contrast and tokens[0].plain in lexicon.NEGATIONS:
            # `not the mug on the desk but the one on the shelf`: what is meant comes first.
            tokens = tokens[contrast + 1 :] + tokens[:contrast]
        super().__init__(text, tokens, own)
        self.renamed = False

    def read(self) -> Chain:
        at = 0
        while at < len(self.tokens):
            at = self._step(at)
        for opened in self.opened:
            self._missing(opened)
        self.note_dropped()
        chain = self.chain
        said = [word for noun in chain.nouns for word in noun.words]
        chain.mended += [m for m in self.respelled.values() if m[2] in said]
        if not chain.nouns:
            raise self.problems[0] if self.problems else self._no_target()
        told = self.renamed or chain.clauses or any(n.attributes or n.choices for n in chain.nouns)
        if self.problems and not told:
            raise self.problems[0]
        return chain

    # ---- one step --------------------------------------------------------------------------------------------------

    def _step(self, at: int) -> int:
        token, word = self.tokens[at], self.tokens[at].plain
        if self.chain.nouns and self.breaks[at] and word in ("it", "this", "they") and not self.opened:
            self.at_root = True
            return at + 1
        if word == "without" and self.chain.nouns and not self.opened:
            self.negated = True
            return self._with(at)
        if self.opened and word in ("neither", "not") and self._starts_noun(at + 1):
            # `near neither the bed nor the desk`
            self.opened[-1] = replace(self.opened[-1], negated=True)
            self._relation_span(token)
            return at + 1
        last = self.chain.clauses[-1] if self.chain.clauses else None
        nor = word in ("nor", "or") and last is not None and last.negated and self._starts_noun(at + 1)
        if nor and last is not None and last.relation:
            self.joined = True
            return at + 1
        if word in lexicon.NEGATIONS:
            self.negated = self.linked = True
            self.joined = self.joined or word == "nor"
            self._relation_span(token)
            return at + 1
        if word in lexicon.AND or word in ("or", "nor", "plus"):
            self.joined = True
            clauses = self.chain.clauses
            if word == "but" and any(t.plain in lexicon.EVERY for t in self.tokens[: min(at, 3)]):
                self.negated = self.linked = True
            self.negated = self.negated or (word in ("or", "nor") and bool(clauses) and clauses[-1].negated)
            return at + 1
        if (side := self._side(at)) is not None:
            return side
        if not self.opened and (clause := self._object_clause(at)) is not None:
            return clause
        loose = self.chain.nouns and not self.opened and token.relation is None
        filler = self.match(lexicon.FILLER, at) if loose else None
        if filler is not None and self._goes_on(filler[1]):
            return filler[1]
        if self.chain.nouns and not self.opened and not self._predicative(at):
            for pattern, why in _NOT_JUDGED:
                if (found := self.match(pattern, at)) and self._goes_on(found[1]):
                    self.problems.append(Unsupported(why, got=f"'{self.words(at, found[1])}'"))
                    self._note(at, found[1], why)
                    return found[1]
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
        if self.chain.nouns and not self.opened and word in ("left", "right") and at + 1 < len(self.tokens):
            side_token = replace(token, relation=word)
            self.opened.append(Opened(side_token, self._take_negation(), self._attach()))
            return at + 1
        if word in lexicon.ACTIONS and not at and len(self.tokens) > 1 and self.tokens[1].plain in DETERMINERS:
            raise Unsupported(
                f"'{word}' asks to do something, and only a thing can be asked for",
                got=f"'{self.text}'",
                expected=FORM,
                cause="not a known relation or name",
            )
        if word in lexicon.UNKNOWN_RELATIONS or (word in lexicon.ACTIONS and self.chain.nouns):
            return self._unused(at, not_known(self.tokens, at, self.text))
        return self._noun(at)

    def _relates(self, at: int) -> bool:
        return at < len(self.tokens) and self.tokens[at].relation is not None and not self.breaks[at]

    def _links(self, at: int) -> bool:
        """Whether a word only links a noun to what follows."""
        word, following = self.tokens[at].plain, self.tokens[at + 1] if at + 1 < len(self.tokens) else None
        if word is None or word in DETERMINERS - lexicon.RELATIVE:
            return False
        if not self.chain.nouns or self.opened:
            return word in lexicon.COPULAS or (
                word in lexicon.LINKING and following is not None and following.relation is not None
            )
        if word == "right" or word in lexicon.POSTURES:
            return following is None or following.relation is not None or self._structural(at + 1)
        return word in lexicon.LINKING or word in lexicon.PLACE_PRONOUNS

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

    def _relation(self, at: int) -> int:
        token = self.tokens[at]
        if not self.chain.nouns:
            if not (self.asks_what or self.linked or self.joined or token.text.split()[0] in lexicon.LINKING):
                raise self._no_target()
            self._add_noun(Phrase(label="thing"), "target", (at, at))
        scene = self._scene(at + 1) if token.relation in choices.OF_THE_SCENE else None
        if scene is not None:
            order = lexicon.SCENE_ORDER.get(str(token.relation))
            if order is None:
                self._note(at, scene, "all of the frame is there")
            else:
                self._choice(Choice(order, None, token.text), at, scene)  # type: ignore[arg-type]
            return scene
        order = lexicon.BARE_SIDES.get(token.text)
        if order is not None and not self._starts_noun(at + 1):
            first = token.text == "on top" or token.text in lexicon.SUPERLATIVES
            self._choice(Choice(order, 1 if first else None, token.text), at, at + 1)  # type: ignore[arg-type]
            return at + 1
        if token.text in lexicon.POSSESSIVE_TAILS:
            self.problems.append(unreadable(token.text, self.text))
            self._note(at, at + 1, self.problems[-1].what)
            return at + 1
        if self.opened and not self.joined:
            self._missing(self.opened.pop())
        self.opened.append(Opened(token, self._take_negation(), self._attach()))
        return at + 1

    def _with(self, at: int) -> int:
        """`table with a lamp on top`: the relation holds from the lamp to the table. Else it tells of a part."""
        phrase, end = self.noun(at + 1)
        after = self.tokens[end] if end < len(self.tokens) else None
        while after is not None and after.plain in lexicon.LINKING and after.plain not in DETERMINERS:
            end += 1
            after = self.tokens[end] if end < len(self.tokens) else None
        tail = None if after is None or phrase is None else self._with_tail(end)
        if phrase is None or after is None or tail is None:
            lacks = "what a thing does not have is not judged"
            return self._unused(at, lacks if self.negated else "parts and what a thing has are left to the detector")
        if phrase.head_word == "nothing":
            phrase, self.negated = replace(phrase, label="thing", head=""), True
        self._relation_span(self.tokens[at])
        number = self._add_noun(phrase, "reference", phrase.where)
        self._relation_span(after)
        words = f"{self.tokens[at].text} ... {after.text}"
        relation, swapped = str(after.relation), not after.swapped
        # `has` after no `that` is said of the target; `with` and `that has` of any thing before.
        relative = self.tokens[at - 1].plain in lexicon.RELATIVE or self.tokens[at].plain in ("with", "without")
        attach: Attach = "same" if self.joined and self.chain.clauses else "any" if relative else "root"
        self.chain.clauses.append(Clause(relation, words, (number,), swapped, attach, True, self._take_negation()))
        self.joined = False
        return tail

    # ---- nouns -----------------------------------------------------------------------------------------------------

    def _noun(self, at: int) -> int:
        excluded = self.joined and self.negated and bool(self.chain.clauses) and not self.chain.clauses[-1].relation
        predicate = not self.opened and (excluded or self._predicative(at))
        predicate = predicate and self.tokens[at].plain not in DETERMINERS
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
            following = self.tokens[end].plain if end < len(self.tokens) and not self.breaks[end] else None
            if alone and not phrase.anything and following in DETERMINERS - lexicon.RELATIVE:
                # `gran the mug`: a verb that nobody knows.
                self._note(at, end, "this word is not known")
                return end
            for k in range(at + 1, phrase.where[0] if phrase.where[1] > phrase.where[0] else end):
                if self.tokens[k].plain == "other" and self.tokens[at].plain != "a":
                    self._note(k, k + 1, "than which other is not said")
            self._add_noun(phrase, "target", phrase.where)
            self._forget()
            return end
        return self._further(at, phrase, end)

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
            return end
        if self.words(at, end).lower() in lexicon.RECIPROCAL:
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
        """The next `and` before a noun, behind words that tell more of the first of a pair."""
        if self.opened[-1].token.text.endswith(" of"):
            return None
        ahead = (k for k in range(at, len(self.tokens)) if self.tokens[k].plain == "and" and self._starts_noun(k + 1))
        return next(ahead, None)

    def _second(self, first: Phrase, number: int, end: int) -> tuple[int | None, int]:
        """The other reference of `between`; `the two chairs` are both."""
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
        """A noun without a relation before it: the target once more, what it is not, or nothing that is of use."""
        root = self.chain.nouns[0]
        if self.negated:
            where = phrase.where
            if root.anything and root.head_word == "one" and not phrase.anything:
                bare = replace(phrase, attributes=(), words=(), modifiers=(), choices=())
                self._merge(bare, named=True)
                where = (end, end)
                root = self.chain.nouns[0]
            again = phrase.anything or (phrase.name == root.name and self._relates(end))
            if again and not (phrase.attributes or phrase.choices):
                # `not the ones on the stool`: what follows is negated.
                self.at_root = True
                return end
            implied = phrase.where[0] == phrase.where[1]
            number = self._add_noun(self._resolved(phrase, root, implied=implied), "reference", where)
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
        told_before = any(t.plain in lexicon.BE for t in self.tokens[:at])
        if self.joined and not told_before and not clauses and not same:
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
        """`the nearest chair to the door`: the relation stands before the noun that it modifies."""
        early = phrase.superlative
        assert early is not None
        others = tuple(c for c in phrase.choices if c.text != early.text)
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
            Opened(replace(link, text=f"{early.text} {link.text}", relation=early.relation), False, "nearest")
        )
        viewer = self._viewer(at)
        return self._reference(at, *self._required(at)) if viewer is None else viewer

    def _required(self, at: int) -> tuple[Phrase, int]:
        phrase, end = self.noun(at)
        if phrase is None:
            raise self._missing_reference(self.opened[-1].token.text)
        return phrase, end
