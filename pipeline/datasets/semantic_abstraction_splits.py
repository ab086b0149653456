"""Splits and subsets of Semantic Abstraction: split files, and the other names of objects.

Split files are read without running what a pickle may hold.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path, PurePosixPath
from typing import Any

from pipeline.datasets.base import GivenExpression
from pipeline.datasets.files import read_json
from pipeline.system.errors import InputError, require
from pipeline.system.plain_pickle import read_plain_pickle

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
