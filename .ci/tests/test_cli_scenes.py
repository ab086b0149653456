"""Maps of scenes from the command line."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
from command_line import spatialviz


def test_a_scene_is_mapped_and_the_map_is_gone_on_from(tmp_path: Path) -> None:
    told = spatialviz(0, "map", "demo", "000001/000002", "--out", tmp_path).out
    assert "scene 000001  3 frames" in told
    assert "laptop" in told
    made = (tmp_path / "000001.npz").read_bytes()
    record = spatialviz(0, "map", "demo", 0, "--out", tmp_path, "--json").record
    assert record["frames"] == ["000001/000000", "000001/000001", "000001/000002"]
    assert {o["state"] for o in record["objects"]} == {"static"}
    assert (tmp_path / "000001.npz").read_bytes() == made
    refined = spatialviz(0, "map", "demo", 0, "--out", tmp_path, "--refine")
    assert "made anew" in refined.err
    assert "refined, it moves" in refined.out


def test_without_poses_a_line_says_what_is_needed(tmp_path: Path) -> None:
    for k in range(2):
        cv2.imwrite(str(tmp_path / f"{k}.png"), np.full((48, 64, 3), 90, np.uint8))
        cv2.imwrite(str(tmp_path / f"{k}_depth.png"), np.full((48, 64), 1500, np.uint16))
    camera = ("--intrinsics", "60,60,31.5,23.5,1000")
    error = spatialviz(2, "map", tmp_path, "--out", tmp_path / "maps", *camera).err
    assert "camera poses" in error
    assert not (tmp_path / "maps").exists()
