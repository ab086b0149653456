"""ROS recordings, written by the library that reads them: bags of ROS 1, SQLite and MCAP of ROS 2."""

from __future__ import annotations

import pickle
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from dataset_writers import HEIGHT, WIDTH, K, Truth, random_truth
from reader_checks import refused
from scipy.spatial.transform import Rotation

from pipeline.datasets import dataset_notes, open_dataset

rosbag1, rosbag2 = pytest.importorskip("rosbags.rosbag1"), pytest.importorskip("rosbags.rosbag2")
typesys = pytest.importorskip("rosbags.typesys")

START = 1_700_000_000
COLOR, DEPTH = "/camera/color/image_raw", "/camera/aligned_depth_to_color/image_raw"


class Recorder:
    """Builds messages of one ROS version and writes them into one file."""

    def __init__(self, path: Path, kind: str) -> None:
        self.one = kind == ".bag"
        self.store: Any = typesys.get_typestore(typesys.Stores.ROS1_NOETIC if self.one else typesys.Stores.ROS2_HUMBLE)
        if self.one:
            tf = "geometry_msgs/TransformStamped[] transforms"
            self.store.register(typesys.get_types_from_msg(tf, "tf2_msgs/msg/TFMessage"))
            self.writer: Any = rosbag1.Writer(path / "room.bag")
        else:
            plugin = rosbag2.StoragePlugin.MCAP if kind == ".mcap" else rosbag2.StoragePlugin.SQLITE3
            self.writer = rosbag2.Writer(path / "room", version=9, storage_plugin=plugin)
        self.writer.open()
        self.connections: dict[str, Any] = {}

    def make(self, kind: str, **values: Any) -> Any:
        return self.store.types[kind](**values)

    def header(self, at: float, frame: str) -> Any:
        time = self.make("builtin_interfaces/msg/Time", sec=START + int(at), nanosec=round(at % 1 * 1e9))
        seq = {"seq": 0} if self.one else {}
        return self.make("std_msgs/msg/Header", stamp=time, frame_id=frame, **seq)

    def write(self, topic: str, kind: str, at: float, message: Any) -> None:
        if topic not in self.connections:
            self.connections[topic] = self.writer.add_connection(topic, kind, typestore=self.store)
        serialize = self.store.serialize_ros1 if self.one else self.store.serialize_cdr
        # A recorder writes a message some time after its stamp.
        self.writer.write(self.connections[topic], round((START + at + 0.004) * 1e9), serialize(message, kind))

    def image(self, topic: str, at: float, pixels: np.ndarray, encoding: str, frame: str = "optical") -> None:
        kind = "sensor_msgs/msg/Image"
        rows = np.ascontiguousarray(pixels).view(np.uint8).reshape(pixels.shape[0], -1)
        padded = np.pad(rows, ((0, 0), (0, 8)))
        self.write(
            topic,
            kind,
            at,
            self.make(
                kind,
                header=self.header(at, frame),
                height=pixels.shape[0],
                width=pixels.shape[1],
                encoding=encoding,
                is_bigendian=0,
                step=padded.shape[1],
                data=padded.ravel(),
            ),
        )

    def camera(self, topic: str, at: float) -> None:
        kind = "sensor_msgs/msg/CameraInfo"
        roi = self.make("sensor_msgs/msg/RegionOfInterest", x_offset=0, y_offset=0, height=0, width=0, do_rectify=False)
        names = ("D", "K", "R", "P") if self.one else ("d", "k", "r", "p")
        values = (np.zeros(5), K.ravel(), np.eye(3).ravel(), np.eye(3, 4).ravel())
        matrices = dict(zip(names, values, strict=True))
        self.write(
            topic,
            kind,
            at,
            self.make(
                kind,
                header=self.header(at, "optical"),
                height=HEIGHT,
                width=WIDTH,
                distortion_model="plumb_bob",
                binning_x=0,
                binning_y=0,
                roi=roi,
                **matrices,
            ),
        )

    def transform(self, topic: str, at: float, parent: str, child: str, T: np.ndarray) -> None:
        kind = "tf2_msgs/msg/TFMessage"
        x, y, z, w = (float(v) for v in Rotation.from_matrix(T[:3, :3]).as_quat())
        one = self.make(
            "geometry_msgs/msg/TransformStamped",
            header=self.header(at, parent),
            child_frame_id=child,
            transform=self.make(
                "geometry_msgs/msg/Transform",
                translation=self.make("geometry_msgs/msg/Vector3", **dict(zip("xyz", T[:3, 3].tolist(), strict=True))),
                rotation=self.make("geometry_msgs/msg/Quaternion", x=x, y=y, z=z, w=w),
            ),
        )
        self.write(topic, kind, at, self.make(kind, transforms=[one]))


MOUNT = np.array([[0.0, 0, 1, 0.1], [-1, 0, 0, 0], [0, -1, 0, 0.2], [0, 0, 0, 1]])


@pytest.fixture(params=[".bag", ".db3", ".mcap"])
def recorded(tmp_path: Path, request: pytest.FixtureRequest) -> tuple[Path, list[Truth]]:
    rng = np.random.default_rng(3)
    made = [random_truth(rng) for _ in range(3)]
    recorder = Recorder(tmp_path, request.param)
    recorder.transform("/tf_static", 0.0, "base", "optical", MOUNT)
    for number, truth in enumerate(made):
        at = 1 + number / 10
        recorder.transform("/tf", at + 0.01, "map", "base", np.asarray(truth.T_world_camera) @ np.linalg.inv(MOUNT))
        recorder.camera("/camera/color/camera_info", at)
        recorder.image(COLOR, at, truth.rgb[..., ::-1], "bgr8")
        recorder.image(DEPTH, at + 0.003, truth.millimetres, "16UC1")
        recorder.image("/camera/infra1/image_rect_raw", at, truth.rgb[..., 0], "mono8")
    # A colour image whose depth was lost.
    recorder.image(COLOR, 2.0, made[0].rgb[..., ::-1], "bgr8")
    recorder.writer.close()
    folder = tmp_path / "room"
    (path,) = [tmp_path / "room.bag"] if request.param == ".bag" else folder.glob("*" + request.param)
    return path, made


def test_frames_come_back_by_time(recorded: tuple[Path, list[Truth]]) -> None:
    path, made = recorded
    dataset = open_dataset(path)
    assert dataset.format == "ros"
    assert dataset.frame_ids == tuple(f"{START + 1 + number / 10:.6f}" for number in range(3))
    assert COLOR in dataset.notes[0]  # type: ignore[attr-defined]
    assert DEPTH in dataset.notes[0]  # type: ignore[attr-defined]
    for opened in (dataset, pickle.loads(pickle.dumps(dataset))):
        # In any order: each is read where it stands.
        for number in (2, 0, 1):
            frame, truth = opened.load(dataset.frame_ids[number]), made[number]
            assert np.array_equal(frame.rgb, truth.rgb)
            assert np.array_equal(frame.depth, truth.depth)
            assert np.array_equal(frame.camera.K, K)
            np.testing.assert_allclose(
                np.asarray(frame.camera.T_world_camera), np.asarray(truth.T_world_camera), atol=1e-6
            )


def test_the_folder_of_a_ros2_recording_opens_too(recorded: tuple[Path, list[Truth]]) -> None:
    path, _ = recorded
    if path.suffix == ".bag":
        refused(lambda: open_dataset(path.parent), "a folder with room.bag", str(path))
    else:
        assert len(open_dataset(path.parent).frame_ids) == 3


def test_compressed_images_and_organised_clouds(tmp_path: Path) -> None:
    recorder = Recorder(tmp_path, ".mcap")
    truth = random_truth(np.random.default_rng(5))
    kind = "sensor_msgs/msg/CompressedImage"
    png = np.frombuffer(cv2.imencode(".png", truth.rgb[..., ::-1])[1].tobytes(), np.uint8)
    message = recorder.make(kind, header=recorder.header(1.0, "optical"), format="bgr8; png compressed bgr8", data=png)
    recorder.write("/camera/rgb/image_color/compressed", kind, 1.0, message)
    points = np.zeros((HEIGHT, WIDTH, 4), np.float32)
    points[..., 2] = np.where(truth.depth > 0, truth.depth, np.nan)
    fields = [
        recorder.make("sensor_msgs/msg/PointField", name=name, offset=4 * k, datatype=7, count=1)
        for k, name in enumerate("xyz")
    ]
    kind = "sensor_msgs/msg/PointCloud2"
    cloud = recorder.make(
        kind,
        header=recorder.header(1.0, "optical"),
        height=HEIGHT,
        width=WIDTH,
        fields=fields,
        is_bigendian=False,
        point_step=16,
        row_step=16 * WIDTH,
        data=points.view(np.uint8).ravel(),
        is_dense=False,
    )
    recorder.write("/points", kind, 1.0, cloud)
    recorder.writer.close()
    path = next((tmp_path / "room").glob("*.mcap"))
    refused(lambda: open_dataset(path), "no CameraInfo", "--intrinsics")
    frame = open_dataset(path, intrinsics=(60.0, 61.0, 31.5, 23.5)).load(f"{START + 1:.6f}")
    assert np.array_equal(frame.rgb, truth.rgb)
    assert np.array_equal(frame.depth, truth.depth)
    assert frame.camera.T_world_camera is None


def test_a_recording_without_depth_or_that_is_cut_off_is_told(tmp_path: Path) -> None:
    recorder = Recorder(tmp_path, ".mcap")
    recorder.image(COLOR, 1.0, np.zeros((HEIGHT, WIDTH, 3), np.uint8), "rgb8")
    recorder.writer.close()
    path = next((tmp_path / "room").glob("*.mcap"))
    refused(lambda: open_dataset(path), "a recording without depth", COLOR)
    (tmp_path / "cut.bag").write_bytes(b"#ROSBAG V2.0\n cut")
    refused(lambda: open_dataset(tmp_path / "cut.bag"), "cannot be read", "cut.bag")


def test_the_unit_that_a_bag_states_is_taken(tmp_path: Path) -> None:
    """librealsense records its options beside the pictures: `/device_0/sensor_0/option/Depth Units/value`."""
    truth = random_truth(np.random.default_rng(5))
    recorder = Recorder(tmp_path, ".bag")
    recorder.camera("/device_0/sensor_0/Depth_0/info/camera_info", 1.0)
    recorder.image("/device_0/sensor_0/Color_0/image/data", 1.0, truth.rgb, "rgb8")
    recorder.image("/device_0/sensor_0/Depth_0/image/data", 1.0, truth.millimetres, "mono16")
    kind = "std_msgs/msg/Float32"
    unit = recorder.make(kind, data=np.float32(0.0001))
    recorder.write("/device_0/sensor_0/option/Depth_Units/value", kind, 0.5, unit)
    recorder.writer.close()
    dataset = open_dataset(tmp_path / "room.bag")
    frame = dataset.load(dataset.frame_ids[0])
    assert np.allclose(frame.depth, truth.depth / 10, atol=1e-6)
    assert any("0.0001 m" in note and "Depth_Units" in note for note in dataset_notes(dataset))
    given = open_dataset(tmp_path / "room.bag", depth_scale=1000)
    assert np.array_equal(given.load(given.frame_ids[0]).depth, truth.depth)
