"""What strangers can put into a folder is refused with one line each, without being read, and the rest stays usable."""

from __future__ import annotations

import io
import json
import os
import resource
import struct
import time
import zipfile
import zlib
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from pipeline.datasets import Dataset, open_dataset
from pipeline.labels import open_labels
from pipeline.proposals import RecordedDetector
from pipeline.system import LIMITS_VARIABLE, InputError, current_limits, safe_files, set_limits
from pipeline.system.limits import Limits, shown
from pipeline.system.picture_headers import header_size


def refused(action: Callable[[], object], *words: str) -> str:
    """The message of the InputError, which must be one line and hold every word."""
    with pytest.raises(InputError) as caught:
        action()
    message = str(caught.value)
    assert "\n" not in message
    assert not [word for word in words if word not in message], message
    return message


def png(width: int, height: int, lines: int | None = None) -> bytes:
    """A grey PNG of zeros; with `lines` fewer of them than its header says."""

    def chunk(kind: bytes, body: bytes) -> bytes:
        return struct.pack(">I", len(body)) + kind + body + struct.pack(">I", zlib.crc32(kind + body))

    packed, row = zlib.compressobj(1), bytes(width + 1)
    content = b"".join(packed.compress(row) for _ in range(height if lines is None else lines)) + packed.flush()
    header = struct.pack(">IIBBBBB", width, height, 8, 0, 0, 0, 0)
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header) + chunk(b"IDAT", content) + chunk(b"IEND", b"")


def replaced(path: Path, put: Callable[[Path], object]) -> None:
    path.unlink()
    put(path)


def sparse(path: Path) -> None:
    with open(path, "wb") as file:
        file.write(b"\x89PNG\r\n\x1a\n")
        file.truncate(3 << 30)


@pytest.fixture
def recording(tmp_path: Path) -> Path:
    root = tmp_path / "recording"
    for folder in ("color", "depth"):
        (root / folder).mkdir(parents=True)
    (root / "spatialviz.toml").write_text("intrinsics = [50, 50, 32, 24]\ndepth_scale = 1000\n")
    for k in range(8):
        cv2.imwrite(str(root / f"color/{k}.png"), np.full((48, 64, 3), 9 * k, np.uint8))
        cv2.imwrite(str(root / f"depth/{k}.png"), np.full((48, 64), 1000 + k, np.uint16))
    return root


def usable(dataset: Dataset) -> list[str]:
    found = []
    for frame_id in dataset.frame_ids:
        with suppress(InputError):
            found.append(dataset.load(frame_id).id)
    return found


def test_each_strange_frame_is_refused_by_itself(recording: Path, tmp_path: Path) -> None:
    (tmp_path / "secret").write_text("root:x:0:0")
    color, depth = recording / "color", recording / "depth"
    replaced(color / "1.png", lambda p: p.symlink_to("/dev/zero"))
    replaced(color / "2.png", lambda p: p.symlink_to(tmp_path / "secret"))
    replaced(depth / "3.png", os.mkfifo)
    replaced(color / "4.png", lambda p: p.write_bytes(png(20_032, 20_032, lines=3)))
    replaced(depth / "5.png", sparse)
    peak, began = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss, time.monotonic()
    dataset = open_dataset(recording)
    words = {
        "1": ("no regular file", "a device", "color/1.png"),
        "2": ("outside the folder", "--limits links=1", "color/2.png"),
        "3": ("no regular file", "a FIFO", "depth/3.png"),
        "4": ("20032x20032", "401.3M pixels", "--limits pixels=410M", "color/4.png"),
        "5": ("too large", "3.221G bytes", "--limits bytes=4G", "depth/5.png"),
    }
    for frame_id, expected in words.items():
        assert "root:x" not in refused(lambda frame_id=frame_id: dataset.load(frame_id), *expected)
    assert usable(dataset) == ["0", "6", "7"]
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - peak < 100_000
    assert time.monotonic() - began < 5


def test_a_pointer_of_git_lfs_is_told_for_what_it_is(recording: Path) -> None:
    pointer = f"version https://git-lfs.github.com/spec/v1\noid sha256:{'a' * 64}\nsize 1234567\n"
    (recording / "color/1.png").write_text(pointer)
    refused(lambda: open_dataset(recording).load("1"), "a pointer of Git LFS", "git lfs pull", "color/1.png")
    refused(lambda: safe_files.checked_path(recording / "color/1.png"), "a pointer of Git LFS")


def test_links_are_followed_where_they_stay_inside_or_are_allowed(
    recording: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    link = tmp_path / "by-link"
    link.symlink_to(recording)
    replaced(recording / "color/0.png", lambda p: p.symlink_to("1.png"))
    (recording / "depth").rename(tmp_path / "elsewhere")
    (recording / "depth").symlink_to(tmp_path / "elsewhere")
    (tmp_path / "elsewhere/7.png").unlink()
    cv2.imwrite(str(tmp_path / "elsewhere/7.png"), np.full((48, 64), 1007, np.uint16))
    assert usable(open_dataset(link)) == []
    monkeypatch.setenv(LIMITS_VARIABLE, "links=1")
    assert len(usable(open_dataset(link))) == 8
    monkeypatch.delenv(LIMITS_VARIABLE)
    (recording / "depth").unlink()
    (tmp_path / "elsewhere").rename(recording / "depth")
    assert len(usable(open_dataset(link))) == 8
    monkeypatch.chdir(recording)
    assert len(usable(open_dataset("."))) == 8


def test_the_cache_of_a_hub_is_one_folder(recording: Path, tmp_path: Path) -> None:
    commit = tmp_path / "datasets--a--b" / "snapshots" / "c0ffee"
    commit.parent.mkdir(parents=True)
    recording.rename(commit)
    blobs = tmp_path / "datasets--a--b" / "blobs"
    blobs.mkdir()
    (commit / "color/0.png").rename(blobs / "abc")
    (commit / "color/0.png").symlink_to("../../../blobs/abc")
    (tmp_path / "outside").write_bytes((commit / "color/1.png").read_bytes())
    replaced(commit / "color/1.png", lambda p: p.symlink_to(tmp_path / "outside"))
    assert usable(open_dataset(commit)) == ["0", *"234567"]


def test_a_dataset_raises_limits_for_itself_and_not_for_all(recording: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(LIMITS_VARIABLE, "pixels=2k")
    refused(lambda: open_dataset(recording).load("0"), "64x48", "3.072k pixels", "at most 2k", "--limits pixels=4k")
    settings = recording / "spatialviz.toml"
    plain = settings.read_text()
    settings.write_text(plain + '[limits]\npixels = "4k"\n')
    assert len(usable(open_dataset(recording))) == 8
    settings.write_text(plain + "[limits]\npixels = 9000\n")
    refused(lambda: open_dataset(recording), "may not raise the limit pixels", "at most 8k", "--limits pixels=9000")
    for wrong in ("links = 1", "seconds = 1000", 'memory = "16G"', "pixel = 3", 'pixels = "many"'):
        settings.write_text(f"{plain}[limits]\n{wrong}\n")
        refused(lambda: open_dataset(recording), "limit")


@pytest.mark.parametrize("name", ["intrinsics.json", "camera.yaml", "intrinsics.txt", "spatialviz.toml"])
def test_files_beside_the_frames_are_not_waited_for(recording: Path, name: str) -> None:
    (recording / "spatialviz.toml").unlink()
    os.mkfifo(recording / name)
    began = time.monotonic()
    refused(lambda: open_dataset(recording, intrinsics=None, depth_scale=1000).load("0"))
    assert time.monotonic() - began < 2


def test_labels_and_recordings_of_detections_go_through_the_door(tmp_path: Path) -> None:
    (tmp_path / "manifest.json").write_text('{"a":' * 100_000)
    refused(lambda: open_labels(tmp_path), "more than 100 levels", "manifest.json")
    replaced(tmp_path / "manifest.json", lambda p: p.symlink_to("/etc/hostname"))
    refused(lambda: open_labels(tmp_path), "outside the folder")
    sparse(tmp_path / "found.json")
    refused(lambda: RecordedDetector(tmp_path / "found.json"), "too large", "--limits text=4G")


def test_depth_of_json_is_counted_as_it_is() -> None:
    def nested(levels: int, brackets: str = "[]") -> str:
        return brackets[0] * levels + brackets[1] * levels

    most = current_limits().depth
    assert safe_files.parse_json(nested(most)) == json.loads(nested(most))
    refused(lambda: safe_files.parse_json(nested(most + 1)), "brackets")
    refused(lambda: safe_files.parse_json('{"a":' * (most + 1) + "1" + "}" * (most + 1)), "brackets")
    refused(lambda: safe_files.parse_json("[" * 100_000), "brackets")
    texts = [nested(500), "[" * 500, '"' + "{" * 500, "\\", '\\"[']
    assert safe_files.parse_json(json.dumps([texts, {"[": "]"}]).encode()) == [texts, {"[": "]"}]
    refused(lambda: safe_files.parse_json(json.dumps(texts)[:-1] + "," + nested(most) + "]"), "brackets")
    with pytest.raises(json.JSONDecodeError):
        safe_files.parse_json("]" * 500)


def test_archives_are_measured_before_they_are_unpacked(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(LIMITS_VARIABLE, "bytes=2M")
    bomb = tmp_path / "bomb.npz"
    with zipfile.ZipFile(bomb, "w", zipfile.ZIP_DEFLATED) as archive, archive.open("depth.npy", "w") as member:
        np.lib.format.write_array_header_1_0(member, {"descr": "<f4", "fortran_order": False, "shape": (900, 900)})
        member.write(bytes(4 * 900 * 900))
    assert bomb.stat().st_size < 10_000
    refused(lambda: safe_files.load_arrays(bomb.read_bytes(), bomb), "depth.npy", "3.24M bytes", "--limits bytes=4M")
    climbing = tmp_path / "climbing.r3d"
    with zipfile.ZipFile(climbing, "w") as archive:
        archive.writestr("../../evil", b"x")
    refused(lambda: safe_files.open_zip(climbing), "would lie outside", "../../evil")
    header = io.BytesIO()
    np.lib.format.write_array_header_1_0(header, {"descr": "<f4", "fortran_order": False, "shape": (1 << 20, 1 << 20)})
    refused(lambda: safe_files.load_arrays(header.getvalue(), "a.npy"), "1048576x1048576", "1.1T pixels")


def test_members_and_rows_have_limits(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pa, pq = pytest.importorskip("pyarrow"), pytest.importorskip("pyarrow.parquet")
    with zipfile.ZipFile(tmp_path / "many.zip", "w") as archive:
        for k in range(5):
            archive.writestr(str(k), b"1234")
    pq.write_table(pa.table({"a": range(5)}), tmp_path / "rows.parquet")
    for limit, action in (
        ("members", lambda: safe_files.open_zip(tmp_path / "many.zip")),
        ("rows", lambda: safe_files.read_parquet(tmp_path / "rows.parquet")),
    ):
        monkeypatch.setenv(LIMITS_VARIABLE, f"{limit}=4")
        refused(action, f"--limits {limit}=6")
        monkeypatch.setenv(LIMITS_VARIABLE, f"{limit}=5")
        action()
    monkeypatch.setenv(LIMITS_VARIABLE, "names=4")
    (tmp_path / "more").mkdir()
    for k in range(5):
        (tmp_path / "more" / str(k)).touch()
    refused(lambda: open_dataset(tmp_path / "more"), "names")


def encoded(kind: str) -> bytes:
    array = np.zeros((34, 57, 3), np.uint8)
    return cv2.imencode(kind, array)[1].tobytes()


@pytest.mark.parametrize("kind", [".png", ".jpg", ".tiff", ".bmp", ".ppm", ".webp"])
def test_headers_tell_the_size_that_a_decoder_makes(kind: str) -> None:
    data = encoded(kind)
    assert header_size(data) == (57, 34)
    decoded: Any = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
    assert decoded.shape[:2] == (34, 57)
    for cut in range(0, min(len(data), 200)):
        header_size(data[:cut])  # Whatever is cut off, nothing is raised.


def test_headers_of_lossless_webp_big_endian_tiff_and_exr() -> None:
    lossless = cv2.imencode(".webp", np.zeros((34, 57, 3), np.uint8), [cv2.IMWRITE_WEBP_QUALITY, 101])[1].tobytes()
    assert header_size(lossless) == (57, 34)
    tags = struct.pack(">HHIHH", 256, 3, 1, 57, 0) + struct.pack(">HHII", 257, 4, 1, 34)
    assert header_size(b"MM\0*" + struct.pack(">IH", 8, 2) + tags) == (57, 34)
    window = b"dataWindow\0box2i\0" + struct.pack("<I4i", 16, -10, 5, 20_031, 20_000)
    assert header_size(b"\x76\x2f\x31\x01\x02\0\0\0" + window) == (20_042, 19_996)
    assert header_size(b"GIF89a") is None


def test_limits_are_read_and_written_alike(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(LIMITS_VARIABLE, "pixels=1M")
    set_limits("bytes=1.5G, seconds=9")
    assert current_limits() == Limits(pixels=10**6, bytes=1_500_000_000, seconds=9)
    assert os.environ[LIMITS_VARIABLE] == "pixels=1M,bytes=1.5G, seconds=9"
    numbers = (0, 999, 1000, 64_000_000, 1_500_000_000, 256e9)
    assert [shown(n) for n in numbers] == ["0", "999", "1k", "64M", "1.5G", "256G"]
    refused(lambda: set_limits("pixel=3"), "no limit 'pixel'", "pixels")
    refused(lambda: set_limits("pixels"), "no number", "500M")
    assert os.environ[LIMITS_VARIABLE].startswith("pixels=1M")
