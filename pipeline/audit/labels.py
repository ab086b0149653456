"""Auditing the expressions of labels: what the review queue holds against what they rest on, own sides, and systems."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from pipeline.audit.geometry import by_own_sides, fit_of_triple, geometry_evidence, has_front
from pipeline.audit.sentences import object_names
from pipeline.audit.suspicion import AuditItem, Evidence
from pipeline.audit.systems import SystemAnswers, system_evidence
from pipeline.corrections.review.doubts import DoubtConfig
from pipeline.corrections.review.queue import review_queue
from pipeline.labels.cases import Case, FrameCases, read_cases
from pipeline.labels.reading import Labels
from pipeline.language.relation_names import HORIZONTAL
from pipeline.system.arrow import pa

OF_OBJECTS = 0.5
"""What is held against an object's mask or box counts by so much against a sentence about it."""
UNREAD, UNREAD_WEIGHT = "expression/unreadable", 0.1
"""That the grammar does not read a sentence says little of its truth."""
Reasons = dict[tuple[str, ...], tuple[float, str]]
"""The score and the strongest reason of what the queue doubts, by frame and what names it there."""


def audit_labels(
    labels: Labels,
    systems: Sequence[SystemAnswers] = (),
    doubts: DoubtConfig | None = None,
) -> Iterator[AuditItem]:
    """Audit every expression of labels, in the order of frames.

    `systems`: of runs on these labels. `doubts`: of the networks that the review queue asks; None: none.

    Raises InputError: the labels are damaged.
    """
    reasons = _reasons(review_queue(labels, doubts))
    for truth in read_cases(labels, 0, np.iinfo(np.int32).max):
        own, names = by_own_sides(truth), object_names(truth)
        for case in truth.cases:
            yield _audited(case, truth, own, names, reasons, systems)


def _reasons(queue: pa.Table) -> Reasons:
    found: Reasons = {}
    for row in queue.to_pylist():
        if not row["reasons"]:
            continue
        frame, kind = row["frame"], row["kind"]
        key = {
            "relation": (frame, "relation", str(row["a"]), str(row["b"]), row["relation"]),
            "object": (frame, "object", str(row["a"])),
            "expression": (frame, "expression", row["expression"]),
        }[kind]
        reason = row["reasons"][0]
        weight = UNREAD_WEIGHT if reason.startswith(UNREAD) else row["score"] * (OF_OBJECTS if kind == "object" else 1)
        found[key] = weight, reason
    return found


def _audited(
    case: Case,
    truth: FrameCases,
    own: dict[str, FrameCases],
    names: list[str],
    doubts: Reasons,
    systems: Sequence[SystemAnswers],
) -> AuditItem:
    a, b = (str(truth.numbers[k]) for k in (case.target_object, case.reference_object))
    rests_on = (
        ("relation", a, b, case.relation),
        ("object", a),
        ("object", b),
        ("expression", case.id),
    )
    evidence = [Evidence("review", *doubts[(truth.frame, *key)]) for key in rests_on if (truth.frame, *key) in doubts]
    if case.relation in HORIZONTAL and has_front(case.reference) and len(case.strict):
        evidence += _frame_of_reference(case, truth, own, names)
    seems = None
    if systems:
        told = system_evidence(
            systems, (truth.frame, case.id), truth.boxes[case.acceptable], list(zip(names, truth.boxes, strict=True))
        )
        if told is not None:
            evidence.append(told[0])
            seems = told[1]
    said = ", ".join(names[k] for k in case.acceptable)
    return AuditItem(case.id, truth.frame, case.text, said, seems, tuple(evidence))


def _frame_of_reference(case: Case, truth: FrameCases, own: dict[str, FrameCases], names: list[str]) -> list[Evidence]:
    ends = truth.alike[case.target_object], truth.alike[case.reference_object]
    fits = {way: fit_of_triple(one, ends[0], case.relation, ends[1]) for way, one in own.items()}
    fit = fit_of_triple(truth, ends[0], case.relation, ends[1])
    words = case.target, case.relation, case.reference
    return [e for e in geometry_evidence(fit, case.strict, fits, False, words, names) if e.kind == "frame"]
