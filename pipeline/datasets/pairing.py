"""Which files are colour, depth, labels, poses or cameras by the words in their names, and which are of one frame."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from pathlib import Path, PurePath

from pipeline.datasets.camera_files import CAMERA_SUFFIXES
from pipeline.datasets.files import listing, natural, readable
from pipeline.datasets.images import DEPTH_SUFFIXES
from pipeline.system.errors import InputError, require

COLOR_SUFFIXES = (".png", ".jpg", ".jpeg", ".tif", ".tiff", ".ppm")
SUFFIXES = {
    "depth": DEPTH_SUFFIXES,
    "label": (".png",),
    "pose": (".txt",),
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
_ORDER = ("other", "depth", "label", "pose", "camera", "color")

Key = tuple[str, ...]
Naming = Callable[[str], Key]
"""What the names of two files of one frame have in common."""


def role_of(name: str) -> tuple[str, str]:
    """(its role or "", what is left of it) of a file's name without its ending, or of a folder's."""
    found: set[str] = set()

    def take(match: re.Match[str]) -> str:
        found.add(match.lastgroup or "")
        return ""

    rest = _ROLES.sub(take, name)
    role = next((role for role in _ORDER if role in found), "")
    return role, re.sub(r"[-_. ]{2,}", "_", rest).strip("-_. ")


def stem_of(name: str) -> str:
    """The name of a file without its folder and its ending."""
    return name.rpartition("/")[2].rpartition(".")[0]


@dataclass(frozen=True)
class Files:
    """The files of a recording by role: names relative to the folder, in natural order.

    Attributes
    ----------
    flat : bool
        Colour and depth stand in one folder, and only their names tell them apart.
    """

    root: Path
    flat: bool
    by_role: dict[str, list[str]] = field(default_factory=dict)

    def of(self, role: str) -> list[str]:
        return self.by_role.get(role, [])

    def paths(self, role: str) -> list[Path]:
        return [self.root / name for name in self.of(role)]


def files_by_role(root: Path, depth: bool = True) -> Files | None:
    """The files of a recording in a folder; None where it holds no colour and depth that its names tell.

    Without `depth` colour alone will do.
    """
    folders, names = readable(root)
    own = _by_name(names)
    beside = sum(len(_files(root, folder, "depth")) for folder in folders if role_of(folder)[0] == "depth")
    # A picture or two beside the folders are no recording of their own.
    if own.get("color") and len(own.get("depth", ())) > beside:
        return Files(root, True, own | {"camera": [*own.get("camera", ()), *_inside(root, folders, "camera")]})
    roles = {role_of(folder)[0] for folder in folders}
    if not depth and "color" not in roles and own.get("color"):
        return Files(root, True, own)
    if not ({"color", "depth"} if depth else {"color"}) <= roles:
        return None
    wanted = ("color", "depth", "label", "pose", "camera")
    found = {role: _inside(root, folders, role) for role in wanted if depth or role != "depth"}
    found["camera"] = [*own.get("camera", ()), *found["camera"]]
    return Files(root, False, found)


def files_in_roles(root: Path, role: str) -> list[str]:
    """The files of a role in the folders of that role, as `files_by_role` has them; none without such a folder."""
    folders = [folder for folder in readable(root)[0] if role_of(folder)[0] == role]
    return _inside(root, folders, role) if folders else []


def _by_name(names: Iterable[str]) -> dict[str, list[str]]:
    """Names of the files of one folder by the role that their words tell; a picture without such a word is colour."""
    found: dict[str, list[str]] = {}
    for name in names:
        stem, _, suffix = name.rpartition(".")
        role = role_of(stem)[0] or "plain"
        if f".{suffix.lower()}" in SUFFIXES.get(role, COLOR_SUFFIXES):
            found.setdefault(role, []).append(name)
    plain = found.pop("plain", [])
    return found if "color" in found or not plain else {**found, "color": plain}


def _inside(root: Path, folders: Iterable[str], role: str) -> list[str]:
    """The files of a role in folders of that role; colour and depth stand in one, the one of their plain name first."""
    found = {folder: _files(root, folder, role) for folder in folders if role_of(folder)[0] == role}
    full = {folder: names for folder, names in found.items() if names}
    if role in ("color", "depth"):
        full = {folder: names for folder, names in full.items() if not role_of(folder)[1]} or full
        one_folder(found, full, role, root)
    return [name for names in full.values() for name in names]


def _files(root: Path, folder: str, role: str) -> list[str]:
    return [f"{folder}/{name}" for name in readable(root / folder)[1] if name.lower().endswith(SUFFIXES[role])]


def one_folder(found: dict[str, list[str]], full: dict[str, list[str]], role: str, root: Path) -> None:
    """Raise InputError where not exactly one of the folders has files."""
    what = {"color": "colour"}.get(role, role)
    suffixes = ", ".join(SUFFIXES[role])
    require(full, f"no {what} files", got=f"{'/, '.join(found)}/ without one", expected=suffixes, path=root)
    require(len(full) <= 1, f"more than one {what} folder", got=", ".join(full), expected="one", path=root)


@dataclass(frozen=True, slots=True)
class Pair:
    """The files of one frame, relative to `root`; either may be missing, and the frame is then broken."""

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
        """The name of the colour file without its ending, or of the depth file where there is none."""
        return stem_of(self.color_name or self.depth_name or "")


def image_files(root: Path, folders: tuple[str, ...], suffixes: tuple[str, ...], role: str) -> list[str]:
    """The image files of the only folder that is named as one of `folders`, relative to `root`."""
    found = {
        folder: [f"{folder}/{name}" for name in listing(root / folder)[1] if name.lower().endswith(suffixes)]
        for folder in listing(root)[0]
        if folder.lower() in folders
    }
    full = {name: paths for name, paths in found.items() if paths}
    one_folder(found, full, role, root)
    return next(iter(full.values()))


def numbers(name: str) -> Key:
    """Every number in a file's name; a time stamp with its decimals is one number."""
    return tuple(_ZEROS.sub("", number) for number in _NUMBER.findall(stem_of(name)))


_NUMBER = re.compile(r"[0-9]+(?:\.[0-9]+)?")
_ZEROS = re.compile(r"^0+(?=[0-9])")


def rest(name: str) -> Key:
    """What the words of its role leave of a file's name."""
    left = role_of(stem_of(name))[1]
    return (_ZEROS.sub("", left),)


def choose_naming(colors: list[str], depths: list[str], flat: bool = False) -> Naming:
    """The way of naming a frame that pairs the most files, and under which no folder has a name twice.

    Raises
    ------
    InputError
        Under every way, some folder has a name twice.
    """
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
    if best is None:
        what = "number" if numbered else "name"
        raise InputError(f"colour and depth cannot be paired: two files have the same {what}", got=same)
    return best[1]


def twice(naming: Naming, names: list[str]) -> str:
    """Two files that `naming` cannot tell apart, as text; empty where there are none."""
    key, count = Counter(map(naming, names)).most_common(1)[0]
    return " and ".join(PurePath(name).name for name in names if naming(name) == key) if count > 1 else ""


def pair_files(naming: Naming, colors: list[str], depths: list[str], root: Path) -> list[Pair]:
    """Every frame that has colour or depth, in natural order.

    Raises
    ------
    InputError
        There are depth files, and no colour file has a depth file.
    """
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


def paired_files(
    root: Path, folders: tuple[str, ...], depth_suffixes: tuple[str, ...], depth_folders: tuple[str, ...] = ("depth",)
) -> dict[str, Pair]:
    """Every frame of a recording by the name of its colour file, or of its depth file; raises as above."""
    colors = image_files(root, folders, COLOR_SUFFIXES, "color")
    depths = image_files(root, depth_folders, depth_suffixes, "depth")
    return {pair.stem: pair for pair in pair_files(choose_naming(colors, depths), colors, depths, root)}
