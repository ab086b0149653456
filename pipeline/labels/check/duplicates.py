"""Objects that are one thing twice: by their masks in the picture, and by their boxes in space."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from pipeline.geometry.boxes import Box3D, iou_3d
from pipeline.labels.check.findings import Finding
from pipeline.labels.check.objects import cleared, corners_of
from pipeline.labels.check.runs import MaskRuns, runs_object
from pipeline.labels.check.view import FrameView, pairs_where
from pipeline.system.errors import InputError

SAME_NAME_IOU = 0.7
OTHER_NAME_IOU = 0.9


def check_duplicates(view: FrameView) -> Iterator[Finding]:
    """Pairs of objects that share their pixels or their place."""
    if len(view.ids) < 2:
        return
    masks, boxes = mask_overlaps(view), box_overlaps(view, view.alike)
    same = view.alike & ((masks >= SAME_NAME_IOU) | (boxes >= SAME_NAME_IOU))
    other = ~view.alike & (masks >= OTHER_NAME_IOU)
    for a, b in pairs_where(np.triu(same | other, 1)):
        names = f"{view.named(a)} and {view.named(b)}"
        yield view.finding(
            "object/duplicate",
            (view.ids[a], view.ids[b]),
            f"{names} are one thing: their masks overlap by {masks[a, b]:.0%}, their boxes by {boxes[a, b]:.0%}"
            if same[a, b]
            else f"{names} share {masks[a, b]:.0%} of their pixels: one thing under two names?",
            {"mask_iou": masks[a, b], "box_iou": boxes[a, b]},
            "error" if same[a, b] else "warning",
        )


def mask_overlaps(view: FrameView) -> np.ndarray:
    """(N, N) float64 IoU of the masks; 0 where one cannot be read."""
    found = np.zeros((len(view.ids), len(view.ids)))
    sound = [k for k, run in enumerate(view.runs) if isinstance(run, MaskRuns) and run.area]
    if len(sound) < 2:
        return found
    from pycocotools import mask as coco

    codes = [runs_object(str(view.objects["mask"][k]), *view.size) for k in sound]
    found[np.ix_(sound, sound)] = coco.iou(codes, codes, np.zeros(len(codes), np.uint8))
    return found


def box_overlaps(view: FrameView, wanted: np.ndarray) -> np.ndarray:
    """(N, N) float64 IoU of the 3D boxes of the wanted pairs, where it can reach SAME_NAME_IOU; else 0."""
    objects = view.objects
    center, rotation, size = objects["center"], objects["R"].reshape(-1, 3, 3), objects["size"]
    known = np.isfinite(center).all(axis=1) & np.isfinite(rotation).all(axis=(1, 2))
    known = np.asarray(known & (size > 0).all(axis=1))
    found = np.zeros((len(center), len(center)))
    if known.sum() < 2:
        return found
    corners = corners_of(*cleared(known, center, rotation, size))
    low, high, volume = corners.min(axis=1), corners.max(axis=1), np.where(known, size.prod(axis=1), 1.0)
    # No solid is larger than the box around it, and no union smaller than the larger of two.
    shared = np.clip(np.minimum(high[:, None], high[None]) - np.maximum(low[:, None], low[None]), 0, None).prod(axis=2)
    larger, smaller = np.maximum(volume[:, None], volume[None]), np.minimum(volume[:, None], volume[None])
    possible = wanted & known[:, None] & known[None, :] & (np.minimum(shared, smaller) >= SAME_NAME_IOU * larger)
    for a, b in pairs_where(np.triu(possible, 1)):
        try:
            boxes = [Box3D(center[k], rotation[k], size[k]) for k in (a, b)]
        except InputError:
            continue
        found[a, b] = found[b, a] = iou_3d(*boxes)
    return found
