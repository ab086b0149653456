"""What tests of readers share: a refusal's words, and a JSON file edited."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from pipeline.system import InputError

MODELS = {
    "1": {"name": "mug", "min_x": -40, "min_y": -30, "min_z": 0, "size_x": 80, "size_y": 70, "size_z": 90},
    "2": {"name": "laptop"},
}
FOLDER = {"intrinsics": (60.0, 61.0, 31.5, 23.5), "depth_scale": 1000.0}


def refused(action: Callable[[], object], *words: str) -> str:
    """The message of the InputError, which must be one line and hold every word."""
    with pytest.raises(InputError) as caught:
        action()
    message = str(caught.value)
    assert "\n" not in message
    for word in words:
        assert word in message, message
    return message
