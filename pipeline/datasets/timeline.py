"""Timeline of a dataset: all its frames as one byte each, and where its scenes begin.

A byte is a share of something in the frame, such as of its wrong answers, so that 100,000 frames are 100 kB.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from functools import cached_property

import numpy as np

from pipeline.datasets.base import Dataset, scenes_of
from pipeline.datasets.odd_frames import OddFrame
from pipeline.system.frozen import dataclass

ALL, UNKNOWN = 254, 255
"""Bytes of a whole share and of none that is known. Rounded up: only a share of nothing is 0."""
MOST_SCENES, MOST_ODD = 400, 500
"""Datasets of more scenes have none of their beginnings; of more odd frames the oddest are kept."""


@dataclass(frozen=True, eq=False)
class Timeline:
    """Frames of a dataset in its order."""

    frame_ids: tuple[str, ...]
    scenes: tuple[tuple[int, str], ...]  # Index of the first frame, and scene, of each run of frames of one scene

    @cached_property
    def indices(self) -> dict[str, int]:
        """Index of each frame."""
        return {frame_id: k for k, frame_id in enumerate(self.frame_ids)}

    def shares(self, counts: Mapping[str, tuple[int, int]]) -> np.ndarray:
        """(N,) uint8: share of the second count of each frame, such as of (right, wrong) answers."""
        out = np.full(len(self.frame_ids), UNKNOWN, np.uint8)
        known = [(k, n) for frame_id, n in counts.items() if (k := self.indices.get(frame_id)) is not None and any(n)]
        if known:
            places, numbers = np.array([k for k, _ in known]), np.array([n for _, n in known])
            out[places] = np.ceil(ALL * numbers[:, 1] / numbers.sum(axis=1))
        return out

    def missing_depth(self, frames: Iterable[OddFrame]) -> np.ndarray:
        """(N,) uint8: share of the pixels without depth of each frame, as `odd_frames` found it."""
        shares = np.array([np.nan if f.depth_missing is None else f.depth_missing for f in frames], float)
        return np.where(np.isnan(shares), UNKNOWN, np.ceil(ALL * np.nan_to_num(shares))).astype(np.uint8)


def timeline_of(dataset: Dataset) -> Timeline:
    """Timeline of a dataset."""
    scenes = scenes_of(dataset)
    starts = tuple((k, scene) for k, scene in enumerate(scenes) if not k or scene != scenes[k - 1])
    return Timeline(dataset.frame_ids, starts if len(starts) <= MOST_SCENES else ())


def oddest(frames: Iterable[OddFrame], most: int = MOST_ODD) -> list[tuple[int, str]]:
    """Index and reasons of the odd frames among all of a dataset, in its order."""
    found = [(k, frame) for k, frame in enumerate(frames) if frame.reasons]
    found = sorted(found, key=lambda one: -(one[1].oddness or 0))[:most]
    return sorted((k, ", ".join(frame.reasons)) for k, frame in found)


def next_with_share(shares: np.ndarray, at: int, step: int) -> int | None:
    """Index of the next frame (`step` 1) or previous (-1) of a share above 0, round the ends; None without any."""
    found = np.flatnonzero((shares > 0) & (shares < UNKNOWN))
    if not len(found):
        return None
    k = np.searchsorted(found, at, "right") if step > 0 else np.searchsorted(found, at, "left") - 1
    return int(found[k % len(found)])
