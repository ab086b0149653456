"""Whether the up that a dataset declares is the one that level planes of its frames show."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence

import numpy as np

from pipeline.datasets.base import Dataset, scene_of
from pipeline.datasets.doctor.opinions import Opinion
from pipeline.datasets.up import Voter, vote
from pipeline.geometry.frame import Frame
from pipeline.geometry.level_plane import decided, up_hypotheses

AXIS_DEG = 6.0
"""A world whose axis is no farther off the vote has that axis up."""
WRONG_DEG = 20.0
AXES = {f"{sign}{name}": np.eye(3)[k] * (1 if sign == "+" else -1) for k, name in enumerate("xyz") for sign in "+-"}


def up_opinion(dataset: Dataset, frames: Sequence[Frame]) -> Opinion:
    """What is thought of up: the declared one against level planes, else what posed frames agree on."""
    offs = []
    for frame in frames:
        own = None if frame.camera.up is None else decided(up_hypotheses(frame.depth, frame.camera))
        if own is not None and frame.camera.up is not None:
            offs.append(_degrees(own.up, frame.camera.up))
    agreed, axis = _agreed(dataset, frames)
    if all(frame.camera.up is None for frame in frames):
        return Opinion("up", "unknown" if agreed is None else "fine", agreed or "nothing declares it or shows it")
    if len(offs) < min(2, len(frames)):
        return Opinion("up", "unknown", f"{len(offs)} of {len(frames)} frames show a level plane that could tell")
    off = float(np.median(offs))
    text = f"the up that is declared is {off:.0f} degrees off the level planes of {len(offs)} frames"
    evidence = {"degrees": round(off, 1), "frames": float(len(offs))}
    if off <= WRONG_DEG:
        return Opinion("up", "fine", text, evidence=evidence)
    if axis is None:
        return Opinion("up", "unknown", f"{text}; --up X,Y,Z or --level-at U,V tells another", evidence=evidence)
    return Opinion("up", "wrong", f"{text}; {agreed}", {"up": axis}, f"--up {axis}", evidence)


def _agreed(dataset: Dataset, frames: Sequence[Frame]) -> tuple[str | None, str | None]:
    """What the posed frames of each scene agree on, in words, and "world:X,Y,Z" where it is an axis of all worlds."""
    scenes: defaultdict[str, list[Voter]] = defaultdict(list)
    for frame in frames:
        pose = frame.camera.T_world_camera
        if pose is not None:
            found = up_hypotheses(frame.depth, frame.camera)
            scenes[scene_of(dataset, frame.id)].append((frame.id, pose[:3, :3], found))
    ups = [counted.up for scene, voters in scenes.items() if (counted := vote(scene, voters)).up is not None]
    if not ups:
        return None, None
    mean = np.mean(ups, axis=0)
    name, axis = min(AXES.items(), key=lambda item: _degrees(item[1], mean))
    if any(_degrees(axis, up) > AXIS_DEG for up in ups):
        return "the level planes of the frames agree on an up that is no axis of the world", None
    numbers = ",".join(f"{n:g}" for n in axis + 0.0)
    return f"the level planes of the frames say that up is the world's {name}", f"world:{numbers}"


def _degrees(a: np.ndarray, b: np.ndarray) -> float:
    return float(np.rad2deg(np.arccos(np.clip(a @ b / np.linalg.norm(a) / np.linalg.norm(b), -1, 1))))
