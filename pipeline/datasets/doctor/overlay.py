"""Depth outlines over colour, before and after the fixes, side by side."""

from __future__ import annotations

import cv2
import numpy as np

from pipeline.datasets.doctor.examine import Examination
from pipeline.geometry.frame import Frame
from pipeline.geometry.outlines import Outlines
from pipeline.geometry.registration import Registration

ON_EDGE, OFF_EDGE = (40, 220, 90), (255, 50, 60)
"""RGB of outlines that lie on an edge of colour, and of those that do not."""
MOST_FRAMES = 4
FADED = 0.55


def overlay(found: Examination, most: int = MOST_FRAMES) -> np.ndarray:
    """Draw examined frames with depth outlines: left as read, right with the fixes applied.

    Where nothing is mended, the right is as the left.

    Returns
    -------
    (H, W, 3) uint8
        RGB; outlines of depth are green where they lie on edges of colour, else red.

    Examples
    --------
    >>> from pipeline.datasets import demo_path, examine, overlay
    >>> picture = overlay(examine(demo_path()), most=1)  # doctest: +SKIP
    >>> picture.shape  # doctest: +SKIP
    (480, 1280, 3)
    """
    mended = {frame.id: frame for frame in found.mended}
    shown = [frame for frame in found.as_read if frame.id in mended]
    shown = [shown[k] for k in np.unique(np.linspace(0, len(shown) - 1, min(most, len(shown))).astype(int))]
    return np.concatenate([np.concatenate([outlined(f), outlined(mended[f.id])], axis=1) for f in shown])


def outlined(frame: Frame) -> np.ndarray:
    """Faded colour (H, W, 3) uint8 of a frame with depth outlines."""
    out = cv2.addWeighted(frame.rgb, FADED, np.full_like(frame.rgb, 255), 1 - FADED, 0)
    found = Outlines.of([frame])
    near = found.near(Registration.none(frame.camera))
    size = max(1, round(frame.width / 640))
    for u, v, on in zip(found.u, found.v, near > 0.5, strict=True):
        cv2.circle(out, (int(u), int(v)), size, ON_EDGE if on else OFF_EDGE, -1)
    return out
