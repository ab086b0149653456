"""The tree of an expression: noun phrases, with relations and choices that identify the target."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Literal

from pipeline.language.attributes import Attribute
from pipeline.language.lexicon import ANYTHING, wording
from pipeline.system.frozen import dataclass

Role = Literal["target", "relation", "reference", "attribute", "choice", "unused"]
Order = Literal[
    "left",
    "right",
    "top",
    "bottom",
    "near",
    "far",
    "middle",
    "high",
    "low",
    "tall",
    "short",
    "big",
    "small",
    "wide",
    "narrow",
    "long",
    "thin",
    "thick",
]


QUERY_KINDS = (
    "negation",
    "between",
    "two-relations",
    "ordinal",
    "extreme",
    "side",
    "attribute",
    "question",
    "relation",
    "name",
)
"""Kinds of sentences, see `Query.kind`; those that `labels.plan.SENTENCE_KINDS` makes have the same names."""


@dataclass(frozen=True)
class Span:
    """A stretch of the expression and its role."""

    start: int  # Character range in the expression as it was typed
    end: int
    role: Role
    # The number of the noun (0 is the target), or of the relation, in order of mention; of an attribute or a choice
    # that of its noun. 0 for what was not used
    index: int
    note: str = ""  # Reason, where it was not used
    unknown: bool = False  # It was not used since it is a name that the detector does not know


# The docstring is part of the schema that `llm_reader` sends: other words ask models anew.
@dataclass(frozen=True)
class Choice:
    """Which of several things that the rest of the noun phrase fits: `leftmost`, `second from the left`, `on the left`.

    Attributes
    ----------
    order : str
        What the things are put in order by. left, right, top and bottom are those of the picture; near and far the
        distance from the camera; high and low the height above the ground; the others are sizes.
    rank : int or None
        The place in that order, 1 for the first; None for a side, of which more than one thing may be.
    text : str
        The words that said it.
    """

    order: Order
    rank: int | None = 1
    text: str = ""


@dataclass(frozen=True)
class Expression:
    """One relation between a target and its reference."""

    target: str  # Names, lower case without articles, or as the class list spells them
    relation: str  # Canonical name, one of `relation_names.RELATIONS`
    reference: str
    text: str  # The expression as it was typed
    second_reference: str | None = None  # The other reference of `between`
    # The relation holds from the reference to the target: `table holding a lamp` looks for a table such that the lamp
    # is on it. Only `on` and `in` need it
    inverse: bool = False
    mapped_from: str | None = None  # The relation in the sentence, where the vocabulary lacks it and another stands in
    note: str | None = None  # That mapping in words

    def __str__(self) -> str:
        second = f" and {self.second_reference}" if self.second_reference else ""
        return f"{self.target} {wording(self.relation, inverse=self.inverse)} {self.reference}{second}"


# The docstring is part of the schema that `llm_reader` sends: other words ask models anew.
@dataclass(frozen=True)
class Attachment:
    """A relation that modifies a noun.

    Attributes
    ----------
    relation : str
        Canonical name.
    nodes : tuple of Node
        Its references; two for `between`, else one.
    inverse : bool
        Whether the relation holds from the reference to the noun that it modifies.
    phrase : str
        The words that said it.
    mapped_from, note : str or None
        As in `Expression`.
    negated : bool
        Whether it must not hold, of no reference.
    """

    relation: str
    nodes: tuple[Node, ...]
    inverse: bool = False
    phrase: str = ""
    mapped_from: str | None = None
    note: str | None = None
    negated: bool = False

    @property
    def of_pairs(self) -> bool:
        """Test if the relation spans the table of candidate pairs: neither negated nor of the viewer."""
        return not self.negated and not any(n.viewer for n in self.nodes)


# The docstring is part of the schema that `llm_reader` sends: other words ask models anew.
@dataclass(frozen=True)
class Node:
    """A noun phrase and what modifies it.

    Attributes
    ----------
    label : str
        The thing with its attributes, as a detector of open vocabulary is asked for it: `red mug`.
    attachments : tuple of Attachment
        In order of mention; all must hold.
    mention : int
        Its number among the nouns of the expression; 0 is the target.
    head : str
        The thing alone: `mug`; empty where the label is no more than that.
    attributes : tuple of Attribute
    choices : tuple of Choice
    count : int or None
        How many there are, where the words say so: `the two chairs`.
    viewer : bool
        It is who looks: `me`, `the camera`.
    excluded : tuple of Node
        What it is not: `the box, not the brick`.
    """

    label: str
    attachments: tuple[Attachment, ...] = ()
    mention: int = 0
    head: str = ""
    attributes: tuple[Attribute, ...] = ()
    choices: tuple[Choice, ...] = ()
    count: int | None = None
    viewer: bool = False
    excluded: tuple[Node, ...] = ()

    @property
    def name(self) -> str:
        """Thing alone, without attributes."""
        return self.head or self.label

    @property
    def anything(self) -> bool:
        """Test if the name says only that there is a thing."""
        return self.name in ANYTHING

    @property
    def pairwise(self) -> Attachment | None:
        """First relation to other objects, the one of the table of candidate pairs."""
        return next((a for a in self.attachments if a.of_pairs), None)

    @property
    def triple(self) -> Attachment | None:
        """Relation of a plain triple: a single relation between bare things; else None."""
        top = self.pairwise
        bare = top is not None and self.is_bare and len(self.attachments) == 1
        return top if bare and top is not None and all(n.is_bare and not n.attachments for n in top.nodes) else None

    @property
    def is_bare(self) -> bool:
        """Test for no attributes, choices and exclusions."""
        return not (self.attributes or self.choices or self.excluded)

    def walk(self) -> Iterator[Node]:
        """Walk this node and all below, depth first; excluded nodes come last."""
        yield self
        for attachment in self.attachments:
            for node in attachment.nodes:
                yield from node.walk()
        for node in self.excluded:
            yield from node.walk()


@dataclass(frozen=True)
class Reading:
    """A reading of an expression."""

    root: Node  # The target
    is_default: bool  # Every relation modifies the noun nearest before it
    description: str  # With brackets: `mug left of (laptop on table)`


@dataclass(frozen=True)
class Query:
    """An expression with all its readings."""

    text: str  # As it was typed
    readings: tuple[Reading, ...]  # The default first
    spans: tuple[Span, ...]  # What each stretch of the text says, in order, without overlap
    reader: str = "grammar"  # The reader: "grammar", or "llm" and the model's name
    # tuple of (str, str), the misspelt words of the grammar and adjectives, each with its correction
    mended: tuple[tuple[str, str], ...] = ()
    # tuple of (str, str or None), once a detector was asked: each thing, and the phrase that the detector was asked
    # for; None for everything
    asked: tuple[tuple[str, str | None], ...] = ()

    @property
    def default(self) -> Reading:
        """Default reading: every relation modifies the noun nearest before."""
        return self.readings[0]

    @property
    def target(self) -> str:
        """Label of the target."""
        return self.default.root.label

    @property
    def expression(self) -> Expression | None:
        """Triple of the target and its first relation in the default reading; None without a relation."""
        root = self.default.root
        top = root.pairwise or next(iter(root.attachments), None)
        if top is None:
            return None
        reference, *more = (n.label for n in top.nodes)
        return Expression(
            target=root.label,
            relation=top.relation,
            reference=reference,
            text=self.text,
            second_reference=more[0] if more else None,
            inverse=top.inverse,
            mapped_from=top.mapped_from,
            note=top.note,
        )

    @property
    def nodes(self) -> tuple[Node, ...]:
        """All things in question, the target first, in order of mention; without the viewer."""
        return tuple(sorted((n for n in self.default.root.walk() if not n.viewer), key=lambda n: n.mention))

    @property
    def labels(self) -> tuple[str, ...]:
        """Names of all things in question, the target first, in order of mention, without repeats."""
        return tuple(dict.fromkeys(n.label for n in self.nodes))

    @property
    def needed(self) -> tuple[str, ...]:
        """Names of the things that have to be present: `labels` without excluded or negated things."""
        present = [self.default.root]
        for node in present:
            present += (n for a in node.attachments if not a.negated for n in a.nodes if not n.viewer)
        there = {node.label for node in present}
        return tuple(label for label in self.labels if label in there)

    @property
    def kind(self) -> str:
        """Kind of sentence, in one word: the first of QUERY_KINDS by the tree.

        Of one relation between bare names, or a bare name, it is `question` where it asks.
        """
        nodes = tuple(self.default.root.walk())
        attachments = [a for n in nodes for a in n.attachments]
        ranks = {c.rank for n in nodes for c in n.choices}
        viewed = {"closest", "farthest"} & {a.relation for a in attachments}
        asks = self.text.rstrip().endswith("?") or self.text.split()[0].lower() in ("which", "what", "where")
        found = (
            any(a.negated for a in attachments) or any(n.excluded for n in nodes),
            any(len(a.nodes) > 1 for a in attachments),
            len(attachments) > 1,
            any(rank is not None and rank > 1 for rank in ranks),
            1 in ranks or bool(viewed),
            None in ranks,
            any(n.attributes for n in nodes),
            asks,
            bool(attachments),
            True,
        )
        return QUERY_KINDS[found.index(True)]

    @property
    def unused(self) -> tuple[Span, ...]:
        """Meaningful words that could not be used, with the reason."""
        return tuple(s for s in self.spans if s.role == "unused")


def described(node: Node) -> str:
    """Noun phrase with brackets, in one form for every wording: `mug left of (laptop on table)`."""
    words = node.label
    for text in dict.fromkeys(c.text for c in node.choices):  # `bottom left` is two
        words = f"{words} [{text}]"
    for number, attachment in enumerate(node.attachments):
        ends = [f"({described(n)})" if n.attachments or n.choices else n.label for n in attachment.nodes]
        head = f"({words})" if number else words
        negation = "not " if attachment.negated else ""
        words = f"{head} {negation}{wording(attachment.relation, inverse=attachment.inverse)} {' and '.join(ends)}"
    for other in node.excluded:
        words = f"{words}, not {described(other)}"
    return words
