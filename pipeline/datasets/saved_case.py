"""The frame of a saved case: colour and depth without loss, the camera, the annotations.

`pipeline.diagnosis.cases` writes the folder and reads all of it; here its frame is a dataset of one. The files have
fixed names, so that a case can name none outside its folder, and the sha256 of each stands in `spatialviz-case.json`.
"""

from __future__ import annotations

import hashlib
import io
from pathlib import Path
from typing import Any, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, FiniteFloat, ValidationError

from pipeline.datasets.base import DatasetFormat, unknown_id
from pipeline.datasets.files import read_json
from pipeline.datasets.images import read_color, read_depth
from pipeline.datasets.settings import Settings
from pipeline.geometry.boxes import Box3D
from pipeline.geometry.camera import Camera, UpSource
from pipeline.geometry.frame import Annotation, Frame
from pipeline.geometry.masks import RunLength
from pipeline.system.encoded_pictures import png
from pipeline.system.errors import InputError, as_input_error, in_file, require
from pipeline.system.reading import checked
from pipeline.system.safe_files import enter, read_bytes

MANIFEST = "spatialviz-case.json"
CASE_FORMAT = "spatialviz-case-1"
DAMAGED = "the case is damaged at {}"
COLOR = "rgb.png"
PACKED = 6
UNITS = (1000.0, 10_000.0, 5000.0, 4000.0, 2000.0, 8000.0, 256.0, 1.0)
"""Depth units in one metre that are tried, so that depth is 16-bit integers to the last bit."""

Three = tuple[FiniteFloat, FiniteFloat, FiniteFloat]
Four = tuple[FiniteFloat, FiniteFloat, FiniteFloat, FiniteFloat]


class _Strict(BaseModel):
    model_config = ConfigDict(extra="forbid")


class SavedBox(_Strict):
    """A 3D box in the camera frame, metres."""

    center: Three  # Metres
    R: tuple[Three, Three, Three]  # Three rows; the columns are the box's axes
    size: Three  # Full edge lengths, metres


class SavedAnnotation(_Strict):
    """`pipeline.geometry.frame.Annotation` with the mask as COCO run lengths."""

    index: int  # Place in the dataset's list of the frame
    label: str  # Class name
    bbox: Four  # x0, y0, x1, y1, pixels
    mask: RunLength | None = None  # Visible pixels
    box: SavedBox | None = None  # Exact 3D box, where the dataset knows it
    visible: FiniteFloat | None = None  # Share that is not occluded
    instance: int | None = None  # The same object's number in all frames
    difficulty: int | None = None  # Of finding it; 1 is easy
    fixed: bool = False  # The 3D box stands as it is


class _SavedViewer(BaseModel):
    """Up vector of the kept answer, to six decimals."""

    up: Three
    up_source: UpSource


class SavedFrame(_Strict):
    """A frame without pixels. `units` is depth units per metre, None where depth.npy holds float32 metres. `up` is null
    in older cases where it was found from the depth; then it is that of the kept answer."""

    id: str = Field(min_length=1)  # Of the frame in its dataset
    width: int = Field(ge=1)  # Pixels
    height: int = Field(ge=1)  # Pixels
    depth: Literal["depth.png", "depth.npy"]  # File of the depth
    units: FiniteFloat | None = Field(gt=0)  # Depth units in one metre; null for metres
    K: tuple[Three, Three, Three]  # Intrinsics, pixels
    T_world_camera: tuple[Four, Four, Four, Four] | None  # Pose: camera to world, metres
    up: Three | None  # Against gravity, camera frame
    up_source: UpSource | None  # What says so
    annotations: tuple[SavedAnnotation, ...]  # Annotated objects
    notes: tuple[str, ...] = ()  # Oddities of the frame
    depth_source: str | None = None  # Network that estimated the depth


def saved_frame(frame: Frame) -> tuple[SavedFrame, dict[str, bytes]]:
    """Record and files, by name, of a saved frame."""
    camera = frame.camera
    depth_file, units, depth = _depth_bytes(frame.depth)
    record = SavedFrame.model_validate(
        {
            "id": frame.id,
            "width": frame.width,
            "height": frame.height,
            "depth": depth_file,
            "units": units,
            "K": camera.K.tolist(),
            "T_world_camera": None if camera.T_world_camera is None else camera.T_world_camera.tolist(),
            "up": None if camera.up is None else camera.up.tolist(),
            "up_source": camera.up_source,
            "annotations": [
                {
                    "index": a.index,
                    "label": a.label,
                    "bbox": [float(v) for v in a.bbox],
                    "mask": None if a.mask is None else RunLength.of(a.mask),
                    "box": a.box
                    and {"center": a.box.center.tolist(), "R": a.box.R.tolist(), "size": a.box.size.tolist()},
                    "visible": a.visible,
                    "instance": a.instance,
                    "difficulty": a.difficulty,
                    "fixed": a.fixed,
                }
                for a in frame.annotations
            ],
            "notes": frame.notes,
            "depth_source": frame.depth_source or None,
        }
    )
    return record, {COLOR: png(np.ascontiguousarray(frame.rgb[..., ::-1]), PACKED), depth_file: depth}


def _depth_bytes(depth: np.ndarray) -> tuple[str, float | None, bytes]:
    """File name, units per metre and bytes of the depth: integers where lossless."""
    for units in UNITS:
        stored = np.round(depth.astype(np.float64) * units)
        if stored.max(initial=0) < 65536:
            whole = stored.astype(np.uint16)
            if np.array_equal(np.divide(whole, np.float32(units), dtype=np.float32, casting="same_kind"), depth):
                return "depth.png", units, png(whole, PACKED)
    buffer = io.BytesIO()
    np.save(buffer, depth)
    return "depth.npy", None, buffer.getvalue()


def read_manifest(root: Path) -> dict[str, Any]:
    """Read the manifest of a case in this program's format."""
    path = enter(root) / MANIFEST
    table = read_json(path)
    require(
        table.get("format") == CASE_FORMAT,
        "a case of another format",
        got=table.get("format"),
        expected=CASE_FORMAT,
        path=path,
    )
    return table


def checked_file(root: Path, manifest: dict[str, Any], name: str) -> Path:
    """Path of a case file with the recorded checksum."""
    path = root / name
    files = manifest.get("files")
    wanted = files.get(name) if isinstance(files, dict) else None
    if not isinstance(wanted, str):
        raise InputError(f"the case does not list {name}", path=root / MANIFEST)
    require(path.is_file(), "a file of the case is missing", path=path)
    with as_input_error("a file of the case cannot be read", OSError, got=lambda error: error.strerror, path=path):
        found = hashlib.sha256(read_bytes(path)).hexdigest()
    require(
        found == wanted, "a file of the case was changed", got=f"sha256 {found[:12]}", expected=wanted[:12], path=path
    )
    return path


def read_saved_frame(root: Path, manifest: dict[str, Any]) -> Frame:
    """The frame of a case."""
    path = root / MANIFEST
    saved = _frame_part(manifest, path)
    depth_path = checked_file(root, manifest, saved.depth)
    rgb, depth = read_color(checked_file(root, manifest, COLOR)), read_depth(depth_path, saved.units)
    require(
        depth.shape == (saved.height, saved.width),
        "the pictures have another size than the case says",
        got=f"{depth.shape[1]}x{depth.shape[0]}",
        expected=f"{saved.width}x{saved.height}",
        path=depth_path,
    )
    with in_file(path):
        pose = None if saved.T_world_camera is None else np.array(saved.T_world_camera)
        up, up_source = (saved.up, saved.up_source) if saved.up is not None else _answered_up(manifest)
        up = None if up is None else np.array(up)
        camera = Camera(np.array(saved.K), saved.width, saved.height, pose, up, up_source)
        annotations = tuple(_annotation(a, depth.shape) for a in saved.annotations)
    with in_file(depth_path):
        return Frame(saved.id, rgb, depth, camera, annotations, saved.notes, saved.depth_source or "")


def _answered_up(manifest: dict[str, Any]) -> tuple[Three | None, UpSource | None]:
    """Up vector of the kept answer, for cases saved without a resolved up."""
    expected = manifest.get("expected")
    try:
        viewer = _SavedViewer.model_validate(expected.get("viewer") if isinstance(expected, dict) else None)
    except ValidationError:
        return None, None
    return (viewer.up, viewer.up_source) if any(viewer.up) else (None, None)


def _frame_part(manifest: dict[str, Any], path: Path) -> SavedFrame:
    return checked(SavedFrame.model_validate, manifest.get("frame"), DAMAGED, path, inside=("frame",))


def _annotation(saved: SavedAnnotation, shape: tuple[int, int]) -> Annotation:
    mask = None if saved.mask is None else saved.mask.decoded(shape, f"annotation {saved.index}")
    box = saved.box
    return Annotation(
        saved.index,
        saved.label,
        np.array(saved.bbox, np.float32),
        mask,
        None if box is None else Box3D(np.array(box.center), np.array(box.R), np.array(box.size)),
        saved.visible,
        saved.instance,
        saved.difficulty,
        saved.fixed,
    )


class SavedCaseDataset:
    """Single frame of a saved case, with the class names of the source dataset."""

    format = "case"

    def __init__(self, root: Path, settings: Settings) -> None:
        self.root = root
        self._manifest = read_manifest(root)
        self.frame_ids = (_frame_part(self._manifest, root / MANIFEST).id,)
        names = self._manifest.get("class_names", [])
        require(
            isinstance(names, list) and all(isinstance(n, str) for n in names),
            "the case is damaged at class_names",
            expected="a list of names",
            path=root / MANIFEST,
        )
        self.class_names = tuple(names)

    def load(self, frame_id: str) -> Frame:
        """Decode the frame; see `Dataset.load`."""
        if frame_id not in self.frame_ids:
            raise unknown_id(self.frame_ids, frame_id, self.root)
        return read_saved_frame(self.root, self._manifest)


FORMAT = DatasetFormat("case", f"case: {MANIFEST}", lambda root: (root / MANIFEST).is_file(), SavedCaseDataset)
