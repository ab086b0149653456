"""Label errors that are known, to measure what finds them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from pipeline.corrections.review.out_of_fold import stacked, unstacked
from pipeline.language.relation_names import DIRECTIONAL
from pipeline.metrics.splits import FrameKey
from pipeline.relations.relations import U
from pipeline.system.errors import InputError
from pipeline.training.label_data import LabelData, LabelledFrame
from pipeline.training.training_data import FrameSamples


@dataclass(frozen=True, eq=False)
class Planted:
    """Labels with errors.

    Attributes
    ----------
    data : LabelData
        With the errors.
    truth : LabelData
        Without.
    flipped : (P, R) bool
        Which cells were turned from T to F or back, in the order of `stacked`.
    """

    data: LabelData
    truth: LabelData
    flipped: np.ndarray


def plant_flips(truth: LabelData, share: float, seed: int = 0) -> Planted:
    """Turn a share of all cells that are T or F into the opposite, each for itself and not with its mirror image.

    Raises
    ------
    InputError
        The share is not between 0 and 1.
    """
    if not 0 < share < 1:
        raise InputError("the share of planted errors must lie between 0 and 1", got=share)
    states = stacked([f.states for f in truth.frames])
    known = np.flatnonzero(states.ravel() != U)
    chosen = np.random.default_rng([seed, 41]).choice(known, round(share * len(known)), replace=False)
    flipped = np.zeros(states.shape, np.bool_)
    flipped.ravel()[chosen] = True
    return Planted(with_labels(truth, np.where(flipped, -states, states)), truth, flipped)


def with_labels(data: LabelData, states: np.ndarray) -> LabelData:
    """The data with other states ((P, R) int8, in the order of `stacked`)."""
    matrices = unstacked(states.astype(np.int8), [len(f.rows) for f in data.frames])
    return replace(data, frames=tuple(replace(f, states=s) for f, s in zip(data.frames, matrices, strict=True)))


def data_of_samples(
    samples: Sequence[FrameSamples], exact: bool, features: str = "rel14"
) -> LabelData:
    """Rendered views as labels: scenes are rooms, states by exact or by seen extents (see `FrameSamples`)."""
    frames = []
    for index, view in enumerate(samples):
        count = len(view.seen_lo)
        if count < 2:
            continue
        states = (view.truth if exact else view.rule).copy()
        states[np.eye(count, dtype=np.bool_)] = U
        key = FrameKey(f"{view.room}/{index}", str(view.room), index)
        frames.append(LabelledFrame(key, view.rows[features], np.zeros(count, np.int32), states, np.arange(count)))
    if not frames:
        raise InputError("these views show no two objects", got=f"{len(samples)} views")
    return LabelData(features, DIRECTIONAL, tuple(frames), ("",))
