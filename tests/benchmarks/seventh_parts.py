"""The parts of `seventh_pipeline`: one that asks a model yes or no, and one whose scorer of pairs is learnt.

The first cleans the points of a mask by the distances to their neighbours and puts a box along the viewer's level axes
around the rest. A relation is a model's "yes" against its "no", bent towards yes, and noisy. Scores saturate, .37 to
.999. Pairs of the three surest targets come before all others, by the sum of log odds, those of the scores halved.

The second puts a box along the camera's axes between percentiles of the points. A relation is the share of draws, in
which both boxes are shaken, that it holds of. Scores are .05 to .6. A network of six hidden units, trained on what the
pipeline finds in the same pictures by another draw of scores, takes target, reference, relation and the distance of
the two; its softmax over all pairs is their score.

PARTS     shortlist  yes or no; the three surest targets, then log odds
          learnt     shaken boxes; a network over scores, relation and distance
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from typing import cast

import numpy as np
from scipy.spatial import KDTree

from pipeline.answering.placing import box_2d
from pipeline.answering.predictions import Header, Prediction
from pipeline.datasets.base import Dataset
from pipeline.geometry.frame import Frame
from pipeline.geometry.viewer import ViewerAxes
from pipeline.labels.cases import Case, FrameCases

from . import sixth_parts
from .fifth_parts import factors_of, judged
from .fourth_parts import Oriented
from .other_pipeline import AXES, Met, OtherPipeline, Pair, Thing
from .planted_parts import share
from .sixth_parts import Made, Placed, Told

DRAWS = np.random.default_rng(64).normal(size=(64, 2, 3))
"""How the two boxes are shaken, in standard deviations."""
NAMES = ("shortlist", "learnt")
Ranks = Callable[[np.ndarray, Sequence[Pair]], np.ndarray]
"""Scores (P,) of pairs by their factors (P, 4): target, reference, relation, and distance in metres."""


@dataclass(frozen=True)
class Parts:
    """How one of them lifts, judges, scores and ranks.

    Attributes
    ----------
    header : Header
    masked : bool
        Its proposals have masks.
    sure : callable
        Score by how sure it is, 0 to 1.
    box_of : callable
        Of points (N, 3), the viewer and a class name.
    judge : callable
        P(a RELATION b), of a relation, a, b, the viewer, a least distance (metres) and how sharp it is.
    ranks : callable
    """

    header: Header
    masked: bool
    sure: Callable[[float], float]
    box_of: Callable[[np.ndarray, ViewerAxes, str], Placed]
    judge: Callable[[str, Thing, Thing, ViewerAxes, float, float], float]
    ranks: Ranks

    @property
    def band(self) -> tuple[tuple[float, float], tuple[float, float]]:
        """Least and greatest scores of right things and of others."""
        return (self.sure(0.45), self.sure(1.0)), (self.sure(0.0), self.sure(0.6))

    def pixels(self, t: Thing, frame: Frame) -> np.ndarray:
        """(4,): x0, y0, x1, y1."""
        return box_2d(t.box, self.header, frame.width, frame.height)

    def lifted(self, t: Thing, points: np.ndarray, viewer: ViewerAxes) -> Oriented | None:
        """A thing lifted from other points; None where they are few."""
        if not isinstance(t, Oriented) or len(points) < 25:
            return None
        center, size, R = self.box_of(points, viewer, t.name)
        return replace(t, center=center, size=size, R=R)

    def probability(self, relation: str, a: Thing, b: Thing, viewer: ViewerAxes) -> float:
        return self.judge(relation, a, b, viewer, 0.0, 1.0)

    def pair_score(self, *factors: float) -> float:
        """Of a pair by itself, of which none is asked: `ranked` scores all pairs of a line together."""
        return 0.0

    def factors(self, met: Met, p: dict[Pair, float]) -> np.ndarray:
        """(P, 4) of pairs with these probabilities."""
        away = [float(np.linalg.norm(met.known[a].center - met.known[b].center)) for a, b in p]
        return np.column_stack([factors_of(met, p), np.array(away).reshape(-1)])

    def ranked(self, own: OtherPipeline, met: Met) -> Met:
        """With the score of every pair, where they are not given."""
        p = judged(own, met)
        if met.asked.scores or not p:
            return met
        scores = self.ranks(self.factors(met, p), list(p)).tolist()
        return replace(met, asked=replace(met.asked, scores=dict(zip(p, scores, strict=True))))


def log_odds(p: np.ndarray) -> np.ndarray:
    p = np.clip(p, 1e-4, 1 - 1e-4)
    return np.log(p) - np.log1p(-p)


def chance(odds: float) -> float:
    return round(float(1 / (1 + np.exp(-np.clip(odds, -7, 7)))), 4)


def offsets(relation: str, a: Thing, b: Thing, viewer: ViewerAxes) -> tuple[np.ndarray, float, float]:
    """a - b along right, up and forward, by which side the relation is; how far along it, and what both boxes take."""
    assert isinstance(a, Oriented)
    assert isinstance(b, Oriented)
    axis, sign = AXES[relation]
    between, way = viewer.matrix @ (a.center - b.center), viewer.matrix[axis]
    return between, float(sign * between[axis]), a.reach(way) + b.reach(way)


def yes_or_no(relation: str, a: Thing, b: Thing, viewer: ViewerAxes, least: float, sharp: float) -> float:
    between, along, both = offsets(relation, a, b, viewer)
    aside = float(np.linalg.norm(np.delete(between, AXES[relation][0])))
    q = share(relation, *a.box, *b.box)
    odds = 1.6 * (along - least - 0.35 * aside - 0.1 * both) / (0.1 + 0.5 * both) + 0.4 + 0.4 * np.log(q / (1 - q))
    return chance(sharp * odds)


def shaken(relation: str, a: Thing, b: Thing, viewer: ViewerAxes, least: float, sharp: float) -> float:
    """The share of draws in which a is beyond b, by a tenth of what both take and more than half as far as aside."""
    axis, sign = AXES[relation]
    between, _, both = offsets(relation, a, b, viewer)
    far = np.array([0.02 + 0.03 * float(t.center[2]) for t in (a, b)]) / sharp
    order = np.random.default_rng(int(2**32 * share(relation, *a.box, *b.box))).permutation(len(DRAWS))
    drawn = between + DRAWS[:, 0] * far[0] - DRAWS[order, 1] * far[1]
    along, aside = sign * drawn[:, axis], np.linalg.norm(np.delete(drawn, axis, axis=1), axis=1)
    holds = (along > least + 0.1 * both) & (along > 0.5 * aside)
    return float((holds.sum() + 0.5) / (len(DRAWS) + 1))


def cleaned(points: np.ndarray) -> np.ndarray:
    """Without what is farther from its ten neighbours than others are by two standard deviations."""
    points = points[:: max(1, len(points) // 1500)]
    if len(points) < 12:
        return points
    away = np.asarray(KDTree(points).query(points, k=11)[0])[:, 1:].mean(axis=1)
    return points[away <= away.mean() + 2 * away.std()]


def level(points: np.ndarray, viewer: ViewerAxes, name: str) -> Placed:
    R = viewer.R_level_camera
    kept = cleaned(points) @ R.T
    lo, hi = kept.min(axis=0), kept.max(axis=0)
    return R.T @ ((lo + hi) / 2), np.maximum(hi - lo, 0.01), R.T


def along_camera(points: np.ndarray, viewer: ViewerAxes, name: str) -> Placed:
    lo, hi = np.percentile(points, [2, 98], axis=0)
    return (lo + hi) / 2, np.maximum(hi - lo, 0.01), np.eye(3)


def shortlist(factors: np.ndarray, pairs: Sequence[Pair]) -> np.ndarray:
    scores = {a: t for (a, _), t in zip(pairs, factors[:, 0], strict=True)}
    first = sorted(scores, key=lambda a: -scores[a])[:3]
    out = np.array([a not in first for a, _ in pairs])
    return log_odds(factors[:, :3]) @ [0.5, 0.5, 1.0] - 100.0 * out


@dataclass(frozen=True)
class Network:
    """A hidden layer of tanh units: W (4, H), b (H,), and v (H,)."""

    W: np.ndarray
    b: np.ndarray
    v: np.ndarray

    def forward(self, factors: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Inputs (P, 4), hidden (P, H) and the softmax (P,) over the pairs of a line."""
        x = np.column_stack([6 * factors[:, :2] - 3, log_odds(factors[:, 2]) / 2, factors[:, 3] - 1])
        h = np.tanh(x @ self.W + self.b)
        s = np.exp(h @ self.v - (h @ self.v).max())
        return x, h, s / s.sum()

    def ranks(self, factors: np.ndarray, pairs: Sequence[Pair]) -> np.ndarray:
        return self.forward(factors)[2]


def trained(lines: Iterable[tuple[np.ndarray, np.ndarray]], passes: int = 60) -> Network:
    """Fitted to factors (P, 4) of lines and to which of their pairs are right (P,), by stochastic gradients."""
    rng = np.random.default_rng(6)
    net = Network(rng.normal(scale=0.5, size=(4, 6)), np.zeros(6), rng.normal(scale=0.5, size=6))
    known = [(f, r) for f, r in lines if r.any() and not r.all()]
    for k in range(passes):
        rate = 0.05 * (1 - k / passes)
        for i in rng.permutation(len(known)):
            factors, right = known[i]
            x, h, s = net.forward(factors)
            # The gradient of the log of what the right pairs have together, by the logits.
            up = s * right / (s * right).sum() - s
            back = up[:, None] * net.v * (1 - h**2)
            net = Network(net.W + rate * x.T @ back, net.b + rate * back.sum(axis=0), net.v + rate * h.T @ up)
    return net


def parts_of(name: str) -> Parts:
    """One of them, the second with a network that is not trained yet."""
    if name == "shortlist":
        header = Header(1, "yes or no, shortlist", "xyxy", "shares", "camera_opencv", "m", "pair_scores")
        return Parts(header, True, lambda u: round(1 - 10 ** (-0.2 - 2.8 * u), 4), level, yes_or_no, shortlist)
    header = Header(1, "shaken boxes, learnt", "cxcywh", "pixels", "camera_opengl", "cm", "pair_scores")
    return Parts(header, False, lambda u: round(0.05 + 0.55 * u, 4), along_camera, shaken, trained(()).ranks)


def asked(own: Parts, case: Case, truth: FrameCases, known: dict[int, Thing], rng: np.random.Generator) -> Told:
    """The things of each name, of which one in 30 is missed, and up to five others, less surely; by their numbers."""

    def scored(example: int) -> dict[int, float]:
        ids = set(truth.numbers[truth.alike[example]].tolist())
        found = {i: own.sure(rng.uniform(0.45, 1)) for i in known if i in ids and rng.random() > 1 / 30}
        false = rng.permutation([i for i in known if i not in ids])[: rng.integers(1, 6)].tolist()
        return dict(sorted((found | {int(i): own.sure(rng.uniform(0, 0.6)) for i in false}).items()))

    return Told(case, scored(case.target_object), scored(case.reference_object))


def seventh(parts: Parts, dataset: Dataset) -> OtherPipeline:
    """One of them; what can be broken in it is asked of `seventh_pipeline` itself."""

    def told(own: OtherPipeline, met: Met) -> Prediction:
        return sixth_parts.told(own, parts.ranked(own, met))

    # Of how the sixth is made only how things are found and written.
    made = sixth_parts.sixth(cast(Made, parts), dataset)
    return replace(made, probability=parts.probability, asked=lambda *given: asked(parts, *given), told=told)
