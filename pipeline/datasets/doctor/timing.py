"""Whether the poses of a sequence are those of its frames, or of frames some places earlier or later."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from pipeline.datasets.base import Dataset, load_picture, scene_of
from pipeline.datasets.doctor.hypotheses import Hypothesis, by_block, surely_positive
from pipeline.datasets.doctor.opinions import Opinion
from pipeline.datasets.doctor.search import FINE
from pipeline.datasets.settings import FILE_NAME
from pipeline.geometry.frame import Frame
from pipeline.geometry.landing import Views, detail_of
from pipeline.geometry.pose_convention import standard_poses
from pipeline.language.counted import counted
from pipeline.system.errors import InputError

SHIFTS = (-1, 1, -2, 2, -4, 4, -8, 8)
MOST_FRAMES, LEAST_FRAMES = 6, 3
MOST_SECONDS = 3.0
"""Poses of further frames are read for no longer than this."""
GRID = (20, 26)


def time_opinion(dataset: Dataset, frames: Sequence[Frame], poses: str, shifted: int = 0) -> Opinion:
    """What is thought of the time of the poses: those of the frames' neighbours land better, or they do not.

    Parameters
    ----------
    frames : sequence of Frame
        Of one size, as they are once what is wrong is mended.
    poses : str
        The convention of the poses as the dataset reads them, one of `CONVENTIONS`.
    shifted : int
        By how many places they are shifted already.
    """
    scene, used = _of_one_scene(dataset, frames)
    ids = [frame_id for frame_id in dataset.frame_ids if scene_of(dataset, frame_id) == scene]
    place = {frame_id: k for k, frame_id in enumerate(ids)}
    if len(used) < LEAST_FRAMES:
        return Opinion("time", "unknown", "no three frames of a scene have poses")
    pairs = np.array([(a, b) for a in range(len(used)) for b in range(len(used)) if a != b])
    views = Views.of([f.depth for f in used], [f.camera for f in used], pairs, GRID)
    views = replace(views, detail=np.stack([detail_of(f.rgb) for f in used]))
    started = time.perf_counter()
    worse: list[int] = []
    better: list[tuple[float, int]] = []
    for shift in SHIFTS:
        there = {k: place[f.id] + shift for k, f in enumerate(used) if 0 <= place[f.id] + shift < len(ids)}
        if time.perf_counter() - started > MOST_SECONDS:
            break
        lead = _lead(dataset, views, {k: ids[n] for k, n in there.items()}, poses)
        if lead is None:
            continue
        if surely_positive(lead):
            better.append((float(lead.mean()), shift))
        elif surely_positive(-lead):
            worse.append(abs(shift))
    if better:
        gain, shift = max(better)
        when = f"{counted(abs(shift), 'place')} {'later' if shift > 0 else 'earlier'}"
        text = f"with the poses of frames {when}, {gain:.0%} more of the points land"
        mend = {"pose_shift": shift + shifted}
        option = f"pose_shift = {shift + shifted} in {FILE_NAME}"
        return Opinion("time", "wrong", text, mend, option, {"shift": float(shift), "gain": round(gain, 4)})
    if not worse:
        return Opinion("time", "unknown", "too few frames, or too close together, to tell the poses of neighbours")
    text = f"the poses of frames {counted(min(worse), 'place')} earlier or later land worse"
    return Opinion("time", "fine", text, evidence={"told_from": float(min(worse))})


def _of_one_scene(dataset: Dataset, frames: Sequence[Frame]) -> tuple[str, list[Frame]]:
    """The scene that has most posed frames, and some of those, which stand next to each other among all."""
    scenes: dict[str, list[Frame]] = {}
    for frame in frames:
        if frame.camera.T_world_camera is not None:
            scenes.setdefault(scene_of(dataset, frame.id), []).append(frame)
    scene = max(scenes, key=lambda name: len(scenes[name]), default="")
    return scene, scenes.get(scene, [])[:MOST_FRAMES]


def _lead(dataset: Dataset, views: Views, shifted: dict[int, str], poses: str) -> np.ndarray | None:
    """By how much more lands, block by block, with poses of other frames; None where too few of them have one."""
    others = views.poses.copy()
    known = []
    for k, frame_id in shifted.items():
        try:
            pose = load_picture(dataset, frame_id).camera.T_world_camera
        except InputError:
            continue
        if pose is not None:
            others[k] = standard_poses(pose, poses)
            known.append(k)
    if len(known) < LEAST_FRAMES:
        return None
    own = views.of_pairs(views.pairs[np.isin(views.pairs, known).all(axis=1)])
    landed = [by_block(Hypothesis().landing(v, FINE, colour=True)) for v in (replace(own, poses=others), own)]
    return landed[0] - landed[1]
