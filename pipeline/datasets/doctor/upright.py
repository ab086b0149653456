"""Declared up against level planes of the frames."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence

import numpy as np

from pipeline.datasets.doctor.seen import Seen
from pipeline.datasets.doctor.trying import Agreement, Opinion
from pipeline.datasets.up import Voter, vote
from pipeline.geometry.level_plane import decided, up_hypotheses

AXIS_DEG = 6.0
"""A world whose axis is no farther off the vote has that axis up."""
WRONG_DEG = 20.0
LEAST_GAIN = 0.1
"""A mend must bring the declared up so much nearer to the level planes of each frame, 1 being on them."""
AXES = {f"{sign}{name}": np.eye(3)[k] * (1 if sign == "+" else -1) for k, name in enumerate("xyz") for sign in "+-"}


class OfLevel:
    """Level-plane test of the declared up."""

    def opinions(self, seen: Seen, known: Sequence[Opinion]) -> list[Opinion]:
        return [_opinion(seen, known)]

    def measured(self, seen: Seen, mended: Seen) -> tuple[Agreement, ...]:
        return (Agreement(1 - _off(seen) / 180, 1 - _off(mended) / 180, LEAST_GAIN),)


def _opinion(seen: Seen, known: Sequence[Opinion]) -> Opinion:
    agreed, axis = _agreed(seen)
    if all(frame.camera.up is None for frame in seen.frames):
        return Opinion("up", "unknown" if agreed is None else "fine", agreed or "nothing declares it or shows it")
    offs = _off(seen)
    offs = offs[np.isfinite(offs)]
    if len(offs) < min(2, len(seen.frames)):
        return Opinion("up", "unknown", f"{len(offs)} of {len(seen.frames)} frames show a level plane that could tell")
    off = float(np.median(offs))
    text = f"the up that is declared is {off:.0f} degrees off the level planes of {len(offs)} frames"
    evidence = {"degrees": round(off, 1), "frames": float(len(offs))}
    if off <= WRONG_DEG:
        return Opinion("up", "fine", text, evidence=evidence)
    trusted = any(o.about == "poses" and (o.state == "fine" or o.mend) for o in known)
    if seen.world_up and not trusted:
        return Opinion("up", "unknown", f"{text}; nothing shows that the poses hold, which carry it", evidence=evidence)
    if axis is None:
        return Opinion("up", "unknown", f"{text}; --up X,Y,Z or --level-at U,V tells another", evidence=evidence)
    return Opinion("up", "wrong", f"{text}; {agreed}", {"up": axis}, f"--up {axis}", evidence)


def _off(seen: Seen) -> np.ndarray:
    """Angles (F,) in degrees between declared up and level planes, NaN where unknown."""
    found = np.full(len(seen.frames), np.nan)
    for k, frame in enumerate(seen.frames):
        own = None if frame.camera.up is None else decided(up_hypotheses(frame.depth, frame.camera))
        if own is not None and frame.camera.up is not None:
            found[k] = _degrees(own.up, frame.camera.up)
    return found


def _agreed(seen: Seen) -> tuple[str | None, str | None]:
    """Agreed up of each scene's posed frames, in words, and "world:X,Y,Z" for a common axis."""
    scenes: defaultdict[str, list[Voter]] = defaultdict(list)
    for frame, scene in zip(seen.frames, seen.scenes, strict=True):
        pose = frame.camera.T_world_camera
        if pose is not None:
            scenes[scene].append((frame.id, pose[:3, :3], up_hypotheses(frame.depth, frame.camera)))
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
