"""Moves of a robot, in a scan in the format of the Active Vision Dataset, against the poses of its images."""

from __future__ import annotations

from pathlib import Path

import pytest
from avd_writer import write_scan

from pipeline.datasets import open_dataset
from pipeline.scenes.move_check import RobotMove, robot_moves


@pytest.mark.parametrize("world", ["y-down", "y-up"])
def test_turns_and_steps_are_what_the_poses_say(tmp_path: Path, world: str) -> None:
    write_scan(tmp_path, world=world)
    dataset = open_dataset(tmp_path)
    found = robot_moves(dataset, dataset.frame_ids)
    assert {m.move for m in found} == {"rotate_ccw", "rotate_cw", "forward", "backward"}
    assert all(m.agrees for m in found), [m.record() for m in found if not m.agrees]
    turns = [abs(m.turned_deg) for m in found if m.move.startswith("rotate")]
    assert turns == pytest.approx([30.0] * len(turns), abs=0.5)
    assert [m.moved_m[1] for m in found if m.move == "forward"] == pytest.approx([0.3], abs=0.01)


@pytest.mark.parametrize(
    ("move", "turned", "moved"),
    [
        ("rotate_cw", -30.0, (0.0, 0.0)),
        ("rotate_ccw", 30.0, (0.0, 0.0)),
        ("rotate_cw", 2.0, (0.0, 0.0)),
        ("rotate_cw", 30.0, (0.5, 0.0)),
        ("forward", 0.0, (0.0, -0.3)),
        ("forward", 90.0, (0.0, 0.3)),
        ("left", 0.0, (0.3, 0.0)),
        ("backward", 0.0, (0.0, -0.01)),
    ],
)
def test_a_wrong_pose_contradicts_its_move(move: str, turned: float, moved: tuple[float, float]) -> None:
    assert not RobotMove("a", move, "b", turned, moved).agrees
