"""The job of `spatialviz agree`: two detectors on the frames of a dataset."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence

from pipeline.errors import InputError
from pipeline.frame import Frame
from pipeline.jobs import ALL_FRAMES, Skipped, Source, frame_range, skip_or_raise
from pipeline.naming import Synonyms
from pipeline.proposals.agreement import MIN_IOU, FrameAgreement, Layer, agree, layer_of_proposals
from pipeline.proposals.base import Detector
from pipeline.proposals.known_names import known_names, knows


def find_layer(
    frame: Frame, detector: Detector, names: Sequence[str] | None = None, synonyms: Synonyms | None = None
) -> Layer:
    """What a detector finds in a frame of the given names, without those that it does not know; None for everything."""
    if names is None:
        return layer_of_proposals(detector.detect(frame, None), known_names(detector))
    known = [name for name in names if knows(detector.vocabulary, name, synonyms)]
    if not known:
        raise InputError(f"the detector {detector.name} knows none of the names", got=", ".join(names))
    return layer_of_proposals(detector.detect(frame, known), known)


def agree_frames(
    source: Source,
    frames: str = ALL_FRAMES,
    *,
    names: Sequence[str] | None = None,
    min_iou: float = MIN_IOU,
    skipped: Skipped | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> Iterator[tuple[str, FrameAgreement]]:
    """How far the source's detector agrees with the one beside it, frame by frame.

    Parameters
    ----------
    source : Source
        With a detector and another `beside` it.
    frames : str
        As in `pipeline.jobs.frame_range`.
    names : sequence of str, optional
        What both are asked for. Default: everything that each knows.
    min_iou : float
        As in `pipeline.proposals.agreement.agree`.
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
        There is no second detector; a frame that was asked for by name is broken; a detector knows none of the names.
    """
    detector, beside = source.needed_detector(), source.beside
    if beside is None:
        raise InputError("there is nothing to compare the detector with", expected="--also NAME or --also NAME=MODEL")
    if names is not None:
        for one in (detector, beside):
            if not any(knows(one.vocabulary, name, source.synonyms) for name in names):
                raise InputError(f"the detector {one.name} knows none of the names", got=", ".join(names))
    chosen = frame_range(source.dataset, frames)
    named = frames if len(chosen) == 1 else ALL_FRAMES
    for done, frame_id in enumerate(chosen, start=1):
        try:
            frame = source.dataset.load(frame_id)
            layers = [find_layer(frame, one, names, source.synonyms) for one in (detector, beside)]
            found = agree(*layers, min_iou=min_iou, synonyms=source.synonyms)
        except InputError as error:
            skip_or_raise(error, named, frame_id, skipped)
        else:
            yield frame_id, found
        if progress is not None:
            progress(done, len(chosen))
