"""Layouts in the wild: pairs by name, single frames, and the formats of capture and reconstruction, as documented."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from dataset_writers import HEIGHT, WIDTH, K, write_png
from reader_checks import FOLDER, refused
from recording_checks import check_frame, truths
from scipy.io import savemat

from pipeline.datasets import open_dataset, survey
from pipeline.datasets.pairing import role_of
from pipeline.geometry import viewer_axes
from pipeline.geometry.viewer import measure

BARE = [K[0, 0], K[1, 1], K[0, 2], K[1, 2]]


# Names


@pytest.mark.parametrize(
    ("color", "depth", "frame_id"),
    [
        ("000007-color.png", "000007-depth.png", "000007"),
        ("7.png", "7_depth.png", "7"),
        ("rgb_0007.png", "depth_0007.png", "0007"),
        ("desk_1_7.png", "desk_1_7_depth.png", "desk_1_7"),
        ("Color_Image_7.jpg", "Depth_Image_7.png", "7"),
        ("shelf-7.rgb.png", "shelf-7.depth.png", "shelf-7"),
        ("apple_1_7_crop.png", "apple_1_7_depthcrop.png", "apple_1_7_crop"),
        ("color/7.png", "aligned_depth/7.png", "7"),
        ("rgb/a-7.png", "depth_raw/b-7.png", "a-7"),
    ],
)
def test_pairs_are_told_by_the_words_of_their_names(tmp_path: Path, color: str, depth: str, frame_id: str) -> None:
    (truth,) = truths(1)
    write_png(tmp_path / color, truth.rgb)
    write_png(tmp_path / depth, truth.millimetres)
    # What stands beside them is no frame.
    for other in ("result.png", "7_depth_vis.png"):
        write_png(tmp_path / other, truth.rgb)
    dataset = open_dataset(tmp_path, **FOLDER)
    assert dataset.frame_ids == (frame_id,)
    check_frame(dataset.load(frame_id), truth)


def test_a_pair_beside_the_folders_of_frames_is_not_the_recording(tmp_path: Path) -> None:
    made = truths(3)
    for number, truth in enumerate(made):
        write_png(tmp_path / f"color/{number}.png", truth.rgb)
        write_png(tmp_path / f"depth/{number}.png", truth.millimetres)
    write_png(tmp_path / "test_color.png", made[0].rgb)
    write_png(tmp_path / "test_depth.png", made[0].millimetres)
    assert open_dataset(tmp_path, **FOLDER).frame_ids == ("0", "1", "2")


def test_a_role_is_a_whole_word() -> None:
    assert [role_of(name)[0] for name in ("indepth", "grgb", "depths", "camera", "kitchen")] == [
        "",
        "",
        "depth",
        "camera",
        "",
    ]


def write_camera_json(path: Path) -> None:
    table = {"color": {"fx": 60.0, "fy": 61.0, "ppx": 31.5, "ppy": 23.5, "width": WIDTH, "height": HEIGHT}}
    path.with_suffix(".json").write_text(json.dumps({**table, "depth_scale": 0.001}))


def write_camera_mat(path: Path) -> None:
    savemat(path.with_suffix(".mat"), {"intrinsic_matrix": K, "factor_depth": np.uint16(1000)})


def write_camera_yml(path: Path) -> None:
    first, last = (", ".join(f"{x}" for x in part) for part in (K.ravel()[:6], K.ravel()[6:]))
    path.with_suffix(".yml").write_text(f"INTRINSICS: [{first},\n  {last}]\nDepthMapFactor: 1000.0\n")


def write_camera_opencv(path: Path) -> None:
    numbers = ", ".join(f"{x}" for x in K.ravel())
    text = f"%YAML:1.0\n---\ncamera_matrix: !!opencv-matrix\n   rows: 3\n   cols: 3\n   dt: d\n   data: [ {numbers} ]\n"
    path.with_suffix(".yaml").write_text(text + "depth_scale: 1000.\n")


def write_camera_orb(path: Path) -> None:
    names = zip(("fx", "fy", "cx", "cy"), BARE, strict=True)
    lines = [f"Camera.{name}: {value}" for name, value in names]
    path.with_suffix(".yaml").write_text("\n".join([*lines, "DepthMapFactor: 1000.0"]))


@pytest.mark.parametrize(
    "write", [write_camera_json, write_camera_mat, write_camera_yml, write_camera_opencv, write_camera_orb]
)
def test_a_single_frame_with_its_camera_file_opens_as_it_comes(tmp_path: Path, write: Callable[[Path], None]) -> None:
    (truth,) = truths(1)
    write_png(tmp_path / "desk/color.png", truth.rgb)
    write_png(tmp_path / "desk/depth.png", truth.millimetres)
    write(tmp_path / "desk/camera")
    dataset = open_dataset(tmp_path / "desk")
    assert dataset.frame_ids == ("desk",)
    check_frame(dataset.load("desk"), truth)


def test_each_frame_may_have_its_camera(tmp_path: Path) -> None:
    for number, truth in enumerate(truths(2)):
        write_png(tmp_path / f"{number}_color.png", truth.rgb)
        write_png(tmp_path / f"{number}_depth.png", truth.millimetres)
        np.savetxt(tmp_path / f"{number}_intrinsics.txt", K + np.diag([number, number, 0]))
    dataset = open_dataset(tmp_path, depth_scale=1000)
    assert [dataset.load(frame_id).camera.fx for frame_id in dataset.frame_ids] == [60, 61]


def test_a_camera_file_of_another_size_is_scaled_or_refused(tmp_path: Path) -> None:
    (truth,) = truths(1)
    write_png(tmp_path / "color/1.png", truth.rgb)
    write_png(tmp_path / "depth/1.png", truth.millimetres)
    camera = {"fx": 120, "fy": 122, "cx": 63.5, "cy": 47.5, "width": 2 * WIDTH, "height": 2 * HEIGHT}
    (tmp_path / "camera.json").write_text(json.dumps(camera))
    check_frame(open_dataset(tmp_path, depth_scale=1000).load("1"), truth)
    (tmp_path / "camera.json").write_text(json.dumps({**camera, "width": WIDTH}))
    refused(lambda: open_dataset(tmp_path, depth_scale=1000).load("1"), "another image size", "camera.json")


def test_camera_files_that_disagree_are_no_camera(tmp_path: Path) -> None:
    (truth,) = truths(1)
    write_png(tmp_path / "color/1.png", truth.rgb)
    write_png(tmp_path / "depth/1.png", truth.millimetres)
    for number, name in enumerate(("camera_a", "camera_b")):
        np.savetxt(tmp_path / f"{name}.txt", K + np.diag([number, 0, 0]))
    refused(lambda: open_dataset(tmp_path, depth_scale=1000), "disagree", "--intrinsics")
    assert open_dataset(tmp_path, **FOLDER).load("1").camera.fx == FOLDER["intrinsics"][0]


@pytest.mark.parametrize("value", [1.0, 0.1, -5.0])
def test_an_ambiguous_depth_scale_is_not_guessed(tmp_path: Path, value: float) -> None:
    (truth,) = truths(1)
    write_png(tmp_path / "color.png", truth.rgb)
    write_png(tmp_path / "depth.png", truth.millimetres)
    (tmp_path / "camera.json").write_text(json.dumps({"K": K.ravel().tolist(), "depth_scale": value}))
    refused(lambda: open_dataset(tmp_path), "the depth's unit is missing", "--depth-scale")


def test_depth_in_npz_and_exr(tmp_path: Path) -> None:
    openexr = pytest.importorskip("OpenEXR")
    (truth,) = truths(1)
    for name in ("1", "2"):
        write_png(tmp_path / f"color/{name}.png", truth.rgb)
    (tmp_path / "depth").mkdir()
    np.savez(tmp_path / "depth/1.npz", depth=truth.depth, confidence=np.ones(3))
    header = {"compression": openexr.ZIP_COMPRESSION, "type": openexr.scanlineimage}
    openexr.File(header, {"Z": truth.depth.astype(np.float32)}).write(str(tmp_path / "depth/2.exr"))
    dataset = open_dataset(tmp_path, intrinsics=FOLDER["intrinsics"])
    assert "--depth-scale" in dataset.notes[0]  # type: ignore[attr-defined]
    for name in ("1", "2"):
        check_frame(dataset.load(name), truth)


# What nothing tells


def test_what_nothing_tells_can_be_looked_at_and_not_measured(tmp_path: Path) -> None:
    (truth,) = truths(1)
    write_png(tmp_path / "1.png", truth.rgb)
    write_png(tmp_path / "1_depth.png", truth.millimetres)
    refused(lambda: open_dataset(tmp_path), "1 pair such as 1.png and 1_depth.png", "--intrinsics", "--depth-scale")
    dataset = open_dataset(tmp_path, browse=True)
    frame = dataset.load("1")
    assert np.array_equal(frame.rgb, truth.rgb)
    assert np.array_equal(frame.depth > 0, truth.depth > 0)
    assert len(frame.camera.untold) == 2
    viewer = viewer_axes(np.array([0.0, -1, 0]))
    refused(lambda: measure(frame.depth, frame.camera, viewer, (5, 5), (9, 9)), "nothing can be measured")
    (report,) = survey(dataset)
    assert report.ok
    assert report.median_depth is None
    assert "--intrinsics" in report.notes[0]
    told = open_dataset(tmp_path, browse=True, **FOLDER).load("1")
    assert told.camera.untold == ()


# YCB-Video


def test_ycb_video_as_it_is_distributed(tmp_path: Path) -> None:
    made = truths(4)
    for number, truth in enumerate(made):
        start = tmp_path / f"000{number // 2}" / f"00000{number % 2 + 1}"
        write_png(Path(f"{start}-color.png"), truth.rgb)
        tenths = (truth.millimetres.astype(np.uint32) * 10).clip(0, 65535)
        write_png(Path(f"{start}-depth.png"), tenths.astype(np.uint16))
        labels = np.zeros((HEIGHT, WIDTH), np.uint8)
        labels[4:9, 5:12], labels[20:30, 30:50] = 2, 14
        write_png(Path(f"{start}-label.png"), labels)
        world_to_camera = np.linalg.inv(np.asarray(truth.T_world_camera))[:3]
        facts = {"intrinsic_matrix": K, "factor_depth": 10000, "rotation_translation_matrix": world_to_camera}
        savemat(f"{start}-meta.mat", facts)
    dataset = open_dataset(tmp_path)
    assert dataset.format == "ycb-video"
    assert dataset.frame_ids == ("0000/000001", "0000/000002", "0001/000001", "0001/000002")
    for frame_id, truth in zip(dataset.frame_ids, made, strict=True):
        frame = dataset.load(frame_id)
        near = truth.millimetres < 6553
        assert np.abs(frame.depth - truth.depth)[near].max() < 1e-6
        np.testing.assert_allclose(frame.camera.T_world_camera, truth.T_world_camera, atol=1e-6)  # type: ignore[arg-type]
        assert [(a.label, a.bbox.tolist()) for a in frame.annotations] == [
            ("cracker box", [5, 4, 12, 9]),
            ("mug", [30, 20, 50, 30]),
        ]
    assert open_dataset(tmp_path / "0001").frame_ids == ("000001", "000002")


def test_real_layouts_open_with_the_one_option_that_is_named(shared_data: Path) -> None:
    real = shared_data / "real"
    refused(lambda: open_dataset(real / "flat-pairs-tabletop"), "3 pairs", "--depth-scale")
    tabletop = open_dataset(real / "flat-pairs-tabletop", depth_scale=1000)
    assert tabletop.load("000001").camera.fx == pytest.approx(618.017, abs=1e-3)
    refused(lambda: open_dataset(real / "numbered-pairs"), "2 pairs", "--intrinsics", "--depth-scale")
    video = open_dataset(real / "ycb-video-layout")
    assert all(report.ok and report.has_pose and report.annotations == 4 for report in survey(video))


def test_picking_challenge_is_not_taken_for_seven_scenes(tmp_path: Path) -> None:
    made = truths(2)
    lines = ["# Environment: shelf", '# Objects: ["a"]', "", "# Color camera intrinsic matrix"]
    lines += [" ".join(map(str, row)) for row in K] + ["# Depth camera intrinsic matrix", "1 0 0", "0 1 0", "0 0 1"]
    for number, truth in enumerate(made):
        write_png(tmp_path / f"frame-00000{number}.color.png", truth.rgb)
        stored = (truth.millimetres.astype(np.uint32) * 10 % 65536).astype(np.uint16)
        write_png(tmp_path / f"frame-00000{number}.depth.png", (stored << 3) | (stored >> 13))
        lines.append(f"# Camera-to-world extrinsic matrix (camera pose) for frame-00000{number}")
        lines += [" ".join(map(repr, row)) for row in np.asarray(truth.T_world_camera).tolist()]
    (tmp_path / "cam.info.txt").write_text("\n".join(lines))
    dataset = open_dataset(tmp_path)
    assert dataset.format == "apc"
    assert dataset.frame_ids == ("frame-000000", "frame-000001")
    for frame_id, truth in zip(dataset.frame_ids, made, strict=True):
        frame = dataset.load(frame_id)
        near = truth.millimetres < 6553
        assert np.abs(frame.depth - truth.depth)[near].max() < 1e-6
        np.testing.assert_allclose(frame.camera.T_world_camera, truth.T_world_camera, atol=1e-6)  # type: ignore[arg-type]


# Messages


@pytest.mark.parametrize(
    ("files", "words"),
    [
        (["0001.png", "0002.png"], ["2 pictures and no depth", "0001_depth.png"]),
        (["rgb/1.jpg", "rgb/2.jpg"], ["2 pictures in rgb/ and no depth"]),
        (["depth/1.png"], ["depth (depth) without colour", "color/"]),
        (["walk.mp4"], ["walk.mp4: a video has no depth"]),
        (["a.npz", "b.npz"], ["a.npz", "array file"]),
        (["rgb.txt", "rgb/1.png"], ["rgb.txt of TUM without depth.txt"]),
        (["sparse.ply"], ["point cloud"]),
        (["drive.mcap"], ["a folder with drive.mcap", "the capture itself"]),
    ],
)
def test_what_is_no_recording_is_told_by_what_is_seen(tmp_path: Path, files: list[str], words: list[str]) -> None:
    for name in files:
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_bytes(b"x")
    message = refused(lambda: open_dataset(tmp_path), *words)
    assert len(message) < 200 + len(str(tmp_path)) * 2


@pytest.mark.parametrize(
    ("name", "words"), [("a.png", "single picture"), ("a.mp4", "video"), ("a.zip", "archive"), ("a.xyz", "no dataset")]
)
def test_a_file_that_is_no_capture_has_its_own_sentence(tmp_path: Path, name: str, words: str) -> None:
    (tmp_path / name).write_bytes(b"x")
    refused(lambda: open_dataset(tmp_path / name), words)


@pytest.mark.slow
def test_a_hundred_thousand_frames_are_listed_without_being_opened(tmp_path: Path) -> None:
    import time

    (truth,) = truths(1)
    write_png(tmp_path / "color/000000.png", truth.rgb)
    write_png(tmp_path / "depth/000000.png", truth.millimetres)
    for kind in ("color", "depth"):
        first = tmp_path / kind / "000000.png"
        for number in range(1, 20_000):
            (tmp_path / kind / f"{number:06d}.png").hardlink_to(first)
    start = time.process_time()
    dataset = open_dataset(tmp_path, **FOLDER)
    # A fifth of the frames in a fifth of 3 s, doubled for a slow machine.
    assert time.process_time() - start < 1.2
    assert len(dataset.frame_ids) == 20_000
    check_frame(dataset.load("019999"), truth)
