"""Masks carried from labelled views to another view of the scene: seen directly where a label's own surface is, grown
along the colour edges where it is not.

Each pixel of the target is looked up in the labelled views: where one measured the same surface, its label stands, an
object's or the background's, and both compete for the rest by a watershed on colour. What no labelled view has seen of
an object is grown only as far as the object may reach, and never to where a labelled view saw beside it.
"""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np

from pipeline.geometry.masks import MaskCrop
from pipeline.scenes.views import View, Visibility
from pipeline.system.errors import require
from pipeline.system.frozen import dataclass

LEAST_SEEN_PX = 12
"""An object of which fewer pixels are seen directly is not proposed."""
BALL_M = 0.03
"""A label reaches so far along the measured surface, metres."""
GROWN = 0.5, 0.05
"""An object may reach beyond what the labelled views show of it by this share of its longest side, and so many metres."""


@dataclass(frozen=True, eq=False)
class LabelledObject:
    """An object of a labelled view."""

    object_id: int  # The same in all views that show it
    number: int  # The frame's own number of it
    mask: MaskCrop


@dataclass(frozen=True, eq=False)
class LabelledView:
    """A view with the masks of all its objects; what is in none is background."""

    view: View
    objects: tuple[LabelledObject, ...]


@dataclass(frozen=True, eq=False)
class ProposedMask:
    """Mask of an object in a view that is not labelled, with its evidence."""

    object_id: int
    mask: MaskCrop
    area: int  # Pixels
    seen: float  # Share of the mask that a labelled view shows directly, 0..1
    measured: float  # Share of the mask with a depth, 0..1
    sources: tuple[tuple[str, int, int], ...]  # Frame, its number of the object, and pixels seen there; the most first


    @property
    def confidence(self) -> float:
        return self.seen


UNKNOWN, BACKGROUND = -2, -1


def propagate(sources: Sequence[LabelledView], target: View) -> tuple[ProposedMask, ...]:
    ids = sorted({o.object_id for s in sources for o in s.objects})
    index = {k: i for i, k in enumerate(ids)}
    v, u = np.nonzero(target.depth > 0)
    points = target.world(v, u)
    votes = np.zeros((len(ids) + 1, len(v)), np.uint8)
    barred = []
    seen_by = np.zeros((len(sources), len(ids)), np.int64)
    low, high = np.full((len(ids), 3), np.inf), np.full((len(ids), 3), -np.inf)
    looked = []
    for k, source in enumerate(sources):
        owner = painted(source, index)
        sv, su, z = source.view.project(points)
        state = source.view.at(sv, su, z)
        own = owner[sv, su]
        good = (state == Visibility.SEEN) & source.view.sharp[sv, su]
        votes[own[good] + 1, np.flatnonzero(good)] += 1
        seen_by[k] = np.bincount(own[good & (own >= 0)], minlength=len(ids))
        _extend(source, owner, low, high)
        looked.append(((state == Visibility.HIDDEN) & (own < 0)))
    found = np.where(votes.any(axis=0), votes.argmax(axis=0) - 1, UNKNOWN)
    labels = np.full(target.size, UNKNOWN, np.int32)
    labels[v, u] = found
    sharp = target.sharp
    labels[~sharp] = UNKNOWN
    seeds = _eroded(labels)
    grown = _watershed(target.rgb, seeds)
    return _proposals(sources, ids, labels, grown, target, seen_by, low, high, v, u, points, looked)


def painted(source: LabelledView, index: dict[int, int]) -> np.ndarray:
    out = np.full(source.view.size, BACKGROUND, np.int32)
    for entry in sorted(source.objects, key=lambda o: -o.mask.area):
        h, w = entry.mask.mask.shape
        out[entry.mask.y : entry.mask.y + h, entry.mask.x : entry.mask.x + w][entry.mask.mask] = index[entry.object_id]
    return out


def _extend(source, owner, low, high):
    v, u = source.view.pixels
    own = owner[v, u]
    points = source.view.points
    for i in np.unique(own[own >= 0]):
        p = points[own == i]
        low[i] = np.minimum(low[i], np.percentile(p, 1, axis=0))
        high[i] = np.maximum(high[i], np.percentile(p, 99, axis=0))


def _eroded(labels: np.ndarray) -> np.ndarray:
    shifted = labels.astype(np.float32)
    edge = cv2.dilate(shifted, np.ones((3, 3))) != cv2.erode(shifted, np.ones((3, 3)))
    out = labels.copy()
    out[edge] = UNKNOWN
    for i in np.unique(labels[labels >= 0]):
        if not (out == i).any():
            out[labels == i] = i
    return out


def _watershed(rgb, seeds):
    markers = np.where(seeds == UNKNOWN, 0, seeds + 2).astype(np.int32)
    cv2.watershed(np.ascontiguousarray(rgb), markers)
    lines = markers <= 0
    if lines.any():
        _, nearest = cv2.distanceTransformWithLabels(lines.astype(np.uint8), cv2.DIST_L2, 3, labelType=cv2.DIST_LABEL_PIXEL)
        at = np.zeros(nearest.max() + 1, np.int32)
        at[nearest[~lines]] = markers[~lines]
        markers[lines] = at[nearest[lines]]
    return markers - 2


def _proposals(sources, ids, labels, grown, target, seen_by, low, high, v, u, points, looked):
    outside = np.zeros(len(v), bool)
    own = grown[v, u]
    fg = own >= 0
    reach = GROWN[0] * (high - low).max(axis=1, keepdims=True) + GROWN[1]
    lo, hi = low - reach, high + reach
    far = np.zeros(len(v), bool)
    far[fg] = ((points[fg] < lo[own[fg]]) | (points[fg] > hi[own[fg]])).any(axis=1)
    for l in looked:
        far |= l
    grown[v[fg & far], u[fg & far]] = BACKGROUND
    out = []
    for i, k in enumerate(ids):
        mask = grown == i
        area = int(mask.sum())
        seen = mask & (labels == i)
        n = int(seen.sum())
        if n < LEAST_SEEN_PX:
            continue
        out.append(ProposedMask(k, MaskCrop.of(mask), area, n / area, float((target.depth[mask] > 0).mean()), ()))
    return tuple(out)
