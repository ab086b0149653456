"""Plain recordings: colour and depth by file names, perhaps poses, camera files and label pictures."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import field, replace
from functools import partial
from pathlib import Path
from typing import ClassVar

import numpy as np

from pipeline.datasets.base import DatasetFormat
from pipeline.datasets.cameras import (
    NOTHING,
    Stated,
    is_small,
    or_note,
    pose_from_matrix,
    pose_from_quaternion,
    read_stated,
    stated_in_files,
)
from pipeline.datasets.files import as_floats, numbered_lines, read_matrix, readable
from pipeline.datasets.frame_poses import NamedPose, pose_named, rigid_matrices
from pipeline.datasets.images import INTEGER_DEPTH_SUFFIXES, read_depth, read_numbers
from pipeline.datasets.pairing import (
    COLOR_SUFFIXES,
    ByTime,
    Files,
    Key,
    Naming,
    Pair,
    choose_naming,
    files_by_role,
    files_in,
    pair_files,
    role_of,
    stem_of,
    twice,
)
from pipeline.datasets.recording import Listed, Recording, beyond_metres
from pipeline.datasets.settings import Settings
from pipeline.datasets.trajectories import NAMES, Trajectory, path_in, read_trajectory
from pipeline.geometry.frame import Annotation
from pipeline.geometry.masks import mask_box
from pipeline.language.counted import counted
from pipeline.system.errors import in_file, needed, require
from pipeline.system.frozen import dataclass
from pipeline.system.safe_files import without_use

NAME_FILES = ("labels.txt", "classes.txt", "image_sets/classes.txt", "label_names.txt")


def label_annotations(
    path: Path, names: Mapping[int, str], size: tuple[int, int], notes: list[str]
) -> tuple[Annotation, ...]:
    """A mask for each number of a label picture of (height, width) pixels; a note where it is broken. A number without
    a name is "object"."""
    numbers = or_note(notes, f"no labels, {path.name}: ", read_numbers, path)
    if numbers is None:
        return ()
    if numbers.shape != size:
        notes.append(f"no labels, {path.name}: not a picture of {size[1]}x{size[0]} with one channel")
        return ()
    found = []
    for index, number in enumerate(np.unique(numbers[numbers > 0]).tolist()):
        mask = numbers == number
        found.append(Annotation(index, names.get(number, "object"), np.array(mask_box(mask)), mask, instance=number))
    return tuple(found)


def read_label_names(root: Path) -> dict[int, str]:
    """Names by number: lines "number name", or names alone counted from 1; empty without a file."""
    for name in NAME_FILES:
        if not (root / name).is_file():
            continue
        lines = [line.split(maxsplit=1) for _, line in numbered_lines(root / name)]
        if all(len(words) == 2 and words[0].isdecimal() for words in lines):
            require(all(len(number) < 20 for number, _ in lines), "a label's number is too long", path=root / name)
            return {int(number): text for number, text in lines}
        return {number: " ".join(words) for number, words in enumerate(lines, start=1)}
    return {}


UPWARDS = (
    "rows of PFM are read from the bottom up, as the format has them; AirSim writes them from the top down: "
    'depth_turned = "top-bottom" in spatialviz.toml, and `doctor` tries'
)
NAMED_NUMBERS = (".json", ".yml", ".yaml", ".toml", ".ini", ".cfg", ".txt", ".npz")
MOST_CAMERA_FILES = 20
"""So many files that may speak of the camera are read."""


PoseText = tuple[Path, str | Trajectory | NamedPose | None, int]
"""A file with a 4x4 matrix; one and the key of its pose; `pose.txt` and a line of it; or a camera path, its lines and
the number of one."""


def _read_pose(path: Path, line: str | Trajectory | NamedPose | None, row: int = 0) -> np.ndarray:
    if isinstance(line, NamedPose):
        return line.read(path)
    if line is None:
        return pose_from_matrix(read_matrix(path, 4, 4))
    if isinstance(line, Trajectory):
        return line.pose(row)
    return pose_from_quaternion(as_floats(line.replace(",", " ").split(), 7, path, "tx ty tz qx qy qz qw"))


@dataclass(frozen=True)
class SceneFolder:
    """A folder of frames with labels, poses and cameras by key."""

    files: Files
    pairs: list[Pair]
    stated: Stated = NOTHING  # What a file for all frames says of the camera
    cameras: Mapping[Key, str] = field(default_factory=dict)
    valid: Mapping[Key, str] = field(default_factory=dict)
    labels: Mapping[Key, str] = field(default_factory=dict)  # Files of single frames, relative to the folder
    poses: Mapping[Key, PoseText] = field(default_factory=dict)
    pose_problem: str | None = None  # Why there are none although there is a file
    timed: bool = False  # Whether colour and depth belong together by nearest time
    keyed: bool = False  # Whether the format names the frames by their keys
    left: tuple[str, ...] = ()  # What a file of a frame holds that may be a pose and was not read

    @classmethod
    def of(cls, files: Files, known: bool, naming: Naming | None = None) -> SceneFolder:
        """List the frames of a folder; InputError where colour and depth do not pair or camera files differ. `told`
        says that the intrinsics are known already."""
        root = files.root
        colors, depths = files.of("color"), files.of("depth")
        keyed = naming is not None
        with in_file(root):
            naming = naming or choose_naming(colors, depths, files.flat)
        depths = naming.matched(depths) if isinstance(naming, ByTime) else depths
        pairs = pair_files(naming, colors, depths, root)
        require(pairs, "there is neither a colour picture nor depth", cause="was it unpacked to the end?", path=root)
        keys = {pair.key for pair in pairs}
        each = {role: {naming(name): name for name in files.of(role)} for role in ("camera", "label", "valid")}
        stated, cameras = NOTHING, {key: name for key, name in each["camera"].items() if key in keys}
        own = {} if keyed else cameras or _beside(root, pairs)
        if not cameras and own and _told(root / next(iter(own.values()))).K is not None:
            cameras = own
        if not cameras:
            stated = stated_in_files((root / name for name in files.of("camera")[:MOST_CAMERA_FILES]), known)
        if not keyed and (stated.units_per_metre is None or stated.K is None):
            read = {*own.values(), *files.of("camera")}
            stated = _by_fields(root, stated, read, not known and not cameras and stated.K is None)
        poses, problem = _poses(files, naming, [pair.key for pair in pairs])
        left: tuple[str, ...] = ()
        if not poses and own:
            poses, problem, left = _named_poses(root, own, problem)
        each_role = cameras, each["valid"], each["label"]
        return cls(files, pairs, stated, *each_role, poses, problem, isinstance(naming, ByTime), keyed, left)

    def camera(self, key: Key) -> Stated:
        """Camera facts of a frame."""
        if key not in self.cameras:
            return self.stated
        own = read_stated(self.files.root / self.cameras[key])
        rest = self.stated
        K, size, path = (own.K, own.size, own.path) if own.K is not None else (rest.K, rest.size, rest.path)
        return Stated(K, size, own.units_per_metre or rest.units_per_metre, path)

    def ids(self, prefix: str) -> list[str]:
        """Frame ids: names of the colour files, without role words in flat folders."""
        stems = [pair.key[0] if self.keyed else pair.stem for pair in self.pairs]
        if self.files.flat and not self.keyed:
            short = [role_of(stem)[1] or self.files.root.resolve().name for stem in stems]
            stems = short if len(set(short)) == len(short) else stems
        return [f"{prefix}/{stem}" if prefix else stem for stem in stems]


class FolderDataset(Recording):
    """Colour and depth files paired by the number or the rest of their names, in two folders or in one.

    A camera file beside them, or one a frame, is read whatever it is called, as long as a word of its name tells it.
    Poses come from `pose/N.txt` (a 4x4 matrix) or `pose.txt` (a line tx ty tz qx qy qz qw a frame), both
    camera-to-world. Lines belong to the frames in order where there are as many, and otherwise line N to number N.
    Label pictures hold a number a pixel, 0 for none; `labels.txt` names the numbers.
    """

    format = "folder"
    names: ClassVar[Mapping[int, str]] = {}
    """What numbers in label pictures mean, where no file says it."""
    parts: ClassVar[Mapping[str, str]] = {}
    """The format's own folders by role; empty where the words of names tell them."""

    def __init__(self, root: Path, settings: Settings) -> None:
        super().__init__(root, settings)
        known = settings.intrinsics is not None
        self._scenes = {
            prefix: SceneFolder.of(self._files(folder), known, self._naming())
            for prefix, folder in self._folders(root).items()
        }
        self._index = {
            frame_id: (prefix, pair)
            for prefix, scene in self._scenes.items()
            for frame_id, pair in zip(scene.ids(prefix), scene.pairs, strict=True)
        }
        self.frame_ids = tuple(self._index)
        if any(scene.labels for scene in self._scenes.values()):
            self._names = read_label_names(root) or self.names
            self.class_names = tuple(dict.fromkeys(self._names.values())) or ("object",)
        texts = [text for scene in self._scenes.values() for text in scene.poses.values()]
        self._arkit = any(isinstance(line, NamedPose) and line.arkit for _, line, _ in texts)
        if self.format in ("folder", "pictures"):
            told: dict[object, str] = {}
            for path, line, _ in texts:
                told.setdefault(line.key if isinstance(line, NamedPose) else path, _taken(path, line))
            left = (f"not read: {', '.join(scene.left)}" for scene in self._scenes.values() if scene.left)
            self.notes += (*filter(None, told.values()), *left)
        for scene in self._scenes.values():
            depth = next(iter(scene.files.of("depth")), "")
            if scene.files.flat and depth and role_of(stem_of(depth))[0] != "depth":
                self.notes += (f"{depth} and its like are taken for the depth of the pictures of their names",)
            if depth.lower().endswith(".pfm"):
                self.notes += (UPWARDS,)
        if any(scene.timed for scene in self._scenes.values()):
            self.notes += ("colour and depth are paired by nearest time, within 20 ms: no two have the same",)
        if valid := next((name for scene in self._scenes.values() for name in scene.valid.values()), None):
            self.notes += (f"depth counts only where {valid} and its like are not 0",)
        self._check()

    def _naming(self) -> Naming | None:
        """The format's own: what the names of the files of a frame have in common, which is the frame's name."""
        return None

    def _folders(self, root: Path) -> dict[str, Path]:
        return {"": root}

    def _files(self, folder: Path) -> Files:
        if self.parts:
            return Files(folder, False, {role: files_in(folder, name, role) for role, name in self.parts.items()})
        return needed(files_by_role(folder), "no colour and depth that their names tell", path=folder)

    def _camera(self, scene: SceneFolder, pair: Pair) -> Stated:
        return scene.camera(pair.key)

    def _pose(self, scene: SceneFolder, pair: Pair, notes: list[str]) -> np.ndarray | None:
        notes += [] if scene.pose_problem is None else [f"no camera pose: {scene.pose_problem}"]
        text = scene.poses.get(pair.key)
        if text is None:
            notes += ["no camera pose: its file is missing"] if scene.poses else []
            return None
        return or_note(notes, f"no camera pose, {text[0].name}: ", _read_pose, *text)

    def _up(self, pose: np.ndarray | None) -> np.ndarray | None:
        """Up vector, camera frame, of the layout's world; None for plain layouts."""
        return None if pose is None or not self._arkit else pose[1, :3]

    def _check(self) -> None:
        """Ask for a camera or a unit that nothing tells, by the first frame of each scene and file endings."""
        for scene in self._scenes.values():
            stated = or_note([], "", self._camera, scene, scene.pairs[0])
            if stated is None:
                continue  # What is wrong with its file is told when a frame is loaded.
            integer = any(name.lower().endswith(INTEGER_DEPTH_SUFFIXES) for name in scene.files.of("depth"))
            seen, first = _seen(scene), next((pair.depth for pair in scene.pairs if pair.depth), None)
            far = 0.0
            if first and not integer and self._settings.depth_scale is None and stated.units_per_metre is None:
                floats = or_note([], "", read_depth, first, None)
                far = 0.0 if floats is None else beyond_metres(floats)
            seen += f", whose floats cannot be metres, with a median of {far:.4g}" if far else ""
            self._ask_for(seen, stated, floats=not (integer or far))

    def _listed(self, frame_id: str, notes: list[str]) -> Listed:
        prefix, pair = self._found(self._index, frame_id)
        scene = self._scenes[prefix]
        color, depth = needed(pair.color, "the colour file is missing", path=pair.depth), pair.depth
        if not self._settings.estimated:
            depth = needed(depth, "the depth file is missing", path=color)
        pose = self._pose(scene, pair, notes)
        stated = NOTHING if self._known else self._camera(scene, pair)
        label = scene.labels.get(pair.key)
        annotate = None if label is None else partial(label_annotations, scene.files.root / label, self._names)
        valid = scene.files.root / scene.valid[pair.key] if pair.key in scene.valid else None
        return Listed(color, depth, stated, pose, annotate, self._up(pose), valid)

    @property
    def _known(self) -> bool:
        """Test whether the settings and the format leave no number to a camera file."""
        units = self._settings.depth_scale or self.rule.units_per_metre
        return self._settings.intrinsics is not None and units is not None


def _seen(scene: SceneFolder) -> str:
    """The colour and depth files of a scene in a few words."""
    first = next((p for p in scene.pairs if p.color_name and p.depth_name), scene.pairs[0])
    return f"{counted(len(scene.pairs), 'pair')} such as {first.color_name} and {first.depth_name}"


def _poses(files: Files, naming: Naming, keys: list[Key]) -> tuple[dict[Key, PoseText], str | None]:
    """Pose text by frame key, and the reason for missing poses."""
    known = set(keys)
    names = [name for name in files.of("pose") if "/" in name or naming(name) in known]
    if names:
        if same := twice(naming, names):
            return {}, f"pose/ has {same} for one frame"
        return {naming(name): (files.root / name, None, 0) for name in names}, None
    path = files.root / "pose.txt"
    if not path.is_file():
        return _along_path(files, keys)
    problems: list[str] = []
    lines = [line for _, line in or_note(problems, "pose.txt: ", numbered_lines, path) or ()]
    if problems:
        return {}, problems[0]
    if len(lines) == len(keys):
        return {key: (path, line, 0) for key, line in zip(keys, lines, strict=True)}, None
    if all(len(key) == 1 and key[0].isdecimal() and 1 <= int(key[0]) <= len(lines) for key in keys):
        return {key: (path, lines[int(key[0]) - 1], 0) for key in keys}, None
    return {}, f"pose.txt has {len(lines)} lines for {len(keys)} frames"


def _taken(path: Path, line: str | Trajectory | NamedPose | None) -> str:
    """A note of what poses are taken for, where it is not this layout's own."""
    if isinstance(line, Trajectory):
        return f"poses are those of {path.name}, taken for camera-to-world: --poses tells another way"
    if not isinstance(line, NamedPose):
        return ""
    return f"poses are {line.key} of {path.name} and its like, taken for {line.words}; `doctor` tries others"


def _beside(root: Path, pairs: list[Pair]) -> dict[Key, str]:
    """The JSON of each frame under its picture's name, where the first tells a camera or a pose."""
    names = [(pair.key, os.path.splitext(pair.color_name)[0] + ".json") for pair in pairs if pair.color_name]
    folders = {os.path.dirname(name) for _, name in names}
    there = {os.path.join(folder, name) for folder in folders for name in readable(root / folder)[1]}
    found = {key: name for key, name in names if name in there}
    for path in [root / name for name in found.values()][:1]:
        if not is_small(path) or (_told(path).K is None and or_note([], "", pose_named, path) is None):
            without_use(path)
            return {}
    return found


def _told(path: Path) -> Stated:
    """Camera facts of a file; nothing where it cannot be read."""
    return or_note([], "", read_stated, path) or NOTHING


def _named_poses(
    root: Path, own: Mapping[Key, str], problem: str | None
) -> tuple[dict[Key, PoseText], str | None, tuple[str, ...]]:
    """Poses that the files of frames name; the reason for missing ones; and what may be a pose in them, where none is
    named."""
    first = root / next(iter(own.values()))
    if (named := or_note([], "", pose_named, first)) is not None:
        return {key: (root / name, named, 0) for key, name in own.items()}, None, ()
    return {}, problem, tuple(f"{key} of {first.name}" for key in or_note([], "", rigid_matrices, first) or ())


def _by_fields(root: Path, known: Stated, read: set[str], camera: bool) -> Stated:
    """What the files beside the pictures, but for those that were `read`, tell by the names of their numbers, whatever
    they are called: the depth's unit, and the camera where it is asked for."""
    names = [n for n in readable(root)[1] if n.lower().endswith(NAMED_NUMBERS) and n not in read and is_small(root / n)]
    found: list[Path] = []
    units = known.units_per_metre
    for name in names[:MOST_CAMERA_FILES]:
        stated = _told(root / name)
        if camera and stated.named:
            found.append(root / name)
        elif stated.units_per_metre is None or units is not None:
            without_use(root / name)
        units = units or stated.units_per_metre
    return replace(stated_in_files(found) if found else known, units_per_metre=units)


def _along_path(files: Files, keys: list[Key]) -> tuple[dict[Key, PoseText], str | None]:
    """Poses of the format's camera path, of the one file beside the pictures that is called like one, or of a camera
    file with a matrix for each frame."""
    names = files.of("path") or [name for name in readable(files.root)[1] if NAMES.fullmatch(name)]
    numbers = [key[-1] if key else "" for key in keys]
    problems: list[str] = []
    if len(names) > 1:
        return {}, f"more than one camera path: {', '.join(names[:4])}"
    if names:
        found = or_note(problems, f"{names[0]}: ", read_trajectory, files.root / names[0])
    else:
        cameras = [files.root / name for name in files.of("camera")[:MOST_CAMERA_FILES] if is_small(files.root / name)]
        found = next(filter(None, (or_note([], "", path_in, path) for path in cameras)), None)
    if found is None:
        return {}, problems[0] if problems else None
    if not names and not set(found.frames) & set(numbers):
        return {}, f"{found.path.name}: its poses are of other frames, {found.frames[0]} for one"
    rows = or_note(problems, f"{found.path.name}: ", found.rows_of, numbers)
    if not rows:
        return {}, problems[0]
    return {key: (found.path, found, row) for key, row in zip(keys, rows, strict=True) if row is not None}, None


FORMAT = DatasetFormat(
    "folder",
    "folder: colour and depth in color/ and depth/, or side by side as N-color.png and N-depth.png",
    lambda root: files_by_role(root) is not None,
    FolderDataset,
)


class PicturesDataset(FolderDataset):
    """Colour alone, for `--depth-model`; poses, camera files and label pictures as in any recording in folders."""

    format = "pictures"

    def _files(self, folder: Path) -> Files:
        if folder.is_file():
            return Files(folder.parent, True, {"color": [folder.name]})
        return needed(files_by_role(folder, depth=False), "no pictures", path=folder)

    def _check(self) -> None:
        """Check nothing: colour alone has no unit, and the network or the user gives the focal length."""


def _are_pictures(root: Path) -> bool:
    return root.suffix.lower() in COLOR_SUFFIXES if root.is_file() else files_by_role(root, depth=False) is not None


PICTURES = DatasetFormat("pictures", "pictures: colour alone, with --depth-model", _are_pictures, PicturesDataset)
