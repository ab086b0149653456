"""OPM: detectors, proposals, and their selection: minimum score, non-maximum suppression, top K."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol, runtime_checkable

import numpy as np

from pipeline.geometry.boxes import iou_2d
from pipeline.geometry.frame import Frame
from pipeline.geometry.masks import MaskStack
from pipeline.language.naming import suggest
from pipeline.system.errors import InputError, UnknownClass, listed, require
from pipeline.system.frozen import dataclass


@dataclass(frozen=True)
class Proposals:
    """Detections of a run of a detector on a frame.

    Attributes
    ----------
    boxes : (N, 4) float32
        x0, y0, x1, y1 in pixels, continuous coordinates.
    scores : (N,) float32
        0..1.
    label_index : (N,) int64
        Which of `labels`.
    labels : tuple of str
        The names the detector gives; these may be more exact than what was asked for ("cracker box" for "box").
    masks : (N, H, W) bool or None
        None where the detector gives boxes only. A `MaskStack` stands for an array of all.
    ids : (N,) int64
        The detector's own identity of each detection: the same number in two runs means the same detection. For
        `annotations` it is the annotation's index.
    has_mask : (N,) bool or None
        False where the mask is only the filled 2D box; None means all as `masks` says.
    segmented : (N,) bool or None
        True where the mask was made from the box by a segmenter; None means nowhere.

    Examples
    --------
    >>> import numpy as np
    >>> from pipeline.proposals import Proposals
    >>> boxes = np.array([[10, 20, 60, 90], [12, 22, 61, 88]], np.float32)
    >>> found = Proposals(boxes, np.array([0.9, 0.6], np.float32), np.zeros(2, np.int64), ("mug",), None, np.arange(2))
    >>> found
    <Proposals 2: mug 0.90, mug 0.60>
    """

    boxes: np.ndarray
    scores: np.ndarray
    label_index: np.ndarray
    labels: tuple[str, ...]
    masks: np.ndarray | MaskStack | None
    ids: np.ndarray
    has_mask: np.ndarray | None = None
    segmented: np.ndarray | None = None

    def __post_init__(self) -> None:
        n = len(self.scores)
        require(
            self.boxes.shape == (n, 4) and self.label_index.shape == (n,) and self.ids.shape == (n,),
            "proposals must have boxes (N, 4) and scores, label_index and ids (N,)",
            got=f"{self.boxes.shape}, {self.scores.shape}, {self.label_index.shape}, {self.ids.shape}",
        )
        if self.masks is not None and (self.masks.dtype != np.bool_ or self.masks.ndim != 3 or len(self.masks) != n):
            raise InputError(
                "proposal masks must be bool (N, H, W)", got=f"{self.masks.dtype} {self.masks.shape} for {n} proposals"
            )
        require(
            not n or (np.isfinite(self.scores).all() and (self.scores >= 0).all() and (self.scores <= 1).all()),
            "proposal scores must lie in 0..1",
            got=lambda: f"{float(np.nanmin(self.scores)):.3g} to {float(np.nanmax(self.scores)):.3g}",
            cause="are these logits?",
        )
        require(not (n and not np.isfinite(self.boxes).all()), "proposal boxes must be finite")
        require(
            not n or not (self.boxes[:, 2:] < self.boxes[:, :2]).any(),
            "proposal boxes must be x0, y0, x1, y1 with x1 >= x0 and y1 >= y0",
            got=lambda: self.boxes[(self.boxes[:, 2:] < self.boxes[:, :2]).any(axis=1)][0].tolist(),
            cause="are they x, y, width, height?",
        )

    def __repr__(self) -> str:
        found = ", ".join(f"{self.label(i)} {self.scores[i]:.2f}" for i in range(min(len(self), 5)))
        return f"<Proposals {len(self)}: {found}{', ...' if len(self) > 5 else ''}>"

    def __len__(self) -> int:
        return len(self.scores)

    def label(self, i: int) -> str:
        return self.labels[int(self.label_index[i])]

    def take(self, index: np.ndarray) -> Proposals:
        """Proposals at `index` ((M,) int or (N,) bool), in that order; self for all."""
        if index.all() if index.dtype == np.bool_ else np.array_equal(index, np.arange(len(self))):
            # The masks of one answer are megabytes, and most answers are taken whole.
            return self
        return Proposals(
            self.boxes[index],
            self.scores[index],
            self.label_index[index],
            self.labels,
            None if self.masks is None else self.masks[index],
            self.ids[index],
            None if self.has_mask is None else self.has_mask[index],
            None if self.segmented is None else self.segmented[index],
        )


def no_proposals(height: int, width: int) -> Proposals:
    """Empty proposals."""
    return Proposals(
        np.zeros((0, 4), np.float32),
        np.zeros(0, np.float32),
        np.zeros(0, np.int64),
        (),
        np.zeros((0, height, width), np.bool_),
        np.zeros(0, np.int64),
    )


@runtime_checkable
class Detector(Protocol):
    """Finds objects by class name.

    Attributes
    ----------
    name : str
        As on the command line.
    vocabulary : tuple of str or None
        Class names the detector is limited to; None where any name will do.
    exact : bool
        Its detections are the truth: scores are taken as they are, and nothing is suppressed or cut off.

    Examples
    --------
    >>> from pipeline.datasets import demo_path, open_dataset
    >>> from pipeline.proposals import Detector, make_detector
    >>> demo = open_dataset(demo_path())
    >>> detector = make_detector("annotations", class_names=demo.class_names)
    >>> isinstance(detector, Detector), len(detector.detect(demo.load(demo.frame_ids[0]), ["mug"]))
    (True, 2)
    """

    @property
    def name(self) -> str: ...

    @property
    def vocabulary(self) -> tuple[str, ...] | None: ...

    @property
    def exact(self) -> bool: ...

    def fingerprint(self) -> str:
        """Cache key of the results, besides picture and names."""
        ...

    def detect(self, frame: Frame, labels: Sequence[str] | None) -> Proposals:
        """Detections of the given class names; None for everything known."""
        ...


def detect_expression(detector: Detector, frame: Frame, text: str) -> Proposals:
    """Detections of a whole expression: as a sentence where the detector can (`detect_expression`), else as a name."""
    own = getattr(detector, "detect_expression", None)
    return detector.detect(frame, [text]) if own is None else own(frame, text)


def reads_annotations(detector: Detector) -> bool:
    """Test whether the frame's annotations bear on the detector's results, by the attribute `reads_annotations`.

    A detector says it by an attribute `reads_annotations`; without one it may read them.
    """
    return bool(getattr(detector, "reads_annotations", True))


def is_final(detector: Detector) -> bool:
    """Test whether detections go on unchanged: nothing suppressed, cut off or calibrated."""
    return bool(getattr(detector, "final", detector.exact))


def told_by_ids(detector: Detector) -> bool:
    """Test whether only equal ids are the same thing, regardless of overlap."""
    return bool(getattr(detector, "told_by_ids", detector.exact))


def lists_things(detector: Detector) -> bool:
    """Test whether all detections of a frame are known without the picture: simulated, or recorded."""
    return bool(getattr(detector, "lists_things", False))


def unknown_class(label: str, names: Sequence[str], where: str, advice: str | None = None) -> UnknownClass:
    """Error for a class name outside a limited vocabulary, with `advice`."""
    close = suggest(label, names)
    hint = f"did you mean {' or '.join(repr(c) for c in close)}?" if close else "known: " + listed(names)
    hint += f"; {advice}" if advice else ""
    return UnknownClass(f"{where} does not know the class {label!r}", cause=hint)


NMS_IOU = 0.5
MAX_CANDIDATES = 1000
"""Boxes of a class that go into non-maximum suppression at most, best first."""


def top_k(proposals: Proposals, k: int, *, min_score: float = 0.0, nms_iou: float = NMS_IOU) -> Proposals:
    """The K best proposals after class-agnostic non-maximum suppression, best first."""
    return proposals.take(top_k_indices(proposals, k, min_score=min_score, nms_iou=nms_iou))


def top_k_indices(proposals: Proposals, k: int, *, min_score: float = 0.0, nms_iou: float = NMS_IOU) -> np.ndarray:
    """Indices (M,) int64 of the proposals selected by `top_k`."""
    order = np.argsort(-proposals.scores, kind="stable")
    order = order[proposals.scores[order] >= min_score]
    return order[suppress(proposals.boxes[order], nms_iou)][:k]


def suppress(boxes: np.ndarray, nms_iou: float = NMS_IOU) -> np.ndarray:
    """Indices of the boxes surviving non-maximum suppression, for boxes ((N, 4)) by falling score.

    Examples
    --------
    >>> import numpy as np
    >>> from pipeline.proposals import suppress
    >>> suppress(np.array([[0, 0, 10, 10], [1, 0, 10, 10], [20, 0, 30, 10]], float))
    array([0, 2])
    """
    overlap = iou_2d(boxes, boxes) > nms_iou
    alive = np.ones(len(boxes), np.bool_)
    for i in range(len(boxes)):
        if alive[i]:
            alive[i + 1 :] &= ~overlap[i, i + 1 :]
    return np.flatnonzero(alive)


def class_wise(
    boxes: np.ndarray, scores: np.ndarray, classes: np.ndarray, k: int, *, nms_iou: float = NMS_IOU
) -> np.ndarray:
    """Indices (M,) int64 of the best `k` of each class after suppression within the class, best first. `boxes` (N, 4)
    float; `scores` (N,) float; `classes` (N,) int."""
    order = np.argsort(-scores, kind="stable")
    kept = [np.zeros(0, np.int64)]
    for one in np.unique(classes):
        own = order[classes[order] == one][:MAX_CANDIDATES]
        kept.append(own[suppress(boxes[own], nms_iou)][:k])
    chosen = np.concatenate(kept)
    return chosen[np.argsort(-scores[chosen], kind="stable")]
