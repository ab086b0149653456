"""What tests of Semantic Abstraction views share."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
from semantic_abstraction_writer import ViewTruth, write_view

from pipeline.datasets import open_dataset
from pipeline.geometry import Frame
from pipeline.system import InputError

VIEW = "00007|FloorPlan201_physics"


def refused(action: Callable[[], object], *words: str) -> None:
    with pytest.raises(InputError) as caught:
        action()
    message = str(caught.value)
    assert "\n" not in message
    for word in words:
        assert word in message, message


def pose(frame: Frame) -> np.ndarray:
    assert frame.camera.T_world_camera is not None
    return frame.camera.T_world_camera


@contextlib.contextmanager
def editing(path: Path) -> Iterator[Any]:
    """A file that a test changes; h5py's own types leave open what an entry is."""
    with h5py.File(path, "a") as file:
        yield file


@pytest.fixture
def view(tmp_path: Path) -> tuple[Path, ViewTruth]:
    path = tmp_path / f"{VIEW}.hdf5"
    return path, write_view(path)


# Hostile files


def changed(path: Path, change: Callable[[Any], None]) -> Any:
    with editing(path) as file:
        change(file)
    return open_dataset(path.parent)
