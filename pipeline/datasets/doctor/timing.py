"""Whether the poses of a sequence are those of its frames, or of frames some places earlier or later."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from pipeline.datasets.base import Dataset, load_pose, scene_of
from pipeline.datasets.cameras import or_note
from pipeline.datasets.doctor.hypotheses import Hypothesis, by_block, surely_positive
from pipeline.datasets.doctor.opinions import Opinion
from pipeline.datasets.doctor.search import FINE
from pipeline.datasets.settings import FILE_NAME
from pipeline.geometry.frame import Frame
from pipeline.geometry.landing import Views, detail_of
from pipeline.geometry.pose_convention import standard_poses
from pipeline.language.counted import counted

SHIFTS = (-1, 1, -2, 2, -4, 4, -8, 8)
FARTHEST = 12
MOST_FRAMES, LEAST_FRAMES = 6, 3
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
    index = {frame_id: k for k, frame_id in enumerate(ids)}
    if len(used) < LEAST_FRAMES:
        return Opinion("time", "unknown", "no three frames of a scene have poses")
    pairs = np.array([(a, b) for a in range(len(used)) for b in range(len(used)) if a != b])
    views = Views.of([f.depth for f in used], [f.camera for f in used], pairs, GRID)
    views = replace(views, detail=np.stack([detail_of(f.rgb) for f in used]))
    known: dict[str, np.ndarray | None] = {}

    def lead_of(shift: int) -> np.ndarray | None:
        there = {k: index[f.id] + shift for k, f in enumerate(used) if 0 <= index[f.id] + shift < len(ids)}
        for frame_id in (ids[n] for n in there.values()):
            if frame_id not in known:
                pose = or_note([], "", load_pose, dataset, frame_id)
                known[frame_id] = None if pose is None else standard_poses(pose, poses)
        return _lead(views, {k: pose for k, n in there.items() if (pose := known[ids[n]]) is not None})

    leads = {shift: lead for shift in SHIFTS if (lead := lead_of(shift)) is not None}
    better = {shift: float(lead.mean()) for shift, lead in leads.items() if surely_positive(lead)}
    worse = [abs(shift) for shift, lead in leads.items() if surely_positive(-lead)]
    near: dict[int, np.ndarray] = leads
    while better and near:
        # Beside the best of the places that were tried another may be better still.
        best = max(better, key=lambda shift: better[shift])
        beside = [shift for shift in (best - 1, best + 1) if shift not in leads and 0 < abs(shift) <= FARTHEST]
        near = {shift: lead for shift in beside if (lead := lead_of(shift)) is not None}
        leads |= near
        better |= {shift: float(lead.mean()) for shift, lead in near.items()}
    if better:
        gain, shift = max((gain, shift) for shift, gain in better.items())
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


def _lead(views: Views, poses: dict[int, np.ndarray]) -> np.ndarray | None:
    """By how much more lands, block by block, with these poses in place of the views' own; None where they are few."""
    if len(poses) < LEAST_FRAMES:
        return None
    others = views.poses.copy()
    others[list(poses)] = list(poses.values())
    own = views.of_pairs(views.pairs[np.isin(views.pairs, list(poses)).all(axis=1)])
    landed = [by_block(Hypothesis().landing(v, FINE, colour=True)) for v in (replace(own, poses=others), own)]
    return landed[0] - landed[1]
