"""How far two detectors agree: which detections are of one thing, which only one made, and the figures of that."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from pipeline.geometry.boxes import iou_2d
from pipeline.language.naming import Synonyms
from pipeline.metrics.intervals import cohen_kappa
from pipeline.proposals.base import Proposals
from pipeline.proposals.class_names import knows, name_groups, same_name, same_names
from pipeline.system.errors import InputError, require

MIN_IOU = 0.5
"""Two detections that overlap less are not of one thing."""


@dataclass(frozen=True)
class Layer:
    """What one detector found in a frame.

    Attributes
    ----------
    boxes : (N, 4) float
        x0, y0, x1, y1 in pixels.
    scores : (N,) float
    labels : tuple of str
    masks : tuple of ((H, W) bool or None)
        None where there is only the box.
    names : tuple of str or None
        What the detector can find; None where that is anything.
    """

    boxes: np.ndarray
    scores: np.ndarray
    labels: tuple[str, ...]
    masks: tuple[np.ndarray | None, ...]
    names: tuple[str, ...] | None = None

    def __len__(self) -> int:
        return len(self.labels)


def layer_of_proposals(found: Proposals, names: Sequence[str] | None = None) -> Layer:
    """A detector's proposals as a layer; `names` are those it was asked for."""
    has = np.ones(len(found), np.bool_) if found.has_mask is None else found.has_mask
    masks = tuple(found.masks[i] if found.masks is not None and has[i] else None for i in range(len(found)))
    labels = tuple(found.label(i) for i in range(len(found)))
    return Layer(found.boxes, found.scores, labels, masks, None if names is None else tuple(names))


@dataclass(frozen=True)
class FrameAgreement:
    """Two layers of one frame, matched.

    Attributes
    ----------
    labels_a, labels_b : tuple of str
    scores_a, scores_b : (N,), (M,) float64
    pairs : (P, 2) int64
        Places in `a` and in `b` of detections of one thing; each detection is in one pair at most.
    iou : (P,) float64
        By masks where both have one, else by boxes.
    same : (P,) bool
        Both gave it the same name.
    beyond_a, beyond_b : (N,), (M,) bool
        In no pair, and of a class that the other detector does not know: no disagreement.
    nearest_a, nearest_b : (N,), (M,) float64
        The greatest overlap with anything of the other detector.
    """

    labels_a: tuple[str, ...]
    labels_b: tuple[str, ...]
    scores_a: np.ndarray
    scores_b: np.ndarray
    pairs: np.ndarray
    iou: np.ndarray
    same: np.ndarray
    beyond_a: np.ndarray
    beyond_b: np.ndarray
    nearest_a: np.ndarray
    nearest_b: np.ndarray

    @property
    def only_a(self) -> np.ndarray:
        """(K,) int64: what only the first found, though the other knows the class; the highest score first."""
        return _alone(self.scores_a, self.pairs[:, 0], self.beyond_a)

    @property
    def only_b(self) -> np.ndarray:
        """(K,) int64: what only the second found, though the other knows the class; the highest score first."""
        return _alone(self.scores_b, self.pairs[:, 1], self.beyond_b)

    @property
    def named_otherwise(self) -> np.ndarray:
        """(K,) int64: places in `pairs` of things that the two name differently, the highest scores first."""
        found = np.flatnonzero(~self.same)
        return found[np.argsort(-self.pair_scores[found].max(axis=1), kind="stable")]

    @property
    def pair_scores(self) -> np.ndarray:
        """(P, 2) float64: the scores of each pair."""
        return np.stack([self.scores_a[self.pairs[:, 0]], self.scores_b[self.pairs[:, 1]]], axis=1)


def agree(a: Layer, b: Layer, *, min_iou: float = MIN_IOU, synonyms: Synonyms | None = None) -> FrameAgreement:
    """Match the detections of two detectors one to one.

    Of all ways to pair detections that overlap by `min_iou` or more, the one with the most pairs of the same name,
    among these the one with the most pairs, among these the one with the greatest sum of overlaps. So the counts depend
    neither on the order of the detections nor on which detector comes first.

    Parameters
    ----------
    a, b : Layer
        Of the same frame.
    min_iou : float
        Above 0, at most 1.
    synonyms : Synonyms, optional
        Which names mean the same.

    Raises
    ------
    InputError
        An overlap out of range, or masks of different size.
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
    """(P, 2) int64: the best one-to-one pairs of overlaps (N, M) and `same` names (N, M) bool, as `agree` says."""
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
    """(N, M) float64: intersection over union, by masks where both have one, else by boxes."""
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


@dataclass(frozen=True)
class ClassAgreement:
    """One class of the table; a thing that is named otherwise stands with both its names.

    Attributes
    ----------
    name : str
        As the first detector has it, where it has it.
    a, b : int
        Detections of each that the other could have made.
    both : int
        Things that both found under this name.
    otherwise : int
        Detections of this name that the other detector names otherwise.
    only_a, only_b : int
    share : float or None
        2 both / (a + b); None where neither has any.
    mean_iou : float or None
        Of what both found.
    """

    name: str
    a: int
    b: int
    both: int
    otherwise: int
    only_a: int
    only_b: int
    share: float | None
    mean_iou: float | None


@dataclass(frozen=True)
class AgreementFigures:
    """The sums.

    Attributes
    ----------
    frames : int
    a, b : int
        Detections of each, without those of classes that the other does not know.
    both : int
        Things that both found under the same name.
    otherwise : int
        Things that both found and name differently.
    only_a, only_b : int
    beyond_a, beyond_b : int
        Found alone, of classes that the other does not know; they count nowhere else.
    share : float or None
        2 both / (a + b), the positive specific agreement. It is what Cohen's kappa tends to where the places without
        any object are beyond counting, as in pictures (Hripcsak and Rothschild, JAMIA 12, 2005).
    share_placed : float or None
        The same whatever the names: 2 (both + otherwise) / (a + b).
    name_kappa : float or None
        Cohen's kappa of the names of what both found; None where there is no choice of names.
    mean_iou : float or None
        Of what both found, however they name it.
    score_correlation : float or None
        Spearman's rank correlation of the scores of what both found; None for fewer than three, or equal scores.
    classes : tuple of ClassAgreement
        The most frequent first.
    renamed : tuple of (str, str, int)
        What the first and the second call a thing where they differ, and how often; the commonest first.
    """

    frames: int
    a: int
    b: int
    both: int
    otherwise: int
    only_a: int
    only_b: int
    beyond_a: int
    beyond_b: int
    share: float | None
    share_placed: float | None
    name_kappa: float | None
    mean_iou: float | None
    score_correlation: float | None
    classes: tuple[ClassAgreement, ...]
    renamed: tuple[tuple[str, str, int], ...]

    def record(self) -> dict[str, Any]:
        """As JSON knows it, figures rounded to 1e-6."""
        return _rounded(asdict(self))


def figures(found: Iterable[FrameAgreement], synonyms: Synonyms | None = None) -> AgreementFigures:
    """The sums over frames; `synonyms` as they were compared with."""
    frames = list(found)
    scores = np.concatenate([np.zeros((0, 2)), *(f.pair_scores for f in frames)])
    iou = np.concatenate([np.zeros(0), *(f.iou for f in frames)])
    both = sum(int(f.same.sum()) for f in frames)
    otherwise = sum(int((~f.same).sum()) for f in frames)
    only_a, only_b = sum(len(f.only_a) for f in frames), sum(len(f.only_b) for f in frames)
    a, b = both + otherwise + only_a, both + otherwise + only_b
    return AgreementFigures(
        frames=len(frames),
        a=a,
        b=b,
        both=both,
        otherwise=otherwise,
        only_a=only_a,
        only_b=only_b,
        beyond_a=sum(int(f.beyond_a.sum()) for f in frames),
        beyond_b=sum(int(f.beyond_b.sum()) for f in frames),
        share=_share(both, a, b),
        share_placed=_share(both + otherwise, a, b),
        name_kappa=_name_kappa(frames, synonyms),
        mean_iou=float(iou.mean()) if len(iou) else None,
        score_correlation=rank_correlation(scores[:, 0], scores[:, 1]),
        classes=_classes(frames, synonyms),
        renamed=_renamed(frames),
    )


def _renamed(frames: Iterable[FrameAgreement]) -> tuple[tuple[str, str, int], ...]:
    counts = Counter((f.labels_a[i], f.labels_b[j]) for f in frames for i, j in f.pairs[~f.same].tolist())
    return tuple((a, b, n) for (a, b), n in sorted(counts.items(), key=lambda item: (-item[1], item[0])))


def rank_correlation(a: np.ndarray, b: np.ndarray) -> float | None:
    """Spearman's correlation, ties with their mean rank; None for fewer than three values, or equal ones."""
    if len(a) < 3:
        return None
    one, other = _ranks(a), _ranks(b)
    if np.ptp(one) == 0 or np.ptp(other) == 0:
        return None
    return float(np.clip(np.corrcoef(one, other)[0, 1], -1, 1))


def _ranks(values: np.ndarray) -> np.ndarray:
    _, index, count = np.unique(values, return_inverse=True, return_counts=True)
    return (np.cumsum(count) - (count - 1) / 2)[index]


def _share(both: int, a: int, b: int) -> float | None:
    return 2 * both / (a + b) if a + b else None


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
    if not first:
        return None
    kappa = cohen_kappa(first, second).kappa
    return kappa if math.isfinite(kappa) else None


def _classes(frames: list[FrameAgreement], synonyms: Synonyms | None) -> tuple[ClassAgreement, ...]:
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
    rows = [_class_row(name, counts, overlap.get(name, [])) for name in dict.fromkeys(name for name, _ in counts)]
    return tuple(sorted(rows, key=lambda r: (-(r.a + r.b), r.name)))


def _class_row(name: str, counts: Counter[tuple[str, str]], iou: list[float]) -> ClassAgreement:
    kinds = ("both", "otherwise_a", "otherwise_b", "only_a", "only_b")
    both, other_a, other_b, only_a, only_b = (counts[name, kind] for kind in kinds)
    a, b = both + other_a + only_a, both + other_b + only_b
    mean = sum(iou) / len(iou) if iou else None
    return ClassAgreement(name, a, b, both, other_a + other_b, only_a, only_b, _share(both, a, b), mean)


def _rounded(value: Any) -> Any:
    if isinstance(value, float):
        return round(value, 6)
    if isinstance(value, dict):
        return {k: _rounded(v) for k, v in value.items()}
    if isinstance(value, (list, tuple)):
        return [_rounded(v) for v in value]
    return value
