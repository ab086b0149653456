"""Auditing statements about pictures, said to be true or false: against each other, and against what is seen."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence

from pipeline.answering.answer_words import best_pair
from pipeline.answering.pipeline import Pipeline
from pipeline.audit.benchmarks import NO_RELATION, Statement
from pipeline.audit.seen import MISREAD
from pipeline.audit.sentences import HOLDS, OWN_SIDES, has_front
from pipeline.audit.suspicion import AuditItem, Evidence
from pipeline.datasets.frame_names import FrameNames
from pipeline.language.expression import parse
from pipeline.language.naming import normal_form
from pipeline.language.relation_names import HORIZONTAL, INVERSE, MIRRORED
from pipeline.language.tree import Query
from pipeline.system.errors import InputError

ONE_OF_TWO = 0.5
DETECTED = 0.6
"""Where what was found says otherwise: detectors and estimated depth err, too."""
SURE, UNSURE_OF_FRAME = 0.9, 0.07
Triple = tuple[str, str, str]
NO_DATASET = "no dataset holds the picture (--dataset; --depth-model for pictures alone, --detector to find things)"


def audit_statements(
    items: Sequence[Statement], source: Pipeline | None, progress: Callable[[int, int], None] | None = None
) -> Iterator[AuditItem]:
    """Audit every item in order; `progress` is told (done, in all).

    `source`: a dataset of the pictures, with its annotations or a detector; None where there is none.
    """
    names = None if source is None else FrameNames(source.dataset.frame_ids)
    against = contradictions(items)
    for number, item in enumerate(items, start=1):
        frame, evidence, why = str(item.picture), list[Evidence](), item.why_not or NO_DATASET
        if not item.why_not and names is not None and source is not None:
            frame = names.find(item.picture, item.id) or frame
            evidence, why = of_geometry(item, frame, source, NO_DATASET)
        yield AuditItem(item.id, frame, item.text, item.truth, None, (*against[number - 1], *evidence), why or None)
        if progress is not None:
            progress(number, len(items))


def triple_of(text: str) -> Triple | None:
    """Names and relation of a plain statement of two things; None for anything else."""
    try:
        e = parse(text).expression
    except InputError:
        return None
    plain = e is not None and not e.inverse and not e.second_reference
    return (normal_form(e.target), e.relation, normal_form(e.reference)) if plain and e is not None else None


def implied(triple: Triple, true: bool) -> Iterator[tuple[Triple, bool]]:
    """A statement with those that follow from it."""
    a, relation, b = triple
    yield triple, true
    if relation in MIRRORED:
        yield (b, MIRRORED[relation], a), true
    if true and relation in INVERSE and INVERSE[relation] != relation:
        yield (a, INVERSE[relation], b), False
        yield (b, relation, a), False


def contradictions(items: Sequence[Statement]) -> list[list[Evidence]]:
    """Evidence by other items of the same picture that say the opposite, or of a scan that mean another object."""
    found: list[list[Evidence]] = [[] for _ in items]
    told: dict[tuple[str, Triple], tuple[int, bool]] = {}
    meant: dict[tuple[str, str], int] = {}
    for k, item in enumerate(items):
        if item.object:
            other = meant.setdefault((str(item.picture), normal_form(item.text)), k)
            if items[other].object != item.object:
                _opposed(found, items, k, other)
            continue
        triple = triple_of(item.text)
        for same, truth in () if triple is None or item.why_not else implied(triple, item.true):
            place, said = told.setdefault((str(item.picture), same), (k, truth))
            if said != truth:
                _opposed(found, items, k, place)
    return found


def _opposed(found: list[list[Evidence]], items: Sequence[Statement], k: int, other: int) -> None:
    for one, rival in ((k, items[other]), (other, items[k])):
        piece = Evidence("contradiction", ONE_OF_TWO, f"{rival.id} says {rival.truth} to “{rival.text}”")
        found[one] += [piece] if piece not in found[one] else []


def of_geometry(item: Statement, frame: str, source: Pipeline | None, unseen: str) -> tuple[list[Evidence], str | None]:
    """Evidence by the annotated or detected things of a frame, and why there is none; `unseen` for no such frame."""
    triple = triple_of(item.text)
    if triple is None:
        return [], NO_RELATION
    sided = triple[1] in HORIZONTAL and has_front(triple[2])
    doubt = f"it does not say whether the viewer's or the {triple[2]}'s own {triple[1]} is meant"
    unsure = [Evidence("frame", UNSURE_OF_FRAME, doubt)] if sided else []
    if source is None or frame not in source.dataset.frame_ids:
        return unsure, unseen
    try:
        context = source.prepare(frame)
        trace = source.ask(context, item.text)
        best = best_pair(trace)
    except InputError as error:
        return unsure, str(error)
    if best is None:
        return unsure, "the two things were not found"
    p, seen = best.p_relation, "annotated" if source.needed_detector().exact else "detected"
    estimated = " by estimated depth" if context.frame.depth_source else ""
    if (p >= SURE) == item.true:
        text = f"{seen} objects agree: the relation has {p:.2f}{estimated}"
        return [Evidence("geometry", HOLDS, text, (("p", p),))], None
    if 1 - SURE < p < SURE:
        return unsure, None
    mended = [*trace.query.mended, *misspelt_names(trace.query)]
    told = "".join(f"; “{a}” is read as “{b}”" for a, b in mended)
    text = f"{seen} objects say {'yes' if p >= SURE else 'no'}: the relation has {p:.2f}{estimated}{told}"
    if sided:
        return [Evidence("frame", MISREAD if mended else OWN_SIDES, f"{text}; {doubt}", (("p", p),))], None
    return [Evidence("geometry", MISREAD if mended else DETECTED, text, (("p", p),))], None


def misspelt_names(query: Query) -> list[tuple[str, str]]:
    """Names that the detector was asked for in other letters, each with these."""
    asked = dict(query.asked)
    return [(n.name, name) for n in query.nodes if (name := asked.get(n.label)) and name not in (n.label, n.name)]
