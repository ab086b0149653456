"""Boxes as DETR-like networks give them: centre and size as shares of the picture."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from pipeline.geometry.frame import Frame
from pipeline.proposals.base import Proposals


def to_pixels(relative: np.ndarray, width: float, height: float, frame: Frame) -> np.ndarray:
    """(N, 4) float32 x0, y0, x1, y1 in pixels of the frame, clipped to it.

    Parameters
    ----------
    relative : (N, 4) float
        Centre and size as shares of what the network saw.
    width, height : float
        The size of that in pixels of the frame: the frame itself, or the square it was padded to.
    frame : Frame
    """
    center, size = relative[:, :2].astype(np.float64), np.maximum(relative[:, 2:].astype(np.float64), 0)
    boxes = np.concatenate([center - size / 2, center + size / 2], axis=1) * [width, height, width, height]
    return np.clip(boxes, 0, [frame.width, frame.height] * 2).astype(np.float32)


def proposals_of(
    boxes: np.ndarray, scores: np.ndarray, names: np.ndarray, labels: Sequence[str], ids: np.ndarray, frame: Frame
) -> Proposals:
    """Proposals without masks; boxes with nothing of them in the picture are left out."""
    inside = (boxes[:, 2] > boxes[:, 0]) & (boxes[:, 3] > boxes[:, 1])
    return Proposals(
        boxes[inside].astype(np.float32),
        np.clip(scores[inside], 0, 1).astype(np.float32),
        names[inside].astype(np.int64),
        tuple(labels),
        None,
        ids[inside].astype(np.int64),
    )


def box_output(session: Any) -> str | None:
    """The name of the output (1, Q, 4), by its usual name or else by its shape."""
    outputs = session.get_outputs()
    named = [o.name for o in outputs if o.name in ("pred_boxes", "boxes")]
    shaped = [o.name for o in outputs if len(o.shape) == 3 and o.shape[2] == 4]
    return next(iter(named + shaped), None)
