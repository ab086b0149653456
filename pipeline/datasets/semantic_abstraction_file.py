"""Files of Semantic Abstraction: HDF5 views and split files, checked before reading large data.

The root datasets of a view have one entry an item along their first axis; the group `data` refers to them by region
references, and holds the rest itself. Split files are read without running what a pickle may hold.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np

from pipeline.datasets.base import GivenExpression
from pipeline.datasets.files import CUT_OFF, read_json
from pipeline.system.errors import InputError, as_input_error, in_file, require
from pipeline.system.plain_pickle import read_plain_pickle
from pipeline.system.safe_files import checked_path

MOST_VALUES = 100_000_000
MOST_NAMES = 1_000_000
"""Bounds on what a file may make us read of one item and of one list: far above what the dataset has."""


@contextmanager
def open_view(path: Path) -> Iterator[Any]:
    """Open an h5py file read-only; any failure becomes an InputError."""
    import h5py

    # h5py raises all of these for damaged files.
    errors = (OSError, KeyError, ValueError, TypeError, RuntimeError, MemoryError)
    with (
        in_file(path),
        as_input_error("an HDF5 file that cannot be read", *errors, got=_unquoted, cause=CUT_OFF, path=path),
        as_input_error("a file is missing", FileNotFoundError, path=path),
        h5py.File(checked_path(path, "unpacked"), "r") as file,
    ):
        yield file


def _unquoted(error: Exception) -> str:
    return str(error).strip("'\"")[:120]


def has(file: Any, name: str) -> bool:
    """Test whether a readable part of this name exists."""
    try:
        return _inside(file, name) is not None
    except InputError:
        return True


def item_count(file: Any) -> int:
    """Number of items: length of the first axis of `rgb`, else 1."""
    found = _inside(file, "rgb")
    return max(1, int(found.shape[0])) if found is not None and getattr(found, "ndim", 0) == 4 else 1


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


def read_integers(file: Any, name: str) -> list[int]:
    """A list of integers, itself or by region references."""
    values = _list(file, name)
    require(not (values.dtype.kind not in "iu" and values.size), f"{name} is no list of integers", got=values.dtype)
    return [int(v) for v in values.tolist()]


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
    parts = [np.ravel(_checked(file, file[reference], name)[reference]) for reference in values]
    return np.concatenate(parts) if parts else np.zeros(0, "S1")


def _reference(file: Any, name: str, item: int) -> Any:
    """Region reference to an item; None without references of this name."""
    import h5py

    references = _inside(file, f"data/{name}")
    if not isinstance(references, h5py.Dataset):
        return None
    if h5py.check_ref_dtype(references.dtype) is not h5py.RegionReference or references.ndim != 1:
        return None
    require(item < references.shape[0], f"data/{name} has no item {item}", got=f"{references.shape[0]} references")
    reference = references[item]
    require(reference, f"the reference data/{name} is empty")
    return reference


def _dataset(file: Any, name: str) -> Any:
    import h5py

    found = _inside(file, name)
    require(isinstance(found, h5py.Dataset), f"{name} is missing")
    return found


def _inside(file: Any, name: str) -> Any:
    """Node of a name inside this file, or None."""
    import h5py

    node = file
    for part in name.split("/"):
        if not isinstance(node, h5py.Group) or part not in node:
            # A link whose file is missing is "not in" the group, and must not pass for a missing part.
            require(
                not isinstance(node, h5py.Group) or not isinstance(node.get(part, getlink=True), h5py.ExternalLink),
                f"{name} leads to another file",
            )
            return None
        require(
            isinstance(node.get(part, getlink=True), h5py.HardLink),
            f"{name} is a link",
            expected="data in the file itself",
        )
        node = node[part]
    return _checked(file, node, name)


def _checked(file: Any, node: Any, name: str) -> Any:
    import h5py

    require(
        not isinstance(node, h5py.Dataset) or (not node.is_virtual and not node.external),
        f"{name} keeps its data in another file",
    )
    return node


SPLIT_FILES = ("vool_split", "ssc_split")
ROOMS, RANDOMIZED_ROOMS, SYNONYM_ROOMS = "unseen_instances", "unseen_instances_dr", "unseen_instances_synonyms"
RANDOMIZED, RENAMED = "@randomized", "@synonyms"
"""What is put behind a frame's id for the same view with randomised materials, which test rooms have, and for the
same view with the objects called by their other names."""
SUFFIXES = {RANDOMIZED_ROOMS: RANDOMIZED, SYNONYM_ROOMS: RENAMED}
"""By split, what stands behind the ids of its frames."""
SUBSETS = ("Visual", "Synonyms", "Class")
"""The subsets that the relation method is reported on, in the order of its tables."""
SYNONYMS: dict[str, str] = {
    "television": "tv",
    "sofa": "couch",
    "house plant": "plant in a pot",
    "bookcase": "bookshelf",
    "baseball bat": "rawlings big stick maple bat",
    "pillow": "cushion",
    "arm chair": "recliner",
    "bread": "loaf of sourdough",
    "cell phone": "mobile phone",
    "desktop": "computer",
    "dresser": "wardrobe",
    "dumbbell": "gym weights",
    "fridge": "refridgerator",
    "garbage can": "trash can",
    "laptop": "computer",
    "outlet": "eletric plug",
    "stairs": "staircase",
}
"""The other name of each of 17 classes, spelt as the dataset spells it."""
_OTHER_NAMES = frozenset(SYNONYMS.values())
NOVEL_CLASSES = frozenset({"pot", "mug", "safe", "teddy bear", "basket ball", "wine bottle"})
"""The classes that no training view shows."""


def subsets_of(frame_id: str, target: str, reference: str) -> tuple[str, ...]:
    """`SUBSETS` of an expression about a frame.

    By the frame's id alone: "Visual" is of views with randomised materials, without the novel classes, as in the
    published evaluation; "Synonyms" of an object that goes by its synonym; "Class" of a class that no training view
    shows. Of frames of the training split, which show no novel class, in none.
    """
    novel = target in NOVEL_CLASSES or reference in NOVEL_CLASSES
    renamed = frame_id.endswith(RENAMED) and bool({target, reference} & _OTHER_NAMES)
    held = (frame_id.endswith(RANDOMIZED) and not novel, renamed, novel)
    return tuple(name for name, there in zip(SUBSETS, held, strict=True) if there)


def with_synonyms(expression: GivenExpression) -> GivenExpression:
    """Expression with synonyms for both names, where known."""
    target = SYNONYMS.get(expression.target, expression.target)
    reference = SYNONYMS.get(expression.reference, expression.reference)
    middle = expression.text[len(expression.target) : len(expression.text) - len(expression.reference)]
    return replace(expression, text=f"{target}{middle}{reference}", target=target, reference=reference)


def split_files(root: Path) -> dict[str, Path]:
    """The split files of a folder by "vool" and "ssc"; JSON before pickle."""
    found: dict[str, Path] = {}
    for name in SPLIT_FILES:
        for path in (root / f"{name}.json", root / f"{name}.pkl"):
            if path.is_file():
                found.setdefault(name.removesuffix("_split"), path)
    return found


def read_split(path: Path) -> dict[str, tuple[str, ...]]:
    """File lists by split."""
    table: Any = read_json(path) if path.suffix == ".json" else read_plain_pickle(path)
    require(isinstance(table, Mapping), "a table of splits was expected", got=type(table).__name__, path=path)
    found: dict[str, tuple[str, ...]] = {}
    for name, files in table.items():
        listed = list(files) if isinstance(files, (list, tuple, set, frozenset)) else None
        if not isinstance(name, str) or listed is None or not all(isinstance(f, str) for f in listed):
            raise InputError("a split must be a name and a list of files", got=repr(name)[:60], path=path)
        found[name] = tuple(sorted(listed) if isinstance(files, (set, frozenset)) else listed)
    return found


def view_name(listed: str) -> str | None:
    """View path of a split entry without ending, relative to the dataset; None outside."""
    path = PurePosixPath(listed)
    if path.is_absolute() or ".." in path.parts or "\\" in listed or path.suffix != ".hdf5":
        return None
    return path.with_suffix("").as_posix()
