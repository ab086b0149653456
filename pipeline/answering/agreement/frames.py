"""Two detectors on the frames of a dataset, beside each other."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import Any

from pipeline.answering.agreement.agreement import (
    MIN_IOU,
    FrameAgreement,
    Layer,
    agree,
    figures,
    layer_of_proposals,
)
from pipeline.answering.opening import ALL_FRAMES, Pipeline, Skipped, frame_range, skip_or_raise
from pipeline.geometry.frame import Frame
from pipeline.language.naming import Synonyms
from pipeline.proposals.base import Detector
from pipeline.proposals.class_names import known_names, knows
from pipeline.system.errors import InputError, require


def find_layer(
    frame: Frame, detector: Detector, names: Sequence[str] | None = None, synonyms: Synonyms | None = None
) -> Layer:
    """What a detector finds in a frame of the given names, without those that it does not know; None for everything."""
    if names is None:
        return layer_of_proposals(detector.detect(frame, None), known_names(detector))
    known = [name for name in names if knows(detector.vocabulary, name, synonyms)]
    require(known, f"the detector {detector.name} knows none of the names", got=", ".join(names))
    return layer_of_proposals(detector.detect(frame, known), known)


def agree_frames(
    source: Pipeline,
    second: Detector,
    frames: str = ALL_FRAMES,
    *,
    names: Sequence[str] | None = None,
    min_iou: float = MIN_IOU,
    skipped: Skipped | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> Iterator[tuple[str, FrameAgreement]]:
    """Compare the detections of two detectors frame by frame.

    Parameters
    ----------
    source : Pipeline
        With the first detector.
    second : Detector
    frames : str
        As in `pipeline.answering.opening.frame_range`.
    names : sequence of str, optional
        What both are asked for. Default: everything that each knows.
    min_iou : float
        As in `pipeline.answering.agreement.agreement.agree`.
    skipped : callable, optional
        Told of each frame that cannot be used, where all were asked for.
    progress : callable, optional
        Called with (frames done, frames in all).

    Yields
    ------
    (frame id, FrameAgreement)

    Raises
    ------
    InputError
        A frame that was asked for by name is broken; a detector knows none of the names.
    """
    detector = source.needed_detector()
    if names is not None:
        for one in (detector, second):
            require(
                any(knows(one.vocabulary, name, source.synonyms) for name in names),
                f"the detector {one.name} knows none of the names",
                got=", ".join(names),
            )
    chosen = frame_range(source.dataset, frames)
    named = frames if len(chosen) == 1 else ALL_FRAMES
    for done, frame_id in enumerate(chosen, start=1):
        try:
            frame = source.dataset.load(frame_id)
            layers = [find_layer(frame, one, names, source.synonyms) for one in (detector, second)]
            found = agree(*layers, min_iou=min_iou, synonyms=source.synonyms)
        except InputError as error:
            skip_or_raise(error, named, frame_id, skipped)
        else:
            yield frame_id, found
        if progress is not None:
            progress(done, len(chosen))


def agreement_record(frame_id: str, found: FrameAgreement, synonyms: Synonyms | None = None) -> dict[str, Any]:
    """One frame: the figures, and every detection by its place in its detector's list."""
    sums = figures([found], synonyms).record()
    del sums["frames"], sums["classes"]

    def one(label: str, score: Any, nearest: Any = None) -> dict[str, Any]:
        found = {} if nearest is None else {"nearest_iou": round(float(nearest), 6)}
        return {"label": label, "score": round(float(score), 6), **found}

    pairs = [
        {
            "a": {"index": int(i), **one(found.labels_a[i], found.scores_a[i])},
            "b": {"index": int(j), **one(found.labels_b[j], found.scores_b[j])},
            "iou": round(float(iou), 6),
            "same_name": bool(same),
        }
        for (i, j), iou, same in zip(found.pairs, found.iou, found.same, strict=True)
    ]
    return {
        "frame": frame_id,
        **sums,
        "pairs": pairs,
        "alone_a": [
            {"index": int(i), **one(found.labels_a[i], found.scores_a[i], found.nearest_a[i])} for i in found.only_a
        ],
        "alone_b": [
            {"index": int(j), **one(found.labels_b[j], found.scores_b[j], found.nearest_b[j])} for j in found.only_b
        ],
    }
