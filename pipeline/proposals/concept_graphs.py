"""Maps of ConceptGraphs: objects fused over the pictures of a scene, each with masks, boxes and scores.

`pcd_saves/full_pcd_*.pkl.gz` (concept-graphs/concept-graphs, slam/cfslam_pipeline_batch.py: a dict whose `objects` and
`bg_objects` are what `MapObjectList.to_serializable` of slam/slam_classes.py gives) and `map/scene_map_*_pruned.pkl.gz`
(scenegraph/build_scenegraph_cfslam.py: that list alone). Of an object `class_name`, `color_path`, `mask`, `xyxy` and
`conf` are lists with an entry for each picture that shows it; `bbox_np` (8, 3) are the corners of its box in the frame
of the scene's poses, metres. Its name is the tag of its caption where it has one (`caption_dict`), else the class that
was said most often. In `pcd_*.pkl.gz` of the branch ali-dev (slam/rerun_realtime_mapping.py) `class_name` is one name
and `color_path` holds Path objects.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from pipeline.geometry.masks import RunLength
from pipeline.proposals.coco_files import Detections, RecordedDetection
from pipeline.system.errors import as_input_error, require
from pipeline.system.plain_pickle import plain, read_plain_pickle
from pipeline.system.reading import Content, checked

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
    detections: Detections = {}
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
