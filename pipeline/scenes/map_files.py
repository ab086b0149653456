"""Object maps as files: a folder with an .npz file a scene, whole and of a version, to be read and gone on from."""

from __future__ import annotations

import io
import json
from dataclasses import replace
from pathlib import Path
from typing import Any
from urllib.parse import quote, unquote

import numpy as np

from pipeline.datasets.base import Dataset, load_pose
from pipeline.datasets.cameras import or_note
from pipeline.scenes.joining import Join, Joining
from pipeline.scenes.object_map import ObjectMap, WorldObject
from pipeline.scenes.poses import PoseAgreement, Refinement
from pipeline.scenes.voxels import Voxels
from pipeline.scenes.world_boxes import NUMBERS, ViewBox
from pipeline.system.errors import as_input_error, require
from pipeline.system.frozen import dataclass
from pipeline.system.reading import checked
from pipeline.system.safe_files import opened_arrays, parse_json
from pipeline.system.whole_files import write_whole

VERSION = 2
NO_BOX = np.full(NUMBERS, np.nan)
"""Row of an object of a view that has no box."""
SUFFIX = ".npz"


@dataclass(frozen=True)
class _Stored:
    """What a file says of a map beside its arrays."""

    version: int
    scene: str
    settings: dict[str, str]
    listed: tuple[str, ...]
    posed: tuple[str, ...]
    left_out: dict[str, str]
    agreements: tuple[PoseAgreement, ...]
    refinements: tuple[Refinement, ...]
    joins: tuple[Join, ...]
    objects: tuple[WorldObject, ...]


def map_path(folder: Path, scene: str) -> Path:
    """File of a scene's map in a folder of maps."""
    return folder / f"{quote(scene, safe=' ')}{SUFFIX}"


def save_map(made: ObjectMap, folder: Path) -> Path:
    """Write a scene's map into a folder, made if missing; the same map gives the same bytes; see `write_whole`."""
    table: dict[str, Any] = {name: getattr(made, name) for name in ("scene", "settings", "listed", "left_out")}
    table |= {"version": VERSION, "posed": list(made.poses), "joins": [vars(j) for j in made.joining.joins]}
    table |= {name: [vars(one) for one in getattr(made, name)] for name in ("agreements", "refinements", "objects")}
    text = json.dumps(table, ensure_ascii=False, allow_nan=False)
    file = io.BytesIO()
    np.savez_compressed(
        file,
        table=np.frombuffer(text.encode(), np.uint8),
        declared=_stacked(made.declared),
        poses=_stacked(made.poses),
        pairs=made.joining.voxels.pairs,
        counts=made.joining.voxels.counts,
        boxes=np.array([NO_BOX if box is None else box.row for box in made.joining.boxes]).reshape(-1, NUMBERS),
    )
    path = map_path(folder, made.scene)
    write_whole(path, file.getvalue(), "the map")
    return path


def _stacked(poses: Any) -> np.ndarray:
    return np.array(list(poses.values()), np.float64).reshape(-1, 4, 4)


def read_map(path: Path) -> ObjectMap:
    """Read a scene's map.

    Raises
    ------
    InputError
        No map of this version, damaged, or larger than the limits.

    >>> import tempfile
    >>> from pipeline.answering.pipeline import open_pipeline
    >>> from pipeline.scenes.map_files import read_map, save_map
    >>> from pipeline.scenes.object_map import map_scene
    >>> made = map_scene(open_pipeline("demo"), "000001", ["000001/000000", "000001/000001"])
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     read = read_map(save_map(made, Path(folder)))
    >>> read.objects == made.objects
    True
    """
    from pydantic import TypeAdapter

    wrong = "this is no map that `spatialviz map` wrote, or a damaged one"
    with as_input_error(wrong, Exception, path=path), opened_arrays(path) as arrays:
        text = parse_json(arrays["table"].astype(np.uint8, casting="no").tobytes(), path)
        declared, poses = (arrays[name].astype(np.float64, casting="no") for name in ("declared", "poses"))
        version = text.get("version") if isinstance(text, dict) else None
        require(version in (1, VERSION), "the map is of another version", got=version, expected=VERSION, path=path)
        pairs = arrays["pairs"].astype(np.int64, casting="no")
        counts = arrays["counts"].astype(np.int32, casting="no")
        rows = None if version == 1 else arrays["boxes"].astype(np.float64, casting="no").reshape(-1, NUMBERS)
    table = checked(TypeAdapter(_Stored).validate_python, text, f"{wrong}: {{}}", path)
    if rows is None:
        # The first version had no boxes: whoever goes on from it makes it anew.
        table = replace(table, settings={**table.settings, "version": "1"})
        rows = np.broadcast_to(NO_BOX, (len(table.joins), NUMBERS))
    boxes = [ViewBox.of_row(row) if np.isfinite(row).all() else None for row in rows]
    sound = pairs.ndim == 1 and pairs.shape == counts.shape and (np.diff(pairs) > 0).all()
    ids = {join.object_id for join in table.joins}
    sound = sound and len(boxes) == len(table.joins) and ids == set(range(len(ids)))
    sound = sound and {o.id for o in table.objects} <= ids
    sound = sound and declared.shape == poses.shape == (len(table.posed), 4, 4)
    voxels = Voxels(pairs, counts)
    require(sound and voxels.sizes().keys() <= {-1, *ids}, wrong, path=path)
    return ObjectMap(
        table.scene,
        table.settings,
        table.listed,
        dict(zip(table.posed, declared, strict=True)),
        dict(zip(table.posed, poses, strict=True)),
        table.agreements,
        table.refinements,
        table.left_out,
        Joining(voxels, table.joins, boxes),
        table.objects,
    )


def check_map(made: ObjectMap, dataset: Dataset, path: Path) -> bool:
    """Tell a map of the dataset's frames from one of others; InputError for other poses, or if only some are known."""
    known = set(dataset.frame_ids)
    absent = [i for i in made.declared if i not in known]
    if len(absent) == len(made.declared):
        return False
    again = "make it anew: spatialviz map DATASET --out MAP"
    require(not absent, "the map has frames that the dataset lacks", got=absent[:3], expected=again, path=path)
    for i, pose in made.declared.items():
        now = or_note([], "", load_pose, dataset, i)
        same = now is not None and np.array_equal(now, pose)
        require(same, f"the map was made with another pose of frame {i}", expected=again, path=path)
    return True


def read_maps(folder: Path, dataset: Dataset | None = None) -> dict[str, ObjectMap]:
    """Read the maps of a folder, by scene, in the order of names; of a dataset only those of its scenes.

    InputError for none, a broken one, or as of `check_map`.
    """
    paths = sorted(folder.glob(f"*{SUFFIX}")) if folder.is_dir() else []
    require(
        paths, "the folder holds no object map", expected="what `spatialviz map DATASET --out MAP` wrote", path=folder
    )
    found = {unquote(path.name.removesuffix(SUFFIX)): read_map(path) for path in paths}
    if dataset is not None:
        found = {k: made for k, made in found.items() if check_map(made, dataset, map_path(folder, k))}
        require(found, "the folder holds maps of another dataset", expected=f"maps of {dataset.root}", path=folder)
    return found
