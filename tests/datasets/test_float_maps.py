"""Depth in floats: dense workspaces of COLMAP, PFM, floats under a picture's name, and floats that are no metres."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from app_writers import truths, write_colmap_binary
from dataset_writers import Truth, write_png
from reader_checks import FOLDER, refused
from recording_checks import check_frame

from pipeline.datasets import dataset_notes, open_dataset
from pipeline.datasets.images import read_stored

NAMES = ["cam_a/2.png", "cam_b/1.png"]


def write_map(path: Path, depth: np.ndarray) -> None:
    """`write_array` of COLMAP's `scripts/python/read_write_dense.py`: "width&height&channels&", then little-endian
    floats of the transposed array in Fortran's order."""
    path.parent.mkdir(parents=True, exist_ok=True)
    height, width = depth.shape
    data = np.transpose(depth.astype("<f4"), (1, 0)).reshape(-1, order="F").tobytes()
    path.write_bytes(f"{width}&{height}&1&".encode() + data)


def write_workspace(root: Path, made: list[Truth], kind: str = "geometric") -> None:
    """What `image_undistorter` and `patch_match_stereo` leave, https://colmap.github.io/format.html; a negative value is
    none, as 0."""
    for truth, name in zip(made, NAMES, strict=True):
        write_png(root / "images" / name, truth.rgb)
        depth = np.where(truth.depth > 0, truth.depth, -1.0)
        write_map(root / f"stereo/depth_maps/{name}.{kind}.bin", depth)
        write_map(root / f"stereo/normal_maps/{name}.{kind}.bin", depth)
    (root / "stereo/fusion.cfg").write_text("\n".join(NAMES))
    write_colmap_binary(root / "sparse", made, NAMES)


@pytest.mark.parametrize("kind", ["geometric", "photometric"])
@pytest.mark.parametrize("place", ["", "dense", "dense/0"])
def test_a_dense_workspace_of_colmap_is_read_with_its_own_model(tmp_path: Path, place: str, kind: str) -> None:
    made = truths(2)
    write_workspace(tmp_path / place, made, kind)
    if place:
        # The raw model beside it has another camera and other places, of pictures that are not undistorted.
        write_colmap_binary(tmp_path / "sparse/0", made[::-1], NAMES)
        for name in NAMES:
            write_png(tmp_path / "images" / name, made[0].rgb[:20])
    dataset = open_dataset(tmp_path)
    assert dataset.format == "colmap"
    for frame_id, truth in zip(("2", "1"), made, strict=True):
        check_frame(dataset.load(frame_id), truth, posed=True)
    notes = " ".join(dataset_notes(dataset))
    assert "scale of poses and depth" in notes
    assert ("not read: images/" in notes) == bool(place)


def test_depth_in_a_folder_of_its_own_is_the_raw_models(tmp_path: Path) -> None:
    made = truths(2)
    write_workspace(tmp_path / "dense", made[::-1])
    write_colmap_binary(tmp_path / "sparse/0", made, ["2.png", "1.png"])
    for name, truth in zip(["2.png", "1.png"], made, strict=True):
        write_png(tmp_path / "images" / name, truth.rgb)
        write_png(tmp_path / "depth" / name, truth.millimetres)
    check_frame(open_dataset(tmp_path, depth_scale=1000.0).load("2"), made[0], posed=True)


@pytest.mark.parametrize(
    "data", [b"", b"4&4&1&", b"4&4&1&" + bytes(63), b"4&4&3&" + bytes(192), b"-4&4&1&", b"4&", b"&&&"]
)
def test_a_broken_map_is_told(tmp_path: Path, data: bytes) -> None:
    write_workspace(tmp_path, truths(2))
    (tmp_path / f"stereo/depth_maps/{NAMES[0]}.geometric.bin").write_bytes(data)
    dataset = open_dataset(tmp_path)
    refused(lambda: dataset.load("2"), "geometric.bin")
    assert dataset.load("1").depth.any()
