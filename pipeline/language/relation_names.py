"""Names, vocabularies, inverses and phrases of the declared relations."""

from __future__ import annotations

from collections import Counter

from pipeline.language.relation import DECLARED, SEMANTIC_ABSTRACTION, Relation
from pipeline.system.errors import InputError


def version_numbers(version: str) -> tuple[int, ...]:
    """Numbers of a version for sorting: "1.10.0" as (1, 10, 0)."""
    return tuple(int(n) for n in version.split("."))


def checked(relations: tuple[Relation, ...]) -> dict[str, Relation]:
    """Check declarations, and map relations by name.

    InputError for two of one name, a phrase that two of them claim, an inverse that is not one, or a new relation
    before old ones.
    """
    found = {r.name: r for r in relations}
    phrases = Counter(p for r in relations for p in (*dict.fromkeys(r.reads), *dict.fromkeys(r.swapped_reads)))
    versions = [version_numbers(r.since) for r in relations if r.pairwise]
    problems = [f"{r.name} is declared twice" for r in relations if found[r.name] is not r]
    problems += [f"two relations are read from {phrase!r}" for phrase, n in phrases.items() if n > 1]
    problems += [f"{r.name} does not read its own phrase {r.phrase!r}" for r in relations if r.phrase not in r.reads]
    for r in relations:
        if r.inverse is not None and (r.inverse not in found or found[r.inverse].inverse != r.name):
            problems.append(f"{r.name} and {r.inverse} are not each other's inverse")
    if versions != sorted(versions):
        problems.append("a newer relation stands before an older one, and the order of columns would change")
    if problems:
        raise InputError("the relations are not well declared", got=problems[0], path="pipeline/language/relation.py")
    return found


RELATIONS = checked(DECLARED)
"""The declared relations by name, in their order."""
PHRASE = {r.name: r.phrase for r in DECLARED}
"""Wording of each between two nouns."""
PAIRWISE = tuple(r.name for r in DECLARED if r.pairwise)
"""Relations with a state for every ordered pair, in the order in which they are always shown."""
VOCABULARIES: dict[str, tuple[str, ...]] = {
    name: tuple(r.name for r in DECLARED if name in r.vocabularies)
    for name in dict.fromkeys(v for r in DECLARED for v in r.vocabularies)
} | {"semantic-abstraction": tuple(SEMANTIC_ABSTRACTION), "all": PAIRWISE}
DIRECTIONAL = VOCABULARIES["avd"]
MIRRORED = {r.name: r.inverse for r in DECLARED if r.inverse is not None}
"""`a R b` says the same as `b MIRRORED[R] a`. `on` and `in` have no such name, only phrases that swap."""
INVERSE = {name: inverse for name, inverse in MIRRORED.items() if inverse != name}
"""MIRRORED without the symmetric relations."""
OPPOSITES = tuple((name, INVERSE[name]) for k, name in enumerate(INVERSE) if INVERSE[name] in tuple(INVERSE)[k:])
"""Each two inverses once: they never hold together."""
HORIZONTAL = {r.name: r.axis for r in DECLARED if r.axis is not None and r.axis[0] != 1}
"""The directions in the level plane: axis among (right, up, forward), and on which side of it the target lies."""
