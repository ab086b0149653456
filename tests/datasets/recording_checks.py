"""What tests of recordings share."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from dataset_writers import K, Truth, random_truth

from pipeline.geometry import Frame
from pipeline.system import InputError

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


def truths(count: int) -> list[Truth]:
    rng = np.random.default_rng(7)
    return [random_truth(rng) for _ in range(count)]


def check_frame(frame: Frame, truth: Truth, posed: bool = False, atol: float = 0.0) -> None:
    assert np.abs(frame.depth - truth.depth).max() <= atol
    np.testing.assert_allclose(frame.camera.K, K, atol=1e-6)
    pose = frame.camera.T_world_camera
    assert (pose is not None) == posed
    if pose is not None:
        np.testing.assert_allclose(pose, truth.T_world_camera, atol=1e-6)
