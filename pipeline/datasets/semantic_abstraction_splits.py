"""Semantic Abstraction's split files, read without running what a pickle may hold, and the subsets reported on them."""

from __future__ import annotations

import io
import pickle
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path, PurePosixPath
from typing import Any, Protocol

from pipeline.datasets.base import GivenExpression
from pipeline.datasets.files import read_bytes, read_json
from pipeline.system.errors import InputError

SPLIT_FILES = ("vool_split", "ssc_split")
ROOMS, RANDOMIZED_ROOMS, SYNONYM_ROOMS = "unseen_instances", "unseen_instances_dr", "unseen_instances_synonyms"
RANDOMIZED, RENAMED = "@randomized", "@synonyms"
"""What is put behind a frame's id for the same view with randomised materials, which test rooms have, and for the
same view with the objects called by their other names."""
SUFFIXES = {RANDOMIZED_ROOMS: RANDOMIZED, SYNONYM_ROOMS: RENAMED}
"""By split, what stands behind the ids of its frames."""
SUBSETS = ("Visual", "Synonyms", "Class")
"""The subsets that the relation method is reported on, in the order of its tables."""
LARGEST_SPLIT_FILE = 100_000_000

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

_PLAIN = {"set": set, "frozenset": frozenset, "list": list, "tuple": tuple, "dict": dict, "str": str, "int": int}


class SplitDataset(Protocol):
    """What the subsets are made of: `base.splits` and `base.given_expressions`."""

    def splits(self) -> dict[str, tuple[str, ...]]: ...

    def given_expressions(self, frame_id: str) -> tuple[GivenExpression, ...]: ...


@dataclass(frozen=True)
class SubsetExpression:
    """One expression of a reported subset.

    Attributes
    ----------
    split : str
        The split it comes from: "unseen_instances", "unseen_instances_dr", "unseen_instances_synonyms".
    frame_id : str
    expression : GivenExpression
    """

    split: str
    frame_id: str
    expression: GivenExpression


def novel_room(dataset: SplitDataset, file: str = "vool") -> Iterator[SubsetExpression]:
    """Expressions about rooms that no training view shows, without the novel classes."""
    return _chosen(dataset, file, (ROOMS,), lambda e: not has_novel_class(e))


def novel_visual(dataset: SplitDataset, file: str = "vool") -> Iterator[SubsetExpression]:
    """The same of views with randomised materials; their frame ids load the randomised picture.

    As in the published evaluation the novel classes are left out here too.
    """
    return _chosen(dataset, file, (RANDOMIZED_ROOMS,), lambda e: not has_novel_class(e))


def novel_vocabulary(dataset: SplitDataset, file: str = "vool") -> Iterator[SubsetExpression]:
    """Expressions whose target or reference is called by its synonym."""
    return _chosen(dataset, file, (SYNONYM_ROOMS,), lambda e: bool({e.target, e.reference} & _OTHER_NAMES))


def novel_class(dataset: SplitDataset, file: str = "vool") -> Iterator[SubsetExpression]:
    """Expressions of all unseen splits whose target or reference is of a class that no training view shows."""
    return _chosen(dataset, file, (ROOMS, RANDOMIZED_ROOMS, SYNONYM_ROOMS), has_novel_class)


def has_novel_class(expression: GivenExpression) -> bool:
    """Whether the target or the reference is of one of the `NOVEL_CLASSES`."""
    return expression.target in NOVEL_CLASSES or expression.reference in NOVEL_CLASSES


def subsets_of(frame_id: str, target: str, reference: str) -> tuple[str, ...]:
    """Which of the `SUBSETS` an expression about a frame, or a pair of its objects, belongs to.

    As the four functions above say it, by the frame's id alone: "Visual" is `novel_visual`, "Synonyms"
    `novel_vocabulary`, "Class" `novel_class`. Of frames of the training split, which show no novel class, in none.
    """
    novel = target in NOVEL_CLASSES or reference in NOVEL_CLASSES
    renamed = frame_id.endswith(RENAMED) and bool({target, reference} & _OTHER_NAMES)
    held = (frame_id.endswith(RANDOMIZED) and not novel, renamed, novel)
    return tuple(name for name, there in zip(SUBSETS, held, strict=True) if there)


def with_synonyms(expression: GivenExpression) -> GivenExpression:
    """The expression with both names replaced by their synonyms, where they have one."""
    target = SYNONYMS.get(expression.target, expression.target)
    reference = SYNONYMS.get(expression.reference, expression.reference)
    middle = expression.text[len(expression.target) : len(expression.text) - len(expression.reference)]
    return replace(expression, text=f"{target}{middle}{reference}", target=target, reference=reference)


def _chosen(
    dataset: SplitDataset, file: str, names: tuple[str, ...], keep: Callable[[GivenExpression], bool]
) -> Iterator[SubsetExpression]:
    splits = dataset.splits()
    for name in names:
        for frame_id in splits.get(f"{file}/{name}", ()):
            for expression in dataset.given_expressions(frame_id):
                if keep(expression):
                    yield SubsetExpression(name, frame_id, expression)


def split_files(root: Path) -> dict[str, Path]:
    """The split files of a folder by "vool" and "ssc"; JSON before pickle."""
    found: dict[str, Path] = {}
    for name in SPLIT_FILES:
        for path in (root / f"{name}.json", root / f"{name}.pkl"):
            if path.is_file():
                found.setdefault(name.removesuffix("_split"), path)
    return found


def read_split(path: Path) -> dict[str, tuple[str, ...]]:
    """The files that each split lists.

    Raises
    ------
    InputError
        Unreadable, a pickle that asks for anything but plain values (which is
        named and not run), or no table of lists of names.
    """
    table: Any = read_json(path) if path.suffix == ".json" else _unpickled(path)
    if not isinstance(table, Mapping):
        raise InputError("a table of splits was expected", got=type(table).__name__, path=path)
    found: dict[str, tuple[str, ...]] = {}
    for name, files in table.items():
        listed = list(files) if isinstance(files, (list, tuple, set, frozenset)) else None
        if not isinstance(name, str) or listed is None or not all(isinstance(f, str) for f in listed):
            raise InputError("a split must be a name and a list of files", got=repr(name)[:60], path=path)
        found[name] = tuple(sorted(listed) if isinstance(files, (set, frozenset)) else listed)
    return found


def view_name(listed: str) -> str | None:
    """The path that a split lists without its ending, relative to the dataset; None for one that leads outside."""
    path = PurePosixPath(listed)
    if path.is_absolute() or ".." in path.parts or "\\" in listed or path.suffix != ".hdf5":
        return None
    return path.with_suffix("").as_posix()


class _PlainUnpickler(pickle._Unpickler):
    """Builds containers, strings and numbers, and nothing that would have to be looked up and called.

    It is the one in Python: that in C reserves as much memory as a few hostile bytes ask it for.
    """

    def get_extension(self, code: int) -> Any:
        raise InputError(f"the pickle asks for the extension {code}", expected="only lists of file names")

    def find_class(self, module: str, name: str) -> Any:
        if module in ("builtins", "__builtin__") and name in _PLAIN:
            return _PLAIN[name]
        raise InputError(
            f"the pickle asks for {module}.{name}"[:120],
            expected="only lists of file names",
            cause="a pickle may run any code; nothing of this one was run. Is there a JSON copy?",
        )


def _unpickled(path: Path) -> Any:
    try:
        size = path.stat().st_size
    except OSError as error:
        raise InputError("a file cannot be read", got=error.strerror, path=path) from error
    if size > LARGEST_SPLIT_FILE:
        raise InputError("a split file is too large", got=f"{size} bytes", path=path)
    try:
        return _PlainUnpickler(io.BytesIO(read_bytes(path))).load()
    except InputError as error:
        raise error if error.path is not None else InputError(str(error), path=path) from error
    except Exception as error:  # A damaged pickle may raise nearly anything.
        what = f"{type(error).__name__}: {error}"[:120]
        raise InputError("a pickle that cannot be read", got=what, path=path) from error
