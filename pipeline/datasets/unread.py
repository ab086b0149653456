"""Files of a recording that its reader did not use, beside the pictures: one note, whatever the format."""

from __future__ import annotations

import os
import re
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path, PurePath

from pipeline.datasets.base import Dataset
from pipeline.datasets.cameras import CAMERA_SUFFIXES, NOTHING, is_small, or_note, read_stated
from pipeline.datasets.files import readable
from pipeline.datasets.images import DEPTH_SUFFIXES
from pipeline.datasets.pairing import COLOR_SUFFIXES, role_of
from pipeline.datasets.recording import Recording
from pipeline.datasets.settings import FILE_NAME, Settings
from pipeline.language.counted import counted
from pipeline.system.errors import InputError

MOST_NAMED = 8
"""So many files and folders are named; of the others there is the count."""
MOST_FOLDERS, MOST_OF_A_FOLDER = 200, 3
"""So many folders are listed; of one with more files than this that were not read, there is the count."""
MOST_LOOKED_INTO = 500
"""So many files are looked into for a camera."""
PLAIN = ("folder", "pictures")
SAYS_CAMERA = "opened as a plain folder, and a camera, poses or a unit may stand in {}"
_PICTURES = (*COLOR_SUFFIXES, *DEPTH_SUFFIXES)
_FACTS = re.compile(
    r"(?<![a-z])(traj(ectory)?|odom(etry)?|ground_?truth|gt|freiburg|extrinsics?|transforms?|associations?|associate"
    r"|vio|slam|tum|frames?|arkit|colmap|points3d|depth_?(units?|scale)|timestamps?|images(?=\.bin))(?![a-z])",
    re.IGNORECASE,
)
"""Words of files that speak of cameras, poses, units or pairing, beside those of `role_of`."""
_FACT_SUFFIXES = (*CAMERA_SUFFIXES, ".csv", ".jsonl", ".log", ".bin", ".xml", ".freiburg", ".traj", ".tum", ".klg")
_FOR_PEOPLE = re.compile(
    r"readme.*|licen[cs]e.*|copying.*|changelog.*|notice|thumbs\.db|.*\.(md|rst|pdf|html?|py|sh|ipynb|docx?|log\.txt)",
    re.IGNORECASE,
)
"""Files that no reader reads."""


def say_unread(dataset: Dataset, seen: set[str], settings: Settings) -> None:
    """Put a note of the files that were not read before the dataset's notes.

    `seen` are the paths that were opened, as `safe_files.watched` gathers them while the caller's block lasts. Camera
    files are not missed where `settings` give the camera.
    """
    if isinstance(dataset, Recording) and dataset.root.is_dir():
        note = unread_note(dataset, seen, settings.intrinsics is not None)
        dataset.notes = (note, *dataset.notes) if note else dataset.notes


@contextmanager
def naming_unread(root: Path, seen: set[str]) -> Iterator[None]:
    """Name the files that may tell a camera, poses or a unit, and were not read, in an error of the block."""
    try:
        yield
    except InputError as error:
        used = {_relative(path, root) for path in seen}
        found = [name for _, names in _unused(root, used, frozenset()) for name in names]
        lying = [name for k, name in enumerate(found) if _may_tell(root, name, k < MOST_LOOKED_INTO)]
        if not lying or not root.is_dir():
            raise
        where = "" if error.path is None else f" [{error.path}]"
        named = ", ".join(lying[:MOST_NAMED])
        raise InputError(f"{str(error).removesuffix(where)}; not read: {named}", path=error.path) from error


def telling_files(folder: Path, seen: set[str]) -> list[str]:
    """Files of a folder of datasets, itself none, that may tell a camera, poses or a unit of them, and are not among
    those that were `seen`."""
    used = {os.path.realpath(path) for path in seen}
    names = [name for name in readable(folder)[1] if not _FOR_PEOPLE.fullmatch(name)]
    names = [name for k, name in enumerate(names) if _may_tell(folder, name, k < MOST_LOOKED_INTO)]
    return [name for name in names if os.path.realpath(folder / name) not in used]


def unread_note(dataset: Recording, seen: set[str], camera_given: bool = False) -> str:
    """The note of the files in the dataset's folder that were not used; "" where there are none."""
    pictures: list[Path] = []
    for frame_id in dict.fromkeys(dataset.frame_ids[:1] + dataset.frame_ids[-1:]):
        with suppress(InputError):
            pictures += dataset.look_through(frame_id)
    if not pictures:
        return ""
    parts = frozenset(part for frame_id in dataset.frame_ids for part in frame_id.split("/"))
    used = {_relative(path, dataset.root) for path in (*seen, *map(str, pictures))}
    told: dict[str, bool] = {}
    for folder, names in _unused(dataset.root, used, parts):
        names = [name for name in names if not re.fullmatch(dataset.again, name)]
        if camera_given:
            names = [name for name in names if role_of(PurePath(name).stem)[0] != "camera"]
        whole = bool(folder) and len(names) > MOST_OF_A_FOLDER
        label = [f"{folder}/ ({counted(len(names), 'file')})"] if whole else names
        both = enumerate(zip(label, names, strict=False), len(told))
        told |= {name: _may_tell(dataset.root, one, k < MOST_LOOKED_INTO) for k, (name, one) in both}
    own = [name for name, tells in told.items() if tells]
    named = [*own, *(name for name in told if name not in own)]
    if not named:
        return ""
    more = f" and {len(named) - MOST_NAMED} more" if len(named) > MOST_NAMED else ""
    note = f"not read: {', '.join(named[:MOST_NAMED])}{more}"
    plain = dataset.format in PLAIN
    return f"{note}; {SAYS_CAMERA.format(', '.join(own[:MOST_NAMED]))}" if own and plain else note


def _relative(path: str, root: Path) -> str:
    return os.path.relpath(os.path.abspath(path), os.path.abspath(root)).replace(os.sep, "/")


def _alike(name: str, parts: frozenset[str]) -> str:
    """A name with its numbers and the names of scenes left open: what it has in common with those of other frames."""
    folders, _, file = name.rpartition("/")
    stem, dot, suffix = file.rpartition(".")
    opened = ["*" if part in parts else re.sub("[0-9]+", "#", part) for part in (*folders.split("/"), stem)]
    return "/".join(opened) + dot + suffix


def _unused(root: Path, used: set[str], parts: frozenset[str]) -> Iterator[tuple[str, list[str]]]:
    """Folders below `root`, each with the paths of its files that are not like a used one."""
    alike = {_alike(name, parts) for name in used}
    # A folder of pictures has a file a frame, whatever they are called.
    kinds = {(_alike(f"{PurePath(name).parent}/", parts), PurePath(name).suffix.lower()) for name in used}
    for folder, names in _walk(root):
        where = _alike(f"{folder or '.'}/", parts)
        suffixes = {suffix for place, suffix in kinds if place == where}
        left: list[str] = []
        among = set(_PICTURES) if suffixes & set(_PICTURES) else set[str]()
        for name in names:
            if os.path.splitext(name)[1].lower() in among or name == FILE_NAME or _FOR_PEOPLE.fullmatch(name):
                continue
            path = f"{folder}/{name}" if folder else name
            if _alike(path, parts) not in alike:
                left.append(path)
        if left:
            yield folder, left


def _walk(root: Path) -> Iterator[tuple[str, list[str]]]:
    """Folders below the root, two deep, each with its files."""
    folders = [""]
    for folder in folders:
        inside, files = readable(root / folder, links=False)
        if folder.count("/") < 1 and len(folders) < MOST_FOLDERS:
            folders += [f"{folder}/{name}" if folder else name for name in inside][:MOST_FOLDERS]
        yield folder, files


def _may_tell(root: Path, name: str, looked_into: bool) -> bool:
    """Test whether a file speaks of a camera, poses or a unit, by its name or, where `looked_into`, by its numbers."""
    path = PurePath(name)
    if path.suffix.lower() not in _FACT_SUFFIXES:
        return False
    roles = {role_of(part)[0] for part in (*path.parts[:-1], path.stem)}
    if roles & {"camera", "pose"} or _FACTS.search(path.name):
        return True
    if not looked_into or path.suffix.lower() not in CAMERA_SUFFIXES or not is_small(root / name):
        return False
    return (or_note([], "", read_stated, root / name) or NOTHING).K is not None
