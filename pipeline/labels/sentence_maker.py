"""Sentences of labelled frames as people say them, each with all its right answers: `label --sentences`.

Trees are proposed from the frame's names, relations, colours and orders. One is kept where the labels say of every
object whether it is meant (`pipeline.labels.tree_truth`), where its parts are needed, and where its words are
read back as that very tree.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Collection, Iterator, Sequence
from dataclasses import replace
from functools import cached_property
from itertools import combinations, islice, product

import numpy as np

from pipeline.answering.objects import PreparedFrame, SceneObject
from pipeline.labels.labelling import FrameLabels, row_hash
from pipeline.labels.plan import LabelConfig
from pipeline.labels.reading import Columns
from pipeline.labels.tree_truth import TreeTruth
from pipeline.labels.wording import VARIED_PHRASES, can_be_worded
from pipeline.language.attributes import BASIC_COLORS, attribute
from pipeline.language.choices import EXTREMES, ORDINALS
from pipeline.language.expression import parse
from pipeline.language.lexicon import SCENE
from pipeline.language.naming import normal_form, same_class
from pipeline.language.noun_phrase import noun_phrase, readable
from pipeline.language.relation_names import PAIRWISE
from pipeline.language.tokens import MAX_LENGTH
from pipeline.language.tree import Attachment, Choice, Node, Order, described
from pipeline.relations.relations import T, U
from pipeline.system.errors import InputError
from pipeline.system.frozen import dataclass

LOOKS = (*((color,) for color in BASIC_COLORS), ("big", "large"), ("small",))
COUNTED = ("second", "third", "fourth", "fifth")
EXTREME_WORDS: dict[Order, tuple[str, ...]] = {
    "left": ("leftmost", "farthest to the left"),
    "right": ("rightmost", "farthest to the right"),
    "near": ("nearest", "closest"),
    "far": ("farthest",),
    "high": ("highest", "topmost"),
    "low": ("lowest",),
    "tall": ("tallest",),
    "short": ("shortest",),
    "big": ("biggest", "largest"),
    "small": ("smallest",),
}
SECONDS: dict[Order, str] = {"near": "closest", "tall": "tallest", "big": "biggest", "small": "smallest"}
SIDES: dict[tuple[Order, ...], tuple[str, ...]] = {
    ("left",): ("on the left", "on the left side"),
    ("right",): ("on the right", "on the right side"),
    ("top",): ("at the top",),
    ("bottom",): ("at the bottom",),
    ("top", "left"): ("in the top left corner",),
    ("top", "right"): ("in the top right corner",),
    ("bottom", "left"): ("in the bottom left corner",),
    ("bottom", "right"): ("in the bottom right corner",),
}
"""What is said, each with its words."""
PHRASES = {
    relation: tuple(p for p in phrases if not {"side", "than"} & set(p.split())) or phrases
    for relation, phrases in VARIED_PHRASES.items()
}
"""Without `on the left side of`, which may be a place on a thing, and `higher than`, which says less than `above`."""
TO_VIEWER = (("closest", "closest to"), ("farthest", "farthest from"))
RELATIONS_A_NAME = 12
"""So many relations of each name are tried; the seed chooses which."""


@dataclass(frozen=True)
class MadeSentence:
    """A sentence of a frame."""

    kind: str
    """One of `plan.SENTENCE_KINDS`."""
    text: str
    tree: Node
    """What it says."""
    answers: tuple[int, ...]
    """Places in the list of objects, of all that are what it says; of no other is it doubtful."""


def make_sentences(
    context: PreparedFrame,
    objects: Sequence[SceneObject],
    labels: FrameLabels,
    config: LabelConfig,
    class_names: Sequence[str],
) -> tuple[MadeSentence, ...]:
    """Make sentences of the wanted kinds for a labelled frame; equal input gives equal sentences.

    `objects`: all of the frame, as they were labelled. `config`: says which kinds, and how many of each. `class_names`:
    the names that a reader of the sentences knows.
    """
    rows, judged = labels.objects, labels.judged
    related = [k for k, o in enumerate(objects) if not config.is_background(o.label)]
    if not related or judged is None:
        return ()
    usable, occluded = ([rows[name][k] for k in related] for name in ("usable", "occluded"))
    truth = TreeTruth(context, [objects[k] for k in related], judged.states, usable, occluded)
    maker = _Maker(truth, context.frame.id, config, tuple(class_names))
    found = (sentence for kind in config.sentences for sentence in maker.of(kind))
    return tuple(replace(s, answers=tuple(related[k] for k in s.answers)) for s in found)


def sentence_rows(made: Sequence[MadeSentence], frame: str, objects: Sequence[SceneObject], exact: bool) -> Columns:
    """Rows of the table `sentences`: answers are annotations if the objects are (`exact`), else boxes."""

    def line(sentence: MadeSentence) -> str:
        mine = [objects[k] for k in sentence.answers]
        right = {"targets": [o.id for o in mine]} if exact else {"boxes": [np.round(o.bbox, 2).tolist() for o in mine]}
        said = {"frame": frame, "sentence": sentence.text, "kind": sentence.kind}
        return json.dumps({**said, **right}, ensure_ascii=False)

    return {"kind": [s.kind for s in made], "line": [line(s) for s in made]}


@dataclass(frozen=True)
class _Maker:
    truth: TreeTruth
    frame: str
    config: LabelConfig
    class_names: tuple[str, ...]

    def of(self, kind: str) -> list[MadeSentence]:
        """At most so many sentences of a kind, with answers as different as possible."""
        fresh: dict[tuple[int, ...], MadeSentence] = {}
        more: list[MadeSentence] = []
        for key, tree in sorted(self._keyed(kind), key=lambda found: found[0]):
            if len(fresh) == self.config.sentences_a_kind:
                break
            made = self._made(kind, tree, key)
            if made is not None and fresh.setdefault(made.answers, made) is not made:
                more.append(made)
        return [*fresh.values(), *more][: self.config.sentences_a_kind]

    def _key(self, *parts: object) -> int:
        return row_hash(self.config.seed, self.frame, *parts)

    def _one_of(self, words: Sequence[str], *parts: object) -> str:
        return words[self._key(*words, *parts) % len(words)]

    def _keyed(self, kind: str) -> Iterator[tuple[int, Node]]:
        for tree in _KINDS[kind](self):
            yield self._key(kind, described(tree)), _numbered(tree)

    def _made(self, kind: str, tree: Node, key: int) -> MadeSentence | None:
        found = self.truth.means(tree)
        alike = self.truth.means(Node(tree.name)) == T
        answers = np.flatnonzero(found == T)
        # Of several answers at most half of those of the name: else little is said.
        if (found == U).any() or not len(answers) or (len(answers) > 1 and 2 * len(answers) > alike.sum()):
            return None
        if kind == "ordinal" and (self.truth.means(replace(tree, choices=())) == T).sum() < 3:
            return None
        several = {0} if len(answers) > 1 else set()
        for reference in (n for a in tree.attachments for n in a.nodes if not n.viewer):
            there = self.truth.means(reference)
            if (there == U).any():
                return None
            several |= {reference.mention} if (there == T).sum() > 1 else set()
        # What is left out must be missed, among things of that very name; of two relations one may say the same again.
        missed = [((alike & (self.truth.means(less) >= U)) != (found == T)).any() for less in _lessened(tree)]
        if not (any(missed) if kind == "two-relations" else all(missed)):
            return None
        text = tree_text(tree, several, key)
        return MadeSentence(kind, text, tree, tuple(answers.tolist())) if self._reads(text, tree) else None

    def _reads(self, text: str, tree: Node) -> bool:
        try:
            query = parse(text, class_names=self.class_names)
        except InputError:
            return False
        return len(text) <= MAX_LENGTH and [r.root for r in query.readings] == [tree] and not query.unused

    # ---- what is proposed -------------------------------------------------------------------------------------------

    def attributes(self) -> Iterator[Node]:
        for name in self._several:
            for looks in self._looking(name):
                yield looks
                for relation in self._relations(name):
                    yield replace(looks, attachments=(relation,))
            to_several = (r for r in self._related[name] if r.nodes[0].label in self._several)
            for relation in islice(to_several, RELATIONS_A_NAME):
                for looks in self._looking(relation.nodes[0].label):
                    yield Node(name, (replace(relation, nodes=(looks,)),))

    def ordinals(self) -> Iterator[Node]:
        for base in self._bases():
            for (number, word), side in product(enumerate(COUNTED, start=2), ("left", "right")):
                yield replace(base, choices=(Choice(side, number, f"{word} from the {side}"),))
            yield from (replace(base, choices=(Choice(order, 2, text),)) for order, text in SECONDS.items())

    def extremes(self) -> Iterator[Node]:
        for base in self._bases():
            for order, words in EXTREME_WORDS.items():
                yield replace(base, choices=(Choice(order, 1, self._one_of(words, order, base.label)),))
            if not base.attachments:
                for relation, phrase in TO_VIEWER:
                    yield Node(base.label, (Attachment(relation, (Node("camera", viewer=True),), False, phrase),))

    def sides(self) -> Iterator[Node]:
        for name, (orders, words) in product(self._several, SIDES.items()):
            text = self._one_of(words, orders, name)
            yield Node(name, choices=tuple(Choice(order, None, text) for order in orders))

    def two_relations(self) -> Iterator[Node]:
        for name in self._several:
            for one, other in combinations(self._relations(name), 2):
                if one.nodes != other.nodes and one.relation != other.relation:
                    yield Node(name, (one, other))

    def negations(self) -> Iterator[Node]:
        for name in self._several:
            relations = self._relations(name)
            for relation in relations:
                yield Node(name, (replace(relation, negated=True),))
                for other in relations:
                    if other.nodes != relation.nodes:
                        yield Node(name, (other, replace(relation, negated=True)))

    def _bases(self) -> Iterator[Node]:
        for name in self._several:
            yield Node(name)
            yield from (Node(name, (r,)) for r in self._related[name] if r.relation in ("on", "in"))

    @cached_property
    def _sure(self) -> dict[str, np.ndarray]:
        """The usable things of each name that can be said."""
        names = dict.fromkeys(o.label for o, ok in zip(self.truth.objects, self.truth.usable, strict=True) if ok)
        return {n: np.flatnonzero(self.truth.means(Node(n)) == T) for n in names if can_be_worded(n)}

    @cached_property
    def _several(self) -> tuple[str, ...]:
        return tuple(name for name, there in self._sure.items() if len(there) > 1)

    def _looking(self, name: str) -> Iterator[Node]:
        for words in LOOKS:
            word = self._one_of(words, name)
            told = attribute(word)
            assert told is not None
            node = Node(f"{word} {name}", head=name, attributes=(told,))
            if (self.truth.means(node) == T).any():
                yield node

    @cached_property
    def _related(self) -> dict[str, list[Attachment]]:
        """The relations that a thing of a name has to things of other names, in an order of the seed's."""
        found: dict[str, list[tuple[int, Attachment]]] = {name: [] for name in self._several}
        for name, other in product(self._several, self._sure):
            if same_class(name, other) or normal_form(other) in SCENE:
                continue
            states = self.truth.states[np.ix_(self._sure[name], self._sure[other])]
            for relation in self.config.relations:
                if (states[..., PAIRWISE.index(relation)] == T).any():
                    phrase = self._one_of(PHRASES[relation], name, other)
                    attachment = Attachment(relation, (Node(other),), False, phrase)
                    found[name].append((self._key(name, relation, other), attachment))
        return {name: [a for _, a in sorted(all_of, key=lambda k: k[0])] for name, all_of in found.items()}

    def _relations(self, name: str) -> list[Attachment]:
        return self._related[name][:RELATIONS_A_NAME]


_KINDS: dict[str, Callable[[_Maker], Iterator[Node]]] = {
    "attribute": _Maker.attributes,
    "ordinal": _Maker.ordinals,
    "extreme": _Maker.extremes,
    "side": _Maker.sides,
    "two-relations": _Maker.two_relations,
    "negation": _Maker.negations,
}


def _numbered(tree: Node) -> Node:
    attachments = tuple(
        replace(a, nodes=tuple(replace(n, mention=k) for n in a.nodes)) for k, a in enumerate(tree.attachments, start=1)
    )
    return replace(tree, attachments=attachments)


def _lessened(tree: Node) -> Iterator[Node]:
    """The tree without each of its parts in turn; choices go together."""
    if tree.choices:
        yield replace(tree, choices=())
    if tree.attributes:
        yield replace(tree, label=tree.name, head="", attributes=())
    for k, attachment in enumerate(tree.attachments):
        before, after = tree.attachments[:k], tree.attachments[k + 1 :]
        yield replace(tree, attachments=(*before, *after))
        if any(n.attributes for n in attachment.nodes):
            bare = tuple(replace(n, label=n.name, head="", attributes=()) for n in attachment.nodes)
            yield replace(tree, attachments=(*before, replace(attachment, nodes=bare), *after))


SENTENCE_FRAMES = ("{}", "{}", "{}", "find {}", "show me {}", "point to {}", "where {is_} {}?", "I am looking for {}")
_NUMBERED = {number: word for word, number in reversed(ORDINALS.items()) if word.isalpha()}


def tree_text(root: Node, several: Collection[int], key: int) -> str:
    """Sentence of a tree: `find the leftmost book that is on the table`.

    `several`: mentions of the nouns that mean several things: they take `a`, since `the` would claim that there is one.
    `key`: at least 0; it chooses among the forms. Equal input gives equal text.
    """
    key, frame = divmod(key, len(SENTENCE_FRAMES))
    return SENTENCE_FRAMES[frame].format(
        phrase_text(root, several, linked=key % 2 > 0), is_=noun_phrase(readable(root.name)).verb
    )


def phrase_text(node: Node, several: Collection[int], *, linked: bool = False) -> str:
    """Word a noun phrase; `linked` puts a relative clause before relations."""
    if node.viewer:
        return f"the {node.label}"
    before, after = zip(*(_around(choice) for choice in node.choices), strict=True) if node.choices else ((), ())
    words = [*before, node.label.removesuffix(node.name).strip(), readable(node.name)]
    noun = noun_phrase(" ".join(w for w in words if w))
    parts = [noun.indefinite() if node.mention in several else noun.definite(), *dict.fromkeys(after)]
    for number, attachment in enumerate(node.attachments):
        # `from the left on the table` would be hard to read.
        linked = linked or any(after)
        parts.append(_relation(attachment, several, number, linked=linked, verb=noun.verb))
    return " ".join(p for p in parts if p)


def _around(choice: Choice) -> tuple[str, str]:
    if choice.text in EXTREMES:
        return (choice.text if choice.rank == 1 else f"{_NUMBERED[choice.rank or 1]} {choice.text}"), ""
    first, _, rest = choice.text.partition(" ")
    return (first, rest) if first in ORDINALS else ("", choice.text)


def _relation(attachment: Attachment, several: Collection[int], number: int, *, linked: bool, verb: str) -> str:
    (end,) = attachment.nodes
    link = f"that {verb} " if not number and (linked or attachment.negated) else ""
    joint = "" if not number else "but " if attachment.negated else "and "
    negation = "not " if attachment.negated else ""
    return f"{joint}{link}{negation}{attachment.phrase} {phrase_text(end, several)}"
