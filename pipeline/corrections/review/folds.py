"""Folds of frames: each is held out once, and nothing is learnt from its surroundings then.

As in `pipeline.metrics.splits`, frames of one scene resemble each other. So scenes
are held out, or where there are few, blocks of camera positions with a gap.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
import xxhash

from pipeline.metrics.splits import FEWEST_SCENES, FRAME_GAP, GAP_M, FrameKey, along_spread
from pipeline.system.errors import InputError

FOLDS = 5


@dataclass(frozen=True, eq=False)
class Folds:
    """What is held out, and what is learnt from, in each of K folds.

    Attributes
    ----------
    kind : str
        "scene": whole scenes; "blocks": blocks of camera positions in each scene.
    held : (K, F) bool
        Every frame is held out in exactly one fold.
    learnt : (K, F) bool
        Never a frame that is held out, nor one in a gap beside it.
    gaps : dict of str to float or int
        Of "blocks", by scene: metres between blocks, or frames where the scene has no usable poses.
    """

    kind: Literal["scene", "blocks"]
    held: np.ndarray
    learnt: np.ndarray
    gaps: dict[str, float | int]

    def __len__(self) -> int:
        return len(self.held)


def make_folds(frames: Sequence[FrameKey], folds: int = FOLDS, seed: int = 0) -> Folds:
    """Part the frames.

    Parameters
    ----------
    frames : sequence of FrameKey
    folds : int
        At most so many: no more than there are scenes, or frames of the longest scene.
    seed : int
        Of the order in which scenes are dealt out.

    Raises
    ------
    InputError
        Fewer than two folds are asked for, or there are fewer than two frames.
    """
    if folds < 2:
        raise InputError("there must be at least two folds", got=folds)
    if len(frames) < 2:
        raise InputError("out-of-fold probabilities need at least two frames", got=len(frames))
    names = np.array([f.scene for f in frames], object)
    scenes = sorted(set(names.tolist()))
    if len(scenes) >= FEWEST_SCENES:
        return _by_scene(names, scenes, min(folds, len(scenes)), seed)
    return _by_block(frames, names, scenes, folds)


def _by_scene(names: np.ndarray, scenes: Sequence[str], folds: int, seed: int) -> Folds:
    """Scenes in a seeded order, each to the fold that has fewest frames."""
    order = sorted(scenes, key=lambda s: (xxhash.xxh3_64_intdigest(f"{seed}\0{s}".encode("utf-8", "replace")), s))
    held, size = np.zeros((folds, len(names)), np.bool_), np.zeros(folds, np.int64)
    for place, scene in enumerate(order):
        mine = names == scene
        # At first one scene each, so that no fold stays empty.
        fold = place if place < folds else int(size.argmin())
        held[fold] |= mine
        size[fold] += mine.sum()
    return Folds("scene", held, ~held, {})


def _by_block(frames: Sequence[FrameKey], names: np.ndarray, scenes: Sequence[str], folds: int) -> Folds:
    most = max(int((names == scene).sum()) for scene in scenes)
    folds = min(folds, max(most, 2))
    held, learnt = np.zeros((2, folds, len(frames)), np.bool_)
    gaps: dict[str, float | int] = {}
    for number, scene in enumerate(scenes):
        places = np.flatnonzero(names == scene)
        along, gap = _along([frames[k] for k in places.tolist()])
        rank = np.argsort(np.argsort(along, kind="stable"), kind="stable")
        # Scenes with few frames start at different folds.
        block = (rank * min(folds, len(places)) // len(places) + number) % folds
        gaps[scene] = _held_in_blocks(held, learnt, places, block, along, gap)
    return Folds("blocks", held, learnt, gaps)


def _along(frames: Sequence[FrameKey]) -> tuple[np.ndarray, float | int]:
    """Where the frames of a scene stand in a row, and the gap: in metres, or in frames where poses do not differ."""
    positions = [f.position for f in frames]
    if all(p is not None for p in positions):
        along = along_spread(np.array(positions, np.float64))
        if along is not None and np.ptp(along) > 0.1:
            return along, GAP_M
    order = np.argsort([f.index for f in frames], kind="stable")
    return np.argsort(order, kind="stable").astype(np.float64), max(1, round(FRAME_GAP * len(frames)))


def _held_in_blocks(
    held: np.ndarray, learnt: np.ndarray, places: np.ndarray, block: np.ndarray, along: np.ndarray, gap: float | int
) -> float | int:
    """Enter one scene's blocks; the gap is halved until at least half of the other frames are left to learn from."""
    mine = block[None] == np.arange(len(held))[:, None]
    held[:, places] = mine
    while True:
        near = np.zeros_like(mine)
        for k, inside in enumerate(mine):
            if inside.any():
                near[k] = (along > along[inside].min() - gap) & (along < along[inside].max() + gap)
        kept = ~near & ~mine
        enough = (kept.sum(axis=1) * 2 >= (~mine).sum(axis=1)).all()
        if enough or gap < 0.01:
            learnt[:, places] = kept if enough else ~mine
            return gap if enough else 0
        gap = gap // 2 if isinstance(gap, int) else gap / 2
