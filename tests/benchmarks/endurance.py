"""A detector's rate and memory over many pictures."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from time import perf_counter

import numpy as np

from pipeline.answering.pipeline import Pipeline
from pipeline.geometry.frame import Frame
from pipeline.proposals.cache import CachedDetector, CachedSegmenter
from pipeline.system.errors import InputError, require
from pipeline.system.whole_files import scratch_folder

SAMPLES = 20
"""How often the memory is looked at."""


@dataclass(frozen=True)
class Endurance:
    """What a run over many pictures showed.

    Attributes
    ----------
    detector : str
    pictures : int
    detections : int
    frames_per_second : float
        Of the detector alone, without reading the pictures.
    resident_mb : tuple of float
        Resident memory in 2**20 bytes, at equal distances over the run; empty where the system does not tell it.
    growth_mb : float or None
        The mean of its last quarter less that of its second.
    """

    detector: str
    pictures: int
    detections: int
    frames_per_second: float
    resident_mb: tuple[float, ...]
    growth_mb: float | None


def run_endurance(
    source: Pipeline,
    frame_ids: Sequence[str],
    count: int,
    progress: Callable[[int, int], None] | None = None,
) -> Endurance:
    """Run the source's detector over `count` pictures, the frames in turn, each changed so that no cache knows it.

    Results that the detector keeps on disk go to a folder that is deleted afterwards.

    Raises
    ------
    InputError
        No detector, no usable frame, or what the detector raises.
    """
    detector = source.needed_detector()
    names = source.dataset.class_names or None
    if detector.vocabulary is not None:
        # What is asked for is all that it knows, whatever the dataset's names are.
        names = None
    frames = _frames(source, frame_ids)
    resident: list[float] = []
    every = max(count // SAMPLES, 1)
    detections, seconds = 0, 0.0
    with scratch_folder() as folder:
        caches = [(cache, cache.folder) for cache in _caches(detector)]
        for cache, _ in caches:
            cache.folder = Path(folder)
        try:
            for number in range(count):
                picture = _changed(frames[number % len(frames)], number)
                start = perf_counter()
                found = detector.detect(picture, names)
                seconds += perf_counter() - start
                detections += len(found)
                if number % every == every - 1:
                    resident += _resident_mb()
                if progress is not None:
                    progress(number + 1, count)
        finally:
            for cache, own in caches:
                cache.folder = own
    quarter = len(resident) // 4
    growth = float(np.mean(resident[-quarter:]) - np.mean(resident[quarter : 2 * quarter])) if quarter else None
    rate = count / max(seconds, 1e-9)
    return Endurance(detector.name, count, detections, rate, tuple(resident), growth)


def _caches(part: object) -> Iterator[CachedDetector | CachedSegmenter]:
    """What keeps results on disk in a detector, in what it wraps, in its segmenter and in its members."""
    if isinstance(part, CachedDetector | CachedSegmenter):
        yield part
    inner = (getattr(part, "detector", None), getattr(part, "segmenter", None), *getattr(part, "members", ()))
    for one in inner:
        if one is not None:
            yield from _caches(one)


def _frames(source: Pipeline, frame_ids: Sequence[str], most: int = 16) -> list[Frame]:
    """At most so many of the frames; broken ones are left out."""
    frames: list[Frame] = []
    reason = None
    for frame_id in frame_ids:
        try:
            frames.append(source.dataset.load(frame_id))
        except InputError as error:
            reason = str(error)
        if len(frames) == most:
            break
    require(frames, "there is no usable frame", cause=reason, path=source.dataset.root)
    return frames


def _changed(frame: Frame, number: int) -> Frame:
    """The frame with the number written into the colours of four pixels."""
    rgb = frame.rgb.copy()
    values = rgb.reshape(-1)[:4]
    values[:] = np.frombuffer(number.to_bytes(4, "little"), np.uint8)[: len(values)]
    return replace(frame, id=f"{frame.id}#{number}", rgb=rgb)


def _resident_mb() -> list[float]:
    """One number, or none where there is no /proc."""
    try:
        pages = int(Path("/proc/self/statm").read_text().split()[1])
    except (OSError, ValueError, IndexError):
        return []
    return [pages * os.sysconf("SC_PAGE_SIZE") / 2**20]
