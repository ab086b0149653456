"""Recorded detections: played back exactly, hostile ones refused in one line."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from proposal_checks import SEEDS, _own_cache, frame  # noqa: F401
from pycocotools import mask as coco

from pipeline.geometry import Frame, decode_run_length
from pipeline.proposals import RecordedDetector, box_mask, make_detector
from pipeline.system import InputError

# Recordings.


def compressed(mask: np.ndarray) -> dict[str, Any]:
    encoded: Any = coco.encode(np.asfortranarray(mask.astype(np.uint8)))
    return {"size": list(mask.shape), "counts": encoded["counts"].decode()}


def uncompressed(mask: np.ndarray) -> dict[str, Any]:
    flat = mask.ravel(order="F").astype(np.int8)
    change = np.flatnonzero(np.diff(flat)) + 1
    runs = np.diff(np.concatenate([[0], change, [len(flat)]])).tolist()
    return {"size": list(mask.shape), "counts": runs if not flat[0] else [0, *runs]}


@given(SEEDS)
@settings(max_examples=25)
def test_both_run_length_codings_decode_to_the_mask(seed: int) -> None:
    rng = np.random.default_rng(seed)
    mask = cv2.resize(rng.random((6, 7)), (40, 30)) > rng.uniform(0, 1)
    for coding in (compressed, uncompressed):
        encoded = coding(mask)
        decoded = decode_run_length(encoded["size"], encoded["counts"])
        assert decoded.dtype == np.bool_
        np.testing.assert_array_equal(decoded, mask)


def entry(label: str = "coffee mug", score: Any = 0.9, bbox: Any = (10, 20, 60, 80), **more: Any) -> dict[str, Any]:
    return {"label": label, "score": score, "bbox": list(bbox), **more}


def recording(folder: Path, *entries: dict[str, Any], frame_id: str = "scene/0") -> Path:
    path = folder / "found.json"
    path.write_text(json.dumps({"frames": {frame_id: list(entries)}}))
    return path


def test_a_recording_plays_back_what_was_written(tmp_path: Path, frame: Frame) -> None:
    mask = frame.annotations[0].mask
    assert mask is not None
    cv2.imwrite(str(tmp_path / "m.png"), mask.view(np.uint8) * 255)
    path = recording(
        tmp_path,
        entry(mask=compressed(mask)),
        entry(score=0.8, mask=uncompressed(mask)),
        entry("laptop", 0.7, mask="m.png"),
        entry("laptop", 0.1),
    )
    detector = make_detector("recorded", model=path)
    assert detector.vocabulary == ("coffee mug", "laptop")
    found = detector.detect(frame, None)
    assert found.masks is not None
    assert found.has_mask is not None
    for k in range(3):
        np.testing.assert_array_equal(found.masks[k], mask)
    np.testing.assert_array_equal(found.masks[3], box_mask(np.array([10, 20, 60, 80]), 240, 320))
    assert found.has_mask.tolist() == [True, True, True, False]
    np.testing.assert_allclose(found.scores, [0.9, 0.8, 0.7, 0.1])
    np.testing.assert_array_equal(found.boxes, np.tile([10, 20, 60, 80], (4, 1)))
    # A detection keeps its identity whatever is asked for.
    some = detector.detect(frame, ["laptops"])
    assert some.ids.tolist() == [2, 3]
    assert [some.label(i) for i in range(2)] == ["laptop", "laptop"]
    assert make_detector("recorded", model=path, min_score=0.5).detect(frame, ["laptop"]).ids.tolist() == [2]


def test_arrays_play_back_too(tmp_path: Path, frame: Frame) -> None:
    masks = np.stack([a.mask for a in frame.annotations if a.mask is not None])
    boxes = np.stack([a.bbox for a in frame.annotations])
    arrays: dict[str, Any] = {"boxes": boxes, "scores": np.array([0.9, 0.8, 0.7])}
    arrays["labels"] = np.array(["mug", "laptop", "mug"])
    np.savez(tmp_path / "scene__0.npz", **arrays, masks=masks)
    np.savez(tmp_path / "scene__1.npz", **arrays)
    detector = RecordedDetector(tmp_path)
    assert detector.vocabulary == ("laptop", "mug")
    found = detector.detect(frame, ["mug"])
    assert found.ids.tolist() == [0, 2]
    assert found.masks is not None
    np.testing.assert_array_equal(found.masks, masks[[0, 2]])
    bare = detector.detect(replace(frame, id="scene/1"), ["mug"])
    assert bare.has_mask is not None
    assert not bare.has_mask.any()
    with pytest.raises(InputError, match="no detections for frame scene/2"):
        detector.detect(replace(frame, id="scene/2"), None)


def test_a_known_class_that_is_absent_is_an_honest_nothing(tmp_path: Path, frame: Frame) -> None:
    path = tmp_path / "found.json"
    path.write_text(json.dumps({"frames": {"scene/0": [entry()], "scene/1": [entry("lamp")], "scene/2": []}}))
    detector = RecordedDetector(path)
    assert len(detector.detect(frame, ["lamp"])) == 0
    assert len(detector.detect(replace(frame, id="scene/2"), None)) == 0
    with pytest.raises(InputError, match=r"does not know the class 'lammp'.*'lamp'"):
        detector.detect(frame, ["lammp"])
    with pytest.raises(InputError, match="no detections for frame scene/9"):
        detector.detect(replace(frame, id="scene/9"), None)


FULL = 240 * 320


@pytest.mark.parametrize(
    ("bad", "message"),
    [
        (entry(score=1.5), r"frames.scene/0.0.score"),
        (entry(score=-0.1), "score"),
        (entry(score="high"), "score"),
        (entry(score=float("nan")), "score"),
        (entry(bbox=(1, 2, 3)), "bbox"),
        (entry(bbox=(1, 2, 3, float("nan"))), "finite|bbox"),
        (entry(bbox=(1, 2, 3, float("inf"))), "finite|bbox"),
        (entry(label=""), "label"),
        ({"score": 0.5, "bbox": [0, 0, 1, 1]}, "label"),
        (entry(mask={"size": [240, 320], "counts": [5, 5]}), "do not fill the mask"),
        (entry(mask={"size": [240, 320], "counts": [FULL + 5, -5]}), "do not fill the mask"),
        (entry(mask={"size": [240, 320], "counts": "0"}), "do not fill the mask"),
        (entry(mask={"size": [240, 320], "counts": "ooooooo"}), "do not fill the mask"),
        (entry(mask={"size": [240, 320], "counts": "\u4e00\x00\x7f"}), "do not fill the mask"),
        (entry(mask={"size": [240, 320], "counts": ""}), "do not fill the mask"),
        (entry(mask={"size": [10, 10], "counts": [50, 50]}), "another size"),
        (entry(mask={"size": [320, 240], "counts": [FULL]}), "another size"),
        (entry(mask={"size": [-240, -320], "counts": [FULL]}), "another size|do not fill"),
        (entry(mask={"size": [10**6, 10**6], "counts": [10**12]}), "another size"),
        (entry(mask={"size": [240], "counts": [FULL]}), "mask"),
        (entry(mask="../outside.png"), "outside the recording's folder"),
        (entry(mask="/etc/hostname"), "outside the recording's folder"),
        (entry(mask="sub/../../outside.png"), "outside the recording's folder"),
        (entry(mask="absent.png"), "not a readable"),
        (entry(mask="nul\x00.png"), "not a readable"),
        (entry(mask="found.json"), "not a readable"),
        (entry(mask="."), "not a readable"),
    ],
)
def test_a_hostile_recording_is_refused_in_one_line(
    tmp_path: Path, frame: Frame, bad: dict[str, Any], message: str
) -> None:
    folder = tmp_path / "in"
    folder.mkdir()
    cv2.imwrite(str(tmp_path / "outside.png"), np.zeros((240, 320), np.uint8))
    path = recording(folder, bad)
    with pytest.raises(InputError, match=message) as caught:
        RecordedDetector(path).detect(frame, None)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    "content",
    [b"", b"{", b"[]", b'{"frames": []}', b'{"frames": {"a": 3}}', b"\xff\xfe\x00", b'{"other": 1}', b"[" * 100_000],
)
def test_a_file_that_is_no_recording_is_refused(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "found.json"
    path.write_bytes(content)
    with pytest.raises(InputError) as caught:
        RecordedDetector(path)
    assert str(path) in str(caught.value)


def test_a_link_out_of_the_folder_is_not_followed(tmp_path: Path, frame: Frame) -> None:
    folder = tmp_path / "in"
    folder.mkdir()
    cv2.imwrite(str(tmp_path / "outside.png"), np.zeros((240, 320), np.uint8))
    (folder / "link.png").symlink_to(tmp_path / "outside.png")
    with pytest.raises(InputError, match="outside"):
        RecordedDetector(recording(folder, entry(mask="link.png"))).detect(frame, None)


GOOD_ARRAYS: dict[str, Any] = {
    "boxes": np.array([[1, 2, 30, 40.0]]),
    "scores": np.array([0.5]),
    "labels": np.array(["mug"]),
}


@pytest.mark.parametrize(
    "change",
    [
        {"boxes": np.zeros((3, 5))},
        {"boxes": np.zeros((2, 4))},
        {"scores": np.array([2.0])},
        {"scores": np.array([[0.5]])},
        {"labels": np.array([{"a": 1}], dtype=object)},
        {"labels": np.array(["mug", "cup"])},
        {"masks": np.zeros((1, 4, 4), bool)},
        {"masks": np.zeros((2, 240, 320), bool)},
        {"boxes": np.array([["a", "b", "c", "d"]])},
        {"boxes": None},
    ],
)
def test_hostile_arrays_are_refused(tmp_path: Path, frame: Frame, change: dict[str, Any]) -> None:
    arrays: dict[str, Any] = {k: v for k, v in (GOOD_ARRAYS | change).items() if v is not None}
    np.savez(tmp_path / "scene__0.npz", **arrays)
    with pytest.raises(InputError):
        RecordedDetector(tmp_path).detect(frame, None)


@pytest.mark.parametrize("damage", ["empty", "text", "cut", "npy", "noise"])
def test_a_damaged_array_file_is_refused(tmp_path: Path, frame: Frame, damage: str) -> None:
    path = tmp_path / "scene__0.npz"
    np.savez_compressed(path, **GOOD_ARRAYS)
    whole = bytearray(path.read_bytes())
    if damage == "npy":
        with path.open("wb") as file:
            np.save(file, np.zeros(4))
    else:
        whole[150:200] = bytes(50)
        half = bytes(whole[: len(whole) // 2])
        path.write_bytes({"empty": b"", "text": b"hello", "cut": half, "noise": bytes(whole)}[damage])
    with pytest.raises(InputError, match="not a recording"):
        RecordedDetector(tmp_path).detect(frame, None)


def test_a_missing_recording_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no recording"):
        RecordedDetector(tmp_path / "none.json")


def test_arrays_with_text_that_is_none_are_refused(tmp_path: Path, frame: Frame) -> None:
    labels = np.full(1, 0x7FFFFFFF, np.uint32).view("<U1")
    np.savez(tmp_path / "scene__0.npz", boxes=np.zeros((1, 4)), scores=np.ones(1), labels=labels)
    with pytest.raises(InputError, match="no character"):
        RecordedDetector(tmp_path).detect(frame, ["mug"])
