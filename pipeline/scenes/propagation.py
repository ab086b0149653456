"""Masks carried from labelled views of a scene to another view of it.

Each pixel of the target is looked up in the labelled views. Where one measured the same surface its label stands, an
object's or the background's; both compete for the rest by a watershed on colour. An object grows no farther than it may
reach, and not to where a labelled view looks past it.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property

import cv2
import numpy as np

from pipeline.geometry.cleaning import SQUARE
from pipeline.geometry.masks import MaskCrop, topmost
from pipeline.scenes.views import PosedView, Visibility
from pipeline.system.frozen import dataclass

LEAST_SEEN_PX = 4
"""An object of which fewer pixels are seen directly is not proposed."""
REACH_SHARE, REACH_M = 0.5, 0.05
"""An object may reach beyond what the labelled views show of it by this share of its longest side, and so many
metres."""
EDGE_LEVELS = 30
"""Neighbouring colours that differ by so many of 255 levels in a channel are an edge."""
DOUBTFUL = 0.3
"""Below this confidence a mask is doubtful: in rendered rooms one of three was less than half right, of the others one
of forty."""
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

    view: PosedView
    objects: tuple[LabelledObject, ...]

    @cached_property
    def owner(self) -> np.ndarray:
        """Place in `objects` of each pixel's, (H, W) int32, `BACKGROUND` for none; of nested masks the smaller one."""
        return topmost(self.view.size, [o.mask for o in self.objects])

    @cached_property
    def surface(self) -> tuple[np.ndarray, np.ndarray]:
        """Sharp pixels of the objects: places in `objects`, (N,) int32, and world points, (N, 3) float32, metres."""
        v, u = np.nonzero((self.owner >= 0) & self.view.sharp)
        return self.owner[v, u], self.view.world(v, u)

    @cached_property
    def extents(self) -> np.ndarray:
        """Lowest and highest world coordinates of each object without outliers, (2, K, 3), metres; infinite without
        any."""
        of, points = self.surface
        out = np.full((2, len(self.objects), 3), np.inf)
        out[1] = -np.inf
        for k in np.unique(of):
            out[:, k] = np.percentile(points[of == k], [1, 99], axis=0)
        return out


@dataclass(frozen=True)
class SourceSighting:
    """Sighting of an object in a labelled view from which its mask was carried."""

    frame_id: str
    number: int  # The frame's own number of the object
    pixels: int  # Of the target, whose surface is seen there as this object's


@dataclass(frozen=True, eq=False)
class ProposedMask:
    """Mask of an object in another view, with its evidence."""

    object_id: int
    mask: MaskCrop
    area: int  # Pixels
    seen: float  # Share of the mask that a labelled view shows directly, 0..1
    measured: float  # Share of the mask with a depth, 0..1
    kept: float  # Share of the object's labelled pixels that this view sees, and that the mask holds, 0..1
    outline: float  # Share of the mask's rim on an edge of the surface or the colours, 0..1
    sightings: tuple[SourceSighting, ...]  # The one with the most pixels first

    @property
    def confidence(self) -> float:
        """Trust in the mask, 0..1: low for things without an edge, without depth, or seen from behind."""
        return self.measured * self.kept * self.outline * self.seen**0.5

    @property
    def doubtful(self) -> bool:
        """Tell a mask that a person should look at."""
        return self.confidence < DOUBTFUL


def propagate(sources: Sequence[LabelledView], target: PosedView) -> tuple[ProposedMask, ...]:
    """Propose masks in a view for the objects of labelled views; what is not seen there is left out.

    Masks do not overlap: of nested objects the smaller lies on top.

    >>> from pipeline.datasets import demo_path, open_dataset
    >>> from pipeline.geometry.masks import MaskCrop
    >>> from pipeline.scenes.propagation import LabelledObject, LabelledView, propagate
    >>> from pipeline.scenes.views import PosedView
    >>> demo = open_dataset(demo_path())
    >>> frame, other = demo.load("000001/000000"), demo.load("000001/000001")
    >>> laptop = LabelledObject(2, 2, MaskCrop.of(frame.annotations[2].mask))
    >>> (found,) = propagate([LabelledView(PosedView.of(frame), (laptop,))], PosedView.of(other))
    >>> found.object_id, found.doubtful
    (2, False)
    """
    ids = sorted({o.object_id for s in sources for o in s.objects})
    places = [np.array([ids.index(o.object_id) for o in s.objects] + [BACKGROUND]) for s in sources]
    v, u = np.nonzero(target.depth > 0)
    points = target.world(v, u)
    # By place in `ids`, the background first.
    votes = np.zeros((len(ids) + 1, len(v)), np.uint16)
    past = np.zeros((len(ids) + 1, len(v)), np.bool_)
    pixels = np.zeros((len(sources), len(ids) + 1), np.int64)
    for k, source in enumerate(sources):
        row, column, z = source.view.project(points)
        state, own = source.view.at(row, column, z), places[k][source.owner[row, column]]
        direct = np.flatnonzero((state == Visibility.SEEN) & source.view.sharp[row, column])
        votes[own[direct] + 1, direct] += 1
        pixels[k] = np.bincount(own[direct] + 1, minlength=len(ids) + 1)
        # What is labelled there would have to show on both sides of what hides the place.
        beside = np.flatnonzero((state == Visibility.HIDDEN) & (own == BACKGROUND))
        past[np.ix_(places[k][:-1] + 1, beside)] = True
    seen = np.full(target.size, UNKNOWN, np.int32)
    seen[v, u] = np.where(votes.any(axis=0), votes.argmax(axis=0) - 1, UNKNOWN)
    seen[~target.sharp] = UNKNOWN
    grown = _watershed(target.rgb, _apart(seen))
    own = grown[v, u]
    gone = past[own + 1, np.arange(len(v))] | _beyond(sources, places, len(ids), own, points)
    gone &= (own >= 0) & (seen[v, u] != own)
    grown[v[gone], u[gone]] = BACKGROUND
    kept, edges = _kept(sources, places, len(ids), grown, target), _edges(target)
    return tuple(
        _proposed(sources, ids[i], pixels[:, i + 1], grown == i, seen == i, target.depth > 0, float(kept[i]), edges)
        for i in range(len(ids))
        if np.count_nonzero((grown == i) & (seen == i)) >= LEAST_SEEN_PX
    )


def _proposed(
    sources: Sequence[LabelledView],
    object_id: int,
    pixels: np.ndarray,
    mask: np.ndarray,
    seen: np.ndarray,
    measured: np.ndarray,
    kept: float,
    edges: np.ndarray,
) -> ProposedMask:
    crop = MaskCrop.of(mask)
    rim = cv2.morphologyEx(mask.view(np.uint8), cv2.MORPH_GRADIENT, SQUARE) > 0
    sightings = (
        SourceSighting(source.view.frame_id, entry.number, int(n))
        for source, n in zip(sources, pixels, strict=True)
        for entry in source.objects
        if entry.object_id == object_id and n
    )
    return ProposedMask(
        object_id,
        crop,
        crop.area,
        float(np.mean(seen[mask])),
        float(np.mean(measured[mask])),
        kept,
        float(np.mean(edges[rim])),
        tuple(sorted(sightings, key=lambda o: -o.pixels)),
    )


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
    """Labels grown to all pixels, (H, W) int32, along the edges of the colours, in a picture twice as large: the lines
    between its basins are a pixel wide."""
    size = 2 * labels.shape[1], 2 * labels.shape[0]
    rgb, labels = cv2.resize(rgb, size), cv2.resize(labels, size, interpolation=cv2.INTER_NEAREST)
    markers = np.where(labels == UNKNOWN, 0, labels + 2).astype(np.int32)
    cv2.watershed(rgb, markers)
    # The lines go to the neighbour with the most similar colour; those at the border need more than one step.
    colours = np.pad(rgb.astype(np.int16), ((1, 1), (1, 1), (0, 0)))
    for _ in range(3):
        v, u = np.nonzero(markers <= 0)
        own, around = rgb[v, u].astype(np.int16), np.pad(markers, 1)
        best, nearest = np.full(len(v), np.inf), np.zeros(len(v), np.int32)
        for dv, du in np.ndindex(3, 3):
            label = around[v + dv, u + du]
            unlike = np.where(label > 0, np.abs(colours[v + dv, u + du] - own).sum(axis=1), np.inf)
            nearer = unlike < best
            best[nearer], nearest[nearer] = unlike[nearer], label[nearer]
        markers[v, u] = nearest
    return np.where(markers > 0, markers - 2, BACKGROUND)[::2, ::2].copy()


def _beyond(
    sources: Sequence[LabelledView], places: Sequence[np.ndarray], count: int, own: np.ndarray, points: np.ndarray
) -> np.ndarray:
    """Points, (N, 3), beyond the reach of their objects, (N,) bool; `own`, (N,): place of each point's object."""
    low, high = np.full((count + 1, 3), np.inf), np.full((count + 1, 3), -np.inf)
    for source, place in zip(sources, places, strict=True):
        np.minimum.at(low, place[:-1], source.extents[0])
        np.maximum.at(high, place[:-1], source.extents[1])
    reach = REACH_SHARE * (high - low).max(axis=1, keepdims=True) + REACH_M
    return ((points < (low - reach)[own]) | (points > (high + reach)[own])).any(axis=1)


def _kept(
    sources: Sequence[LabelledView], places: Sequence[np.ndarray], count: int, grown: np.ndarray, target: PosedView
) -> np.ndarray:
    """Share of each object's labelled pixels that the target sees, and that `grown`, (H, W), gives to it, (count,)."""
    totals = np.zeros((2, count), np.int64)
    for source, place in zip(sources, places, strict=True):
        of, surface = source.surface
        v, u, z = target.project(surface)
        on = target.at(v, u, z) == Visibility.SEEN
        v, u, i = v[on], u[on], place[of[on]]
        totals += [np.bincount(i, minlength=count), np.bincount(i[grown[v, u] == i], minlength=count)]
    return totals[1] / np.maximum(totals[0], 1)


def _edges(view: PosedView) -> np.ndarray:
    """Pixels beside an edge of the surface or the colours, (H, W) bool."""
    bent = ~view.normals[1] | (view.depth <= 0)
    levels = cv2.morphologyEx(view.rgb, cv2.MORPH_GRADIENT, SQUARE).max(axis=-1)
    return (cv2.dilate(bent.view(np.uint8), SQUARE) > 0) | (levels >= EDGE_LEVELS)
