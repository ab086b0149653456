"""Confident learning of one yes-or-no question: which labels are probably wrong, given out-of-fold probabilities.

After C. G. Northcutt, L. Jiang and I. L. Chuang, "Confident Learning: Estimating
Uncertainty in Dataset Labels", JAIR 70 (2021), 1373-1411: per-class thresholds,
the confident joint of given and true labels, its calibration to the counts of
given labels (section 3.1), and ranking by self-confidence. Each relation is a
question of its own, as relations may hold together and cells that are too close
to call (U) have no label.

The network is trained on given labels, and so its probability is that of the
given label. With the noise rates of the confident joint it is inverted to that
of the true label, and Bayes' rule gives the probability that a label is wrong.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pipeline.system.errors import require

FEWEST = 10
"""With fewer labels of either answer no noise rates are estimated."""
MOST_NOISE = 0.9
"""The two noise rates together; at 1 a label would say nothing."""
TRUSTED = 0.9
"""How far the inverted probability is trusted; for the rest the network's own counts, so that none is certain."""


@dataclass(frozen=True)
class Noise:
    """How labels of one question came to be wrong."""

    thresholds: np.ndarray
    """(2,) float64: mean probability of "no" over labels that say no, of "yes" over those that say yes; NaN where there
    are none."""
    joint: np.ndarray
    """(2, 2) float64: labels by what they say [0: no, 1: yes] and what they should [0, 1]; sums to their number."""
    yes_for_no: float
    no_for_yes: float
    """Share of true noes that were labelled yes, and the reverse."""

    @property
    def wrong(self) -> float:
        """Estimated number of wrong labels."""
        return float(self.joint[0, 1] + self.joint[1, 0])


def estimate_noise(p: np.ndarray, says: np.ndarray) -> Noise:
    """Noise rates by the confident joint.

    `p` (M,) float: out-of-fold probability of "yes". `says` (M,) bool: what the labels say.

    Raises InputError: lengths differ, or a probability is not in 0..1.
    """
    p, says = _checked(p, says)
    counts = np.array([(~says).sum(), says.sum()], np.float64)
    if counts.min() < FEWEST:
        thresholds = np.array([(1 - p[~says]).mean() if counts[0] else np.nan, p[says].mean() if counts[1] else np.nan])
        return Noise(thresholds, np.diag(counts), 0.0, 0.0)
    thresholds, table = confident_joint(p, says)
    # One more of each kind of error: where none was seen, ranks still differ.
    table += [[0, 1], [1, 0]]
    joint = table / table.sum(axis=1, keepdims=True) * counts[:, None]
    # Columns are true classes; a class that is confidently seen nowhere leaves its rate at nothing.
    true = np.maximum(joint.sum(axis=0), 1e-12)
    yes_for_no, no_for_yes = joint[1, 0] / true[0], joint[0, 1] / true[1]
    scale = min(1.0, MOST_NOISE / max(yes_for_no + no_for_yes, 1e-12))
    return Noise(thresholds, joint, float(yes_for_no * scale), float(no_for_yes * scale))


def confident_joint(p: np.ndarray, says: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Thresholds and the confident joint of given and true labels (equation 1 of the paper).

    `p` (M,) float; `says` (M,) bool, with either answer at least once.

    Returns `thresholds` (2,) float64: mean probability of each answer over the labels that give it. `counts` (2, 2)
    float64: by what labels say and what they should.
    """
    p, says = _checked(p, says)
    thresholds = np.array([(1 - p[~says]).mean(), p[says].mean()])
    confident = np.stack([1 - p >= thresholds[0], p >= thresholds[1]])
    # Where both are confident, the more probable one is what the label should be.
    truly_yes = np.where(confident.all(axis=0), p >= 0.5, confident[1])
    counted = confident.any(axis=0)
    table = np.zeros((2, 2))
    np.add.at(table, (says[counted].astype(np.int64), truly_yes[counted].astype(np.int64)), 1.0)
    return thresholds, table


def probability_wrong(p: np.ndarray, says: np.ndarray, noise: Noise | None = None) -> np.ndarray:
    """(M,) float64: how probably each label is wrong; arguments as of `estimate_noise`.

    P(says | x) = (1 - no_for_yes) P(yes | x) + yes_for_no P(no | x) is solved for
    P(yes | x), and P(wrong | x, says) follows by Bayes' rule. Without noise rates
    (too few labels) it is one less the self-confidence.
    """
    p, says = _checked(p, says)
    noise = estimate_noise(p, says) if noise is None else noise
    e, d = noise.yes_for_no, noise.no_for_yes
    if not (e or d):
        return 1 - self_confidence(p, says)
    inverted = np.clip((p - e) / (1 - e - d), 0.0, 1.0)
    yes = np.clip(TRUSTED * inverted + (1 - TRUSTED) * p, 1e-9, 1 - 1e-9)
    right = np.where(says, (1 - d) * yes, (1 - e) * (1 - yes))
    wrong = np.where(says, e * (1 - yes), d * yes)
    return wrong / (wrong + right)


def self_confidence(p: np.ndarray, says: np.ndarray) -> np.ndarray:
    """(M,) float64: probability of the given label; the least first ranks errors.

    Of two answers it ranks as the normalised margin does, which is twice this less 1.
    """
    p, says = _checked(p, says)
    return np.where(says, p, 1 - p)


def _checked(p: np.ndarray, says: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    p, says = np.asarray(p, np.float64), np.asarray(says, np.bool_)
    require(
        p.ndim == 1 and p.shape == says.shape, "one probability a label is needed", got=p.shape, expected=says.shape
    )
    require(
        not len(p) or (np.isfinite(p).all() and p.min() >= 0 and p.max() <= 1),
        "probabilities must lie between 0 and 1",
    )
    return p, says
