"""Spatial expressions: `mug left of the laptop` to a tree of nouns and relations, with all readings."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Sequence
from dataclasses import replace

from pipeline.language import lexicon
from pipeline.language.chain import Chain, Clause
from pipeline.language.grammar import read_chain
from pipeline.language.naming import Synonyms, default_synonyms
from pipeline.language.relation_names import MIRRORED, RELATIONS
from pipeline.language.tokens import NameIndex, check_text, mended, vocabulary
from pipeline.language.tree import Attachment, Node, Query, Reading, described
from pipeline.system.errors import InputError, Unsupported, require

MAX_RELATIONS = 4
"""Of more parts than this only two readings are kept: there would be 42, 132, ... of them."""
MOST_RELATIONS = 16
MOST_READINGS = 14


Reader = Callable[..., Query]
"""What reads expressions: `parse`, or whatever takes the same arguments and gives a `Query`, as a language model does
(`pipeline.language.llm_reader`)."""


UNREAD = "unread"


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

    >>> from pipeline.language import parse
    >>> query = parse("the red mug to the left of the laptop on the table")
    >>> [reading.description for reading in query.readings]
    ['red mug left of (laptop on table)', '(red mug left of laptop) on table']
    >>> query.labels, query.kind
    (('red mug', 'laptop', 'table'), 'two-relations')
    """
    text = check_text(text)
    if isinstance(class_names, str):
        raise InputError("class_names must be a list of names", got=repr(class_names[:60]))
    if isinstance(relations, str):
        raise InputError("relations must be a list of names", got=repr(relations[:60]))
    known = vocabulary(tuple(class_names), synonyms or default_synonyms())
    chain = read_chain(text, known)
    require(
        len(chain.clauses) <= MOST_RELATIONS,
        "the expression has too many relations",
        got=str(len(chain.clauses)),
        expected=f"at most {MOST_RELATIONS}",
    )
    readings: list[Reading] = []
    for clauses in _ways(chain.clauses, relations):
        attachments = [offered(clause, relations) if clause.relation else None for clause in clauses]
        for parents in _parents(clauses):
            root = _tree(0, replace(chain, clauses=clauses), attachments, parents)
            words = described(root)
            if not any(r.description == words for r in readings) and len(readings) < MOST_READINGS:
                readings.append(Reading(root, is_default=not readings, description=words))
    # Of words that say two things ("green, not jar" of one "jar") the first counts.
    first = {(s.start, s.end): s for s in reversed(chain.spans)}
    spans = tuple(sorted(first.values(), key=lambda s: s.start))
    return Query(text, tuple(readings), spans, mended=_mended_words(text, known, chain))


def _mended_words(text: str, known: NameIndex, chain: Chain) -> tuple[tuple[str, str], ...]:
    """Misspelt words that were corrected, in order; a name keeps its own."""
    names = [s for s in chain.spans if s.role in ("target", "reference")]
    read = set(mended(text, known))
    inside = {m for m in read if any(s.start <= m[0] and m[1] <= s.end for s in names)}
    anything = {m for m in inside if m[2] in lexicon.ANYTHING and any(n.name == m[2] for n in chain.nouns)}
    words = sorted((read - inside) | anything | set(chain.mended))
    return tuple((text[start:end], meant) for start, end, meant in words)


def sentence_kind(text: str, class_names: Sequence[str] = ()) -> str:
    """Kind of a text by the grammar (`Query.kind`); "unread" for unreadable texts."""
    try:
        return parse(text, class_names=class_names).kind
    except InputError:
        return UNREAD


def offered(clause: Clause, relations: Collection[str] | None) -> Attachment:
    """Relation in canonical terms and among those on offer, with references still to fill in; else Unsupported."""
    relation, inverse, mapped_from, lacking = clause.relation, clause.swapped, None, "on"
    coarser = RELATIONS[relation].coarser
    if relations is not None and relation not in relations and coarser is not None and coarser in relations:
        relation, mapped_from, lacking = coarser, relation, relation
    elif relations is not None and "on" not in relations and clause.phrase in lexicon.UNDER:
        mapped_from = "under"
    if inverse and relation in MIRRORED:
        relation, inverse = MIRRORED[relation], False
    if relations is not None and relation not in relations:
        known = [r for r in RELATIONS if r in relations]
        raise Unsupported(
            f"the relation '{relation}' is not in this vocabulary",
            got=f"'{clause.phrase}'",
            expected="one of " + ", ".join(known) if known else None,
        )
    note = f"this vocabulary has no '{lacking}': '{clause.phrase}' is read as '{relation}'" if mapped_from else None
    return Attachment(relation, (), inverse, clause.phrase, mapped_from, note, clause.negated)


def _ways(clauses: list[Clause], relations: Collection[str] | None) -> Iterator[list[Clause]]:
    """Parts as read first, and by the other meaning of their words."""
    yield clauses
    both = relations is None or {"on", "near"} <= set(relations)
    if both and any(c.otherwise for c in clauses):
        yield [replace(c, relation=c.otherwise[0], choice=c.otherwise[1]) if c.otherwise else c for c in clauses]


def _parents(clauses: Sequence[Clause]) -> Iterator[tuple[int, ...]]:
    """Nouns modified by each relation, for every reading; the default reading first.

    A relation may modify any noun on the right frontier: the last noun, what that one modifies, and so on up to the
    target. Trees grown so do not cross, and there are 1, 2, 5, 14, ... (Catalan) of them.
    """

    def attachable(clause: Clause, done: tuple[int, ...], frontier: tuple[int, ...]) -> Sequence[int]:
        same = frontier.index(done[-1]) if done and done[-1] in frontier else None
        only = {"nearest": len(frontier) - 1, "root": 0, "same": same}.get(clause.attach)
        return range(len(frontier) - 1, -1, -1) if only is None else (only,)

    def grow(done: tuple[int, ...], frontier: tuple[int, ...]) -> Iterator[tuple[int, ...]]:
        if len(done) == len(clauses):
            yield done
            return
        clause = clauses[len(done)]
        for index in attachable(clause, done, frontier):
            reached = () if clause.closed else clause.references[-1:]
            yield from grow((*done, frontier[index]), (*frontier[: index + 1], *reached))

    if len(clauses) <= MAX_RELATIONS:
        return grow((), (0,))
    return iter(dict.fromkeys((_chained(clauses, nearest=True), _chained(clauses, nearest=False))))


def _chained(clauses: Sequence[Clause], *, nearest: bool) -> tuple[int, ...]:
    """Nouns modified by each part: the nearest before, or the target."""
    parents: list[int] = []
    last = 0
    for clause in clauses:
        open_now = clause.attach == "nearest" or (clause.attach == "any" and nearest)
        parents.append(last if open_now else parents[-1] if clause.attach == "same" and parents else 0)
        last = clause.references[-1] if clause.references and not clause.closed else parents[-1]
    return tuple(parents)


def _tree(noun: int, chain: Chain, attachments: Sequence[Attachment | None], parents: Sequence[int]) -> Node:
    phrase = chain.nouns[noun]
    mine, chosen, excluded = [], list(phrase.choices), []
    for clause, attachment, parent in zip(chain.clauses, attachments, parents, strict=True):
        if parent != noun:
            continue
        nodes = tuple(_tree(r, chain, attachments, parents) for r in clause.references)
        if clause.choice is not None:
            chosen.append(clause.choice)
        if attachment is None and clause.choice is None:
            excluded += nodes
        elif attachment is not None:
            mine.append(replace(attachment, nodes=nodes))
    return Node(
        label=phrase.label,
        attachments=tuple(mine),
        mention=noun,
        head=phrase.head,
        attributes=phrase.attributes,
        choices=tuple(dict.fromkeys(chosen)),
        count=phrase.count,
        viewer=phrase.viewer,
        excluded=tuple(excluded),
    )
