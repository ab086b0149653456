"""How far two detectors agree, in figures: of one frame or of many."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from pipeline.answering.agreement.agreement import FrameAgreement
from pipeline.language.naming import Synonyms
from pipeline.proposals.class_names import name_groups, same_name


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
    _, place, count = np.unique(values, return_inverse=True, return_counts=True)
    return (np.cumsum(count) - (count - 1) / 2)[place]


def _share(both: int, a: int, b: int) -> float | None:
    return 2 * both / (a + b) if a + b else None


def _name_kappa(frames: Iterable[FrameAgreement], synonyms: Synonyms | None) -> float | None:
    from pipeline.metrics.significance import cohen_kappa

    said = [
        (f.labels_a[i], f.labels_b[j], same)
        for f in frames
        for (i, j), same in zip(f.pairs.tolist(), f.same.tolist(), strict=True)
    ]
    # Two words for one class are one name.
    stands = name_groups([label for a, b, _ in said for label in (a, b)], synonyms)
    apart = [not same and stands[a] == stands[b] for a, b, same in said]
    first, second = ([row[k] if own else stands[row[k]] for row, own in zip(said, apart, strict=True)] for k in (0, 1))
    if not first:
        return None
    kappa = cohen_kappa(first, second).kappa
    return kappa if math.isfinite(kappa) else None


def _classes(frames: list[FrameAgreement], synonyms: Synonyms | None) -> tuple[ClassAgreement, ...]:
    names_a = list(dict.fromkeys(label for f in frames for label in f.labels_a))
    names_b = dict.fromkeys(label for f in frames for label in f.labels_b)
    row_of = {label: next((n for n in names_a if same_name(n, label, synonyms)), label) for label in names_b}
    counts: dict[str, Counter[str]] = {}
    overlap: dict[str, list[float]] = {}

    def add(name: str, what: str) -> None:
        counts.setdefault(name, Counter())[what] += 1

    for f in frames:
        for (i, j), iou, same in zip(f.pairs.tolist(), f.iou.tolist(), f.same.tolist(), strict=True):
            name = f.labels_a[i]
            if same:
                add(name, "both")
                overlap.setdefault(name, []).append(iou)
            else:
                add(name, "otherwise_a")
                add(row_of[f.labels_b[j]], "otherwise_b")
        for i in f.only_a.tolist():
            add(f.labels_a[i], "only_a")
        for j in f.only_b.tolist():
            add(row_of[f.labels_b[j]], "only_b")
    rows = [_class_row(name, count, overlap.get(name, [])) for name, count in counts.items()]
    return tuple(sorted(rows, key=lambda r: (-(r.a + r.b), r.name)))


def _class_row(name: str, count: Counter[str], iou: list[float]) -> ClassAgreement:
    both, other_a, other_b = count["both"], count["otherwise_a"], count["otherwise_b"]
    a, b = both + other_a + count["only_a"], both + other_b + count["only_b"]
    mean = sum(iou) / len(iou) if iou else None
    return ClassAgreement(
        name, a, b, both, other_a + other_b, count["only_a"], count["only_b"], _share(both, a, b), mean
    )


def _rounded(value: Any) -> Any:
    if isinstance(value, float):
        return round(value, 6)
    if isinstance(value, dict):
        return {k: _rounded(v) for k, v in value.items()}
    if isinstance(value, (list, tuple)):
        return [_rounded(v) for v in value]
    return value
