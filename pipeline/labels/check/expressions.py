"""Rules on expressions: what they say must follow from the relations, and read back as it was meant."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from functools import lru_cache
from typing import Any

import numpy as np

from pipeline.labels.check.view import Finding, FrameView, state_letter
from pipeline.language.expression import parse
from pipeline.language.naming import normal_form
from pipeline.language.noun_phrase import readable
from pipeline.language.tokens import words_of
from pipeline.relations.pair_measures import NOT_JUDGED, T, U
from pipeline.system.errors import InputError

MANY_ALIKE = 3
MARGIN_TOLERANCE = 1e-5


TEXTS_KEPT = 200_000
"""So many texts that were read are remembered, so that memory is bounded."""
Triple = tuple[str, str, str]
"""Normal form of target, relation, normal form of reference."""


def triple_of(class_names: tuple[str, ...], text: str) -> Triple | str:
    """Triple read from a text with the dataset's class names, or the reason for none."""
    try:
        query = parse(text, class_names=class_names)
    except InputError as error:
        return str(error)
    found = query.expression
    if found is None or query.default.root.triple is None:
        return "it is not one relation of two things"
    if found.inverse:
        return "its relation is the other way round"
    return normal_form(found.target), found.relation, normal_form(found.reference)


def check_expressions(view: FrameView, read: Callable[[str], Triple | str]) -> Iterator[Finding]:
    """All rules on the expressions of a frame; `read` is `triple_of` with the class names of the labels."""
    rows = view.expressions
    for row, number in enumerate(rows["id"]):
        pair = int(rows["target_object"][row]), int(rows["reference_object"][row])
        found = [*_on_its_own(view, row, read)]
        if pair[0] in view.row_of and pair[1] in view.row_of:
            found += [*_against_objects(view, row), *_against_relations(view, row)]
        for rule, message, figures in found:
            told = f"{str(rows['text'][row])!r}: {message}"
            yield view.finding(rule, pair, told, {"id": str(number), **figures})


def says_the(text: str, names: Sequence[str]) -> list[bool]:
    """Tell, of each name, a direct `the` in the text that does not belong to a longer name."""
    words = f" {' '.join(words_of(text))} "
    definite = [*map(_with_the, names)]
    longer = [
        {other for j, ways in enumerate(definite) if j != k for other in ways if other not in own}
        for k, own in enumerate(definite)
    ]
    return [
        any(words.count(way) > sum(words.count(o) for o in more if o.startswith(way)) for way in own)
        for own, more in zip(definite, longer, strict=True)
    ]


@lru_cache(TEXTS_KEPT)
def _with_the(name: str) -> frozenset[str]:
    """Ways to say a name behind a `the`."""
    return frozenset(f" the {' '.join(words_of(way))} " for way in (name, readable(name), readable(name, brief=False)))


Fault = tuple[str, str, dict[str, Any]]
"""Name of a broken rule, what is wrong, and the figures."""


def _on_its_own(view: FrameView, row: int, read: Callable[[str], Triple | str]) -> Iterator[Fault]:
    """Rules on the row alone."""
    rows = view.expressions
    a, targets, answers = int(rows["target_object"][row]), rows["targets"][row], len(rows["acceptable"][row])
    ambiguous = bool(rows["ambiguous"][row])
    if a not in targets:
        empty = f"its own target {a} is not among the targets" if len(targets) else "it has no targets"
        yield "expression/empty", empty, {}
    if ambiguous != (answers > 1):
        said = f"it is said to be {'ambiguous' if ambiguous else 'not ambiguous'}, with {answers} acceptable"
        yield "expression/ambiguous", said, {"acceptable": answers}
    wanted = normal_form(str(rows["target"][row])), rows["relation"][row], normal_form(str(rows["reference"][row]))
    found = read(str(rows["text"][row]))
    if isinstance(found, str):
        yield "expression/unreadable", f"it cannot be read: {found}", {}
    elif found != wanted:
        misread = f"it reads as {' / '.join(found)} and not {' / '.join(map(str, wanted))}"
        yield "expression/unreadable", misread, {}


def _against_objects(view: FrameView, row: int) -> Iterator[Fault]:
    rows = view.expressions
    ends = {role: view.row_of[int(rows[f"{role}_object"][row])] for role in ("target", "reference")}
    definite = says_the(str(rows["text"][row]), [str(rows[role][row]) for role in ends])
    for role, k in ends.items():
        name, of_object = view.labels[k], {"object": view.ids[k]}
        if rows[role][row] != name:
            other = f"its {role} is called {rows[role][row]!r}, and object {view.ids[k]} is {name!r}"
            yield "expression/class", other, of_object
        if not view.objects["usable"][k]:
            reason = view.objects["reason"][k] or "not usable"
            unusable = f"its {role}, {name} {view.ids[k]}, may not be asked for: {reason}"
            yield "expression/unusable", unusable, of_object
    for (role, k), said in zip(ends.items(), definite, strict=True):
        if said and not view.alone[k]:
            message = f"it says `the` of its {role}, and the frame has others that {view.labels[k]!r} may mean"
            yield "expression/article", f"{message}: labels made anew say `a`", {"object": view.ids[k]}


def _against_relations(view: FrameView, row: int) -> Iterator[Fault]:
    """State, margin and sets, as `labels.labelling.candidate_expressions` makes them."""
    rows = view.expressions
    relation = rows["relation"][row]
    if relation not in view.states:
        yield "expression/state", f"the relation {relation!r} is not labelled", {}
        return
    states = view.states[relation]
    a, b = view.row_of[int(rows["target_object"][row])], view.row_of[int(rows["reference_object"][row])]
    state = int(states[a, b])
    if state != T:
        what = "has no state" if state == NOT_JUDGED else f"is {state_letter(state)}"
        yield "expression/state", f"{view.relation_text(a, relation, b)} {what}", {"state": state}
    margin, stated = float(view.margins[relation][a, b]), float(rows["margin"][row])
    if state == T and not abs(margin - stated) <= MARGIN_TOLERANCE:
        message = f"its margin is {stated:.4f} m, the relation's {margin:.4f} m"
        yield "expression/margin", message, {"stated": stated, "margin": margin}
    alike = view.alike[a] & view.related
    among, total = states[:, view.alike[b] & view.related], int(alike.sum())
    for name, least in (("targets", T), ("acceptable", U)):
        stored, given = rows[name][row], view.ids[alike & (among >= least).any(axis=1)]
        if not np.array_equal(np.sort(stored), np.sort(given)):
            message = f"{name} are {_list(stored)}, the relations give {_list(given)}"
            yield "expression/sets", message, {"set": name, "stored": len(stored), "given": len(given)}
    if total >= MANY_ALIKE and len(np.unique(rows["acceptable"][row])) == total:
        message = f"all {total} of its class are acceptable: it tells nothing apart"
        yield "expression/everything", message, {"objects": total}


def _list(numbers: Sequence[int] | np.ndarray) -> str:
    listed = ", ".join(str(n) for n in np.sort(numbers)[:8])
    return f"{{{listed}{', ...' if len(numbers) > 8 else ''}}}"
