"""A colour picture that stands upright beside depth that lies: which way it was turned."""

from __future__ import annotations

import cv2
import numpy as np

from pipeline.datasets.settings import TURNS

CLEARLY = 0.02
"""By how much the outlines of one turn must meet better, as a correlation."""


def turn_to(rgb: np.ndarray, depth: np.ndarray) -> str | None:
    """The turn, one of `TURNS`, of colour (H, W, 3) uint8 after which its outlines meet those of depth (W, H) float
    best; None where neither does so clearly."""
    size = depth.shape[1], depth.shape[0]
    scores: dict[str, float] = {}
    for name, turns in TURNS.items():
        turned = cv2.resize(np.ascontiguousarray(np.rot90(rgb, turns)), size, interpolation=cv2.INTER_AREA)
        grey = cv2.cvtColor(turned, cv2.COLOR_RGB2GRAY)
        pair = [outlines - outlines.mean() for outlines in (_outlines(grey), _outlines(depth))]
        scores[name] = float(np.vdot(*pair) / max(float(np.prod([np.linalg.norm(one) for one in pair])), 1e-9))
    best, other = sorted(scores, key=lambda name: -scores[name])
    return best if scores[best] > scores[other] + CLEARLY else None


def _outlines(values: np.ndarray) -> np.ndarray:
    """Strength of edges, of which a few strong ones do not count for all."""
    smooth = cv2.GaussianBlur(values.astype(np.float32), (0, 0), 1.5)
    strength = np.hypot(cv2.Sobel(smooth, cv2.CV_32F, 1, 0), cv2.Sobel(smooth, cv2.CV_32F, 0, 1))
    return cv2.GaussianBlur(np.minimum(strength, np.percentile(strength, 95)), (0, 0), 1.5)
