"""File roles by words in names, and pairing of colour and depth."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Callable, Iterable
from dataclasses import field
from pathlib import Path, PurePath

import numpy as np

from pipeline.datasets.cameras import CAMERA_SUFFIXES
from pipeline.datasets.files import natural, readable
from pipeline.datasets.images import DEPTH_SUFFIXES
from pipeline.datasets.stamps import ROUNDING, WITHIN, as_seconds, match_times, nearest
from pipeline.system.errors import InputError, require
from pipeline.system.frozen import dataclass

COLOR_SUFFIXES = (".png", ".jpg", ".jpeg", ".tif", ".tiff", ".ppm")
SUFFIXES = {
    "depth": DEPTH_SUFFIXES,
    "label": (".png",),
    "pose": (".txt",),
    "valid": (".npy", ".png"),
    "camera": CAMERA_SUFFIXES,
    "color": COLOR_SUFFIXES,
}
"""What a file of each role may end in."""

_ROLES = re.compile(
    r"(?<![a-z])(?:"
    r"(?P<other>vis|viz|colou?red|colormap|colou?ri[sz]ed|normals?|conf(?:idence)?|ir|infra(?:red)?|thumbs?|preview"
    r"|overlay|result|background|workspace|filled|pred)"
    r"|(?P<depth>depth(?:_?map|_?image)?s?|dpt)"
    r"|(?P<label>labels?|masks?|segs?|segmentations?|semantics?|instances?)"
    r"|(?P<pose>poses?)"
    r"|(?P<camera>meta(?:data)?|cameras?|cam|intrinsics?|calib(?:ration)?|k|info)"
    r"|(?P<color>colou?rs?|rgb|bgr|images?|img|wide)"
    r")(?:(?=crop)|(?![a-z]))",
    re.IGNORECASE,
)
_VALIDITY = re.compile(
    r"(?<![a-z])(?:depth[-_ ]?masks?|masks?[-_ ]?depth"
    r"|(?:depth[-_ ]?)?valid(?:ity)?(?:[-_ ]?(?:depth|masks?))*)(?![a-z])",
    re.IGNORECASE,
)
"""A name of what tells where depth counts, which is no depth."""
_LEFT, _RIGHT = (re.compile(rf"(?<![a-z]){side}(?![a-z])", re.IGNORECASE) for side in ("left", "right"))
FLOAT_SUFFIXES = (".exr", ".pfm", ".npy")
"""Endings of files that hold floats, whatever they are of."""
_ORDER = ("other", "valid", "depth", "label", "pose", "camera", "color")

Key = tuple[str, ...]
Naming = Callable[[str], Key]
"""What the names of two files of one frame have in common."""


def role_of(name: str) -> tuple[str, str]:
    """Role of a file or folder name ("" if none), and the rest of the name."""
    found: set[str] = set()

    def take(match: re.Match[str]) -> str:
        found.add(match.lastgroup or "")
        return ""

    left = _VALIDITY.sub("", name)
    found |= {"valid"} if left != name else set()
    rest = _ROLES.sub(take, left)
    role = next((role for role in _ORDER if role in found), "")
    return role, re.sub(r"[-_. ]{2,}", "_", rest).strip("-_. ")


def stem_of(name: str) -> str:
    """File name without folder and ending."""
    return name.rpartition("/")[2].rpartition(".")[0]


@dataclass(frozen=True)
class Files:
    """The files of a recording by role: names relative to the folder, in natural order."""

    root: Path
    flat: bool  # Colour and depth stand in one folder, and only their names tell them apart
    by_role: dict[str, list[str]] = field(default_factory=dict)

    def of(self, role: str) -> list[str]:
        return self.by_role.get(role, [])


def files_by_role(root: Path, depth: bool = True) -> Files | None:
    """Files of a recording by role; None without colour and depth by name. Without `depth` colour alone will do."""
    folders, names = readable(root)
    own = _by_name(names)
    roles = set(_folder_roles(folders).values())
    if "depth" not in roles | own.keys():
        stems = {stem_of(name) for name in own.get("color", ())}
        own["depth"] = [n for n in names if n.lower().endswith(FLOAT_SUFFIXES) and stem_of(n) in stems]
    in_folders = sum(len(files_in(root, folder, "depth")) for folder in folders if role_of(folder)[0] == "depth")
    # A picture or two beside the folders are no recording of their own.
    if own.get("color") and len(own.get("depth", ())) > in_folders:
        return Files(root, True, own | {"camera": [*own.get("camera", ()), *_inside(root, folders, "camera")]})
    if not depth and "color" not in roles and own.get("color"):
        return Files(root, True, own)
    if not ({"color", "depth"} if depth else {"color"}) <= roles:
        return None
    wanted = ("color", "depth", "label", "pose", "camera", "valid")
    found = {role: _inside(root, folders, role) for role in wanted if depth or role != "depth"}
    found["camera"] = [*own.get("camera", ()), *found["camera"]]
    return Files(root, False, found)


def files_in_roles(root: Path, role: str) -> list[str]:
    """Files of a role in folders of the role; empty without such a folder."""
    folders = [folder for folder in readable(root)[0] if role_of(folder)[0] == role]
    return _inside(root, folders, role) if folders else []


def _by_name(names: Iterable[str]) -> dict[str, list[str]]:
    """File names by role; pictures without a role word are colour."""
    found: dict[str, list[str]] = {}
    for name in names:
        stem, _, suffix = name.rpartition(".")
        role = role_of(stem)[0] or "plain"
        if f".{suffix.lower()}" in SUFFIXES.get(role, COLOR_SUFFIXES):
            found.setdefault(role, []).append(name)
    plain = found.pop("plain", [])
    color = _of_left(found.get("color", plain))
    return {**found, "color": color} if color else found


def _of_left(names: list[str]) -> list[str]:
    """The names of the left camera among those of a stereo pair; else all."""
    left = [name for name in names if _LEFT.search(name)]
    return left if left and all(_LEFT.search(name) or _RIGHT.search(name) for name in names) else names


def _folder_roles(folders: Iterable[str]) -> dict[str, str]:
    """Roles of folders by name; where none is of colour, the left camera's is."""
    roles = {folder: role_of(folder)[0] for folder in folders}
    left = {folder: "color" for folder, role in roles.items() if not role and _LEFT.search(folder)}
    return roles if "color" in roles.values() else {**roles, **left}


def _inside(root: Path, folders: Iterable[str], role: str) -> list[str]:
    """Files in folders of a role; colour and depth use a single folder, preferably of a plain name."""
    found = {folder: files_in(root, folder, role) for folder, own in _folder_roles(folders).items() if own == role}
    full = {folder: names for folder, names in found.items() if names}
    if role in ("color", "depth"):
        full = {folder: names for folder, names in full.items() if not role_of(folder)[1]} or full
        full = {folder: full[folder] for folder in _of_left(list(full))}
        what = {"color": "colour"}.get(role, role)
        got = f"{'/, '.join(found)}/ without one"
        require(full, f"no {what} files", got=got, expected=", ".join(SUFFIXES[role]), path=root)
        require(len(full) <= 1, f"more than one {what} folder", got=", ".join(full), expected="one", path=root)
    return [name for names in full.values() for name in names]


def files_in(root: Path, folder: str, role: str) -> list[str]:
    """Files of a role in a folder, relative to `root`."""
    return [f"{folder}/{name}" for name in readable(root / folder)[1] if name.lower().endswith(SUFFIXES[role])]


@dataclass(frozen=True, slots=True)
class Pair:
    """Files of a frame, relative to `root`; broken where a file is missing."""

    key: Key
    root: Path
    color_name: str | None
    depth_name: str | None

    @property
    def color(self) -> Path | None:
        return None if self.color_name is None else self.root / self.color_name

    @property
    def depth(self) -> Path | None:
        return None if self.depth_name is None else self.root / self.depth_name

    @property
    def stem(self) -> str:
        """Stem of the colour file, else of the depth file."""
        return stem_of(self.color_name or self.depth_name or "")


def numbers(name: str) -> Key:
    """Numbers in a file name; a time stamp with decimals is a single number."""
    return tuple(_ZEROS.sub("", number) for number in _NUMBER.findall(stem_of(name)))


_NUMBER = re.compile(r"[0-9]+(?:\.[0-9]+)?")
_ZEROS = re.compile(r"^0+(?=[0-9])")


def rest(name: str) -> Key:
    """Rest of a file name without role words."""
    left = role_of(stem_of(name))[1]
    return (_ZEROS.sub("", left),)


SURE = 0.9
"""Share of the files that pair by their numbers, below which nearness in time is tried."""


def choose_naming(colors: list[str], depths: list[str], flat: bool = False) -> Naming:
    """Choose the naming with the most pairs and unique names per folder."""
    known = {name: numbers(name) for name in (*colors, *depths)}
    numbered = all(known.values())

    def each(name: str) -> Key:
        return known[name] if name in known else numbers(name)

    # Recordings may number their files and add a time that differs between colour and depth.
    namings: tuple[Naming, ...] = (lambda name: each(name)[-1:], each, lambda name: each(name)[:1])
    if not numbered:
        namings = (lambda name: (stem_of(name),),)
    if flat or not numbered:
        # In one folder other pictures may have numbers too.
        namings = (rest, *namings)
    best: tuple[int, Naming] | None = None
    same = ""
    for naming in namings:
        keys = [list(map(naming, names)) for names in (colors, depths)]
        unique = [set(found) for found in keys]
        if any(len(found) < len(every) for found, every in zip(unique, keys, strict=True)):
            same = same or twice(naming, colors) or twice(naming, depths)
            continue
        count = len(unique[0] & unique[1])
        if best is None or count > best[0]:
            best = count, naming
        if count == min(len(colors), len(depths)):
            break
    if numbered and (best is None or best[0] < SURE * min(len(colors), len(depths))):
        timed = by_time(colors, depths)
        if timed is not None and timed.pairs > (0 if best is None else best[0]):
            return timed
    if best is None:
        what = "number" if numbered else "name"
        raise InputError(f"colour and depth cannot be paired: two files have the same {what}", got=same)
    return best[1]


TIME = re.compile(r"[0-9]+\.[0-9]+|[0-9]{10,}")
"""A number of a name that is a time: with decimals, or as many digits as seconds since 1970 have."""

_FRACTION = re.compile(r"(?<![0-9])([0-9]{10})[-_.]([0-9]{6}|[0-9]{9})(?![0-9])")
"""Seconds since 1970 and their micro- or nanoseconds."""


class ByTime:
    """A naming of recordings whose pictures and depth were taken at times of their own: depth, and whatever else is
    named by a time, has the key of the colour picture that is nearest within 20 ms."""

    def __init__(self, colors: list[str], depths: list[str]) -> None:
        self._colors = sorted(colors, key=_stamp)
        self._times = as_seconds(np.array([_stamp(name) for name in self._colors]))
        order = sorted(depths, key=_stamp)
        matched = match_times(self._times, as_seconds(np.array([_stamp(name) for name in order])))
        self._of = {order[j]: numbers(self._colors[i]) for i, j in matched.items()}
        self._of |= {name: numbers(name) for name in colors}
        self.pairs = len(matched)

    def matched(self, names: list[str]) -> list[str]:
        """Those of these names that belong to a colour picture."""
        return [name for name in names if name in self._of]

    def __call__(self, name: str) -> Key:
        if name in self._of:
            return self._of[name]
        own = numbers(name)
        if not _is_time(name):
            return own
        at = nearest(self._times, float(as_seconds(np.array([_stamp(name)]))[0]), WITHIN + ROUNDING)
        return own if at is None else numbers(self._colors[at])


def _stamp(name: str) -> float:
    if match := _FRACTION.search(stem_of(name)):
        return float(f"{match[1]}.{match[2]}")
    return float(numbers(name)[-1])


def _is_time(name: str) -> bool:
    return bool(any(TIME.fullmatch(last) for last in numbers(name)[-1:]) or _FRACTION.search(stem_of(name)))


def by_time(colors: list[str], depths: list[str]) -> ByTime | None:
    """The naming by nearest time; None where the names are no times."""
    names = [*colors, *depths]
    if not names or not all(map(_is_time, names)):
        return None
    naming = ByTime(colors, depths)
    return naming if naming.pairs else None


def twice(naming: Naming, names: list[str]) -> str:
    """Two files with the same key under `naming`, as text; else empty."""
    key, count = Counter(map(naming, names)).most_common(1)[0]
    return " and ".join(PurePath(name).name for name in names if naming(name) == key) if count > 1 else ""


def pair_files(naming: Naming, colors: list[str], depths: list[str], root: Path) -> list[Pair]:
    """Pairs for every frame with colour or depth, in natural order."""
    color = {naming(name): name for name in colors}
    depth = {naming(name): name for name in depths}
    require(
        not depths or color.keys() & depth.keys(),
        "colour and depth do not pair: no number or name in common",
        got=lambda: " and ".join(
            f"{stem_of(names[0])} ... {stem_of(names[-1])}" if names else "no picture" for names in (colors, depths)
        ),
        path=root,
    )
    keys = color.keys() | depth.keys()
    single = all(len(key) == 1 and key[0].isdecimal() for key in keys)
    order = (lambda key: (int(key[0]), key)) if single else (lambda key: [natural(part) for part in key])
    keys = sorted(keys, key=order)
    return [Pair(key, root, color.get(key), depth.get(key)) for key in keys]
