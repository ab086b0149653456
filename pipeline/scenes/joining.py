"""Identity of objects over the views of a scene: geometry decides, the class name breaks ties.

The objects of a view are matched with those of the scene by the IoU of their pixels, over the pixels whose place was
seen before, by the Hungarian method; at the end, objects that stand at the same place are joined. What contains what
says nothing: cups would be joined to their table.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import field, replace

import numpy as np
from scipy.optimize import linear_sum_assignment

from pipeline.answering.objects import PreparedFrame, all_objects
from pipeline.answering.pipeline import Pipeline
from pipeline.geometry.masks import MaskCrop
from pipeline.language.noun_phrase import same_names
from pipeline.scenes.views import View
from pipeline.scenes.voxels import BACKGROUND, UNSEEN, Voxels
from pipeline.system.errors import require
from pipeline.system.frozen import dataclass

SAME_NAME = 0.1
"""Worth of the same class name, beside an IoU."""
LEAST_SCORE = 0.25
"""A match scores at least so much."""
LEAST_SEEN = 0.1
"""Below this share of pixels whose place was seen before, a match is doubtful."""
SAME_PLACE, SAME_PLACE_NAMED = 0.5, 0.25
"""Objects are one if they share this part of the smaller one's places; with the same name the second."""
STRIDE = 2
"""Every so many-th row and column of a view is compared."""


@dataclass(frozen=True)
class Seen:
    """An object of a view, before it has an identity."""

    number: int  # The frame's own number of it
    label: str
    score: float  # 0..1
    mask: MaskCrop


@dataclass(frozen=True)
class Join:
    """Evidence of one sighting: why an object of a frame is this object of the scene."""

    frame_id: str
    number: int
    object_id: int
    new: bool  # Nothing of the scene matched
    iou: float  # With the scene's object, over pixels whose place was seen before; 0 for a new one
    second: float  # Of the next best object
    known: float  # Share of the mask's pixels whose place was seen before
    same_name: bool
    label: str
    score: float

    @property
    def doubtful(self) -> bool:
        """Tell a match that rests on little: few known pixels, or another object that fits nearly as well."""
        return not self.new and (self.known < LEAST_SEEN or self.iou - self.second < SAME_NAME)


@dataclass
class Joining:
    """Objects of a scene as views come in, in their order.

    >>> from pipeline.answering.pipeline import open_pipeline
    >>> from pipeline.scenes.joining import Joining, seen_objects
    >>> from pipeline.scenes.views import View
    >>> demo, joining = open_pipeline("demo"), Joining()
    >>> for frame in (demo.prepare(0), demo.prepare(1)):
    ...     joined = joining.add(View.of(frame.frame), seen_objects(demo, frame))
    >>> sum(not join.new for join in joined), len(joined)
    (5, 6)
    """

    voxels: Voxels = field(default_factory=Voxels)
    joins: list[Join] = field(default_factory=list)
    votes: dict[int, Counter[str]] = field(default_factory=dict)  # By object, the class names' summed scores

    def add(self, view: View, objects: Sequence[Seen]) -> tuple[Join, ...]:
        """Match the objects of the next view, and take them in."""
        numbers = [o.number for o in objects]
        require(len(set(numbers)) == len(numbers), f"frame {view.frame_id}: objects have the same number", got=numbers)
        v, u = view.pixels
        on_grid = (v % STRIDE == 0) & (u % STRIDE == 0)
        v, u = v[on_grid], u[on_grid]
        own = _painted(view.size, objects)[v, u]
        points = view.world(v, u)
        owner = self.voxels.owners(points)
        iou, known = _overlaps(own, owner, len(objects), sorted(self.votes))
        labels = [*(o.label for o in objects), *map(self.name, sorted(self.votes))]
        named = same_names(labels)[: len(objects), len(objects) :]
        found = self._matched(view.frame_id, objects, iou, known, named)
        ids = np.array([BACKGROUND, *(join.object_id for join in found)])
        self.voxels.add(points, ids[own + 1])
        self.joins.extend(found)
        return found

    def _matched(
        self, frame_id: str, objects: Sequence[Seen], iou: np.ndarray, known: np.ndarray, named: np.ndarray
    ) -> tuple[Join, ...]:
        ids = sorted(self.votes)
        score = np.where(iou > 0, iou + SAME_NAME * named, 0.0)
        matched = dict(zip(*linear_sum_assignment(-score), strict=True)) if score.size else {}
        out = []
        for i, entry in enumerate(objects):
            k = matched.get(i)
            new = k is None or score[i, k] < LEAST_SCORE
            number = len(self.votes) if new else ids[k]  # pyright: ignore[reportCallIssue, reportArgumentType]
            others = np.delete(iou[i], [] if new else [k])
            self.votes.setdefault(number, Counter())[entry.label] += entry.score
            out.append(
                Join(
                    frame_id,
                    entry.number,
                    number,
                    new,
                    0.0 if new else float(iou[i, k]),
                    float(others.max(initial=0.0)),
                    float(known[i]),
                    False if new else bool(named[i, k]),
                    entry.label,
                    entry.score,
                )
            )
        return tuple(out)

    def name(self, object_id: int) -> str:
        """Class name by vote; of equal ones the first in the alphabet."""
        votes = self.votes[object_id]
        return min(votes, key=lambda label: (-votes[label], label))

    def merged(self) -> dict[int, int]:
        """Join objects that stand at the same place and never in one frame; ids by the ids that they had before."""
        frames: dict[int, set[str]] = {k: set() for k in self.votes}
        for join in self.joins:
            frames[join.object_id].add(join.frame_id)
        sizes, new = self.voxels.sizes(), {k: k for k in self.votes}
        shares = {
            pair: n / max(1, min(sizes.get(pair[0], 0), sizes.get(pair[1], 0)))
            for pair, n in self.voxels.shared().items()
        }
        for (a, b), share in sorted(shares.items(), key=lambda item: (-item[1], item[0])):
            one, other = _root(new, a), _root(new, b)
            if one == other or frames[one] & frames[other]:
                continue
            named = bool(same_names([self.name(one), self.name(other)])[0, 1])
            if share >= (SAME_PLACE_NAMED if named else SAME_PLACE):
                keep, gone = min(one, other), max(one, other)
                new[gone] = keep
                frames[keep] |= frames.pop(gone)
                self.votes[keep] += self.votes.pop(gone)
        roots = {k: _root(new, k) for k in new}
        self.joins = [replace(join, object_id=roots[join.object_id]) for join in self.joins]
        self.voxels.renamed(roots)
        return roots


def seen_objects(pipeline: Pipeline, prepared: PreparedFrame) -> tuple[Seen, ...]:
    """Objects of a frame as a pipeline's detector finds them, each with a mask."""
    objects = all_objects(prepared, pipeline.needed_detector())
    return tuple(Seen(o.id if o.id >= 0 else place, o.label, o.score, o.held.crop) for place, o in enumerate(objects))


def _root(new: dict[int, int], k: int) -> int:
    while new[k] != k:
        k = new[k]
    return k


def _painted(size: tuple[int, int], objects: Sequence[Seen]) -> np.ndarray:
    """Index of each pixel's object, (H, W) int32, -1 for none; of nested masks the smaller lies on top."""
    out = np.full(size, -1, np.int32)
    for i in sorted(range(len(objects)), key=lambda i: -objects[i].mask.area):
        crop = objects[i].mask
        h, w = crop.mask.shape
        out[crop.y : crop.y + h, crop.x : crop.x + w][crop.mask] = i
    return out


def _overlaps(own: np.ndarray, owner: np.ndarray, count: int, ids: Sequence[int]) -> tuple[np.ndarray, np.ndarray]:
    """IoU of a view's objects with the scene's, (N, M), over pixels whose place was seen, and the share of such
    pixels of each of the view's, (N,).

    `own`, (P,): index of each pixel's object; `owner`, (P,): the scene's owner of its place.
    """
    seen = owner != UNSEEN
    whole = np.bincount(own[own >= 0], minlength=count)
    a, b = own[seen], owner[seen]
    place = np.searchsorted(np.asarray(ids, np.int64), b)
    both = (a >= 0) & (b >= 0)
    inter = np.zeros((count, len(ids)))
    np.add.at(inter, (a[both], place[both]), 1)
    mine = np.bincount(a[a >= 0], minlength=count)
    theirs = np.bincount(place[b >= 0], minlength=len(ids))[: len(ids)]
    union = mine[:, None] + theirs[None] - inter
    return inter / np.maximum(union, 1), mine / np.maximum(whole, 1)
