"""Which labels a relation network has learnt from, and which frames of a label set it has seen."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from pipeline.labels.reading import Labels
from pipeline.metrics.splits import DROPPED, TRAIN, VALIDATION, FrameKey, SplitPlan
from pipeline.relations.contract import TrainedOn


def identity(labels: Labels) -> tuple[str, str, str]:
    """Name of the dataset's folder, hash of its files ("" where the manifest has none), hash of the frames' table."""
    dataset = labels.manifest.dataset
    return (
        Path(str(dataset.get("path", ""))).name,
        str(dataset.get("input_hash", "")),
        labels.manifest.tables["frames"].content_hash,
    )


def trained_on(labels: Labels, plan: SplitPlan) -> TrainedOn:
    """What a network of these labels and this split learns from."""
    name, input_hash, content = identity(labels)
    inside = {part: [plan.frames[k] for k in plan.indices(part)] for part in (TRAIN, VALIDATION)}
    whole = plan.kind == "scene"
    names = {part: tuple(dict.fromkeys(f.scene if whole else f.frame for f in frames))
             for part, frames in inside.items()}  # fmt: skip
    scenes = tuple(sorted({f.scene for frames in inside.values() for f in frames}))
    return TrainedOn(name, input_hash, content, plan.kind, names[TRAIN], names[VALIDATION], scenes)


def same_dataset(learnt: TrainedOn, labels: Labels) -> bool:
    """Whether these labels are of the dataset that was learnt from."""
    name, input_hash, content = identity(labels)
    return (
        content == learnt.content_hash
        or (input_hash != "" and input_hash == learnt.input_hash)
        or (name != "" and name == learnt.dataset)
    )


def parts_seen(learnt: TrainedOn, labels: Labels, frames: Sequence[FrameKey]) -> np.ndarray:
    """(F,) int8: TRAIN or VALIDATION where the network knows a frame; DROPPED where it has not seen it."""
    found = np.full(len(frames), DROPPED, np.int8)
    if not same_dataset(learnt, labels):
        return found
    train, validation = set(learnt.train), set(learnt.validation)
    for k, frame in enumerate(frames):
        name = frame.scene if learnt.split == "scene" else frame.frame
        if name in train:
            found[k] = TRAIN
        elif name in validation:
            found[k] = VALIDATION
    return found
