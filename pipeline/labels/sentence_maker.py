"""Sentences of labelled frames as people say them, each with all its right answers: `label --sentences`.

Trees are proposed from the frame's names, relations, colours and orders. One is kept where the labels say of every
object whether it is meant (`pipeline.labels.tree_truth`), where each of its parts is needed, and where its words are read
back as that very tree.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import combinations, product

import numpy as np

from pipeline.answering.objects import PreparedFrame, SceneObject
from pipeline.labels.labelling import FrameLabels, row_hash
from pipeline.labels.plan import LabelConfig
from pipeline.labels.reading import Columns
from pipeline.labels.tree_truth import TreeTruth
from pipeline.labels.tree_wording import tree_text
from pipeline.labels.wording import VARIED_PHRASES, can_be_worded
from pipeline.language.attributes import BASIC_COLORS, attribute
from pipeline.language.expression import parse
from pipeline.language.naming import same_class
from pipeline.language.relation_names import PAIRWISE
from pipeline.language.tokens import MAX_LENGTH
from pipeline.language.tree import Attachment, Choice, Node, Order, described
from pipeline.relations.relations import T, U
from pipeline.system.errors import InputError

LOOKS = (*BASIC_COLORS, "big", "large", "small", "tall", "short")
COUNTED = ("second", "third", "fourth", "fifth")
EXTREMES: tuple[tuple[Order, str], ...] = (
    ("left", "leftmost"), ("left", "farthest to the left"), ("right", "rightmost"), ("right", "farthest to the right"),
    ("near", "nearest"), ("near", "closest"), ("far", "farthest"), ("high", "highest"), ("high", "topmost"),
    ("low", "lowest"), ("tall", "tallest"), ("short", "shortest"), ("big", "biggest"), ("big", "largest"),
    ("small", "smallest"),
)  # fmt: skip
SIDES: tuple[tuple[tuple[Order, ...], str], ...] = (
    (("left",), "on the left"), (("left",), "on the left side"), (("right",), "on the right"),
    (("right",), "on the right side"), (("top",), "at the top"), (("bottom",), "at the bottom"),
    *(((a, b), f"in the {a} {b} corner") for a, b in product(("top", "bottom"), ("left", "right"))),
)  # fmt: skip
TO_VIEWER = (("closest", "closest to"), ("farthest", "farthest from"))
RELATIONS_A_NAME = 12
"""So many relations of each name are tried, which its number and seed choose."""


@dataclass(frozen=True)
class MadeSentence:
    """A sentence of a frame.

    Attributes
    ----------
    kind : str
        One of `plan.SENTENCE_KINDS`.
    text : str
    tree : Node
        What it says.
    answers : tuple of int
        Indices of all objects that are what it says; of no other is it doubtful.
    """

    kind: str
    text: str
    tree: Node
    answers: tuple[int, ...]

    def line(self, frame: str, numbers: Sequence[int] | None, boxes: np.ndarray) -> str:
        """Its line for `eval --sentences`: the annotations that are right, or, without `numbers` of those, the boxes."""
        right = (
            {"targets": [numbers[k] for k in self.answers]}
            if numbers is not None
            else {"boxes": [[round(float(v), 2) for v in boxes[k]] for k in self.answers]}
        )
        return json.dumps({"frame": frame, "sentence": self.text, "kind": self.kind, **right}, ensure_ascii=False)


def make_sentences(
    truth: TreeTruth, frame: str, config: LabelConfig, class_names: Sequence[str]
) -> tuple[MadeSentence, ...]:
    """The sentences of a frame, of the kinds that are wanted; equal input gives equal sentences.

    Parameters
    ----------
    truth : TreeTruth
    frame : str
    config : LabelConfig
        Says which kinds, and how many of each.
    class_names : sequence of str
        The names that a reader of the sentences knows.
    """
    maker = _Maker(truth, frame, config, tuple(class_names))
    return tuple(sentence for kind in config.sentences for sentence in maker.of(kind))


def frame_sentences(
    context: PreparedFrame,
    objects: Sequence[SceneObject],
    labels: FrameLabels,
    config: LabelConfig,
    class_names: Sequence[str],
    exact: bool,
) -> Columns:
    """The rows of the table `sentences` of a labelled frame.

    Parameters
    ----------
    objects : sequence of SceneObject
        All of the frame, as they were labelled.
    exact : bool
        The objects are the dataset's own annotations.
    """
    rows, judged = labels.objects, labels.judged
    if not rows or judged is None:
        return {}
    related = [k for k, o in enumerate(objects) if not config.is_background(o.label)]
    usable, occluded = ([rows[name][k] for k in related] for name in ("usable", "occluded"))
    mine = [objects[k] for k in related]
    truth = TreeTruth(context, mine, judged.states, usable, occluded)
    found = make_sentences(truth, context.frame.id, config, class_names)
    numbers = [o.id for o in mine] if exact else None
    boxes = np.array([o.bbox for o in mine], np.float64)
    return {
        "kind": [s.kind for s in found],
        "line": [s.line(context.frame.id, numbers, boxes) for s in found],
    }


@dataclass(frozen=True)
class _Maker:
    truth: TreeTruth
    frame: str
    config: LabelConfig
    class_names: tuple[str, ...]

    def of(self, kind: str) -> Iterator[MadeSentence]:
        """At most as many as are wanted of a kind, no two with the same answers."""
        answered: set[tuple[int, ...]] = set()
        for key, tree in sorted(self._keyed(kind), key=lambda found: found[0]):
            if len(answered) >= self.config.sentences_a_kind:
                return
            made = self._made(kind, tree, key)
            if made is not None and made.answers not in answered:
                answered.add(made.answers)
                yield made

    def _key(self, *parts: object) -> int:
        return row_hash(self.config.seed, self.frame, *parts)

    def _keyed(self, kind: str) -> Iterator[tuple[int, Node]]:
        for tree in _KINDS[kind](self):
            yield self._key(kind, described(tree)), _numbered(tree)

    def _made(self, kind: str, tree: Node, key: int) -> MadeSentence | None:
        found = self.truth.means(tree)
        alike = self.truth.means(Node(tree.name)) >= U
        answers = np.flatnonzero(found == T)
        # Of several answers fewer than half of those of the name: else little is said.
        if (found == U).any() or not len(answers) or (len(answers) > 1 and 2 * len(answers) > alike.sum()):
            return None
        if kind == "ordinal" and (self.truth.means(replace(tree, choices=())) >= U).sum() < 3:
            return None
        several = {0} if len(answers) > 1 else set()
        for reference in (n for a in tree.attachments for n in a.nodes if not n.viewer):
            there = self.truth.means(reference)
            if (there == U).any():
                return None
            several |= {reference.mention} if (there == T).sum() > 1 else set()
        if any(((self.truth.means(less) >= U) == (found == T)).all() for less in _lessened(tree)):
            return None
        text = tree_text(tree, several, key)
        return MadeSentence(kind, text, tree, tuple(answers.tolist())) if self._reads(text, tree) else None

    def _reads(self, text: str, tree: Node) -> bool:
        """Whether the grammar reads a sentence as this tree, in no other way, and leaves no word unused."""
        try:
            query = parse(text, class_names=self.class_names)
        except InputError:
            return False
        return len(text) <= MAX_LENGTH and [r.root for r in query.readings] == [tree] and not query.unused

    # ---- what is proposed -------------------------------------------------------------------------------------------

    def attributes(self) -> Iterator[Node]:
        for name in self._names(several=True):
            for looks in self._looking(name):
                yield looks
                for relation in self._relations(name):
                    yield replace(looks, attachments=(relation,))
            for relation in self._relations(name):
                for looks in self._looking(relation.nodes[0].label):
                    yield Node(name, (replace(relation, nodes=(looks,)),))

    def ordinals(self) -> Iterator[Node]:
        for base in self._bases():
            for (number, word), side in product(enumerate(COUNTED, start=2), ("left", "right")):
                yield replace(base, choices=(Choice(side, number, f"{word} from the {side}"),))
            for order, text in EXTREMES:
                if text in ("closest", "tallest", "biggest", "smallest"):
                    yield replace(base, choices=(Choice(order, 2, text),))

    def extremes(self) -> Iterator[Node]:
        for base in self._bases():
            yield from (replace(base, choices=(Choice(order, 1, text),)) for order, text in EXTREMES)
            if not base.attachments:
                for relation, phrase in TO_VIEWER:
                    yield replace(
                        base, attachments=(Attachment(relation, (Node("camera", viewer=True),), False, phrase),)
                    )

    def sides(self) -> Iterator[Node]:
        for name, (orders, text) in product(self._names(several=True), SIDES):
            yield Node(name, choices=tuple(Choice(order, None, text) for order in orders))

    def two_relations(self) -> Iterator[Node]:
        for name in self._names(several=True):
            for pair in combinations(self._relations(name), 2):
                yield Node(name, pair)

    def negations(self) -> Iterator[Node]:
        for name in self._names(several=True):
            relations = self._relations(name)
            for relation in relations:
                yield Node(name, (replace(relation, negated=True),))
                for other in relations:
                    if other.nodes != relation.nodes:
                        yield Node(name, (other, replace(relation, negated=True)))

    def _bases(self) -> Iterator[Node]:
        """Names that mean several things, alone and with what they are on or in."""
        for name in self._names(several=True):
            yield Node(name)
            yield from (Node(name, (r,)) for r in self._relations(name) if r.relation in ("on", "in"))

    def _names(self, *, several: bool) -> tuple[str, ...]:
        """Names of usable things that can be said; those that mean more than one."""
        names = dict.fromkeys(o.label for o, ok in zip(self.truth.objects, self.truth.usable, strict=True) if ok)
        least = 2 if several else 1
        return tuple(n for n in names if can_be_worded(n) and (self.truth.means(Node(n)) == T).sum() >= least)

    def _looking(self, name: str) -> Iterator[Node]:
        """A name with each attribute that one of its things has."""
        for word in LOOKS:
            told = attribute(word)
            assert told is not None
            node = Node(f"{word} {name}", head=name, attributes=(told,))
            if (self.truth.means(node) == T).any():
                yield node

    def _relations(self, name: str) -> list[Attachment]:
        """Some of the relations that a thing of a name has to things of other names."""
        mine = np.flatnonzero(self.truth.means(Node(name)) == T)
        found = []
        for other, relation in product(self._names(several=False), self.config.relations):
            theirs = np.flatnonzero(self.truth.means(Node(other)) == T)
            held = self.truth.states[np.ix_(mine, theirs)][..., PAIRWISE.index(relation)] == T
            if held.any() and not same_class(name, other):
                key, phrases = self._key(name, relation, other), VARIED_PHRASES[relation]
                found.append((key, Attachment(relation, (Node(other),), False, phrases[key % len(phrases)])))
        return [attachment for _, attachment in sorted(found, key=lambda k: k[0])[:RELATIONS_A_NAME]]


_KINDS: dict[str, Callable[[_Maker], Iterator[Node]]] = {
    "attribute": _Maker.attributes,
    "ordinal": _Maker.ordinals,
    "extreme": _Maker.extremes,
    "side": _Maker.sides,
    "two-relations": _Maker.two_relations,
    "negation": _Maker.negations,
}


def _numbered(tree: Node) -> Node:
    """The tree with its nouns numbered as they are mentioned."""
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
