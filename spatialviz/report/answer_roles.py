"""Which object plays which role in an answer and in the truth."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pipeline.answering.objects import SceneObject
from pipeline.diagnosis.asking import JudgedAnswer
from pipeline.geometry.boxes import Box3D
from pipeline.geometry.palette import Role


@dataclass(frozen=True)
class AnswerRoles:
    """The roles of one answer.

    Attributes
    ----------
    objects : tuple of SceneObject
        As detected.
    target, reference : int or None
        Places of the answer's objects.
    roles : dict of int to Role
        Place -> target or reference, for the answer's objects.
    right : (int, int) or None
        Places of the best right pair among the detections.
    labelled : dict of int to int
        Place -> the labelled object that it is.
    true_boxes : tuple of (str, Box3D)
        Label and box of the labelled target and reference, where they are known.
    true_places : tuple of int
        Which labelled objects those are.
    true_masks : tuple of (str, Role, (H, W) bool)
        Label, role and pixels of the same.
    exact : bool
        The detections are the dataset's own.
    """

    objects: tuple[SceneObject, ...]
    target: int | None
    reference: int | None
    roles: dict[int, Role]
    right: tuple[int, int] | None
    labelled: dict[int, int]
    true_boxes: tuple[tuple[str, Box3D], ...]
    true_places: tuple[int, ...]
    true_masks: tuple[tuple[str, Role, np.ndarray], ...]
    exact: bool

    def name(self, place: int) -> str:
        """An object as the tables call it."""
        entry = self.objects[place]
        return f"{entry.label}·{entry.id if self.exact else place}"


def answer_roles(answered: JudgedAnswer) -> AnswerRoles:
    """The roles of an answer."""
    trace, judged = answered.trace, answered.diagnosis
    objects: tuple[SceneObject, ...] = () if trace is None else trace.objects
    target = reference = None
    roles: dict[int, Role] = {}
    if trace is not None and trace.ranking is not None and trace.ranking.pairs:
        best = trace.ranking.pairs[0]
        target, reference = best.target, best.reference
        for other in (best.second_reference, reference):
            if other is not None:
                roles[other] = "reference"
        roles[target] = "target"
    right = None
    labelled: dict[int, int] = {}
    boxes: list[tuple[str, Box3D]] = []
    places: list[int] = []
    masks: list[tuple[str, Role, np.ndarray]] = []
    if judged is not None:
        evidence, case = judged.evidence, judged.case
        # Another parse than the gold triple is judged by detections of its own.
        if evidence.answers.objects is objects:
            pair = judged.right
            right = None if pair is None or pair.reference is None else (pair.target, pair.reference)
            labelled = {place: int(k) for place, k in enumerate(evidence.match) if k >= 0}
        ends: tuple[tuple[Role, int], ...] = (("target", case.target_object), ("reference", case.reference_object))
        for role, k in ends:
            entry = evidence.objects.get(k, points=True)
            if entry is None:
                continue
            masks.append((judged.truth.labels[k], role, entry.mask))
            if entry.lifted.box is not None:
                boxes.append((judged.truth.labels[k], entry.lifted.box))
                places.append(k)
    return AnswerRoles(
        objects, target, reference, roles, right, labelled, tuple(boxes), tuple(places), tuple(masks),
        trace is not None and trace.exact,
    )  # fmt: skip
