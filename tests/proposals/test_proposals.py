"""OPM: selection, the truth and recordings as detectors, the cache, and a real network."""

from __future__ import annotations

import json
import os
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pycocotools import mask as coco
from scenes import frame_of, upright

from pipeline.datasets import open_dataset
from pipeline.geometry.boxes import iou_2d
from pipeline.geometry.frame import Frame
from pipeline.geometry.masks import decode_run_length
from pipeline.language.naming import Synonyms, default_synonyms
from pipeline.proposals import AnnotationDetector, CachedDetector, Detector, Proposals, make_detector, top_k
from pipeline.proposals.annotations import box_mask
from pipeline.proposals.base import no_proposals
from pipeline.proposals.recorded import RecordedDetector
from pipeline.proposals.selection import suppress
from pipeline.proposals.yolo_seg import letterbox
from pipeline.system.errors import InputError

SEEDS = st.integers(0, 2**32 - 1)


@pytest.fixture(autouse=True)
def _own_cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SPATIALVIZ_CACHE", str(tmp_path / "cache"))


@pytest.fixture(scope="module")
def frame() -> Frame:
    boxes = [upright((x, 0.9, 2), (0.3, 0.4, 0.3)) for x in (-0.6, 0.0, 0.6)]
    return frame_of(boxes, ["coffee mug", "laptop", "coffee mug"])


def proposals_of(boxes: np.ndarray, scores: np.ndarray) -> Proposals:
    n = len(boxes)
    return Proposals(
        boxes.astype(np.float32), scores.astype(np.float32), np.zeros(n, np.int64), ("thing",), None, np.arange(n)
    )


def random_boxes(rng: np.random.Generator, n: int) -> np.ndarray:
    low = rng.uniform(0, 60, (n, 2))
    return np.concatenate([low, low + rng.uniform(5, 40, (n, 2))], axis=1)


# Selection.


@given(SEEDS, st.integers(0, 25), st.floats(0.05, 0.95))
def test_suppression_is_greedy_by_score(seed: int, n: int, threshold: float) -> None:
    boxes = random_boxes(np.random.default_rng(seed), n)
    kept: list[int] = []
    for i in range(n):
        if all(iou_2d(boxes[i], boxes[j])[0, 0] <= threshold for j in kept):
            kept.append(i)
    assert suppress(boxes, threshold).tolist() == kept


@given(SEEDS, st.integers(0, 25), st.integers(1, 12))
def test_top_k_are_the_best_that_do_not_overlap(seed: int, n: int, k: int) -> None:
    rng = np.random.default_rng(seed)
    proposals = proposals_of(random_boxes(rng, n), rng.uniform(0, 1, n))
    chosen = top_k(proposals, k, min_score=0.2)
    assert len(chosen) <= k
    assert (np.diff(chosen.scores) <= 0).all()
    assert (chosen.scores >= 0.2).all()
    overlap = iou_2d(chosen.boxes, chosen.boxes)
    assert (overlap[~np.eye(len(chosen), dtype=bool)] <= 0.5).all()
    # Whatever was left out is too weak, overlaps a better one, or comes after the K.
    left_out = set(range(n)) - set(chosen.ids.tolist())
    for i in left_out:
        better = chosen.scores >= proposals.scores[i]
        covered = (iou_2d(proposals.boxes[i], chosen.boxes)[0, :] > 0.5) & better
        assert proposals.scores[i] < 0.2 or covered.any() or better.sum() == k


def test_equal_scores_keep_the_order_of_the_detector() -> None:
    boxes = np.array([[0, 0, 10, 10], [50, 0, 60, 10], [0, 50, 10, 60]])
    assert top_k(proposals_of(boxes, np.full(3, 0.5)), 2).ids.tolist() == [0, 1]


@pytest.mark.parametrize("size", [(480, 640), (100, 333), (641, 479), (1080, 1920)])
@pytest.mark.parametrize("inside", [(480, 640), (640, 640), (320, 416)])
def test_a_letterboxed_box_comes_back(size: tuple[int, int], inside: tuple[int, int]) -> None:
    rng = np.random.default_rng(0)
    h, w = size
    rgb = rng.integers(0, 256, (h, w, 3)).astype(np.uint8)
    image, place = letterbox(rgb, *inside)
    assert image.shape == (*inside, 3)
    assert place.width == inside[1] or place.height == inside[0]
    border = np.ones(inside, bool)
    border[place.top : place.top + place.height, place.left : place.left + place.width] = False
    assert (image[border] == 114).all()
    assert abs(inside[0] - place.height - 2 * place.top) <= 1
    assert abs(inside[1] - place.width - 2 * place.left) <= 1
    boxes = np.sort(rng.uniform(0, 1, (20, 2, 2)), axis=1).reshape(20, 4) * [w, h, w, h]
    there = boxes * place.scale + [place.left, place.top] * 2
    back = place.to_picture(there, h, w)
    np.testing.assert_allclose(back, boxes, atol=0.01)
    outside = place.to_picture(np.array([[-500, -500, 5000, 5000.0]]), h, w)
    np.testing.assert_allclose(outside, [[0, 0, w, h]])
    if inside == size:
        np.testing.assert_array_equal(image, rgb)


def test_a_mark_keeps_its_place_in_the_letterbox() -> None:
    rgb = np.zeros((300, 500, 3), np.uint8)
    rgb[100:150, 200:260] = 255
    image, place = letterbox(rgb, 640, 640)
    v, u = np.nonzero((image > 200).all(axis=2))
    back = place.to_picture(np.array([[u.min(), v.min(), u.max() + 1, v.max() + 1]]), 300, 500)
    np.testing.assert_allclose(back, [[200, 100, 260, 150]], atol=1)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"scores": np.array([0.1, 3.0], np.float32)}, "0..1.*logits"),
        ({"scores": np.array([0.1, -0.2], np.float32)}, "0..1"),
        ({"scores": np.array([0.1, np.nan], np.float32)}, "0..1"),
        ({"boxes": np.zeros((3, 4), np.float32)}, "proposals must have boxes"),
        ({"boxes": np.full((2, 4), np.inf, np.float32)}, "finite"),
        ({"masks": np.zeros((2, 4, 4), np.uint8)}, "bool"),
        ({"masks": np.zeros((1, 4, 4), bool)}, "for 2 proposals"),
    ],
)
def test_hostile_proposals_are_refused(change: dict[str, Any], message: str) -> None:
    with pytest.raises(InputError, match=message):
        replace(proposals_of(random_boxes(np.random.default_rng(0), 2), np.array([0.1, 0.2])), **change)


# The truth as a detector.


def test_annotations_come_as_they_are(frame: Frame) -> None:
    detector = AnnotationDetector(("coffee mug", "laptop", "lamp"))
    found = detector.detect(frame, None)
    assert [found.label(i) for i in range(3)] == ["coffee mug", "laptop", "coffee mug"]
    assert found.ids.tolist() == [0, 1, 2]
    assert (found.scores == 1).all()
    assert found.masks is not None
    for k, annotation in enumerate(frame.annotations):
        assert annotation.mask is not None
        np.testing.assert_array_equal(found.masks[k], annotation.mask)
    assert detector.detect(frame, ["mugs", "mug"]).ids.tolist() == [0, 2]
    assert len(detector.detect(frame, ["lamp"])) == 0


def test_an_unknown_class_is_an_error_with_a_suggestion(frame: Frame) -> None:
    detector = AnnotationDetector(("coffee mug", "laptop", "lamp"))
    with pytest.raises(InputError, match=r"the dataset does not know the class 'lapptop'.*'laptop'"):
        detector.detect(frame, ["lapptop"])
    with pytest.raises(InputError, match="known: coffee mug, lamp, laptop"):
        detector.detect(frame, ["zebra"])


def test_an_annotation_without_a_mask_is_its_box(frame: Frame) -> None:
    bare = replace(frame, annotations=(replace(frame.annotations[0], mask=None), frame.annotations[1]))
    found = AnnotationDetector().detect(bare, None)
    assert found.has_mask is not None
    assert found.has_mask.tolist() == [False, True]
    assert found.masks is not None
    np.testing.assert_array_equal(found.masks[0], box_mask(bare.annotations[0].bbox, 240, 320))


def test_a_box_mask_is_clipped_to_the_picture() -> None:
    mask = box_mask(np.array([-5, 2, 3, 400]), 10, 20)
    assert mask[2:, :3].all()
    assert mask.sum() == 8 * 3
    assert not box_mask(np.array([5, 5, 5, 9]), 10, 20).any()


def test_an_unknown_detector_and_a_missing_model_are_refused() -> None:
    with pytest.raises(InputError, match=r"no detector 'magic'.*annotations or recorded or yolo-seg"):
        make_detector("magic")
    for name in ("recorded", "yolo-seg"):
        with pytest.raises(InputError, match="needs --model"):
            make_detector(name)
    assert isinstance(make_detector("annotations"), Detector)


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
@settings(max_examples=40)
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


# The cache.


class Counting:
    """A detector that counts its runs and finds one thing for each name."""

    name = "counting"
    exact = False
    vocabulary = None

    def __init__(self, version: str = "1", empty: bool = False) -> None:
        self.version, self.empty, self.runs = version, empty, 0

    def fingerprint(self) -> str:
        return self.version

    def detect(self, frame: Frame, labels: Sequence[str] | None) -> Proposals:
        self.runs += 1
        if self.empty:
            return no_proposals(frame.height, frame.width)
        names = tuple(labels or ("all",))
        n = len(names)
        masks = np.zeros((n, frame.height, frame.width), bool)
        masks[:, 10:60, 20 : 20 + self.runs * 10] = True
        boxes = np.tile(np.array([20, 10, 50, 60], np.float32), (n, 1))
        return Proposals(boxes, np.full(n, 0.5, np.float32), np.arange(n), names, masks, np.arange(n))


def equal(a: Proposals, b: Proposals) -> bool:
    same = all(np.array_equal(getattr(a, k), getattr(b, k)) for k in ("boxes", "scores", "label_index", "ids"))
    if a.masks is None or b.masks is None:
        return same and a.masks is b.masks and a.labels == b.labels
    return same and np.array_equal(a.masks, b.masks) and a.labels == b.labels


def cached(detector: Counting, folder: Path) -> CachedDetector:
    return CachedDetector(detector, folder)


@pytest.mark.parametrize("empty", [False, True])
def test_a_second_run_is_not_needed(tmp_path: Path, frame: Frame, empty: bool) -> None:
    counting = Counting(empty=empty)
    detector = cached(counting, tmp_path)
    first = detector.detect(frame, ["mug", "cup"])
    assert equal(detector.detect(frame, ["mug", "cup"]), first)
    assert counting.runs == 1
    # From the disk, by a process that never ran the detector.
    later = Counting(empty=empty)
    assert equal(cached(later, tmp_path).detect(replace(frame, id="another name"), ["mug", "cup"]), first)
    assert later.runs == 0
    assert first.masks is not None
    assert first.masks.dtype == np.bool_


def test_the_key_is_the_content(tmp_path: Path, frame: Frame) -> None:
    detector = cached(Counting(), tmp_path)
    rgb = frame.rgb.copy()
    rgb[0, 0, 0] ^= 1
    keys = [
        detector.key(frame, ["mug"]),
        detector.key(frame, ["cup"]),
        detector.key(frame, ["mug", "cup"]),
        detector.key(frame, None),
        detector.key(replace(frame, rgb=rgb), ["mug"]),
        cached(Counting("2"), tmp_path).key(frame, ["mug"]),
    ]
    assert len(set(keys)) == len(keys)
    assert detector.key(replace(frame, id="x", depth=frame.depth * 2), ["mug"]) == keys[0]


@pytest.mark.parametrize("seed", range(30))
def test_a_damaged_cache_file_is_a_miss(tmp_path: Path, frame: Frame, seed: int) -> None:
    rng = np.random.default_rng(seed)
    first = cached(Counting(), tmp_path).detect(frame, ["mug"])
    (path,) = (tmp_path / "proposals").glob("*.npz")
    content = bytearray(path.read_bytes())
    if seed == 0:
        content.clear()
    elif seed < 4:
        del content[int(rng.integers(1, len(content))) :]
    else:
        at = int(rng.integers(0, len(content) - 8))
        content[at : at + 8] = rng.integers(0, 256, 8).astype(np.uint8).tobytes()
    path.write_bytes(bytes(content))
    counting = Counting()
    found = cached(counting, tmp_path).detect(frame, ["mug"])
    if counting.runs == 0:  # The damage hit a byte that nothing reads.
        assert equal(found, first)
    # It is mended: the next process reads it.
    again = Counting()
    assert equal(cached(again, tmp_path).detect(frame, ["mug"]), found)
    assert again.runs == 0


def test_a_folder_that_cannot_be_written_only_means_that_nothing_is_kept(tmp_path: Path, frame: Frame) -> None:
    (tmp_path / "file").write_text("")
    for empty in (False, True):
        counting = Counting(empty=empty)
        detector = cached(counting, tmp_path / "file")
        first = detector.detect(frame, ["mug"])
        assert equal(detector.detect(frame, ["mug"]), first)
        assert counting.runs == 1, "it is still kept in memory"


def test_nothing_half_written_is_left(tmp_path: Path, frame: Frame, monkeypatch: pytest.MonkeyPatch) -> None:
    def full_disk(*_: Any, **__: Any) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(np, "savez_compressed", full_disk)
    cached(Counting(), tmp_path).detect(frame, ["mug"])
    assert not list((tmp_path / "proposals").iterdir())


def test_the_cache_lies_where_the_environment_says(tmp_path: Path, frame: Frame) -> None:
    CachedDetector(Counting()).detect(frame, ["mug"])
    assert list((Path(os.environ["SPATIALVIZ_CACHE"]) / "proposals").glob("*.npz"))


# A real network.


@pytest.fixture(scope="module")
def yolo_file(shared_data: Path) -> Path:
    return shared_data / "onnx" / "yolov8n_seg_480x640.onnx"


@pytest.fixture(scope="module")
def yolo(yolo_file: Path) -> Detector:
    from pipeline.proposals.yolo_seg import YoloSegDetector

    return YoloSegDetector(yolo_file)


@pytest.fixture(scope="module")
def dining(shared_data: Path) -> list[Frame]:
    dataset = open_dataset(
        shared_data / "real" / "slambook-diningroom", intrinsics=(518, 519, 325.5, 253.5), depth_scale=1000
    )
    return [dataset.load(f) for f in dataset.frame_ids]


@pytest.fixture(scope="module")
def kitchen(shared_data: Path) -> list[Frame]:
    dataset = open_dataset(shared_data / "real" / "7scenes-redkitchen")
    return [dataset.load(f) for f in dataset.frame_ids[3:9]]


def names_in(found: Proposals) -> list[str]:
    return [found.label(i) for i in range(len(found))]


def test_the_network_finds_what_is_there(yolo: Detector, dining: list[Frame], kitchen: list[Frame]) -> None:
    for frame in dining:
        found = names_in(yolo.detect(frame, ["chair", "dining table"]))
        assert found.count("chair") >= 2
        assert "dining table" in found
    for frame in kitchen:
        assert "cup" in names_in(yolo.detect(frame, ["cup"]))
        assert "chair" in names_in(yolo.detect(frame, ["chairs"]))
        assert len(yolo.detect(frame, ["zebra"])) == 0


def test_masks_lie_in_their_boxes_and_scores_fall(yolo: Detector, dining: list[Frame], kitchen: list[Frame]) -> None:
    for frame in (*dining, *kitchen):
        found = yolo.detect(frame, None)
        assert found.masks is not None
        assert found.masks.shape[1:] == frame.depth.shape
        assert (np.diff(found.scores) <= 0).all()
        assert (found.scores >= 0.15).all()
        overlap = iou_2d(found.boxes, found.boxes)
        assert (overlap[~np.eye(len(found), dtype=bool)] <= 0.5).all()
        own = []
        for box, mask in zip(found.boxes, found.masks, strict=True):
            v, u = np.nonzero(mask)
            x0, y0, x1, y1 = np.floor(box[0]), np.floor(box[1]), np.ceil(box[2]), np.ceil(box[3])
            assert x0 <= u.min() <= u.max() < x1
            assert y0 <= v.min() <= v.max() < y1
            own.append(iou_2d(box, np.array([u.min(), v.min(), u.max() + 1, v.max() + 1]))[0, 0])
        assert min(own) > 0.2
        assert np.median(own) > 0.85


def test_a_detection_is_the_same_whatever_is_asked(yolo: Detector, kitchen: list[Frame]) -> None:
    frame = kitchen[0]
    both, chairs = yolo.detect(frame, ["chair", "cup"]), yolo.detect(frame, ["chair"])
    for k, number in enumerate(chairs.ids):
        at = np.flatnonzero(both.ids == number)
        assert len(at) == 1
        assert both.scores[at[0]] == chairs.scores[k]
        np.testing.assert_array_equal(both.boxes[at[0]], chairs.boxes[k])
    again = yolo.detect(frame, ["chair"])
    assert equal(again, chairs)


@pytest.mark.parametrize(("down", "across"), [(160, 0), (0, 320), (200, 100)])
def test_a_moved_picture_moves_the_detections(yolo: Detector, kitchen: list[Frame], down: int, across: int) -> None:
    """A picture of another shape goes through the letterbox and its masks come back in place."""
    frame = kitchen[0]
    h, w = 480 + down, 640 + across
    rgb = np.full((h, w, 3), 114, np.uint8)
    rgb[down:, across:] = frame.rgb
    wider = Frame("wider", rgb, np.ones((h, w), np.float32), replace(frame.camera, height=h, width=w))
    moved, here = yolo.detect(wider, ["tv", "chair"]), yolo.detect(frame, ["tv", "chair"])
    assert here.masks is not None
    assert moved.masks is not None
    for k in range(2):
        overlap = iou_2d(here.boxes[k] + [across, down] * 2, moved.boxes)[0]
        best = int(overlap.argmax())
        assert overlap[best] > 0.8
        mask = moved.masks[best][down:, across:]
        assert (here.masks[k] & mask).sum() / (here.masks[k] | mask).sum() > 0.75


def test_an_unknown_name_is_refused_with_what_is_near(yolo: Detector, kitchen: list[Frame]) -> None:
    with pytest.raises(InputError, match=r"does not know the class 'chiar'.*'chair'"):
        yolo.detect(kitchen[0], ["chiar"])


def test_what_a_cached_result_depends_on_is_in_the_fingerprint(yolo_file: Path) -> None:
    from pipeline.proposals.yolo_seg import YoloSegDetector

    other = default_synonyms().extended([["puff", "chair"]])
    made = [
        YoloSegDetector(yolo_file),
        YoloSegDetector(yolo_file, min_score=0.3),
        YoloSegDetector(yolo_file, synonyms=other),
    ]
    assert len({d.fingerprint() for d in made}) == 3
    assert YoloSegDetector(yolo_file).fingerprint() == made[0].fingerprint()
    assert YoloSegDetector(yolo_file, synonyms=Synonyms.load()).fingerprint() == made[0].fingerprint()
    assert isinstance(make_detector("yolo-seg", model=yolo_file), CachedDetector)


@pytest.mark.parametrize(
    "name", ["picodet_s_416_coco.onnx", "gdino_stub.onnx", "sam_encoder_nchw_stub.onnx", "sam_decoder_stub.onnx"]
)
def test_a_model_of_another_contract_is_refused(shared_data: Path, name: str) -> None:
    with pytest.raises(InputError, match="not a yolo-seg model") as caught:
        make_detector("yolo-seg", model=shared_data / "onnx" / name)
    assert "\n" not in str(caught.value)
    assert name in str(caught.value)


@pytest.mark.parametrize("content", [None, b"", b"this is no model", b"\x08\x07" * 100])
def test_a_file_that_is_no_model_is_refused(tmp_path: Path, content: bytes | None) -> None:
    path = tmp_path / "model.onnx"
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(InputError, match=r"model\.onnx") as caught:
        make_detector("yolo-seg", model=path)
    assert "\n" not in str(caught.value)
