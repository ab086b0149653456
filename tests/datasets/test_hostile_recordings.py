"""Recordings that were made to hang, to fill memory, or to lead out of their folder: one line each, or they open."""

from __future__ import annotations

import json
import os
import time
import warnings
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
from app_writers import truths, write_scannetpp, write_stray
from dataset_writers import write_png

from pipeline.datasets import open_dataset
from pipeline.datasets.base import dataset_notes
from pipeline.datasets.cameras import read_stated
from pipeline.datasets.files import name_inside, natural
from pipeline.datasets.images import read_depth
from pipeline.datasets.stamps import match_times
from pipeline.datasets.video import open_video
from pipeline.geometry.registration import _away
from pipeline.system import InputError

SECONDS = 5.0
"""Each of these took minutes, or would have."""


@pytest.fixture(autouse=True)
def in_time() -> Iterator[None]:
    begin = time.process_time()
    yield
    assert time.process_time() - begin < SECONDS


def refused(call: Callable[[], object], *words: str) -> None:
    with pytest.raises(InputError) as told:
        call()
    assert all(word in str(told.value) for word in words), str(told.value)
    assert "\n" not in str(told.value)


def test_a_recording_whose_depth_is_gone(tmp_path: Path) -> None:
    write_stray(tmp_path, truths(2), packed=False)
    for path in (tmp_path / "depth").iterdir():
        path.unlink()
    refused(lambda: open_dataset(tmp_path), "without depth")


@pytest.mark.parametrize(
    "content",
    [
        b"#EXTM3U\n#EXT-X-TARGETDURATION:9\n#EXTINF:9,\nfile:///etc/hostname\n#EXT-X-ENDLIST\n",
        b"ffconcat version 1.0\nfile 'other.mp4'\n",
        b"v=0\r\no=- 0 0 IN IP4 127.0.0.1\r\nc=IN IP4 127.0.0.1\r\nm=video 5004 RTP/AVP 96\r\n",
        b"YUV4MPEG2 W30000 H30000 F30:1\nFRAME\n",
        b"\x89PNG\r\n\x1a\n",
    ],
)
def test_a_video_that_leads_elsewhere(tmp_path: Path, content: bytes) -> None:
    """What FFmpeg and OpenCV open by its content: https://ffmpeg.org/ffmpeg-formats.html, "concat", "hls", "sdp"."""
    write_stray(tmp_path, truths(2), packed=True)
    (tmp_path / "rgb.mp4").rename(tmp_path / "other.mp4")
    (tmp_path / "rgb.mp4").write_bytes(content)
    refused(lambda: open_video(tmp_path / "rgb.mp4"), "neither MP4 nor Matroska")


def test_names_of_frames_with_more_digits_than_any_number(tmp_path: Path) -> None:
    write_scannetpp(tmp_path, truths(2), "deflate")
    path = tmp_path / "iphone/pose_intrinsic_imu.json"
    table = json.loads(path.read_text())
    some = table["frame_000000"]
    table |= {f"frame_{digits}": some for digits in ("9" * 5000, "9" * 1_200_000)}
    path.write_text(json.dumps(table | {f"k{number}": some for number in range(10, 20_000)}))
    assert open_dataset(tmp_path).load("frame_000001").depth.any()
    with pytest.raises(InputError):
        open_dataset(tmp_path).load("frame_9")
    names = [f"{number}.png" for number in ("9" * 1_200_000, "10", "9")]
    assert sorted(names, key=natural) == names[::-1]


@pytest.mark.parametrize("head", [["a" * 60_000 + "!"] * 8, ["p_" * 60_000] * 8, [f"c{k}" for k in range(300_000)]])
def test_a_table_of_poses_with_long_names(tmp_path: Path, head: list[str]) -> None:
    write_stray(tmp_path, truths(2), packed=False)
    path = tmp_path / "odometry.csv"
    path.write_text(",".join(head) + "\n" + path.read_text())
    frame = open_dataset(tmp_path).load("000000")
    assert frame.camera.T_world_camera is None
    assert any("odometry.csv" in note for note in frame.notes)


@pytest.mark.parametrize("text", ["1" * 60_000 + "x", "e:[\n" * 16_000, "K: [" + "1" * 60_000])
def test_a_camera_file_that_is_none(tmp_path: Path, text: str) -> None:
    path = tmp_path / "camera.yml"
    path.write_text(text)
    assert read_stated(path).K is None


@pytest.mark.parametrize("word", ["1_0", "\u0661", "1e308", "-1e12", "nan", "0x10"])
def test_numbers_of_poses_that_are_none(tmp_path: Path, word: str) -> None:
    write_stray(tmp_path, truths(2), packed=False)
    path = tmp_path / "odometry.csv"
    lines = path.read_text().splitlines()
    path.write_text(
        "\n".join([lines[0], ", ".join([*lines[1].split(", ")[:2], word, *lines[1].split(", ")[3:]]), lines[2]])
    )
    frame = open_dataset(tmp_path).load("000000")
    assert frame.camera.T_world_camera is None
    assert any("odometry.csv" in note for note in frame.notes)


@pytest.mark.parametrize("word", ["1_0", "1e-320", "1e308", "1e6", "0.01", "nan", "-60"])
def test_focal_lengths_that_are_none(tmp_path: Path, word: str) -> None:
    write_stray(tmp_path, truths(2), packed=False)
    path = tmp_path / "camera_matrix.csv"
    path.write_text(", ".join([word, *path.read_text().split(", ")[1:]]))
    refused(lambda: open_dataset(tmp_path).load("000000"), "camera_matrix.csv")


def test_times_that_all_lie_together() -> None:
    times = 1 + np.arange(30_000) * 1e-7
    refused(lambda: match_times(times, times), "900000000 pairs", "20 ms")


@pytest.mark.parametrize("name", ["/" + "a/" * 500_000 + "x.png", f"/home/{'a' * 300}/x.png", "/a/\ud800.png", "/a\0b"])
def test_absolute_names_that_no_system_has(tmp_path: Path, name: str) -> None:
    (tmp_path / "y.png").write_bytes(b"y")
    refused(lambda: name_inside(name, tmp_path / "list.txt", 3), "line 3", "outside the dataset")
    assert name_inside(f"/home/{'b/' * 20}y.png", tmp_path / "list.txt", 3) == "y.png"


def test_more_names_beside_the_frames_than_a_camera_has(tmp_path: Path) -> None:
    write_png(tmp_path / "a.png", np.zeros((48, 64, 3), np.uint8))
    frames = [{"file_path": "a.png", "depth_file_path": "a.png"}] * 2000
    (tmp_path / "transforms.json").write_text(json.dumps({f"k{k}": k for k in range(20_000)} | {"frames": frames}))
    refused(lambda: open_dataset(tmp_path), "transforms.json", "20000 names")


def test_a_number_of_a_label_that_is_none(tmp_path: Path) -> None:
    for folder in ("color", "depth", "label"):
        picture = np.ones((48, 64), np.uint16) if folder != "color" else np.zeros((48, 64, 3), np.uint8)
        write_png(tmp_path / folder / "0.png", picture)
    (tmp_path / "labels.txt").write_text(f"1 mug\n{'9' * 5000} cup\n")
    refused(lambda: open_dataset(tmp_path, intrinsics=(60, 60, 32, 24), depth_scale=1000), "labels.txt", "too long")


def test_many_small_files_that_no_reader_reads(tmp_path: Path) -> None:
    write_stray(tmp_path, truths(2), packed=False)
    for number in range(3000):
        (tmp_path / f"x{number}.json").write_text(json.dumps({"a": [1] * 5000}))
    (tmp_path / "zz_poses.txt").write_text("1\n")
    (note,) = (note for note in dataset_notes(open_dataset(tmp_path)) if note.startswith("not read"))
    assert "zz_poses.txt" in note


def test_a_pipe_and_a_link_under_the_name_of_a_list(tmp_path: Path) -> None:
    """That a folder is one of RoboSpatial's is told by the beginning of its list, which is opened first of all."""
    write_stray(tmp_path / "a", truths(2), packed=False)
    os.mkfifo(tmp_path / "a/annotations.json")
    assert open_dataset(tmp_path / "a").format == "stray-scanner"
    (tmp_path / "annotations.json").write_text('"id" "category" "question" "answer" "img" "depth_image" "mask"')
    (tmp_path / "a/annotations.json").unlink()
    (tmp_path / "a/annotations.json").symlink_to(tmp_path / "annotations.json")
    assert open_dataset(tmp_path / "a").format == "stray-scanner"


@pytest.mark.parametrize("name", ["0.pfm", "0.npy", "0.geometric.bin"])
def test_depth_without_a_pixel(tmp_path: Path, name: str) -> None:
    np.save(tmp_path / "0.npy", np.zeros((0, 0), np.float32))
    (tmp_path / "0.pfm").write_bytes(b"Pf\n0 0\n-1\n")
    (tmp_path / "0.geometric.bin").write_bytes(b"0&0&1&")
    refused(lambda: read_depth(tmp_path / name, None), "without a pixel", name)


def test_a_picture_without_an_edge() -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert (_away(np.zeros((48, 64, 3), np.uint8)) == 255).all()
