"""Poses of a recording's views, one after the other: agreement with earlier views, and refinement where it is asked
for."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import replace

import numpy as np

from pipeline.datasets.base import Dataset, load_picture, load_pose
from pipeline.scenes.poses import (
    ALL_PAIRS,
    LEAST_AGREE,
    NEAR,
    PoseAgreement,
    Refinement,
    agreement,
    fits,
    misfits,
    partners,
    refine,
    typical_fits,
)
from pipeline.scenes.views import PosedView
from pipeline.system.errors import FrameUnusable, needed
from pipeline.system.recent import Recent


class SceneViews:
    """Views of a scene under the poses that are used, of which a few are held."""

    def __init__(self, dataset: Dataset, refined: bool = False) -> None:
        self.dataset, self.refined = dataset, refined
        self.declared: dict[str, np.ndarray] = {}
        self.poses: dict[str, np.ndarray] = {}
        self.agreements: list[PoseAgreement] = []
        self.refinements: list[Refinement] = []
        self._views: Recent[tuple[str, bytes], PosedView] = Recent(ALL_PAIRS)

    def view(self, frame_id: str) -> PosedView:
        """View of a frame under the pose that is used; InputError for a broken frame."""
        pose = self.poses[frame_id]
        return self._views.get(
            (frame_id, pose.tobytes()), lambda: PosedView.of(load_picture(self.dataset, frame_id), pose)
        )

    def add(self, frame_id: str) -> None:
        """Compare the next frame with earlier ones, and refine its pose; InputError for a broken frame."""
        earlier = list(self.poses)
        pose = needed(load_pose(self.dataset, frame_id), f"frame {frame_id} has no pose", error=FrameUnusable)
        view = PosedView.of(load_picture(self.dataset, frame_id), pose)
        self._hold(view)
        self.declared[frame_id] = view.T_world_camera
        others = [self.view(earlier[i]) for i in partners([*self.poses.values()], len(earlier))]
        found = [agreement(other, view) for other in others]
        if self.refined and (better := self._refined(view, found)) is not None:
            self.refinements.append(better)
            if better.used:
                self._hold(view.moved(np.array(better.pose)))
                found = [agreement(other, self.view(frame_id)) for other in others]
        self.agreements.extend(found)

    def _hold(self, view: PosedView) -> None:
        self.poses[view.frame_id] = view.T_world_camera
        self._views.get((view.frame_id, view.T_world_camera.tobytes()), lambda: view)

    def _refined(self, view: PosedView, found: Sequence[PoseAgreement]) -> Refinement | None:
        shared = [pair for pair in found if pair.agree is not None]
        most = sorted(shared, key=lambda pair: (-pair.shared, pair.one))[:NEAR]
        made = refine(view, [self.view(pair.one) for pair in most]) if most else None
        return None if made is None else replace(made, used=made.better)

    def refinement(self, frame_id: str, others: Collection[str]) -> Refinement | None:
        """Refinement of a frame's pose against the views, of these, that share most with it; nothing is used."""
        pairs = [p for p in self.agreements if frame_id in (p.one, p.other) and p.agree is not None]
        pairs = [replace(p, one=p.other, other=p.one) if p.one == frame_id else p for p in pairs]
        made = self._refined(self.view(frame_id), [p for p in pairs if p.one in others])
        return None if made is None else replace(made, used=False)


def bad_poses(agreements: Sequence[PoseAgreement]) -> dict[str, str]:
    """Reasons, by frame, to leave out the frames whose pose does not fit the others."""
    reasons: dict[str, str] = {}
    for most, judged, least in (
        ("mostly", typical_fits(agreements), 0.0),
        ("at best", fits(agreements), LEAST_AGREE),
    ):
        usual = misfits(list(judged.values()), least)
        for i, agree in judged.items():
            if agree < usual:
                what = f"{most} {agree:.2f} of what another frame sees too agrees, usual is {usual:.2f} and more"
                reasons[i] = f"its pose does not fit: {what}"
    return reasons
