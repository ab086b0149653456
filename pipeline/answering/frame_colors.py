"""Colours of a frame's pixels: of the picture, by object, by depth, or by fate in lifting."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from pipeline.answering.objects import SceneObject
from pipeline.geometry.frame import Frame
from pipeline.geometry.lifting import Pixel
from pipeline.geometry.palette import DROPPED, Role, depth_colors, instance_colors, palette


def frame_colors(
    mode: str, frame: Frame, objects: Sequence[SceneObject], roles: Mapping[int, Role], dark: bool
) -> np.ndarray:
    """(H, W, 3) uint8 colours of a frame's pixels.

    `mode`: "rgb", "objects" (masks in colours, the larger below), "depth" or "evidence" (what was cleaned away, and
    why); `objects`: without any, "objects" and "evidence" are the picture itself; `roles`: mapping of int to Role:
    places in `objects` that have the colour of a role.
    """
    if mode == "depth":
        return depth_colors(frame.depth)
    if mode == "rgb" or not objects:
        return frame.rgb
    grey = np.repeat(frame.rgb.mean(axis=2, keepdims=True), 3, axis=2)
    image = (grey * 0.55 + (20 if dark else 110)).astype(np.uint8)
    order = sorted(range(len(objects)), key=lambda i: -int(objects[i].lifted.quality.mask_pixels))
    if mode == "objects":
        calm, role_colors = instance_colors(len(objects)), palette(dark)
        for i in order:
            color = role_colors[roles[i]] if i in roles else calm[i]
            mask = objects[i].mask
            image[mask] = (image[mask] * 0.35 + np.array(color) * 0.65).astype(np.uint8)
        return image
    for i in order:
        evidence = objects[i].lifted.evidence
        if evidence is None:
            continue
        h, w = evidence.codes.shape
        window = image[evidence.y0 : evidence.y0 + h, evidence.x0 : evidence.x0 + w]
        source = frame.rgb[evidence.y0 : evidence.y0 + h, evidence.x0 : evidence.x0 + w]
        kept = evidence.codes == Pixel.KEPT
        window[kept] = source[kept]
        for reason, color in DROPPED.items():
            window[evidence.codes == reason] = color
    return image
