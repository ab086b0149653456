"""Finding the colour and the depth files of a recording, and pairing them by their names."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from pipeline.datasets.files import listing, natural
from pipeline.system.errors import InputError

Key = tuple[str, ...]
Naming = Callable[[Path], Key]
"""What two files of one frame have in common: a part of their names."""


@dataclass(frozen=True)
class Pair:
    """The files of one frame; either may be missing, and the frame is then broken."""

    key: Key
    color: Path | None
    depth: Path | None


def image_files(root: Path, folders: tuple[str, ...], suffixes: tuple[str, ...], what: str) -> list[Path]:
    """The image files of the only folder that is named as one of `folders`."""
    found: dict[str, list[Path]] = {}
    for name in listing(root)[0]:
        if name.lower() in folders:
            paths = [root / name / file for file in listing(root / name)[1]]
            found[name] = [path for path in paths if path.suffix.lower() in suffixes]
    full = {name: paths for name, paths in found.items() if paths}
    if not full:
        raise InputError(
            f"no {what} files",
            got=f"{'/, '.join(found)}/ without one",
            expected=", ".join(suffixes),
            path=root,
        )
    if len(full) > 1:
        raise InputError(f"more than one {what} folder", got=", ".join(full), expected="one", path=root)
    return next(iter(full.values()))


def numbers(path: Path) -> Key:
    """Every number in a file's name; a time stamp with its decimals is one number."""
    found = re.findall(r"[0-9]+(?:\.[0-9]+)?", path.stem)
    return tuple(re.sub(r"^0+(?=[0-9])", "", number) for number in found)


def _last_number(path: Path) -> Key:
    return numbers(path)[-1:]


def _first_number(path: Path) -> Key:
    return numbers(path)[:1]


def _stem(path: Path) -> Key:
    return (path.stem,)


def choose_naming(colors: list[Path], depths: list[Path]) -> Naming:
    """The way of naming a frame that pairs the most files, and under which no folder has a name twice.

    Raises
    ------
    InputError
        Under every way, some folder has a name twice.
    """
    numbered = all(numbers(path) for path in (*colors, *depths))
    # Recordings may number their files and add a time that differs between colour and depth.
    namings: tuple[Naming, ...] = (_last_number, numbers, _first_number) if numbered else (_stem,)
    good: list[Naming] = []
    same: list[str] = []
    for naming in namings:
        same = [twice(naming, colors), twice(naming, depths)]
        if not any(same):
            good.append(naming)
    if good:
        return max(good, key=lambda naming: len(set(map(naming, colors)) & set(map(naming, depths))))
    raise InputError(
        "colour and depth cannot be paired: two files have the same number"
        if numbered
        else "colour and depth cannot be paired: two files have the same name",
        got=next(filter(None, same)),
        path=(colors if same[0] else depths)[0].parent,
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
    if not color.keys() & depth.keys():
        raise InputError(
            "colour and depth do not pair: no number or name in common",
            got=f"{colors[0].name} ... {colors[-1].name} and {depths[0].name} ... {depths[-1].name}",
            path=colors[0].parent.parent,
        )
    keys = sorted(color.keys() | depth.keys(), key=lambda key: [natural(part) for part in key])
    return [Pair(key, color.get(key), depth.get(key)) for key in keys]
