"""From a network's logits to probabilities that mean what they say: antisymmetry, then Platt's sigmoid."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from pipeline.relations import INVERSE

Platt = tuple[float, float]
"""a and b of P = 1 / (1 + exp(-(a * logit + b))), a > 0."""

IDENTITY: Platt = (1.0, 0.0)
FEWEST_POSITIVES = 50
"""With fewer examples of either answer the sigmoid is left as it is."""


def antisymmetric(logits: np.ndarray, vocabulary: Sequence[str]) -> np.ndarray:
    """"a left of b" and "b right of a" get one and the same logit: the mean of the two.

    Parameters
    ----------
    logits : (N, N, R) float
        In the order of `vocabulary`; relations without their inverse in it stay as they are.
    """
    result = logits.copy()
    for k, relation in enumerate(vocabulary):
        inverse = INVERSE.get(relation)
        if inverse in vocabulary:
            other = vocabulary.index(inverse)
            if k < other:
                mean = (logits[..., k] + logits[..., other].T) / 2
                result[..., k], result[..., other] = mean, mean.T
    return result


def sigmoid(x: np.ndarray) -> np.ndarray:
    """The logistic function, without overflow."""
    return 0.5 * (1.0 + np.tanh(0.5 * np.asarray(x, np.float64)))


def fit_platt(logits: np.ndarray, holds: np.ndarray) -> Platt:
    """Platt's sigmoid by Newton's method on held-out examples.

    Targets are (n+ + 1) / (n+ + 2) and 1 / (n- + 2) as in Platt (1999), which
    keeps the fit finite where the examples are separable.

    Parameters
    ----------
    logits : (M,) float
    holds : (M,) bool
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
    """A sigmoid for each relation; inverse relations share one, so that antisymmetry stays exact.

    Parameters
    ----------
    logits : sequence of (N, N, R) float
        Of each view, antisymmetric.
    truth : sequence of (N, N, R) int8
        States; U and the diagonal take no part.
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
