"""Fitted models of a ranking and a relation scorer that cannot be asked again, from their file.

Of two pairs of one line the file says which scored more. How probable that is follows from P(target), P(reference) and
P(relation) of both: a sum of curves, each of which rises with these factors, is fitted to all such comparisons of the
file, whatever the scale of its scores. A ranking that uses its factors at all gives no less to a pair that is better in
all of them. Where such a sum does not say what most comparisons say, the ranking goes by something else.

Scores that are products or shares of a whole are sums in their logarithms, those of a classifier in their log odds: it
is fitted to what fits best. A ranking may also go by how a thing stands among its like, as one of the three surest.

Where the truth takes the place of a box, somebody has to say what the scorer would have said. For each relation that
the file has enough pairs of, their probabilities are fitted by where the one box lies from the other, as the viewer
sees it; where the fit decides nearly all pairs as they are, it stands in. Else the rule does.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import field, replace
from functools import cached_property
from typing import Literal

import numpy as np

from pipeline.answering.coordinate_conventions import try_box
from pipeline.answering.objects import prepare_frame
from pipeline.answering.predictions import Predictions
from pipeline.datasets.base import Dataset
from pipeline.geometry.boxes import Box3D
from pipeline.geometry.lifting import LiftedObject
from pipeline.geometry.viewer import ViewerAxes
from pipeline.language.relation_names import PAIRWISE
from pipeline.relations.features import Appearance
from pipeline.relations.scorer import RelationScores, RuleScorer
from pipeline.system.frozen import dataclass

LEAST_COMPARED, MOST_COMPARED = 30, 12_000
"""Comparisons: of fewer nothing is said, of more some are taken, evenly."""
MOST_ODD = 0.25
"""A pair is odd whose score stands the wrong way round with more than half of the others of its line; so many may be,
of those of all lines, whose scores are wrong."""
FITS = 3
"""How often a ranking is fitted, each time without the pairs that were odd by the fit before."""
CONTRADICTED = 0.15
"""A fit stands in that contradicts no more than this of what is said of the others."""
ALIKE = 0.02
"""Scores are fitted as they stand where that contradicts no more comparisons than this beyond a fit to their order."""
FAR = 4.0
"""A difference of scores is left out of the last fit that is off by so many times the median."""
LEAST_NOISE = 0.0001
"""No fit is surer than this share of all that it spans: what lies within is told by rounding."""
_RIDGE = 0.5
_MOST_STEPS, _SHORT = 30, 1e-7
_BENDS = (0.25, 0.5, 0.75)
_STEPS = tuple(k / 10 for k in range(1, 10))

_FEW = 0.05
"""A scale is tried that can hold all scores but this share."""
CLEARER = 0.7
"""How things stand among others is believed where it leaves no more than this of what the factors alone do not tell."""
_NOTHING = 1e-12

Compared = tuple[np.ndarray, np.ndarray, np.ndarray]
"""(N, 3) float64 factors, (N,) float64 scores and (N, 2) int64 ids of the pairs of one line."""

_BOUND = 700.0
Scale = Literal["values", "logs", "odds"]
SCALES: dict[Scale, tuple[Callable[[np.ndarray], np.ndarray], Callable[[np.ndarray], np.ndarray]]] = {
    "values": (lambda s: s, lambda s: s),
    "logs": (lambda s: np.log(np.maximum(s, _NOTHING)), lambda s: np.exp(np.clip(s, -_BOUND, _BOUND))),
    "odds": (
        lambda s: np.log(np.clip(s, _NOTHING, 1)) - np.log(np.clip(1 - s, _NOTHING, 1)),
        lambda s: 1 / (1 + np.exp(np.clip(-s, -_BOUND, _BOUND))),
    ),
}
"""In what scores are sums: from scores, and back; none changes their order."""


def curves(factors: np.ndarray) -> np.ndarray:
    """(..., K) float64: rising functions of factors (..., 3): bent, joined, and by thresholds."""
    clear = np.clip(factors, 0.01, 0.99)
    bends = [np.minimum(clear, bend) for bend in _BENDS]
    odds = np.log(clear / (1 - clear))
    t, r, p = np.moveaxis(clear, -1, 0)
    joined = [np.minimum(t, r), np.minimum(t, p), np.minimum(r, p), t * r, t * p, r * p, t * r * p]
    either = [1 - (1 - t) * (1 - r), 1 - (1 - t) * (1 - p), 1 - (1 - r) * (1 - p), 1 - (1 - t) * (1 - r) * (1 - p)]
    mixed = np.stack([*joined, clear.min(axis=-1), *either], axis=-1)
    return np.concatenate([clear, *bends, np.log(clear), odds, mixed, *(clear > step for step in _STEPS)], axis=-1)


@dataclass(frozen=True)
class FittedRanking:
    """Fitted model of a file's ranking."""

    # (K,) float64: of `curves` and `standing`; the difference of two sums is how much more the one pair scores, about,
    # on `scale`
    weights: np.ndarray
    unit: float  # So much more is one more of the log odds that it scores more at all
    scale: Scale = "values"  # In what scores are sums

    def sums(self, factors: np.ndarray, ids: np.ndarray | None = None) -> np.ndarray:
        """(..., P) float64: sums of factors (..., P, 3) of the pairs of a line with these ids (P, 2)."""
        features = curves(factors)
        # Cases of before were kept with the first curves only.
        if ids is not None and len(self.weights) > features.shape[-1]:
            features = np.concatenate([features, standing(factors, ids)], axis=-1)
        known = min(features.shape[-1], len(self.weights))
        return np.asarray(features[..., :known] @ self.weights[:known])

    @staticmethod
    def of(lines: Sequence[Compared]) -> FittedRanking | None:
        """Fit lines together; None where their factors explain nothing."""
        above, below, start = [np.zeros(0, np.int64)], [np.zeros(0, np.int64)], 0
        for _, scores, _ in lines:
            a, b = np.nonzero(scores[:, None] > scores[None] + 1e-9)
            above.append(a + start)
            below.append(b + start)
            start += len(scores)
        every = np.stack([np.concatenate(above), np.concatenate(below)], axis=1)
        if len(every) < LEAST_COMPARED:
            return None
        every = every[np.unique(np.linspace(0, len(every) - 1, min(MOST_COMPARED, len(every))).astype(int))]
        seen = np.concatenate([np.concatenate([curves(f), standing(f, ids)], axis=1) for f, _, ids in lines])
        x = seen[every[:, 0]] - seen[every[:, 1]]
        compared, kept = np.bincount(every.ravel(), minlength=start), np.ones(len(every), np.bool_)
        wrong, odd = ~kept, np.zeros(start, np.bool_)
        # Without the pairs that are odd by one fit the next tells better which are.
        for _ in range(FITS):
            wrong = x @ fitted(x[kept], rising=True) <= 0
            odd = np.bincount(every[wrong].ravel(), minlength=start) > compared / 2
            kept = ~odd[every].any(axis=1)
            if not kept.any():
                return None
        if odd.sum() > MOST_ODD * np.count_nonzero(compared) or wrong[kept].mean() > CONTRADICTED:
            return None
        x, every = x[kept], every[kept]
        scores = np.concatenate([scores for _, scores, _ in lines])
        weights, more, near, scale = _scaled(x, scores, every)
        x = x[:, : len(weights)]
        order = fitted(x, rising=True)
        if (x @ weights <= 0).mean() > (x @ order <= 0).mean() + ALIKE:
            apart = x @ order
            weights, near = order * (more @ apart) / max(float(apart @ apart), 1e-12), np.ones(len(x), np.bool_)
        noise = float((more - x @ weights)[near].std()) * np.sqrt(3) / np.pi
        low, high = curves(np.array([[0.0] * 3, [1.0] * 3])) @ weights[: curves(np.zeros((1, 3))).shape[1]]
        return FittedRanking(weights, max(noise, LEAST_NOISE * (high - low), 1e-12), scale)


def _scaled(x: np.ndarray, scores: np.ndarray, every: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, Scale]:
    """Weights of the first columns of x (N, C), and the scale on which they fit best.

    Weights (K,) give the differences (N,) of the pairs `every` (N, 2); then these, the near ones of them (N,), and the
    scale on which the least is left of those.
    """
    best: tuple[np.ndarray, np.ndarray, np.ndarray] | None = None
    scale: Scale = "values"
    left, alone = np.inf, curves(np.zeros((1, 3))).shape[1]
    for columns in (alone, x.shape[1]):
        for name, (forward, _) in SCALES.items():
            outside = (scores <= 0) | ((scores >= 1) if name == "odds" else False)
            if name != "values" and outside.mean() > _FEW:
                continue
            more = forward(scores[every[:, 0]]) - forward(scores[every[:, 1]])
            z = x[:, :columns]
            # A wrong score that stands the right way round is known by how far it stands from all others.
            far = np.abs(more - z @ _regressed(z, more))
            near = far <= FAR * np.median(far) + 1e-9
            weights = _regressed(z[near], more[near])
            off = float(np.abs(more - z @ weights)[near].sum() / np.abs(more[near]).sum())
            # Factors that explain the scores by themselves are believed before how things stand among others.
            if best is None or off < (left if columns == alone else CLEARER * left - 0.01):
                best, scale, left = (weights, more, near), name, off
    assert best is not None
    return *best, scale


def _regressed(x: np.ndarray, more: np.ndarray) -> np.ndarray:
    """(K,) float64, none below 0: least-squares weights of x ((N, K)) for differences of scores ((N,))."""
    scale = np.maximum(np.sqrt((x**2).mean(axis=0)), 1e-6)
    z = x / scale
    return _least(z.T @ z + _RIDGE / 5 * np.eye(z.shape[1]), z.T @ more, True) / scale


def fitted(x: np.ndarray, p: np.ndarray | float = 1.0, rising: bool = False) -> np.ndarray:
    """(K,) float64: logistic weights of x ((N, K)) for probabilities p ((N,)), by Newton's method; with `rising` none
    below 0."""
    scale = np.maximum(np.sqrt((x**2).mean(axis=0)), 1e-6)
    z = x / scale

    def loss(w: np.ndarray) -> float:
        odds = z @ w
        return float((np.logaddexp(0, odds) - p * odds).sum() + _RIDGE * w @ w / 2)

    w = np.zeros(z.shape[1])
    for _ in range(_MOST_STEPS):
        q = 1 / (1 + np.exp(-np.clip(z @ w, -500, 500)))
        bent = (z * (q * (1 - q))[:, None]).T @ z + _RIDGE * np.eye(len(w))
        step = _least(bent, bent @ w + (p - q) @ z - _RIDGE * w, rising) - w
        before, length = loss(w), 1.0
        while length > _SHORT and loss(w + length * step) > before:
            length /= 2
        w = w + length * step
        if before - loss(w) < _SHORT * (1 + abs(before)):
            break
    return w / scale


def _least(a: np.ndarray, b: np.ndarray, rising: bool) -> np.ndarray:
    """(K,) float64: minimiser of w A w / 2 - b w, A (K, K) positive; with `rising` over w with none below 0."""
    if not rising:
        return np.linalg.solve(a, b)
    from scipy.optimize import nnls

    root = np.linalg.cholesky(a).T
    return nnls(root, np.linalg.solve(root.T, b))[0]


_FIRST = (1, 2, 3, 5)
_STEEP = 4.0
"""Of a softmax over values from 0 to 1, so many times."""
_EVEN = 0.01
"""No spread within a line counts as less."""
_FAR = 5.0


def standing(factors: np.ndarray, ids: np.ndarray) -> np.ndarray:
    """(..., P, K) float64 of the factors (..., P, 3) of the P pairs of a line with these ids (P, 2).

    Of target, reference and relation the share that is not surer, whether among the first few, and how many pairs it is
    above; `_shares`; the place between the least and the most of the line, and from the mean in standard deviations.
    Objects not proposed (an id below 0) are no rivals.
    """
    lines = factors.reshape(int(np.prod(factors.shape[:-2])), *factors.shape[-2:])
    found, known = [], ids.min(axis=1) >= 0
    for part in range(3):
        numbers = np.arange(len(ids)) if part == 2 else ids[:, part]
        _, first, own = np.unique(numbers, return_index=True, return_inverse=True)
        rivals = first[ids[first].min(axis=1) >= 0] if part == 2 else first[numbers[first] >= 0]
        values = -lines[:, :, part]
        above = [np.searchsorted(np.sort(v[rivals]), v[first], side="left")[own.ravel()] for v in values]
        rank = np.array(above).reshape(lines.shape[:2])
        found += [1 - rank / max(len(rivals), 1), *(rank < k for k in _FIRST)]
        found += [[np.searchsorted(np.sort(v[known]), v, side="left") for v in -values]]
    clear = np.clip(lines, 0.01, 0.99)
    found += _shares(clear, ids, known)
    if known.any():
        for v in np.moveaxis(clear, -1, 0):
            among = v[:, known]
            low, high, mean, std = (f(axis=1, keepdims=True) for f in (among.min, among.max, among.mean, among.std))
            found += [np.clip((v - low) / np.maximum(high - low, _EVEN), 0, 1)]
            found += [np.clip((v - mean) / np.maximum(std, _EVEN), -_FAR, _FAR)]
    else:
        found += [np.zeros(clear.shape[:2])] * 6
    features = np.stack([np.asarray(f) for f in found], axis=-1).astype(np.float64)
    return features.reshape(*factors.shape[:-1], len(found))


def _shares(clear: np.ndarray, ids: np.ndarray, known: np.ndarray) -> list[np.ndarray]:
    """(L, P) float64 each, of lines (L, P, 3), among the pairs of the target, of the reference, and all.

    Share of a pair in its like, in logarithms and by itself, whether first, the distance to the best of the others (as
    a share of the more), the first and the mean of them. Then the less of its shares among those of its target and of
    its reference.
    """
    t, r, p = np.moveaxis(clear, -1, 0)
    odds, steep, whole = p / (1 - p), np.exp(_STEEP * p), t * r * p
    groups = (
        (ids[:, 0], (p, whole, odds, r * p, r * steep)),
        (ids[:, 1], (p, whole, odds, t * p, t * steep)),
        (np.zeros(len(ids)), (p, whole, t, r)),
    )
    found = [[_share(v, numbers, known) for v in values] for numbers, values in groups]
    less = [np.minimum(one[0], other[0]) for one, other in zip(*found[:2], strict=True)][:2]
    return [column for values in found for columns in values for column in columns] + less


def _share(v: np.ndarray, numbers: np.ndarray, known: np.ndarray) -> tuple[np.ndarray, ...]:
    """Six views (L, P) of values (L, P) above 0 among those of the pairs with equal number (P,)."""
    others, best, count = np.zeros_like(v), np.zeros_like(v), np.zeros(len(numbers))
    for number in np.unique(numbers):
        group = numbers == number
        rivals = group & known
        among = np.sort(np.concatenate([np.zeros((len(v), 2)), v[:, rivals]], axis=1), axis=1)
        own = known[group]
        others[:, group] = among.sum(axis=1, keepdims=True) - v[:, group] * own
        # The best of the others is the second for a pair that is itself the first.
        best[:, group] = np.where(own & (v[:, group] == among[:, -1:]), among[:, -2:-1], among[:, -1:])
        count[group] = rivals.sum() - own
    share = v / (v + others)
    first = np.maximum(v, best)
    return np.log(share), share, v >= best, (v - best) / first, first, (v + others) / (1 + count)


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
