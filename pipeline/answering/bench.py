"""Speed of the stages, measured in one run so that ratios hold on any machine."""

from __future__ import annotations

from collections.abc import Callable
from time import perf_counter
from typing import Any

import numpy as np

from pipeline.answering.objects import PreparedFrame, all_objects, appearance_of
from pipeline.answering.opening import Pipeline, contexts
from pipeline.geometry.level_plane import level_plane
from pipeline.geometry.lifting import depth_edges, lift
from pipeline.relations.features import Appearance
from pipeline.system.errors import InputError

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
            totals[name] = totals.get(name, 0.0) + _fastest(job, repeat)
        if len(lifted) > 1:
            loops.append(
                (
                    _fastest(lambda k=lifted, v=viewer, s=seen: source.scorer.score(k, v, s), repeat),
                    _fastest(lambda k=lifted, v=viewer, s=seen: _pair_by_pair(source, k, v, s), 1),
                )
            )
    if not frames:
        raise InputError("no frame of the dataset can be used", path=source.dataset.root)
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


def _fastest(job: Callable[[], Any], repeat: int) -> float:
    best = np.inf
    for _ in range(max(repeat, 1)):
        start = perf_counter()
        job()
        best = min(best, perf_counter() - start)
    return float(best)


def _whole_cloud(frame: Any) -> np.ndarray:
    from pipeline.geometry.camera import backproject

    v, u = np.nonzero(frame.depth > 0)
    return backproject(frame.depth, frame.camera, v, u)


def _pair_by_pair(source: Pipeline, lifted: list, viewer: Any, seen: Appearance) -> None:
    for i, a in enumerate(lifted):
        for j, b in enumerate(lifted[:i]):
            source.scorer.score([a, b], viewer, seen.take([i, j]))
