"""Moves of a robot between frames against the camera poses: what it sees after a turn is seen from there."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np

from pipeline.datasets.base import Dataset, load_pose, moves
from pipeline.system.frozen import dataclass

TURN_DEG, STAND_M = (10.0, 60.0), 0.25
"""A turn is by so many degrees (a robot of the Active Vision Dataset turns by 30), on the spot but for so many
metres: a camera is not above the wheels' middle."""
STEP_M, STRAY_DEG = 0.05, 45.0
"""A step is at least so long, in its direction within so many degrees, and turns the camera by no more."""
DIRECTIONS = {"forward": (0, 1), "backward": (0, -1), "right": (1, 0), "left": (-1, 0)}
"""Along x (right) and z (forward) of the camera."""


@dataclass(frozen=True)
class RobotMove:
    """A move from one frame to another, and what the two poses say of it."""

    frame: str
    move: str  # One of `datasets.base.MOVES`
    other: str
    turned_deg: float  # To the right
    moved_m: tuple[float, float]  # To the right and forward

    @property
    def agrees(self) -> bool:
        """Tell whether the poses do what the move says."""
        distance = float(np.hypot(*self.moved_m))
        if self.move in DIRECTIONS:
            along = float(np.dot(self.moved_m, DIRECTIONS[self.move]))
            return (
                distance >= STEP_M
                and along >= distance * np.cos(np.deg2rad(STRAY_DEG))
                and abs(self.turned_deg) <= STRAY_DEG
            )
        turned = self.turned_deg if self.move == "rotate_cw" else -self.turned_deg
        return TURN_DEG[0] <= turned <= TURN_DEG[1] and distance <= STAND_M

    def record(self) -> dict[str, Any]:
        """JSON of `map --json`."""
        return {
            "frame": self.frame,
            "move": self.move,
            "to": self.other,
            "turned_deg": round(self.turned_deg, 2),
            "moved_m": [round(m, 4) for m in self.moved_m],
            "agrees": self.agrees,
        }


def robot_moves(dataset: Dataset, frame_ids: Iterable[str]) -> tuple[RobotMove, ...]:
    """Compare the moves between posed frames with their poses; none where the dataset has no moves.

    >>> from pipeline.datasets import demo_path, open_dataset
    >>> from pipeline.scenes.move_check import robot_moves
    >>> robot_moves(open_dataset(demo_path()), ("000001/000000",))
    ()
    """
    ids = tuple(frame_ids)
    pairs = [(i, move, other) for i in ids for move, other in moves(dataset, i).items() if other in ids]
    poses = {i: load_pose(dataset, i) for i in dict.fromkeys(i for pair in pairs for i in pair[::2])}
    found = []
    for frame, move, other in pairs:
        one, two = poses[frame], poses[other]
        if one is not None and two is not None:
            between = np.linalg.inv(one) @ two
            turned = float(np.rad2deg(np.arctan2(between[0, 2], between[2, 2])))
            found.append(RobotMove(frame, move, other, turned, (float(between[0, 3]), float(between[2, 3]))))
    return tuple(found)
