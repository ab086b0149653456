"""Splits of frames into training, validation and test: 70, 10 and 20 in a hundred.

Frames of one scene show the same objects from almost the same place. A split
that puts neighbours on both sides measures memory: so scenes are split, or on
one scene blocks of camera positions with a gap between them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, Literal

import numpy as np
import xxhash

from pipeline.system.errors import require
from pipeline.system.frozen import dataclass

SplitKind = Literal["scene", "blocks"]
TRAIN, VALIDATION, TEST, DROPPED = 0, 1, 2, -1
PARTS = ("train", "validation", "test")
SHARES = (0.7, 0.1, 0.2)
FEWEST_SCENES = 3
GAP_M = 1.0
FRAME_GAP = 0.02
"""Where there are no poses: the share of a scene's frames that is dropped at either cut."""


@dataclass(frozen=True)
class FrameKey:
    """A frame as a split knows it."""

    frame: str
    scene: str
    index: int  # Index in the dataset
    position: tuple[float, float, float] | None = None  # Of the camera in the world, metres


@dataclass(frozen=True, eq=False)
class SplitPlan:
    """Each frame's part."""

    kind: SplitKind
    seed: int
    frames: tuple[FrameKey, ...]
    part: np.ndarray  # (F,) int8, TRAIN, VALIDATION, TEST, or DROPPED (in a gap)
    # Of "blocks", by scene: metres between blocks, or frames where the scene has no usable poses
    gaps: dict[str, float | int]
    warning: str | None

    def indices(self, part: int) -> np.ndarray:
        """Indices of the frames of a part."""
        return np.flatnonzero(self.part == part)

    def for_frames(self, frames: Sequence[FrameKey]) -> SplitPlan:
        """Apply the parts, by id, to frames of other labels of the dataset; frames outside the plan are dropped."""
        parts = {f.frame: part for f, part in zip(self.frames, self.part.tolist(), strict=True)}
        part = np.array([parts.get(f.frame, DROPPED) for f in frames], np.int8)
        return replace(self, frames=tuple(frames), part=part)

    def record(self) -> dict[str, Any]:
        """JSON: the scenes of each part, or the frames where scenes are cut."""
        counts = {name: int((self.part == k).sum()) for k, name in enumerate(PARTS)}
        inside = {name: [self.frames[i] for i in self.indices(k)] for k, name in enumerate(PARTS)}
        members = (
            {f"{name}_scenes": sorted({f.scene for f in found}) for name, found in inside.items()}
            if self.kind == "scene"
            else {f"{name}_frames": [f.frame for f in found] for name, found in inside.items()}
        )
        return {
            "kind": self.kind,
            "seed": self.seed,
            "frames": {**counts, "dropped": int((self.part == DROPPED).sum())},
            "warning": self.warning,
            **({"gaps": self.gaps} if self.gaps else {}),
            **members,
        }


def split_frames(frames: Sequence[FrameKey], kind: SplitKind | None = None, seed: int = 0) -> SplitPlan:
    """Split frames into parts.

    Parameters
    ----------
    kind : str, optional
        "scene": whole scenes, in the order of a seeded hash of their names.
        "blocks": in each scene one block of camera positions for each part, at
        least 1 m apart (less, with a warning, where the scene is smaller).
        By default scenes where there are at least three, else blocks.

    Raises
    ------
    InputError
        Too few scenes or frames.

    >>> from pipeline.metrics import TEST, FrameKey, split_frames
    >>> frames = [FrameKey(f"{scene}/{k}", scene, k) for scene in ("bath", "hall", "kitchen") for k in range(4)]
    >>> plan = split_frames(frames)
    >>> plan.kind, [frames[i].frame for i in plan.indices(TEST)]
    ('scene', ['bath/0', 'bath/1', 'bath/2', 'bath/3'])
    """
    frames = tuple(frames)
    scenes = sorted({f.scene for f in frames})
    kind = kind or ("scene" if len(scenes) >= FEWEST_SCENES else "blocks")
    if kind == "scene":
        return SplitPlan("scene", seed, frames, _by_scene(frames, scenes, seed), {}, None)
    require(
        len(frames) >= len(PARTS),
        "training needs at least three frames: to learn, to calibrate, to measure",
        got=len(frames),
    )
    require(kind == "blocks", "no such split", got=repr(kind), expected="scene | blocks")
    return _blocks(frames, scenes, seed)


def _by_scene(frames: Sequence[FrameKey], scenes: Sequence[str], seed: int) -> np.ndarray:
    require(
        len(scenes) >= FEWEST_SCENES,
        "a split by scene needs at least three scenes",
        got=f"{len(scenes)}: {', '.join(scenes)}",
        expected="--split blocks on fewer",
    )
    order = sorted(scenes, key=lambda s: (xxhash.xxh3_64_intdigest(f"{seed}\0{s}".encode("utf-8", "replace")), s))
    part = dict(zip(order, _cut(len(order)).tolist(), strict=True))
    return np.array([part[f.scene] for f in frames], np.int8)


def _cut(n: int) -> np.ndarray:
    """Parts in a row, (n,), at least one of each where n >= 3: training first, then validation, then test."""
    test, validation = max(1, round(n * SHARES[2])), max(1, round(n * SHARES[1]))
    return np.repeat(np.array([TRAIN, VALIDATION, TEST], np.int8), [n - test - validation, validation, test])


def _blocks(frames: Sequence[FrameKey], scenes: Sequence[str], seed: int) -> SplitPlan:
    part = np.full(len(frames), DROPPED, np.int8)
    gaps: dict[str, float | int] = {}
    for scene in scenes:
        indices = np.array([k for k, f in enumerate(frames) if f.scene == scene])
        if len(indices) < len(PARTS):
            # Too few to cut: where the same scene is not measured on, they may be learnt from.
            part[indices], gaps[scene] = TRAIN, 0
            continue
        positions = [frames[k].position for k in indices]
        cut = None
        if all(p is not None for p in positions):
            cut = position_blocks(np.array(positions, np.float64), GAP_M)
        if cut is None:
            order = np.argsort([frames[k].index for k in indices], kind="stable")
            part[indices[order]], gaps[scene] = _index_blocks(len(indices))
        else:
            part[indices], gaps[scene] = cut
    require(
        ((part == VALIDATION).any() and (part == TEST).any()),
        "no scene has the three frames that blocks need",
        got=f"{len(frames)} frames in {len(scenes)} scenes",
    )
    return SplitPlan("blocks", seed, tuple(frames), part, gaps, _blocks_warning(len(scenes), gaps))


def _blocks_warning(scenes: int, gaps: dict[str, float | int]) -> str:
    metres = [g for g in gaps.values() if isinstance(g, float)]
    text = f"learnt and measured on the same {'scene' if scenes == 1 else f'{scenes} scenes'}, in blocks of "
    if metres:
        text += f"camera positions at least {min(metres):.2g} m apart"
    if len(metres) < len(gaps):
        text += (" or of " if metres else "") + "neighbouring frames, as poses are missing or do not differ"
    if metres and min(metres) < GAP_M:
        text += " (the cameras stand too close together for 1 m)"
    return text + (
        ": the figures say how it does from other places in known rooms, not in new ones; random frames would say even "
        "less, as neighbouring frames are almost the same picture"
    )


def position_blocks(positions: np.ndarray, gap: float) -> tuple[np.ndarray, float] | None:
    """Cut camera positions, (F, 3), metres, into three blocks along the direction of their largest spread.

    Gives the parts, (F,) int8, those between blocks DROPPED, and the gap, metres: halved until no block is empty; None
    where the positions do not differ by enough to be cut with a gap of 1 cm.
    """
    along = along_spread(positions)
    if along is None:
        return None
    n = len(along)
    ranked = np.sort(along)
    parts = _cut(n)
    first, last = ranked[np.flatnonzero(parts == VALIDATION)[[0, -1]]]
    while gap >= 0.01:
        part = np.full(n, DROPPED, np.int8)
        part[(along >= first) & (along <= last)] = VALIDATION
        part[along <= first - gap] = TRAIN
        part[along >= last + gap] = TEST
        if len(set(part.tolist()) - {DROPPED}) == len(PARTS) and (part == TRAIN).sum() >= SHARES[0] / 2 * n:
            return part, float(gap)
        gap /= 2
    return None


def along_spread(positions: np.ndarray) -> np.ndarray | None:
    """Coordinates, (F,), metres, of positions, (F, 3), in the direction of largest spread; None if not finite."""
    centred = positions - positions.mean(axis=0)
    if not np.isfinite(centred).all():
        return None
    along = centred @ np.linalg.svd(centred, full_matrices=False)[2][0]
    # The sign of a singular vector is free: the first frame is at the beginning.
    return along if along[0] <= np.median(along) else -along


def _index_blocks(n: int) -> tuple[np.ndarray, int]:
    """Cut neighbouring frames into blocks, with frames dropped on the training's and the test's side of either cut."""
    part = _cut(n)
    gap = max(1, round(FRAME_GAP * n)) if n >= 10 else 0
    if gap:
        middle = np.flatnonzero(part == VALIDATION)
        part[max(middle[0] - gap, 1) : middle[0]] = DROPPED
        part[middle[-1] + 1 : min(middle[-1] + 1 + gap, n - 1)] = DROPPED
    return part, gap
