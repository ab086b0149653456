"""A decision map as a picture: seen from above, the viewer below and looking up the page."""

from __future__ import annotations

import cv2
import numpy as np

from pipeline.diagnosis.whatif.decision_map import DecisionMap
from pipeline.diagnosis.whatif.rerun import Outcome
from pipeline.geometry.palette import instance_colors
from pipeline.relations.scorer import stacked_extents

CELL_PIXELS = 12
_INK, _PAPER, _NOTHING = (20, 20, 20), (245, 245, 245), (200, 200, 200)
_LINE_PIXELS = 22


def map_picture(found: DecisionMap, outcome: Outcome) -> np.ndarray:
    """(H, W, 3) uint8 RGB: each cell in the colour of its winner, paler where the margin is small.

    The outlines are those of the other objects' extents. Below stand the winners with their share of the floor.
    """
    colors = instance_colors(len(found.keys)).astype(np.float64)
    cells = np.where((found.winner >= 0)[..., None], colors[np.maximum(found.winner, 0)], np.array(_NOTHING, float))
    strength = (0.35 + 0.65 * np.clip(found.margin, 0, 1))[..., None]
    cells = np.round(cells * strength + 255 * (1 - strength)).astype(np.uint8)
    # Far is up on the page.
    image = np.ascontiguousarray(np.kron(cells[::-1], np.ones((CELL_PIXELS, CELL_PIXELS, 1), np.uint8)))
    lo, hi = stacked_extents([o.lifted for o in outcome.trace.objects])
    step_r, step_f = (float(axis[1] - axis[0]) for axis in (found.right, found.forward))
    left, near = found.right[0] - step_r / 2, found.forward[0] - step_f / 2
    for k, key in enumerate(found.keys):
        if not np.isfinite(lo[k]).all():
            continue
        x0, x1 = (round((v - left) / step_r * CELL_PIXELS) for v in (lo[k, 0], hi[k, 0]))
        y0, y1 = (image.shape[0] - round((v - near) / step_f * CELL_PIXELS) for v in (hi[k, 2], lo[k, 2]))
        cv2.rectangle(image, (x0, y0), (x1, y1), _INK, 1 if key != found.key else 2)
        _write(image, key, (x0 + 2, min(y1 - 3, image.shape[0] - 3)), 0.35)
    return np.concatenate([image, _legend(found, outcome, image.shape[1], colors)])


def _legend(found: DecisionMap, outcome: Outcome, width: int, colors: np.ndarray) -> np.ndarray:
    winners, counts = np.unique(found.winner, return_counts=True)
    strip = np.full((_LINE_PIXELS * (len(winners) + 1) + 8, width, 3), _PAPER, np.uint8)
    _write(strip, f"{outcome.trace.query.text}: who wins where {found.key} stands", (8, _LINE_PIXELS - 4), 0.45)
    for line, (winner, count) in enumerate(sorted(zip(winners.tolist(), counts.tolist(), strict=True)), start=2):
        base = line * _LINE_PIXELS - 4
        color = _NOTHING if winner < 0 else tuple(int(c) for c in colors[winner])
        cv2.rectangle(strip, (8, base - 12), (22, base + 2), color, -1)
        label = "no pair" if winner < 0 else f"{outcome.trace.objects[winner].label} {found.keys[winner]}"
        _write(strip, f"{label}: {count / found.winner.size:.0%} of the floor", (30, base), 0.45)
    return strip


def _write(image: np.ndarray, text: str, at: tuple[int, int], scale: float) -> None:
    plain = text.encode("ascii", "replace").decode()
    cv2.putText(image, plain, at, cv2.FONT_HERSHEY_SIMPLEX, scale, _INK, 1, cv2.LINE_AA)
