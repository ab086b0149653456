"""A scan of a phone that is not there to the end is told of in one line, and never ends in an error of the program."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from pipeline.datasets import open_dataset
from pipeline.datasets.phones import COLOR, DEPTH, TRAJECTORY
from pipeline.system import InputError


@pytest.fixture
def scan(tmp_path: Path) -> Path:
    for name in (COLOR, DEPTH):
        (tmp_path / name).mkdir()
    return tmp_path


def picture(path: Path, depth: bool) -> None:
    cv2.imwrite(str(path), np.full((4, 6), 1000, np.uint16) if depth else np.zeros((4, 6, 3), np.uint8))


def test_without_a_picture(scan: Path) -> None:
    with pytest.raises(InputError, match="neither a colour picture nor depth"):
        open_dataset(scan, browse=True)


def test_without_colour(scan: Path) -> None:
    picture(scan / DEPTH / "1_1.000.png", True)
    with pytest.raises(InputError, match=r"do not pair.*got no picture and 1_1.000"):
        open_dataset(scan, browse=True)


def test_names_without_a_time(scan: Path) -> None:
    picture(scan / COLOR / "x.png", False)
    picture(scan / DEPTH / "x.png", True)
    dataset = open_dataset(scan, browse=True)
    with pytest.raises(InputError, match="the name of a frame has no time"):
        dataset.load(dataset.frame_ids[0])


def test_a_trajectory_of_remarks(scan: Path) -> None:
    picture(scan / COLOR / "1_1.000.png", False)
    picture(scan / DEPTH / "1_1.000.png", True)
    (scan / TRAJECTORY).write_text("# nothing yet\n")
    dataset = open_dataset(scan, browse=True)
    assert dataset.load(dataset.frame_ids[0]).camera.T_world_camera is None
