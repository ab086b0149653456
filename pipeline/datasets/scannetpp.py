"""ScanNet++'s iPhone recordings, https://github.com/scannetpp/scannetpp (`iphone/prepare_iphone_data.py`)."""

from __future__ import annotations

import re
import zlib
from functools import lru_cache, partial
from pathlib import Path
from threading import Lock
from typing import IO

import numpy as np

from pipeline.datasets.base import DatasetFormat
from pipeline.datasets.cameras import NOTHING, Stated, or_note, pose_from_matrix
from pipeline.datasets.files import CUT_OFF, Blob, Part, as_floats, natural, read_json, readable
from pipeline.datasets.images import picture_size
from pipeline.datasets.pairing import stem_of
from pipeline.datasets.recording import DepthRule, Listed, Recording
from pipeline.datasets.settings import Settings
from pipeline.datasets.video import open_video
from pipeline.system.errors import InputError, as_input_error, extra_module, needed, require
from pipeline.system.safe_files import opened

FACTS, VIDEOS, DEPTHS = "pose_intrinsic_imu.json", ("rgb.mkv", "rgb.mp4"), "depth.bin"
HEIGHT, WIDTH = 192, 256
"""Pixels of the depth of an iPhone's sensor, as the makers' script takes it."""
_ID = re.compile(r"frame_([0-9]{1,9})")


class ScanNetPlusDataset(Recording):
    """An `iphone/` folder of a scene of ScanNet++: frames of `pose_intrinsic_imu.json`, as `frame_000000`.

    Colour is `rgb.mkv`, or unpacked to `rgb/frame_N.jpg`; depth `depth.bin`, or unpacked to `depth/frame_N.png` (mm).
    The intrinsics are the colour's. A frame's `aligned_pose`, else its `pose`, is camera-to-world of an OpenCV camera;
    the world of the aligned poses is the scene's scan, whose z is up. A scene's folder may be opened as well.
    """

    format = "scannet++"
    rule = DepthRule(1000.0, "ScanNet++'s")
    again = r".*\.(bin|mkv|mp4)"

    def __init__(self, root: Path, settings: Settings) -> None:
        super().__init__(root, settings)
        self._folder = needed(_iphone(root), "no iPhone recording of ScanNet++", path=root)
        self._table = read_json(self._folder / FACTS)
        self._colors, self._depths = (
            {stem_of(n): self._folder / part / n for n in readable(self._folder / part)[1]} for part in ("rgb", "depth")
        )
        self._video = next((p for name in VIDEOS if (p := self._folder / name).is_file()), None)
        color = next(iter(self._colors.values()), None)
        self._size = picture_size(color) if color else open_video(needed(self._video, "no colour", path=root)).size
        self._at = () if self._depths else depth_places(self._folder / DEPTHS)
        # What was unpacked may be every tenth frame only.
        self._numbers = {
            i: int(found[1])
            for i in sorted(self._table, key=natural)
            if (found := _ID.fullmatch(i)) and all(i in part for part in (self._colors, self._depths) if part)
        }
        self.frame_ids = tuple(self._numbers)
        require(self.frame_ids, "no frame has colour, depth and an entry of the table", path=self._folder / FACTS)

    def _listed(self, frame_id: str, notes: list[str]) -> Listed:
        number, entry = self._found(self._numbers, frame_id), self._table[frame_id]
        path = self._folder / FACTS
        require(isinstance(entry, dict), f"{frame_id} is no object", path=path)
        color: Blob | None = self._colors.get(frame_id)
        if color is None:
            video = needed(self._video, "no colour", path=self._folder)
            color = Part(video, f" picture {number}", partial(_picture, video, number))
        depth: Blob | None = self._depths.get(frame_id)
        if depth is None:
            bundle = self._folder / DEPTHS
            depth = Part(bundle, f" depth {number}", partial(read_packed, bundle, self._at, number))
        matrix = entry.get("intrinsic")
        stated = NOTHING
        if matrix is not None:
            stated = Stated(as_floats(matrix, 9, path, "intrinsic").reshape(3, 3), self._size, path=path)
        key = "aligned_pose" if entry.get("aligned_pose") is not None else "pose"
        pose = or_note(notes, f"no camera pose, {key}: ", _pose, entry.get(key), path)
        return Listed(color, depth, stated, pose, up=pose[2, :3] if pose is not None and key != "pose" else None)


def _pose(values: object, path: Path) -> np.ndarray:
    return pose_from_matrix(as_floats(values, 16, path, "a pose").reshape(4, 4))


def _picture(video: Path, number: int) -> np.ndarray:
    return open_video(video).picture(number)


def depth_places(path: Path) -> tuple[tuple[int, int], ...]:
    """(first byte, bytes) of each frame of `depth.bin`, whose frames stand one behind the other, each after its size in
    four bytes; none where the file is one stream."""
    found: list[tuple[int, int]] = []
    with as_input_error("a file is missing", FileNotFoundError, path=path), opened(path, "unpacked") as file:
        end = file.seek(0, 2)
        at = 0
        while at + 4 <= end:
            file.seek(at)
            size = int.from_bytes(file.read(4), "little")
            if not 0 < size <= 4 * HEIGHT * WIDTH + 4096:
                return ()
            found.append((at + 4, size))
            at += 4 + size
    require(at == end, "depth that is cut off", got=f"{end} bytes", expected=at, cause=CUT_OFF, path=path)
    return tuple(found)


def read_packed(path: Path, places: tuple[tuple[int, int], ...], number: int) -> np.ndarray:
    """Depth `number` of `depth.bin` as (192, 256) uint16 millimetres: LZ4 of these, or raw deflate of float32 metres;
    a file that is one stream is such a deflate of all frames."""
    with as_input_error("depth that cannot be unpacked", zlib.error, ValueError, got=str, path=path):
        if not places:
            return _millimetres(_inflated(path, path.stat().st_mtime_ns).frame(number))
        require(number < len(places), f"no depth {number}", got=f"{len(places)} frames", path=path)
        with opened(path, "unpacked") as file:
            file.seek(places[number][0])
            data = file.read(places[number][1])
        try:
            inflate = zlib.decompressobj(-zlib.MAX_WBITS)
            metres = np.frombuffer(inflate.decompress(data, 4 * HEIGHT * WIDTH + 1), np.float32)
            return _millimetres(metres.reshape(HEIGHT, WIDTH))
        except (zlib.error, ValueError):
            block = extra_module("lz4.block", "depth of ScanNet++", "ros")
            try:
                raw = block.decompress(data, uncompressed_size=2 * HEIGHT * WIDTH)
            except Exception as error:
                raise InputError("depth that cannot be unpacked", got=str(error)[:80], path=path) from error
            return np.frombuffer(raw, np.uint16).reshape(HEIGHT, WIDTH)


class Inflated:
    """A file of one deflate, of which one frame is held at a time; safe for several threads.

    Frames are read forwards, and from the start again for an earlier one.
    """

    def __init__(self, path: Path) -> None:
        self._path, self._lock = path, Lock()
        self._restart()

    def _restart(self) -> None:
        self._next, self._at, self._left = 0, 0, b""
        self._inflate = zlib.decompressobj(-zlib.MAX_WBITS)

    def frame(self, number: int) -> np.ndarray:
        """Frame (192, 256) float32 metres; InputError where the file ends before it."""
        with self._lock, opened(self._path, "unpacked") as file:
            if number < self._next:
                self._restart()
            file.seek(self._at)
            data = b""
            while self._next <= number:
                data = self._take(file)
                self._next += 1
            return np.frombuffer(data, np.float32).reshape(HEIGHT, WIDTH)

    def _take(self, file: IO[bytes]) -> bytes:
        wanted, found = 4 * HEIGHT * WIDTH, b""
        while len(found) < wanted:
            if not self._left:
                self._left = file.read(1 << 16)
                self._at += len(self._left)
                require(self._left, "depth that is cut off", cause=CUT_OFF, path=self._path)
            found += self._inflate.decompress(self._left, wanted - len(found))
            self._left = self._inflate.unconsumed_tail
            require(not self._inflate.eof or len(found) == wanted, "depth that is cut off", path=self._path)
        return found


@lru_cache(maxsize=2)
def _inflated(path: Path, written: int) -> Inflated:
    return Inflated(path)


def _millimetres(metres: np.ndarray) -> np.ndarray:
    return np.clip(np.nan_to_num(metres) * 1000, 0, 65534).astype(np.uint16)


def _iphone(root: Path) -> Path | None:
    """Folder of the recording: a scene's `iphone/`, or this itself."""
    for folder in (root / "iphone", root):
        folders, files = readable(folder)
        color = "rgb" in folders or any(name in files for name in VIDEOS)
        if FACTS in files and color and ("depth" in folders or DEPTHS in files):
            return folder
    return None


SCANNETPP = DatasetFormat(
    "scannet++",
    f"scannet++: {FACTS} with rgb.mkv or rgb/, and {DEPTHS} or depth/",
    lambda root: _iphone(root) is not None,
    ScanNetPlusDataset,
)
