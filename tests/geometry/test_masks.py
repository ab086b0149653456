"""Masks held by their crops, and the run-length code that is made of crops."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from pycocotools import mask as coco

from pipeline.geometry import decode_run_length, encode_run_length
from pipeline.geometry.fitting import MANY, extents_of
from pipeline.geometry.frame import Annotation
from pipeline.geometry.masks import MaskCrop, MaskStack, PictureMask, encode_crops


def some_masks(size: tuple[int, int], count: int, seed: int) -> list[np.ndarray]:
    """Empty, full, scattered and solid masks, some of which touch each border."""
    rng = np.random.default_rng(seed)
    found = [np.zeros(size, np.bool_), np.ones(size, np.bool_)]
    for _ in range(count - 2):
        mask = np.zeros(size, np.bool_)
        top, bottom = sorted(rng.integers(0, size[0] + 1, 2))
        left, right = sorted(rng.integers(0, size[1] + 1, 2))
        mask[top:bottom, left:right] = rng.random((bottom - top, right - left)) < rng.choice([0.3, 1.0])
        found.append(mask)
    return found


@pytest.mark.parametrize("size", [(1, 1), (1, 9), (9, 1), (7, 11), (40, 33)])
def test_run_lengths_are_those_of_the_coco_api(size: tuple[int, int]) -> None:
    masks = some_masks(size, 60, 3)
    codes = encode_crops(size, [MaskCrop.of(mask) for mask in masks])
    for mask, code in zip(masks, codes, strict=True):
        theirs = coco.encode(np.asfortranarray(mask.view(np.uint8)))["counts"]
        assert code == encode_run_length(mask) == theirs.decode()  # type: ignore[union-attr]
        np.testing.assert_array_equal(decode_run_length(size, code), mask)
    assert encode_crops(size, []) == []


def test_a_crop_may_be_wider_than_its_pixels() -> None:
    mask = cv2.resize(np.eye(6, dtype=np.uint8), (30, 24)) > 0
    assert encode_crops((24, 30), [MaskCrop(0, 0, mask)]) == [encode_run_length(mask)]


def test_a_stack_is_taken_as_an_array_of_all() -> None:
    size = (12, 17)
    masks = some_masks(size, 5, 4)
    stack = MaskStack(size, [PictureMask(size, MaskCrop.of(mask)) for mask in masks])
    whole = np.stack(masks)
    assert (stack.shape, stack.dtype, stack.ndim, len(stack)) == (whole.shape, whole.dtype, 3, 5)
    np.testing.assert_array_equal(stack, whole)
    np.testing.assert_array_equal(stack[3], whole[3])
    np.testing.assert_array_equal(list(stack), whole)
    assert stack.sum() == whole.sum()
    np.testing.assert_array_equal(stack.any(axis=(1, 2)), whole.any(axis=(1, 2)))
    np.testing.assert_array_equal(stack[:, 2:4], whole[:, 2:4])
    chosen = np.array([4, 0])
    np.testing.assert_array_equal(stack[chosen], whole[chosen])
    np.testing.assert_array_equal(stack[np.array([True, False, True, False, False])], whole[[0, 2]])
    assert stack[np.zeros(0, np.int64)].shape == (0, *size)


def test_a_mask_is_painted_when_it_is_looked_at() -> None:
    mask = np.zeros((12, 17), np.bool_)
    mask[3:7, 5:9] = True
    held = Annotation.of_mask(0, "mug", PictureMask((12, 17), MaskCrop.of(mask)))
    assert "mask" not in vars(held)
    assert held.mask_size == (12, 17)
    assert held.bbox.tolist() == [5, 3, 9, 7]
    assert held.mask is held.mask
    np.testing.assert_array_equal(held.mask, mask)  # type: ignore[arg-type]
    assert Annotation(1, "mug", np.zeros(4)).mask is None


@pytest.mark.parametrize("n", [1, 2, 99, MANY, 5 * MANY])
def test_percentiles_of_many_values_are_those_of_all(n: int) -> None:
    rng = np.random.default_rng(n)
    spread = rng.normal(size=n)
    # Those that fall, those that hardly differ, and one whose ends come at every eighth place.
    columns = [spread, np.sort(spread)[::-1], np.round(spread), np.where(np.arange(n) % 8, 0.0, spread)]
    points = np.stack(columns, axis=1)
    low, high = extents_of(points)
    np.testing.assert_allclose([low, high], np.percentile(points, [1, 99], axis=0), rtol=0, atol=1e-12)
