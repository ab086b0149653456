"""Spatial expressions: `mug left of the laptop` to target, relation and reference, with every way to read it."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass, replace

from pipeline.language import lexicon
from pipeline.language.grammar import Chain, Clause, Span, read_chain
from pipeline.language.lexicon import wording
from pipeline.language.naming import Synonyms, default_synonyms
from pipeline.language.relation_names import MIRRORED, RELATIONS
from pipeline.language.tokens import check_text, vocabulary
from pipeline.system.errors import InputError, require

__all__ = ["MAX_RELATIONS", "Attachment", "Expression", "Node", "Query", "Reading", "Span", "parse"]

MAX_RELATIONS = 4
"""More relations than this have too many readings (1, 2, 5, 14, 42, ...) to show."""


@dataclass(frozen=True)
class Expression:
    """One relation between a target and its reference.

    Attributes
    ----------
    target, reference : str
        Names, lower case without articles, or as the class list spells them.
    relation : str
        Canonical name, one of `relation_names.RELATIONS`.
    text : str
        The expression as it was typed.
    second_reference : str or None
        The other reference of `between`.
    inverse : bool
        Whether the relation holds from the reference to the target: `table holding a lamp` looks for a table such
        that the lamp is on it. Only `on` and `in` need it.
    mapped_from : str or None
        What was said, where the vocabulary has no relation for it and another stands in.
    note : str or None
        That mapping in words.
    """

    target: str
    relation: str
    reference: str
    text: str
    second_reference: str | None = None
    inverse: bool = False
    mapped_from: str | None = None
    note: str | None = None

    def __post_init__(self) -> None:
        require(
            self.relation in RELATIONS,
            "unknown relation",
            got=repr(self.relation),
            expected="one of " + ", ".join(RELATIONS),
        )
        require(
            self.target.strip() and self.reference.strip(),
            "an expression needs a target and a reference",
            got=repr((self.target, self.reference)),
        )
        if (self.relation == "between") != (self.second_reference is not None):
            raise InputError("between, and only between, has a second reference", got=self.relation)

    def __str__(self) -> str:
        second = f" and {self.second_reference}" if self.second_reference else ""
        return f"{self.target} {wording(self.relation, inverse=self.inverse)} {self.reference}{second}"


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
    """

    relation: str
    nodes: tuple[Node, ...]
    inverse: bool = False
    phrase: str = ""
    mapped_from: str | None = None
    note: str | None = None


@dataclass(frozen=True)
class Node:
    """A noun and what modifies it.

    Attributes
    ----------
    label : str
    attachments : tuple of Attachment
        In order of mention; all must hold.
    mention : int
        Its number among the nouns of the expression; 0 is the target.
    """

    label: str
    attachments: tuple[Attachment, ...] = ()
    mention: int = 0

    def walk(self) -> Iterator[Node]:
        """This node and all below it, depth first."""
        yield self
        for attachment in self.attachments:
            for node in attachment.nodes:
                yield from node.walk()


@dataclass(frozen=True)
class Reading:
    """One way to read an expression.

    Attributes
    ----------
    root : Node
        The target.
    is_default : bool
        Whether every relation modifies the noun nearest before it.
    description : str
        With brackets: `mug left of (laptop on table)`.
    """

    root: Node
    is_default: bool
    description: str


@dataclass(frozen=True)
class Query:
    """An expression with all its readings.

    Attributes
    ----------
    text : str
        As it was typed.
    readings : tuple of Reading
        The default first.
    spans : tuple of Span
        What each stretch of the text says, in order, without overlap.
    """

    text: str
    readings: tuple[Reading, ...]
    spans: tuple[Span, ...]

    @property
    def default(self) -> Reading:
        """The reading in which every relation modifies the noun nearest before it."""
        return self.readings[0]

    @property
    def expression(self) -> Expression:
        """The triple of the target and its first relation in the default reading; all there is if it has one."""
        root = self.default.root
        top = root.attachments[0]
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
    def labels(self) -> tuple[str, ...]:
        """The names of all things asked for, the target first, in order of mention, without repeats."""
        return tuple(dict.fromkeys(n.label for n in sorted(self.default.root.walk(), key=lambda n: n.mention)))


def parse(
    text: str,
    *,
    class_names: Sequence[str] = (),
    relations: Collection[str] | None = None,
    synonyms: Synonyms | None = None,
) -> Query:
    """Read a spatial expression.

    Left, right, front and behind are the camera's. Articles, `that is`, leading verbs (`find`, `where is`), the form
    of a question and `from the camera` are dropped. Double quotes hold a name together.

    Parameters
    ----------
    text : str
        `TARGET RELATION REFERENCE`, at most 300 characters and 4 relations.
    class_names : sequence of str
        Names to hold together and to spell as they are here, such as `front door` and `pillow on bed`. Other names
        are read all the same.
    relations : collection of str, optional
        The canonical relations on offer; all by default. Where there is no `on`, `above` stands in for it.
    synonyms : Synonyms, optional
        The project's own table by default.

    Raises
    ------
    InputError
        The text is no such expression: empty, too long, without relation, target or reference, with a relation that
        is unknown or not on offer, negated, or judged from an object's own front. The message suggests what is near.
    """
    text = check_text(text)
    if isinstance(class_names, str):
        raise InputError("class_names must be a list of names", got=repr(class_names[:60]))
    if isinstance(relations, str):
        raise InputError("relations must be a list of names", got=repr(relations[:60]))
    known = vocabulary(tuple(class_names), synonyms or default_synonyms())
    chain = read_chain(text, known)
    require(
        len(chain.clauses) <= MAX_RELATIONS,
        "the expression has too many relations",
        got=str(len(chain.clauses)),
        expected=f"at most {MAX_RELATIONS}",
        cause="it would have 42 readings or more",
    )
    attachments = [_attachment(clause, relations) for clause in chain.clauses]
    readings = []
    for parents in _parents(chain.clauses):
        root = _tree(0, chain, attachments, parents)
        readings.append(Reading(root, is_default=not readings, description=_described(root)))
    return Query(text, tuple(readings), tuple(sorted(chain.spans, key=lambda s: s.start)))


def _attachment(clause: Clause, relations: Collection[str] | None) -> Attachment:
    """A clause in canonical terms and in those on offer, its references still to be filled in."""
    relation, inverse, mapped_from, lacking = clause.relation, clause.swapped, None, "on"
    coarser = RELATIONS[relation].coarser
    if relations is not None and relation not in relations and coarser is not None and coarser in relations:
        relation, mapped_from, lacking = coarser, relation, relation
    elif relations is not None and "on" not in relations and clause.phrase in lexicon.UNDER:
        mapped_from = "under"
    if inverse and relation in MIRRORED:
        relation, inverse = MIRRORED[relation], False
    if relations is not None and relation not in relations:
        offered = [r for r in RELATIONS if r in relations]
        raise InputError(
            f"the relation '{relation}' is not in this vocabulary",
            got=f"'{clause.phrase}'",
            expected="one of " + ", ".join(offered) if offered else None,
        )
    note = f"this vocabulary has no '{lacking}': '{clause.phrase}' is read as '{relation}'" if mapped_from else None
    return Attachment(relation, (), inverse, clause.phrase, mapped_from, note)


def _parents(clauses: Sequence[Clause]) -> Iterator[tuple[int, ...]]:
    """For every reading the noun that each relation modifies; the default reading first.

    A relation may modify any noun on the right frontier: the last noun, what that one modifies, and so on up to the
    target. Trees grown so do not cross, and there are 1, 2, 5, 14, ... (Catalan) of them.
    """

    def grow(done: tuple[int, ...], frontier: tuple[int, ...]) -> Iterator[tuple[int, ...]]:
        if len(done) == len(clauses):
            yield done
            return
        clause = clauses[len(done)]
        places = range(len(frontier) - 1, -1, -1)
        if clause.attach == "nearest":
            places = places[:1]
        elif clause.attach == "same" and done:
            places = [frontier.index(done[-1])]
        for place in places:
            reached = () if clause.closed else clause.references[-1:]
            yield from grow((*done, frontier[place]), (*frontier[: place + 1], *reached))

    return grow((), (0,))


def _tree(noun: int, chain: Chain, attachments: Sequence[Attachment], parents: Sequence[int]) -> Node:
    mine = tuple(
        replace(attachment, nodes=tuple(_tree(r, chain, attachments, parents) for r in clause.references))
        for clause, attachment, parent in zip(chain.clauses, attachments, parents, strict=True)
        if parent == noun
    )
    return Node(chain.nouns[noun], mine, noun)


def _described(node: Node) -> str:
    words = node.label
    for number, attachment in enumerate(node.attachments):
        ends = [f"({_described(n)})" if n.attachments else n.label for n in attachment.nodes]
        head = f"({words})" if number else words
        words = f"{head} {wording(attachment.relation, inverse=attachment.inverse)} {' and '.join(ends)}"
    return words
