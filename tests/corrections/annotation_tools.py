"""What annotation tools make of a COCO export: their own numbers, polygons, rounded coordinates, none of our keys."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np

from pipeline.geometry import decode_run_length


def polygons(mask: np.ndarray) -> list[list[float]]:
    """Outer outlines through the centres of border pixels, as OpenCV finds them."""
    outlines, _ = cv2.findContours(mask.astype(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_SIMPLE)
    return [[round(float(x), 2) for x in o.ravel()] for o in outlines if len(o) >= 3]


def through_cvat(instances: dict[str, Any], *, attributes: bool) -> dict[str, Any]:
    """The file as CVAT exports it after importing it and changing nothing.

    Parameters
    ----------
    attributes : bool
        Its project knows the attribute `object`, and keeps it.
    """
    images = [
        {
            "id": k,
            "width": i["width"],
            "height": i["height"],
            "file_name": i["file_name"],
            "license": 0,
            "flickr_url": "",
            "coco_url": "",
            "date_captured": 0,
        }
        for k, i in enumerate(reversed(instances["images"]), start=1)
    ]
    again = {i["id"]: k for k, i in enumerate(reversed(instances["images"]), start=1)}
    size = {i["id"]: (i["height"], i["width"]) for i in instances["images"]}
    annotations = []
    for a in sorted(instances["annotations"], key=lambda a: (a["category_id"], -a["id"])):
        outline = a["segmentation"]
        if isinstance(outline, dict):
            outline = polygons(decode_run_length(size[a["image_id"]], outline["counts"]))
        corners = np.reshape([x for p in outline for x in p], (-1, 2))
        if not len(corners):
            continue
        low, high = corners.min(axis=0), corners.max(axis=0)
        kept = {"object": a["object"]} if attributes else {}
        annotations.append(
            {
                "id": len(annotations) + 1,
                "image_id": again[a["image_id"]],
                "category_id": a["category_id"] + 7,
                "segmentation": outline,
                "area": float(np.prod(high - low)),
                "iscrowd": 0,
                "bbox": np.round([*low, *(high - low)], 2).tolist(),
                "attributes": {"occluded": False, **kept},
            }
        )
    categories = [{**c, "id": c["id"] + 7, "supercategory": ""} for c in instances["categories"]]
    info = {"contributor": "", "date_created": "", "description": "", "url": "", "version": "", "year": ""}
    return {"licenses": [], "info": info, "categories": categories, "images": images, "annotations": annotations}
