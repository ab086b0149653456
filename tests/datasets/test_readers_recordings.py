"""Readers of recordings: TUM, ScanNet, Redwood, SUN RGB-D; round trips, hostile input, the real ones."""

from __future__ import annotations

import json
import pickle
import shutil
import tempfile
from collections.abc import Callable
from decimal import Decimal
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from dataset_writers import (
    HEIGHT,
    START,
    WIDTH,
    K,
    write_folder,
    write_png,
    write_redwood,
    write_scannet,
    write_seven_scenes,
    write_sunrgbd,
    write_tum,
    write_votenet,
)
from every_format import WRITERS
from hypothesis import example, given, settings
from hypothesis import strategies as st

from pipeline.datasets import open_dataset, summarise, survey
from pipeline.datasets.base import dataset_notes
from pipeline.datasets.tum import _match
from pipeline.geometry.camera import backproject
from pipeline.geometry.frame import Frame
from pipeline.geometry.level_plane import level_plane
from pipeline.system.errors import InputError

CAMERA = (60.0, 61.0, 31.5, 23.5)


def refused(action: Callable[[], object], *words: str) -> None:
    """An InputError whose message is one line and holds every word."""
    with pytest.raises(InputError) as caught:
        action()
    message = str(caught.value)
    assert "\n" not in message
    for word in words:
        assert word in message, message


def pose(frame: Frame) -> np.ndarray:
    assert frame.camera.T_world_camera is not None
    return frame.camera.T_world_camera


def degrees(a: np.ndarray, b: np.ndarray) -> float:
    return float(np.degrees(np.arccos(np.clip(a @ b / np.linalg.norm(a) / np.linalg.norm(b), -1, 1))))


# Which format a folder has

@pytest.mark.parametrize("name", WRITERS)
def test_every_format_is_told_from_the_others(tmp_path: Path, name: str) -> None:
    root = tmp_path / "data"
    root.mkdir()
    WRITERS[name](root)
    dataset = open_dataset(root, intrinsics=CAMERA, depth_scale=None if name != "folder" else 1000)
    assert dataset.format == name
    assert dataset.root == root
    reports = list(survey(dataset))
    assert reports
    assert all(report.ok for report in reports), [report.problem for report in reports]
    again = pickle.loads(pickle.dumps(dataset))
    assert np.array_equal(again.load(dataset.frame_ids[0]).depth, dataset.load(dataset.frame_ids[0]).depth)


def test_a_folder_of_datasets_is_no_dataset_of_one_of_their_formats(tmp_path: Path) -> None:
    for name in ("tum", "scannet", "redwood", "sunrgbd", "avd", "semantic-abstraction", "folder"):
        (tmp_path / name).mkdir()
        WRITERS[name](tmp_path / name)
    refused(lambda: open_dataset(tmp_path), "no dataset is recognised", "rgb.txt", "intrinsic_depth.txt")


@pytest.mark.parametrize("mark", ["pose.txt", "other.json", "large.json", "sun3d", "float"])
def test_a_plain_recording_stays_one(tmp_path: Path, mark: str) -> None:
    """Its poses, a foreign file above it, many images beside intrinsics.txt: none makes it another format."""
    root = tmp_path / "rec"
    write_folder(root, [1, 2], poses=mark == "pose.txt")
    camera = {"width": WIDTH, "height": HEIGHT, "intrinsic_matrix": K.T.ravel().tolist()}
    if mark == "pose.txt":
        (tmp_path / "intrinsics.json").write_text(json.dumps(camera))
    elif mark == "other.json":
        (tmp_path / "intrinsics.json").write_text('{"fx": 1}')
    elif mark == "large.json":
        (tmp_path / "intrinsics.json").write_text(json.dumps({**camera, "more": "x" * 100_000}))
    elif mark == "sun3d":
        (root / "rgb").rename(root / "image")
        (root / "extrinsics").mkdir()
        np.savetxt(root / "intrinsics.txt", K)
    else:
        (root / "intrinsics.json").write_text(json.dumps(camera))
        for number in (1, 2):
            (root / f"depth/{number}.png").unlink()
            np.save(root / f"depth/{number}.npy", np.full((HEIGHT, WIDTH), 1.5, np.float32))
    dataset = open_dataset(root, intrinsics=CAMERA, depth_scale=1.0 if mark == "float" else 1000)
    assert dataset.format == "folder"
    assert (dataset.load("1").camera.T_world_camera is not None) == (mark == "pose.txt")


# TUM


def test_tum_is_read_back_exactly(tmp_path: Path) -> None:
    written = write_tum(tmp_path, 4)
    dataset = open_dataset(tmp_path, intrinsics=CAMERA)
    assert dataset.frame_ids == tuple(written)
    assert dataset.class_names == ()
    for frame_id, truth in written.items():
        frame = dataset.load(frame_id)
        assert frame.notes == ()
        assert np.array_equal(frame.rgb, truth.rgb)
        assert np.array_equal(frame.depth, truth.depth)
        assert np.array_equal(frame.camera.K, K)
        np.testing.assert_allclose(pose(frame), truth.T_world_camera, atol=1e-7)
        assert frame.camera.up is None


def test_tum_times_may_stand_in_any_order(tmp_path: Path) -> None:
    written = write_tum(tmp_path, 5)
    for name in ("rgb", "depth", "groundtruth"):
        lines = (tmp_path / f"{name}.txt").read_text().splitlines()
        (tmp_path / f"{name}.txt").write_text("\n".join(lines[::-1]))
    dataset = open_dataset(tmp_path, intrinsics=CAMERA)
    assert dataset.frame_ids == tuple(written)
    for frame_id, truth in written.items():
        frame = dataset.load(frame_id)
        assert np.array_equal(frame.depth, truth.depth)
        np.testing.assert_allclose(pose(frame), truth.T_world_camera, atol=1e-7)


@pytest.mark.parametrize(
    ("folder", "camera", "whose"),
    [
        ("rgbd_dataset_freiburg1_desk", (517.3, 516.5, 318.6, 255.3), "freiburg1's by the folder's name"),
        ("rgbd_dataset_freiburg2_xyz", (520.9, 521.0, 325.1, 249.7), "freiburg2's by the folder's name"),
        ("rgbd_dataset_freiburg3_sitting", (535.4, 539.2, 320.1, 247.6), "freiburg3's by the folder's name"),
        ("mine", (525, 525, 319.5, 239.5), "TUM's default"),
    ],
)
def test_tum_camera_is_the_one_that_the_folder_names(
    tmp_path: Path, folder: str, camera: tuple[float, ...], whose: str
) -> None:
    root = tmp_path / folder
    (frame_id,) = write_tum(root, 1)
    refused(lambda: open_dataset(root).load(frame_id), "640x480", "64x48", "--intrinsics")
    write_png(root / f"rgb/{frame_id}.png", np.zeros((480, 640, 3), np.uint8))
    write_png(next((root / "depth").iterdir()), np.full((480, 640), 7500, np.uint16))
    dataset = open_dataset(root)
    frame = dataset.load(frame_id)
    assert (frame.camera.fx, frame.camera.fy, frame.camera.cx, frame.camera.cy) == camera
    assert frame.notes == ()
    unit, said = dataset_notes(dataset)
    assert "5000 to a metre" in unit
    assert "--depth-scale" in unit
    assert f"{whose}, {','.join(f'{n:g}' for n in camera)}" in said
    assert "--intrinsics" in said
    assert frame.depth[0, 0] == 1.5
    given_by_hand = open_dataset(root, intrinsics=CAMERA, depth_scale=2500)
    assert given_by_hand.load(frame_id).camera.fx == 60
    assert given_by_hand.load(frame_id).depth[0, 0] == 3
    assert dataset_notes(given_by_hand) == ()


STAMPS = st.one_of(
    st.floats(1e-4, 1e12).map(repr),
    st.decimals(0, 10**10, allow_nan=False, allow_infinity=False).map(lambda d: f"{d:f}"),
    st.integers(0, 10**25).map(str),
    st.from_regex(r"[0-9]{1,12}\.[0-9]{1,40}", fullmatch=True),
)


@given(st.lists(STAMPS, min_size=1, max_size=12, unique_by=Decimal), st.sampled_from([" ", "  ", "\t"]))
@example(["0.00585412979126"], " ")
@example(["0.00001", "1311868164.363181", "1311868164.3631810000000001"], " ")
def test_tum_time_stamps_may_be_of_any_length(stamps: list[str], between: str) -> None:
    with tempfile.TemporaryDirectory() as folder:
        root = Path(folder)
        for name in ("rgb", "depth"):
            lines = [f"{stamp}{between}{name}/{k}.png" for k, stamp in enumerate(stamps)]
            (root / f"{name}.txt").write_text("\n".join(lines) + "\n")
        dataset = open_dataset(root)
        assert dataset.frame_ids == tuple(sorted(stamps, key=Decimal))
        for stamp in stamps:
            # Both images of a time are missing: neither their times nor their paths were taken for something else.
            refused(lambda stamp=stamp: dataset.load(stamp), f"rgb/{stamps.index(stamp)}.png")


@pytest.mark.parametrize("stamp", ["9" * 400, "inf", "-1.5", "1.5.2", "0x10", "1_0", "٣", "1e9", "1.", ".5", ""])
def test_tum_times_that_are_none_are_refused(tmp_path: Path, stamp: str) -> None:
    write_tum(tmp_path, 1)
    (tmp_path / "rgb.txt").write_text(f"{stamp} rgb/0.png\n")
    refused(lambda: open_dataset(tmp_path), "line 1", "rgb.txt")


UNSTATED = {
    "bop": (), "tum": ("5000 to a metre", "525,525,319.5,239.5"), "7-scenes": ("1000 to a metre", "585,585,320,240"),
    "scannet": ("1000 to a metre",), "redwood": ("1000 to a metre",), "sunrgbd": ("1000 to a metre",),
    "avd": ("1000 to a metre",), "sunrgbd-votenet": (), "semantic-abstraction": (),
}  # fmt: skip
"""What the files of a format leave unsaid."""


@pytest.mark.parametrize("kind", UNSTATED)
def test_what_no_file_states_is_said_once_with_the_option_that_tells_it(tmp_path: Path, kind: str) -> None:
    said = UNSTATED[kind]
    WRITERS[kind](tmp_path)
    (tmp_path / "camera-intrinsics.txt").unlink(missing_ok=True)
    dataset = open_dataset(tmp_path)
    notes = dataset_notes(dataset)
    assert len(notes) == len(said)
    for note, words, option in zip(notes, said, ("--depth-scale", "--intrinsics"), strict=False):
        assert words in note
        assert option in note
    assert list(summarise(survey(dataset))["notes"]) == list(notes)
    told = open_dataset(tmp_path, intrinsics=CAMERA, depth_scale=1234)
    assert dataset_notes(told) == ()
    (tmp_path / "spatialviz.toml").write_text("depth_scale = 1234.0\n")
    assert not [note for note in dataset_notes(open_dataset(tmp_path)) if "--depth-scale" in note]


def test_an_own_camera_file_of_7_scenes_needs_no_note(tmp_path: Path) -> None:
    for seq in ("seq-01", "seq-02"):
        (tmp_path / seq).mkdir()
        write_seven_scenes(tmp_path / seq, 1)
        (tmp_path / seq / "camera-intrinsics.txt").unlink()
    assert len(dataset_notes(open_dataset(tmp_path))) == 2
    (tmp_path / "seq-01" / "camera-intrinsics.txt").write_text("60 0 31.5 0 61 23.5 0 0 1")
    assert len(dataset_notes(open_dataset(tmp_path))) == 2
    (tmp_path / "seq-02" / "camera-intrinsics.txt").write_text("60 0 31.5 0 61 23.5 0 0 1")
    (note,) = dataset_notes(open_dataset(tmp_path))
    assert "--depth-scale" in note


@pytest.mark.parametrize(
    ("offsets", "ok"),
    [
        ([-0.0199, 1 / 30 + 0.0201], [True, False]),
        ([-0.0201, 1 / 30 + 0.0199], [False, True]),
        ([-0.0199, 1 / 30 - 0.0132], [True, True]),
        # Both images may have the only depth, and the nearer one gets it.
        ([0.018], [False, True]),
        ([0.015], [True, False]),
    ],
)
def test_tum_colour_without_depth_within_20_ms_is_a_broken_frame(
    tmp_path: Path, offsets: list[float], ok: list[bool]
) -> None:
    write_tum(tmp_path, 2)
    path = (tmp_path / "depth.txt").read_text().split()[-1]
    (tmp_path / "depth.txt").write_text("\n".join(f"{START + offset:.6f} {path}" for offset in offsets))
    reports = list(survey(open_dataset(tmp_path, intrinsics=CAMERA)))
    assert [report.ok for report in reports] == ok
    assert all("no depth image within 20 ms" in str(report.problem) for report in reports if not report.ok)
    (tmp_path / "depth.txt").write_text(f"{START + 9:.6f} {path}")
    refused(lambda: open_dataset(tmp_path), "within 20 ms", "depth.txt")


@settings(max_examples=200, deadline=None)
@given(
    a=st.lists(st.integers(0, 200), unique=True, max_size=12),
    b=st.lists(st.integers(0, 200), unique=True, max_size=12),
)
def test_tum_matching_is_that_of_the_datasets_own_tool(a: list[int], b: list[int]) -> None:
    first, second = np.sort(np.array(a, float)) / 1000, np.sort(np.array(b, float)) / 1000
    pairs = sorted(
        (round(abs(x - y) * 1000), i, j)
        for i, x in enumerate(first)
        for j, y in enumerate(second)
        if round(abs(x - y) * 1000) <= 20
    )
    left, right, distances = set(range(len(a))), set(range(len(b))), []
    for distance, i, j in pairs:
        if i in left and j in right:
            left.remove(i)
            right.remove(j)
            distances.append(distance)
    found = _match(first, second)
    assert len(set(found.values())) == len(found)
    mine = sorted(round(abs(first[i] - second[j]) * 1000) for i, j in found.items())
    assert all(distance <= 20 for distance in mine)
    assert len(mine) == 0 or mine[0] == pairs[0][0]
    # Ties may be broken otherwise; nothing that could still be paired is left over.
    assert not any(i not in found and j not in found.values() for _, i, j in pairs)
    if len({pair[0] for pair in pairs}) == len(pairs):
        assert mine == sorted(distances)


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ("1305031102.3 ../secret.png", ["line 3", "outside the dataset"]),
        ("1305031102.3 /etc/passwd", ["outside the dataset", "/etc/passwd"]),
        ("1305031102.3 rgb/../../secret.png", ["outside the dataset"]),
        (r"1305031102.3 ..\secret.png", ["outside the dataset"]),
        (r"1305031102.3 C:\secret.png", ["outside the dataset"]),
        (r"1305031102.3 \\server\secret.png", ["outside the dataset"]),
        ("1305031102.3 rgb/a\0.png", ["outside the dataset"]),
        ("1305031102.3", ["line 3 is malformed", "timestamp path"]),
        ("later rgb/a.png", ["line 3 is malformed"]),
        ("nan rgb/a.png", ["line 3 is malformed"]),
        ("-1 rgb/a.png", ["line 3 is malformed"]),
        ("1e9 rgb/a.png", ["line 3 is malformed"]),
        (f"{'9' * 400} rgb/a.png", ["line 3 is malformed"]),
        (f"{START:.6f} rgb/a.png", ["line 3 repeats a time stamp"]),
    ],
)
@pytest.mark.parametrize("name", ["rgb.txt", "depth.txt"])
def test_tum_line_that_cannot_be_is_refused(tmp_path: Path, name: str, line: str, words: list[str]) -> None:
    write_tum(tmp_path, 1)
    (tmp_path.parent / "secret.png").touch()
    text = (tmp_path / "rgb.txt").read_text()
    (tmp_path / name).write_text(text + line + "\n")
    refused(lambda: open_dataset(tmp_path), *words, name)


def test_tum_lists_that_are_empty_or_no_text_are_refused(tmp_path: Path) -> None:
    write_tum(tmp_path, 1)
    for content, word in ((b"", "empty"), (b"# nothing\n", "without a line"), (b"\xff\xfe\x00", "not a text file")):
        (tmp_path / "rgb.txt").write_bytes(content)
        refused(lambda: open_dataset(tmp_path), word, "rgb.txt")


def test_tum_broken_images_break_their_frame_only(tmp_path: Path) -> None:
    ids = list(write_tum(tmp_path, 4))
    (tmp_path / f"rgb/{ids[0]}.png").unlink()
    depth = sorted((tmp_path / "depth").iterdir())
    depth[1].write_bytes(depth[1].read_bytes()[:-30])
    write_png(depth[2], np.full((HEIGHT, WIDTH - 4), 7500, np.uint16))
    reports = list(survey(open_dataset(tmp_path, intrinsics=CAMERA)))
    assert [report.ok for report in reports] == [False, False, False, True]
    assert "missing" in str(reports[0].problem)
    assert "cut off" in str(reports[1].problem)
    assert "60x48" in str(reports[2].problem)


@pytest.mark.parametrize(
    ("content", "word"),
    [
        ("", "empty"),
        ("1305031102.1783 1 2 3", "count"),
        ("1305031102.1783 0 0 0 0 0 0 one", "not numbers"),
        ("nan 0 0 0 0 0 0 1", "time stamp"),
        ("1305031102.1783 nan 0 0 0 0 0 1", "lost"),
        ("1305031102.1783 0 0 0 0 0 0 2", "length 1"),
        ("1305031102.2 0 0 0 0 0 0 1", "within 20 ms"),
        ("1.0 0 0 0 0 0 0 1", "within 20 ms"),
    ],
)
def test_tum_unusable_pose_is_left_out_with_a_note(tmp_path: Path, content: str, word: str) -> None:
    (frame_id,) = write_tum(tmp_path, 1)
    (tmp_path / "groundtruth.txt").write_text(content)
    frame = open_dataset(tmp_path, intrinsics=CAMERA).load(frame_id)
    assert frame.camera.T_world_camera is None
    (note,) = frame.notes
    assert "no camera pose" in note
    assert word in note
    (tmp_path / "groundtruth.txt").unlink()
    frame = open_dataset(tmp_path, intrinsics=CAMERA).load(frame_id)
    assert frame.camera.T_world_camera is None
    assert frame.notes == ()


# ScanNet


def test_scannet_is_read_back_exactly(tmp_path: Path) -> None:
    written = write_scannet(tmp_path, [0, 2, 10])
    dataset = open_dataset(tmp_path)
    assert dataset.format == "scannet"
    assert dataset.frame_ids == ("0", "2", "10")
    for frame_id, truth in written.items():
        frame = dataset.load(frame_id)
        assert frame.notes == ()
        assert np.array_equal(frame.rgb, truth.rgb)
        assert np.array_equal(frame.depth, truth.depth)
        assert np.array_equal(frame.camera.K, K)
        np.testing.assert_allclose(pose(frame), truth.T_world_camera, atol=1e-12)
        assert frame.camera.up is None
    assert open_dataset(tmp_path, intrinsics=(80, 81, 30, 20), depth_scale=2000).load("2").camera.fx == 80


def test_scannet_larger_colour_is_made_as_large_as_the_depth_and_noted_once(tmp_path: Path) -> None:
    written = write_scannet(tmp_path, [0, 1])
    for frame_id, truth in written.items():
        large = cv2.resize(truth.rgb, (2 * WIDTH + 1, 2 * HEIGHT), interpolation=cv2.INTER_NEAREST)
        write_png(tmp_path / f"color/{frame_id}.png", large)
    dataset = open_dataset(tmp_path)
    frames = [dataset.load(frame_id) for frame_id in dataset.frame_ids]
    assert [len(frame.notes) for frame in frames] == [1, 0]
    assert "129x96" in frames[0].notes[0]
    assert "64x48" in frames[0].notes[0]
    for frame, truth in zip(frames, written.values(), strict=True):
        assert frame.rgb.shape == truth.rgb.shape
        # One column too many of 129 smears the noise a little; a shift of one pixel would give about 85.
        assert np.abs(frame.rgb.astype(int) - truth.rgb).mean() < 45
        assert np.array_equal(frame.camera.K, K)
    write_png(tmp_path / "color/1.png", np.zeros((96, 96, 3), np.uint8))
    refused(lambda: open_dataset(tmp_path).load("1"), "differ in size", "96x96")
    (tmp_path / "intrinsic/intrinsic_depth.txt").unlink()
    refused(lambda: open_dataset(tmp_path).load("0"), "missing", "intrinsic_depth.txt")


def test_scannet_colour_camera_serves_where_there_is_no_other_and_one_size(tmp_path: Path) -> None:
    write_scannet(tmp_path, [0])
    (tmp_path / "intrinsic/intrinsic_depth.txt").unlink()
    np.testing.assert_allclose(open_dataset(tmp_path).load("0").camera.K[:2], 2 * K[:2])


@pytest.mark.parametrize("content", ["-inf " * 16, "nan " * 16, "1 2 3", "", "lost", "2 0 0 0 " * 4])
def test_scannet_lost_pose_is_left_out_with_a_note(tmp_path: Path, content: str) -> None:
    write_scannet(tmp_path, [0, 1])
    (tmp_path / "pose/0.txt").write_text(content)
    lost, fine = (open_dataset(tmp_path).load(frame_id) for frame_id in ("0", "1"))
    assert lost.camera.T_world_camera is None
    assert len(lost.notes) == 1
    assert "no camera pose, 0.txt" in lost.notes[0]
    assert fine.camera.T_world_camera is not None
    (tmp_path / "pose/0.txt").unlink()
    assert "missing" in open_dataset(tmp_path).load("0").notes[0]
    shutil.rmtree(tmp_path / "pose")
    assert open_dataset(tmp_path).load("0").notes == ()


@pytest.mark.parametrize(
    ("content", "words"),
    [
        ("60 0 31.5 0 61 23.5 0 0 1", ["count", "got 9"]),
        ("60 0 31.5 0 0 61 23.5 0 0 0 1 0 0.1 0 0 1", ["last row"]),
        ("60 0 31.5 1 0 61 23.5 0 0 0 1 0 0 0 0 1", ["last column"]),
        ("60 0 0 0 0 61 0 0 31.5 23.5 1 0 0 0 0 1", ["column by column"]),
        ("-60 0 31.5 0 0 61 23.5 0 0 0 1 0 0 0 0 1", ["focal"]),
        ("nan 0 31.5 0 0 61 23.5 0 0 0 1 0 0 0 0 1", ["not finite"]),
        ("60 0 315 0 0 61 23.5 0 0 0 1 0 0 0 0 1", ["principal point"]),
        ("hello", ["not numbers"]),
    ],
)
def test_scannet_wrong_intrinsics_are_refused(tmp_path: Path, content: str, words: list[str]) -> None:
    write_scannet(tmp_path, [0])
    (tmp_path / "intrinsic/intrinsic_depth.txt").write_text(content)
    refused(lambda: open_dataset(tmp_path).load("0"), *words, "intrinsic_depth.txt")


def test_scannet_missing_and_cut_images_break_their_frame_only(tmp_path: Path) -> None:
    write_scannet(tmp_path, [0, 1, 2, 3])
    (tmp_path / "color/0.png").unlink()
    (tmp_path / "depth/1.png").unlink()
    path = tmp_path / "depth/2.png"
    path.write_bytes(path.read_bytes()[:-30])
    reports = list(survey(open_dataset(tmp_path)))
    assert [(report.id, report.ok) for report in reports] == [("0", False), ("1", False), ("2", False), ("3", True)]
    assert "colour file is missing" in str(reports[0].problem)
    assert "depth file is missing" in str(reports[1].problem)
    assert "cut off" in str(reports[2].problem)


# Redwood


@pytest.mark.parametrize(("inside", "opened"), [("", ""), ("RGBD", ""), ("RGBD", "RGBD")])
def test_redwood_is_read_back_exactly(tmp_path: Path, inside: str, opened: str) -> None:
    written = write_redwood(tmp_path / "rec", ["00000", "00001", "00010"], inside)
    dataset = open_dataset(tmp_path / "rec" / opened)
    assert dataset.format == "redwood"
    assert dataset.frame_ids == tuple(written)
    for frame_id, truth in written.items():
        frame = dataset.load(frame_id)
        assert frame.notes == ()
        assert np.array_equal(frame.rgb, truth.rgb)
        assert np.array_equal(frame.depth, truth.depth)
        assert np.array_equal(frame.camera.K, K)
        np.testing.assert_allclose(pose(frame), truth.T_world_camera, atol=1e-9)


def test_redwood_reads_nothing_above_but_the_camera_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write_redwood(tmp_path / "rec", ["0", "1"], "RGBD")
    (tmp_path / "rec/RGBD/trajectory.log").rename(tmp_path / "rec/trajectory.log")
    assert open_dataset(tmp_path / "rec").load("0").camera.T_world_camera is not None
    assert open_dataset(tmp_path / "rec/RGBD").load("0").camera.T_world_camera is None
    monkeypatch.chdir(tmp_path / "rec/RGBD")
    assert np.array_equal(open_dataset(".").load("0").camera.K, K)
    # Two folders up is never looked at, and a camera file of one's own goes first.
    (tmp_path / "rec/camera_primesense.json").rename(tmp_path / "camera_primesense.json")
    refused(lambda: open_dataset(tmp_path / "rec/RGBD"), "--intrinsics")
    camera = {"width": WIDTH, "height": HEIGHT, "intrinsic_matrix": [*(2 * K).T.ravel().tolist()[:8], 1]}
    (tmp_path / "rec/RGBD/intrinsics.json").write_text(json.dumps(camera))
    assert open_dataset(tmp_path / "rec/RGBD").load("0").camera.fx == 120


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda t: t.pop("width"), ["width is missing"]),
        (lambda t: t.update(width=640), ["another image size", "640x48", "64x48"]),
        (lambda t: t.update(intrinsic_matrix=K.ravel().tolist()), ["column by column"]),
        (lambda t: t["intrinsic_matrix"].pop(), ["count", "got 8"]),
        (lambda t: t.update(intrinsic_matrix=None), ["intrinsic_matrix"]),
        (lambda t: t.update(intrinsic_matrix="x"), ["not numbers"]),
        (lambda t: t["intrinsic_matrix"].__setitem__(0, -1), ["focal"]),
        (lambda t: t["intrinsic_matrix"].__setitem__(0, float("nan")), ["not finite"]),
    ],
)
def test_redwood_wrong_camera_file_is_refused(tmp_path: Path, change: Callable[[Any], Any], words: list[str]) -> None:
    write_redwood(tmp_path, ["0"])
    path = tmp_path / "camera_primesense.json"
    table = json.loads(path.read_text())
    change(table)
    path.write_text(json.dumps(table))
    refused(lambda: open_dataset(tmp_path).load("0"), *words, "camera_primesense.json")
    assert open_dataset(tmp_path, intrinsics=CAMERA).load("0").camera.fx == 60
    path.write_text('{"intrinsic_matrix": [1,')
    refused(lambda: open_dataset(tmp_path).load("0"), "malformed JSON", "camera_primesense.json")


@pytest.mark.parametrize(
    ("change", "word"),
    [
        (lambda lines: lines[:-1], "not whole"),
        (lambda lines: ["a b c", *lines[1:]], "line 1"),
        (lambda lines: ["0 0", *lines[1:]], "line 1"),
        (lambda lines: [lines[0], "1 2 3", *lines[2:]], "line 2"),
        (lambda lines: [lines[0], "1 2 3 x", *lines[2:]], "line 2"),
        (lambda lines: [*lines[:5], lines[0], *lines[6:]], "repeats frame 0"),
        (lambda lines: [*lines, "7 7 8", *lines[1:5], "8 8 9", *lines[1:5]], "4 poses for 2 frames"),
        (lambda lines: [], "empty"),
    ],
)
def test_redwood_malformed_trajectory_leaves_the_poses_out(
    tmp_path: Path, change: Callable[[list[str]], list[str]], word: str
) -> None:
    write_redwood(tmp_path, ["desk", "sofa"])
    path = tmp_path / "trajectory.log"
    path.write_text("\n".join(change(path.read_text().splitlines())))
    for report in survey(open_dataset(tmp_path)):
        assert report.ok
        assert not report.has_pose
        (note,) = (note for note in report.notes if "pose" in note)
        assert word in note


def test_redwood_poses_stay_with_their_frames(tmp_path: Path) -> None:
    written = write_redwood(tmp_path, ["0", "1", "2", "3"])
    for folder in ("color", "depth"):
        (tmp_path / folder / "2.png").unlink()
    dataset = open_dataset(tmp_path)
    assert dataset.frame_ids == ("0", "1", "3")
    for frame_id in dataset.frame_ids:
        np.testing.assert_allclose(pose(dataset.load(frame_id)), written[frame_id].T_world_camera, atol=1e-9)
    for folder in ("color", "depth"):
        (tmp_path / folder / "0.png").unlink()
    # Now the files begin at 1: they may as well count from 1 as have lost the first.
    assert "4 poses for 2 frames" in open_dataset(tmp_path).load("1").notes[0]
    lines = (tmp_path / "trajectory.log").read_text().splitlines()
    lines[1] = "inf 0 0 0"
    (tmp_path / "trajectory.log").write_text("\n".join(lines[:10]))
    lost, fine = (open_dataset(tmp_path).load(frame_id) for frame_id in ("1", "3"))
    assert lost.camera.T_world_camera is None
    assert "lost" in lost.notes[0]
    assert fine.camera.T_world_camera is not None


def test_redwood_times_in_the_names_may_differ_between_colour_and_depth(tmp_path: Path) -> None:
    names = ["0000001-000000000000", "0000002-000000033335", "0000003-000000066670"]
    written = write_redwood(tmp_path, names)
    for k, name in enumerate(names[1:]):
        (tmp_path / f"depth/{name}.png").rename(tmp_path / f"depth/{name[:8]}{5000 + k:012d}.png")
    dataset = open_dataset(tmp_path)
    assert dataset.frame_ids == tuple(names)
    for name, truth in written.items():
        frame = dataset.load(name)
        assert np.array_equal(frame.depth, truth.depth)
        np.testing.assert_allclose(pose(frame), truth.T_world_camera, atol=1e-9)


# SUN RGB-D


@pytest.mark.parametrize("prefix", ["", "kv1/NYUdata/", "xtion/sun3ddata/house/room/"])
def test_sunrgbd_is_read_back_exactly(tmp_path: Path, prefix: str) -> None:
    ids = [f"{prefix}{name}" for name in ("NYU0002", "NYU0010")]
    written = write_sunrgbd(tmp_path, ids)
    dataset = open_dataset(tmp_path)
    assert dataset.format == "sunrgbd"
    assert dataset.frame_ids == tuple(ids)
    for frame_id, (truth, Rtilt) in written.items():
        frame = dataset.load(frame_id)
        assert frame.notes == ()
        assert np.array_equal(frame.rgb, truth.rgb)
        assert np.array_equal(frame.depth, truth.depth)
        np.testing.assert_allclose(frame.camera.K, K)
        assert frame.camera.up_source == "declared"
        assert frame.camera.up is not None
        x, y, z = frame.camera.up
        np.testing.assert_allclose(Rtilt @ [x, z, -y], [0, 0, 1], atol=1e-5)
        assert y < -0.9
    alone = open_dataset(tmp_path / ids[0])
    assert alone.frame_ids == ("NYU0002",)
    assert np.array_equal(alone.load("NYU0002").depth, written[ids[0]][0].depth)
    assert open_dataset(tmp_path, intrinsics=(80, 81, 30, 20)).load(ids[0]).camera.fx == 80


def test_sunrgbd_filled_depth_is_the_second_choice(tmp_path: Path) -> None:
    write_sunrgbd(tmp_path, ["a"])
    shutil.rmtree(tmp_path / "a/depth")
    frame = open_dataset(tmp_path).load("a")
    assert (frame.depth == 2).all()
    assert "depth_bfx/ is used" in frame.notes[0]


@pytest.mark.parametrize("content", ["", "1 0 0", "lost", "nan " * 12, "2 0 0 0 0 2 0 0 0 0 2 0", None])
def test_sunrgbd_without_a_tilt_has_no_up(tmp_path: Path, content: str | None) -> None:
    write_sunrgbd(tmp_path, ["a", "b"])
    path = tmp_path / "a/extrinsics/20141221170930.txt"
    path.unlink() if content is None else path.write_text(content)
    frame = open_dataset(tmp_path).load("a")
    assert frame.camera.up is None
    assert "no up vector" in frame.notes[0]
    assert open_dataset(tmp_path).load("b").camera.up is not None
    np.savetxt(tmp_path / "a/extrinsics/20150101000000.txt", np.eye(3, 4))
    newest = open_dataset(tmp_path).load("a").camera.up
    assert newest is not None
    np.testing.assert_allclose(newest, [0, -1, 0], atol=1e-12)


def test_sunrgbd_broken_folders_are_broken_frames(tmp_path: Path) -> None:
    write_sunrgbd(tmp_path, [f"{k}" for k in range(8)])
    (tmp_path / "0/image/0000001.png").unlink()
    shutil.rmtree(tmp_path / "1/image")
    (tmp_path / "2/depth/0000001.png").unlink()
    (tmp_path / "3/intrinsics.txt").unlink()
    (tmp_path / "4/intrinsics.txt").write_text("60 0 31.5")
    path = tmp_path / "5/depth/0000001.png"
    path.write_bytes(path.read_bytes()[:-30])
    np.save(tmp_path / "depth.npy", np.zeros((HEIGHT, WIDTH)))
    shutil.move(tmp_path / "depth.npy", tmp_path / "6/depth/0000001.png")
    reports = list(survey(open_dataset(tmp_path)))
    assert [report.ok for report in reports] == [False] * 7 + [True]
    words = ["colour file", "colour file", "depth file", "missing", "count", "cut off", "rotated bits"]
    for word, report in zip(words, reports, strict=False):
        assert word in str(report.problem)


def test_sunrgbd_links_out_of_the_folder_are_not_followed(tmp_path: Path) -> None:
    write_sunrgbd(tmp_path / "data", ["kv1/a"])
    write_sunrgbd(tmp_path / "elsewhere", ["b"])
    (tmp_path / "data/kv1/b").symlink_to(tmp_path / "elsewhere/b")
    (tmp_path / "data/kv2").symlink_to(tmp_path / "elsewhere")
    (tmp_path / "data/kv1/again").symlink_to(tmp_path / "data")
    assert open_dataset(tmp_path / "data").frame_ids == ("kv1/a",)


# SUN RGB-D as VoteNet exports it


@pytest.mark.parametrize("inside", ["", "sunrgbd_trainval"])
def test_votenet_is_read_back_exactly(tmp_path: Path, inside: str) -> None:
    written = write_votenet(tmp_path / inside, ["000002", "000010"])
    dataset = open_dataset(tmp_path)
    assert dataset.format == "sunrgbd-votenet"
    assert dataset.frame_ids == ("000002", "000010")
    assert dataset.class_names == ("chair",)
    for frame_id, (truth, Rtilt) in written.items():
        frame = dataset.load(frame_id)
        assert frame.notes == ()
        assert np.abs(frame.rgb.astype(int) - truth.rgb).max() <= 3
        assert np.array_equal(frame.depth > 0, truth.depth > 0)
        np.testing.assert_allclose(frame.depth, truth.depth, rtol=1e-5)
        np.testing.assert_allclose(frame.camera.K, K)
        (chair,) = frame.annotations
        assert (chair.label, chair.mask) == ("chair", None)
        assert chair.bbox.tolist() == [10, 5, 30, 35]
        assert chair.box is not None
        corners = chair.box.corners
        upright = np.stack([corners[:, 0], corners[:, 2], -corners[:, 1]], axis=1) @ Rtilt.T
        forward, across = np.array([0.6, -0.8, 0]), np.array([-0.8, -0.6, 0])
        local = (upright - [0.1, 2.5, -0.4]) @ np.stack([across, forward, [0, 0, 1]], axis=1)
        np.testing.assert_allclose(np.abs(local), np.tile([0.3, 0.5, 0.4], (8, 1)), atol=1e-6)


def test_votenet_without_labels_is_a_recording(tmp_path: Path) -> None:
    write_votenet(tmp_path, ["1", "2"])
    (tmp_path / "label/1.txt").unlink()
    (tmp_path / "label/2.txt").write_text("")
    dataset = open_dataset(tmp_path)
    assert dataset.class_names == ()
    assert "no labels, 1.txt" in dataset.load("1").notes[0]
    assert dataset.load("2").notes == ()
    shutil.rmtree(tmp_path / "label")
    frame = open_dataset(tmp_path).load("1")
    assert frame.notes == ()
    assert frame.annotations == ()


@pytest.mark.parametrize(
    ("line", "word"),
    [
        ("sofa", "count"),
        ("sofa 1 2 3 4 5 6", "count"),
        ("sofa 1 2 3 4 0 2 0 1 1 1 x 0", "not numbers"),
        ("sofa 1 2 3 4 0 2 0 1 1 1 nan 0", "NaN"),
        ("sofa 1 2 0 4 0 2 0 1 1 1 1 0", "empty 2D box"),
        ("sofa 1 2 3 4 0 2 0 1 1 1 0 0", "no orientation"),
        ("sofa 1 2 3 4 0 2 0 1 -1 1 1 0", "at least 0"),
    ],
)
def test_votenet_malformed_label_leaves_the_others(tmp_path: Path, line: str, word: str) -> None:
    write_votenet(tmp_path, ["1"])
    path = tmp_path / "label/1.txt"
    path.write_text(f"{line}\n{path.read_text()}")
    frame = open_dataset(tmp_path).load("1")
    assert [(a.index, a.label) for a in frame.annotations] == [(1, "chair")]
    (note,) = frame.notes
    assert "annotation 0 (sofa), line 1" in note
    assert word in note


def test_votenet_wrong_calibrations_are_refused(tmp_path: Path) -> None:
    write_votenet(tmp_path, ["1", "2"])
    calib = tmp_path / "calib/1.txt"
    tilt, K_line = calib.read_text().splitlines()
    for text, words in (
        ((tmp_path / "calib/2.txt").read_text(), ["do not project to pixels", "1.mat"]),
        (f"{tilt}\n60 0 0 0 61 0 32 24 1", ["do not project to pixels"]),
        (f"{tilt}\n60 0 0 0 61 0 92.5 24.5 1", ["outside the image"]),
        (f"{tilt}\n60 0 32.5 0 61 24.5 0 0 1", ["column by column"]),
        (f"{tilt}\nnan 0 0 0 61 0 32.5 24.5 1", ["column by column"]),
        (tilt, ["two lines"]),
        (f"1 2 3\n{K_line}", ["count", "line 1"]),
        (f"2 0 0 0 2 0 0 0 2\n{K_line}", ["not a rotation", "1.txt"]),
    ):
        calib.write_text(text)
        refused(lambda: open_dataset(tmp_path).load("1"), *words)
    calib.unlink()
    refused(lambda: open_dataset(tmp_path).load("1"), "missing", "calib/1.txt")
    assert open_dataset(tmp_path).load("2").depth.any()


def test_votenet_wrong_point_files_are_refused(tmp_path: Path) -> None:
    from scipy.io import savemat

    write_votenet(tmp_path, ["1", "2"])
    path = tmp_path / "depth/1.mat"
    whole = path.read_bytes()
    for content in (b"", b"MATLAB 7.3", b"hello" * 100, whole[: len(whole) // 2], whole[:-20], whole[:130]):
        path.write_bytes(content)
        refused(lambda: open_dataset(tmp_path).load("1"), "1.mat")
    for table in (
        {"other": np.ones((3, 6))},
        {"instance": np.ones(3)},
        {"instance": np.array([["a" * 6] * 6])},
        {"instance": np.full((4, 6), np.nan)},
        {"instance": np.zeros((0, 6))},
        {"instance": np.array([[0, -1, 0, 0, 0, 0.0]])},
    ):
        savemat(path, table)
        refused(lambda: open_dataset(tmp_path).load("1"), "1.mat")
    path.unlink()
    refused(lambda: open_dataset(tmp_path).load("1"), "missing", "1.mat")
    (tmp_path / "image/2.jpg").unlink()
    assert [report.ok for report in survey(open_dataset(tmp_path))] == [False, False]


# The real recordings


@pytest.mark.parametrize(
    ("folder", "name"),
    [
        ("open3d-testdata", "redwood"),
        ("open3d-testdata/RGBD", "redwood"),
        ("sunrgbd-toy", "sunrgbd-votenet"),
        ("sunrgbd-toy/sunrgbd_trainval", "sunrgbd-votenet"),
        ("sunrgbd-toy/images", "sunrgbd"),
        ("sunrgbd-toy/images/img_0063", "sunrgbd"),
        ("ycbv-bop", "bop"),
        ("7scenes-redkitchen", "7-scenes"),
        ("slambook-diningroom", "folder"),
    ],
)
def test_real_recordings_are_told_apart(shared_data: Path, folder: str, name: str) -> None:
    given_by_hand: dict[str, Any] = {"intrinsics": (518, 519, 325.5, 253.5), "depth_scale": 1000}
    options = given_by_hand if name == "folder" else {}
    assert open_dataset(shared_data / "real" / folder, **options).format == name


def test_the_folder_of_all_real_recordings_is_none(shared_data: Path) -> None:
    refused(lambda: open_dataset(shared_data / "real"), "no dataset is recognised")


@pytest.mark.parametrize("opened", ["", "RGBD"])
def test_real_redwood(shared_data: Path, opened: str) -> None:
    root = shared_data / "real/open3d-testdata"
    dataset = open_dataset(root / opened)
    assert dataset.frame_ids == tuple(f"{k:05d}" for k in range(5))
    blocks = np.loadtxt(root / "RGBD/trajectory.log", usecols=range(3), ndmin=2).reshape(5, 5, 3)
    frames = [dataset.load(frame_id) for frame_id in dataset.frame_ids]
    for frame, block in zip(frames, blocks, strict=True):
        assert frame.notes == ()
        assert frame.camera.K.tolist() == [[525, 0, 319.5], [0, 525, 239.5], [0, 0, 1]]
        np.testing.assert_allclose(pose(frame)[:3, :3], block[1:4], atol=1e-12)
        assert 1 < np.median(frame.depth[frame.depth > 0]) < 3


def test_real_redwood_poses_put_the_first_view_on_the_last(shared_data: Path) -> None:
    dataset = open_dataset(shared_data / "real/open3d-testdata")
    a, b = dataset.load("00000"), dataset.load("00004")

    def error(T: np.ndarray) -> float:
        v, u = (grid.ravel() for grid in np.mgrid[0:480:4, 0:640:4])
        points = backproject(a.depth, a.camera, v, u).astype(np.float64)
        moved = points[points[:, 2] > 0] @ T[:3, :3].T + T[:3, 3]
        x, y = (np.round(moved[:, k] / moved[:, 2] * 525 + c).astype(int) for k, c in ((0, 319.5), (1, 239.5)))
        inside = (x >= 0) & (x < 640) & (y >= 0) & (y < 480)
        seen = b.depth[y[inside], x[inside]]
        return float(np.median(np.abs(seen - moved[inside, 2])[seen > 0]))

    right = error(np.linalg.inv(pose(b)) @ pose(a))
    assert right < 0.02
    assert error(pose(b) @ np.linalg.inv(pose(a))) > 2 * right


def test_real_sunrgbd_folders(shared_data: Path) -> None:
    dataset = open_dataset(shared_data / "real/sunrgbd-toy/images")
    assert dataset.frame_ids == ("2014-12-18_11-31-54_260595134347", "img_0063")
    for frame_id, size, fx in zip(dataset.frame_ids, ((530, 730), (427, 561)), (529.5, 520.532), strict=True):
        frame = dataset.load(frame_id)
        assert frame.notes == ()
        assert frame.depth.shape == size
        assert frame.camera.fx == fx
        assert 1 < np.median(frame.depth[frame.depth > 0]) < 4
        assert frame.camera.up is not None
        assert frame.camera.up_source == "declared"
        plane = level_plane(frame.depth, frame.camera)
        assert plane is not None
        # The office's floor is 1.1 degrees off, the shelf of the other 6.1; read transposed, both are over 15 off.
        assert degrees(plane, frame.camera.up) < 7
        assert degrees(plane, frame.camera.up * [1, 1, -1]) > 15


def test_real_bedroom_depth_is_the_image_that_the_points_came_from(shared_data: Path) -> None:
    from scipy.io import loadmat

    root = shared_data / "real/sunrgbd-toy/sunrgbd_trainval"
    frame = open_dataset(root).load("000001")
    assert frame.rgb.shape == (530, 730, 3)
    assert frame.camera.K.tolist() == [[529.5, 0, 364], [0, 529.5, 264], [0, 0, 1]]
    instance = loadmat(root / "depth/000001.mat")["instance"]
    v, u = np.nonzero(frame.depth)
    assert len(v) == len(instance)
    x, y, z = backproject(frame.depth, frame.camera, v, u).astype(np.float64).T
    Rtilt = np.array((root / "calib/000001.txt").read_text().split()[:9], float).reshape(3, 3).T
    upright = np.stack([x, z, -y], axis=1) @ Rtilt.T
    # Rows of the file stand column by column; in that order the points and the colours are the file's own.
    order = np.lexsort((v, u))
    np.testing.assert_allclose(upright[order], instance[:, :3], atol=1e-4)
    np.testing.assert_allclose(frame.rgb[v, u][order] / 255, instance[:, 3:], atol=1e-6)


def test_real_bedroom_boxes_are_the_files_own(shared_data: Path) -> None:
    root = shared_data / "real/sunrgbd-toy"
    dataset = open_dataset(root)
    names = ("bed", "dresser", "dresser_mirror", "lamp", "night_stand", "ottoman")
    assert dataset.class_names == names
    frame = dataset.load("000001")
    assert frame.notes == ()
    lines = [line.split() for line in (root / "sunrgbd_trainval/label/000001.txt").read_text().splitlines()]
    assert [a.label for a in frame.annotations] == [line[0] for line in lines]
    calib = (root / "sunrgbd_trainval/calib/000001.txt").read_text().split()
    Rtilt = np.array(calib[:9], float).reshape(3, 3).T

    def upright(v: np.ndarray) -> np.ndarray:
        return Rtilt @ np.array([v[0], v[2], -v[1]])

    assert frame.camera.up is not None
    assert degrees(upright(frame.camera.up), np.array([0, 0, 1])) < 0.01
    plane = level_plane(frame.depth, frame.camera)
    assert plane is not None
    assert degrees(plane, frame.camera.up) < 2
    rows, columns = np.nonzero(frame.depth)
    points = backproject(frame.depth, frame.camera, rows, columns)
    for annotation, line in zip(frame.annotations, lines, strict=True):
        numbers = np.array(line[1:], float)
        box = annotation.box
        assert box is not None
        assert np.abs(upright(box.center) - numbers[4:7]).max() < 0.001
        np.testing.assert_allclose(box.size / 2, numbers[7:10], atol=1e-9)
        along = upright(box.R[:, 1])
        assert degrees(along[:2], numbers[10:12]) < 0.1
        assert degrees(upright(box.R[:, 2]), np.array([0, 0, 1])) < 0.1
        # What is measured inside the 3D box is seen inside the 2D box, which was drawn independently.
        inside = (np.abs((points - box.center) @ box.R) <= box.size / 2).all(axis=1)
        x0, y0, x1, y1 = annotation.bbox
        seen = (columns >= x0) & (columns < x1) & (rows >= y0) & (rows < y1)
        assert inside.sum() > 150
        assert (inside & seen).sum() > 0.98 * inside.sum()
        assert (inside & seen).sum() > 0.05 * seen.sum()
