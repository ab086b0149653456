"""Semantic Abstraction: AI2-THOR views as HDF5 files, with masks, whole-object points and expressions.

https://github.com/columbia-ai-robotics/semantic-abstraction. The root datasets of a view have one entry an item along
their first axis; the group `data` refers to them by region references, and holds the rest itself.
"""

from __future__ import annotations

import os
import re
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from pipeline.datasets.base import DatasetFormat, GivenExpression, unknown_id
from pipeline.datasets.cameras import Stated, or_note
from pipeline.datasets.files import CUT_OFF, Part, natural, readable
from pipeline.datasets.images import read_depth
from pipeline.datasets.recording import Listed, Recording
from pipeline.datasets.semantic_abstraction_objects import (
    SCENE_BOUNDS,
    annotated_objects,
    depth_samples,
    fit_pose,
    object_ids,
    points_of,
)
from pipeline.datasets.semantic_abstraction_splits import (
    RANDOMIZED,
    RENAMED,
    SUFFIXES,
    SYNONYMS,
    read_split,
    split_files,
    view_name,
    with_synonyms,
)
from pipeline.datasets.settings import Settings
from pipeline.geometry.camera import Camera, intrinsics, lift_pixels
from pipeline.language.relation import SEMANTIC_ABSTRACTION
from pipeline.system.errors import InputError, as_input_error, in_file, needed, require
from pipeline.system.safe_files import checked_path

SUFFIX = ".hdf5"
LEVELS = 3
"""How deep files lie at most below the opened folder."""
NOT_AN_OBJECT = frozenset({"empty", "out of bounds", "unlabelled"})
LARGEST_ID = 1_000_000
MOST_OBJECTS = 2000
"""Objects are numbered by their place in one list of names, and a view shows some dozens of them."""
MOST_VALUES = 100_000_000
MOST_NAMES = 1_000_000
"""Bounds on what a file may make us read of one item and of one list: far above what the dataset has."""
LARGEST_SCENE = 100.0
RELATIONS = {words: name for name, words in SEMANTIC_ABSTRACTION.items()}
"""The dataset's six relations and what we call them."""
NO_POSE = "no camera pose and no 3D boxes"


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
    one_size = True

    def __init__(self, root: Path, settings: Settings) -> None:
        super().__init__(root, settings)
        self._index: dict[str, tuple[str, int]] = {}
        self._views: dict[str, list[str]] = {}
        names: set[str] = set()
        for view in sorted(_views_below(root, LEVELS), key=natural):
            count = 1
            try:
                with open_view(root / (view + SUFFIX)) as file:
                    count = file["rgb"].shape[0] if "rgb" in file and file["rgb"].ndim == 4 else 1
                    names.update(read_classes(file).values())
            except InputError:  # Told when the frame is loaded.
                pass
            self._views[view] = [f"{view}/{k}" for k in range(count)] if count > 1 else [view]
            self._index |= {frame_id: (view, k) for k, frame_id in enumerate(self._views[view])}
        self.frame_ids = tuple(self._index)
        self.class_names: tuple[str, ...] = tuple(sorted(names - NOT_AN_OBJECT))

    def _listed(self, frame_id: str, notes: list[str]) -> Listed:
        path, item = self._view(frame_id)
        given = self._settings.intrinsics
        with open_view(path) as file:
            rgb = _picture(file, item, frame_id.endswith(RANDOMIZED))
            size = (rgb.shape[0], rgb.shape[1])
            stored = read_item(file, "depth", item, "f", *size)
            K = read_array(file, "data/cam_intr", 3, 3) if given is None else intrinsics(*given)
            seg = _segments(file, item, size, notes)
            labels = _labels(file, object_ids(seg), notes)
            if frame_id.endswith(RENAMED):
                labels = {number: SYNONYMS.get(label, label) for number, label in labels.items()}
            scene = or_note(notes, f"{NO_POSE}: ", _scene, file, item)
        depth = Part(path, "/depth", lambda: stored)
        pose, points = None, None
        if scene is not None:
            cam_pose, xyz, owner, bounds = scene
            points = points_of(xyz, owner, list(labels))
            metres = read_depth(depth, self._settings.depth_scale)
            v, u, sample_owner = depth_samples(seg, metres, list(labels))
            with in_file(path):
                samples = lift_pixels(metres[v, u], Camera(K, size[1], size[0]), v, u)
            known = cam_pose, samples, sample_owner, points.xyz, points.owner, bounds
            pose = or_note(notes, f"{NO_POSE}: ", fit_pose, *known)
        if pose is not None and pose.convention and frame_id == self.frame_ids[0]:
            notes.append(f"cam_pose fits the file's points only {pose.convention}; said of the first frame only")
        T, up = (None, None) if pose is None else (pose.T_world_camera, pose.up)
        annotations = annotated_objects(seg, labels, pose, points)
        stated = Stated(K, path=path)
        return Listed(Part(path, "/rgb", lambda: rgb), depth, stated, T, lambda size, notes: annotations, up)

    def given_expressions(self, frame_id: str) -> tuple[GivenExpression, ...]:
        """The dataset's own expressions; see `base.given_expressions`.

        The target is one object by its id, the reference every object of its class. Of both only the annotated ones are
        given: a target may be hidden. Expressions of other relations than the six are left out.
        """
        path, item = self._view(frame_id)
        with open_view(path) as file:
            group = "data/descriptions"
            if group not in file:
                return ()
            targets, references, relations = (
                read_names(file, f"{group}/{name}")
                for name in ("target_obj_name", "reference_obj_name", "spatial_relation_name")
            )
            given = f"{group}/target_obj_id" in file
            ids = _list(file, f"{group}/target_obj_id") if given else np.full(len(targets), -1)
            require(ids.dtype.kind in "iu" or not ids.size, "target_obj_id is no list of integers", got=ids.dtype)
            lengths = {len(targets), len(references), len(relations), len(ids)}
            require(len(lengths) == 1, "the lists of data/descriptions differ in length")
            classes = _labels(file, object_ids(_segments(file, item, (None, None), [])), [])
        found: list[GivenExpression] = []
        for target, number, relation, reference in zip(targets, ids.tolist(), relations, references, strict=True):
            if relation not in RELATIONS:
                continue
            meant, others = (tuple(i for i, label in classes.items() if label == name) for name in (target, reference))
            if number >= 0:
                meant = tuple(i for i in (number,) if i in classes)
            text = f"{target} {relation} a {reference}"
            found.append(GivenExpression(text, target, RELATIONS[relation], reference, meant, others))
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
            raise unknown_id(self.frame_ids, frame_id, self.root)
        return self.root / (known[0] + SUFFIX), known[1]


def _picture(file: Any, item: int, randomized: bool) -> np.ndarray:
    """Colour (H, W, 3) uint8; the randomised picture is an empty array outside test rooms."""
    shape = None, None, 3
    if not randomized:
        return read_item(file, "rgb", item, "u", *shape).astype(np.uint8, copy=False)
    why: list[str] = []
    found = or_note(why, "", read_item, file, "data/domain_randomized_rgb", item, "u", *shape)
    return needed(found, "this view has no picture with randomised materials", got=why).astype(np.uint8, copy=False)


def _scene(file: Any, item: int) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Scene data of a file: cam_pose (4, 4), points (M, 3) with objects (M,), bounds (2, 3)."""
    cam_pose = read_array(file, "data/cam_pose", 4, 4)
    xyz = read_item(file, "full_xyz_pts", item, "f", None, 3)
    return cam_pose, xyz, read_item(file, "full_objid_pts", item, "iu", len(xyz)), _bounds(file)


def _segments(file: Any, item: int, size: tuple[int | None, int | None], notes: list[str]) -> np.ndarray:
    """Object ids (H, W), below 0 for none; without `seg` empty, with a note."""
    if "seg" not in file:
        notes.append("no annotations, seg is missing")
        return np.full((size[0] or 1, size[1] or 1), -1)
    return read_item(file, "seg", item, "iu", *size)


def _labels(file: Any, ids: np.ndarray, notes: list[str]) -> dict[int, str]:
    """Class names by id for `ids` (ascending), without background."""
    require(
        len(ids) <= MOST_OBJECTS and ids.max(initial=0) < LARGEST_ID,
        "seg cannot be a segmentation",
        got=f"{len(ids)} ids up to {ids.max(initial=0)}",
    )
    wanted = [int(i) for i in ids]
    classes = or_note(notes if wanted else [], "the objects are named by their ids: ", read_classes, file)
    unknown = [] if classes is None else [i for i in wanted if i not in classes]
    if unknown:
        notes.append(f"{len(unknown)} objects have no class, the first is object {unknown[0]}")
    named = {i: (classes or {}).get(i, f"object_{i}") for i in wanted}
    return {i: label for i, label in named.items() if label not in NOT_AN_OBJECT}


def _bounds(file: Any) -> np.ndarray:
    """Scene bounds (2, 3); defaults where implausible."""
    bounds = or_note([], "", read_array, file, "data/scene_bounds", 2, 3)
    if bounds is None or not np.abs(bounds).max() < LARGEST_SCENE:  # Nor is NaN.
        return SCENE_BOUNDS
    size = bounds[1] - bounds[0]
    return bounds if size.min() > 0.01 * size.max() > 0 else SCENE_BOUNDS


@contextmanager
def open_view(path: Path) -> Iterator[Any]:
    """Open an h5py file read-only, with all data in the file itself; any failure becomes an InputError."""
    import h5py

    # h5py raises all of these for damaged files.
    errors = (OSError, KeyError, ValueError, TypeError, RuntimeError, MemoryError)
    with (
        in_file(path),
        as_input_error(
            "an HDF5 file that cannot be read",
            *errors,
            got=lambda e: str(e).strip("'\"")[:120],
            cause=CUT_OFF,
            path=path,
        ),
        as_input_error("a file is missing", FileNotFoundError, path=path),
        h5py.File(checked_path(path, "unpacked"), "r") as file,
    ):
        for group in ("/", "data", "data/descriptions"):
            _check_own(file.get(group))
        yield file


def _check_own(group: Any) -> None:
    """Raise InputError for a link in a group, and for data in another file."""
    import h5py

    for name in group if isinstance(group, h5py.Group) else ():
        hard = isinstance(group.get(name, getlink=True), h5py.HardLink)
        require(hard, f"{name} is a link", expected="data in the file itself")
        _own(group[name], name)


def _own(node: Any, name: Any) -> Any:
    outside = getattr(node, "is_virtual", False) or getattr(node, "external", None)
    require(not outside, f"{name} keeps its data in another file")
    return node


def _dataset(file: Any, name: str) -> Any:
    found = file.get(name)
    require(hasattr(found, "shape"), f"{name} is missing")
    return found


def read_item(file: Any, name: str, item: int, kinds: str, *shape: int | None) -> np.ndarray:
    """Item of a root dataset, through the region reference in `data` if present."""
    dataset = _dataset(file, name)
    require(
        dataset.dtype.kind in kinds and dataset.ndim == len(shape) + 1,
        f"{name} has another form",
        got=f"{dataset.dtype} {dataset.shape}",
    )
    inside = dataset.shape[1:]
    require(
        not any(want is not None and want != have for want, have in zip(shape, inside, strict=True)),
        f"{name} has another shape",
        got=inside,
        expected=tuple(n or "any" for n in shape),
    )
    require(
        min(inside) >= 1 and np.prod(inside, dtype=np.float64) <= MOST_VALUES,
        f"{name} cannot be of this size",
        got=inside,
    )
    reference = _reference(file, name, item)
    if reference is None:
        require(item < dataset.shape[0], f"{name} has no item {item}", got=f"{dataset.shape[0]} items")
        return np.asarray(dataset[item])
    require(
        file[reference] == dataset,
        f"the reference data/{name} leads to another dataset",
        got=lambda: file[reference].name,
    )
    values = np.asarray(dataset[reference])
    require(
        values.shape == (1, *inside),
        f"the reference data/{name} is not one item",
        got=values.shape,
        expected=(1, *inside),
    )
    return values[0]


def read_array(file: Any, name: str, *shape: int) -> np.ndarray:
    """A small dataset of numbers of this shape, as float64."""
    dataset = _dataset(file, name)
    require(
        dataset.shape == shape and dataset.dtype.kind in "fiu",
        f"{name} has another form",
        got=f"{dataset.dtype} {dataset.shape}",
        expected=shape,
    )
    return np.asarray(dataset[()], dtype=np.float64)


def read_names(file: Any, name: str) -> list[str]:
    """A list of texts, stored as bytes or as strings, itself or by region references."""
    values = _list(file, name)
    require(
        values.dtype.kind in "SUO" and all(isinstance(v, (bytes, str)) for v in values.tolist()),
        f"{name} is no list of names",
        got=values.dtype,
    )
    texts = (v.decode("utf-8", "replace") if isinstance(v, bytes) else v for v in values.tolist())
    return [" ".join("".join(c if c.isprintable() else " " for c in text).split()) for text in texts]


def read_classes(file: Any) -> dict[int, str]:
    """Class names by object id, from `data/objid_to_class` with entries `name[id]` or by index."""
    found: dict[int, str] = {}
    for index, text in enumerate(read_names(file, "data/objid_to_class")):
        match = re.fullmatch(r"(.*?)\s*\[([0-9]{1,9})\]", text, re.ASCII | re.DOTALL)
        name, number = (match[1], int(match[2])) if match else (text, index)
        if name:
            found.setdefault(number, name)
    return found


def _list(file: Any, name: str) -> np.ndarray:
    import h5py

    dataset = _dataset(file, name)
    require(dataset.ndim == 1 and dataset.shape[0] <= MOST_NAMES, f"{name} is no list", got=dataset.shape)
    values = np.asarray(dataset[()])
    if h5py.check_ref_dtype(dataset.dtype) is not h5py.RegionReference:
        return values
    require(all(values), f"{name} holds an empty reference")
    parts = [np.ravel(_own(file[reference], name)[reference]) for reference in values]
    return np.concatenate(parts) if parts else np.zeros(0, "S1")


def _reference(file: Any, name: str, item: int) -> Any:
    """Region reference to an item; None without references of this name."""
    import h5py

    references = file.get(f"data/{name}")
    if not isinstance(references, h5py.Dataset):
        return None
    if h5py.check_ref_dtype(references.dtype) is not h5py.RegionReference or references.ndim != 1:
        return None
    require(item < references.shape[0], f"data/{name} has no item {item}", got=f"{references.shape[0]} references")
    reference = references[item]
    require(reference, f"the reference data/{name} is empty")
    return reference


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
            return all(name in file for name in ("rgb", "depth", "data/cam_intr"))
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
