"""Image files that are not what they should be: cut, damaged, of another kind."""

from __future__ import annotations

import struct
import sys
import zlib
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest
from dataset_writers import (
    HEIGHT,
    WIDTH,
    write_bop,
    write_png,
)
from hypothesis import given, settings
from hypothesis import strategies as st
from reader_checks import refused

from pipeline.datasets import (
    open_dataset,
    read_color,
)
from pipeline.datasets.images import read_depth, read_mask
from pipeline.datasets.png_masks import mask_of_png
from pipeline.system import InputError

# Files that are not what they should be


def encodings() -> dict[str, bytes]:
    rng = np.random.default_rng(0)
    noise = rng.integers(0, 256, (HEIGHT, WIDTH, 3)).astype(np.uint8)
    depth = rng.integers(500, 4000, (HEIGHT, WIDTH)).astype(np.uint16)
    smooth = cv2.resize(noise[:4, :4], (640, 480), interpolation=cv2.INTER_LINEAR)

    def encode(suffix: str, image: np.ndarray, *options: int) -> bytes:
        return cv2.imencode(suffix, image, options)[1].tobytes()

    return {
        "png": encode(".png", noise),
        "png16": encode(".png", depth),
        "png-large": encode(".png", smooth),
        "jpeg": encode(".jpg", noise),
        "jpeg-large": encode(".jpg", smooth),
        "jpeg-progressive": encode(".jpg", smooth, cv2.IMWRITE_JPEG_PROGRESSIVE, 1),
        "jpeg-restarts": encode(".jpg", smooth, cv2.IMWRITE_JPEG_RST_INTERVAL, 2),
        "tiff": encode(".tiff", noise),
        "pgm": encode(".pgm", depth),
        "ppm": encode(".ppm", noise),
    }


@pytest.mark.parametrize("kind", list(encodings()))
def test_a_file_cut_anywhere_is_refused(tmp_path: Path, kind: str) -> None:
    whole = encodings()[kind]
    path = tmp_path / "000001.png"
    path.write_bytes(whole)
    assert read_color(path).shape[2] == 3
    size = len(whole)
    rng = np.random.default_rng(1)
    cuts = {
        size // 2,
        int(size * 0.95),
        size - 20,
        size - 2,
        size - 1,
        1,
        *rng.integers(1, size, 20).tolist(),
    }
    for cut in sorted(cuts):
        path.write_bytes(whole[:cut])
        refused(lambda: read_color(path), "000001.png")


@pytest.mark.parametrize("kind", ["png", "png16", "png-large"])
def test_a_png_with_a_flipped_bit_is_refused(tmp_path: Path, kind: str) -> None:
    whole = encodings()[kind]
    path = tmp_path / "1.png"
    for position in np.random.default_rng(2).integers(8, len(whole), 20).tolist():
        damaged = bytearray(whole)
        damaged[position] ^= 0x10
        path.write_bytes(damaged)
        refused(lambda: read_color(path), "1.png")


def test_a_jpeg_with_a_thumbnail_is_cut_where_the_picture_ends(tmp_path: Path) -> None:
    whole, thumbnail = encodings()["jpeg-large"], encodings()["jpeg"]
    segment = b"\xff\xe1" + struct.pack(">H", len(thumbnail) + 2) + thumbnail
    with_thumbnail = whole[:2] + segment + whole[2:]
    path = tmp_path / "1.jpg"
    path.write_bytes(with_thumbnail + b"\0\0padding")
    assert read_color(path).shape == (480, 640, 3)
    path.write_bytes(with_thumbnail[: len(with_thumbnail) * 3 // 4])
    refused(lambda: read_color(path), "cut off")


@pytest.mark.parametrize(
    "content",
    [
        b"",
        b"hello, I am no image\n",
        b"version https://git-lfs.github.com/spec/v1\n",
        b"\x89PNG\r\n\x1a\n",
        b"\xff\xd8\xff",
    ],
    ids=["empty", "text", "lfs", "png-magic-only", "jpeg-magic-only"],
)
@pytest.mark.parametrize("read", [read_color, read_mask, lambda path: read_depth(path, 1000)])
def test_what_is_no_image_is_refused(tmp_path: Path, content: bytes, read: Callable[[Path], object]) -> None:
    path = tmp_path / "000001.png"
    path.write_bytes(content)
    refused(lambda: read(path), "000001.png")
    refused(lambda: read(tmp_path / "absent.png"), "missing", "absent.png")
    refused(lambda: read(tmp_path), str(tmp_path))


@settings(max_examples=30, deadline=None)
@given(
    data=st.binary(max_size=200),
    magic=st.sampled_from([b"\x89PNG\r\n\x1a\n", b"\xff\xd8", b"P5 4 4 9 ", b"II*\0", b"\x93NUMPY"]),
)
def test_rubbish_behind_any_magic_is_refused_or_read(
    tmp_path_factory: pytest.TempPathFactory, data: bytes, magic: bytes
) -> None:
    path = tmp_path_factory.getbasetemp() / "rubbish"
    path.write_bytes(magic + data)
    for read in (read_color, lambda p: read_depth(p, 1000)):
        problem: InputError | None = None
        try:
            assert read(path).size > 0
        except InputError as error:
            problem = error
        assert problem is None or str(path) in str(problem)


def test_depth_of_a_wrong_kind_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "1.png"
    write_png(path, np.full((HEIGHT, WIDTH), 100, np.uint8))
    refused(lambda: read_depth(path, 1000), "8 bits", "1.png")
    assert cv2.imwrite(str(path), np.full((HEIGHT, WIDTH, 3), 1000, np.uint16))
    refused(lambda: read_depth(path, 1000), "one channel")
    write_png(path, np.full((HEIGHT, WIDTH), 1000, np.uint16))
    refused(lambda: read_depth(path, None), "--depth-scale")
    np.save(tmp_path / "1.npy", np.array([[{}]], dtype=object))
    refused(lambda: read_depth(tmp_path / "1.npy", 1.0), "1.npy")
    np.save(tmp_path / "1.npy", np.ones((4, 4), complex))
    refused(lambda: read_depth(tmp_path / "1.npy", 1.0), "must be numbers")
    np.save(tmp_path / "1.npy", np.ones((4, 4)))
    whole = (tmp_path / "1.npy").read_bytes()
    (tmp_path / "1.npy").write_bytes(whole[:-20])
    refused(lambda: read_depth(tmp_path / "1.npy", 1.0), "1.npy")


def test_exr_without_its_package_says_what_to_install(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "OpenEXR", None)
    path = tmp_path / "1.exr"
    path.write_bytes(b"\x76\x2f\x31\x01" + bytes(100))
    refused(lambda: read_depth(path, None), "pip install OpenEXR", "1.exr")


def test_exr_depth_is_read(tmp_path: Path) -> None:
    OpenEXR = pytest.importorskip("OpenEXR", reason="the optional OpenEXR package is not installed")
    depth = np.random.default_rng(0).uniform(0.5, 4, (HEIGHT, WIDTH)).astype(np.float32)
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    path = tmp_path / "1.exr"
    for channels in ({"Z": depth}, {"R": depth, "G": depth, "B": depth}):
        with OpenEXR.File(header, channels) as image:
            image.write(str(path))
        assert np.array_equal(read_depth(path, None), depth)
    with OpenEXR.File(header, {"R": depth, "G": depth + 1, "B": depth}) as image:
        image.write(str(path))
    refused(lambda: read_depth(path, None), "one channel")
    path.write_bytes(path.read_bytes()[:-20])
    refused(lambda: read_depth(path, None), "1.exr")


def test_colour_ignores_the_orientation_tag(tmp_path: Path) -> None:
    exif = b"Exif\0\0MM\0*\0\0\0\x08\0\x01\x01\x12\0\x03\0\0\0\x01\0\x06\0\0\0\0\0\0"
    whole = encodings()["jpeg-large"]
    path = tmp_path / "1.jpg"
    path.write_bytes(whole[:2] + b"\xff\xe1" + struct.pack(">H", len(exif) + 2) + exif + whole[2:])
    turned = cv2.imread(str(path))
    assert turned is not None
    assert turned.shape[:2] == (640, 480)
    assert read_color(path).shape[:2] == (480, 640)


def test_sixteen_bit_and_coloured_masks_keep_every_pixel(tmp_path: Path) -> None:
    mask = np.zeros((HEIGHT, WIDTH), np.uint16)
    mask[3, 4] = 1
    write_png(tmp_path / "1.png", mask)
    assert np.array_equal(read_mask(tmp_path / "1.png"), mask > 0)
    bgra = np.zeros((HEIGHT, WIDTH, 4), np.uint8)
    bgra[..., 3] = 255
    bgra[3, 4, 2] = 1
    assert cv2.imwrite(str(tmp_path / "1.png"), bgra)
    assert np.array_equal(read_mask(tmp_path / "1.png"), mask > 0)


def png_of(rows: np.ndarray, width: int, depth: int, filters: int) -> bytes:
    """Grey PNG of rows of bytes, all filtered by one of none, sub and up."""
    if filters == 1:
        rows = np.diff(rows, axis=1, prepend=np.uint8(0))
    elif filters == 2:
        rows = np.diff(rows, axis=0, prepend=np.zeros_like(rows[:1]))
    raw = np.concatenate([np.full((len(rows), 1), filters, np.uint8), rows.astype(np.uint8)], axis=1).tobytes()
    header = struct.pack(">2I5B", width, len(rows), depth, 0, 0, 0, 0)
    parts = ((b"IHDR", header), (b"IDAT", zlib.compress(raw)), (b"IEND", b""))
    chunks = (struct.pack(">I", len(d)) + k + d + struct.pack(">I", zlib.crc32(k + d)) for k, d in parts)
    return b"\x89PNG\r\n\x1a\n" + b"".join(chunks)


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 2**32 - 1), st.sampled_from([0, 1, 2]), st.sampled_from([1, 8]))
def test_a_mask_is_read_as_opencv_decodes_it(seed: int, filters: int, depth: int) -> None:
    rng = np.random.default_rng(seed)
    height, width = (int(k) for k in rng.integers(1, 40, 2))
    mask = np.zeros((height, width), np.bool_)
    top, left = rng.integers(0, [height, width])
    mask[top : top + rng.integers(0, 20), left : left + rng.integers(0, 20)] = True
    mask &= rng.random(mask.shape) < rng.choice([0.5, 1.0])
    rows = np.packbits(mask, axis=1) if depth == 1 else mask.astype(np.uint8) * np.uint8(200)
    data = png_of(rows, width, depth, filters)
    found = mask_of_png(data)
    assert found is not None
    assert found.size == (height, width)
    np.testing.assert_array_equal(found.whole, mask)
    decoded = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
    assert decoded is not None
    np.testing.assert_array_equal(decoded > 0, mask)


def test_a_mask_of_more_or_fewer_rows_than_it_says_is_left_to_the_decoder() -> None:
    rows = np.ones((6, 9), np.uint8)
    data = png_of(rows, 9, 8, 0)
    assert mask_of_png(data) is not None
    for height in (5, 7, 0, 2**31 - 1):
        header = struct.pack(">2I5B", 9, height, 8, 0, 0, 0, 0)
        sized = data[:16] + header + struct.pack(">I", zlib.crc32(b"IHDR" + header)) + data[33:]
        assert mask_of_png(sized) is None
    palette = data[:25] + b"\x03" + data[26:]
    assert mask_of_png(palette) is None
    assert mask_of_png(data[:20]) is None


def test_colour_and_depth_of_different_sizes_are_refused(tmp_path: Path) -> None:
    write_bop(tmp_path, {"000001": [1]})
    write_png(tmp_path / "000001/depth/000001.png", np.full((30, 40), 1000, np.uint16))
    refused(lambda: open_dataset(tmp_path).load("000001/000001"), "40x30", "64x48", "depth/000001.png")
