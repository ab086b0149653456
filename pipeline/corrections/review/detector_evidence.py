"""What a second detector says otherwise of the objects of labels: it sees none, calls one by another name, sees more.

The detector looks at the labelled frames, at everything it knows. An object is
seen where a detection overlaps its 2D box with an IoU of at least SAME_BOX_IOU.
A detector speaks only of what it knows: where the object's class is not in its
vocabulary, that it does not see it says nothing, and another name little.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from pipeline.answering.opening import Pipeline
from pipeline.corrections.review.evidence import DISPUTED, SAME_BOX_IOU, UNMATCHED, WARNED, ItemEvidence
from pipeline.corrections.review.items import ItemKey, missing_object
from pipeline.datasets import Dataset
from pipeline.geometry.boxes import iou_2d
from pipeline.labels.reading import Labels
from pipeline.language.naming import Synonyms, match, same_or_kind
from pipeline.proposals.base import Detector, Proposals
from pipeline.proposals.registry import made_by
from pipeline.system.detector_setup import DetectorSetup
from pipeline.system.errors import InputError
from pipeline.training.label_data import column_arrays, rows_of_frame

LEAST_SCORE = 0.5
"""Detections below this are no evidence of anything; but they see what is there."""


@dataclass(frozen=True)
class SecondDetector:
    """What a detector says of labels.

    Attributes
    ----------
    items : tuple of ItemEvidence
        Against objects, and for places where one may be missing.
    frames : int
        Looked at.
    skipped : dict of str to str
        Frames that it could not look at, and why.
    """

    items: tuple[ItemEvidence, ...]
    frames: int
    skipped: dict[str, str]


def detector_evidence(
    labels: Labels,
    dataset: Dataset,
    detector: Detector,
    *,
    synonyms: Synonyms | None = None,
    progress: Callable[[int, int], None] | None = None,
    name: str | None = None,
) -> SecondDetector:
    """Let a detector look at the frames of labels.

    Parameters
    ----------
    labels : Labels
    dataset : Dataset
        The one that they were made from.
    detector : Detector
    synonyms : Synonyms, optional
        Names that mean the same are no dispute.
    progress : callable, optional
        Called with (frames done, of how many).
    name : str, optional
        What the detector is called. Default: its own name.

    Raises
    ------
    InputError
        Not one of the frames can be looked at.
    """
    objects = column_arrays(labels.objects.select(["frame_index", "object", "label", "bbox"]))
    frames = [row for row in labels.frames.select(["frame", "frame_index", "ok"]).to_pylist() if row["ok"]]
    items: list[ItemEvidence] = []
    skipped: dict[str, str] = {}
    for done, row in enumerate(frames, start=1):
        mine = rows_of_frame(objects["frame_index"], row["frame_index"])
        try:
            found = detector.detect(dataset.load(row["frame"]), None)
        except InputError as error:
            skipped[row["frame"]] = str(error)
        except Exception as error:  # A network's own failure: its words, in one line.
            skipped[row["frame"]] = f"{type(error).__name__}: {str(error).strip()}".split("\n")[0].removesuffix(": ")
        else:
            numbers, names, boxes = (objects[name][mine] for name in ("object", "label", "bbox"))
            items += compared(row["frame"], numbers, names, boxes, found, detector, synonyms, name)
        if progress is not None:
            progress(done, len(frames))
    if frames and len(skipped) == len(frames):
        first = next(iter(skipped.values()))
        raise InputError(f"the detector {name or detector.name} could look at none of the labelled frames", got=first)
    return SecondDetector(tuple(items), len(frames) - len(skipped), skipped)


def compared(
    frame: str,
    numbers: np.ndarray,
    names: np.ndarray,
    boxes: np.ndarray,
    found: Proposals,
    detector: Detector,
    synonyms: Synonyms | None = None,
    name: str | None = None,
) -> Iterator[ItemEvidence]:
    """What detections say against the objects of one frame.

    Parameters
    ----------
    frame : str
    numbers, names, boxes : (N,) int, (N,) str, (N, 4) float
        Of the labels; boxes x0, y0, x1, y1.
    found : Proposals
    detector : Detector
        Whose they are.
    synonyms : Synonyms, optional
    name : str, optional
        What the detector is called.
    """
    called, vocabulary = name or detector.name, detector.vocabulary

    @lru_cache
    def same(label: str, detected: str) -> bool:
        # A more general name is no other name: the detector's "box" is the labels' "cracker box".
        return same_or_kind(label, detected, synonyms)

    @lru_cache
    def knows(label: str) -> bool:
        return vocabulary is None or bool(match(label, vocabulary, synonyms))

    iou = iou_2d(boxes.reshape(-1, 4), found.boxes.astype(np.float64)) if len(numbers) else np.zeros((0, len(found)))
    here = iou >= SAME_BOX_IOU
    classes = [found.label(k) for k in range(len(found))]
    for row, (number, label) in enumerate(zip(numbers.tolist(), names.tolist(), strict=True)):
        key = ItemKey(frame, "object", number, None, "")
        at = np.flatnonzero(here[row])
        if not len(at):
            if knows(label):
                yield ItemEvidence(key, UNMATCHED, f"the detector {called} sees no object here")
            continue
        if any(same(label, classes[k]) for k in at.tolist()):
            continue
        best = int(at[np.lexsort((-iou[row, at], -found.scores[at]))[0]])
        score = float(found.scores[best])
        if score < LEAST_SCORE:
            continue
        reason = f"the detector {called} calls it {classes[best]!r} (score {score:.2f})"
        known = knows(label)
        yield ItemEvidence(
            key, DISPUTED if known else WARNED, f"{reason}{'' if known else f', and knows no {label!r}'}"
        )
    yield from _missing(frame, found, np.asarray(here.any(axis=0)), classes, called)


def _missing(
    frame: str, found: Proposals, covered: np.ndarray, classes: list[str], detector: str
) -> Iterator[ItemEvidence]:
    """Detections that are no object of the labels; of several of one place the surest."""
    left = np.flatnonzero(~covered & (found.scores >= LEAST_SCORE))
    left = left[np.argsort(-found.scores[left], kind="stable")]
    iou = iou_2d(found.boxes[left].astype(np.float64), found.boxes[left].astype(np.float64))
    shown = np.zeros(len(left), np.bool_)
    locations = set()
    for n, k in enumerate(left.tolist()):
        key = missing_object(frame, found.boxes[k].tolist())
        shown[n] = not (iou[n] >= SAME_BOX_IOU)[shown].any() and key not in locations
        if shown[n]:
            locations.add(key)
            score = float(found.scores[k])
            reason = f"the detector {detector} sees {classes[k]!r} here (score {score:.2f}), and the labels nothing"
            yield ItemEvidence(key, UNMATCHED * score, reason, classes[k])


def second_setup(source: Pipeline, labels: Labels) -> tuple[str, DetectorSetup] | None:
    """The detector that can say something new of labels: the one beside the source's, else the source's own.

    One that the labels were made from is none; None where there is no other.

    Returns
    -------
    (its name, see `Pipeline.detector_names`; what it is made from)
    """
    maker = labels.manifest.models.get("detector")
    own, other = source.detector_names
    known = ((other, source.second_detector, source.second_setup), (own, source.detector, source.setup))
    return next(((name, s) for name, d, s in known if d is not None and s is not None and not made_by(maker, d)), None)
