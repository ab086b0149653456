"""Reading the small text files of a dataset, and pairing its colour and depth files by their names."""

from __future__ import annotations

import io
import json
import os
import re
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path, PurePosixPath, PureWindowsPath
from typing import Any

import numpy as np

from pipeline.system.errors import InputError, require

CUT_OFF = "was the copy or the download interrupted?"
COLOR_SUFFIXES = (".png", ".jpg", ".jpeg", ".tif", ".tiff", ".ppm")


def read_bytes(path: Path) -> bytes:
    """The whole file.

    Raises
    ------
    InputError
        Missing, unreadable, or empty.
    """
    try:
        data = path.read_bytes()
    except FileNotFoundError as error:
        raise InputError("a file is missing", path=path) from error
    except OSError as error:
        raise InputError("a file cannot be read", got=error.strerror, path=path) from error
    require(data, "a file is empty", got="0 bytes", cause="was the copy interrupted?", path=path)
    return data


def read_json(path: Path) -> dict[str, Any]:
    """A JSON file whose top level is an object.

    Raises
    ------
    InputError
        Missing, empty, malformed (with the line), or of another shape.
    """
    data = read_bytes(path)
    try:
        table = json.loads(data.decode("utf-8-sig"))
    except json.JSONDecodeError as error:
        raise InputError(
            f"malformed JSON in line {error.lineno}, column {error.colno}", got=error.msg, path=path
        ) from error
    except (UnicodeDecodeError, RecursionError, ValueError) as error:
        raise InputError("malformed JSON", got=f"{type(error).__name__}: {error}", path=path) from error
    require(isinstance(table, dict), "a JSON object was expected", got=type(table).__name__, path=path)
    return table


def numbered_lines(path: Path) -> list[tuple[int, str]]:
    """The lines of a text file that say something, each with its number in the file, from 1.

    Raises
    ------
    InputError
        Missing, empty, unreadable, or no text.
    """
    try:
        text = read_bytes(path).decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise InputError("not a text file", path=path) from error
    lines = ((number, line.strip()) for number, line in enumerate(text.splitlines(), start=1))
    return [(number, line) for number, line in lines if line and not line.startswith("#")]


def path_inside(root: Path, name: str, source: Path, line: int) -> Path:
    """The file that line `line` of the list `source` names, which must lie inside `root`.

    Raises
    ------
    InputError
        An absolute path, one with "..", or one with control characters.
    """
    windows = PureWindowsPath(name)
    outside = PurePosixPath(name).is_absolute() or windows.drive or windows.root or ".." in windows.parts
    require(
        name and not outside and name.isprintable(),
        f"line {line} names a file outside the dataset",
        got=repr(name[:80]),
        expected="a path relative to the dataset's folder, without ..",
        path=source,
    )
    return root / name


def read_matrix(path: Path, rows: int, columns: int) -> np.ndarray:
    """A text file of rows x columns numbers, as float64. inf and NaN may be among them."""
    words = " ".join(line for _, line in numbered_lines(path)).replace(",", " ").split()
    return as_floats(words, rows * columns, path).reshape(rows, columns)


def as_floats(values: Any, count: int, path: Path, what: str = "numbers") -> np.ndarray:
    """`values` as (count,) float64, whatever their nesting.

    Raises
    ------
    InputError
        Not numbers, or another count.
    """
    try:
        array = np.asarray(values, dtype=np.float64).ravel()
    except (TypeError, ValueError, OverflowError) as error:
        raise InputError(f"{what}: not numbers", got=str(values)[:60], path=path) from error
    require(array.size == count, f"{what}: a wrong count", got=array.size, expected=count, path=path)
    return array


def read_mat(path: Path, *names: str) -> dict[str, Any]:
    """The named variables of a MATLAB file, as far as it has them.

    Raises
    ------
    InputError
        Missing, cut off, or no MATLAB file.
    """
    data = read_bytes(path)
    from scipy.io import loadmat

    try:
        return loadmat(io.BytesIO(data), variable_names=names)
    except Exception as error:  # The package raises a dozen kinds of error for damaged files.
        raise InputError("a MATLAB file that cannot be read", got=str(error)[:120], cause=CUT_OFF, path=path) from error


def listing(folder: Path, links: bool = True) -> tuple[list[str], list[str]]:
    """Names of the folders and of the files in a folder, each in natural order, without hidden ones.

    Without `links` a folder that is a link counts as a file.
    """
    folders: list[str] = []
    files: list[str] = []
    try:
        with os.scandir(folder) as entries:
            for entry in entries:
                if not entry.name.startswith("."):
                    (folders if entry.is_dir(follow_symlinks=links) else files).append(entry.name)
    except OSError as error:
        raise InputError("a folder cannot be listed", got=error.strerror, path=folder) from error
    return sorted(folders, key=natural), sorted(files, key=natural)


def readable(folder: Path, links: bool = True) -> tuple[list[str], list[str]]:
    """`listing`, and nothing where the folder cannot be read: what may not be looked at is no data."""
    try:
        return listing(folder, links)
    except InputError:
        return [], []


def natural(name: str) -> tuple[list[tuple[int, int, str]], str]:
    """Sort key under which frame2 comes before frame10."""
    parts = re.findall(r"[0-9]+|[^0-9]+", name)
    return [(0, int(p), "") if p[0] in "0123456789" else (1, 0, p) for p in parts], name


Key = tuple[str, ...]
Naming = Callable[[Path], Key]
"""What two files of one frame have in common: a part of their names."""


@dataclass(frozen=True)
class Pair:
    """The files of one frame; either may be missing, and the frame is then broken."""

    key: Key
    color: Path | None
    depth: Path | None

    @property
    def stem(self) -> str:
        """The name of the colour file without its ending, or of the depth file where there is none."""
        return next(path.stem for path in (self.color, self.depth) if path is not None)


def image_files(root: Path, folders: tuple[str, ...], suffixes: tuple[str, ...], what: str) -> list[Path]:
    """The image files of the only folder that is named as one of `folders`."""
    found = {
        name: [root / name / file for file in listing(root / name)[1] if Path(file).suffix.lower() in suffixes]
        for name in listing(root)[0]
        if name.lower() in folders
    }
    full = {name: paths for name, paths in found.items() if paths}
    require(full, f"no {what} files", got=f"{'/, '.join(found)}/ without one", expected=", ".join(suffixes), path=root)
    require(len(full) <= 1, f"more than one {what} folder", got=", ".join(full), expected="one", path=root)
    return next(iter(full.values()))


def numbers(path: Path) -> Key:
    """Every number in a file's name; a time stamp with its decimals is one number."""
    found = re.findall(r"[0-9]+(?:\.[0-9]+)?", path.stem)
    return tuple(re.sub(r"^0+(?=[0-9])", "", number) for number in found)


def choose_naming(colors: list[Path], depths: list[Path]) -> Naming:
    """The way of naming a frame that pairs the most files, and under which no folder has a name twice.

    Raises
    ------
    InputError
        Under every way, some folder has a name twice.
    """
    numbered = all(numbers(path) for path in (*colors, *depths))
    # Recordings may number their files and add a time that differs between colour and depth.
    by_number: tuple[Naming, ...] = (lambda path: numbers(path)[-1:], numbers, lambda path: numbers(path)[:1])
    namings = by_number if numbered else (lambda path: (path.stem,),)
    same = [[twice(naming, colors), twice(naming, depths)] for naming in namings]
    good = [naming for naming, texts in zip(namings, same, strict=True) if not any(texts)]
    if good:
        return max(good, key=lambda naming: len(set(map(naming, colors)) & set(map(naming, depths))))
    raise InputError(
        f"colour and depth cannot be paired: two files have the same {'number' if numbered else 'name'}",
        got=next(filter(None, same[-1])),
        path=(colors if same[-1][0] else depths)[0].parent,
    )


def twice(naming: Naming, paths: list[Path]) -> str:
    """Two files that `naming` cannot tell apart, as text; empty where there are none."""
    key, count = Counter(map(naming, paths)).most_common(1)[0]
    return " and ".join(path.name for path in paths if naming(path) == key) if count > 1 else ""


def pair_files(naming: Naming, colors: list[Path], depths: list[Path]) -> list[Pair]:
    """Every frame that has colour or depth, in natural order.

    Raises
    ------
    InputError
        No colour file has a depth file.
    """
    color = {naming(path): path for path in colors}
    depth = {naming(path): path for path in depths}
    require(
        color.keys() & depth.keys(),
        "colour and depth do not pair: no number or name in common",
        got=f"{colors[0].name} ... {colors[-1].name} and {depths[0].name} ... {depths[-1].name}",
        path=colors[0].parent.parent,
    )
    keys = sorted(color.keys() | depth.keys(), key=lambda key: [natural(part) for part in key])
    return [Pair(key, color.get(key), depth.get(key)) for key in keys]


def paired_files(
    root: Path, folders: tuple[str, ...], depth_suffixes: tuple[str, ...], depth_folders: tuple[str, ...] = ("depth",)
) -> dict[str, Pair]:
    """Every frame of a recording by the name of its colour file, or of its depth file; raises as above."""
    colors = image_files(root, folders, COLOR_SUFFIXES, "colour")
    depths = image_files(root, depth_folders, depth_suffixes, "depth")
    return {pair.stem: pair for pair in pair_files(choose_naming(colors, depths), colors, depths)}
