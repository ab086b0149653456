"""Pictures as bytes."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from pipeline.system import jpeg, png, resized, thumbnail
from pipeline.system.encoded_pictures import THUMB


def drawn(data: bytes) -> np.ndarray:
    found = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
    assert found is not None
    return found


DOWN, ACROSS = np.mgrid[0:255:90j, 0:255:120j]
RAMP = np.stack([DOWN, ACROSS, np.full_like(DOWN, 60)], axis=2)
RGB = RAMP.astype(np.uint8)


def test_a_png_gives_every_pixel_back_and_a_jpeg_nearly() -> None:
    depth = np.arange(90 * 120, dtype=np.uint16).reshape(90, 120)
    np.testing.assert_array_equal(drawn(png(depth, 6)), depth)
    assert np.abs(drawn(jpeg(RGB, 95))[..., ::-1].astype(int) - RGB).mean() < 3


@pytest.mark.parametrize(("width", "shape"), [(60, (45, 60)), (0.2, (1, 1)), (7, (5, 7))])
def test_a_smaller_picture_keeps_its_shape(width: float, shape: tuple[int, int]) -> None:
    assert resized(RGB, width).shape[:2] == shape


def test_a_thumbnail_is_square_around_its_object_and_empty_outside() -> None:
    assert drawn(thumbnail(RGB, np.array([40, 30, 60, 40]))).shape[:2] == (THUMB, THUMB)
    color = drawn(thumbnail(RGB, np.array([40, 30, 60, 40])))[THUMB // 2, THUMB // 2, ::-1]
    assert np.abs(color.astype(int) - RGB[35, 50]).max() < 12
    assert drawn(thumbnail(RGB, np.array([110, 80, 130, 100]))).shape[0] <= THUMB
    assert thumbnail(RGB, np.array([400, 300, 420, 320])) == b""
