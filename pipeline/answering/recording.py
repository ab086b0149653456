"""Record a detector's output on a dataset, for `--detector recorded`."""

from __future__ import annotations

import json
import os
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np

from pipeline.answering.pipeline import Pipeline
from pipeline.geometry.frame import Frame
from pipeline.geometry.masks import encode_run_length
from pipeline.proposals.base import Detector, Proposals, top_k
from pipeline.proposals.recorded import MADE_BY, MADE_BY_FILE
from pipeline.system.errors import InputError, UnknownClass, require
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
    source: Pipeline,
    out: str | Path,
    class_names: Sequence[str] | None = None,
    progress: Callable[[int, int], None] | None = None,
    *,
    frame_ids: Sequence[str] | None = None,
) -> RecordingReport:
    """Run a detector over a dataset and write its detections.

    Parameters
    ----------
    source : Pipeline
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
    detector, out = source.needed_detector(), Path(out)
    chosen = source.dataset.frame_ids if frame_ids is None else tuple(frame_ids)
    skipped: dict[str, str] = {}
    unknown: dict[str, int] = {}
    classes: Counter[str] = Counter()
    frames = detections = 0
    writer = _json_file if out.suffix.lower() == ".json" else _npz_folder
    with writer(out, f"{detector.name}: {detector.fingerprint()}") as write:
        for done, frame_id in enumerate(chosen, start=1):
            try:
                frame = source.dataset.load(frame_id)
                found = findings(frame, detector, class_names, source.config.k, unknown)
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
            raise InputError("there is no usable frame to record", cause=reason, path=source.dataset.root)
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
