"""Poses that a settings file moves along the frames: each frame takes that of the one so many places on."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from dataset_writers import write_folder
from reader_checks import FOLDER

from pipeline.datasets import open_dataset


@pytest.mark.parametrize("shift", [-1, 2])
def test_a_frame_takes_the_pose_of_the_one_so_many_places_on(tmp_path: Path, shift: int) -> None:
    written = write_folder(tmp_path, [0, 1, 2, 3])
    (tmp_path / "spatialviz.toml").write_text(f"pose_shift = {shift}\n")
    dataset = open_dataset(tmp_path, **FOLDER)
    for place, frame_id in enumerate(dataset.frame_ids):
        frame = dataset.load(frame_id)
        if not 0 <= place + shift < len(written):
            assert frame.camera.T_world_camera is None
            assert f"no frame {shift:+d} places on" in frame.notes[-1]
            continue
        pose = frame.camera.T_world_camera
        assert pose is not None
        np.testing.assert_allclose(pose, written[place + shift].T_world_camera, atol=1e-6)
