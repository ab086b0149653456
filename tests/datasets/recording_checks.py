"""What tests of recordings share."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from pipeline.geometry.frame import Frame
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
