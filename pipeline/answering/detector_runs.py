"""Runs of a detector over a dataset: recorded for `--detector recorded`, or scores calibrated by hits and misses."""

from __future__ import annotations

import json
import os
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import field
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np

from pipeline.answering.pipeline import Pipeline
from pipeline.datasets.base import scene_of
from pipeline.geometry.boxes import iou_2d
from pipeline.geometry.frame import Frame
from pipeline.geometry.masks import encode_run_length
from pipeline.metrics.calibration_metrics import (
    FEWEST_POSITIVES,
    IDENTITY,
    brier_score,
    expected_calibration_error,
    reliability_diagram,
    sigmoid,
)
from pipeline.proposals.annotations import AnnotationDetector
from pipeline.proposals.base import Detector, Proposals, top_k
from pipeline.proposals.recorded import MADE_BY, MADE_BY_FILE
from pipeline.proposals.score_calibration import (
    HIT_IOU,
    RELIABILITY_BINS,
    SCORE_LIMIT,
    FittedFrame,
    ScoreCalibration,
    fit_scores,
    score_logit,
)
from pipeline.system.errors import InputError, UnknownClass, require
from pipeline.system.frozen import dataclass
from pipeline.system.whole_files import temporary_folder, text_file, whole_file

Record = dict[str, Any]
"""Detection as JSON: label, score, bbox; mask, segmented and id where it has them."""


@dataclass(frozen=True)
class RecordingReport:
    """Report of a recording."""

    frames: int
    detections: int
    skipped: dict[str, str]  # Frames that were left out, and why
    unknown: tuple[str, ...]  # Names that the detector does not know
    seconds: float
    classes: dict[str, int] = field(default_factory=dict)  # Detections by label, the commonest first


def record_detections(
    pipeline: Pipeline,
    out: str | Path,
    class_names: Sequence[str] | None = None,
    progress: Callable[[int, int], None] | None = None,
    *,
    frame_ids: Sequence[str] | None = None,
) -> RecordingReport:
    """Run a detector over a dataset and write its detections.

    Parameters
    ----------
    pipeline : Pipeline
        Its `config.k` proposals of each name are kept, as `ask` would; those of an exact detector all.
    out : str or Path
        A JSON file where the name ends in ".json", else a folder with an NPZ file for each frame: it must not exist, or
        be empty. Either appears whole or not at all, and frames are written one by one.
    class_names : sequence of str, optional
        Asked for one by one, as `ask` does. None asks once for everything that the detector knows: then a thing has one
        label only.
    progress : callable, optional
        Called with (frames done, frames in all).
    frame_ids : sequence of str, optional
        All frames by default; broken ones are left out.

    Raises
    ------
    InputError
        No detector, a name that is nowhere known, no usable frame, or a place that cannot be written.
    """
    start = perf_counter()
    detector, out = pipeline.needed_detector(), Path(out)
    chosen = pipeline.dataset.frame_ids if frame_ids is None else tuple(frame_ids)
    skipped: dict[str, str] = {}
    unknown: dict[str, int] = {}
    classes: Counter[str] = Counter()
    frames = detections = 0
    writer = _json_file if out.suffix.lower() == ".json" else _npz_folder
    with writer(out, f"{detector.name}: {detector.fingerprint()}") as write:
        for done, frame_id in enumerate(chosen, start=1):
            try:
                frame = pipeline.dataset.load(frame_id)
                found = findings(frame, detector, class_names, pipeline.config.k, unknown)
            except InputError as error:
                skipped[frame_id] = str(error)
            else:
                write(frame, found)
                frames, detections = frames + 1, detections + len(found)
                classes.update(one["label"] for one in found)
            if progress is not None:
                progress(done, len(chosen))
        if not frames:
            reason = next(iter(skipped.values()), None)
            raise InputError("there is no usable frame to record", cause=reason, path=pipeline.dataset.root)
        never = tuple(name for name, times in unknown.items() if times == frames)
        if class_names and len(never) == len(set(class_names)):
            raise InputError(f"the detector {detector.name} knows none of the names", got=", ".join(never[:8]))
    return RecordingReport(frames, detections, skipped, never, perf_counter() - start, dict(classes.most_common()))


def findings(
    frame: Frame, detector: Detector, class_names: Sequence[str] | None, k: int, unknown: dict[str, int] | None = None
) -> list[Record]:
    """Detections of a frame: for each name the K best; `unknown` counts the refused names."""
    queries: list[list[str] | None] = [None] if class_names is None else [[name] for name in class_names]
    best: dict[tuple[int, str], Record] = {}
    masks: dict[int, Record | None] = {}
    nameless = 0
    for query in queries:
        try:
            found = detector.detect(frame, query)
        except UnknownClass:
            if unknown is None or query is None:
                raise
            unknown[query[0]] = unknown.get(query[0], 0) + 1
            continue
        if query is not None and not detector.exact:
            found = top_k(found, k)
        for i, number in enumerate(found.ids.tolist()):
            if number < 0:
                # Without an identity each detection is a thing of its own.
                nameless -= 1
                number = nameless
            if number not in masks:
                masks[number] = mask_record(found, i)
            entry = detection_record(found, i, masks[number])
            key = number, entry["label"]
            if key not in best or entry["score"] > best[key]["score"]:
                best[key] = entry
    return list(best.values())


def mask_record(found: Proposals, i: int) -> Record | None:
    """Mask of a detection in COCO's code; None for a mere box."""
    if found.masks is None or (found.has_mask is not None and not found.has_mask[i]):
        return None
    return {"size": found.masks.shape[1:], "counts": encode_run_length(found.masks[i])}


def detection_record(found: Proposals, i: int, mask: Record | None, segmented: bool = False) -> Record:
    """Detection as JSON, without an absent mask or identity; `segmented` marks a mask made by a segmenter."""
    record: Record = {"label": found.label(i), "score": float(found.scores[i]), "bbox": found.boxes[i].tolist()}
    if mask is not None:
        record |= {"mask": mask} | ({"segmented": True} if segmented else {})
    return record | ({"id": int(found.ids[i])} if found.ids[i] >= 0 else {})


@contextmanager
def _json_file(out: Path, made_by: str) -> Iterator[Callable[[Frame, list[Record]], None]]:
    """Write a JSON file frame by frame, visible once complete."""
    require(not out.is_dir(), "the recording would replace a folder", expected="the name of a file", path=out)
    with whole_file(out, "the recording") as temporary, text_file(temporary) as file:
        file.write(f'{{"{MADE_BY}": {json.dumps(made_by)}, "frames": {{')
        lines = 0

        def write(frame: Frame, found: list[Record]) -> None:
            nonlocal lines
            entries = json.dumps(found, allow_nan=False)
            file.write(f"{',' if lines else ''}\n{json.dumps(frame.id)}: {entries}")
            lines += 1

        yield write
        file.write("\n}}\n")


@contextmanager
def _npz_folder(out: Path, made_by: str) -> Iterator[Callable[[Frame, list[Record]], None]]:
    """Write a folder of NPZ files, visible once complete."""
    require(
        not (out.exists() and not (out.is_dir() and not any(out.iterdir()))),
        "the folder for the recording is not empty",
        path=out,
    )
    with temporary_folder(out) as partial:
        yield lambda frame, found: _write_arrays(partial, frame, found)
        (partial / MADE_BY_FILE).write_text(json.dumps({MADE_BY: made_by}), encoding="utf-8")
        if out.exists():
            out.rmdir()
        os.replace(partial, out)


def _write_arrays(folder: Path, frame: Frame, found: list[Record]) -> None:
    path = folder / (frame.id.replace("/", "__") + ".npz")
    require(not path.exists(), "two frames would have one file", got=frame.id, path=path)
    arrays: dict[str, Any] = {
        "boxes": np.array([f["bbox"] for f in found], np.float32).reshape(-1, 4),
        "scores": np.array([f["score"] for f in found], np.float32),
        "labels": np.array([f["label"] for f in found], np.str_),
        "mask_counts": np.array([f["mask"]["counts"].encode() if "mask" in f else b"" for f in found], np.bytes_),
        "mask_size": np.array([frame.height, frame.width]),
    }
    if all("id" in f for f in found):
        arrays["ids"] = np.array([f["id"] for f in found], np.int64)
    np.savez_compressed(path, **arrays)


ClassNames = Callable[[Frame], Sequence[str]]


def annotated_names(frame: Frame) -> tuple[str, ...]:
    """Classes in a frame, the names asked by expressions about it."""
    return tuple(dict.fromkeys(a.label for a in frame.annotations))


def collect_hits(
    pipeline: Pipeline,
    frame_ids: Sequence[str],
    class_names: ClassNames = annotated_names,
    *,
    progress: Callable[[int, int], None] | None = None,
    skipped: Callable[[str, str], None] | None = None,
    used: Callable[[Frame], None] | None = None,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Collect detections as `ask` gets them, with their hits.

    `pipeline`: of a dataset with annotations, with a detector; `frame_ids`: broken ones are left out, their reason to
    `skipped`; `class_names`: the names to be asked for in a frame, each by itself; names that the detector does not
    know are left out; `progress`: called with (frames done, frames in all); `used`: called with each frame that was not
    left out. Returns `scores` (N,) float64; `hits` (N,) bool; `frames` (N,) int64: which of `frame_ids` each is of.
    """
    detector = pipeline.needed_detector()
    require(not detector.exact, f"the detections of {detector.name!r} are the truth: there is nothing to calibrate")
    require(pipeline.dataset.class_names, "a calibration needs a dataset with annotations", path=pipeline.dataset.root)
    truth = AnnotationDetector(pipeline.dataset.class_names, pipeline.synonyms)
    parts: list[tuple[np.ndarray, np.ndarray, int]] = []
    for n, frame_id in enumerate(frame_ids):
        try:
            frame = pipeline.dataset.load(frame_id)
            parts += [(*pair, n) for pair in _of_frame(frame, detector, truth, class_names(frame), pipeline.config.k)]
            if used is not None:
                used(frame)
        except InputError as error:
            if skipped is not None:
                skipped(frame_id, str(error))
        if progress is not None:
            progress(n + 1, len(frame_ids))
    return (
        np.concatenate([np.zeros(0), *(s for s, _, _ in parts)]),
        np.concatenate([np.zeros(0, np.bool_), *(h for _, h, _ in parts)]),
        np.concatenate([np.zeros(0, np.int64), *(np.full(len(s), n) for s, _, n in parts)]),
    )


def _of_frame(
    frame: Frame, detector: Detector, truth: AnnotationDetector, names: Sequence[str], k: int
) -> list[tuple[np.ndarray, np.ndarray]]:
    pairs = []
    for name in names:
        try:
            found = top_k(detector.detect(frame, [name]), k)
        except UnknownClass:
            continue
        overlap = iou_2d(found.boxes, truth.detect(frame, [name]).boxes)
        pairs.append((found.scores.astype(np.float64), (overlap >= HIT_IOU).any(axis=1)))
    return pairs


def calibrate_scores(
    pipeline: Pipeline,
    frame_ids: Sequence[str],
    class_names: ClassNames = annotated_names,
    *,
    progress: Callable[[int, int], None] | None = None,
    skipped: Callable[[str, str], None] | None = None,
) -> tuple[ScoreCalibration, dict[str, Any]]:
    """Fit a detector's calibration on frames, and measure its effect by halves.

    The figures `after` are of each half of the frames, in their order, under the sigmoid that was fitted on the
    other half; the calibration itself is fitted on all.

    Returns
    -------
    report : dict
        `frames`, `detections`, `hits`, `fitted` (False for the identity), `before` and `after`: each with `brier`,
        `ece` (15 bins), `log_loss` and `reliability`, a list of {low, high, count, score, hits} by bin of score.
    """
    fitted_on: list[FittedFrame] = []
    dataset = pipeline.dataset

    def note(frame: Frame) -> None:
        fitted_on.append(FittedFrame(frame.id, scene_of(dataset, frame.id), frame.content_hash))

    scores, hits, frames = collect_hits(pipeline, frame_ids, class_names, progress=progress, skipped=skipped, used=note)
    require(len(scores), "the detector found nothing in these frames", cause="are they the right ones?")
    a, b = fit_scores(scores, hits)
    fingerprint = pipeline.needed_detector().fingerprint()
    calibration = ScoreCalibration(
        fingerprint,
        a,
        b,
        int(hits.sum()),
        int((~hits).sum()),
        pipeline.config.k,
        dataset.root.resolve().name,
        tuple(fitted_on),
    )
    first = frames < (len(frame_ids) + 1) // 2
    after = scores.astype(np.float64)
    for fold in (first, ~first):
        slope, offset = fit_scores(scores[~fold], hits[~fold])
        if (slope, offset) != IDENTITY:
            after[fold] = sigmoid(slope * score_logit(scores[fold]) + offset)
    report = {
        "frames": len(np.unique(frames)),
        "detections": len(scores),
        "hits": int(hits.sum()),
        "fewest": FEWEST_POSITIVES,
        "fitted": not calibration.identity,
        "before": reliability(scores, hits),
        "after": reliability(after, hits),
    }
    return calibration, report


def reliability(p: np.ndarray, hits: np.ndarray) -> dict[str, Any]:
    """Calibration figures of scores (N,) in 0..1, given the hits (N,) bool."""
    diagram = reliability_diagram(p, hits, RELIABILITY_BINS)
    rows = [
        {
            "low": round(float(diagram.edges[k]), 6),
            "high": round(float(diagram.edges[k + 1]), 6),
            "count": int(diagram.count[k]),
            "score": round(float(diagram.confidence[k]), 4),
            "hits": round(float(diagram.frequency[k]), 4),
        }
        for k in np.flatnonzero(diagram.count)
    ]
    q = np.clip(p, SCORE_LIMIT, 1 - SCORE_LIMIT)
    return {
        "brier": brier_score(p, hits),
        "ece": expected_calibration_error(p, hits),
        "log_loss": float(-np.where(hits, np.log(q), np.log1p(-q)).mean()),
        "reliability": rows,
    }
