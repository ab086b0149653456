"""Ensemble of detectors with fused detections.

Weighted boxes fusion, where boxes of several detectors become one where they overlap: Solovyev, Wang and Gabruseva,
"Weighted boxes fusion: ensembling boxes from different object detection models", Image and Vision Computing 107, 2021
(arXiv:1910.13302), with weight 1 for every detector. The authors' library needs numba and pandas and has had no release
since 2022; the tests hold figures that it gave.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal, get_args

import numpy as np
import xxhash

from pipeline.geometry.boxes import iou_2d
from pipeline.geometry.frame import Frame
from pipeline.language.naming import Synonyms
from pipeline.proposals.annotations import box_mask
from pipeline.proposals.base import (
    NMS_IOU,
    Detector,
    Proposals,
    detect_expression,
    no_proposals,
    reads_annotations,
    suppress,
    unknown_class,
)
from pipeline.proposals.class_names import known_names, knows, name_groups, same_name
from pipeline.system.errors import require
from pipeline.system.frozen import dataclass

Fusion = Literal["wbf", "nms"]
FUSIONS: tuple[str, ...] = get_args(Fusion)
_ID_BITS = 53
"""So many are whole numbers to every reader of JSON."""


class EnsembleDetector:
    """Several detectors, run and fused.

    With "wbf" (weighted boxes fusion) a fused box is the mean of the members' boxes, weighted by score, and what few of
    the detectors that know its class have found loses score. With "nms" everything stands as it is, but for what
    overlaps a detection of higher score in the same class. Either way the mask is that of the member with the highest
    score that has one, and the name that of the highest score.

    A class that a member does not know is asked of the others. Detections are fused within a class; what answers one
    name, or a whole expression, is of one class. The order of the members does not matter.
    """

    exact = False

    def __init__(self, members: Sequence[Detector], fusion: str = "wbf", synonyms: Synonyms | None = None) -> None:
        require(len(members) >= 2, "at least two detectors are needed to fuse them", got=len(members))
        require(fusion in FUSIONS, f"there is no fusion {fusion!r}", expected=" or ".join(FUSIONS))
        self.members = tuple(members)
        self.name = "&".join(member.name for member in members)
        self.fusion = fusion
        self.synonyms = synonyms

    @property
    def vocabulary(self) -> tuple[str, ...] | None:
        return _together([member.vocabulary for member in self.members])

    @property
    def default_labels(self) -> tuple[str, ...] | None:
        """Names for a request of everything; None for any name."""
        return _together([known_names(member) for member in self.members])

    @property
    def reads_annotations(self) -> bool:
        return any(reads_annotations(member) for member in self.members)

    def fingerprint(self) -> str:
        return f"ensemble:{self.fusion}:" + "&".join(sorted(member.fingerprint() for member in self.members))

    def detect(self, frame: Frame, labels: Sequence[str] | None) -> Proposals:
        if labels is None:
            found = [member.detect(frame, None) for member in self.members]
            return self._fused(frame, found, [known_names(member) for member in self.members])
        for label in labels:
            if not any(knows(member.vocabulary, label, self.synonyms) for member in self.members):
                names = [name for member in self.members for name in member.vocabulary or ()]
                raise unknown_class(label, names, "none of the detectors")
        found, known = [], []
        for member in self.members:
            own = [label for label in labels if knows(member.vocabulary, label, self.synonyms)]
            if own:
                found.append(member.detect(frame, own))
                known.append(own)
        return self._fused(frame, found, known, one=labels[0] if len(labels) == 1 else None)

    def detect_expression(self, frame: Frame, text: str) -> Proposals:
        """Fused detections of a whole expression, as a single class."""
        found = [detect_expression(member, frame, text) for member in self.members]
        return self._fused(frame, found, [None] * len(found), one=text)

    def _fused(
        self,
        frame: Frame,
        found: Sequence[Proposals],
        known: Sequence[Sequence[str] | None],
        one: str | None = None,
    ) -> Proposals:
        """Fused answer; `known` are the names asked of each member, `one` the only name if any."""
        labels = [p.label(i) for p in found for i in range(len(p))]
        if not labels:
            return no_proposals(frame.height, frame.width)
        boxes = np.concatenate([p.boxes for p in found]).astype(np.float32)
        scores = np.concatenate([p.scores for p in found]).astype(np.float32)
        groups = dict.fromkeys(labels, one) if one is not None else name_groups(labels, self.synonyms)
        names = sorted({str(name) for name in groups.values()})
        classes = np.array([names.index(str(groups[label])) for label in labels], np.int64)
        if self.fusion == "wbf":
            # Detectors asked for `own` names (None: any) that could have said a name.
            could = [
                len(found)
                if one is not None
                else sum(own is None or any(same_name(n, name, self.synonyms) for n in own) for own in known)
                for name in names
            ]
            fused = fuse_boxes(boxes, scores, classes, np.array(could, np.int64), FUSION_IOU)
        else:
            fused = _suppressed(boxes, scores, classes)
        return _proposals(frame, fused, labels, found)


def _together(known: Sequence[tuple[str, ...] | None]) -> tuple[str, ...] | None:
    """Union of known names; None if any member knows all names."""
    names = {name for own in known for name in own or ()}
    return None if None in known else tuple(sorted(names))


def _suppressed(boxes: np.ndarray, scores: np.ndarray, classes: np.ndarray) -> FusedBoxes:
    """Union after non-maximum suppression within each class, each box a cluster."""
    order = falling(boxes, scores)
    kept = [own[suppress(boxes[own], NMS_IOU)] for own in (order[classes[order] == k] for k in np.unique(classes))]
    chosen = np.concatenate(kept)
    chosen = chosen[falling(boxes[chosen], scores[chosen])]
    members = tuple(np.array([i]) for i in chosen)
    return FusedBoxes(boxes[chosen].astype(np.float64), scores[chosen].astype(np.float64), classes[chosen], members)


def _proposals(frame: Frame, fused: FusedBoxes, labels: Sequence[str], found: Sequence[Proposals]) -> Proposals:
    """Fused boxes with the best member's name and the best available mask."""
    shape = (frame.height, frame.width)
    own = [(p, i) for p in found for i in range(len(p))]
    named = [labels[int(members[0])] for members in fused.members]
    names = tuple(dict.fromkeys(named))
    boxes = fused.boxes.astype(np.float32)
    masked = [next((own[int(i)] for i in members if _has_mask(*own[int(i)])), None) for members in fused.members]
    masks = None
    if any(member is not None for member in masked):
        made = [_mask(member, box, shape) for member, box in zip(masked, boxes, strict=True)]
        masks = np.stack(made)
    has_mask = np.array([member is not None for member in masked])
    return Proposals(
        boxes,
        np.clip(fused.scores, 0, 1).astype(np.float32),
        np.array([names.index(name) for name in named], np.int64),
        names,
        masks,
        np.array([_identity(box, None if masks is None else masks[n]) for n, box in enumerate(boxes)], np.int64),
        has_mask,
        np.array([m is not None and m[0].segmented is not None and bool(m[0].segmented[m[1]]) for m in masked]),
    )


def _has_mask(found: Proposals, i: int) -> bool:
    return found.masks is not None and (found.has_mask is None or bool(found.has_mask[i]))


def _mask(member: tuple[Proposals, int] | None, box: np.ndarray, shape: tuple[int, int]) -> np.ndarray:
    if member is None or member[0].masks is None:
        return box_mask(box, *shape)
    return member[0].masks[member[1]]


def _identity(box: np.ndarray, mask: np.ndarray | None) -> int:
    """Hash of box and mask as an id, stable from run to run."""
    digest = xxhash.xxh3_64(box.tobytes())
    if mask is not None:
        digest.update(np.packbits(mask).tobytes())
    return digest.intdigest() >> (64 - _ID_BITS)


FUSION_IOU = 0.55
"""The paper's threshold."""


@dataclass(frozen=True)
class FusedBoxes:
    """Clusters of boxes, the most certain first."""

    boxes: np.ndarray  # (C, 4) float64: Means of the members' boxes, weighted by their scores
    scores: np.ndarray  # (C,) float64: Means of their scores, less where few detectors found the thing
    classes: np.ndarray  # (C,) int64
    members: tuple[np.ndarray, ...]
    """tuple of (M,) int64: Places in the input of each cluster's boxes, the highest score first."""


def falling(boxes: np.ndarray, scores: np.ndarray) -> np.ndarray:
    """Order (N,) int64 by falling score; ties are ordered by box."""
    return np.lexsort((*np.asarray(boxes, np.float64).reshape(-1, 4).T[::-1], -np.asarray(scores)))


def fuse_boxes(
    boxes: np.ndarray, scores: np.ndarray, classes: np.ndarray, detectors: np.ndarray, iou: float = FUSION_IOU
) -> FusedBoxes:
    """Weighted boxes fusion of the boxes of several detectors, within each class.

    `boxes` (N, 4) float: x0, y0, x1, y1 of all detectors; `scores` (N,) float: 0..1; `classes` (N,) int: Numbers
    from 0; `detectors` (K,) int: How many detectors could have found each class.
    """
    boxes, scores = np.asarray(boxes, np.float64).reshape(-1, 4), np.asarray(scores, np.float64)
    means = np.empty_like(boxes)
    kinds = np.full(len(boxes), -1, np.int64)
    members: list[list[int]] = []
    for i in falling(boxes, scores).tolist():
        count = len(members)
        overlap = np.where(kinds[:count] == classes[i], iou_2d(boxes[i], means[:count])[0], 0.0)
        best = int(overlap.argmax()) if count else -1
        if best < 0 or overlap[best] <= iou:
            best = count
            members.append([])
            kinds[best] = classes[i]
        members[best].append(i)
        means[best] = _mean(boxes[members[best]], scores[members[best]])
    count = len(members)
    clusters = tuple(np.array(m, np.int64) for m in members)
    fused = np.array([scores[m].mean() for m in clusters]).reshape(count)
    could = np.maximum(np.asarray(detectors)[kinds[:count]], 1)
    fused *= np.minimum([len(m) for m in clusters], could) / could
    order = falling(means[:count], fused)
    return FusedBoxes(means[:count][order], fused[order], kinds[:count][order], tuple(clusters[k] for k in order))


def _mean(boxes: np.ndarray, scores: np.ndarray) -> np.ndarray:
    weights = scores if scores.sum() > 0 else np.ones(len(scores))
    mean = weights @ boxes / weights.sum()
    # Rounding may put it a hair outside what it is the mean of.
    return np.clip(mean, boxes.min(axis=0), boxes.max(axis=0))
