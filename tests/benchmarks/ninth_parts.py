"""The parts of `ninth_pipeline`: a program of soft steps over attention, and scores that are standardised and added.

The first runs "filter, relate, filter" as neuro-symbolic programs do. A box is turned about gravity along the principal
axis of the floor plan, around points whose depth is within three deviations of the median. A relation is a fuzzy angle
from the direction, softened near the thing itself. Scores are sigmoids, .05 to .88. Attention on references is their
squared score, in sum one; a target has its score times the relation's expectation under that attention, and a pair has
its target's, times a weak power of what part of the expectation is by its reference.

The second fuses three lists as retrieval does. A box is level, around the largest connected cluster of voxels. A
relation is how many of eight sampled answers say yes. Scores are .3 to .7. Each factor's logarithm, or log odds, is
standardised over the pairs of a line and cut at two and a half deviations; a pair has their weighted sum.

PARTS     attended      fuzzy angles; expectation under attention
          standardised  votes; a weighted sum of z-scores
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import cast

import numpy as np
from scipy import ndimage

from pipeline.answering.predictions import Header
from pipeline.datasets.base import Dataset
from pipeline.geometry.viewer import ViewerAxes
from pipeline.labels.cases import Case, FrameCases

from .other_pipeline import AXES, OtherPipeline, Pair, Thing
from .planted_parts import share
from .seventh_parts import Parts, chance, log_odds, offsets, seventh
from .sixth_parts import Placed, Told

NAMES = ("attended", "standardised")
VOTES = 8
WEIGHTS = np.array([0.7, 0.5, 1.0])
"""Of target, reference and relation in the weighted sum."""


def about_gravity(points: np.ndarray, viewer: ViewerAxes, name: str) -> Placed:
    """Along up and the principal axes of the floor plan, between percentiles of what is not far in depth."""
    off = np.abs(points[:, 2] - np.median(points[:, 2]))
    level = points[off <= 3 * 1.4826 * np.median(off) + 0.01] @ viewer.matrix.T
    long = np.linalg.eigh(np.cov(level[:, [0, 2]].T))[1][:, 1]
    axes = np.array([[long[0], 0, -long[1]], [0, 1, 0], [long[1], 0, long[0]]])
    lo, hi = np.percentile(level @ axes, [2, 98], axis=0)
    R = viewer.matrix.T @ axes
    return R @ ((lo + hi) / 2), np.maximum(hi - lo, 0.01), R


def connected(points: np.ndarray) -> np.ndarray:
    """The points in the largest cluster of touching voxels, which are larger farther away."""
    edge = 0.02 + 0.015 * float(np.median(points[:, 2]))
    # What is very far from the rest is no cluster, and would make the grid large.
    cells = np.clip(np.floor((points - np.median(points, axis=0)) / edge), -32, 32).astype(int) + 32
    grid = np.zeros((65,) * 3, bool)
    grid[tuple(cells.T)] = True
    numbers, _ = cast("tuple[np.ndarray, int]", ndimage.label(grid, np.ones((3, 3, 3))))
    of = numbers[tuple(cells.T)]
    return points[of == np.bincount(of).argmax()]


def clustered(points: np.ndarray, viewer: ViewerAxes, name: str) -> Placed:
    """Along the viewer's level axes, around the largest cluster."""
    R = viewer.R_level_camera
    kept = connected(points) @ R.T
    lo, hi = np.percentile(kept, [1, 99], axis=0)
    return R.T @ ((lo + hi) / 2), np.maximum(hi - lo, 0.01), R.T


def by_angle(relation: str, a: Thing, b: Thing, viewer: ViewerAxes, least: float, sharp: float) -> float:
    """The angle of a - b from the relation's direction, against 55 degrees; unsure within the boxes' reach."""
    between, along, both = offsets(relation, a, b, viewer)
    along -= least
    aside = float(np.linalg.norm(np.delete(between, AXES[relation][0])))
    angle = float(np.arctan2(aside, along))
    clear = float(np.tanh(np.hypot(along, aside) / (0.03 + 0.5 * both)))
    q = share(relation, *a.box, *b.box)
    return chance(sharp * (clear * 4.0 * (0.96 - angle) + 0.5 * float(np.log(q / (1 - q)))))


def by_votes(relation: str, a: Thing, b: Thing, viewer: ViewerAxes, least: float, sharp: float) -> float:
    """How many of eight samples say yes; each has noise of its own."""
    between, along, both = offsets(relation, a, b, viewer)
    aside = float(np.linalg.norm(np.delete(between, AXES[relation][0])))
    odds = 1.5 * (along - least - 0.4 * aside - 0.1 * both) / (0.04 + 0.3 * both)
    draws = np.array([share(relation, *a.box, *b.box, k) for k in range(VOTES)])
    yes = int((sharp * odds + log_odds(draws) > 0).sum())
    return round((yes + 0.5) / (VOTES + 1), 4)


def attended(factors: np.ndarray, pairs: Sequence[Pair]) -> np.ndarray:
    t, r, p = factors[:, :3].T
    refs = {b: x * x for (_, b), x in zip(pairs, r.tolist(), strict=True)}
    by = r * r / sum(refs.values()) * p
    expected: dict[int, float] = {}
    for (a, _), x in zip(pairs, by.tolist(), strict=True):
        expected[a] = expected.get(a, 0.0) + x
    of = np.array([expected[a] for a, _ in pairs])
    return t * of * (by / of) ** 0.25


def standardised(factors: np.ndarray, pairs: Sequence[Pair]) -> np.ndarray:
    x = np.column_stack([np.log(np.clip(factors[:, :2], 1e-4, 1)), log_odds(factors[:, 2])])
    return np.clip((x - x.mean(axis=0)) / np.maximum(x.std(axis=0), 0.05), -2.5, 2.5) @ WEIGHTS


def parts_of(name: str) -> Parts:
    if name == NAMES[0]:
        header = Header(1, "soft program, attention", "xyxy", "shares", "camera_opencv", "m", "pair_scores")
        return Parts(header, True, lambda u: round(1 / (1 + np.exp(3 - 5 * u)), 4), about_gravity, by_angle, attended)
    header = Header(1, "votes, standardised sum", "cxcywh", "pixels", "camera_opengl", "cm", "pair_scores")
    return Parts(header, False, lambda u: round(0.3 + 0.4 * u, 4), clustered, by_votes, standardised)


def asked(own: Parts, case: Case, truth: FrameCases, known: dict[int, Thing], rng: np.random.Generator) -> Told:
    """The things of each name, of which one in 20 is missed, and two to six others, a little less surely."""

    def scored(example: int) -> dict[int, float]:
        ids = set(truth.numbers[truth.alike[example]].tolist())
        found = {i: own.sure(rng.uniform(0.35, 1)) for i in known if i in ids and rng.random() > 1 / 20}
        false = rng.permutation([i for i in known if i not in ids])[: rng.integers(2, 7)].tolist()
        return dict(sorted((found | {int(i): own.sure(rng.uniform(0, 0.7)) for i in false}).items()))

    return Told(case, scored(case.target_object), scored(case.reference_object))


def ninth(parts: Parts, dataset: Dataset) -> OtherPipeline:
    """One of them; what can be broken in it is asked of `ninth_pipeline` itself."""
    return replace(seventh(parts, dataset), asked=lambda *given: asked(parts, *given))
