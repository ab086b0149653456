"""The chain of nouns and relations read from an expression, how readers add to it, and errors with corrections."""

from __future__ import annotations

import difflib
from collections.abc import Collection, Sequence
from dataclasses import field, replace
from typing import Literal

from pipeline.language import choices, lexicon
from pipeline.language.attribute_reader import Phrase
from pipeline.language.naming import DETERMINERS, HEAD_ENDS
from pipeline.language.nouns import QUANTIFIERS, NounReader
from pipeline.language.relation_names import PHRASE, RELATIONS
from pipeline.language.tokens import EXAMPLE, Token
from pipeline.language.tree import Choice, Query, Role, Span
from pipeline.system.errors import InputError, UnknownClass, Unsupported, require
from pipeline.system.frozen import dataclass

FORM = "TARGET RELATION REFERENCE"
NOT_EXACT = "how exactly it stands so is not judged"
"""Of `directly` before a relation, which itself is judged."""
Unread = Literal["WORDS", "GRAMMAR", "UNSUPPORTED"]
"""Why an expression was not read as meant: a name is not known, the sentence cannot be read, or it can and what it asks
for is not judged."""


def why_unread(problem: InputError) -> Unread:
    """Kind of an expression's error."""
    if isinstance(problem, UnknownClass):
        return "WORDS"
    return "UNSUPPORTED" if isinstance(problem, Unsupported) else "GRAMMAR"


def why_unused(query: Query) -> Unread | None:
    """Kind of error of words left out; None where all were used, or only `directly` was not."""
    unused = [span for span in query.unused if span.note != NOT_EXACT]
    if not unused:
        return None
    return "WORDS" if any(span.unknown for span in unused) else "UNSUPPORTED"


def check_judged(tokens: Sequence[Token], text: str) -> None:
    """Refuse, by InputError, a question for a number, and a relation without a rule: `far from`."""
    words = [t.plain or "" for t in tokens]
    require(
        " ".join(words[:2]) not in ("how many", "how much"),
        "a number is asked for, and only a thing can be",
        got=f"'{text}'",
        expected=FORM,
        error=Unsupported,
    )
    for phrase in lexicon.FAR:
        size = len(phrase.split())
        require(
            not any(" ".join(words[i : i + size]) == phrase for i in range(1, len(words))),
            f"'{phrase}' is not a relation that is judged",
            got=f"'{text}'",
            expected="'farthest from' or 'near'",
            cause="it says only that two things are not near",
            error=Unsupported,
        )


def other_view(what: str, text: str, at: str | None = None) -> InputError:
    """Error for an expression judged from an object's front, or from somebody's position, `at` a thing."""
    known = "no object's own front is known; left, right, front and behind are judged from the camera"
    return Unsupported(
        f"'{what}' asks for another view than the camera's",
        got=f"'{text}'",
        cause=known if at is None else f"{known}; from the {at} only with a map of the scene: `ask --world`",
    )


def unreadable(word: str, text: str) -> InputError:
    """Error for a word that has no place in the grammar at its position."""
    return InputError(f"'{word}' cannot be read here", got=f"'{text}'", expected=FORM, cause=EXAMPLE)


def not_known(tokens: Sequence[Token], at: int, text: str) -> InputError:
    """Error for a word that relates two things in a way that is not judged, or close to such a word."""
    word = tokens[at].text
    near = _close_phrases(tokens, range(max(at - 1, 0), at + 1))
    meant = " or ".join(f"'{phrase}'" for phrase in near)
    hint = f"did you mean {meant}?" if near else "known relations: " + ", ".join(PHRASE.values())
    error = Unsupported if tokens[at].plain in lexicon.UNKNOWN_RELATIONS | lexicon.ACTIONS else InputError
    return error(f"'{word}' is not a known relation", got=f"'{text}'", cause=hint)


def _close_phrases(tokens: Sequence[Token], starts: range) -> list[str]:
    """Relation phrases with letters close to one to four words that start at the given tokens, best first."""
    scores: dict[str, float] = {}
    for start in starts:
        for end in range(start + 1, min(start + 5, len(tokens) + 1)):
            if any(t.plain is None for t in tokens[start:end]):
                break
            run = " ".join(t.text for t in tokens[start:end])
            known = [p for p in lexicon.phrase_table() if p[0] == run[0] and abs(len(p) - len(run)) < 4]
            for phrase in difflib.get_close_matches(run, known, n=3, cutoff=0.7):
                scores[phrase] = max(difflib.SequenceMatcher(None, phrase, run).ratio(), scores.get(phrase, 0.0))
    return sorted(scores, key=lambda p: (-scores[p], len(p), p))[:3]


Attach = Literal["any", "nearest", "same", "root"]

PART = "parts and what a thing has are left to the detector"
OWN_WORDS = (
    lexicon.GRAMMAR_WORDS
    | lexicon.AND
    | lexicon.WITH
    | lexicon.OTHER
    | lexicon.PRONOUNS
    | lexicon.CLOSING
    | lexicon.SMALL_WORDS
    | DETERMINERS
    | QUANTIFIERS
    | frozenset(choices.NUMBERS)
    | frozenset(w for phrase in lexicon.phrase_table() for w in phrase.split())
) - lexicon.DISTINGUISHING
"""Words that may be left out of all spans: what they say is in how the expression was read."""


@dataclass(frozen=True)
class Clause:
    """A relation, side or exclusion of the chain."""

    relation: str  # Canonical name; empty for a choice and for an exclusion
    phrase: str
    references: tuple[int, ...]  # Numbers of the nouns; two for `between`, none for a choice
    swapped: bool = False  # The relation holds from the reference to the target
    # Nouns that it may modify: any on the right frontier; only the one before it (`the nearest chair to`); the one that
    # the part before it modifies (`left of a and behind b`); or the target
    attach: Attach = "any"
    closed: bool = False  # Nothing later may modify its references, as in `table with a lamp on top`
    negated: bool = False
    choice: Choice | None = None
    # Another relation, and a side of the noun with it, for the same words: `on the left
    # side of the table` may be a place on it
    otherwise: tuple[str, Choice | None] | None = None


@dataclass
class Chain:
    """Nouns in order of mention, parts between them, and the span of each in the text."""

    nouns: list[Phrase] = field(default_factory=list)
    clauses: list[Clause] = field(default_factory=list)
    spans: list[Span] = field(default_factory=list)
    mended: list[tuple[int, int, str]] = field(default_factory=list)
    """Misspelt words: where each stands, and what it was read as."""


@dataclass(frozen=True)
class OpenRelation:
    """A relation that waits for its reference."""

    token: Token
    negated: bool
    attach: Attach


class ChainReader(NounReader):
    """A reader of noun phrases that holds the chain and its open relations."""

    def __init__(self, text: str, tokens: Sequence[Token], own: Collection[str] = ()) -> None:
        super().__init__(text, tokens, own)
        self.chain = Chain()
        self.problems: list[InputError] = []
        self.opened: list[OpenRelation] = []
        self.negated = self.joined = self.linked = self.at_root = False

    # ---- what is added ---------------------------------------------------------------------------------------------

    def _refer(self, *references: int) -> None:
        """Close the open relations with their references."""
        for opened in self.opened:
            self._relation_span(opened.token)
            self.chain.clauses.append(
                Clause(
                    str(opened.token.relation),
                    opened.token.text,
                    references,
                    opened.token.swapped,
                    opened.attach,
                    negated=opened.negated,
                    otherwise=self._otherwise(opened.token, references),
                )
            )
        self.opened.clear()
        self._forget()

    def _otherwise(self, token: Token, references: tuple[int, ...]) -> tuple[str, Choice | None] | None:
        if HEAD_ENDS.split(self.chain.nouns[references[0]].name)[0].split()[-1] not in lexicon.SURFACES:
            return None
        before = next((t for t in reversed(self.tokens) if t.end <= token.start), token)
        # The plain phrases, which labels are written with, say one thing; after `lying` a place on it is as likely.
        plain = token.text in RELATIONS[str(token.relation)].says and before.plain not in lexicon.LYING
        if not plain and (found := choices.SIDE_OR_PLACE.fullmatch(token.text)):
            return "on", Choice(choices.SIDES[found["side"]], None, token.text)  # type: ignore[arg-type]
        return ("near", None) if token.relation == "on" and token.text.endswith(" side of") else None

    def _relate(self, token: Token, words: str, phrase: Phrase, attach: Attach, *, negated: bool) -> None:
        """Add a closed clause, said from the other side, with its reference."""
        number = self._add_noun(phrase, "reference", phrase.where)
        self._relation_span(token)
        clause = Clause(str(token.relation), words, (number,), not token.swapped, attach, closed=True, negated=negated)
        self.chain.clauses.append(clause)
        self.joined = False

    def _exclude(self, phrase: Phrase, where: tuple[int, int]) -> None:
        """Add a thing that the target is not."""
        number = self._add_noun(phrase, "reference", where)
        self.chain.clauses.append(Clause("", "not", (number,), attach="root", negated=True, closed=True))

    def _add_noun(self, phrase: Phrase, role: Role, where: tuple[int, int]) -> int:
        number = len(self.chain.nouns)
        self.chain.nouns.append(phrase)
        if where[1] > where[0]:
            self.chain.spans.append(self._span(where, role, number))
        self._modifier_spans(phrase, number)
        return number

    def _any_target(self, at: int) -> None:
        """Add a thing without a name as the target, where there is none."""
        if not self.chain.nouns:
            self._add_noun(Phrase(label="thing"), "target", (at, at))

    def _span(self, where: tuple[int, int], role: Role, number: int) -> Span:
        return Span(self.tokens[where[0]].start, self.tokens[where[1] - 1].end, role, number)

    def _modifier_spans(self, phrase: Phrase, number: int) -> None:
        for start, end, role in phrase.modifiers:
            lacking = number > 0 and bool(phrase.lacks) and self.text[start:end].lower().startswith(("not", "non"))
            why = "how a thing of a relation does not look is not judged" if lacking else ""
            self.chain.spans.append(Span(start, end, "unused" if lacking else role, 0 if lacking else number, why))

    def _relation_span(self, token: Token) -> None:
        self.chain.spans.append(Span(token.start, token.end, "relation", len(self.chain.clauses)))

    def _attach(self) -> Attach:
        """Take the attachment of the part that begins here."""
        attach: Attach = (
            "root" if self.at_root else "same" if self.joined and (self.chain.clauses or self.opened) else "any"
        )
        self.joined = self.at_root = False
        return attach

    def _take_negation(self) -> bool:
        negated, self.negated = self.negated, False
        return negated

    def _forget(self) -> None:
        self.joined = self.linked = self.negated = False

    def _unused(self, at: int, why: str | InputError, size: int = 1) -> int:
        """Skip words up to the next part that cannot be used, at least `size`, with a note."""
        end = at + size
        if self._starts_noun(end):
            end = max(self.noun(end)[1], end)
        self._forget()
        problem = why if isinstance(why, InputError) else Unsupported(why, got=f"'{self.words(at, end)}'")
        return self._refused(problem, at, end)

    def _refused(self, problem: InputError, at: int, end: int, also: Token | None = None) -> int:
        """Note words as not used for a problem, which is raised where nothing else tells the thing meant."""
        self.problems.append(problem)
        return self._note(at, end, problem.what, also)

    def _place_left_out(self, token: Token, relation: str) -> Token:
        """Relation of a part of a thing, by its preposition alone; the part is noted as not judged."""
        preposition = token.text.split()[0]
        cut = token.start + len(preposition)
        start = cut + len(self.text[cut : token.end]) - len(self.text[cut : token.end].lstrip())
        self.chain.spans.append(
            Span(start, token.end, "unused", 0, "where on or in a thing something is is not judged")
        )
        return replace(token, text=preposition, relation=relation, end=cut)

    def _note(self, at: int, end: int, why: str, also: Token | None = None) -> int:
        start = self.tokens[at].start
        if also is not None:
            if any(also.end <= s.start < start for s in self.chain.spans):
                self.chain.spans.append(Span(also.start, also.end, "unused", 0, why))
            else:
                start = also.start
        self.chain.spans.append(Span(start, self.tokens[end - 1].end, "unused", 0, why))
        return end

    def note_dropped(self) -> None:
        """Note words outside all parts that are not the grammar's own: nothing is dropped in silence."""
        taken = sorted((s.start, s.end) for s in self.chain.spans)
        for at, token in enumerate(self.tokens):
            own = token.name is None and all(w in OWN_WORDS for w in token.text.split())
            if not own and not any(start < token.end and token.start < end for start, end in taken):
                self._note(at, at + 1, "this word was not used")

    def _missing(self, opened: OpenRelation) -> None:
        token = opened.token
        self.problems.append(self._missing_reference(token.text))
        self.chain.spans.append(Span(token.start, token.end, "unused", 0, self.problems[-1].what))

    def _merge(self, phrase: Phrase, number: int = 0, *, named: bool = False) -> None:
        """Merge later words about a noun: `the mug ... , the red one`, `the mug is the leftmost object`."""
        noun = self.chain.nouns[number]
        words, name = (*noun.words, *phrase.words), phrase.name if named else noun.name
        tail = "" if named else noun.label.partition(noun.name)[2]
        self.chain.nouns[number] = replace(
            noun,
            label=" ".join([*words, name + tail]),
            head=name if words or tail else "",
            words=words,
            attributes=(*noun.attributes, *phrase.attributes),
            choices=(*noun.choices, *phrase.choices),
        )
        self._modifier_spans(phrase, number)
        start, end = phrase.where if named else self._tail_noted(phrase)
        if end > start:
            role = "reference" if number else "target"
            self.chain.spans.append(self._span((start, end), role, number))

    def _tail_noted(self, phrase: Phrase) -> tuple[int, int]:
        """Tokens of a noun named again without `with a lid`, noted as unused: a detector gets the first noun alone."""
        start, end = phrase.where
        own = phrase.label.partition(phrase.name)[2].split() if phrase.name else []
        cut = next((k for k in range(start, end) if own and self.tokens[k].text == own[0]), end)
        if cut < end:
            self._note(cut, end, PART)
        return start, cut

    # ---- errors ----------------------------------------------------------------------------------------------------

    def _missing_reference(self, after: str) -> InputError:
        return InputError(
            f"the reference is missing after '{after}'", got=f"'{self.text}'", expected=FORM, cause=EXAMPLE
        )

    def _no_target(self) -> InputError:
        return InputError(
            "the target is missing before the relation", got=f"'{self.text}'", expected=FORM, cause=EXAMPLE
        )

    def _is_pronoun(self, phrase: Phrase) -> bool:
        return phrase.label in lexicon.PRONOUNS - lexicon.ANYTHING and not phrase.named

    def _names_nothing(self, role: str, phrase: Phrase) -> InputError:
        return Unsupported(
            f"the {role} names no object: '{phrase.label}'", got=f"'{self.text}'", expected="the name of a thing"
        )
