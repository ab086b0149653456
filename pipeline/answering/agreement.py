"""Agreement of two detectors: detections of the same object, detections by one alone, and summary figures."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from pipeline.answering.pipeline import ALL_FRAMES, Pipeline, Skipped, frame_range, skip_or_raise
from pipeline.geometry.boxes import iou_2d
from pipeline.geometry.frame import Frame
from pipeline.language.naming import Synonyms
from pipeline.metrics.intervals import cohen_kappa
from pipeline.proposals.base import Detector, Proposals
from pipeline.proposals.class_names import known_names, knows, name_groups, same_name, same_names
from pipeline.system.errors import InputError, require

MIN_IOU = 0.5
"""Two detections that overlap less are not of one thing."""


@dataclass(frozen=True)
class Layer:
    """Detections of a detector in a frame."""

    boxes: np.ndarray  # (N, 4) float: x0, y0, x1, y1 in pixels
    scores: np.ndarray  # (N,) float
    labels: tuple[str, ...]
    masks: tuple[np.ndarray | None, ...]  # tuple of ((H, W) bool or None): none where there is only the box
    names: tuple[str, ...] | None = None  # What the detector can find; None where that is anything

    def __len__(self) -> int:
        return len(self.labels)


def layer_of_proposals(found: Proposals, names: Sequence[str] | None = None) -> Layer:
    """Layer of a detector's proposals; `names` are the asked names."""
    has = np.ones(len(found), np.bool_) if found.has_mask is None else found.has_mask
    masks = tuple(found.masks[i] if found.masks is not None and has[i] else None for i in range(len(found)))
    labels = tuple(found.label(i) for i in range(len(found)))
    return Layer(found.boxes, found.scores, labels, masks, None if names is None else tuple(names))


@dataclass(frozen=True)
class FrameAgreement:
    """Two matched layers of a frame."""

    labels_a: tuple[str, ...]
    labels_b: tuple[str, ...]
    # scores_a, scores_b: (N,), (M,) float64
    scores_a: np.ndarray
    scores_b: np.ndarray
    # pairs: (P, 2) int64: places in `a` and in `b` of detections of one thing; each detection is in one pair at most
    pairs: np.ndarray
    iou: np.ndarray  # (P,) float64: by masks where both have one, else by boxes
    same: np.ndarray  # (P,) bool: both gave it the same name
    # beyond_a, beyond_b: (N,), (M,) bool: in no pair, and of a class that the other detector does not know: no
    # disagreement
    beyond_a: np.ndarray
    beyond_b: np.ndarray
    # nearest_a, nearest_b: (N,), (M,) float64: the greatest overlap with anything of the other detector
    nearest_a: np.ndarray
    nearest_b: np.ndarray

    @property
    def only_a(self) -> np.ndarray:
        """(K,) int64: detections of the first alone, though the other knows the class; highest score first."""
        return _alone(self.scores_a, self.pairs[:, 0], self.beyond_a)

    @property
    def only_b(self) -> np.ndarray:
        """(K,) int64: detections of the second alone, though the other knows the class; highest score first."""
        return _alone(self.scores_b, self.pairs[:, 1], self.beyond_b)

    @property
    def named_otherwise(self) -> np.ndarray:
        """(K,) int64: places in `pairs` with differing names, highest scores first."""
        found = np.flatnonzero(~self.same)
        return found[np.argsort(-self.pair_scores[found].max(axis=1), kind="stable")]

    @property
    def pair_scores(self) -> np.ndarray:
        """(P, 2) float64: the scores of each pair."""
        return np.stack([self.scores_a[self.pairs[:, 0]], self.scores_b[self.pairs[:, 1]]], axis=1)


def agree(a: Layer, b: Layer, *, min_iou: float = MIN_IOU, synonyms: Synonyms | None = None) -> FrameAgreement:
    """Match the detections of two detectors, each at most once.

    Of all ways to pair detections that overlap by `min_iou` or more, the one with the most pairs of the same name,
    among these the one with the most pairs, among these the one with the greatest sum of overlaps. So the counts depend
    neither on the order of the detections nor on which detector comes first.

    `a`, `b`: of the same frame; `min_iou`: above 0, at most 1; `synonyms`: which names mean the same.
    """
    require(0 < min_iou <= 1, "the least overlap must be above 0 and at most 1", got=min_iou)
    overlap = overlaps(a, b)
    same = same_names(a.labels, b.labels, synonyms)
    pairs = matched(overlap, same, min_iou)
    i, j = pairs.T
    return FrameAgreement(
        a.labels,
        b.labels,
        np.asarray(a.scores, np.float64),
        np.asarray(b.scores, np.float64),
        pairs,
        overlap[i, j],
        same[i, j],
        _beyond(a, b, i, synonyms),
        _beyond(b, a, j, synonyms),
        overlap.max(axis=1, initial=0.0),
        overlap.max(axis=0, initial=0.0),
    )


def matched(overlap: np.ndarray, same: np.ndarray, min_iou: float) -> np.ndarray:
    """(P, 2) int64: best matching of overlaps (N, M) and `same` names (N, M) bool, as in `agree`."""
    from scipy.optimize import linear_sum_assignment

    allowed = (overlap >= min_iou) & (overlap > 0)
    if not allowed.any():
        return np.zeros((0, 2), np.int64)
    # More than all overlaps together can sum up to: so a pair more always outweighs them, and a name outweighs both.
    much = min(overlap.shape) + 1.0
    value = np.where(allowed, overlap + much + much * much * same, 0.0)
    row, column = linear_sum_assignment(value, maximize=True)
    fits = allowed[row, column]
    return np.stack([row[fits], column[fits]], axis=1).astype(np.int64)


def overlaps(a: Layer, b: Layer) -> np.ndarray:
    """(N, M) float64: intersection over union, by masks where both have any, else by boxes."""
    found = iou_2d(a.boxes, b.boxes)
    rows = [i for i, mask in enumerate(a.masks) if mask is not None]
    columns = [j for j, mask in enumerate(b.masks) if mask is not None]
    if not rows or not columns:
        return found
    from pycocotools import mask as coco

    masks_a, masks_b = ([m for m in layer.masks if m is not None] for layer in (a, b))
    sizes = {m.shape for m in (*masks_a, *masks_b)}
    if len(sizes) > 1:
        raise InputError("the masks of two detectors must be of one size", got=" and ".join(map(str, sorted(sizes))))
    codes_a, codes_b = ([coco.encode(np.asfortranarray(m.view(np.uint8))) for m in ms] for ms in (masks_a, masks_b))
    iou = coco.iou(codes_a, codes_b, [0] * len(codes_b))
    found[np.ix_(rows, columns)] = np.nan_to_num(np.asarray(iou, np.float64))
    return found


def _beyond(own: Layer, other: Layer, paired: np.ndarray, synonyms: Synonyms | None) -> np.ndarray:
    known = {label: knows(other.names, label, synonyms) for label in set(own.labels)}
    beyond = np.array([not known[label] for label in own.labels], np.bool_)
    beyond[paired] = False
    return beyond


def _alone(scores: np.ndarray, paired: np.ndarray, beyond: np.ndarray) -> np.ndarray:
    alone = ~beyond
    alone[paired] = False
    found = np.flatnonzero(alone)
    return found[np.argsort(-scores[found], kind="stable")]


def figures(found: Iterable[FrameAgreement], synonyms: Synonyms | None = None) -> dict[str, Any]:
    """Sums over frames as JSON, rounded to 1e-6; `synonyms` are those of the comparison.

    Returns frames; a, b : detections of each, without those of classes that the other does not know; both : things that
    both found under the same name; otherwise : that they name differently; only_a, only_b; beyond_a, beyond_b : found
    alone, of classes that the other does not know, which count nowhere else. share : 2 both / (a + b), the positive
    specific agreement. Cohen's kappa tends to it where the places without any object are beyond counting, as in
    pictures (Hripcsak and Rothschild, JAMIA 12, 2005); share_placed : the same whatever the names; None where neither
    found anything. name_kappa : Cohen's kappa of the names of what both found, None where there is no choice of names;
    mean_iou, score_correlation (Spearman's; None for fewer than three, or equal scores) : of what both found. classes :
    the most frequent first, each with name, a, b, both, otherwise, only_a, only_b, share, mean_iou; a thing that is
    named otherwise stands with both its names, under those of the first detector where it has them. renamed : [name,
    other name, count], the commonest first.
    """
    frames = list(found)
    scores = np.concatenate([np.zeros((0, 2)), *(f.pair_scores for f in frames)])
    iou = np.concatenate([np.zeros(0), *(f.iou for f in frames)])
    both = sum(int(f.same.sum()) for f in frames)
    otherwise = sum(int((~f.same).sum()) for f in frames)
    only_a, only_b = sum(len(f.only_a) for f in frames), sum(len(f.only_b) for f in frames)
    a, b = both + otherwise + only_a, both + otherwise + only_b
    counts = Counter((f.labels_a[i], f.labels_b[j]) for f in frames for i, j in f.pairs[~f.same].tolist())
    return {
        "frames": len(frames),
        "a": a,
        "b": b,
        "both": both,
        "otherwise": otherwise,
        "only_a": only_a,
        "only_b": only_b,
        "beyond_a": sum(int(f.beyond_a.sum()) for f in frames),
        "beyond_b": sum(int(f.beyond_b.sum()) for f in frames),
        "share": _share(both, a, b),
        "share_placed": _share(both + otherwise, a, b),
        "name_kappa": _name_kappa(frames, synonyms),
        "mean_iou": _mean(iou),
        "score_correlation": rank_correlation(scores[:, 0], scores[:, 1]),
        "classes": _classes(frames, synonyms),
        "renamed": [[*names, n] for names, n in sorted(counts.items(), key=lambda item: (-item[1], item[0]))],
    }


def rank_correlation(a: np.ndarray, b: np.ndarray) -> float | None:
    """Spearman's correlation, ties with their mean rank; None for fewer than three values, or equal ones."""
    from scipy.stats import spearmanr

    if len(a) < 3 or np.ptp(a) == 0 or np.ptp(b) == 0:
        return None
    return round(float(np.asarray(spearmanr(a, b))[0]), 6)


def _share(both: int, a: int, b: int) -> float | None:
    return round(2 * both / (a + b), 6) if a + b else None


def _mean(values: np.ndarray | Sequence[float]) -> float | None:
    return round(float(np.mean(values)), 6) if len(values) else None


def _name_kappa(frames: Iterable[FrameAgreement], synonyms: Synonyms | None) -> float | None:
    named = [
        (f.labels_a[i], f.labels_b[j], same)
        for f in frames
        for (i, j), same in zip(f.pairs.tolist(), f.same.tolist(), strict=True)
    ]
    # Two words for one class are one name.
    stands = name_groups([label for a, b, _ in named for label in (a, b)], synonyms)
    apart = [not same and stands[a] == stands[b] for a, b, same in named]
    first, second = ([row[k] if own else stands[row[k]] for row, own in zip(named, apart, strict=True)] for k in (0, 1))
    kappa = cohen_kappa(first, second).kappa if first else math.nan
    return round(kappa, 6) if math.isfinite(kappa) else None


def _classes(frames: list[FrameAgreement], synonyms: Synonyms | None) -> list[dict[str, Any]]:
    names_a = list(dict.fromkeys(label for f in frames for label in f.labels_a))
    names_b = dict.fromkeys(label for f in frames for label in f.labels_b)
    row_of = {label: next((n for n in names_a if same_name(n, label, synonyms)), label) for label in names_b}
    counts: Counter[tuple[str, str]] = Counter()
    overlap: dict[str, list[float]] = {}
    for f in frames:
        for (i, j), iou, same in zip(f.pairs.tolist(), f.iou.tolist(), f.same.tolist(), strict=True):
            name = f.labels_a[i]
            if same:
                counts[name, "both"] += 1
                overlap.setdefault(name, []).append(iou)
            else:
                counts.update([(name, "otherwise_a"), (row_of[f.labels_b[j]], "otherwise_b")])
        counts.update((f.labels_a[i], "only_a") for i in f.only_a.tolist())
        counts.update((row_of[f.labels_b[j]], "only_b") for j in f.only_b.tolist())
    rows = []
    for name in dict.fromkeys(name for name, _ in counts):
        kinds = ("both", "otherwise_a", "otherwise_b", "only_a", "only_b")
        both, other_a, other_b, only_a, only_b = (counts[name, kind] for kind in kinds)
        a, b = both + other_a + only_a, both + other_b + only_b
        rows.append(
            {
                "name": name,
                "a": a,
                "b": b,
                "both": both,
                "otherwise": other_a + other_b,
                "only_a": only_a,
                "only_b": only_b,
                "share": _share(both, a, b),
                "mean_iou": _mean(overlap.get(name, [])),
            }
        )
    return sorted(rows, key=lambda r: (-(r["a"] + r["b"]), r["name"]))


def find_layer(
    frame: Frame, detector: Detector, names: Sequence[str] | None = None, synonyms: Synonyms | None = None
) -> Layer:
    """Detect the given names in a frame, without unknown ones; None for everything."""
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
    frames : str
        As in `pipeline.answering.pipeline.frame_range`.
    names : sequence of str, optional
        What both are asked for. Default: everything that each knows.
    min_iou : float
        As in `agree`.
    skipped : callable, optional
        Told of each frame that cannot be used, where all were asked for.
    progress : callable, optional
        Called with (frames done, frames in all).

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
    """Record of a frame: the figures, and every detection by its place in its detector's list."""
    sums = figures([found], synonyms)
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
