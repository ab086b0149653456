"""Detections with masks as other programs write them: COCO files, and maps of ConceptGraphs.

Results are as the COCO API writes them (cocodataset.org, "Results Format"; `loadRes` of pycocotools): a list of
{"image_id", "category_id", "bbox": [x, y, width, height], "score"}, with "segmentation" (a run-length code) in place of
or beside the box. In the wild ids are text, masks are polygons, counts are bytes as Python prints them, and scores are
left out (then 1). Which picture and class the numbers mean stands in the annotation file. An object of `images`,
`categories` and `annotations` with scores holds both: what FiftyOne exports of detections with a confidence
(`COCOObject.to_anno_dict` of fiftyone/utils/coco.py), as demo/create_coco_dataset.py of GroundingDINO does.

`pcd_saves/full_pcd_*.pkl.gz` (concept-graphs/concept-graphs, slam/cfslam_pipeline_batch.py: a dict whose `objects` and
`bg_objects` are what `MapObjectList.to_serializable` of slam/slam_classes.py gives) and `map/scene_map_*_pruned.pkl.gz`
(scenegraph/build_scenegraph_cfslam.py: that list alone). Of an object `class_name`, `color_path`, `mask`, `xyxy` and
`conf` are lists with an entry for each picture that shows it; `bbox_np` (8, 3) are the corners of its box in the frame
of the scene's poses, metres. Its name is the tag of its caption where it has one (`caption_dict`), else the class that
was said most often. In `pcd_*.pkl.gz` of the branch ali-dev (slam/rerun_realtime_mapping.py) `class_name` is one name
and `color_path` holds Path objects.
"""

from __future__ import annotations

import ast
from collections import Counter
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from pydantic import BaseModel, BeforeValidator, Field, FiniteFloat

from pipeline.datasets.frame_names import Picture
from pipeline.geometry.masks import RunLength, decode_crop
from pipeline.system.errors import as_input_error, needed, require
from pipeline.system.frozen import dataclass
from pipeline.system.plain_pickle import plain, read_plain_pickle
from pipeline.system.reading import Content, checked, read_content

MaskCode = RunLength | str
"""The code, or the name of a file."""
Polygons = list[list[FiniteFloat]]
MOST_PIXELS = 1 << 28
"""Of a picture."""
ROUNDED = 2.0
"""Pixels by which a box may leave its picture."""


class RecordedDetection(BaseModel):
    """A detection of a recorded run."""

    label: str = Field(min_length=1)
    score: float = Field(default=1.0, ge=0, le=1)
    bbox: tuple[FiniteFloat, FiniteFloat, FiniteFloat, FiniteFloat]
    mask: MaskCode | None = None
    id: int | None = Field(default=None, ge=0, lt=2**63)


def detected(label: str, score: float | None, box: tuple[float, ...]) -> RecordedDetection:
    """Detection, without a score for None, so that `unscored` counts it."""
    told = {} if score is None else {"score": score}
    return RecordedDetection.model_validate({"label": label, "bbox": box, **told})


class Detections(dict[Picture, list[RecordedDetection]]):
    """By picture; one that the file lists and nothing was found in has an empty list."""

    def __init__(self, *found: Any) -> None:
        super().__init__(*found)
        self.assumed: list[str] = []
        """What was assumed of the file, a sentence each."""


def without_score(found: Detections) -> tuple[int, int]:
    """Number of detections whose file gives no score, and of all."""
    every = [row for rows in found.values() for row in rows]
    return sum("score" not in row.model_fields_set for row in every), len(every)


class CocoImage(BaseModel):
    """A picture of a COCO file; `frame` is spatialviz's own addition."""

    id: Picture
    file_name: str
    height: int | None = None
    width: int | None = None
    frame: str | None = None


class CocoCategory(BaseModel):
    """A class name of a COCO file."""

    id: Picture
    name: str = Field(min_length=1)


class CocoKey(BaseModel):
    """Pictures and classes by number in a COCO file."""

    images: list[CocoImage] = []
    categories: list[CocoCategory] = []


def _as_written(value: Any) -> Any:
    """A mask with counts that are printed bytes (b'...') as text, and a single polygon as a list of one."""
    if isinstance(value, dict) and isinstance(counts := value.get("counts"), str) and counts[:2] in ("b'", 'b"'):
        with suppress(ValueError, SyntaxError, MemoryError, RecursionError):
            return {**value, "counts": ast.literal_eval(counts).decode("ascii")}
    flat = isinstance(value, list) and bool(value) and not isinstance(value[0], list)
    return [value] if flat else value


class CocoResult(BaseModel):
    """A detection."""

    image_id: Picture
    category_id: Picture
    score: float | None = Field(default=None, ge=0, le=1)
    bbox: tuple[FiniteFloat, FiniteFloat, FiniteFloat, FiniteFloat] | None = None
    segmentation: Annotated[RunLength | Polygons | None, BeforeValidator(_as_written)] = None


def is_coco(content: Content) -> bool:
    """Test for a list of results, or annotations of which any has a score."""
    rows = _results(content)
    if not {"image_id", "category_id"} <= rows.first.keys():
        return False
    alone = isinstance(content.value, list) and bool({"bbox", "segmentation"} & rows.first.keys())
    return alone or any("score" in row for row in rows.value if isinstance(row, dict))


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
    images = {str(image.id): image for image in known.images}
    names = {str(category.id): category.name for category in known.categories}
    found = Detections({image.frame or image.file_name: [] for image in known.images})
    if _counts_from_zero(rows, names):
        found.assumed.append("category_id counts from 0 in the file and from 1 in the annotation file: 1 is added")
        names = {str(int(number) - 1): name for number, name in names.items() if number.isdecimal()}
    if corners := _are_corners(rows, images):
        found.assumed.append(corners)
    for k, row in enumerate(rows):
        where = content.where(k)
        image = images.get(str(row.image_id))
        expected = None if known.images else "the annotation file beside it (--key, --model-config, --with)"
        require(
            image or not images or not str(row.image_id).isdecimal(),
            f"{where}: no picture has the id {row.image_id}",
            path=key or path,
        )
        nameless = f"{where}: no class has the id {row.category_id}"
        label = needed(names.get(str(row.category_id)), nameless, expected=expected, path=path)
        mask = _code(row.segmentation, image, where, path)
        picture = row.image_id if image is None else image.frame or image.file_name
        box = row.bbox if corners and row.bbox else _corners(row, mask, where, path)
        detection = detected(label, row.score, box)
        detection.mask = mask
        found.setdefault(picture, []).append(detection)
    return found


def _counts_from_zero(rows: list[CocoResult], names: dict[str, str]) -> bool:
    """True for classes by a network's own index, where the annotation file has no 0 (ultralytics/ultralytics#18136)."""
    ids = {str(row.category_id) for row in rows}
    return "0" in ids - names.keys() and all(i.isdecimal() and str(int(i) + 1) in names for i in ids)


def _are_corners(rows: list[CocoResult], images: dict[str, CocoImage]) -> str:
    """Words for boxes of two corners, as other tools have them, by how they lie in their pictures; else empty."""
    sized = [(row.bbox, images[str(row.image_id)]) for row in rows if row.bbox and str(row.image_id) in images]
    known = [
        (*box, image.width + ROUNDED, image.height + ROUNDED) for box, image in sized if image.width and image.height
    ]
    within = [x + w <= width and y + h <= height for x, y, w, h, width, height in known]
    of_corners = all(x <= w <= width and y <= h <= height for x, y, w, h, width, height in known)
    if all(within) or not of_corners:
        return ""
    return (
        f"bbox is read as two corners, not as corner and size: so all {len(known)} boxes lie in their pictures, "
        f"and else {sum(within)}"
    )


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


ENDINGS = (".pkl.gz", ".pkl")
Corners = tuple[tuple[float, float, float], ...]


@dataclass(frozen=True)
class SceneMap:
    """A map."""

    detections: Detections  # What was found in each picture; the ids are the objects' numbers in the file
    corners: dict[int, Corners]  # By object: the eight corners of its box in the world, metres


def read_map(path: Path) -> Content:
    """A map as the content of a file."""
    content = read_plain_pickle(path, _compact)
    found = [content.get(key) or [] for key in ("objects", "bg_objects")] if isinstance(content, dict) else [content]
    require(
        all(isinstance(part, list) and all(isinstance(o, dict) for o in part) for part in found) and any(found),
        "the pickle is no map of ConceptGraphs",
        expected="a list of objects, or a dict with one under 'objects'",
        path=path,
    )
    detections = Detections()
    corners: dict[int, Corners] = {}
    for number, thing in enumerate([thing for part in found for thing in part]):
        wrong, errors = f"object {number}: not as ConceptGraphs writes it", (KeyError, TypeError, ValueError)
        with as_input_error(wrong, *errors, got=_told, path=path):
            box = np.asarray(plain(thing["bbox_np"]), np.float64)
            require(
                box.shape == (8, 3) and np.isfinite(box).all(),
                f"object {number}, bbox_np: eight corners are asked for",
                got=box.shape,
                path=path,
            )
            corners[number] = tuple((float(x), float(y), float(z)) for x, y, z in box)
            name = _name(thing)
            views = zip(thing["color_path"], thing["mask"], thing["xyxy"], thing["conf"], strict=True)
            for picture, mask, xyxy, score in views:
                box_2d = tuple(float(v) for v in np.asarray(plain(xyxy)).ravel())
                row = {"label": name, "score": float(plain(score)), "bbox": box_2d, "mask": plain(mask), "id": number}
                found_there = checked(RecordedDetection.model_validate, row, f"{wrong}, at {{}}", path)
                detections.setdefault(str(picture), []).append(found_there)
    return Content(SceneMap(detections, corners), path)


def _compact(array: np.ndarray) -> Any:
    """Masks as run lengths, to save memory."""
    return RunLength.of(array) if array.ndim == 2 and array.dtype == np.bool_ and array.size else array


def _name(thing: dict[str, Any]) -> str:
    response = (thing.get("caption_dict") or {}).get("response") or {}
    tag = response.get("object_tag") if isinstance(response, dict) else None
    said = thing["class_name"]
    return str(tag or (said if isinstance(said, str) else Counter(said).most_common(1)[0][0]))


def _told(error: Exception) -> str:
    return f"no {error}" if isinstance(error, KeyError) else str(error)


def map_detections(content: Content, key: Path | None) -> Detections:
    """Detections of a map by picture."""
    scene: SceneMap = content.value
    return scene.detections
