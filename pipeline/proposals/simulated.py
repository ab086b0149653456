"""A detector made of the dataset's annotations, degraded as real detectors are: for experiments without any weights.

What it gets wrong, all by shares and sizes that `SimulationOptions` holds:

* an object is missed under its own name;
* a query returns objects of other classes, or stretches of background;
* boxes are shifted and scaled, masks are eroded or dilated, some are cut, some leak into what is behind;
* scores of right and wrong detections come from overlapping distributions of the logit, one for each class and kind,
  and are no probabilities: on average they are far too low, as those of detectors with an open vocabulary.

Every figure is a hash of (seed, frame id, what it is about, its own name). So nothing depends on the order of calls,
on other frames, names or processes, and with another recall, say, the same objects come first to be missed.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import cached_property
from pathlib import Path
from statistics import NormalDist
from typing import Annotated, Any

import cv2
import numpy as np
import xxhash
from pydantic import BaseModel, ConfigDict, Field, FiniteFloat, model_validator

from pipeline.geometry.boxes import iou_2d
from pipeline.geometry.frame import Annotation, Frame
from pipeline.geometry.masks import MaskCrop
from pipeline.language.naming import Synonyms, default_synonyms
from pipeline.proposals.base import Proposals, no_proposals
from pipeline.proposals.class_names import meant_names
from pipeline.system.errors import as_input_error
from pipeline.system.frozen import dataclass
from pipeline.system.reading import checked, parse_toml
from pipeline.system.safe_files import read_json, read_text

REGIONS = 16
"""Stretches of background in a frame that may be taken for an object."""
FIRST_REGION_ID = 1 << 32
"""Identity of the first of them; those below are the annotations' own."""
REGION_IOU = 0.3
"""A stretch of background that overlaps an annotated box more than this is none."""
KEPT_OF_CUT = (0.5, 0.85)
"""A cut mask keeps a share of its pixels between these."""
SCORE_LIMITS = (0.01, 0.99)

Share = Annotated[float, Field(ge=0, le=1)]
_NORMAL = NormalDist()


class SimulationOptions(BaseModel):
    """Degradation of the annotations.

    Attributes
    ----------
    seed : int
        Another seed is another detector of the same quality.
    recall : float
        Share of objects that are found when their class is asked for.
    cross_class : float
        Share of queries (a name in a frame) that also return objects of other classes.
    most_confused : int
        At most so many of them in one query; every number from 1 is equally likely.
    background : float
        Mean number of background boxes in a query, at most 16.
    box_jitter : float
        Standard deviation of a box's shift and of the logarithm of its scale, in box sides.
    mask_error : tuple of int
        Masks are eroded (negative) or dilated by a number of pixels between these, evenly.
    truncated : float
        Share of objects whose mask and box are cut.
    corrupted : float
        Share of objects whose mask is merged with background, so that lifting goes astray.
    true_logit, confused_logit, background_logit : float
        Mean logit of the score of a right detection, of an object of another class, of background.
    score_spread : float
        Standard deviation of the logit within each.
    class_spread : float
        Standard deviation of the means from class to class.
    doubted : float
        Share of objects that are found but hardly believed, as things seen from an odd side are.
    doubted_logit : float
        Mean logit of their scores, instead of `true_logit`.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)
    seed: int = Field(default=0, ge=0)
    recall: Share = 0.93
    cross_class: Share = 0.35
    most_confused: int = Field(default=2, ge=1, le=100)
    background: float = Field(default=0.3, ge=0, le=REGIONS)
    box_jitter: float = Field(default=0.03, ge=0, le=0.5)
    mask_error: tuple[int, int] = (-2, 3)
    truncated: Share = 0.04
    corrupted: Share = 0.06
    true_logit: FiniteFloat = -0.3
    confused_logit: FiniteFloat = -1.3
    background_logit: FiniteFloat = -1.9
    score_spread: float = Field(default=0.9, ge=0, le=10)
    class_spread: float = Field(default=0.4, ge=0, le=10)
    doubted: Share = 0.0
    doubted_logit: FiniteFloat = -3.5

    @model_validator(mode="after")
    def _in_order(self) -> SimulationOptions:
        low, high = self.mask_error
        if not -50 <= low <= high <= 50:
            raise ValueError("mask_error must be two numbers of pixels from -50 to 50, the smaller first")
        return self


def read_options(path: str | Path) -> SimulationOptions:
    """Read options from a TOML or JSON file, with defaults for missing keys."""
    path = Path(path)
    unreadable = "the options of the simulated detector cannot be read"
    with as_input_error(unreadable, OSError, ValueError, got=str, path=path):
        table: Any = read_json(path) if path.suffix.lower() == ".json" else parse_toml(read_text(path))
    wrong = "the options of the simulated detector are wrong at {}"
    return checked(SimulationOptions.model_validate, table, wrong, path, keys=SimulationOptions.model_fields)


@dataclass(frozen=True)
class _SimulatedDetection:
    """An answer to a query; `right` for an object of the requested class."""

    id: int
    label: str
    score: float
    right: bool


class SimulatedDetector:
    """Simulated detector of chosen quality, from annotations.

    A thing has one identity, one box and one mask whatever is asked for: that of an object is its annotation's index.
    Its score and its label depend on the name that was asked. Where several names of one call return the same thing,
    it stands once: under its own class if that found it, else under the name with the highest score.

    Parameters
    ----------
    class_names : tuple of str
        The dataset's class names.
    min_score : float
        Detections below it are dropped.
    """

    name = "simulated"
    exact = False
    lists_things = True

    def __init__(
        self,
        options: SimulationOptions | None = None,
        class_names: tuple[str, ...] = (),
        *,
        synonyms: Synonyms | None = None,
        min_score: float = 0.0,
    ) -> None:
        self.options = options or SimulationOptions()
        self.class_names = class_names
        self.synonyms = synonyms
        self.min_score = min_score
        self._meanings: dict[tuple[str, tuple[str, ...]], tuple[str, ...]] = {}

    @property
    def vocabulary(self) -> tuple[str, ...] | None:
        return self.class_names or None

    @cached_property
    def _fingerprint(self) -> str:
        table = self.synonyms or default_synonyms()
        parts = (self.options.model_dump_json(), self.min_score, table.fingerprint)
        return f"simulated:{xxhash.xxh3_64_hexdigest(repr(parts).encode())}"

    def fingerprint(self) -> str:
        return self._fingerprint

    def detect(self, frame: Frame, labels: Sequence[str] | None) -> Proposals:
        known = tuple(dict.fromkeys([*(a.label for a in frame.annotations), *self.class_names]))
        best: dict[int, _SimulatedDetection] = {}
        for query in dict.fromkeys(self._meant(label, known) for label in (known if labels is None else labels)):
            for found in self._answers(frame, query):
                other = best.get(found.id)
                if other is None or (found.right, found.score) > (other.right, other.score):
                    best[found.id] = found
        chosen = sorted((f for f in best.values() if f.score >= self.min_score), key=lambda f: (-f.score, f.id))
        return self._proposals(frame, chosen) if chosen else no_proposals(frame.height, frame.width)

    def _meant(self, label: str, known: tuple[str, ...]) -> tuple[str, ...]:
        """Classes meant by a name, sorted."""
        meant = self._meanings.get((label, known))
        if meant is None:
            meant = tuple(sorted(meant_names(label, known, self.synonyms, "the dataset")))
            self._meanings[label, known] = meant
        return meant

    # What is found, and with which score.

    def _answers(self, frame: Frame, query: tuple[str, ...]) -> Iterator[_SimulatedDetection]:
        o = self.options
        asked = (frame.id, "query", *query)
        others = []
        for a in frame.annotations:
            if a.label not in query:
                others.append(a.index)
            elif self._uniform(frame.id, a.index, "found") < o.recall:
                doubted = self._uniform(frame.id, a.index, "doubted") < o.doubted
                mean = o.doubted_logit if doubted else o.true_logit
                score = self._score("true", a.label, mean, frame.id, a.index, "score")
                yield _SimulatedDetection(a.index, a.label, score, True)
        if self._uniform(*asked, "cross-class") < o.cross_class:
            count = 1 + int(self._uniform(*asked, "confused") * o.most_confused)
            for index in sorted(others, key=lambda i: self._uniform(*asked, "order", i))[:count]:
                score = self._score("confused", query[0], o.confused_logit, *asked, "score", index)
                yield _SimulatedDetection(index, query[0], score, False)
        for k in range(REGIONS):
            if self._uniform(*asked, "background", k) < o.background / REGIONS and self._region(frame, k) is not None:
                score = self._score("background", query[0], o.background_logit, *asked, "score of region", k)
                yield _SimulatedDetection(FIRST_REGION_ID + k, query[0], score, False)

    def _uniform(self, *key: object) -> float:
        """Number in (0, 1) from a hash of seed and key."""
        text = "\x1f".join(map(str, (self.options.seed, *key)))
        return ((xxhash.xxh3_64_intdigest(text.encode("utf-8", "surrogatepass")) >> 12) + 0.5) / (1 << 52)

    def _normal(self, *key: object) -> float:
        return _NORMAL.inv_cdf(self._uniform(*key))

    def _score(self, kind: str, label: str, mean: float, *key: object) -> float:
        o = self.options
        logit = mean + o.class_spread * self._normal("class", label, kind) + o.score_spread * self._normal(*key)
        return float(np.clip(0.5 * (1 + np.tanh(0.5 * logit)), *SCORE_LIMITS))

    # What it looks like.

    def _proposals(self, frame: Frame, chosen: Sequence[_SimulatedDetection]) -> Proposals:
        annotations = {a.index: a for a in frame.annotations}
        # Where nothing is annotated by a mask, this is a detector that gives boxes only.
        segments = any(a.mask is not None for a in frame.annotations)
        boxes = np.zeros((len(chosen), 4), np.float32)
        masks = np.zeros((len(chosen), frame.height, frame.width), np.bool_)
        has_mask = np.zeros(len(chosen), np.bool_)
        for n, found in enumerate(chosen):
            if found.id in annotations:
                boxes[n], crop = self._object(frame, annotations[found.id])
            else:
                boxes[n], crop = self._background(frame, found.id - FIRST_REGION_ID)
                crop = crop if segments else None
            has_mask[n] = crop is not None
            if crop is None:
                x0, y0, x1, y1 = np.round(boxes[n]).astype(int)
                masks[n, y0:y1, x0:x1] = True
            else:
                crop.paint(masks[n])
        names = tuple(dict.fromkeys(f.label for f in chosen))
        return Proposals(
            boxes,
            np.array([f.score for f in chosen], np.float32),
            np.array([names.index(f.label) for f in chosen], np.int64),
            names,
            masks,
            np.array([f.id for f in chosen], np.int64),
            has_mask,
        )

    def _object(self, frame: Frame, a: Annotation) -> tuple[np.ndarray, MaskCrop | None]:
        """The box (4,) and the mask of an annotated object, the same for every query."""
        o, key = self.options, (frame.id, a.index)
        cut, corrupt = (self._uniform(*key, kind) < s for kind, s in (("cut", o.truncated), ("leak", o.corrupted)))
        angle = 2 * np.pi * self._uniform(*key, "angle")
        kept = KEPT_OF_CUT[0] + (KEPT_OF_CUT[1] - KEPT_OF_CUT[0]) * self._uniform(*key, "kept")
        if a.mask is None or not a.mask.any():
            box = a.bbox.astype(np.float64)
            if cut:
                # A box alone can only be cut along its sides.
                side = int(angle / (np.pi / 2)) % 4
                length = box[2:] - box[:2]
                box[side] += (1 - kept) * length[side % 2] * (1 if side < 2 else -1)
            return self._jittered(frame, key, box), None
        low, high = o.mask_error
        pixels = low + int(self._uniform(*key, "mask error") * (high - low + 1))
        crop = surroundings(a.mask, max(high, 0) + 1)
        mask = resized(crop.mask, pixels)
        if cut:
            mask = truncated(mask, angle, kept)
        crop = MaskCrop(crop.x, crop.y, mask)
        box = np.array(crop.box, np.float64)
        if corrupt:
            free = np.ones_like(mask)
            h, w = mask.shape
            for other in frame.annotations:
                if other.mask is not None and other.index != a.index:
                    free &= ~other.mask[crop.y : crop.y + h, crop.x : crop.x + w]
            crop = MaskCrop(crop.x, crop.y, leaked(mask, angle, free))
        return self._jittered(frame, key, box), crop

    def _jittered(self, frame: Frame, key: tuple[object, ...], box: np.ndarray) -> np.ndarray:
        """A box (4,) shifted and scaled, inside the picture and at least a pixel large."""
        shift_x, shift_y, scale_x, scale_y = (
            self.options.box_jitter * self._normal(*key, what) for what in ("x", "y", "width", "height")
        )
        size = np.maximum(box[2:] - box[:2], 1.0)
        center = (box[:2] + box[2:]) / 2 + size * (shift_x, shift_y)
        half = size * np.exp((scale_x, scale_y)) / 2
        limit = np.array([frame.width, frame.height], np.float64)
        low = np.clip(center - half, 0, limit - 1)
        return np.concatenate([low, np.clip(center + half, low + 1, limit)]).astype(np.float32)

    def _region(self, frame: Frame, k: int) -> np.ndarray | None:
        """Box (4,) of a background stretch; None on an annotated object."""
        key = (frame.id, "region", k)
        side = 0.06 * (0.3 / 0.06) ** self._uniform(*key, "side") * min(frame.width, frame.height)
        stretch = 2.0 ** (self._uniform(*key, "stretch") - 0.5)
        limit = np.array([frame.width, frame.height], np.float64)
        half = np.minimum(np.maximum([side * stretch / 2, side / stretch / 2], 1.0), limit / 2)
        position = np.array([self._uniform(*key, "x"), self._uniform(*key, "y")])
        center = half + position * (limit - 2 * half)
        box = np.concatenate([center - half, center + half]).astype(np.float32)
        if frame.annotations and iou_2d(box, np.stack([a.bbox for a in frame.annotations])).max() > REGION_IOU:
            return None
        return box

    def _background(self, frame: Frame, k: int) -> tuple[np.ndarray, MaskCrop]:
        """Background stretch with an ellipse mask."""
        box = self._region(frame, k)
        assert box is not None
        x0, y0 = np.floor(box[:2]).astype(int)
        x1, y1 = np.minimum(np.ceil(box[2:]).astype(int), (frame.width, frame.height))
        rows, columns = np.ogrid[y0:y1, x0:x1]
        center, half = (box[:2] + box[2:]) / 2, np.maximum((box[2:] - box[:2]) / 2, 0.5)
        inside = np.square((columns + 0.5 - center[0]) / half[0]) + np.square((rows + 0.5 - center[1]) / half[1]) <= 1
        return box, MaskCrop(int(x0), int(y0), inside)


LEAST_LEFT = 0.25
"""An erosion that leaves less of a mask than this share does not take place: what is found is never nothing."""
LEAK_REACH = 0.3
"""How far a leak reaches beyond each edge of the object's box, in box sides."""


def surroundings(mask: np.ndarray, margin: float, reach: float = LEAK_REACH) -> MaskCrop:
    """Crop of a mask ((H, W) bool) around its box, widened by `margin` pixels or `reach` of the sides."""
    height, width = mask.shape
    x, y, w, h = cv2.boundingRect(mask.view(np.uint8))
    dx, dy = int(np.ceil(max(margin, reach * w))), int(np.ceil(max(margin, reach * h)))
    x0, y0 = max(x - dx, 0), max(y - dy, 0)
    return MaskCrop(x0, y0, mask[y0 : min(y + h + dy, height), x0 : min(x + w + dx, width)].copy())


def resized(mask: np.ndarray, pixels: int) -> np.ndarray:
    """Mask ((h, w) bool) dilated, or eroded for negative `pixels`."""
    if pixels == 0:
        return mask
    # OpenCV takes a square apart into rows and columns; a disc of this size would take twenty times as long.
    kernel = np.ones((2 * abs(pixels) + 1,) * 2, np.uint8)
    changed = (cv2.dilate if pixels > 0 else cv2.erode)(mask.view(np.uint8), kernel).view(np.bool_)
    return changed if changed.sum() >= LEAST_LEFT * mask.sum() else mask


def truncated(mask: np.ndarray, angle: float, share: float) -> np.ndarray:
    """Part of a mask ((h, w) bool) on one side of a straight cut, keeping `share` of the pixels. `angle`, in radians,
    is the direction along which the cut pixels lie."""
    v, u = np.nonzero(mask)
    along = u * np.cos(angle) + v * np.sin(angle)
    stays = along <= np.quantile(along, share)
    cut = np.zeros_like(mask)
    cut[v[stays], u[stays]] = True
    return cut


def leaked(mask: np.ndarray, angle: float, free: np.ndarray) -> np.ndarray:
    """Mask ((h, w) bool) merged with the `free` surroundings ((h, w) bool) on one side. The side is that of `angle`, in
    radians, as seen from the mask's centre; the leak fills what is given there."""
    v, u = np.nonzero(mask)
    rows, columns = np.ogrid[: mask.shape[0], : mask.shape[1]]
    side = (columns - u.mean()) * np.cos(angle) + (rows - v.mean()) * np.sin(angle) > 0
    return mask | (side & free)
