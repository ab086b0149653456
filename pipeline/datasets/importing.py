"""A recording written again in the plain layout: `color/`, `depth/`, `pose/`, `label/`, and `spatialviz.toml`."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path, PurePosixPath

import cv2
import numpy as np

from pipeline.datasets.base import Dataset
from pipeline.datasets.settings import write_settings
from pipeline.geometry.frame import Frame
from pipeline.system.errors import InputError, require
from pipeline.system.whole_files import temporary_folder

SCALES = (1000.0, 5000.0, 10000.0)
"""Units to a metre in which depth is written as 16-bit integers where that loses nothing."""


@dataclass
class RecordingReport:
    """Summary of a written recording."""

    frames: int = 0
    skipped: dict[str, str] = field(default_factory=dict)  # Frames that were left out, and why
    notes: list[str] = field(default_factory=list)  # What the plain layout cannot hold


class _Writer:
    """Writer of frames into a folder; the first frame decides the storage of depth."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.scale: float | None = None
        self.cameras: dict[str, np.ndarray] = {}
        self.numbers: dict[tuple[str, object], int] = {}
        self.frame_up: dict[str, tuple[float, float, float]] = {}
        self.boxes = 0

    def write(self, name: str, frame: Frame) -> None:
        require(not frame.depth_source, "depth that is estimated is not written: it would pass for measured")
        camera = frame.camera
        if not self.cameras:
            self.scale = next((scale for scale in SCALES if _whole(frame.depth, scale)), None)
        self.cameras[name] = camera.K
        self._picture("color", name, frame.rgb[..., ::-1])
        if self.scale is not None and _whole(frame.depth, self.scale):
            self._picture("depth", name, np.round(frame.depth * self.scale).astype(np.uint16))
        else:
            # Floats are read in the unit of the integers beside them.
            self._picture("depth", name, frame.depth * np.float32(self.scale or 1), "tiff")
        if camera.T_world_camera is not None:
            self._text("pose", name, camera.T_world_camera)
        if camera.up is not None and camera.up_source == "declared":
            x, y, z = camera.up.tolist()
            self.frame_up[name] = (x, y, z)
        self._labels(name, frame)

    def _labels(self, name: str, frame: Frame) -> None:
        masked = [(a.mask, a) for a in frame.annotations if a.mask is not None]
        self.boxes += len(frame.annotations) - len(masked)
        if not masked:
            return
        picture = np.zeros(frame.depth.shape, np.uint16)
        # What is smaller lies on top of what holds it.
        for mask, annotation in sorted(masked, key=lambda pair: -int(np.count_nonzero(pair[0]))):
            own = annotation.index if annotation.instance is None else annotation.instance
            number = self.numbers.setdefault((annotation.label, own), len(self.numbers) + 1)
            picture[mask] = number
        self._picture("label", name, picture)

    def _picture(self, kind: str, name: str, pixels: np.ndarray, suffix: str = "png") -> None:
        (self.folder / kind).mkdir(parents=True, exist_ok=True)
        done, data = cv2.imencode(f".{suffix}", np.ascontiguousarray(pixels))
        require(done, "a picture cannot be written", path=self.folder / kind / name)
        (self.folder / kind / f"{name}.{suffix}").write_bytes(data.tobytes())

    def _text(self, kind: str, name: str, matrix: np.ndarray) -> None:
        (self.folder / kind).mkdir(exist_ok=True)
        rows = (" ".join(repr(float(value)) for value in row) for row in matrix)
        (self.folder / kind / f"{name}.txt").write_text("\n".join(rows) + "\n")

    def close(self) -> None:
        """Write the files for all frames."""
        if self.numbers:
            lines = (f"{number} {label}" for (label, _), number in self.numbers.items())
            (self.folder / "labels.txt").write_text("\n".join(lines) + "\n", encoding="utf-8")
        K = next(iter(self.cameras.values()))
        camera = (float(K[0, 0]), float(K[1, 1]), float(K[0, 2]), float(K[1, 2]))
        if any(not np.array_equal(other, K) for other in self.cameras.values()):
            camera = None
            for name, own in self.cameras.items():
                self._text("camera", name, own)
        write_settings(self.folder, camera, self.scale, frame_up=self.frame_up)


def _whole(depth: np.ndarray, scale: float) -> bool:
    """Test whether 16-bit integers of `scale` units per metre restore the depth exactly."""
    stored = np.round(depth * np.float32(scale))
    return bool(stored.max() < 65536) and np.array_equal(np.divide(stored, scale, dtype=np.float32), depth)


def import_recording(
    dataset: Dataset, out: Path, progress: Callable[[int, int], None] = lambda done, total: None
) -> RecordingReport:
    """Write every readable frame into a new folder in the plain layout, with a folder per scene.

    Parameters
    ----------
    out : Path
        Must not exist, or be empty.
    progress : callable
        Told (frames done, frames of all).

    Raises
    ------
    InputError
        `out` is not empty or cannot be written, or no frame can be read.
    """
    require(not out.exists() or not any(out.iterdir()), "the folder is not empty", path=out)
    report = RecordingReport()
    with temporary_folder(out) as partial:
        scenes = {str(PurePosixPath(frame_id).parent) for frame_id in dataset.frame_ids}
        writers: dict[str, _Writer] = {}
        for done, frame_id in enumerate(dataset.frame_ids, start=1):
            scene = str(PurePosixPath(frame_id).parent)
            try:
                frame = dataset.load(frame_id)
                if scene not in writers:
                    # Poses of several scenes are of several worlds.
                    writers[scene] = _Writer(partial if len(scenes) == 1 else partial / scene.replace("/", "_"))
                writers[scene].write(PurePosixPath(frame_id).name, frame)
                report.frames += 1
            except InputError as error:
                report.skipped[frame_id] = str(error)
            progress(done, len(dataset.frame_ids))
        require(report.frames, "no frame can be read", got=next(iter(report.skipped.values()), None), path=dataset.root)
        for writer in writers.values():
            writer.close()
        if out.exists():
            out.rmdir()
        partial.replace(out)
    boxes = sum(writer.boxes for writer in writers.values())
    if boxes:
        report.notes.append(f"{boxes} annotations without a mask are left out: label pictures hold masks")
    return report
