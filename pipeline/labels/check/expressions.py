"""Rules on expressions: what they say must follow from the relations, and read back as it was meant."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from pipeline.labels.check.view import Finding, FrameView, state_letter
from pipeline.labels.labelling import row_hash
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


@dataclass(frozen=True)
class ExpressionRules:
    """What the expressions of a run are compared with."""

    read: Callable[[str], Triple | str]
    """`triple_of` with the class names of the labels, each text once."""
    seed: int
    """Of the ids."""
    profile: str


def check_expressions(view: FrameView, rules: ExpressionRules) -> Iterator[Finding]:
    """All rules on the expressions of a frame."""
    rows = view.expressions
    seen: set[object] = set()
    for row in range(len(rows)):
        pair = int(rows["target_object"][row]), int(rows["reference_object"][row])
        text = str(rows["text"][row])
        found = [*_on_its_own(view, row, rules)]
        if rows["id"][row] in seen:
            found.append(("expression/duplicate-id", f"a second expression has the id {rows['id'][row]}", {}))
        seen.add(rows["id"][row])
        if pair[0] in view.row_of and pair[1] in view.row_of:
            found += _against_objects(view, row)
            found += _against_relations(view, row)
        for rule, message, figures in found:
            yield view.finding(rule, pair, f"{text!r}: {message}", {"id": str(rows["id"][row]), **figures})


def says_the(text: str, names: Sequence[str]) -> list[bool]:
    """Tell, of each name, a direct `the` in the text that does not belong to a longer name."""
    words = f" {' '.join(words_of(text))} "
    definite = [{f" the {' '.join(words_of(way))} " for way in (name, readable(name), readable(name, brief=False))}
            for name in names]  # fmt: skip
    longer = [
        {other for j, ways in enumerate(definite) if j != k for other in ways if other not in own}
        for k, own in enumerate(definite)
    ]
    return [
        any(words.count(way) > sum(words.count(o) for o in more if o.startswith(way)) for way in own)
        for own, more in zip(definite, longer, strict=True)
    ]


Found = tuple[str, str, dict[str, float | int | str]]


def _on_its_own(view: FrameView, row: int, rules: ExpressionRules) -> Iterator[Found]:
    rows = view.expressions
    a, relation, b = int(rows["target_object"][row]), rows["relation"][row], int(rows["reference_object"][row])
    targets, acceptable = rows["targets"][row], rows["acceptable"][row]
    if not len(targets):
        yield "expression/empty", "it has no targets", {}
    elif a not in targets:
        yield "expression/empty", f"its own target {a} is not among the targets", {}
    if bool(rows["ambiguous"][row]) != (len(acceptable) > 1):
        flag = "ambiguous" if rows["ambiguous"][row] else "not ambiguous"
        yield (
            "expression/ambiguous",
            f"it is said to be {flag}, with {len(acceptable)} acceptable",
            {"acceptable": len(acceptable)},
        )
    if rows["id"][row] != f"{row_hash(rules.seed, str(rows['frame'][row]), a, relation, b):016x}":
        yield "expression/id", "its id is not the hash of frame, objects and relation", {}
    wanted = normal_form(str(rows["target"][row])), relation, normal_form(str(rows["reference"][row]))
    read = rules.read(str(rows["text"][row]))
    if isinstance(read, str):
        yield "expression/unreadable", f"it cannot be read: {read}", {}
    elif read != wanted:
        yield "expression/unreadable", f"it reads as {' / '.join(read)} and not {' / '.join(map(str, wanted))}", {}
    frames = view.tables["frames"]
    if rows["profile"][row] != rules.profile:
        yield "expression/source", f"its profile is {rows['profile'][row]!r}, that of the labels {rules.profile!r}", {}
    elif len(frames) and rows["up_source"][row] != frames["up_source"][0]:
        yield (
            "expression/source",
            f"its up vector is {rows['up_source'][row]}, the frame's is {frames['up_source'][0]}",
            {},
        )


def _against_objects(view: FrameView, row: int) -> Iterator[Found]:
    rows = view.expressions
    for role in ("target", "reference"):
        number = int(rows[f"{role}_object"][row])
        k = view.row_of[number]
        if rows[role][row] != view.labels[k]:
            message = f"its {role} is called {rows[role][row]!r}, and object {number} is {view.labels[k]!r}"
            yield "expression/class", message, {"object": number}
        if not view.objects["usable"][k]:
            reason = view.objects["reason"][k] or "not usable"
            yield (
                "expression/unusable",
                f"its {role}, {view.labels[k]} {number}, may not be asked for: {reason}",
                {"object": number},
            )
    names = [str(rows[role][row]) for role in ("target", "reference")]
    for role, definite in zip(("target", "reference"), says_the(str(rows["text"][row]), names), strict=True):
        k = view.row_of[int(rows[f"{role}_object"][row])]
        if definite and not view.alone[k]:
            message = f"it says `the` of its {role}, and the frame has others that {view.labels[k]!r} may mean"
            yield "expression/article", f"{message}: labels made anew say `a`", {"object": int(view.ids[k])}


def _against_relations(view: FrameView, row: int) -> Iterator[Found]:
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
        yield (
            "expression/margin",
            f"its margin is {stated:.4f} m, the relation's {margin:.4f} m",
            {
                "stated": stated,
                "margin": margin,
            },
        )
    alike, references = view.alike[a] & view.related, view.alike[b] & view.related
    among = states[:, references]
    sure = view.ids[alike & (among == T).any(axis=1)]
    likely = view.ids[alike & (among >= U).any(axis=1)]
    for name, wanted in (("targets", sure), ("acceptable", likely)):
        stored = rows[name][row]
        if not np.array_equal(np.sort(stored), np.sort(wanted)):
            yield (
                "expression/sets",
                f"{name} are {_list(stored)}, the relations give {_list(wanted)}",
                {
                    "set": name,
                    "stored": len(stored),
                    "given": len(wanted),
                },
            )
    total = int(alike.sum())
    if total >= MANY_ALIKE and len(np.unique(rows["acceptable"][row])) == total:
        yield (
            "expression/everything",
            f"all {total} of its class are acceptable: it tells nothing apart",
            {"objects": total},
        )


def _list(numbers: np.ndarray) -> str:
    listed = ", ".join(str(n) for n in np.sort(numbers)[:8])
    return f"{{{listed}{', ...' if len(numbers) > 8 else ''}}}"
