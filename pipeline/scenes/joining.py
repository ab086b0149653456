"""Identity of objects over the views of a scene: geometry decides, the class name breaks ties.

The objects of a view are matched with those of the scene by the IoU of their pixels, over the pixels whose place was
seen before, by the Hungarian method; at the end, objects that stand at the same place are joined. What contains what
says nothing: cups would be joined to their table.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

import numpy as np

from pipeline.answering.objects import PreparedFrame, SceneObject, all_objects
from pipeline.answering.pipeline import Pipeline
from pipeline.geometry.cleaning import Pixel
from pipeline.geometry.masks import MaskCrop, topmost
from pipeline.language.noun_phrase import same_names
from pipeline.scenes.views import PosedView
from pipeline.scenes.voxels import BACKGROUND, UNSEEN, Voxels
from pipeline.scenes.world_boxes import ViewBox
from pipeline.system.errors import require
from pipeline.system.frozen import dataclass

SAME_NAME, WITHIN = 0.1, 0.5
"""Worth of the same class name, beside an IoU, and, with it, of the smaller one's share that lies in the other, for
masks drawn too narrow and too wide. Without the name it would join cups to their table."""
LEAST_SCORE = 0.2
"""A match scores at least so much."""
LEAST_SEEN = 0.1
"""Below this share of pixels whose place was seen before, a match is doubtful."""
SAME_PLACE, SAME_PLACE_NAMED = 0.5, 0.25
"""Objects are one if they share this part of the smaller one's places; with the same name the second."""
STRIDE = 2
"""Every so many-th row and column of a view is compared, but for objects of fewer than `SMALL` pixels."""
SMALL = 200


@dataclass(frozen=True)
class Sighting:
    """An object of a view, before it has an identity."""

    number: int  # Of it in its frame, as in labels
    label: str
    score: float  # 0..1
    mask: MaskCrop
    kept: np.ndarray | None = None  # (h, w) bool, of the mask's crop: pixels that are the object's beyond doubt
    box: ViewBox | None = None  # Whole box, world


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


class Joining:
    """Objects of a scene as views come in, in their order.

    `voxels`, `joins` (with the ids of before `merged`) and `boxes` (of each join, if any) are all that it knows: of a
    saved scene it goes on from them.

    >>> from pipeline.answering.pipeline import open_pipeline
    >>> from pipeline.scenes.joining import Joining, seen_objects
    >>> from pipeline.scenes.views import PosedView
    >>> demo, joining = open_pipeline("demo"), Joining()
    >>> for frame in (demo.prepare(0), demo.prepare(1)):
    ...     joined = joining.add(PosedView.of(frame.frame), seen_objects(demo, frame))
    >>> sum(not join.new for join in joined), len(joined)
    (19, 29)
    """

    def __init__(
        self, voxels: Voxels | None = None, joins: Iterable[Join] = (), boxes: Iterable[ViewBox | None] = ()
    ) -> None:
        self.voxels = voxels or Voxels()
        self.joins, self.boxes = list(joins), list(boxes)
        self.votes: dict[int, dict[str, float]] = {}
        """By object, the summed scores of the class names."""
        for join in self.joins:
            vote(self.votes, join.object_id, join)

    def copied(self) -> Joining:
        """Joining that goes on from here, and leaves this one as it is."""
        return Joining(self.voxels, self.joins, self.boxes)

    def add(self, view: PosedView, objects: Sequence[Sighting]) -> tuple[Join, ...]:
        """Match the objects of the next view, and take them in."""
        numbers = [o.number for o in objects]
        require(len(set(numbers)) == len(numbers), f"frame {view.frame_id}: objects have the same number", got=numbers)
        painted, compared = _painted(view.sharp, objects)
        v, u = np.nonzero(compared)
        own = painted[v, u]
        points = view.world(v, u)
        iou, inner, known = _overlaps(own, self.voxels.owners(points), len(objects), len(self.votes))
        labels = [*(o.label for o in objects), *map(self.name, range(len(self.votes)))]
        named = same_names(labels)[: len(objects), len(objects) :]
        found = self._matched(view.frame_id, objects, iou, inner, known, named)
        ids = np.array([BACKGROUND, *(join.object_id for join in found)])
        self.voxels = self.voxels.added(points, ids[own + 1])
        self.joins.extend(found)
        self.boxes.extend(o.box for o in objects)
        return found

    def _matched(
        self,
        view_id: str,
        objects: Sequence[Sighting],
        iou: np.ndarray,
        inner: np.ndarray,
        known: np.ndarray,
        named: np.ndarray,
    ) -> tuple[Join, ...]:
        # The program starts without it.
        from scipy.optimize import linear_sum_assignment

        score = np.where(iou > 0, iou + named * (SAME_NAME + WITHIN * inner), 0.0)
        matched = dict(zip(*linear_sum_assignment(-score), strict=True)) if score.size else {}
        out = []
        for i, entry in enumerate(objects):
            k = matched.get(i, -1)
            new = k < 0 or score[i, k] < LEAST_SCORE
            number = len(self.votes) if new else int(k)
            second = float((iou[i] if new else np.delete(iou[i], k)).max(initial=0.0))
            own = (0.0, False) if new else (float(iou[i, k]), bool(named[i, k]))
            vote(self.votes, number, entry)
            seen = (float(known[i]), own[1], entry.label, entry.score)
            out.append(Join(view_id, entry.number, number, bool(new), own[0], second, *seen))
        return tuple(out)

    def name(self, object_id: int) -> str:
        """Class name by vote."""
        return elected(self.votes[object_id])

    def merged(self) -> dict[int, int]:
        """Id by the id of before: of objects that stand at the same place and never in one frame the smallest.

        Nothing is changed by it: what later views show may join others.
        """
        frames: dict[int, set[str]] = {k: set() for k in self.votes}
        for join in self.joins:
            frames[join.object_id].add(join.frame_id)
        sizes, root = self.voxels.sizes(), {k: k for k in self.votes}
        shared = self.voxels.shared()
        shares = {(a, b): n / min(sizes[a], sizes[b]) for (a, b), n in shared.items()}
        for (a, b), share in sorted(shares.items(), key=lambda item: (-item[1], item[0])):
            one, other = sorted((root[a], root[b]))
            named = bool(same_names([self.name(a), self.name(b)])[0, 1])
            if one == other or frames[one] & frames[other] or share < (SAME_PLACE_NAMED if named else SAME_PLACE):
                continue
            frames[one] |= frames[other]
            root.update({k: one for k, of in root.items() if of == other})
        return root


def vote(votes: dict[int, dict[str, float]], object_id: int, entry: Sighting | Join) -> None:
    """Add a sighting's score to its class name among those of an object."""
    own = votes.setdefault(object_id, {})
    own[entry.label] = own.get(entry.label, 0.0) + entry.score


def elected(votes: Mapping[str, float]) -> str:
    """Class name with most votes; of equal ones the first in the alphabet."""
    return min(votes, key=lambda label: (-votes[label], label))


def seen_objects(
    pipeline: Pipeline, prepared: PreparedFrame, T_world_camera: np.ndarray | None = None
) -> tuple[Sighting, ...]:
    """Objects of a frame as a pipeline's detector finds them, each with a mask, and with a pose its box."""
    detector = pipeline.needed_detector()
    return tuple(
        Sighting(
            o.id if detector.exact else place,
            o.label,
            o.score,
            o.held.crop,
            _kept(o, prepared.frame.depth),
            None if T_world_camera is None else ViewBox.of(o, T_world_camera, prepared.viewer),
        )
        for place, o in enumerate(all_objects(prepared, detector))
    )


def _kept(thing: SceneObject, depth: np.ndarray) -> np.ndarray | None:
    """Pixels of an object's mask that lifting kept, (h, w) bool, of the mask's crop; None where it does not tell."""
    crop, evidence = thing.held.crop, thing.lifted.evidence
    if evidence is None:
        return None
    h, w = crop.mask.shape
    return evidence.full(*depth.shape)[crop.y : crop.y + h, crop.x : crop.x + w] == Pixel.KEPT


def _painted(sharp: np.ndarray, objects: Sequence[Sighting]) -> tuple[np.ndarray, np.ndarray]:
    """Index of each pixel's object, (H, W) int32, -1 for none, and the pixels to compare, (H, W) bool.

    Of nested masks the smaller lies on top; what of a mask is not kept is nobody's.
    """
    grid = np.zeros(sharp.shape, np.bool_)
    grid[::STRIDE, ::STRIDE] = True
    own, compared = topmost(sharp.shape, [o.mask for o in objects]), sharp & grid
    for i, entry in enumerate(objects):
        crop = entry.mask
        h, w = crop.mask.shape
        part = np.s_[crop.y : crop.y + h, crop.x : crop.x + w]
        kept = sharp[part] & crop.mask if entry.kept is None else entry.kept
        top = own[part] == i
        compared[part][top] = (kept if np.count_nonzero(kept) < SMALL else kept & grid[part])[top]
    return own, compared


def _overlaps(own: np.ndarray, owner: np.ndarray, count: int, known: int) -> tuple[np.ndarray, ...]:
    """IoU of a view's objects with the scene's, (count, known), over pixels whose place was seen, and the share of such
    pixels of each of the view's, (count,).

    `own`, (P,): index of each pixel's object; `owner`, (P,): the scene's owner of its place.
    """
    whole = np.bincount(own[own >= 0], minlength=count)
    seen = owner != UNSEEN
    # With a row and a column for the background.
    table = np.bincount((own[seen] + 1) * (known + 1) + owner[seen] + 1, minlength=(count + 1) * (known + 1))
    table = table.reshape(count + 1, known + 1).astype(np.float64)
    both, mine, theirs = table[1:, 1:], table[1:].sum(axis=1), table[:, 1:].sum(axis=0)
    union = mine[:, None] + theirs - both
    inner = both / np.maximum(np.minimum(mine[:, None], theirs), 1)
    return both / np.maximum(union, 1), inner, mine / np.maximum(whole, 1)
