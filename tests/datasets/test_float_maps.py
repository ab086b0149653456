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
    """What `image_undistorter` and `patch_match_stereo` leave, https://colmap.github.io/format.html; below 0 is
    none, as 0 is."""
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


# PFM, and floats under a picture's name


def write_pfm(path: Path, depth: np.ndarray, big: bool = False, upright: bool = False) -> None:
    """http://netpbm.sourceforge.net/doc/pfm.html: the bottom row first, a scale below 0 for little-endian. `upright`:
    the top row first, as `write_pfm` of AirSim's `PythonClient/airsim/utils.py` leaves it."""
    path.parent.mkdir(parents=True, exist_ok=True)
    rows = depth if upright else depth[::-1]
    head = f"Pf\n{depth.shape[1]} {depth.shape[0]}\n{'1.0' if big else '-1.0'}\n"
    path.write_bytes(head.encode() + rows.astype(">f4" if big else "<f4").tobytes())


@pytest.mark.parametrize("big", [False, True])
def test_pfm_has_the_bottom_row_first_and_says_so(tmp_path: Path, big: bool) -> None:
    (truth,) = truths(1)
    write_png(tmp_path / "color/1.png", truth.rgb)
    write_pfm(tmp_path / "depth/1.pfm", truth.depth, big)
    assert np.array_equal(read_stored(tmp_path / "depth/1.pfm"), truth.depth)
    dataset = open_dataset(tmp_path, intrinsics=FOLDER["intrinsics"])
    check_frame(dataset.load("1"), truth)
    assert any("AirSim" in note and "top-bottom" in note for note in dataset_notes(dataset))
    write_pfm(tmp_path / "depth/1.pfm", truth.depth, big, upright=True)
    (tmp_path / "spatialviz.toml").write_text('depth_turned = "top-bottom"')
    check_frame(open_dataset(tmp_path, intrinsics=FOLDER["intrinsics"]).load("1"), truth)


@pytest.mark.parametrize("data", [b"Pf\n", b"Pf\n4 4\n-1\n" + bytes(63), b"PF\n1 1\n-1\n" + bytes(12), b"Pf\n4 4\nx\n"])
def test_a_broken_pfm_is_told(tmp_path: Path, data: bytes) -> None:
    (tmp_path / "1.pfm").write_bytes(data)
    refused(lambda: read_stored(tmp_path / "1.pfm"), "1.pfm")


@pytest.mark.parametrize("ending", ["npy", "pfm"])
def test_floats_under_a_pictures_name_are_its_depth_where_there_is_no_other(tmp_path: Path, ending: str) -> None:
    made = truths(2)
    for number, truth in enumerate(made):
        write_png(tmp_path / f"{number:04d}.png", truth.rgb)
        if ending == "npy":
            np.save(tmp_path / f"{number:04d}.npy", truth.depth)
        else:
            write_pfm(tmp_path / f"{number:04d}.pfm", truth.depth)
    dataset = open_dataset(tmp_path, intrinsics=FOLDER["intrinsics"])
    for frame_id, truth in zip(("0000", "0001"), made, strict=True):
        check_frame(dataset.load(frame_id), truth)
    assert any(f"0000.{ending} and its like are taken for the depth" in note for note in dataset_notes(dataset))
    # A folder of depth is what its name says.
    for number, truth in enumerate(made):
        write_png(tmp_path / f"depth/{number}.png", truth.millimetres)
        write_png(tmp_path / f"color/{number}.png", truth.rgb)
    assert open_dataset(tmp_path, **FOLDER).frame_ids == ("0", "1")


@pytest.mark.parametrize("place", ["", "images/"])
def test_floats_of_other_names_are_named_with_what_else_lies_there(tmp_path: Path, place: str) -> None:
    # `img_VEHICLE_CAMERA_TYPE_TIME` of AirSim's recordings, docs/modify_recording_data.md.
    for number, truth in enumerate(truths(3)):
        write_png(tmp_path / f"{place}img_Car_0_0_{number}.png", truth.rgb)
        write_pfm(tmp_path / f"{place}img_Car_0_2_{number}.pfm", truth.depth)
    (tmp_path / "airsim_rec.txt").write_text("VehicleName\tTimeStamp\n")
    words = "img_Car_0_2_0.pfm and 2 more", "airsim_rec.txt", "img_Car_0_0_0_depth.pfm beside img_Car_0_0_0.png"
    refused(lambda: open_dataset(tmp_path), *words)


# Stereo cameras, and floats that are no metres


@pytest.mark.parametrize(
    ("left", "depth", "right"),
    [
        ("left/left_{}.png", "depth/depth_{}.npy", "right/right_{}.png"),
        ("left{:06d}.png", "depth{:06d}.npy", "right{:06d}.png"),  # svo_export of the ZED SDK, mode 4
        ("image_left/{}_left.png", "depth_left/{}_left_depth.npy", "image_right/{}_right.png"),  # TartanAir
        ("rgb_left/{}.png", "depth/{}.npy", "rgb_right/{}.png"),
    ],
)
def test_the_left_cameras_pictures_are_colour_where_no_others_are(
    tmp_path: Path, left: str, depth: str, right: str
) -> None:
    made = truths(2)
    for number, truth in enumerate(made):
        write_png(tmp_path / left.format(number), truth.rgb)
        write_png(tmp_path / right.format(number), truth.rgb[:, ::-1])
        (tmp_path / depth.format(number)).parent.mkdir(exist_ok=True)
        np.save(tmp_path / depth.format(number), truth.depth)
    dataset = open_dataset(tmp_path, intrinsics=FOLDER["intrinsics"])
    for frame_id, truth in zip(dataset.frame_ids, made, strict=True):
        frame = dataset.load(frame_id)
        assert np.array_equal(frame.rgb, truth.rgb)
        check_frame(frame, truth)
    if "/" in right:
        assert any(f"not read: {right.partition('/')[0]}/" in note for note in dataset_notes(dataset))


def test_left_is_not_colour_where_colour_is(tmp_path: Path) -> None:
    (truth,) = truths(1)
    for folder in ("color", "left"):
        write_png(tmp_path / folder / "1.png", truth.rgb if folder == "color" else 255 - truth.rgb)
    write_png(tmp_path / "depth/1.png", truth.millimetres)
    assert np.array_equal(open_dataset(tmp_path, **FOLDER).load("1").rgb, truth.rgb)


def test_floats_that_cannot_be_metres_are_asked_about(tmp_path: Path) -> None:
    """The ZED SDK's own unit is the millimetre, https://www.stereolabs.com/docs/depth-sensing/depth-settings, where a
    value too near is -inf, too far +inf and hidden NaN."""
    made = truths(2)
    for number, truth in enumerate(made):
        write_png(tmp_path / f"left/{number}.png", truth.rgb)
        depth = truth.millimetres.astype(np.float32)
        depth[truth.millimetres == 0] = (np.nan, np.inf, -np.inf)[number]
        (tmp_path / "depth").mkdir(exist_ok=True)
        np.save(tmp_path / f"depth/{number}.npy", depth)
    camera = FOLDER["intrinsics"]
    refused(lambda: open_dataset(tmp_path, intrinsics=camera), "cannot be metres", "--depth-scale", "1000")
    browsed = open_dataset(tmp_path, intrinsics=camera, browse=True)
    assert browsed.load("0").camera.untold
    assert not any("taken for metres" in note for note in dataset_notes(browsed))
    for frame_id, truth in zip(("0", "1"), made, strict=True):
        check_frame(open_dataset(tmp_path, **FOLDER).load(frame_id), truth)
    # A later frame is looked at when it is read.
    np.save(tmp_path / "depth/0.npy", made[0].depth)
    dataset = open_dataset(tmp_path, intrinsics=camera)
    check_frame(dataset.load("0"), made[0])
    refused(lambda: dataset.load("1"), "cannot be metres", "--depth-scale")
