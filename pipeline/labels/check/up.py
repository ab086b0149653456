"""Rules on the up vector: that something says where up is, and that the posed frames of a scene agree."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from pipeline.datasets.up_text import ASSUMED
from pipeline.labels.check.findings import Finding
from pipeline.labels.check.view import FrameView

DISAGREE_DEG = 10.0
"""Ups of one scene that are further apart are not one: the doubtful band of a relation's cone is 10 degrees wide."""


class UpRules:
    """The frames of one scene are kept until the next begins, so that memory does not grow with scenes."""

    def __init__(self) -> None:
        self._scene: str | None = None
        self._ups: list[tuple[str | None, np.ndarray]] = []

    def add(self, view: FrameView) -> Iterator[Finding]:
        """What is to be said of a frame, and of the scene before where this one begins another."""
        frames = view.tables["frames"]
        if not view.usable or view.viewer is None:
            return
        if frames["scene"][0] != self._scene:
            yield from self.finish()
            self._scene = frames["scene"][0]
        if frames["up_source"][0] == "assumed":
            yield view.finding("frame/up-assumed", (), ASSUMED)
            return
        pose = frames["T_world_camera"][0].reshape(4, 4)
        if np.isfinite(pose).all():
            self._ups.append((view.id, pose[:3, :3] @ view.viewer.up))

    def finish(self) -> Iterator[Finding]:
        """The frames of the scene whose up is not that of most."""
        ups, self._ups = self._ups, []
        if len(ups) < 2:
            return
        vectors = np.array([up / max(np.linalg.norm(up), 1e-9) for _, up in ups])
        apart = np.degrees(np.arccos(np.clip(vectors @ vectors.T, -1, 1)))
        most = int((apart <= DISAGREE_DEG).sum(axis=1).argmax())
        agreeing = int((apart[most] <= DISAGREE_DEG).sum())
        for place in np.flatnonzero(apart[most] > DISAGREE_DEG):
            off = round(float(apart[most, place]), 1)
            message = f"its up is {off:g} degrees off that of {agreeing} of the {len(ups)} frames of {self._scene}"
            figures: dict[str, float | int | str] = {"degrees": off, "agreeing": agreeing, "frames": len(ups)}
            yield Finding("frame/up-disagrees", "warning", ups[place][0], (), message, figures)
