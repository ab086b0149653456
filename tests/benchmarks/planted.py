"""Planted faults: one module of a pipeline that is right is broken at a time, and the verdict has to name it.

The clean pipeline sees what is annotated, with scores of .80 to .95 (`PlantedDetector`), and scores relations as the
source does. A fault breaks one thing for one expression:

OPM-TARGET   the acceptable targets are dropped (absent), get .1 where .3 is the least (threshold), fall behind K
             mistaken objects (rank), or have boxes shifted by half their width (localisation)
OPM-REF      the same for the acceptable references
LIFT         masks run into what lies beside the things (leak), or half of the things are lifted to places off by a
             metre or so (shift)
SRM          half of all pairs, those that lie in some way to each other, have the opposite probabilities (opposite)
OPM-CONF     the right things score .30, and four other objects are taken for the target or for the reference with .97
PRM          the relation weighs .005 instead of 1 (weights), or the acceptable targets score .01 and the others of
             their class .99, so that confidences overrule it (scores)
PARSE        other words: the two names swapped (swapped), the opposite relation (relation), no relation (unreadable)
LABEL        another acceptable target is the labelled one (another); the labelled object is confused with one that is
             not acceptable (wrong), or its box is off (box), and a person marked it; the expression lists only one that
             is not acceptable by the labels' own relations, and nobody marked it (listed)

A fault causes a failure where the clean pipeline answers with the labelled target and the broken one does not answer
with an acceptable target; a fault of the label where it does not answer with the labelled one. (An answer that moves
from one acceptable target to another is no failure of a module: the sentence is ambiguous.)
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from pipeline.answering.batch import FrameAnswers
from pipeline.answering.objects import PreparedFrame, prepare_frame
from pipeline.answering.pipeline import Pipeline
from pipeline.diagnosis.decision import diagnose
from pipeline.diagnosis.frame_evidence import FrameEvidence
from pipeline.diagnosis.verdict import Diagnosis
from pipeline.evaluation.records import record
from pipeline.evaluation.systems import class_names_of
from pipeline.geometry.boxes import iou_2d
from pipeline.geometry.frame import Frame
from pipeline.labels.cases import Case, FrameCases, read_cases, read_query
from pipeline.labels.reading import Labels
from pipeline.language.relation_names import INVERSE, PHRASE
from pipeline.proposals.annotations import AnnotationDetector
from pipeline.proposals.base import Proposals
from pipeline.relations.relations import U

from .planted_parts import (
    PlantedDetector,
    ShiftedContext,
    WrongScorer,
    dropped,
    false_positives,
    leaking,
    moved_boxes,
    rescored,
    share,
)

KINDS: dict[str, tuple[str, ...]] = {
    "OPM-TARGET": ("absent", "threshold", "rank", "localisation"),
    "OPM-REF": ("absent", "threshold", "rank", "localisation"),
    "LIFT": ("leak", "shift"),
    "SRM": ("opposite",),
    "OPM-CONF": ("target", "reference"),
    "PRM": ("weights", "scores"),
    "PARSE": ("swapped", "relation", "unreadable"),
    "LABEL": ("another", "wrong", "box", "listed"),
}
"""Verdict that must name the fault -> the ways in which it is planted."""
LOW, LEAST, CONFIDENT = 0.1, 0.3, 0.97
BADLY_PLACED = 0.5
"""A box shifted by so many of its widths overlaps itself by a third."""
MISTAKEN = 4
OVERRULED_WEIGHT = 0.005
OVERRULED, OVERRULING = 0.01, 0.99
SHIFT_M = 1.0
AWAY_IOU = 0.3
"""A mistaken object overlaps the right ones at most this much."""


@dataclass(frozen=True)
class Planted:
    """A pipeline and a label with one fault, for one expression."""

    source: Pipeline
    context: PreparedFrame
    truth: FrameCases
    case: Case
    mark: str | None = None


@dataclass(frozen=True)
class Outcome:
    """A fault that caused a failure.

    Attributes
    ----------
    module, kind : str
        As in KINDS.
    frame, id : str
        The expression.
    verdict : str
    detail : str or None
    """

    module: str
    kind: str
    frame: str
    id: str
    verdict: str
    detail: str | None


def clean_source(source: Pipeline, seed: int = 0) -> Pipeline:
    """The source with a detector that is right."""
    truth = AnnotationDetector(source.dataset.class_names, source.synonyms)
    return replace(source, detector=PlantedDetector(truth, seed), open_unfiltered=None)


def plant(
    module: str, kind: str, source: Pipeline, context: PreparedFrame, truth: FrameCases, case: Case, seed: int = 0
) -> Planted | None:
    """Break one module for one expression; None where this expression leaves nothing to break in that way.

    Parameters
    ----------
    module, kind : str
        As in KINDS.
    source : Pipeline
        A clean one.
    context, truth, case
        The frame and the expression.
    seed : int
    """
    if module in ("OPM-TARGET", "OPM-REF"):
        return _missing(module, kind, source, context, truth, case)
    if module == "LIFT":
        return _misplaced(kind, source, context, truth, case, seed)
    if module == "SRM":
        return Planted(replace(source, scorer=WrongScorer(source.scorer, seed)), context, truth, case)
    if module == "OPM-CONF":
        return _mistaken(kind, source, context, truth, case, seed)
    if module == "PRM":
        if kind == "weights":
            rank = replace(source.config.rank, relation_weight=OVERRULED_WEIGHT)
            return Planted(replace(source, config=replace(source.config, rank=rank)), context, truth, case)
        edit = rescored(truth.numbers[case.acceptable], OVERRULED, OVERRULING)
        return Planted(_edited(source, {case.target: edit}), context, truth, case)
    if module == "PARSE":
        return _misread(kind, source, context, truth, case)
    return _mislabelled(kind, source, context, truth, case, seed)


def judge(planted: Planted, class_names: Sequence[str]) -> tuple[dict[str, Any], Diagnosis]:
    """The record of the expression, without the columns of the diagnosis, and the diagnosis."""
    case, truth = planted.case, planted.truth
    names = tuple(dict.fromkeys((case.target, case.reference)))
    answers = FrameAnswers(planted.source, planted.context, names, (case.relation,))
    evidence = FrameEvidence(truth, answers, cases=(case,))
    row = record(case, truth, answers, read_query(case, class_names), evidence.overlap)
    return row, diagnose(evidence, case, parse_ok=row["parse_ok"], mark=planted.mark)


def planted_failures(
    source: Pipeline,
    labels: Labels,
    *,
    kinds: dict[str, tuple[str, ...]] | None = None,
    seed: int = 0,
    stop: int | None = None,
    every: int = 1,
) -> Iterator[Outcome]:
    """Plant every fault in every expression, and give those that cause a failure.

    Parameters
    ----------
    source : Pipeline
        Gives the dataset, the relation scorer and the configuration; its detector is not used.
    labels : Labels
        Of that dataset, from its annotations.
    kinds : dict, optional
        All of KINDS by default.
    seed : int
    stop : int, optional
        Frames from this index on are left out.
    every : int
        Only each so-manieth expression of a frame.
    """
    clean = clean_source(source, seed)
    class_names = class_names_of(labels)
    for truth in read_cases(labels, 0, 2**31 - 1 if stop is None else stop):
        context = prepare_frame(clean.dataset, clean.dataset.load(truth.frame), clean.config.lift)
        for case in truth.cases[::every]:
            row, _ = judge(Planted(clean, context, truth, case), class_names)
            if not row["correct"]:
                continue
            for module, ways in (KINDS if kinds is None else kinds).items():
                for kind in ways:
                    planted = plant(module, kind, clean, context, truth, case, seed)
                    if planted is None:
                        continue
                    row, diagnosis = judge(planted, class_names)
                    if not row["correct"] and (module == "LABEL" or not row["set_correct"]):
                        yield Outcome(module, kind, truth.frame, case.id, diagnosis.verdict, diagnosis.detail)


def confusion(outcomes: Iterable[Outcome]) -> dict[tuple[str, str], Counter[str]]:
    """(module, kind) -> how often each verdict was given."""
    found: dict[tuple[str, str], Counter[str]] = {}
    for o in outcomes:
        found.setdefault((o.module, o.kind), Counter())[o.verdict] += 1
    return found


_NameEdit = Callable[[Frame, Proposals], Proposals]


def _edited(source: Pipeline, edits: dict[str, _NameEdit], *, key: str = "", least: float = 0.0) -> Pipeline:
    """The source with the detections of some names edited."""

    def edit(frame: Frame, name: str, found: Proposals) -> Proposals:
        return edits[name](frame, found) if name in edits else found

    detector = source.needed_detector()
    assert isinstance(detector, PlantedDetector)
    broken = replace(detector, edit=edit, key=key, min_score=least)
    return replace(source, detector=broken, open_unfiltered=lambda: replace(broken, min_score=0.0))


def _both(first: _NameEdit, second: _NameEdit) -> _NameEdit:
    return lambda frame, found: second(frame, first(frame, found))


def _others(truth: FrameCases, right: np.ndarray, name_object: int, seed: int, *key: object) -> np.ndarray:
    """Numbers of objects of other classes, away from the right ones ((K,) places), in an order of chance."""
    apart = iou_2d(truth.boxes, truth.boxes[right]).max(axis=1, initial=0.0) <= AWAY_IOU
    found = truth.numbers[apart & ~truth.alike[name_object]]
    return np.array(sorted(found.tolist(), key=lambda n: share(seed, truth.frame, *key, n)), np.int64)


def _missing(
    module: str, kind: str, source: Pipeline, context: PreparedFrame, truth: FrameCases, case: Case
) -> Planted | None:
    pairs = truth.acceptable_pairs(case)
    name, example = (
        (case.target, case.target_object) if module == "OPM-TARGET" else (case.reference, case.reference_object)
    )
    right = case.acceptable if module == "OPM-TARGET" else np.flatnonzero(pairs.any(axis=0))
    if module == "OPM-REF" and truth.alike[case.target_object, case.reference_object]:
        # Without the references the targets would be missing too.
        return None
    ids, least = truth.numbers[right], 0.0
    if kind == "absent":
        edit = dropped(ids)
    elif kind == "threshold":
        edit, least = rescored(ids, LOW), LEAST
    elif kind == "localisation":
        edit = moved_boxes(ids, BADLY_PLACED)
    else:
        wrong = _others(truth, right, example, 0, "rank")
        edit = _both(rescored(ids, LOW), false_positives(wrong, CONFIDENT))
    broken = _edited(source, {name: edit}, least=least)
    return Planted(broken, context, truth, case)


def _misplaced(
    kind: str, source: Pipeline, context: PreparedFrame, truth: FrameCases, case: Case, seed: int
) -> Planted:
    asked = truth.alike[case.target_object] | truth.alike[case.reference_object]
    ids = truth.numbers[asked]
    if kind == "leak":
        edit = leaking(ids, seed)
        return Planted(
            _edited(source, {case.target: edit, case.reference: edit}, key=f"leak:{seed}"), context, truth, case
        )
    rng = np.random.default_rng([seed, truth.frame_index, 43])
    moved = rng.normal(0, SHIFT_M, (len(truth.numbers), 3))
    off = rng.random(len(truth.numbers)) < 0.5
    chosen = {int(n): v for n, v, o in zip(truth.numbers, moved, off, strict=True) if o and n in ids}
    return Planted(source, ShiftedContext(context, chosen), truth, case)


def _mistaken(
    kind: str, source: Pipeline, context: PreparedFrame, truth: FrameCases, case: Case, seed: int
) -> Planted | None:
    if truth.alike[case.target_object, case.reference_object]:
        return None
    pairs = truth.acceptable_pairs(case)
    name, example, right = (
        (case.target, case.target_object, case.acceptable)
        if kind == "target"
        else (case.reference, case.reference_object, np.flatnonzero(pairs.any(axis=0)))
    )
    wrong = _others(truth, right, example, seed, case.id)[:MISTAKEN]
    edit = _both(rescored((), 0.0, 0.30), false_positives(wrong, CONFIDENT))
    return Planted(_edited(source, {name: edit}), context, truth, case)


def _misread(kind: str, source: Pipeline, context: PreparedFrame, truth: FrameCases, case: Case) -> Planted | None:
    target, relation, reference = case.target, case.relation, case.reference
    if kind == "swapped":
        if target == reference:
            return None
        text = f"{reference} {PHRASE[relation]} the {target}"
    elif kind == "relation":
        if relation not in INVERSE:
            return None
        text = f"{target} {PHRASE[INVERSE[relation]]} the {reference}"
    else:
        text = f"{target} {reference}"
    return Planted(source, context, truth, replace(case, text=text))


def _mislabelled(
    kind: str, source: Pipeline, context: PreparedFrame, truth: FrameCases, case: Case, seed: int
) -> Planted | None:
    k = case.target_object
    if kind == "another":
        others = case.acceptable[case.acceptable != k]
        if not len(others):
            return None
        other = min(others.tolist(), key=lambda o: share(seed, truth.frame, case.id, o))
        return Planted(source, context, truth, replace(case, target_object=int(other)))
    if kind in ("wrong", "listed"):
        others = np.flatnonzero(truth.alike[k] & ~np.isin(np.arange(len(truth.labels)), case.acceptable))
        if not len(others):
            return None
        other = min(others.tolist(), key=lambda o: share(seed, truth.frame, case.id, o))
        if kind == "listed":
            only = np.array([other])
            listed = replace(case, target_object=int(other), strict=only, acceptable=only)
            return Planted(source, context, truth, listed)
        states = truth.states[case.relation].copy()
        states[[k, other]] = states[[other, k]]
        truth = replace(truth, states={**truth.states, case.relation: states})
        right = np.flatnonzero(truth.acceptable_pairs(case).any(axis=1))
        states_of = states[right].max(axis=1)
        case = replace(case, target_object=int(other), acceptable=right, strict=right[states_of > U])
        return Planted(source, context, truth, case, "BAD_LABEL")
    boxes = truth.boxes.copy()
    width = boxes[k, 2] - boxes[k, 0]
    boxes[k, [0, 2]] += width * (1 if boxes[k, 0] < context.frame.width / 2 else -1)
    return Planted(source, context, replace(truth, boxes=boxes), case, "BAD_BOX")
