"""Masks carried from labelled views of a scene to another view of it.

Each pixel of the target is looked up in the labelled views. Where one measured the same surface its label stands, an
object's or the background's; both compete for the rest by a watershed on colour. An object grows no farther than it may
reach, and not to where a labelled view looks past it.
"""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np

from pipeline.geometry.cleaning import SQUARE
from pipeline.geometry.masks import MaskCrop
from pipeline.scenes.views import View, Visibility
from pipeline.system.frozen import dataclass

LEAST_SEEN_PX = 4
"""An object of which fewer pixels are seen directly is not proposed."""
REACH_SHARE, REACH_M = 0.5, 0.05
"""An object may reach beyond what the labelled views show of it by this share of its longest side, and so many
metres."""
RIM_PX = 3
"""Width of the strip at an outline in which an edge of the surface is looked for."""
UNKNOWN, BACKGROUND = -2, -1


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


@dataclass(frozen=True)
class Origin:
    """Sighting of an object in a labelled view from which its mask was carried."""

    frame_id: str
    number: int  # The frame's own number of the object
    pixels: int  # Of the target, whose surface is seen there as this object


@dataclass(frozen=True, eq=False)
class ProposedMask:
    """Mask of an object in a view that is not labelled, with its evidence."""

    object_id: int
    mask: MaskCrop
    area: int  # Pixels
    seen: float  # Share of the mask that a labelled view shows directly, 0..1
    measured: float  # Share of the mask with a depth, 0..1
    edge: float  # Share of the object's outlines in the labelled views that are an edge of the surface, 0..1
    origins: tuple[Origin, ...]  # The one with the most pixels first

    @property
    def confidence(self) -> float:
        """Trust in the mask, 0..1."""
        return self.seen * self.measured


def propagate(sources: Sequence[LabelledView], target: View) -> tuple[ProposedMask, ...]:
    """Propose masks in a view for the objects of labelled views; objects that it does not show are left out.

    Masks do not overlap: of nested objects the smaller lies on top.
    """
    ids = sorted({o.object_id for s in sources for o in s.objects})
    v, u = np.nonzero(target.depth > 0)
    points = target.world(v, u)
    votes = np.zeros((len(ids) + 1, len(v)), np.uint16)
    past = np.zeros((len(ids) + 1, len(v)), np.bool_)
    pixels = np.zeros((len(sources), len(ids)), np.int64)
    for k, source in enumerate(sources):
        owner = painted(source.view.size, [o.mask for o in source.objects], [ids.index(o.object_id) for o in source.objects])
        sv, su, z = source.view.project(points)
        state, own = source.view.at(sv, su, z), owner[sv, su]
        direct = np.flatnonzero((state == Visibility.SEEN) & source.view.sharp[sv, su])
        votes[own[direct] + 1, direct] += 1
        pixels[k] = np.bincount(own[direct] + 1, minlength=len(ids) + 1)[1:]
        known = np.isin(ids, [o.object_id for o in source.objects])
        beside = np.flatnonzero((state == Visibility.HIDDEN) & (own == BACKGROUND))
        past[np.ix_(np.flatnonzero(known) + 1, beside)] = True
    seen = np.full(target.size, UNKNOWN, np.int32)
    seen[v, u] = np.where(votes.any(axis=0), votes.argmax(axis=0) - 1, UNKNOWN)
    seen[~target.sharp] = UNKNOWN
    grown = _watershed(target.rgb, _apart(seen))
    own = grown[v, u]
    gone = past[own + 1, np.arange(len(v))] | _beyond(sources, ids, own, points)
    gone &= (own >= 0) & (seen[v, u] != own)
    grown[v[gone], u[gone]] = BACKGROUND
    found = []
    for i, object_id in enumerate(ids):
        mask = grown == i
        count = np.count_nonzero(mask & (seen == i))
        if count < LEAST_SEEN_PX:
            continue
        area = int(np.count_nonzero(mask))
        origins = [
            Origin(s.view.frame_id, next(o.number for o in s.objects if o.object_id == object_id), int(n))
            for s, n in zip(sources, pixels[:, i], strict=True)
            if n
        ]
        measured = np.count_nonzero(mask & (target.depth > 0)) / area
        origins.sort(key=lambda o: -o.pixels)
        found.append(ProposedMask(object_id, MaskCrop.of(mask), area, count / area, measured, 1.0, tuple(origins)))
    return tuple(found)


def painted(size: tuple[int, int], masks: Sequence[MaskCrop], values: Sequence[int]) -> np.ndarray:
    """Value of each pixel's mask, (H, W) int32, `BACKGROUND` for none; of nested masks the smaller lies on top."""
    out = np.full(size, BACKGROUND, np.int32)
    for mask, value in sorted(zip(masks, values, strict=True), key=lambda pair: -pair[0].area):
        h, w = mask.mask.shape
        out[mask.y : mask.y + h, mask.x : mask.x + w][mask.mask] = value
    return out


def _apart(labels: np.ndarray) -> np.ndarray:
    """Labels without the pixels where two meet: poses and depths are not exact, and colour decides there."""
    known = labels != UNKNOWN
    high = cv2.dilate(np.where(known, labels, UNKNOWN).astype(np.float32), SQUARE)
    low = cv2.erode(np.where(known, labels, np.iinfo(np.int16).max).astype(np.float32), SQUARE)
    out = np.where(high != low, UNKNOWN, labels)
    for i in np.setdiff1d(labels, out):
        out[labels == i] = i
    return out


def _watershed(rgb: np.ndarray, labels: np.ndarray) -> np.ndarray:
    """Labels grown to all pixels, (H, W) int32, along the edges of the colours."""
    markers = np.where(labels == UNKNOWN, 0, labels + 2).astype(np.int32)
    if not markers.any():
        return np.full(labels.shape, BACKGROUND, np.int32)
    cv2.watershed(np.ascontiguousarray(rgb), markers)
    # The lines between the basins go to the neighbour with the most similar colour; border pixels need two steps.
    for _ in range(3):
        v, u = np.nonzero(markers <= 0)
        own, around = rgb[v, u].astype(np.int16), np.pad(markers, 1)
        colours = np.pad(rgb.astype(np.int16), ((1, 1), (1, 1), (0, 0)))
        best, nearest = np.full(len(v), np.inf), np.zeros(len(v), np.int32)
        for dv, du in np.ndindex(3, 3):
            label = around[v + dv, u + du]
            apart = np.where(label > 0, np.abs(colours[v + dv, u + du] - own).sum(axis=1), np.inf)
            nearer = apart < best
            best[nearer], nearest[nearer] = apart[nearer], label[nearer]
        markers[v, u] = nearest
    return np.where(markers > 0, markers - 2, BACKGROUND)


def _beyond(sources: Sequence[LabelledView], ids: Sequence[int], own: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Points, (N, 3), beyond the reach of their objects, (N,) bool; `own`, (N,): index of each point's object."""
    low, high = np.full((len(ids), 3), np.inf), np.full((len(ids), 3), -np.inf)
    for source in sources:
        for entry in source.objects:
            v, u = np.nonzero(entry.mask.mask)
            v, u = v + entry.mask.y, u + entry.mask.x
            sharp = source.view.sharp[v, u]
            if sharp.any():
                i = ids.index(entry.object_id)
                ends = np.percentile(source.view.world(v[sharp], u[sharp]), [1, 99], axis=0)
                low[i], high[i] = np.minimum(low[i], ends[0]), np.maximum(high[i], ends[1])
    reach = REACH_SHARE * (high - low).max(axis=1, initial=0.0, keepdims=True) + REACH_M
    low, high = low - reach, high + reach
    return ((points < low[own]) | (points > high[own])).any(axis=1)
