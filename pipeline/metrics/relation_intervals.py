"""Intervals of relation metrics, and of what two scorers differ by on the same pairs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from pipeline.language.relation_names import DIRECTIONAL
from pipeline.metrics.counts import f1_of, mean_of_defined, ratio
from pipeline.metrics.inputs import checked_clusters, checked_names
from pipeline.metrics.intervals import BootstrapConfig, Estimate, bootstrap
from pipeline.metrics.relation_metrics import CellOutcomes
from pipeline.system.errors import InputError


@dataclass(frozen=True)
class RelationEstimates:
    """Figures of `RelationMetrics` with intervals, or differences of two scorers.

    Attributes
    ----------
    relations : tuple of str
    precision, recall, f1 : tuple of Estimate
        R each.
    micro_f1, macro_f1, element_accuracy : Estimate
        A resample without a relation takes its macro mean over the others.
    """

    relations: tuple[str, ...]
    precision: tuple[Estimate, ...]
    recall: tuple[Estimate, ...]
    f1: tuple[Estimate, ...]
    micro_f1: Estimate
    macro_f1: Estimate
    element_accuracy: Estimate


def relation_estimates(
    cells: CellOutcomes,
    clusters: Any,
    *,
    other: CellOutcomes | None = None,
    relations: Sequence[str] = DIRECTIONAL,
    config: BootstrapConfig | None = None,
) -> RelationEstimates:
    """Intervals of all figures from one set of resamples.

    Parameters
    ----------
    cells : CellOutcomes
        Of P pairs and R relations, from `cell_outcomes`.
    clusters : (P,) int or str
        Scene of each pair, or frame where there is one scene.
    other : CellOutcomes, optional
        Another scorer's on the same pairs and the same truth: the estimates are
        then the figures of `cells` less those of `other`.
    relations : sequence of str
    config : BootstrapConfig, optional

    Raises
    ------
    InputError
        Not one cluster a pair, or a scorer that was measured against another truth.
    """
    shape = cells.tp.shape
    names = checked_names(relations, shape[1])
    if other is not None and not (
        shape == other.tp.shape
        and np.array_equal(cells.tp | cells.fn, other.tp | other.fn)
        and np.array_equal(cells.fp | cells.tn, other.fp | other.tn)
    ):
        raise InputError("two scorers can only be compared on the same pairs and the same truth")
    # Sums by cluster first: a million pairs with four numbers for each relation would be hundreds of megabytes.
    place, count = checked_clusters(clusters, shape[0])
    known = cells.tp | cells.fp | cells.fn | cells.tn
    by_relation = np.stack([_sums(known[..., k], place, count) for k in range(shape[1])], axis=1)
    some = np.repeat(_sums(np.asarray(known.any(axis=1)), place, count)[:, None], 3, axis=1)
    rows = np.concatenate([by_relation] * 3 + [some], axis=1)
    found = bootstrap(
        _by_cluster(cells, place, count),
        np.arange(count),
        _figures,
        counted=rows > 0,
        other=None if other is None else _by_cluster(other, place, count),
        config=config,
    )
    found = [replace(e, n=int(n)) for e, n in zip(found, rows.sum(axis=0), strict=True)]
    r = len(names)
    precision, recall, f1 = (tuple(found[k * r : (k + 1) * r]) for k in range(3))
    return RelationEstimates(names, precision, recall, f1, *found[3 * r :])


def _by_cluster(cells: CellOutcomes, place: np.ndarray, count: int) -> np.ndarray:
    """(C, R, 4) float64: how many of tp, fp, fn, tn each cluster has."""
    kinds = (cells.tp, cells.fp, cells.fn, cells.tn)
    columns = [np.stack([_sums(kind[:, k], place, count) for kind in kinds], axis=1) for k in range(cells.tp.shape[1])]
    return np.stack(columns, axis=1)


def _sums(flags: np.ndarray, place: np.ndarray, count: int) -> np.ndarray:
    return np.bincount(place[flags], minlength=count).astype(np.float64)


def _figures(sums: np.ndarray) -> np.ndarray:
    """(S, 3 R + 3) from sums (S, R, 4): precision, recall, F1 of each relation, micro-F1, macro-F1, accuracy."""
    tp, fp, fn, _ = np.moveaxis(sums, -1, 0)
    f1 = f1_of(tp, fp, fn)
    pooled = sums.sum(axis=1)
    overall = (f1_of(*pooled.T[:3]), mean_of_defined(f1), ratio(pooled[:, 0] + pooled[:, 3], pooled.sum(axis=1)))
    return np.concatenate([ratio(tp, tp + fp), ratio(tp, tp + fn), f1, np.stack(overall, axis=1)], axis=1)
