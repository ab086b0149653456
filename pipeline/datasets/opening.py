"""Dataset opening with format detection."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import replace
from importlib import import_module
from pathlib import Path
from typing import TypeVar

from pipeline.datasets.base import Dataset, DatasetFormat
from pipeline.datasets.cameras import ShiftedPoses
from pipeline.datasets.files import listed_once, readable
from pipeline.datasets.meant import AsMeant
from pipeline.datasets.pairing import COLOR_SUFFIXES, FLOAT_SUFFIXES, role_of
from pipeline.datasets.parquet import is_lerobot_depth, lerobot_features
from pipeline.datasets.settings import OR_ESTIMATED, GivenUp, read_settings
from pipeline.datasets.unread import naming_unread, say_unread, telling_files
from pipeline.datasets.up import with_given_up
from pipeline.language.counted import counted
from pipeline.system.errors import InputError, UnknownFormat, require
from pipeline.system.plugins import load_plugins
from pipeline.system.remote import local_path
from pipeline.system.safe_files import enter, watched

Opened = TypeVar("Opened")
FORMATS = (
    "bop.FORMAT",
    "saved_case.FORMAT",
    "robospatial.FORMAT",
    "layouts.APC",
    "layouts.SEVEN_SCENES",
    "layouts.SCANNET",
    "tum.FORMAT",
    "sunrgbd.VOTENET_FORMAT",
    "sunrgbd.FORMAT",
    "layouts.YCB_VIDEO",
    "replica.REPLICA",
    "tum.ASSOCIATED",
    "phones.ARKITSCENES",
    "phones.RECORD3D",
    "phone_apps.STRAY",
    "phone_apps.POLYCAM",
    "scannetpp.SCANNETPP",
    "reconstructions.NERFSTUDIO",
    "reconstructions.COLMAP",
    "layouts.REDWOOD",
    "parquet.FORMAT",
    "streams.FORMAT",
    "avd.FORMAT",
    "semantic_abstraction.FORMAT",
)
"""The formats with marks of their own, by module; the first that recognises a folder opens it, and those behind it are
not imported. A new reader is one file and one name here."""
CAPTURES = ("phones.RECORD3D", "parquet.FORMAT", "streams.FORMAT")
"""Formats of single files, which are told by their names."""
FALLBACK, PICTURES = "folder.FORMAT", "folder.PICTURES"
"""What any other recording is opened as, after the plugins have been asked, and colour alone."""

ENTRY_POINT_GROUP = "spatialviz.datasets"
"""Entry points of this group name a DatasetFormat, and so add a reader."""


def open_dataset(
    path: str | Path,
    *,
    intrinsics: tuple[float, float, float, float] | None = None,
    depth_scale: float | None = None,
    up: str | None = None,
    level_at: str | None = None,
    depth_model: str | None = None,
    poses: str | None = None,
    registration: tuple[float, ...] | None = None,
    browse: bool = False,
) -> Dataset:
    """Open a folder of RGB-D frames without decoding an image.

    What is given here wins over `spatialviz.toml` beside the data, and that
    over the dataset's own files.

    Parameters
    ----------
    path : str or Path
        The dataset's folder, or its URL (see `remote.local_path`).
    intrinsics : (fx, fy, cx, cy), optional
        Pixels.
    depth_scale : float, optional
        Depth units in one metre: 1000 for millimetres.
    up : str, optional
        Against gravity: "world:X,Y,Z", "camera:X,Y,Z", or "X,Y,Z" for the world in a dataset with poses and the
        camera frame in one without.
    level_at : str, optional
        "FRAME:U,V", or "U,V" of the first frame: the surface at this pixel is level, in all frames of its scene
        that have poses.
    depth_model : str, optional
        A network that estimates depth: NAME, NAME=FILE.onnx, FILE.onnx or an id of the model hub. It stands in for
        depth that is missing, and replaces what was measured.
    poses : str, optional
        What the pose files mean, one of `pose_convention.CONVENTIONS`.
    registration : (fx, fy, cx, cy, tx, ty, tz), optional
        The colour camera as the depth camera sees it, pixels and metres; see `Settings`.
    browse : bool
        Frames are only looked at: where nothing tells the camera or the depth's unit, that is no error but a note
        and `Camera.untold`, and what measures refuses.

    Raises
    ------
    InputError
        No such folder, an unknown format (with what was looked for), or facts missing that only a person can give.

    Examples
    --------
    >>> from pipeline.datasets import demo_path, open_dataset
    >>> demo = open_dataset(demo_path())
    >>> demo.format, demo.frame_ids[:2]
    ('bop', ('000001/000000', '000001/000001'))
    """
    root = local_path(path)
    require(root.exists(), "there is no such dataset", expected="a folder", path=root)
    require(up is None or level_at is None, "--up and --level-at say the same", expected="one of them")
    up_vector = None if up is None else GivenUp.parse(up)
    known = read_settings(enter(root))
    enter(root, known.limits)
    model = None
    if depth_model is not None:
        from pipeline.datasets.depth.estimator import open_depth_model

        model = open_depth_model(str(depth_model))
    settings = replace(
        known.overridden(intrinsics, depth_scale, up_vector, poses=poses, registration=registration),
        # What is missing of measured depth does not matter where none is used.
        browse=browse or model is not None,
        estimated=model is not None,
    )
    with listed_once():
        for candidate in _formats(root, model is not None):
            if candidate.recognises(root):
                with watched() as seen, naming_unread(root, seen):
                    dataset = candidate.open(root, settings)
                    say_unread(dataset, seen, settings)
                if settings.meant:
                    dataset = AsMeant(dataset, settings.meant)
                if settings.pose_shift:
                    dataset = ShiftedPoses(dataset, settings.pose_shift)
                if model is not None:
                    from pipeline.datasets.depth.estimator import EstimatedDepth

                    dataset = EstimatedDepth(dataset, model, browse)
                return with_given_up(dataset, settings, level_at)
    known = tuple(_formats(root, model is not None))
    raise unknown(root, lambda path: any(candidate.recognises(path) for candidate in known))


def open_each(path: str | Path, open_one: Callable[[str | Path], Opened]) -> tuple[dict[str, Opened], dict[str, str]]:
    """Open a dataset, or all datasets in the folders of a folder, by `open_one`.

    Returns what was opened by the folder's name, at least one, and folders that could not be opened, and why.

    Raises
    ------
    InputError
        Where nothing can be opened; the reason is that of the folder itself.
    """
    try:
        return {Path(path).name or str(path): open_one(path)}, {}
    except UnknownFormat:
        folder = local_path(path)
        if not folder.is_dir():
            raise
        opened: dict[str, Opened] = {}
        left_out: dict[str, str] = {}
        with watched() as seen:
            for inside in sorted(p for p in folder.iterdir() if p.is_dir() and not p.name.startswith(".")):
                try:
                    opened[inside.name] = open_one(inside)
                except InputError as error:
                    left_out[inside.name] = str(error)
        if not opened:
            raise
        left_out |= dict.fromkeys(telling_files(folder, seen), "not read; a camera, poses or a unit may stand in it")
        return opened, left_out


def _formats(root: Path, estimated: bool) -> Iterator[DatasetFormat]:
    """The formats that a path may be of, in the order in which they are asked; each is imported when it is."""
    yield from map(_format, FORMATS if root.is_dir() else CAPTURES)
    if root.is_dir():
        yield from (loaded for _, loaded in load_plugins(ENTRY_POINT_GROUP, "dataset", DatasetFormat))
        yield _format(FALLBACK)
    if estimated:
        yield _format(PICTURES)


def _format(name: str) -> DatasetFormat:
    module, _, attribute = name.partition(".")
    return getattr(import_module(f"pipeline.datasets.{module}"), attribute)


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
DEEPER = 5
"""So many of the folders in so many of them, where none of them is one."""
LAYOUT = "pictures in color/ and depth in depth/ under the same names (docs/recordings.md)"
OF_FILE = {
    "picture": ("a single picture is no recording", f"the folder that holds it and its depth, {OR_ESTIMATED}"),
    "video": ("a video has no depth", f"its frames with depth: {LAYOUT}"),
    "point cloud": ("a point cloud or mesh has no frames", "the recording that it was made of"),
    "archive": ("an archive is not read in place", "the folder that it unpacks to"),
    "array file": ("a single array file is no recording", LAYOUT),
}
OTHER_CAPTURES = {
    ".mkv": ("a video, which Azure Kinect stores depth in", "what Open3D's azure_kinect_mkv_reader.py makes of it"),
    ".svo": ("a recording of a ZED camera", "pictures and depth of it: svo_export of the ZED SDK, mode 4"),
    ".svo2": ("a recording of a ZED camera", "pictures and depth of it: svo_export of the ZED SDK, mode 4"),
    ".sens": (
        "a recording of ScanNet",
        "what its SensReader unpacks: color/, depth/, pose/, intrinsic/",
    ),
    ".oni": ("a recording of OpenNI", LAYOUT),
    ".klg": ("a log of ElasticFusion", LAYOUT),
}
"""Captures that are known and not read, by ending: what they are, and what would do."""
SPECTACULAR = "data.jsonl", {"calibration.json", "data.mkv", "data.mp4", "data.mov", "data.avi", "vio_config.yaml"}
"""A recording of Spectacular AI has the first and some of these, https://spectacularai.github.io/docs/sdk/recording.html."""
HALVES = {
    "rgb.txt": "rgb.txt of TUM without depth.txt",
    "depth.txt": "depth.txt of TUM without rgb.txt",
    "scene_gt.json": "scene_gt.json of BOP without scene_camera.json",
    "cameras.bin": "cameras.bin of COLMAP without images.bin",
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
    fallback = "a file is no dataset", "its folder, or a capture: " + ", ".join(CAPTURE_SUFFIXES)
    of_file = OTHER_CAPTURES.get(path.suffix.lower(), OF_FILE.get(kind_of(path.name), fallback))
    what, expected = of_file if path.is_file() else _folder(path, recognised)
    return UnknownFormat(f"no dataset is recognised here: {what}", expected=expected, path=path)


def _folder(root: Path, recognised: Callable[[Path], bool]) -> tuple[str, str]:
    folders, files = readable(root)
    inside = [name for name in folders[:LOOKED_INTO] if recognised(root / name)] or [
        f"{name}/{below}"
        for name in folders[:DEEPER]
        for below in readable(root / name)[0][:DEEPER]
        if recognised(root / name / below)
    ]
    kinds = Counter(kind_of(name) for name in files)
    half = next((text for name, text in HALVES.items() if name in files), None)
    depths = [name for name in (*files, *folders) if role_of(Path(name).stem)[0] == "depth"]
    colors = [folder for folder in folders if role_of(folder)[0] == "color"]
    within = sum(kind_of(name) == "picture" for folder in colors for name in readable(root / folder)[1])
    pictures = within + sum(kind_of(name) == "picture" and name not in depths for name in files)
    if not folders and not files:
        return "the folder is empty", LAYOUT
    if SPECTACULAR[0] in files and SPECTACULAR[1] & set(files):
        what = "a recording of Spectacular AI: colour is a video, and its poses are not in data.jsonl yet"
        return what, "what `sai-cli process RECORDING OUTPUT` writes of it: transforms.json, images/ and depth"
    if half:
        return half, "both"
    if other := next((name for name in files if Path(name).suffix.lower() in OTHER_CAPTURES), None):
        what, expected = OTHER_CAPTURES[Path(other).suffix.lower()]
        return f"{other}: {what}", expected
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
        return (
            f"a folder of {counted(len(inside), 'dataset')}",
            f"{'it' if len(inside) == 1 else 'one of them'}: {root / inside[0]}",
        )
    if pictures and not depths:
        where = f" in {colors[0]}/" if within else ""
        name = next((name for name in files if kind_of(name) == "picture"), "")
        depth = f"{Path(name).stem}_depth.png" if name else "depth/0001.png beside color/0001.png"
        places = [files, *(readable(root / folder)[1] for folder in colors)]
        beside = next(n for n in places if any(kind_of(name) == "picture" for name in n))
        if maps := [name for name in beside if name.lower().endswith(FLOAT_SUFFIXES)]:
            picture = next(name for name in beside if kind_of(name) == "picture")
            stem, lying = (
                Path(picture).stem,
                [name for name in files if kind_of(name) != "picture" and name not in maps],
            )
            more = f" and {len(maps) - 1} more" if len(maps) > 1 else ""
            also = f"; also here: {', '.join(lying[:4])}" if lying else ""
            return (
                f"{counted(pictures, 'picture')}{where} and no depth by its name, but {maps[0]}{more}{also}",
                f"{stem}_depth{Path(maps[0]).suffix} beside {picture}, if they are depth, {OR_ESTIMATED}",
            )
        return (
            f"{counted(pictures, 'picture')}{where} and no depth",
            f"a depth file for each, such as {depth}, {OR_ESTIMATED}",
        )
    if depths and not pictures and kinds["video"]:
        video = next(name for name in files if kind_of(name) == "video")
        unpack = f"its frames: mkdir color && ffmpeg -i {video} -start_number 0 color/%06d.png"
        return f"depth ({depths[0]}) and colour in a video, {video}", unpack
    if depths and not pictures:
        return f"depth ({depths[0]}) without colour", LAYOUT
    for kind in ("video", "array file", "point cloud", "archive"):
        if kinds[kind]:
            name = next(name for name in files if kind_of(name) == kind)
            return f"{name}: {OF_FILE[kind][0]}", OF_FILE[kind][1]
    if folders:
        return f"folders {', '.join(folders[:4])}{' ...' if len(folders) > 4 else ''}", LAYOUT
    return f"{len(files)} files without pictures, {files[0]} for one", LAYOUT
