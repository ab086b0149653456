"""Fitted model of a relation scorer that cannot be asked again, from the pairs of its file.

Where the truth takes the place of a box, somebody has to say what the scorer would have said. For each relation that
the file has enough pairs of, their probabilities are fitted by where the one box lies from the other, as the viewer
sees it; where the fit decides nearly all pairs as they are, it stands in. Else the rule does.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from pipeline.answering.coordinate_conventions import try_box
from pipeline.answering.fitted_ranking import fitted
from pipeline.answering.objects import prepare_frame
from pipeline.answering.predictions import Predictions
from pipeline.datasets.base import Dataset
from pipeline.geometry.boxes import Box3D
from pipeline.geometry.lifting import LiftedObject
from pipeline.geometry.viewer import ViewerAxes
from pipeline.language.relation_names import PAIRWISE
from pipeline.relations.features import Appearance
from pipeline.relations.scorer import RelationScores, RuleScorer

LEAST_PAIRS, MOST_PAIRS = 60, 4000
DECIDED_ALIKE = 0.7
"""A fit stands in that decides at least this share of the file's pairs as they are; the others may be wrong themselves,
in every line of a file whose scorer is broken."""
LOOKED_AT = 24
"""Frames whose pairs are fitted to, spread evenly."""
_SURE = 0.99


def described(boxes: Sequence[Box3D], viewer: ViewerAxes) -> np.ndarray:
    """(N, N, K) float64: position of each box relative to each other along the viewer's axes.

    In metres, in their own extents, by how they look from the camera and how far from it, in which direction, how far
    aside of each axis, and how far apart. Bounded measures saturate: far to the left is not more to the left.
    """
    center = np.array([box.center for box in boxes]).reshape(-1, 3) @ viewer.matrix.T
    half = np.array([np.abs(viewer.matrix @ box.R) @ box.size / 2 for box in boxes]).reshape(-1, 3)
    seen = np.array([box.center / max(float(box.center[2]), 0.1) for box in boxes]).reshape(-1, 3)[:, :2]
    away = np.log([max(float(np.linalg.norm(box.center)), 0.1) for box in boxes]).reshape(-1)
    apart, reach, bearing = center[:, None] - center[None], half[:, None] + half[None], seen[:, None] - seen[None]
    gap = np.abs(apart) - reach
    far = np.linalg.norm(apart, axis=2, keepdims=True)
    aside = np.sqrt(np.maximum(far**2 - apart**2, 0))
    inside = reach + 0.05
    most = np.tanh(apart / inside), np.sign(apart) * np.tanh((np.abs(apart) - aside / 2) / inside)
    return np.concatenate(
        [
            apart,
            apart / inside,
            bearing,
            gap,
            np.maximum(gap, 0),
            np.ones_like(far),
            apart / np.maximum(far, 1e-6),
            far,
            aside,
            aside / inside,
            *most,
            (away[:, None] - away)[..., None],
        ],
        axis=2,
    )


@dataclass(frozen=True, eq=False)
class FittedScorer:
    """Rule scorer, replaced by the fit of the file where reliable."""

    predictions: Predictions
    dataset: Dataset = field(repr=False)
    kept: dict[str, np.ndarray | None] | None = None
    """What the whole file showed, where it is not at hand."""

    name = "rule"

    @cached_property
    def weights(self) -> dict[str, np.ndarray | None]:
        """(K,) float64 by relation: weights of `described` for the log odds; None where nothing explains its pairs."""
        if self.kept is not None:
            return self.kept
        predictions, rows = self.predictions, dict[str, list[tuple[np.ndarray, float]]]()
        frames = list(dict.fromkeys(line.frame for line in predictions.lines.values()))
        chosen = np.unique(np.linspace(0, len(frames) - 1, min(LOOKED_AT, len(frames))).astype(int))
        for frame_id in (frames[int(k)] for k in chosen):
            frame, lines = self.dataset.load(frame_id), predictions.of_frame(frame_id)
            ids = dict.fromkeys(i for line in lines for i in line.objects)
            given = ((i, predictions.box_of(frame_id, i)) for i in ids)
            tried = ((i, None if b is None else try_box(b, predictions.header, frame.camera, False)) for i, b in given)
            boxes = {i: box for i, box in tried if box is not None}
            index = {i: k for k, i in enumerate(boxes)}
            away = described(list(boxes.values()), prepare_frame(self.dataset, frame).viewer)
            for line in lines:
                for relation, pairs in (line.relations or {}).items():
                    known = [r for r in pairs if len(r) == 3 and r[0] in boxes and r[1] in boxes and r[0] != r[1]]
                    rows.setdefault(relation, []).extend((away[index[a], index[b]], p) for a, b, p in known)
        return {relation: _weights(samples) for relation, samples in rows.items() if len(samples) >= LEAST_PAIRS}

    def follows(self, relation: str) -> bool:
        """True unless many pairs show independence of probabilities and boxes."""
        return self.weights.get(relation, ()) is not None

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
        away = described([o.box for o in objects if o.box is not None], viewer)
        others = ~np.eye(len(boxed), dtype=np.bool_)
        for r, relation in enumerate(found.relations):
            if (weights := self.weights.get(relation)) is not None:
                # Cases of before were kept with the first columns only.
                fitted = np.clip(1 / (1 + np.exp(-away[..., : len(weights)] @ weights)), 1 - _SURE, _SURE)
                here = probabilities[boxed[:, None], boxed, r]
                probabilities[boxed[:, None], boxed, r] = np.where(others, fitted, here)
        return replace(found, probabilities=probabilities)


def _weights(samples: Sequence[tuple[np.ndarray, float]]) -> np.ndarray | None:
    """Fit the pairs of a relation; None without a fit.

    A pair whose probability is wrong says the opposite of all others, and the second fit leaves it out.
    """
    chosen = np.unique(np.linspace(0, len(samples) - 1, min(MOST_PAIRS, len(samples))).astype(int))
    x, p = (np.array([samples[k][part] for k in chosen]) for part in (0, 1))
    alike = (x @ fitted(x, p) > 0) == (p > 0.5)
    return fitted(x[alike], p[alike]) if alike.mean() >= DECIDED_ALIKE else None
