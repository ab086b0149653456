"""OPM: selection, the truth and recordings as detectors, the cache, and a real network."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from proposal_checks import SEEDS, _own_cache, equal, frame  # noqa: F401

from pipeline.geometry import Frame, iou_2d
from pipeline.geometry.picture_input import PictureInput, place_picture
from pipeline.proposals import (
    AnnotationDetector,
    CachedDetector,
    Detector,
    Proposals,
    box_mask,
    make_detector,
    no_proposals,
    suppress,
    top_k,
)
from pipeline.system import InputError


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
    tensor, place = place_picture(rgb, *inside, PictureInput(scale=1))
    image = tensor[0].transpose(1, 2, 0)
    assert image.shape == (*inside, 3)
    height, width = round(h * place.scale_y), round(w * place.scale_x)
    assert width == inside[1] or height == inside[0]
    border = np.ones(inside, bool)
    border[place.top : place.top + height, place.left : place.left + width] = False
    assert (image[border] == 114).all()
    assert abs(inside[0] - height - 2 * place.top) <= 1
    assert abs(inside[1] - width - 2 * place.left) <= 1
    boxes = np.sort(rng.uniform(0, 1, (20, 2, 2)), axis=1).reshape(20, 4) * [w, h, w, h]
    there = boxes * ([place.scale_x, place.scale_y] * 2) + [place.left, place.top] * 2
    np.testing.assert_allclose(place.to_picture(there), boxes, atol=0.01)
    if inside == size:
        np.testing.assert_array_equal(image, rgb)


def test_a_mark_keeps_its_place_in_the_letterbox() -> None:
    rgb = np.zeros((300, 500, 3), np.uint8)
    rgb[100:150, 200:260] = 255
    image, place = place_picture(rgb, 640, 640, PictureInput(scale=1))
    v, u = np.nonzero((image[0] > 200).all(axis=0))
    back = place.to_picture(np.array([[u.min(), v.min(), u.max() + 1, v.max() + 1]]))
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
