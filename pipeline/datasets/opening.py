"""Dataset opening with format detection."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from pipeline.datasets import (
    avd,
    bop,
    folder,
    layouts,
    parquet,
    phones,
    reconstructions,
    robospatial,
    saved_case,
    semantic_abstraction,
    streams,
    sunrgbd,
    tum,
)
from pipeline.datasets.base import Dataset, DatasetFormat
from pipeline.datasets.cameras import ShiftedPoses
from pipeline.datasets.depth.estimated import EstimatedDepth
from pipeline.datasets.depth.estimator import open_depth_model
from pipeline.datasets.files import listed_once
from pipeline.datasets.settings import GivenUp, read_settings
from pipeline.datasets.unknown import unknown
from pipeline.datasets.up import with_given_up
from pipeline.system.errors import require
from pipeline.system.plugins import load_plugins
from pipeline.system.remote import local_path
from pipeline.system.safe_files import enter

FORMATS: tuple[DatasetFormat, ...] = (
    saved_case.FORMAT,
    robospatial.FORMAT,
    bop.FORMAT,
    layouts.APC,
    layouts.SEVEN_SCENES,
    layouts.SCANNET,
    tum.FORMAT,
    sunrgbd.VOTENET_FORMAT,
    sunrgbd.FORMAT,
    layouts.YCB_VIDEO,
    phones.ARKITSCENES,
    phones.RECORD3D,
    reconstructions.NERFSTUDIO,
    reconstructions.COLMAP,
    layouts.REDWOOD,
    parquet.FORMAT,
    streams.FORMAT,
    avd.FORMAT,
    semantic_abstraction.FORMAT,
)
"""The formats with marks of their own; the first that recognises a folder opens it.
A new reader is one file and one line here."""

CAPTURES: tuple[DatasetFormat, ...] = (phones.RECORD3D, parquet.FORMAT, streams.FORMAT)
"""Formats of single files, which are told by their names."""

FALLBACK = folder.FORMAT
"""What any other recording is opened as, after the plugins have been asked."""

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
    told = None if up is None else GivenUp.parse(up)
    known = read_settings(enter(root))
    enter(root, known.limits)
    model = None if depth_model is None else open_depth_model(str(depth_model))
    settings = replace(
        known.overridden(intrinsics, depth_scale, told, poses=poses, registration=registration),
        # What is missing of measured depth does not matter where none is used.
        browse=browse or model is not None,
        estimated=model is not None,
    )
    added = (loaded for _, loaded in load_plugins(ENTRY_POINT_GROUP, "dataset", DatasetFormat))
    formats = (*FORMATS, *added, FALLBACK) if root.is_dir() else CAPTURES
    formats = formats if model is None else (*formats, folder.PICTURES)
    with listed_once():
        for candidate in formats:
            if candidate.recognises(root):
                dataset = candidate.open(root, settings)
                if settings.pose_shift:
                    dataset = ShiftedPoses(dataset, settings.pose_shift)
                if model is not None:
                    dataset = EstimatedDepth(dataset, model, browse)
                return with_given_up(dataset, settings, level_at)
    raise unknown(root, lambda path: any(candidate.recognises(path) for candidate in formats))
