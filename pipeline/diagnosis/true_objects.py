"""The labelled objects of a frame in 3D: as their label describes them, or lifted anew where points are needed."""

from __future__ import annotations

import numpy as np

from pipeline.answering.objects import PreparedFrame, SceneObject
from pipeline.geometry.boxes import Box3D
from pipeline.geometry.lifting import LiftedObject, Quality, lift
from pipeline.geometry.masks import decode_run_length
from pipeline.labels.cases import FrameCases
from pipeline.language.relation_names import DIRECTIONAL
from pipeline.proposals.annotations import box_mask
from pipeline.relations.model import OnnxScorer
from pipeline.relations.scorer import RelationScorer, RuleScorer
from pipeline.system.errors import InputError

_POINTED = ("paper30", "canon30")


class TrueObjects:
    """What LIFT and RECALL put in place of detections; each object is made when it is first needed.

    Parameters
    ----------
    truth : FrameCases
    context : PreparedFrame

    Attributes
    ----------
    known : (N,) bool
        Objects whose geometry is known.
    pseudo : (N,) bool
        Those of which the label has a box and no pixels: points are not to be had.
    """

    def __init__(self, truth: FrameCases, context: PreparedFrame) -> None:
        self._truth, self._context = truth, context
        described = np.concatenate([truth.geometry["lo"], truth.geometry["size"]], axis=1)
        self.known: np.ndarray = np.asarray(np.isfinite(described).all(axis=1))
        self.pseudo = self.known & np.array([m is None for m in truth.masks], np.bool_)
        self._described: dict[int, SceneObject] = {}
        self._lifted: dict[int, SceneObject] = {}

    def get(self, k: int, points: bool) -> SceneObject | None:
        """An object, with its points where they are asked for; None where its geometry is not known."""
        if not self.known[k]:
            return None
        if not points or self.pseudo[k]:
            return self._described.setdefault(k, self._described.get(k) or self._describe(k))
        return self._lifted.setdefault(k, self._lifted.get(k) or self._lift(k))

    def _mask(self, k: int) -> np.ndarray:
        """(H, W) bool: the labelled pixels; all of the 2D box where there are none."""
        frame, code = self._context.frame, self._truth.masks[k]
        if code is None:
            return box_mask(self._truth.boxes[k], frame.height, frame.width)
        where = f"labelled object {self._truth.numbers[k]} of frame {frame.id}"
        return decode_run_length((frame.height, frame.width), code, where)

    def _describe(self, k: int) -> SceneObject:
        truth = self._truth
        row = {name: values[k] for name, values in truth.geometry.items()}
        try:
            box = Box3D(row["center"], row["R"].reshape(3, 3), row["size"])
        except InputError:
            box = None
        quality = Quality(int(truth.facts["mask_pixels"][k]), 0, 0.0, 0.0, False, float("nan"), False, "annotation")
        lifted = LiftedObject(np.empty((0, 3), np.float32), box, 1.0, row["lo"], row["hi"], "box", None, quality)
        return self._entry(k, np.zeros((0, 0), np.bool_), lifted)

    def _lift(self, k: int) -> SceneObject:
        context, mask = self._context, self._mask(k)
        (lifted,) = lift(
            context.frame.depth, context.frame.camera, [mask], context.viewer, config=context.config,
            edges=context.edges, boxes=context.boxes,
        )  # fmt: skip
        return self._entry(k, mask, lifted) if np.isfinite(lifted.lo).all() else self._describe(k)

    def _entry(self, k: int, mask: np.ndarray, lifted: LiftedObject) -> SceneObject:
        return SceneObject(-1, self._truth.labels[k], 1.0, self._truth.boxes[k].astype(np.float32), mask, lifted)


def needs_points(scorer: RelationScorer, relation: str) -> bool:
    """Whether a scorer looks at the points of objects for a relation, and not only at their extents."""
    if relation not in DIRECTIONAL:
        return True
    if isinstance(scorer, OnnxScorer):
        return scorer.name.partition("+")[0] in _POINTED
    return not isinstance(scorer, RuleScorer)
