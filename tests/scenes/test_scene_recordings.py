"""Posed recordings of several formats: their frames are one scene, and their surfaces agree under their poses."""

from __future__ import annotations

from itertools import combinations
from pathlib import Path

import pytest

from pipeline.datasets import open_dataset
from pipeline.scenes.pose_fit import bad_poses
from pipeline.scenes.poses import agreement
from pipeline.scenes.views import posed_frames, views_of
from pipeline.system.errors import FrameUnusable

RECORDINGS = {
    "field/01-replica-niceslam/Replica/room0": (3, 0.91),
    "field/02-nerfstudio-windows-paths": (3, 0.91),
    "field/03-ngp-integer-depth-scale": (3, 0.91),
    "field/05-stray-scanner": (3, 0.85),
    "real/open3d-testdata": (5, 0.90),
    "real/ycb-video-layout": (2, 0.98),
    "real/ycbv-bop": (2, 0.97),
}
"""Frames of the first scene with a pose, and the least agreement of two of them."""


@pytest.mark.parametrize("name", RECORDINGS)
def test_the_frames_of_a_recording_agree(shared_data: Path, name: str) -> None:
    dataset = open_dataset(shared_data / name)
    ids = posed_frames(dataset, dataset.frame_ids[0])
    pairs = [agreement(*pair) for pair in combinations(list(views_of(dataset, ids)), 2)]
    found = [p.agree for p in pairs if p.agree is not None]
    assert (len(ids), min(found)) == (RECORDINGS[name][0], pytest.approx(RECORDINGS[name][1], abs=0.01))
    assert bad_poses(pairs) == {}


def test_frames_whose_poses_were_lost_are_told(shared_data: Path) -> None:
    dataset = open_dataset(shared_data / "field" / "11-scannet-inf-pose")
    with pytest.raises(FrameUnusable, match="1 of 3 frames with a pose"):
        posed_frames(dataset, dataset.frame_ids[0])
