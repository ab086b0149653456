"""Speed of the stages in one run, so that ratios hold on any machine; and a detector's rate and memory over many."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np

from pipeline.answering.objects import PreparedFrame, all_objects, appearance_of
from pipeline.answering.pipeline import Pipeline, contexts
from pipeline.geometry.camera import backproject
from pipeline.geometry.frame import Frame
from pipeline.geometry.level_plane import level_plane
from pipeline.geometry.lifting import depth_edges, lift
from pipeline.proposals.cache import CachedDetector, CachedSegmenter
from pipeline.relations.features import Appearance
from pipeline.system.errors import InputError, require
from pipeline.system.whole_files import scratch_folder

MAX_FRAMES = 8


def bench_source(source: Pipeline, repeat: int = 5) -> dict[str, Any]:
    """Time each stage on up to eight frames of a dataset.

    Returns
    -------
    dict
        frames, objects, width, height; ms_per_frame by stage (fastest of
        `repeat` passes, mean over frames); ratios: lifting all objects against
        one back-projection of the whole frame, relations against lifting, and
        scoring pair by pair in a Python loop against all pairs at once.
    """
    detector = source.needed_detector()
    totals: dict[str, float] = {}
    loops: list[tuple[float, float]] = []
    frames = objects = width = height = 0
    for context in contexts(source, None, lambda *_: None):
        if frames == MAX_FRAMES:
            break
        frames += 1
        frame, viewer = context.frame, context.viewer
        found = all_objects(context, detector)
        lifted = [o.lifted for o in found]
        seen = appearance_of(found, frame)
        objects += len(found)
        width, height = frame.width, frame.height
        masks = [o.mask for o in found]
        stages: dict[str, Callable[[], Any]] = {
            "decode": lambda i=frame.id: source.dataset.load(i),
            "up vector": lambda f=frame: level_plane(f.depth, f.camera),
            "backproject frame": lambda f=frame: _whole_cloud(f),
            "depth edges": lambda f=frame: depth_edges(f.depth),
            "lift": lambda f=frame, m=masks, v=viewer, e=context.edges: lift(
                f.depth, f.camera, m, v, config=source.config.lift, edges=e
            ),
            "relations": lambda k=lifted, v=viewer, s=seen: source.scorer.score(k, v, s),
            "frame context": lambda f=frame: PreparedFrame(f, source.config.lift),
        }
        for name, job in stages.items():
            totals[name] = totals.get(name, 0.0) + fastest(job, repeat)
        if len(lifted) > 1:
            loops.append(
                (
                    fastest(lambda k=lifted, v=viewer, s=seen: source.scorer.score(k, v, s), repeat),
                    fastest(lambda k=lifted, v=viewer, s=seen: _pair_by_pair(source, k, v, s), 1),
                )
            )
    require(frames, "no frame of the dataset can be used", path=source.dataset.root)
    ms = {name: round(total / frames * 1000, 3) for name, total in totals.items()}
    ratios = {
        "lift / backproject": round(totals["lift"] / totals["backproject frame"], 2),
        "relations / lift": round(totals["relations"] / max(totals["lift"], 1e-9), 3),
    }
    if loops:
        ratios["pair loop / all at once"] = round(sum(b for _, b in loops) / sum(a for a, _ in loops), 1)
    return {
        "frames": frames,
        "objects": objects,
        "width": width,
        "height": height,
        "ms_per_frame": ms,
        "ratios": ratios,
    }


def fastest(job: Callable[[], Any], repeat: int) -> float:
    """Seconds of the fastest of some passes."""
    best = np.inf
    for _ in range(max(repeat, 1)):
        start = perf_counter()
        job()
        best = min(best, perf_counter() - start)
    return float(best)


def _whole_cloud(frame: Any) -> np.ndarray:
    v, u = np.nonzero(frame.depth > 0)
    return backproject(frame.depth, frame.camera, v, u)


def _pair_by_pair(source: Pipeline, lifted: list, viewer: Any, seen: Appearance) -> None:
    for i, a in enumerate(lifted):
        for j, b in enumerate(lifted[:i]):
            source.scorer.score([a, b], viewer, seen.take([i, j]))


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


if __name__ == "__main__":
    # cd tests && python -m benchmarks.stages [DATASET]
    import json
    import sys

    from pipeline.answering.pipeline import open_pipeline

    print(json.dumps(bench_source(open_pipeline((sys.argv[1:] or ["demo"])[0])), indent=2))
