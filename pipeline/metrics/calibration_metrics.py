"""Calibration of probabilities: Brier score, ECE, reliability diagrams, and sigmoids that calibrate."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from pipeline.language.relation_names import INVERSE
from pipeline.metrics.intervals import ratio
from pipeline.system.frozen import dataclass

ECE_BINS = 15


@dataclass(frozen=True)
class ReliabilityDiagram:
    """Probabilities in bins of equal width [k/B, (k+1)/B), the last with its end."""

    edges: np.ndarray  # (B + 1,) float64
    count: np.ndarray  # (B,) int64
    confidence: np.ndarray  # (B,) float64, mean probability; NaN in an empty bin
    frequency: np.ndarray  # (B,) float64, share of what holds; NaN in an empty bin

    @property
    def ece(self) -> float:
        """Expected calibration error (Naeini et al., AAAI 2015), weighted by the bins' counts; NaN if empty."""
        gap = np.abs(self.confidence - self.frequency)
        return float(ratio(np.where(self.count > 0, gap * self.count, 0.0).sum(), self.count.sum()))


@dataclass(frozen=True)
class CalibrationMetrics:
    """Calibration of all known cells together; NaN where no cell is known."""

    brier: float
    diagram: ReliabilityDiagram


def reliability_diagram(p: Any, holds: Any, bins: int = ECE_BINS) -> ReliabilityDiagram:
    """Reliability diagram of (M,) probabilities, 0..1, and (M,) bool: mean probability and frequency by bin.

    For a softmax, `p` is the largest probability of each row and `holds` says
    whether its relation is the true one.
    """
    p, holds = np.asarray(p, np.float64), np.asarray(holds, np.bool_)
    index = np.minimum((p * bins).astype(np.int64), bins - 1)
    count = np.bincount(index, minlength=bins)
    confidence = ratio(np.bincount(index, p, bins), count)
    frequency = ratio(np.bincount(index, holds.astype(np.float64), bins), count)
    return ReliabilityDiagram(np.linspace(0.0, 1.0, bins + 1), count, confidence, frequency)


def expected_calibration_error(p: Any, holds: Any, bins: int = ECE_BINS) -> float:
    """Expected calibration error of (M,) probabilities and (M,) bool; NaN without any.

    >>> import numpy as np
    >>> from pipeline.metrics import expected_calibration_error
    >>> round(expected_calibration_error([0.8] * 10, np.arange(10) < 6), 3)
    0.2
    """
    return reliability_diagram(p, holds, bins).ece


def brier_score(p: Any, holds: Any) -> float:
    """Brier score, the mean of (p - [holds])², of (M,) probabilities and (M,) bool; NaN without any."""
    p, holds = np.asarray(p, np.float64), np.asarray(holds, np.bool_)
    return float(ratio(np.square(p - holds).sum(), len(p)))


def calibration_metrics(p: np.ndarray, truth: np.ndarray) -> CalibrationMetrics:
    """Calibration of relation probabilities, (P, R), by states, (P, R) int8: 1 T, 0 U (left out), -1 F."""
    known, holds = truth != 0, truth > 0
    squared = np.where(known, np.square(p - holds), 0.0)
    return CalibrationMetrics(float(ratio(squared.sum(), known.sum())), reliability_diagram(p[known], holds[known]))


Platt = tuple[float, float]
"""a and b of P = 1 / (1 + exp(-(a * logit + b))), a > 0."""
IDENTITY: Platt = (1.0, 0.0)
FEWEST_POSITIVES = 50
"""With fewer examples of either answer the sigmoid is left as it is."""


def antisymmetric(logits: np.ndarray, vocabulary: Sequence[str]) -> np.ndarray:
    """Average the logits, (..., N, N, R), of "a left of b" and "b right of a", so that both are the same.

    Relations without their inverse in the vocabulary stay as they are.
    """
    result = logits.copy("K")
    for k, relation in enumerate(vocabulary):
        inverse = INVERSE.get(relation)
        if inverse in vocabulary:
            other = vocabulary.index(inverse)
            if k < other:
                mean = (logits[..., k] + logits[..., other].swapaxes(-1, -2)) / 2
                result[..., k], result[..., other] = mean, mean.swapaxes(-1, -2)
    return result


def antisymmetric_log_softmax(logits: np.ndarray, vocabulary: Sequence[str]) -> np.ndarray:
    """Logarithms of class probabilities, (N, N, R), in which "a left of b" and "b right of a" mirror each other.

    The logits of two pairs have no common zero, and so only what does not depend
    on it is averaged: among the relations with an inverse, the logarithm of each
    one's share. How much falls to these together and to each of the others (on,
    in) stays as in the network's output for that pair.
    """
    result = log_softmax(logits)
    mirrored = [k for k, relation in enumerate(vocabulary) if INVERSE.get(relation) in vocabulary]
    if mirrored:
        names = [vocabulary[k] for k in mirrored]
        inside = result[..., mirrored]
        together = _log_sum(inside)
        result[..., mirrored] = log_softmax(antisymmetric(inside - together, names)) + together
    return result


def log_softmax(logits: np.ndarray) -> np.ndarray:
    """Logarithm of the softmax over the last axis, float64."""
    wide = np.asarray(logits, np.float64)
    return wide - _log_sum(wide)


def softmax(logits: np.ndarray) -> np.ndarray:
    """Softmax over the last axis, float64."""
    return np.exp(log_softmax(logits))


def _log_sum(x: np.ndarray) -> np.ndarray:
    top = x.max(axis=-1, keepdims=True)
    return top + np.log(np.exp(x - top).sum(axis=-1, keepdims=True))


def sigmoid(x: np.ndarray) -> np.ndarray:
    """Logistic function, without overflow."""
    return 0.5 * (1.0 + np.tanh(0.5 * np.asarray(x, np.float64)))


def fit_platt(logits: np.ndarray, holds: np.ndarray) -> Platt:
    """Fit Platt's sigmoid to (M,) held-out logits and (M,) bool by Newton's method.

    Targets are (n+ + 1) / (n+ + 2) and 1 / (n- + 2) as in Platt (1999), which
    keeps the fit finite where the examples are separable.
    """
    positive, negative = int(holds.sum()), int((~holds).sum())
    if min(positive, negative) < FEWEST_POSITIVES:
        return IDENTITY
    x = np.asarray(logits, np.float64)
    target = np.where(holds, (positive + 1) / (positive + 2), 1 / (negative + 2))
    design = np.stack([x, np.ones_like(x)], axis=1)
    weights = np.array(IDENTITY)
    loss = _cross_entropy(x, target, weights)
    for _ in range(100):
        p = sigmoid(design @ weights)
        gradient = design.T @ (p - target)
        curvature = design.T @ (design * (p * (1 - p))[:, None]) + 1e-9 * np.eye(2)
        step = np.linalg.solve(curvature, gradient)
        scale = 1.0
        # A full Newton step may overshoot where the sigmoid is flat.
        while scale > 1e-6 and _cross_entropy(x, target, weights - scale * step) > loss:
            scale /= 2
        weights = weights - scale * step
        previous, loss = loss, _cross_entropy(x, target, weights)
        if previous - loss < 1e-10 * max(previous, 1.0):
            break
    return (float(weights[0]), float(weights[1])) if weights[0] > 0 else IDENTITY


def _cross_entropy(x: np.ndarray, target: np.ndarray, weights: np.ndarray) -> float:
    z = weights[0] * x + weights[1]
    return float((np.logaddexp(0.0, z) - target * z).sum())


def fit_calibration(
    logits: Sequence[np.ndarray], truth: Sequence[np.ndarray], vocabulary: Sequence[str]
) -> dict[str, Platt]:
    """Fit a sigmoid for each relation to antisymmetric logits, (N, N, R) a view, and states, int8.

    Inverse relations share a sigmoid, so that antisymmetry stays exact; U and the diagonal take no part.
    """
    found: dict[str, Platt] = {}
    for k, relation in enumerate(vocabulary):
        inverse = INVERSE.get(relation, relation)
        if inverse in found:
            found[relation] = found[inverse]
            continue
        values, holds = [], []
        for view, states in zip(logits, truth, strict=True):
            known = (states[..., k] != 0) & ~np.eye(len(states), dtype=np.bool_)
            values.append(view[..., k][known])
            holds.append(states[..., k][known] > 0)
        found[relation] = fit_platt(np.concatenate(values), np.concatenate(holds))
    return found


def labelled_pairs(
    values: Sequence[np.ndarray], truth: Sequence[np.ndarray], classes: int
) -> tuple[np.ndarray, np.ndarray]:
    """Values, (P, R), and classes, (P,) int64, of the pairs of all views with a class, (N, N) int each, >= 0."""
    pairs = [(v[t >= 0], t[t >= 0]) for v, t in zip(values, truth, strict=True)]
    found = np.concatenate([np.zeros((0, classes)), *(v for v, _ in pairs)])
    return found, np.concatenate([np.zeros(0, np.int64), *(t for _, t in pairs)]).astype(np.int64)


def fit_temperature(
    logits: Sequence[np.ndarray], truth: Sequence[np.ndarray], vocabulary: Sequence[str]
) -> dict[str, Platt]:
    """Fit a temperature for all classes, by the likelihood of held-out pairs (Guo et al. 2017, section 4.2).

    `logits` are (N, N, R) a view, of a softmax network, `truth` the index of the true relation, (N, N), -1 for pairs
    that take no part. It is (1 / temperature, 0) for each relation; the identity with fewer than 50 pairs.
    """
    z, t = labelled_pairs(logits, truth, len(vocabulary))
    slope = 1.0
    if len(t) >= FEWEST_POSITIVES:
        # The likelihood is concave in the slope: golden sections of its logarithm, 1/16 to 16.
        low, high, golden = np.log(1 / 16), np.log(16.0), (5**0.5 - 1) / 2

        def loss(exponent: float) -> float:
            return -float(log_softmax(z * np.exp(exponent))[np.arange(len(t)), t].sum())

        for _ in range(40):
            a, b = high - golden * (high - low), low + golden * (high - low)
            low, high = (low, b) if loss(a) < loss(b) else (a, high)
        slope = float(np.exp((low + high) / 2))
    return dict.fromkeys(vocabulary, (slope, 0.0))
