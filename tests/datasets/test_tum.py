"""TUM recordings: lists, time stamps, cameras and poses."""

from __future__ import annotations

import tempfile
from decimal import Decimal
from pathlib import Path

import numpy as np
import pytest
from dataset_writers import (
    HEIGHT,
    START,
    WIDTH,
    K,
    write_png,
    write_seven_scenes,
    write_tum,
)
from every_format import WRITERS
from hypothesis import example, given, settings
from hypothesis import strategies as st
from recording_checks import CAMERA, pose, refused
from slow_cases import mostly_slow

from pipeline.datasets import SurveyCounts, dataset_notes, open_dataset, survey
from pipeline.datasets.tum import match_times

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


@pytest.mark.slow
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
    "bop": (),
    "tum": ("5000 to a metre", "525,525,319.5,239.5"),
    "7-scenes": ("1000 to a metre", "585,585,320,240", "of two cameras"),
    "scannet": ("1000 to a metre",),
    "redwood": ("1000 to a metre",),
    "sunrgbd": ("1000 to a metre",),
    "avd": ("1000 to a metre",),
    "sunrgbd-votenet": (),
    "semantic-abstraction": (),
}
"""What the files of a format leave unsaid."""


@pytest.mark.parametrize("kind", mostly_slow(UNSTATED, fast=(0, 1, 2, 3)))
def test_what_no_file_states_is_said_once_with_the_option_that_tells_it(tmp_path: Path, kind: str) -> None:
    said = UNSTATED[kind]
    WRITERS[kind](tmp_path)
    (tmp_path / "camera-intrinsics.txt").unlink(missing_ok=True)
    dataset = open_dataset(tmp_path)
    notes = dataset_notes(dataset)
    assert len(notes) == len(said)
    for note, words, option in zip(notes, said, ("--depth-scale", "--intrinsics", "spatialviz doctor"), strict=False):
        assert words in note
        assert option in note
    counts = SurveyCounts()
    assert list(counts.watch(survey(dataset)))
    assert counts.record()["notes"] == list(notes)
    # Where the colour camera stands is told by spatialviz.toml alone.
    warp = tuple(note for note in notes if "of two cameras" in note)
    told = open_dataset(tmp_path, intrinsics=CAMERA, depth_scale=1234)
    assert dataset_notes(told) == warp
    (tmp_path / "spatialviz.toml").write_text("registration = [60.0, 60.0, 31.5, 23.5, 0.0, 0.0, 0.0]\n")
    assert not [note for note in dataset_notes(open_dataset(tmp_path)) if "of two cameras" in note]
    (tmp_path / "spatialviz.toml").write_text("depth_scale = 1234.0\n")
    assert not [note for note in dataset_notes(open_dataset(tmp_path)) if "--depth-scale" in note]


def test_an_own_camera_file_of_7_scenes_needs_no_note(tmp_path: Path) -> None:
    for seq in ("seq-01", "seq-02"):
        (tmp_path / seq).mkdir()
        write_seven_scenes(tmp_path / seq, 1)
        (tmp_path / seq / "camera-intrinsics.txt").unlink()
    assert len(dataset_notes(open_dataset(tmp_path))) == 3
    (tmp_path / "seq-01" / "camera-intrinsics.txt").write_text("60 0 31.5 0 61 23.5 0 0 1")
    assert len(dataset_notes(open_dataset(tmp_path))) == 3
    (tmp_path / "seq-02" / "camera-intrinsics.txt").write_text("60 0 31.5 0 61 23.5 0 0 1")
    unit, warp = dataset_notes(open_dataset(tmp_path))
    assert "--depth-scale" in unit
    assert "of two cameras" in warp


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


@settings(max_examples=50, deadline=None)
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
    found = match_times(first, second)
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
    ],
)
@pytest.mark.parametrize("name", ["rgb.txt", "depth.txt"])
def test_tum_line_that_cannot_be_is_refused(tmp_path: Path, name: str, line: str, words: list[str]) -> None:
    write_tum(tmp_path, 1)
    (tmp_path.parent / "secret.png").touch()
    text = (tmp_path / "rgb.txt").read_text()
    (tmp_path / name).write_text(text + line + "\n")
    refused(lambda: open_dataset(tmp_path), *words, name)


@pytest.mark.parametrize("name", ["rgb", "depth"])
def test_a_line_that_repeats_a_time_stamp_is_left_out_and_said(tmp_path: Path, name: str) -> None:
    write_tum(tmp_path, 2)
    path = tmp_path / f"{name}.txt"
    first = path.read_text().splitlines()[1]
    path.write_text(f"{path.read_text()}{first}\n{first.split()[0]} {name}/a.png\n")
    dataset = open_dataset(tmp_path, intrinsics=CAMERA)
    assert [dataset.load(frame_id).id for frame_id in dataset.frame_ids] == list(dataset.frame_ids)
    assert len(dataset.frame_ids) == 2
    assert [note for note in dataset_notes(dataset) if "left out" in note] == [
        f"{name}.txt: 1 line, such as line 5, left out: another picture with the same time stamp"
    ]


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
