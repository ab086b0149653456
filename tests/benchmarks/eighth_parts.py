"""The parts of `eighth_pipeline`: one that compares points and matches softly, and one with learnt relation heads.

The first puts a box along the principal axes around the points of a mask, tilted as they are. A relation is the mean,
over all pairs of one sampled point of each thing, of a soft comparison with margin and cone. Scores are objectness
times similarity, .01 to .6 over two decades. A pair's score is a dual softmax: over all references of its target, times
over all targets of its reference.

The second keeps the largest cluster of a thing's depths, and makes a box of the mean and the standard deviations along
the viewer's level axes, as of a Gaussian. A relation is a logistic regression's on boxes in space and in the picture,
one for each relation, trained on the labels of the same dataset. Scores are said in words, .35 to .95 in steps of .05.
Pairs are ranked by the harmonic mean of detection and relation, less with their distance.

PARTS     matched    points, dual softmax
          harmonic   relation heads, harmonic mean with a prior of distance
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from pipeline.answering.predictions import Header
from pipeline.datasets.base import Dataset
from pipeline.geometry.frame import Frame
from pipeline.geometry.viewer import ViewerAxes
from pipeline.labels.cases import FrameCases
from pipeline.relations.relations import F, T

from .fourth_parts import Oriented, points_of
from .other_pipeline import AXES, OtherPipeline, Pair, Thing
from .planted_parts import share
from .seventh_parts import Parts, chance, offsets, seventh
from .sixth_parts import Placed

SAMPLED = 20
NAMES = ("matched", "harmonic")
Heads = Mapping[str, np.ndarray]
"""Relation -> weights (7,) of `features`."""


@dataclass(frozen=True)
class Cloud(Oriented):
    """A thing with some of its points, (N, 3), camera frame, metres."""

    points: np.ndarray = field(default_factory=lambda: np.zeros((0, 3)))


def sampled(points: np.ndarray) -> np.ndarray:
    return points[np.linspace(0, len(points) - 1, SAMPLED).astype(int)]


@dataclass(frozen=True)
class Clouds(Parts):
    """Parts whose things keep points."""

    def lifted(self, t: Thing, points: np.ndarray, viewer: ViewerAxes) -> Oriented | None:
        moved = super().lifted(t, points, viewer)
        return replace(moved, points=sampled(points)) if isinstance(moved, Cloud) else moved


def principal(points: np.ndarray, viewer: ViewerAxes, name: str) -> Placed:
    """Along the principal axes of the points, between percentiles."""
    R = np.linalg.eigh(np.cov(points.T))[1]
    R = R * [1, 1, np.sign(np.linalg.det(R))]
    lo, hi = np.percentile(points @ R, [2, 98], axis=0)
    return R @ ((lo + hi) / 2), np.maximum(hi - lo, 0.01), R


def largest_cluster(points: np.ndarray) -> np.ndarray:
    """Those of the most points between gaps of 5 cm in depth."""
    z = np.sort(points[:, 2])
    starts = np.flatnonzero(np.diff(z, prepend=-np.inf) > 0.05)
    ends = np.append(starts[1:], len(z))
    k = int(np.argmax(ends - starts))
    return points[(points[:, 2] >= z[starts[k]]) & (points[:, 2] <= z[ends[k] - 1])]


def gaussian(points: np.ndarray, viewer: ViewerAxes, name: str) -> Placed:
    R = viewer.R_level_camera
    kept = largest_cluster(points) @ R.T
    # An even spread of a length has this many standard deviations of it.
    return R.T @ kept.mean(axis=0), np.maximum(np.sqrt(12) * kept.std(axis=0), 0.01), R.T


def by_points(relation: str, a: Thing, b: Thing, viewer: ViewerAxes, least: float, sharp: float) -> float:
    assert isinstance(a, Cloud)
    assert isinstance(b, Cloud)
    axis, sign = AXES[relation]
    between = (a.points[:, None] - b.points[None]).reshape(-1, 3) @ viewer.matrix.T
    along = sign * between[:, axis]
    aside = np.sqrt(np.maximum(0, (between**2).sum(axis=1) - along**2))
    odds = sharp * (along - least - 0.02 - 0.5 * aside) / 0.06
    return round(float(0.01 + 0.98 * (1 / (1 + np.exp(-np.clip(odds, -30, 30)))).mean()), 4)


def features(relation: str, a: Thing, b: Thing, viewer: ViewerAxes, least: float = 0.0) -> np.ndarray:
    """(7,): offset, by itself and against the boxes, gap, what is aside, offset in the picture, sizes, and 1."""
    axis, sign = AXES[relation]
    between, along, both = offsets(relation, a, b, viewer)
    along -= least
    aside = float(np.linalg.norm(np.delete(between, axis)))
    (u, v), (w, h) = (np.array(a.box[:2]) - b.box[:2], (np.array(a.box[2:]) + b.box[2:]) / 2)
    # Deeper things are smaller in the picture.
    flat = sign * (u / w, -v / h, float(np.log(np.prod(b.box[2:]) / np.prod(a.box[2:]))))[axis]
    size = float(np.log(a.size.max() / b.size.max()))
    ratio = along / (both + 0.05)
    return np.array([along, np.tanh(ratio), max(0.0, along - both), aside, np.tanh(flat / 2), size, 1.0])


def trained_heads(frames: Sequence[tuple[FrameCases, ViewerAxes, dict[int, Thing]]]) -> Heads:
    """Fitted to what the labels are sure of, by gradients of the logistic loss, with a penalty on weights."""
    heads = {}
    for relation in AXES:
        x, y = [], []
        for truth, viewer, known in frames:
            state = truth.states[relation]
            for i, j in np.argwhere(truth.judged & ((state == T) | (state == F))).tolist():
                a, b = (known.get(int(truth.numbers[k])) for k in (i, j))
                if i != j and a is not None and b is not None:
                    x.append(features(relation, a, b, viewer))
                    y.append(state[i, j] == T)
        inputs, wanted = np.array(x).reshape(-1, 7), np.array(y, np.float64)
        # As many of those that hold as of those that do not.
        weight = np.where(wanted > 0, 0.5 / max(1.0, wanted.sum()), 0.5 / max(1.0, (1 - wanted).sum()))
        w = np.zeros(7)
        for _ in range(600):
            p = 1 / (1 + np.exp(-np.clip(inputs @ w, -30, 30)))
            w -= 1.0 * (inputs.T @ (weight * (p - wanted)) + 0.004 * w)
        heads[relation] = w
    return heads


def by_heads(heads: Heads) -> Callable[[str, Thing, Thing, ViewerAxes, float, float], float]:
    def judge(relation: str, a: Thing, b: Thing, viewer: ViewerAxes, least: float, sharp: float) -> float:
        q = share(relation, *a.box, *b.box)
        odds = features(relation, a, b, viewer, least) @ heads[relation] + 0.3 * np.log(q / (1 - q))
        return chance(sharp * float(odds))

    return judge


def dual_softmax(factors: np.ndarray, pairs: Sequence[Pair], axes: Sequence[int] = (0, 1)) -> np.ndarray:
    """(P,) of factors (P, 4); over the candidates of the target's side, of the reference's, or both."""
    kept = np.clip(factors[:, :3], 1e-4, 1)
    power = np.exp(np.log(kept) @ [0.6, 0.6, 1.5])
    sums: list[dict[int, float]] = [{}, {}]
    for pair, x in zip(pairs, power.tolist(), strict=True):
        for k in axes:
            sums[k][pair[k]] = sums[k].get(pair[k], 0.0) + x
    return np.array([np.prod([x / sums[k][pair[k]] for k in axes]) for pair, x in zip(pairs, power, strict=True)])


def harmonic(factors: np.ndarray, pairs: Sequence[Pair]) -> np.ndarray:
    t, r, p, away = factors.T
    detected = np.sqrt(t * r)
    return 2 * detected * p / (detected + p) * np.exp(-away / 8)


def in_words(u: float) -> float:
    return round(round(20 * (0.35 + 0.6 * u)) / 20, 2)


def parts_of(name: str, heads: Heads | None = None) -> Parts:
    """One of them, the second with the weights of its heads, none before they are trained."""
    if name == "matched":
        header = Header(1, "points, dual softmax", "xyxy", "shares", "camera_opencv", "m", "pair_scores")
        return Clouds(header, True, lambda u: round(10 ** (-2 + 1.8 * u), 4), principal, by_points, dual_softmax)
    header = Header(1, "relation heads, harmonic mean", "cxcywh", "pixels", "camera_opengl", "cm", "pair_scores")
    known = heads or {relation: np.zeros(7) for relation in AXES}
    return Parts(header, False, in_words, gaussian, by_heads(known), harmonic)


def eighth(parts: Parts, dataset: Dataset) -> OtherPipeline:
    """One of them; what can be broken in it is asked of `eighth_pipeline` itself."""
    made = seventh(parts, dataset)

    def things(frame: Frame) -> list[Thing]:
        found = [t for t in made.things(frame) if isinstance(t, Oriented)]
        if not isinstance(parts, Clouds):
            return list(found)
        return [Cloud(**vars(t), points=sampled(points_of(frame, t.id))) for t in found]

    return replace(made, things=things)
