"""Errors for unrecognised paths: contents and advice."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from pathlib import Path

from pipeline.datasets.files import readable
from pipeline.datasets.pairing import COLOR_SUFFIXES, role_of
from pipeline.datasets.parquet import is_lerobot_depth, lerobot_features
from pipeline.datasets.settings import OR_ESTIMATED
from pipeline.language.counted import counted
from pipeline.system.errors import UnknownFormat

CAPTURE_SUFFIXES = (".bag", ".db3", ".mcap", ".r3d", ".parquet")
KINDS: dict[str, tuple[str, ...]] = {
    "picture": (*COLOR_SUFFIXES, ".bmp", ".webp", ".heic", ".gif"),
    "video": (".mp4", ".mov", ".avi", ".mkv", ".webm", ".m4v"),
    "capture": CAPTURE_SUFFIXES,
    "point cloud": (".ply", ".pcd", ".las", ".laz", ".obj", ".glb", ".stl"),
    "archive": (".zip", ".tar", ".gz", ".tgz", ".7z", ".rar"),
    "array file": (".npz", ".npy", ".h5", ".hdf5", ".pkl", ".mat"),
}
LOOKED_INTO = 40
"""So many folders are looked into for datasets."""
LAYOUT = "pictures in color/ and depth in depth/ under the same names (docs/recordings.md)"
OF_FILE = {
    "picture": ("a single picture is no recording", f"the folder that holds it and its depth, {OR_ESTIMATED}"),
    "video": ("a video has no depth", f"its frames with depth: {LAYOUT}"),
    "point cloud": ("a point cloud or mesh has no frames", "the recording that it was made of"),
    "archive": ("an archive is not read in place", "the folder that it unpacks to"),
    "array file": ("a single array file is no recording", LAYOUT),
}
HALVES = {
    "rgb.txt": "rgb.txt of TUM without depth.txt",
    "depth.txt": "depth.txt of TUM without rgb.txt",
    "scene_gt.json": "scene_gt.json of BOP without scene_camera.json",
    "cameras.bin": "a binary COLMAP model (colmap model_converter --output_type TXT)",
    "cameras.txt": "cameras.txt of COLMAP without images.txt",
    "annotations.json": "annotations.json without pictures and depth",
}
"""Files that belong to a format whose other half is missing."""


def kind_of(name: str) -> str:
    """Kind of a file by ending; empty if unknown."""
    return next((kind for kind, ends in KINDS.items() if name.lower().endswith(ends)), "")


def unknown(path: Path, recognised: Callable[[Path], bool]) -> UnknownFormat:
    """Error for an unrecognised path: contents and advice in a line. `recognised` says whether a reader would open
    another one."""
    what, expected = _file(path) if path.is_file() else _folder(path, recognised)
    return UnknownFormat(f"no dataset is recognised here: {what}", expected=expected, path=path)


def _file(path: Path) -> tuple[str, str]:
    fallback = "a file is no dataset", "its folder, or a capture: " + ", ".join(CAPTURE_SUFFIXES)
    return OF_FILE.get(kind_of(path.name), fallback)


def _folder(root: Path, recognised: Callable[[Path], bool]) -> tuple[str, str]:
    folders, files = readable(root)
    inside = [name for name in folders[:LOOKED_INTO] if recognised(root / name)]
    kinds = Counter(kind_of(name) for name in files)
    half = next((text for name, text in HALVES.items() if name in files), None)
    depths = [name for name in (*files, *folders) if role_of(Path(name).stem)[0] == "depth"]
    beside = [folder for folder in folders if role_of(folder)[0] == "color"]
    within = sum(kind_of(name) == "picture" for folder in beside for name in readable(root / folder)[1])
    pictures = within + sum(kind_of(name) == "picture" and name not in depths for name in files)
    if not folders and not files:
        return "the folder is empty", LAYOUT
    if half:
        return half, "both"
    if kinds["capture"]:
        captures = [name for name in files if kind_of(name) == "capture"]
        return f"a folder with {captures[0]}", f"the capture itself: {root / captures[0]}"
    features = lerobot_features(root)
    videos = [name for name, feature in features.items() if feature.get("dtype") == "video"]
    if features:
        depth = any(is_lerobot_depth(features, name) for name in features)
        what = f"pictures in videos ({', '.join(videos[:2])}{' ...' if len(videos) > 2 else ''})" if videos else ""
        seen = " and ".join(text for text in (what, "" if depth else "no depth") if text)
        return f"a dataset of LeRobot with {seen or 'no colour'}", "one recorded with depth and --dataset.video=false"
    if inside:
        return f"a folder of {counted(len(inside), 'dataset')}", f"one of them, such as {root / inside[0]}"
    if pictures and not depths:
        where = f" in {beside[0]}/" if within else ""
        return (
            f"{counted(pictures, 'picture')}{where} and no depth",
            f"a depth file for each, such as {_depth_name(files)}, {OR_ESTIMATED}",
        )
    if depths and not pictures:
        return f"depth ({depths[0]}) without colour", LAYOUT
    for kind in ("video", "array file", "point cloud", "archive"):
        if kinds[kind]:
            name = next(name for name in files if kind_of(name) == kind)
            return f"{name}: {OF_FILE[kind][0]}", OF_FILE[kind][1]
    if folders:
        return f"folders {', '.join(folders[:4])}{' ...' if len(folders) > 4 else ''}", LAYOUT
    return f"{len(files)} files without pictures, {files[0]} for one", LAYOUT


def _depth_name(files: list[str]) -> str:
    """Possible name of a depth file for the first picture."""
    name = next((name for name in files if kind_of(name) == "picture"), "")
    return f"{Path(name).stem}_depth.png" if name else "depth/0001.png beside color/0001.png"
