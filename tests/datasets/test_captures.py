"""Captures and reconstructions, written as their makers document them and read back."""

from __future__ import annotations

import json
import zipfile
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from dataset_writers import HEIGHT, OPENGL, WIDTH, K, write_nerfstudio, write_png
from reader_checks import refused
from recording_checks import check_frame, truths
from scipy.spatial.transform import Rotation

from pipeline.datasets import open_dataset

BARE = [K[0, 0], K[1, 1], K[0, 2], K[1, 2]]


# Reconstructions


@pytest.mark.parametrize("named", [True, False])
def test_nerfstudio(tmp_path: Path, named: bool) -> None:
    made = write_nerfstudio(tmp_path, named)
    dataset = open_dataset(tmp_path)
    assert dataset.format == "nerfstudio"
    assert "nerfstudio's, 1000 to a metre" in dataset.notes[0]  # type: ignore[attr-defined]
    for frame_id, truth in zip(dataset.frame_ids, made, strict=True):
        check_frame(dataset.load(frame_id), truth, posed=True)


def test_nerfstudio_leaves_what_it_cannot_use_in_one_line(tmp_path: Path) -> None:
    write_nerfstudio(tmp_path)
    table = json.loads((tmp_path / "transforms.json").read_text())
    table["k1"] = 0.1
    table["frames"][0]["transform_matrix"] = [[1, 2], [3, 4]]
    (tmp_path / "transforms.json").write_text(json.dumps(table))
    dataset = open_dataset(tmp_path)
    assert "distortion" in dataset.notes[-1]  # type: ignore[attr-defined]
    assert "transform_matrix" in dataset.load("frame_00001").notes[0]
    table["frames"][0]["file_path"] = "../../etc/passwd"
    (tmp_path / "transforms.json").write_text(json.dumps(table))
    refused(lambda: open_dataset(tmp_path), "outside the dataset")
    (tmp_path / "transforms.json").write_text(json.dumps({"frames": [{"file_path": "images/frame_00001.png"}]}))
    for path in (tmp_path / "depth").iterdir():
        path.unlink()
    refused(lambda: open_dataset(tmp_path), "depth")


def test_colmap_text_model_with_a_depth_folder(tmp_path: Path) -> None:
    made, lines = truths(3), ["# Image list with two lines of data per image:"]
    for number, truth in enumerate(made, start=1):
        write_png(tmp_path / f"images/view {number}.png", truth.rgb)
        write_png(tmp_path / f"depth/view {number}.png", truth.millimetres)
        T = np.linalg.inv(np.asarray(truth.T_world_camera))
        x, y, z, w = Rotation.from_matrix(T[:3, :3]).as_quat()
        pose = " ".join(repr(float(v)) for v in (w, x, y, z, *T[:3, 3]))
        # Points of the last picture may be none: an empty line.
        lines += [
            f"{number} {pose} 1 view {number}.png",
            "1.5 2.5 -1 20.25 30.5 7 3.5 4.5 8 9.5 1.5 12" if number < 3 else "",
        ]
    (tmp_path / "sparse/0").mkdir(parents=True)
    (tmp_path / "sparse/0/images.txt").write_text("\n".join(lines) + "\n")
    (tmp_path / "sparse/0/cameras.txt").write_text(f"# comment\n1 PINHOLE {WIDTH} {HEIGHT} 60 61 32 24\n")
    refused(lambda: open_dataset(tmp_path), "3 posed pictures", "--depth-scale")
    dataset = open_dataset(tmp_path, depth_scale=1000)
    assert dataset.format == "colmap"
    assert dataset.frame_ids == ("view 1", "view 2", "view 3")
    for frame_id, truth in zip(dataset.frame_ids, made, strict=True):
        check_frame(dataset.load(frame_id), truth, posed=True)


# Phones


def test_arkitscenes(tmp_path: Path) -> None:
    made, lines = truths(3), []
    root = tmp_path / "41069021"
    for number, truth in enumerate(made):
        name = f"41069021_{305.123 + number / 10:.3f}"
        write_png(root / f"lowres_wide/{name}.png", truth.rgb)
        write_png(root / f"lowres_depth/{name}.png", truth.millimetres)
        write_png(root / f"confidence/{name}.png", np.ones((HEIGHT, WIDTH), np.uint8))
        pincam = root / f"lowres_wide_intrinsics/41069021_{305.124 + number / 10:.3f}.pincam"
        pincam.parent.mkdir(exist_ok=True)
        pincam.write_text(f"{WIDTH} {HEIGHT} 60 61 31.5 23.5")
        T = np.linalg.inv(np.asarray(truth.T_world_camera))
        vector = cv2.Rodrigues(T[:3, :3])[0].ravel()
        lines.append(" ".join(repr(float(v)) for v in (305.1234 + number / 10, *vector, *T[:3, 3])))
    (root / "lowres_wide.traj").write_text("\n".join(lines[:2]))
    dataset = open_dataset(root)
    assert dataset.format == "arkitscenes"
    assert dataset.frame_ids[0] == "41069021_305.123"
    for number, (frame_id, truth) in enumerate(zip(dataset.frame_ids, made, strict=True)):
        frame = dataset.load(frame_id)
        check_frame(frame, truth, posed=number < 2)
        assert (frame.camera.up_source == "declared") == (number < 2)
    assert "none within" in dataset.load(dataset.frame_ids[2]).notes[0]


def test_record3d(tmp_path: Path) -> None:
    lzfse = pytest.importorskip("lzfse")
    made = truths(2)
    poses = []
    with zipfile.ZipFile(tmp_path / "room.r3d", "w") as archive:
        for number, truth in enumerate(made):
            large = cv2.resize(truth.rgb, (2 * WIDTH, 2 * HEIGHT))
            archive.writestr(f"rgbd/{number}.jpg", cv2.imencode(".jpg", large)[1].tobytes())
            depth = np.where(truth.depth > 0, truth.depth, np.nan).astype(np.float32)
            archive.writestr(f"rgbd/{number}.depth", lzfse.compress(depth.tobytes()))
            T = np.asarray(truth.T_world_camera) @ OPENGL
            poses.append([*Rotation.from_matrix(T[:3, :3]).as_quat(), *T[:3, 3]])
        camera = [120.0, 0, 0, 0, 122.0, 0, 63.5, 47.5, 1]
        sizes = {"w": 2 * WIDTH, "h": 2 * HEIGHT, "dw": WIDTH, "dh": HEIGHT}
        archive.writestr("metadata", json.dumps({"K": camera, **sizes, "fps": 60, "poses": poses}))
    dataset = open_dataset(tmp_path / "room.r3d")
    assert dataset.format == "record3d"
    for frame_id, truth in zip(dataset.frame_ids, made, strict=True):
        frame = dataset.load(frame_id)
        check_frame(frame, truth, posed=True)
        assert frame.camera.up_source == "declared"
    (tmp_path / "other.r3d").write_bytes(b"PK\x03\x04 cut off")
    refused(lambda: open_dataset(tmp_path / "other.r3d"), "not a Record3D capture")


def test_record3d_exported_to_files(tmp_path: Path) -> None:
    """`rgb/N.jpg`, `depth/N.exr` and `metadata.json`, as the application exports them; the third depth is missing."""
    openexr = pytest.importorskip("OpenEXR")
    made, poses = truths(3), []
    (tmp_path / "depth").mkdir()
    for number, truth in enumerate(made):
        write_png(tmp_path / f"rgb/{number}.jpg", cv2.resize(truth.rgb, (2 * WIDTH, 2 * HEIGHT)))
        header = {"compression": openexr.ZIP_COMPRESSION, "type": openexr.scanlineimage}
        with openexr.File(header, {"R": truth.depth}) as file:
            file.write(str(tmp_path / f"depth/{number}.exr"))
        T = np.asarray(truth.T_world_camera) @ OPENGL
        poses.append([*Rotation.from_matrix(T[:3, :3]).as_quat(), *T[:3, 3]])
    (tmp_path / "depth/1.exr").unlink()
    table = {"w": 2 * WIDTH, "h": 2 * HEIGHT, "K": [120.0, 0, 0, 0, 122.0, 0, 63.5, 47.5, 1], "poses": poses}
    (tmp_path / "metadata.json").write_text(json.dumps({**table, "fps": 60}))
    dataset = open_dataset(tmp_path)
    assert (dataset.format, dataset.frame_ids) == ("record3d", ("0", "2"))
    for frame_id in dataset.frame_ids:
        check_frame(dataset.load(frame_id), made[int(frame_id)], posed=True)
        assert dataset.load(frame_id).camera.up_source == "declared"
    # Folders of these names beside other metadata are a plain recording.
    (tmp_path / "metadata.json").write_text(json.dumps({"K": K.ravel().tolist()}))
    assert open_dataset(tmp_path).format == "folder"


# Tables


def encoded(pixels: np.ndarray) -> dict[str, Any]:
    pixels = pixels[..., ::-1] if pixels.ndim == 3 else pixels
    return {"bytes": cv2.imencode(".png", pixels)[1].tobytes(), "path": None}


def test_parquet_with_picture_columns(tmp_path: Path) -> None:
    made = truths(3)
    columns = {
        "id": ["a", "b", "c"],
        "image": [encoded(truth.rgb) for truth in made],
        "depth": [encoded(truth.millimetres) for truth in made],
        "intrinsics": [K.tolist()] * 3,
        "prompt": ["mug", "table", "box"],
    }
    (tmp_path / "data").mkdir()
    pq.write_table(pa.table(columns), tmp_path / "data/train-00000-of-00001.parquet", row_group_size=2)
    refused(lambda: open_dataset(tmp_path), "3 rows with image and depth", "the depth's unit", "--depth-scale")
    for path in (tmp_path, tmp_path / "data/train-00000-of-00001.parquet"):
        dataset = open_dataset(path, depth_scale=1000)
        assert dataset.format == "parquet"
        assert dataset.frame_ids == ("a", "b", "c")
        for frame_id, truth in zip(dataset.frame_ids, made, strict=True):
            check_frame(dataset.load(frame_id), truth)
    floats = {"image": columns["image"], "depth": [truth.depth.tolist() for truth in made]}
    pq.write_table(pa.table(floats), tmp_path / "x.parquet")
    check_frame(open_dataset(tmp_path / "x.parquet", intrinsics=tuple(BARE)).load("2"), made[2])  # type: ignore[arg-type]
    pq.write_table(pa.table({"image": columns["image"]}), tmp_path / "x.parquet")
    refused(lambda: open_dataset(tmp_path / "x.parquet"), "without a depth column", "image")


def test_lerobot_with_pictures_in_its_tables(tmp_path: Path) -> None:
    """LeRobot v3 recorded without videos: chunks of tables, several cameras, the depth's unit in `meta/info.json`."""
    made = truths(4)
    other = [encoded(np.zeros((HEIGHT, WIDTH, 3), np.uint8))] * 2
    for number in (0, 1):
        part = made[2 * number : 2 * number + 2]
        tiffs = [{"bytes": cv2.imencode(".tiff", t.millimetres)[1].tobytes(), "path": None} for t in part]
        columns = {
            "observation.images.top": other,
            "observation.images.front": [encoded(truth.rgb) for truth in part],
            "observation.images.front_depth": tiffs,
            "timestamp": [0.0, 0.1],
        }
        (tmp_path / f"data/chunk-00{number}").mkdir(parents=True)
        pq.write_table(pa.table(columns), tmp_path / f"data/chunk-00{number}/file-000.parquet")
    (tmp_path / "meta").mkdir()
    depth = {"dtype": "image", "info": {"is_depth_map": True, "depth_unit": "mm"}}
    features = {"observation.images.front": {"dtype": "image"}, "observation.images.front_depth": depth}
    (tmp_path / "meta/info.json").write_text(json.dumps({"codebase_version": "v3.0", "features": features}))
    refused(lambda: open_dataset(tmp_path), "observation.images.front_depth; a camera is missing", "--intrinsics")
    dataset = open_dataset(tmp_path, intrinsics=tuple(BARE))  # type: ignore[arg-type]
    assert dataset.frame_ids[1:3] == ("chunk-000/file-000/1", "chunk-001/file-000/0")
    for frame_id, truth in zip(dataset.frame_ids, made, strict=True):
        check_frame(dataset.load(frame_id), truth)


@pytest.mark.parametrize(("depth", "words"), [(False, "and no depth"), (True, "front_depth)")])
def test_lerobot_with_videos_is_told(tmp_path: Path, depth: bool, words: str) -> None:
    (tmp_path / "meta").mkdir()
    video = {"dtype": "video", "info": {"video.codec": "av1"}}
    features = {"action": {"dtype": "float32"}, "observation.images.front": video}
    features |= {"observation.images.front_depth": video} if depth else {}
    (tmp_path / "meta/info.json").write_text(json.dumps({"codebase_version": "v3.0", "features": features}))
    refused(lambda: open_dataset(tmp_path), "dataset of LeRobot with pictures in videos", words, "video=false")
