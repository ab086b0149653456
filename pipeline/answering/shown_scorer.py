"""A relation scorer that cannot be asked again, as far as the pairs of its file show what it goes by.

Where the truth takes the place of a box, somebody has to say what the scorer would have said. For each relation that
the file has enough pairs of, their probabilities are fitted by where the one box lies from the other; where the fit
decides nearly all pairs as they are, it stands in. Else the rule does.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace

import numpy as np

from pipeline.answering.placing import try_box
from pipeline.answering.predictions import Predictions
from pipeline.geometry.boxes import Box3D
from pipeline.geometry.lifting import LiftedObject
from pipeline.geometry.viewer import ViewerAxes
from pipeline.language.relation_names import PAIRWISE
from pipeline.relations.features import Appearance
from pipeline.relations.scorer import RelationScores, RuleScorer

LEAST_PAIRS = 60
DECIDED_ALIKE = 0.85
"""A fit stands in that decides at least this share of the file's pairs as they are; some may be wrong themselves."""
_STEEPEST = 4.0


def described(boxes: Sequence[Box3D]) -> np.ndarray:
    """(N, N, 11) float64: where each box lies from each other, camera frame, metres."""
    center, half = (np.array([v(b) for b in boxes]).reshape(-1, 3) for v in (lambda b: b.center, _half))
    apart = center[:, None] - center[None]
    away = np.linalg.norm(apart, axis=2, keepdims=True)
    return np.concatenate([apart, np.abs(apart), half[:, None] + half[None], away, np.ones_like(away)], axis=2)


def _half(box: Box3D) -> np.ndarray:
    """(3,): how far it reaches from its centre along the axes of its frame."""
    return np.abs(box.R) @ box.size / 2


@dataclass(frozen=True)
class ShownScorer:
    """The rule, and in its place what the file shows.

    Attributes
    ----------
    weights : dict of str to (11,) float64
        By relation: of `described`, giving the log odds.
    """

    weights: dict[str, np.ndarray]

    name = "rule"

    @staticmethod
    def of(predictions: Predictions) -> ShownScorer:
        """What the pairs of a file show; boxes in the world show nothing, for their frames are not at hand."""
        header = predictions.header
        rows: dict[str, list[tuple[np.ndarray, float]]] = {}
        for line in predictions.lines.values() if header.coordinates != "world" else ():
            given = ((i, predictions.box_of(line.frame, i)) for i in line.objects)
            tried = ((i, None if box is None else try_box(box, header, None, False)) for i, box in given)
            boxes = {i: box for i, box in tried if box is not None}
            index, away = {i: k for k, i in enumerate(boxes)}, described(list(boxes.values()))
            for relation, pairs in (line.relations or {}).items():
                known = [r for r in pairs if len(r) == 3 and r[0] in boxes and r[1] in boxes and r[0] != r[1]]
                rows.setdefault(relation, []).extend((away[index[a], index[b]], p) for a, b, p in known)
        found = {}
        for relation, samples in rows.items():
            if len(samples) >= LEAST_PAIRS:
                x, p = np.array([s[0] for s in samples]), np.array([s[1] for s in samples])
                weights = fitted(x, p)
                if ((x @ weights > 0) == (p > 0.5)).mean() >= DECIDED_ALIKE:
                    found[relation] = weights
        return ShownScorer(found)

    def score(
        self,
        objects: Sequence[LiftedObject],
        viewer: ViewerAxes,
        appearance: Appearance | None = None,
        relations: Collection[str] = PAIRWISE,
    ) -> RelationScores:
        found = RuleScorer().score(objects, viewer, appearance, relations)
        probabilities = found.probabilities.copy()
        boxed = np.array([k for k, o in enumerate(objects) if o.box is not None], np.int64)
        away = described([o.box for o in objects if o.box is not None])
        others = ~np.eye(len(boxed), dtype=np.bool_)
        for r, relation in enumerate(found.relations):
            if relation in self.weights:
                odds = np.clip(away @ self.weights[relation], -_STEEPEST, _STEEPEST)
                here = probabilities[boxed[:, None], boxed, r]
                probabilities[boxed[:, None], boxed, r] = np.where(others, 1 / (1 + np.exp(-odds)), here)
        return replace(found, probabilities=probabilities)


def fitted(x: np.ndarray, p: np.ndarray) -> np.ndarray:
    """(K,) float64: weights of x ((N, K)) whose log odds come nearest to those of p ((N,)); twice, without what is odd.

    A pair whose probability is wrong says the opposite of all others, and the second fit leaves it out.
    """
    odds = np.clip(np.log(np.clip(p, 1e-6, 1) / np.clip(1 - p, 1e-6, 1)), -_STEEPEST, _STEEPEST)
    kept = np.ones(len(p), np.bool_)
    weights = np.zeros(x.shape[1])
    for _ in range(2):
        a = x[kept]
        weights = np.linalg.solve(a.T @ a + 1e-3 * len(a) * np.eye(x.shape[1]), a.T @ odds[kept])
        kept = (x @ weights) * odds > -1.0
    return weights
