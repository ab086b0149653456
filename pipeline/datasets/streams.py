"""ROS recordings read in place: `.bag`, `.db3`, `.mcap` and folders of ROS 2, frames by time (extra: ros).

Depth of 16 bits is millimetres and depth of floats metres (REP 118); an optical frame is OpenCV's camera (REP 103).
"""

from __future__ import annotations

import re
import struct
from bisect import bisect_left
from collections import defaultdict
from collections.abc import Iterable
from dataclasses import replace
from functools import lru_cache
from os.path import commonpath
from pathlib import Path
from threading import Lock
from typing import Any

import cv2
import numpy as np

from pipeline.datasets.base import DatasetFormat
from pipeline.datasets.cameras import NOTHING, Stated, or_note, pose_from_quaternion
from pipeline.datasets.files import Part, as_floats, readable
from pipeline.datasets.pairing import role_of
from pipeline.datasets.recording import Listed, Recording
from pipeline.datasets.settings import Settings
from pipeline.datasets.stamps import match_times
from pipeline.system.errors import InputError, as_input_error, extra_module, needed, require
from pipeline.system.limits import shown
from pipeline.system.safe_files import BoundedPath, check_pixels, checked_path

SUFFIXES = (".bag", ".db3", ".mcap")
METADATA, LARGEST_METADATA = "metadata.yaml", 4 * 10**6
"""The description of a recording in a folder, and its bytes: its parser takes half a minute for ten times as many."""
IMAGES = ("sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage")
CLOUD, CAMERA_INFO, TF = "sensor_msgs/msg/PointCloud2", "sensor_msgs/msg/CameraInfo", "tf2_msgs/msg/TFMessage"
FLOATS = ("std_msgs/msg/Float32", "std_msgs/msg/Float64")
REGISTERED = ("aligned", "registered", "color", "rgb")
"""Words in a depth topic's name that say it is registered to the colour image."""
TF_WITHIN_NS = 100_000_000
"""A transform further in time from a frame is not used."""
COMPRESSED_DEPTH_HEADER, FLOAT32 = 12, 7
_DTYPES = {
    "16UC1": ("u2", 1),
    "mono16": ("u2", 1),
    "32FC1": ("f4", 1),
    "mono8": ("u1", 1),
    "8UC1": ("u1", 1),
    "rgb8": ("u1", 3),
    "bgr8": ("u1", 3),
    "8UC3": ("u1", 3),
    "rgba8": ("u1", 4),
    "bgra8": ("u1", 4),
    "bayer_rggb8": ("u1", 1),
    "bayer_bggr8": ("u1", 1),
    "bayer_gbrg8": ("u1", 1),
    "bayer_grbg8": ("u1", 1),
}
_TO_RGB = {
    "mono8": cv2.COLOR_GRAY2RGB,
    "8UC1": cv2.COLOR_GRAY2RGB,
    "bgr8": cv2.COLOR_BGR2RGB,
    "8UC3": cv2.COLOR_BGR2RGB,
    "rgba8": cv2.COLOR_RGBA2RGB,
    "bgra8": cv2.COLOR_BGRA2RGB,
    # OpenCV names a pattern by its second row and column.
    "bayer_rggb8": cv2.COLOR_BayerBG2RGB,
    "bayer_bggr8": cv2.COLOR_BayerRG2RGB,
    "bayer_gbrg8": cv2.COLOR_BayerGR2RGB,
    "bayer_grbg8": cv2.COLOR_BayerGB2RGB,
}


class Stream:
    """An open recording, read message by message."""

    def __init__(self, path: Path) -> None:
        highlevel = extra_module("rosbags.highlevel", "a ROS recording", "ros")
        typesys = extra_module("rosbags.typesys", "a ROS recording", "ros")
        self.path, self.lock = path, Lock()
        store = typesys.get_typestore(typesys.Stores.LATEST)
        with as_input_error("a recording that cannot be read", Exception, got=str, path=path):
            for part in path.iterdir() if path.is_dir() else (path,):
                checked_path(part, "unpacked")
                require(
                    part.name != METADATA or part.stat().st_size <= LARGEST_METADATA,
                    "a description that is too large",
                    got=f"{shown(part.stat().st_size)} bytes",
                    expected=f"at most {shown(LARGEST_METADATA)}",
                    path=part,
                )
            self.reader: Any = highlevel.AnyReader([BoundedPath(path)], default_typestore=store)
            self.reader.open()
        self.kinds: dict[str, str] = {c.topic: c.msgtype for c in self.reader.connections}

    def raw(self, topics: Iterable[str], start: int | None = None, stop: int | None = None) -> Any:
        wanted = [c for c in self.reader.connections if c.topic in set(topics)]
        if not wanted:
            # The library takes no topic for all of them.
            return
        with as_input_error("a recording that cannot be read", Exception, got=str, path=self.path):
            yield from self.reader.messages(wanted, start=start, stop=stop)

    def times(self, topic: str) -> tuple[np.ndarray, list[int]]:
        """Stamps of a topic's headers, seconds, and when each message was written, nanoseconds; no message is kept."""
        stamps, written = [], []
        with self.lock:
            for _, at, data in self.raw([topic]):
                # Both ROS 1 (after a counter) and ROS 2 (after its CDR header) have the stamp at byte 4.
                seconds, nanoseconds = struct.unpack_from("<iI", data, 4)
                stamps.append(seconds + nanoseconds * 1e-9)
                written.append(at)
        order = np.argsort(stamps, kind="stable")
        return np.array(stamps)[order], [written[k] for k in order]

    def message(self, topic: str, at: int | None = None) -> Any:
        """Message of a topic written at a time, or the first message."""
        with self.lock:
            for connection, _, data in self.raw([topic], at, None if at is None else at + 1):
                return self._decoded(connection, data)
        raise InputError(f"no message of {topic} at {at}", path=self.path)

    def all(self, topics: list[str]) -> Any:
        with self.lock:
            for connection, _, data in self.raw(topics):
                yield connection.topic, self._decoded(connection, data)

    def _decoded(self, connection: Any, data: bytes) -> Any:
        with as_input_error(f"a message of {connection.topic} that cannot be read", Exception, got=str, path=self.path):
            return self.reader.deserialize(data, connection.msgtype)


def _stream(path: Path) -> Stream:
    return _opened(path, path.stat().st_mtime_ns)


@lru_cache(maxsize=2)
def _opened(path: Path, written: int) -> Stream:
    return Stream(path)


class StreamDataset(Recording):
    """Frames of colour images with depth within 20 ms; the id is the colour stamp in seconds.

    The topics are told by their types and the words of their names, and said in a note. Poses come from tf, in the
    frame at the root of its tree.
    """

    format = "ros"

    def __init__(self, root: Path, settings: Settings) -> None:
        super().__init__(root, settings)
        stream = _stream(root)
        self._color, self._depth, info = _topics(stream)
        stamps, colors = stream.times(self._color)
        depth_stamps, depths = stream.times(self._depth)
        pairs = match_times(stamps, depth_stamps)
        require(
            pairs,
            "no colour image has depth within 20 ms",
            got=f"{len(colors)} images of {self._color}, {len(depths)} of {self._depth}",
            path=root,
        )
        self._at = {f"{stamps[i]:.6f}": (colors[i], depths[j], stamps[i]) for i, j in sorted(pairs.items())}
        self.frame_ids = tuple(self._at)
        self.notes = (f"colour is {self._color}, depth {self._depth}, the camera {info or 'in no topic'}",)
        stated = NOTHING if info is None else _camera_info(stream.message(info), root)
        self._stated = replace(stated, units_per_metre=1000.0)
        units = _unit_topic(stream, self._depth)
        if units is not None and settings.depth_scale is None:
            (unit,) = as_floats(stream.message(units).data, 1, root, units)
            require(0 < unit < np.inf, "the depth's unit must be positive", got=f"{unit:g} by {units}", path=root)
            # A float32 holds 0.0001 only nearly.
            self._stated = replace(stated, units_per_metre=float(f"{1 / unit:.5g}"))
            self.notes += (f"the depth's unit is {unit:.5g} m, by {units}",)
        self._ask_for(f"{len(self._at)} pairs of {self._color} and {self._depth}, no CameraInfo", self._stated)
        self._transforms: Transforms | None = None

    def _listed(self, frame_id: str, notes: list[str]) -> Listed:
        color_at, depth_at, stamp = self._found(self._at, frame_id)
        stream = _stream(self.root)
        rgb = _rgb(stream.message(self._color, color_at), self.root)
        message = stream.message(self._depth, depth_at)
        depth = _depth(message, self.root)
        if self._transforms is None:
            self._transforms = Transforms(stream)
        pose = or_note(notes, "no camera pose, tf: ", self._transforms.pose, message.header.frame_id, stamp)
        stated = replace(self._stated, units_per_metre=1.0) if depth.dtype.kind == "f" else self._stated
        color = Part(self.root, self._color, lambda: rgb)
        return Listed(color, Part(self.root, self._depth, lambda: depth), stated, pose)


def _topics(stream: Stream) -> tuple[str, str, str | None]:
    """(colour, depth, camera) topics; InputError where colour or depth is missing."""
    roles = {topic: role_of(topic.replace("/", "_"))[0] for topic in sorted(stream.kinds)}
    images = [topic for topic in roles if stream.kinds[topic] in IMAGES]
    color = [topic for topic in images if roles[topic] in ("color", "camera")]
    depth = [topic for topic in images if roles[topic] == "depth"]
    depth = depth or [topic for topic in roles if stream.kinds[topic] == CLOUD]
    missing = " and ".join(what for what, found in (("colour", color), ("depth", depth)) if not found)
    if missing:
        seen = ", ".join(f"{topic} ({kind.rpartition('/')[2]})" for topic, kind in list(stream.kinds.items())[:6])
        raise InputError(f"a recording without {missing}", got=seen or "no topic", path=stream.path)

    def worth(topic: str) -> tuple[bool, bool]:
        return any(word in topic for word in REGISTERED), stream.kinds[topic] == IMAGES[0]

    best_depth = max(depth, key=worth)
    best_color = max(color, key=lambda topic: (stream.kinds[topic] == IMAGES[0], len(commonpath([topic, best_depth]))))
    infos = [topic for topic, kind in stream.kinds.items() if kind == CAMERA_INFO]
    info = max(infos, key=lambda topic: len(commonpath([topic, best_depth])), default=None)
    return best_color, best_depth, info


def _unit_topic(stream: Stream, depth: str) -> str | None:
    """Topic that states the metres in a unit of depth, as librealsense records its options; None where there is none.

    https://github.com/IntelRealSense/librealsense/blob/master/src/media/ros/ros_file_format.h
    """
    told = [t for t, kind in stream.kinds.items() if kind in FLOATS and re.search("depth[_ ]?units?(?![a-z])", t, re.I)]
    return max(sorted(told), key=lambda topic: len(commonpath([topic, depth])), default=None)


def _camera_info(message: Any, path: Path) -> Stated:
    K = getattr(message, "k", None)
    K = np.asarray(message.K if K is None else K, np.float64).reshape(3, 3)
    return Stated(K if K[0, 0] > 0 else None, (message.width, message.height), path=path)


def _image(message: Any, path: Path) -> tuple[np.ndarray, str]:
    """The pixels of an Image or a CompressedImage, and their encoding."""
    if hasattr(message, "format"):
        skip = COMPRESSED_DEPTH_HEADER if "compressedDepth" in message.format else 0
        data = np.asarray(message.data)[skip:]
        check_pixels(data.tobytes(), path)
        pixels = cv2.imdecode(data, cv2.IMREAD_UNCHANGED)
        pixels = needed(pixels, "an image that cannot be decoded", got=message.format, path=path)
        return pixels, "bgr8" if pixels.ndim == 3 else "mono8" if pixels.dtype == np.uint8 else "16UC1"
    encoding = message.encoding
    require(encoding in _DTYPES, "an encoding that is not read", got=encoding, expected=", ".join(_DTYPES), path=path)
    kind, channels = _DTYPES[encoding]
    dtype = np.dtype(kind).newbyteorder(">" if message.is_bigendian else "<")
    data = np.asarray(message.data, np.uint8)
    require(data.size >= message.step * message.height, "an image that is cut off", got=data.size, path=path)
    rows = data[: message.step * message.height].reshape(message.height, message.step)
    wide = rows[:, : message.width * channels * dtype.itemsize].copy().view(dtype)
    pixels = wide.reshape(message.height, message.width, channels).astype(dtype.newbyteorder("="))
    return pixels[..., 0] if channels == 1 else pixels, encoding


def _rgb(message: Any, path: Path) -> np.ndarray:
    pixels, encoding = _image(message, path)
    require(pixels.dtype == np.uint8, "colour of another type than 8 bits", got=encoding, path=path)
    return np.ascontiguousarray(cv2.cvtColor(pixels, _TO_RGB[encoding]) if encoding in _TO_RGB else pixels)


def _depth(message: Any, path: Path) -> np.ndarray:
    """The depth of an image, or z of an organised point cloud."""
    if not hasattr(message, "fields"):
        return _image(message, path)[0]
    require(message.height > 1, "a point cloud that is no grid", got=f"{message.width} points", path=path)
    floats = (field for field in message.fields if field.name == "z" and field.datatype == FLOAT32)
    z = needed(next(floats, None), "a point cloud without z of floats", path=path)
    points = np.asarray(message.data, np.uint8).reshape(message.height, message.row_step)
    points = points[:, : message.width * message.point_step].reshape(message.height, message.width, message.point_step)
    return points[..., z.offset : z.offset + 4].copy().view("<f4")[..., 0].astype(np.float32)


class Transforms:
    """Tree of tf: parent and timed transforms of each frame."""

    def __init__(self, stream: Stream) -> None:
        found: defaultdict[str, list[tuple[float, str, np.ndarray]]] = defaultdict(list)
        topics = [topic for topic, kind in stream.kinds.items() if kind == TF or topic.endswith("/tf")]
        for topic, message in stream.all(topics):
            for t in message.transforms:
                stamp = t.header.stamp
                at = -1.0 if topic.endswith("static") else stamp.sec + stamp.nanosec * 1e-9
                v, q = t.transform.translation, t.transform.rotation
                values = np.array([v.x, v.y, v.z, q.x, q.y, q.z, q.w])
                found[t.child_frame_id.lstrip("/")].append((at, t.header.frame_id.lstrip("/"), values))
        self._of = {child: sorted(entries, key=lambda entry: entry[0]) for child, entries in found.items()}

    def pose(self, frame: str, stamp: float) -> np.ndarray | None:
        """T_root_frame (4, 4) at a time; None where tf does not know the frame."""
        T, child, moving = np.eye(4), frame.lstrip("/"), False
        for _ in range(len(self._of)):
            if child not in self._of:
                break
            entries = self._of[child]
            after = bisect_left(entries, stamp, key=lambda entry: entry[0])
            near = [entries[k] for k in (after - 1, after) if 0 <= k < len(entries)]
            at, child, values = min(near, key=lambda entry: abs(entry[0] - stamp))
            require(
                at < 0 or abs(at - stamp) * 1e9 <= TF_WITHIN_NS, f"none of {child} within {TF_WITHIN_NS / 1e6:g} ms"
            )
            moving |= at >= 0
            T = pose_from_quaternion(values) @ T
        # A tree of static transforms alone says where the camera is on its mount, not in the world.
        return T if moving else None


def _recognises(root: Path) -> bool:
    if root.suffix.lower() in SUFFIXES and not root.is_dir():
        return True
    names = readable(root)[1]
    return METADATA in names and any(name.endswith(SUFFIXES) for name in names)


FORMAT = DatasetFormat("ros", f"ros: {', '.join(SUFFIXES)}", _recognises, StreamDataset)
