"""Semantic Abstraction: AI2-THOR views as HDF5 files, with masks, whole-object points and expressions.

https://github.com/columbia-ai-robotics/semantic-abstraction
"""

from __future__ import annotations

import os
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from pipeline.datasets.base import DatasetFormat, GivenExpression, unknown_frame
from pipeline.datasets.cameras import make_camera, or_note
from pipeline.datasets.files import natural, readable
from pipeline.datasets.recording import Recording
from pipeline.datasets.semantic_abstraction_file import (
    RANDOMIZED,
    RENAMED,
    SUFFIXES,
    SYNONYMS,
    has,
    item_count,
    open_view,
    read_array,
    read_classes,
    read_integers,
    read_item,
    read_names,
    read_split,
    split_files,
    view_name,
    with_synonyms,
)
from pipeline.datasets.semantic_abstraction_objects import (
    SCENE_BOUNDS,
    ObjectPoints,
    ScenePose,
    annotated_objects,
    depth_samples,
    fit_pose,
    object_ids,
    points_of,
)
from pipeline.datasets.settings import Settings
from pipeline.geometry.camera import Camera, lift_pixels
from pipeline.geometry.frame import Frame
from pipeline.language.relation import SEMANTIC_ABSTRACTION
from pipeline.system.errors import InputError, require

SUFFIX = ".hdf5"
LEVELS = 3
"""How deep files lie at most below the opened folder."""
NOT_AN_OBJECT = frozenset({"empty", "out of bounds", "unlabelled"})
LARGEST_ID = 1_000_000
MOST_OBJECTS = 2000
"""Objects are numbered by their place in one list of names, and a view shows some dozens of them."""
LARGEST_SCENE = 100.0

RELATIONS = {words: name for name, words in SEMANTIC_ABSTRACTION.items()}
"""The dataset's six relations and what we call them."""


NO_POSE = "no camera pose and no 3D boxes"


@dataclass(frozen=True)
class _FileScene:
    """Scene data of a file: cam_pose (4, 4), points (M, 3) with objects (M,), bounds (2, 3)."""

    cam_pose: np.ndarray
    xyz: np.ndarray
    owner: np.ndarray
    bounds: np.ndarray


class SemanticAbstractionDataset(Recording):
    """Frames of id the file's path without its ending; in a file of several items `/k` behind it.

    Depth is in metres, the pose and the boxes too (the scene's 0.6 units are one metre). Annotations are the objects of
    `seg` that have a pixel; their `index` is the object's id. The box of an object is that of all its points in the
    scene's bounds, seen or hidden, along the scene's axes: x is level and away from the camera, z the height. The pose
    is `cam_pose` where it takes the depth to the file's own points, else the reading of it that does; where none does
    there is no pose, and there are no boxes. An id with `@randomized` behind it is the view with randomised materials,
    where it has one, and with `@synonyms` the view whose objects go by their other names; such ids are in the splits
    and not in `frame_ids`.
    """

    format = "semantic-abstraction"

    def __init__(self, root: Path, settings: Settings) -> None:
        super().__init__(root, settings)
        self._index: dict[str, tuple[str, int]] = {}
        self._views: dict[str, tuple[str, ...]] = {}
        names: set[str] = set()
        for view in sorted(_views_below(root, LEVELS), key=natural):
            count = 1
            try:
                with open_view(root / (view + SUFFIX)) as file:
                    count = item_count(file)
                    names.update(read_classes(file).values())
            except InputError:  # Told when the frame is loaded.
                pass
            ids = (view,) if count == 1 else tuple(f"{view}/{k}" for k in range(count))
            self._views[view] = ids
            self._index.update({frame_id: (view, k) for k, frame_id in enumerate(ids)})
        self.frame_ids = tuple(self._index)
        self.class_names: tuple[str, ...] = tuple(sorted(names - NOT_AN_OBJECT))

    def load(self, frame_id: str) -> Frame:
        """Decode a frame; see `Dataset.load`."""
        path, item = self._view(frame_id)
        notes: list[str] = []
        with open_view(path) as file:
            rgb = _picture(file, item, frame_id.endswith(RANDOMIZED))
            size = (rgb.shape[0], rgb.shape[1])
            stored = read_item(file, "depth", item, "f", *size)
            K = None if self._settings.intrinsics is not None else read_array(file, "data/cam_intr", 3, 3)
            seg = _segments(file, item, size, notes)
            labels = _labels(file, object_ids(seg), notes)
            if frame_id.endswith(RENAMED):
                labels = {number: SYNONYMS.get(label, label) for number, label in labels.items()}
            scene = or_note(notes, f"{NO_POSE}: ", _scene, file, item)
        depth = _depth(stored, self._settings)
        camera = make_camera(K, size, None, self._settings, path)
        pose, points = None, None
        if scene is not None:
            points = points_of(scene.xyz, scene.owner, list(labels))
            pose = _pose(scene, points, camera, depth, seg, list(labels), notes)
        if pose is not None and pose.convention and frame_id == self.frame_ids[0]:
            notes.append(f"cam_pose fits the file's points only {pose.convention}; said of the first frame only")
        T, up = (None, None) if pose is None else (pose.T_world_camera, pose.up)
        annotations = annotated_objects(seg, labels, pose, points)
        return self._frame(frame_id, (rgb, depth), K, T, path, path, annotations, notes, up)

    def given_expressions(self, frame_id: str) -> tuple[GivenExpression, ...]:
        """The dataset's own expressions; see `base.given_expressions`.

        The target is one object by its id, the reference every object of its class. Of both only the annotated ones are
        given: a target may be hidden. Expressions of other relations than the six are left out.
        """
        path, item = self._view(frame_id)
        with open_view(path) as file:
            if not has(file, "data/descriptions"):
                return ()
            group = "data/descriptions"
            targets, references, relations = (
                read_names(file, f"{group}/{name}")
                for name in ("target_obj_name", "reference_obj_name", "spatial_relation_name")
            )
            ids = read_integers(file, f"{group}/target_obj_id") if has(file, f"{group}/target_obj_id") else None
            require(
                len({len(targets), len(references), len(relations), len(relations if ids is None else ids)}) <= 1,
                "the lists of data/descriptions differ in length",
            )
            classes = _labels(file, object_ids(_segments(file, item, (None, None), [])), [])
        of_class: dict[str, tuple[int, ...]] = {}
        for number, label in classes.items():
            of_class[label] = (*of_class.get(label, ()), number)
        found: list[GivenExpression] = []
        for k, (target, relation, reference) in enumerate(zip(targets, relations, references, strict=True)):
            if relation not in RELATIONS:
                continue
            number = -1 if ids is None else ids[k]
            meant = of_class.get(target, ()) if number < 0 else (number,) if number in classes else ()
            text = f"{target} {relation} a {reference}"
            found.append(
                GivenExpression(text, target, RELATIONS[relation], reference, meant, of_class.get(reference, ()))
            )
        return tuple(map(with_synonyms, found) if frame_id.endswith(RENAMED) else found)

    def scene_of(self, frame_id: str) -> str | None:
        """Room of a view, such as "FloorPlan3", where named."""
        named = re.search(r"FloorPlan[0-9]+", frame_id, re.ASCII)
        return None if named is None else named.group()

    def splits(self) -> dict[str, tuple[str, ...]]:
        """Frames of the split files, by "vool/train" and so on; see `base.splits`.

        Files that are not here, and paths that lead outside, are left out. The frames of `unseen_instances_dr` are
        those with randomised materials, the frames of `unseen_instances_synonyms` those with the other names.
        """
        found: dict[str, tuple[str, ...]] = {}
        for kind, path in split_files(self.root).items():
            for name, listed in read_split(path).items():
                views = dict.fromkeys(view_name(file) for file in listed)
                ids = [i for view in views if view is not None for i in self._views.get(view, ())]
                found[f"{kind}/{name}"] = tuple(i + SUFFIXES.get(name, "") for i in ids)
        return found

    def _view(self, frame_id: str) -> tuple[Path, int]:
        known = self._index.get(frame_id.removesuffix(RANDOMIZED).removesuffix(RENAMED))
        if known is None:
            raise unknown_frame(self, frame_id)
        return self.root / (known[0] + SUFFIX), known[1]


def _picture(file: Any, item: int, randomized: bool) -> np.ndarray:
    """Colour (H, W, 3) uint8; the randomised picture is an empty array outside test rooms."""
    if not randomized:
        return read_item(file, "rgb", item, "u", None, None, 3).astype(np.uint8, copy=False)
    try:
        return read_item(file, "data/domain_randomized_rgb", item, "u", None, None, 3).astype(np.uint8, copy=False)
    except InputError as error:
        raise InputError("this view has no picture with randomised materials", got=error.what) from error


def _depth(stored: np.ndarray, settings: Settings) -> np.ndarray:
    """Depth (H, W) float32 metres; NaN, inf and non-positive values become 0."""
    with np.errstate(over="ignore", invalid="ignore"):
        depth = (stored / (settings.depth_scale or 1.0)).astype(np.float32)
    depth[~(np.isfinite(depth) & (depth > 0))] = 0
    return depth


def _segments(file: Any, item: int, size: tuple[int | None, int | None], notes: list[str]) -> np.ndarray:
    """Object ids (H, W), below 0 for none; without `seg` empty, with a note."""
    if not has(file, "seg"):
        notes.append("no annotations, seg is missing")
        return np.full((size[0] or 1, size[1] or 1), -1)
    return read_item(file, "seg", item, "iu", *size)


def _labels(file: Any, ids: np.ndarray, notes: list[str]) -> dict[int, str]:
    """Class names by id for `ids` (ascending), without background."""
    classes: dict[int, str] = {}
    require(
        len(ids) <= MOST_OBJECTS and ids.max(initial=0) < LARGEST_ID,
        "seg cannot be a segmentation",
        got=f"{len(ids)} ids up to {ids.max(initial=0)}",
    )
    wanted = [int(i) for i in ids]
    try:
        classes = read_classes(file)
    except InputError as error:
        if wanted:
            notes.append(f"the objects are named by their ids: {error.what}")
    else:
        unknown = [i for i in wanted if i not in classes]
        if unknown:
            notes.append(f"{len(unknown)} objects have no class, the first is object {unknown[0]}")
    named = {i: classes.get(i, f"object_{i}") for i in wanted}
    return {i: label for i, label in named.items() if label not in NOT_AN_OBJECT}


def _scene(file: Any, item: int) -> _FileScene:
    """Scene data of a file; InputError where incomplete."""
    cam_pose = read_array(file, "data/cam_pose", 4, 4)
    xyz = read_item(file, "full_xyz_pts", item, "f", None, 3)
    return _FileScene(cam_pose, xyz, read_item(file, "full_objid_pts", item, "iu", len(xyz)), _bounds(file))


def _pose(
    scene: _FileScene,
    points: ObjectPoints,
    camera: Camera,
    depth: np.ndarray,
    seg: np.ndarray,
    ids: list[int],
    notes: list[str],
) -> ScenePose | None:
    """Pose aligning the depth with the file's points; None, with a note, without a fit."""
    v, u, owner = depth_samples(seg, depth, ids)
    samples = lift_pixels(depth[v, u], camera, v, u)
    given = scene.cam_pose, samples, owner, points.xyz, points.owner, scene.bounds
    return or_note(notes, f"{NO_POSE}: ", fit_pose, *given)


def _bounds(file: Any) -> np.ndarray:
    """Scene bounds (2, 3); defaults where implausible."""
    try:
        bounds = read_array(file, "data/scene_bounds", 2, 3)
    except InputError:
        return SCENE_BOUNDS
    if not np.abs(bounds).max() < LARGEST_SCENE:  # Nor is NaN.
        return SCENE_BOUNDS
    size = bounds[1] - bounds[0]
    return bounds if size.min() > 0.01 * size.max() > 0 else SCENE_BOUNDS


def _views_below(root: Path, levels: int, prefix: str = "") -> list[str]:
    """Relative paths of HDF5 files below a folder, without ending; links are not followed."""
    folders, files = readable(root, links=False)
    found = [prefix + n.removesuffix(SUFFIX) for n in files if n.endswith(SUFFIX) and os.path.isfile(root / n)]
    for name in folders if levels > 0 else ():
        found += _views_below(root / name, levels - 1, f"{prefix}{name}/")
    return found


def _is_view(root: Path, view: str) -> bool:
    """Test for a view by file name, else by content."""
    if re.fullmatch(r"[0-9]+.FloorPlan[0-9]+_physics", view.rpartition("/")[2], re.ASCII):
        return True
    try:
        with open_view(root / (view + SUFFIX)) as file:
            return all(has(file, name) for name in ("rgb", "depth", "data/cam_intr"))
    except InputError:
        return False


def _recognises(root: Path) -> bool:
    """Recognise views in the folder, below split files, or in most folders. Not any folder with a view somewhere below:
    that may hold other datasets too."""
    own = _views_below(root, 0)
    if own:
        return _is_view(root, own[0])
    if split_files(root):
        return bool(_views_below(root, LEVELS))
    folders, _ = readable(root, links=False)
    below = [next(iter(_views_below(root / name, LEVELS - 1)), None) for name in folders]
    good = sum(view is not None and _is_view(root / name, view) for name, view in zip(folders, below, strict=True))
    return 2 * good > len(folders)


FORMAT = DatasetFormat(
    "semantic-abstraction",
    "semantic-abstraction: <seed>|FloorPlan<N>_physics.hdf5, here, below split files, or in most folders",
    _recognises,
    SemanticAbstractionDataset,
)
