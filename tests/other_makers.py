"""What rooms of other makers share: where the camera is, what is lifted, and how answers are measured on them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from pipeline.geometry import Camera, LiftedObject, ViewerAxes, lift, viewer_axes
from pipeline.metrics import ECE_BINS, f1_of
from pipeline.relations import Appearance

MIN_PIXELS, MIN_POINTS = 200, 16

Extents = tuple[np.ndarray, np.ndarray]


@dataclass(frozen=True)
class Regime:
    """Where cameras are: metres above the floor (`close`: from the table's middle), degrees down, degrees of roll."""

    height: tuple[float, float]
    pitch: tuple[float, float]
    roll: float
    close: bool = False


USUAL = Regime((0.9, 1.7), (0, 35), 5)
REGIMES = {
    "low": Regime((0.3, 0.7), (-8, 15), 4),
    "usual": USUAL,
    "high": Regime((1.7, 2.3), (15, 60), 12),
    "table top": Regime((0.5, 1.1), (15, 65), 10, close=True),
}


@dataclass(frozen=True)
class Seen:
    """Objects of one view as lifted, and the exact extents of the whole ones along (right, up, forward)."""

    objects: list[LiftedObject]
    exact: list[Extents]
    viewer: ViewerAxes
    looks: Appearance


def seen_objects(
    depth: np.ndarray, camera: Camera, masks: Sequence[np.ndarray], exact: Sequence[Extents], names: Sequence[str] = ()
) -> Seen:
    """Those of which enough is seen."""
    assert camera.up is not None
    viewer = viewer_axes(camera.up)
    lifted = lift(depth, camera, masks, viewer)
    kept = [k for k, item in enumerate(lifted) if item.quality.points >= MIN_POINTS]
    found = [lifted[k] for k in kept]
    looks = replace(unnamed(found), labels=tuple(names[k] for k in kept)) if names else unnamed(found)
    return Seen(found, [exact[k] for k in kept], viewer, looks)


def unnamed(objects: Sequence[LiftedObject]) -> Appearance:
    """What objects look like of whose names and 2D boxes nothing is known."""
    return Appearance(np.zeros((len(objects), 4)), ("",) * len(objects), 640, 480)


def tallied(probabilities: np.ndarray, labels: np.ndarray, truth: np.ndarray) -> np.ndarray:
    """What the figures of one view are sums of, as one row; see `figures`.

    Parameters
    ----------
    probabilities : (N, N, 6) float
        Of a network, in the order of DIRECTIONAL.
    labels, truth : (N, N, 6) int8
        States as they would be labelled, and of exact geometry.
    """
    off = ~np.eye(len(truth), dtype=np.bool_)
    p, said, true = probabilities[off], labels[off], truth[off]
    vertical = np.zeros(true.shape, np.bool_)
    vertical[:, 2:4] = True
    known, decided = true != 0, (said != 0) & (true != 0)
    bins = np.minimum((p[known] * ECE_BINS).astype(int), ECE_BINS - 1)
    of_bins = [
        np.bincount(bins, weights, ECE_BINS) for weights in (None, p[known], (true[known] > 0).astype(np.float64))
    ]
    counts = [
        *_hits(p > 0.5, true, known),
        *_hits(p > 0.5, true, known & vertical),
        *_hits(said > 0, true, decided & vertical),
        (said * true == -1).sum(),
        said.size,
        decided.sum(),
        known.sum(),
        len(p),
    ]
    return np.concatenate([counts, *of_bins]).astype(np.float64)


def _hits(yes: np.ndarray, truth: np.ndarray, among: np.ndarray) -> tuple[int, int, int]:
    """True positives, false positives, false negatives."""
    holds = truth > 0
    return tuple(int((among & cells).sum()) for cells in (yes & holds, yes & ~holds, ~yes & holds))  # pyright: ignore


FLIPS = "flips in 1,000"
FIGURES = ("micro-F1", "above/below F1", "ECE", "above/below F1 of labels", FLIPS, "decided")


def figures(sums: np.ndarray) -> np.ndarray:
    """(S, 6) of sums over views (S, K): see FIGURES. Flips are labels T for F or F for T, among all cells."""
    micro, vertical, labelled = (f1_of(*np.moveaxis(sums[:, k : k + 3], -1, 0)) for k in (0, 3, 6))
    flips, cells, decided, known = (sums[:, 9 + k] for k in range(4))
    count, said, holds = np.moveaxis(sums[:, 14:].reshape(len(sums), 3, ECE_BINS), 1, 0)
    ece = np.abs(said - holds).sum(axis=1) / np.maximum(count.sum(axis=1), 1)
    return np.stack([micro, vertical, ece, labelled, 1000 * flips / cells, decided / known], axis=1)
