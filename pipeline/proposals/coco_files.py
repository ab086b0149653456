"""COCO files: pictures, classes, polygons, and detector results.

Results are as the COCO API writes them (cocodataset.org, "Results Format"; `loadRes` of pycocotools): a list of
{"image_id", "category_id", "bbox": [x, y, width, height], "score"}, with "segmentation" (a run-length code) in place of
or beside the box. Which picture and class the numbers mean stands in the annotation file. An object of `images`,
`categories` and `annotations` with scores holds both: what FiftyOne exports of detections with a confidence
(`COCOObject.to_anno_dict` of fiftyone/utils/coco.py), as demo/create_coco_dataset.py of GroundingDINO does.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import BaseModel, Field, FiniteFloat

from pipeline.datasets.frame_names import Picture
from pipeline.geometry.masks import RunLength, decode_crop
from pipeline.system.errors import needed, require
from pipeline.system.reading import Content, checked, read_content

MaskCode = RunLength | str
"""The code, or the name of a file."""
Polygons = list[list[FiniteFloat]]
MOST_PIXELS = 1 << 28
"""Of a picture."""


class RecordedDetection(BaseModel):
    """A detection of a recorded run."""

    label: str = Field(min_length=1)
    score: float = Field(ge=0, le=1)
    bbox: tuple[FiniteFloat, FiniteFloat, FiniteFloat, FiniteFloat]
    mask: MaskCode | None = None
    id: int | None = Field(default=None, ge=0, lt=2**63)


Detections = dict[Picture, list[RecordedDetection]]
"""By picture; one that the file lists and nothing was found in has an empty list."""


class CocoImage(BaseModel):
    """A picture of a COCO file; `frame` is spatialviz's own addition."""

    id: int
    file_name: str
    height: int | None = None
    width: int | None = None
    frame: str | None = None


class CocoCategory(BaseModel):
    """A class name of a COCO file."""

    id: int
    name: str = Field(min_length=1)


class CocoKey(BaseModel):
    """Pictures and classes by number in a COCO file."""

    images: list[CocoImage] = []
    categories: list[CocoCategory] = []


class CocoResult(BaseModel):
    """A detection."""

    image_id: Picture
    category_id: int
    score: float = Field(ge=0, le=1)
    bbox: tuple[FiniteFloat, FiniteFloat, FiniteFloat, FiniteFloat] | None = None
    segmentation: RunLength | Polygons | None = None


def is_coco(content: Content) -> bool:
    """Test for results, or annotations with scores."""
    return {"image_id", "category_id", "score"} <= _results(content).first.keys()


def scored(content: Content) -> Content:
    """Annotations without scores as results with score 1; those without a class are things."""
    value = content.value
    if not isinstance(value, dict) or not isinstance(value.get("annotations"), list):
        return content
    whole = {"score": 1.0, "category_id": -1}
    rows = [whole | row if isinstance(row, dict) else row for row in value["annotations"]]
    classes = [*(value.get("categories") or ()), {"id": -1, "name": "thing"}]
    return replace(content, value=value | {"annotations": rows, "categories": classes})


def _results(content: Content) -> Content:
    """List of results, also inside an object."""
    inside = isinstance(content.value, dict) and "annotations" in content.value
    return replace(content, value=content.value["annotations"]) if inside else content


def coco_detections(content: Content, key: Path | None) -> Detections:
    """The detections of a file, boxes as corners."""
    path = content.path
    told = read_content(key).value if key is not None else content.value if isinstance(content.value, dict) else {}
    known = checked(CocoKey.model_validate, told, "not an annotation file of COCO at {}", key or path)
    rows = _results(content).rows(CocoResult.model_validate, "not a result of COCO")
    images = {image.id: image for image in known.images}
    names = {category.id: category.name for category in known.categories}
    found: Detections = {image.frame or image.file_name: [] for image in known.images}
    for k, row in enumerate(rows):
        where = content.where(k)
        image = images.get(row.image_id) if isinstance(row.image_id, int) else None
        expected = None if known.images else "the annotation file beside it (--key, --model-config, --with)"
        require(
            image or not images or not isinstance(row.image_id, int),
            f"{where}: no picture has the id {row.image_id}",
            path=key or path,
        )
        nameless = f"{where}: no class has the id {row.category_id}"
        label = needed(names.get(row.category_id), nameless, expected=expected, path=path)
        mask = _code(row.segmentation, image, where, path)
        picture = row.image_id if image is None else image.frame or image.file_name
        box = _corners(row, mask, where, path)
        found.setdefault(picture, []).append(RecordedDetection(label=label, score=row.score, bbox=box, mask=mask))
    return found


def _corners(row: CocoResult, mask: RunLength | None, where: str, path: Path) -> tuple[float, float, float, float]:
    if row.bbox is None:
        code = needed(mask, f"{where}: neither a box nor a mask", cause="are these keypoints?", path=path)
        return decode_crop(code.size, code.counts, where, path).box
    x, y, w, h = row.bbox
    require(w >= 0 and h >= 0, f"{where}: bbox is x, y, width, height", got=list(row.bbox), path=path)
    return x, y, x + w, y + h


def _code(content: RunLength | Polygons | None, image: CocoImage | None, where: str, path: Path) -> RunLength | None:
    if not content:  # Files of boxes have an empty list.
        return None
    from pycocotools import mask as coco

    told = None if image is None or image.height is None or image.width is None else (image.height, image.width)
    size = content.size if isinstance(content, RunLength) else told
    shape = needed(size, f"{where}: a polygon, and the picture's height and width are not told", path=path)
    possible = min(shape) > 0 and shape[0] * shape[1] <= MOST_PIXELS
    require(possible, f"{where}: a picture of impossible size", got=shape, path=path)
    if isinstance(content, RunLength):
        return content
    require(
        not any(len(p) < 6 or len(p) % 2 for p in content),
        f"{where}: a polygon needs x, y of three corners or more",
        path=path,
    )
    clipped = [np.clip(np.reshape(p, (-1, 2)), 0, shape[::-1]).ravel().tolist() for p in content]
    encoded: Any = coco.merge(coco.frPyObjects(clipped, *shape))
    return RunLength(shape, encoded["counts"].decode("ascii"))
