"""The sentences of auto-labelled expressions and questions: varied, correct English that `parse` reads back."""

from __future__ import annotations

import operator
from collections.abc import Sequence
from functools import lru_cache
from itertools import product

from pipeline.language import lexicon
from pipeline.language.expression import parse
from pipeline.language.naming import DETERMINERS, is_named, match, normal_form, same_class
from pipeline.language.noun_phrase import NounPhrase, noun_phrase, readable
from pipeline.language.openers import LEADING_WORDS
from pipeline.language.relation import SEMANTIC_ABSTRACTION
from pipeline.language.relation_names import PAIRWISE, PHRASE, RELATIONS
from pipeline.language.tokens import MAX_LENGTH, words_of
from pipeline.system.errors import InputError, Shown, require
from pipeline.system.frozen import dataclass

__all__ = ["STYLES", "can_be_worded", "expression_text", "question_text"]

STYLES = ("varied", "plain", "semantic-abstraction")

VARIED_PHRASES = {name: RELATIONS[name].says or (PHRASE[name],) for name in PAIRWISE}

VARIED_FRAMES = (
    "{t} {p} {bare_r}",
    "{t} {p} {the_r}",
    "{the_t} {p} {the_r}",
    "{the_t} {p} {a_r}",
    "{a_t} {p} {the_r}",
    "{the_t} that {is_} {p} {the_r}",
    "{a_t} that {is_} {p} {the_r}",
    "{the_t} which {is_} {p} {a_r}",
    "find {the_t} {p} {the_r}",
    "find {a_t} that {is_} {p} {the_r}",
    "show me {the_t} {p} {the_r}",
    "point to {the_t} {p} {a_r}",
    "locate {the_t} that {is_} {p} {the_r}",
    "look for {a_t} {p} {the_r}",
    "I am looking for {the_t} {p} {the_r}",
    "where {is_} {the_t} {p} {the_r}?",
    "which {t} {is_} {p} {the_r}?",
    "which {t} {is_} {p} {a_r}?",
)
SEEN_FRAMES = (*VARIED_FRAMES, "{the_t} {p} {the_r}, as seen from the camera", "from the camera, {the_t} {p} {the_r}")
QUESTION_FRAMES = (
    "{Is} {the_t} {p} {the_r}?",
    "{Is} {the_t} {p} {the_r} in this image?",
    "In the image, {is_} {the_t} {p} {the_r}?",
    "Is it true that {the_t} {is_} {p} {the_r}?",
)
SEEN_QUESTION_FRAMES = (
    *QUESTION_FRAMES,
    "{Is} {the_t} {p} {the_r}, as seen from the camera?",
    "From the camera, {is_} {the_t} {p} {the_r}?",
)
PLAIN_FRAME = "{t} {p} {plain_r}"
PLAIN_QUESTION = "{Is} {the_t} {p} {the_r}?"
SEMANTIC_ABSTRACTION_FRAME = "{t} {p} a {r}"
SEMANTIC_ABSTRACTION_PHRASES = {**PHRASE, **SEMANTIC_ABSTRACTION}
"""The relation words of Semantic Abstraction (Ha and Song, CoRL 2022); ours where it has none."""


Several = tuple[bool, bool]
"""Whether the frame has several objects that the target's, or the reference's, name may mean."""


@dataclass(frozen=True)
class _Template:
    """A sentence with blanks for the two names, its relation phrase already in it."""

    frame: str
    phrase: str

    def filled(self, target: NounPhrase, reference: NounPhrase, several: Several = (False, False)) -> str:
        other = target.words == reference.words
        a_r = reference.indefinite(other=other)
        the_r = a_r if several[1] else reference.definite(other=other)
        plain_r = a_r if several[1] else reference.definite()
        return self.frame.format(
            t=target.words,
            the_t=target.indefinite() if several[0] else target.definite(),
            a_t=target.indefinite(),
            p=self.phrase,
            r=reference.words,
            # "in front door" would be misleading, and "left of left shoe" is hard to read.
            bare_r=plain_r if words_of(reference.words)[0] in _PHRASE_WORDS else reference.words,
            the_r=the_r,
            a_r=a_r,
            plain_r=plain_r,
            is_=target.verb,
            Is=target.verb.capitalize(),
        )


_TEMPLATE_WORDS = frozenset(
    word
    for text in (
        *SEEN_FRAMES,
        *SEEN_QUESTION_FRAMES,
        "the a an some other another is are",
        *(p for phrases in VARIED_PHRASES.values() for p in phrases),
        *SEMANTIC_ABSTRACTION_PHRASES.values(),
    )
    for word in words_of(text)
)
_PHRASE_WORDS = frozenset(w for p in lexicon.phrase_table() for w in p.split())
_GRAMMAR_WORDS = (
    _PHRASE_WORDS
    | lexicon.LINKING
    | lexicon.RELATIVE
    | lexicon.POSTURES
    | lexicon.CLOSING
    | lexicon.AND
    | lexicon.WITH
    | lexicon.NEGATIONS
    | lexicon.ARTICLES
    | lexicon.PRONOUNS
    | lexicon.UNKNOWN_RELATIONS
    | lexicon.VERBS
    | lexicon.VIEW_WORDS
    | lexicon.OBJECT_VIEW_WORDS
    | lexicon.OTHER
    | DETERMINERS
    | LEADING_WORDS
    | frozenset(["left", "right", "front", "back", "rear", "top", "bottom", "middle", "center", "side", "hand"])
)


def expression_text(
    target: str,
    relation: str,
    reference: str,
    key: int,
    *,
    style: str = "varied",
    class_names: Sequence[str] = (),
    several: Several = (False, False),
) -> str:
    """Sentence of an expression: `the mug to the left of a laptop`.

    `language.expression.parse`, given the class names, reads it back as the same target, relation and reference.
    A name that the grammar would misread stands in double quotes, or the sentence falls back to the plain form.

    `target`, `reference`: class names as the dataset spells them. `relation`: one of `relations.PAIRWISE`. `key`: 0 ..
    2**64 - 1, such as a seeded hash; it chooses the sentence. Equal input gives equal text. `style`: many forms; `mug
    left of the laptop`; or the published form of Semantic Abstraction, `mug on the left of a laptop`, whose `a` stands
    before any name. `class_names`: all names of the dataset, where the sentence must also not be mistaken for any other
    of them. `several`: whether the target's and the reference's name mean several objects of the frame: those take `a`,
    since `the` would claim that there is one. The published form has its `a` in any case.

    Raises InputError: where an argument is out of range, or no sentence can carry the names: see `can_be_worded`.
    """
    require(style in STYLES, "unknown style of expressions", got=repr(style), expected="one of " + ", ".join(STYLES))
    number = _checked(relation, key)
    frames, phrases = {
        "varied": (SEEN_FRAMES if RELATIONS[relation].viewer_dependent else VARIED_FRAMES, VARIED_PHRASES[relation]),
        "plain": ((PLAIN_FRAME,), (PHRASE[relation],)),
        "semantic-abstraction": ((SEMANTIC_ABSTRACTION_FRAME,), (SEMANTIC_ABSTRACTION_PHRASES[relation],)),
    }[style]
    templates = _chosen(frames, phrases, number), _Template(PLAIN_FRAME, PHRASE[relation])
    return _worded(templates, target, relation, reference, class_names, several)


def question_text(relation: str, target: str, reference: str, key: int, *, class_names: Sequence[str] = ()) -> str:
    """A question to be answered with yes or no: `Is the mug left of the laptop?`.

    Parameters and errors are those of `expression_text`, and `parse` reads it as well.
    """
    number = _checked(relation, key)
    frames = SEEN_QUESTION_FRAMES if RELATIONS[relation].viewer_dependent else QUESTION_FRAMES
    templates = _chosen(frames, VARIED_PHRASES[relation], number), _Template(PLAIN_QUESTION, PHRASE[relation])
    return _worded(templates, target, relation, reference, class_names)


@lru_cache(maxsize=65536)
def can_be_worded(name: str) -> bool:
    """Tell class names fit for an expression and read back the same."""
    return isinstance(name, str) and bool(_forms(name, _known(())))


def _checked(relation: str, key: int) -> int:
    require(
        relation in PAIRWISE,
        "no such relation of two things",
        got=repr(relation),
        expected="one of " + ", ".join(PAIRWISE),
    )
    try:
        number = operator.index(key)
    except TypeError:
        raise InputError("the key of an expression must be an integer", got=repr(key)[:60]) from None
    require(0 <= number < 2**64, "the key of an expression is out of range", got=number, expected="0 .. 2**64 - 1")
    return number


def _chosen(frames: Sequence[str], phrases: Sequence[str], key: int) -> _Template:
    rest, index = divmod(key, len(frames))
    return _Template(frames[index], phrases[rest % len(phrases)])


def _worded(
    templates: tuple[_Template, _Template],
    target: str,
    relation: str,
    reference: str,
    class_names: Sequence[str],
    several: Several = (False, False),
) -> str:
    known = _known(class_names)
    for name in (target, reference):
        require(
            isinstance(name, str) and _forms(name, known),
            "the class name cannot be said in an expression",
            got=Shown(name, 80),
        )
    settled = _is_settled(target, known) and _is_settled(reference, known)
    settled = settled and (target == reference or words_of(target) != words_of(reference))
    rivals = known.rivals or _rivals((target, reference))
    targets, references = _forms(target, known), _forms(reference, known)
    for template in templates:
        for i, j in _by_preference(len(targets), len(references)):
            text = template.filled(noun_phrase(targets[i]), noun_phrase(references[j]), several)
            if len(text) > MAX_LENGTH:
                continue
            if settled and not (rivals and _holds_a_rival(text, rivals, (targets[i], references[j]))):
                return text
            if _reads_back(text, target, relation, reference, known):
                return text
    raise InputError(
        "no sentence can carry these class names",
        got=f"{target[:60]!r} {relation} {reference[:60]!r}",
        cause="they are too long together, or made of words of the grammar",
    )


@dataclass(frozen=True, eq=False)
class _Known:
    """The names of a dataset, hashed once, and its rivals: those that could reach from a name into a sentence."""

    names: tuple[str, ...]
    rivals: dict[str, tuple[str, ...]]


@lru_cache(maxsize=64)
def _known(class_names: tuple[str, ...]) -> _Known:
    return _Known(class_names, _rivals(class_names))


@lru_cache(maxsize=65536)
def _rivals(names: tuple[str, ...]) -> dict[str, tuple[str, ...]]:
    """Names with a word of some sentence in them, by their first word, each as a run of words."""
    found: dict[str, tuple[str, ...]] = {}
    for words in {words_of(name) for name in names}:
        if not _TEMPLATE_WORDS.isdisjoint(words):
            found[words[0]] = (*found.get(words[0], ()), _run(words))
    return found


def _run(words: Sequence[str]) -> str:
    return f" {'  '.join(words)} "


def _holds_a_rival(text: str, rivals: dict[str, tuple[str, ...]], forms: tuple[str, str]) -> bool:
    words = words_of(text)
    started = rivals.keys() & set(words)
    if not started:
        return False
    run, ends = _run(words), [_run(words_of(n)) for n in forms]
    return any(run.count(r) > sum(e.count(r) for e in ends) for first in started for r in rivals[first])


@lru_cache(maxsize=256)
def _by_preference(first: int, second: int) -> tuple[tuple[int, int], ...]:
    return tuple(sorted(product(range(first), range(second)), key=lambda p: (p[0] + p[1], p)))


@lru_cache(maxsize=65536)
def _forms(name: str, known: _Known) -> tuple[str, ...]:
    spoken = [w for w in dict.fromkeys((readable(name), readable(name, brief=False), " ".join(name.split()))) if w]
    quoted = [f'"{w}"' for w in dict.fromkeys(w.replace('"', " ").strip() for w in spoken) if w]
    partner = "mug" if not same_class(name, "mug") else "lamp"

    def survives(form: str) -> bool:
        ahead = PLAIN_FRAME.format(t=form, p="left of", plain_r=f"the {partner}")
        after = PLAIN_FRAME.format(t=partner, p="near", plain_r=f"the {form}")
        return (
            _names_no_other(form, name, known.names)
            and _reads_back(ahead, name, "left", partner, known)
            and _reads_back(after, partner, "near", name, known)
        )

    found = (next((form for form in forms if survives(form)), None) for forms in (spoken, quoted))
    return tuple(form for form in found if form is not None)


def _names_no_other(form: str, name: str, names: tuple[str, ...]) -> bool:
    if not names or normal_form(form) == normal_form(name):
        return True
    return set(match(form, names)) <= {name, *match(name, names)}


@lru_cache(maxsize=65536)
def _is_settled(name: str, known: _Known) -> bool:
    words = words_of(_forms(name, known)[0])
    if words == words_of(name) and (not known.names or name in known.names):
        return words[0] not in _PHRASE_WORDS and words[0] not in _TEMPLATE_WORDS
    return _GRAMMAR_WORDS.isdisjoint(words) and "'" not in name


@lru_cache(maxsize=65536)
def _reads_back(text: str, target: str, relation: str, reference: str, known: _Known) -> bool:
    try:
        query = parse(text, class_names=known.names or (target, reference))
    except InputError:
        return False
    found = query.expression
    single = sum(len(n.attachments) for n in query.default.root.walk()) == 1
    if found is None or query.default.root.triple is None:
        return False
    right = single and found.relation == relation and not found.inverse
    return right and is_named(found.target, target) and is_named(found.reference, reference)
