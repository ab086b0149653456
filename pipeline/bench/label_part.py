"""Labelling: a frame beside decoding its files, the whole job, its memory over many frames, and many objects."""

from __future__ import annotations

import gc
from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path
from time import process_time

import numpy as np

from pipeline.bench.clock import Figure, Setup, resident_mb, side_by_side
from pipeline.bench.worlds import crowded_frame, decode, demo_frames, pictures
from pipeline.datasets import demo_path
from pipeline.labels import SENTENCE_KINDS, LabelConfig, SourceSpec, label_dataset, open_labeller
from pipeline.labels.job import Labeller, label_frame, shard_tables
from pipeline.system.whole_files import scratch_folder
from pipeline.system.worker_pool import one_thread

MANY = 400


def measure(setup: Setup) -> Iterator[Figure]:
    """Measure labelling."""
    times = setup.times(12, 4)
    with scratch_folder() as folder, one_thread():
        for name in ("written", "packed"):
            labeller, frame = opened(demo_frames(folder / name, 1, written=name == "written"))
            job = partial(labelled, labeller, frame)
            seconds, floor = side_by_side([job, partial(decode, pictures(folder / name))], times)
            yield f"label.{name}", seconds * 1000, floor * 1000
        wordy = replace(labeller, config=replace(labeller.config, sentences=SENTENCE_KINDS))
        seconds, floor = side_by_side([partial(labelled, wordy, frame), job], times)
        yield "label.sentences", seconds * 1000, floor * 1000
        yield "label.job", *_rates(folder)
        yield "label.memory", *_memory(demo_frames(folder / "many", setup.times(MANY, MANY // 4)))
        # Last: so many objects leave memory behind.
        few, many = (partial(labelled, *opened(crowded_frame(folder / str(n), n))) for n in (30, 300))
        seconds, floor = side_by_side([many, few], setup.times(5))
        yield "label.growth", seconds * 1000, floor * 1000


def opened(root: Path) -> tuple[Labeller, str]:
    """A labeller of a dataset's own masks, and its first frame."""
    labeller = open_labeller(SourceSpec(str(root)), LabelConfig())
    return labeller, labeller.source.dataset.frame_ids[0]


def labelled(labeller: Labeller, frame: str) -> None:
    """A frame from its files to its tables."""
    found = label_frame(labeller, frame, 0)
    shard_tables([found], tuple(found.tables()))


def _rates(folder: Path) -> tuple[float, float]:
    """Frames a second of the whole job, and of decoding alone."""
    start = process_time()
    report = label_dataset(SourceSpec("demo"), folder / "labels", workers=1)
    ended = process_time()
    files = pictures(Path(demo_path()))
    decoded = process_time()
    decode(files)
    return report.frames / (ended - start), report.frames / (process_time() - decoded)


def _memory(root: Path) -> tuple[float, float]:
    """Resident memory after all frames, and after the first quarter: means of the eighth before."""
    labeller, _ = opened(root)
    seen = []
    for k, frame in enumerate(labeller.source.dataset.frame_ids):
        labelled(labeller, frame)
        seen.append(resident_mb())
        if k % 50 == 0:
            gc.collect()
    eighth = len(seen) // 8
    return float(np.mean(seen[-eighth:])), float(np.mean(seen[eighth : 2 * eighth]))
