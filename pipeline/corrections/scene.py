"""The labelled objects of a frame in 3D, with the boxes that the labels have."""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import numpy as np

from pipeline.answering.objects import SceneObject
from pipeline.corrections.journal.effective_frame import EffectiveFrame
from pipeline.geometry.boxes import Box3D
from pipeline.geometry.lifting import LiftedObject, Quality
from pipeline.geometry.masks import decode_crop
from pipeline.proposals.annotations import box_mask
from pipeline.system.errors import InputError


@lru_cache(maxsize=3)
def labelled_objects(frame: EffectiveFrame) -> tuple[SceneObject, ...]:
    """Everything that stands in a frame, in the order of the numbers; `id` is the object's number in the labels.

    Points are not read: what is known of an object is what its row says.
    """
    size = frame.row["height"], frame.row["width"]
    return tuple(_labelled(frame.objects[n], size) for n in sorted(frame.objects))


def labelled_box(row: dict[str, Any]) -> Box3D | None:
    """The 3D box of a row of `objects` (camera frame); None where it has none."""
    if row["center"] is None or not np.isfinite(np.array(row["center"], np.float64)).all():
        return None
    try:
        return Box3D(np.array(row["center"], np.float64), np.array(row["R"], np.float64).reshape(3, 3),
                     np.array(row["size"], np.float64))  # fmt: skip
    except (InputError, TypeError, ValueError):
        return None


def _labelled(row: dict[str, Any], size: tuple[int, int]) -> SceneObject:
    bbox = np.array(row["bbox"], np.float32)
    if row["mask"] is None:
        mask = box_mask(bbox, *size)
        pixels = int(mask.sum())
    else:
        crop = _crop(size, row["mask"], f"object {row['object']}")
        mask, pixels = np.zeros(size, np.bool_), int(crop.mask.sum())
        crop.paint(mask)

    def number(name: str, nothing: float) -> float:
        return nothing if row[name] is None else float(row[name])

    quality = Quality(
        pixels, int(number("points", 0)), number("kept", 0.0), number("depth_missing", 0.0),
        bool(row["touches_border"]), number("distance", float("nan")), bool(row["fallback"]),
        row["mask_source"] or "box",
    )  # fmt: skip
    lo, hi = (np.full(3, np.nan) if row[k] is None else np.array(row[k], np.float64) for k in ("lo", "hi"))
    lifted = LiftedObject(
        np.empty((0, 3), np.float32), labelled_box(row), number("yaw_confidence", 0.0), lo, hi, "box", None, quality
    )
    return SceneObject(row["object"], row["label"], number("score", 1.0), bbox, mask, lifted)


# An edit changes one object of a frame; the pixels of the others are known already.
_crop = lru_cache(maxsize=256)(decode_crop)
