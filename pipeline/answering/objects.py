"""Prepared frame, and its objects: proposals lifted to 3D once each."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import field
from time import perf_counter
from typing import TYPE_CHECKING

import cv2
import numpy as np

from pipeline.datasets.base import Dataset
from pipeline.datasets.up import resolved_camera, scene_doubt
from pipeline.geometry.boxes import Box3D, iou_2d
from pipeline.geometry.camera import backproject
from pipeline.geometry.cleaning import LiftConfig, depth_edges
from pipeline.geometry.frame import Frame
from pipeline.geometry.lifting import LiftedObject, MaskSource, lift
from pipeline.geometry.masks import LazyMask, MaskStack, PictureMask
from pipeline.geometry.viewer import ViewerAxes, resolve_up, viewer_axes
from pipeline.language.class_sizes import is_thin
from pipeline.proposals.annotations import box_mask
from pipeline.proposals.base import Detector, Proposals, lists_things
from pipeline.relations.features import Appearance
from pipeline.system.frozen import dataclass

if TYPE_CHECKING:
    from pipeline.answering.whole_boxes import CompletedBox

_UNPAINTED = np.zeros((0, 0), np.bool_)
SAME_BOX_IOU = 0.7
SAME_MASK_IOU = 0.5
BOX_MARGIN_M = 0.02
"""How far beyond an annotated 3D box a point still counts as inside: the noise of the depth and of the hand."""


@dataclass(frozen=True)
class SceneObject:
    """Proposal in 3D."""

    id: int  # The detector's own identity; the annotation's index for `annotations`, -1 where it has none
    label: str
    score: float  # 0..1
    bbox: np.ndarray  # (4,) float32: x0, y0, x1, y1, pixels
    mask: np.ndarray  # (H, W) bool
    lifted: LiftedObject
    # P(attribute | object) where an imported file gives it, by attribute
    given_attributes: Mapping[str, float] = field(default_factory=dict)
    box_from: str = ""  # Of imported predictions: "given", or "worked out" where the file gives no 3D box of it
    whole: CompletedBox | None = None  # Where the configuration asks for completed boxes

    def __repr__(self) -> str:
        return f"<SceneObject {self.label!r}, score {self.score:.2f}, {self.box or 'no 3D box'}>"

    @property
    def held(self) -> PictureMask:
        """The mask, as it is held by its crop."""
        return LazyMask.of(self) or PictureMask.of(self.mask)

    @property
    def box(self) -> Box3D | None:
        """3D box in the camera frame, metres; None without depth."""
        return self.lifted.box

    @property
    def size_box(self) -> Box3D | None:
        """Box by which sizes are compared: the whole object's where it is estimated, else the seen one."""
        return self.box if (whole := self.estimated) is None else whole.box

    @property
    def estimated(self) -> CompletedBox | None:
        """Whole box, where it is estimated and differs from the seen one."""
        # What was moved or drawn since has a box of its own.
        valid = self.whole is not None and self.whole.seen is self.box and self.whole.box is not self.box
        return self.whole if valid else None

    def name(self, index: int, exact: bool) -> str:
        """Name in tables: by the dataset's own number for exact objects, else by place in the list."""
        return f"{self.label}·{self.id if exact else index}"


SceneObject.mask = LazyMask()  # pyright: ignore[reportAttributeAccessIssue]


class PreparedFrame:
    """Frame with every result independent of the question, computed once.

    `boxes`: fit 3D boxes; without them lifting is a third cheaper, and all relations are the same; `up_doubt`: see
    `ViewerAxes`; `frame`: with the camera's up vector resolved; `edges`: (H, W) bool: depth edges; `seconds`: what
    making it took.
    """

    def __init__(
        self, frame: Frame, config: LiftConfig | None = None, *, boxes: bool = True, up_doubt: str = ""
    ) -> None:
        start = perf_counter()
        self.boxes = boxes
        self.config = config or LiftConfig()
        camera = resolve_up(frame.depth, frame.camera)
        assert camera.up is not None
        self.frame = frame.by_camera(camera)
        self.viewer: ViewerAxes = viewer_axes(camera.up, camera.up_source or "assumed", up_doubt)
        self.edges = depth_edges(frame.depth, self.config)
        self._lifted: dict[tuple[str, int, bool], tuple[LiftedObject, PictureMask]] = {}
        self._numbers: dict[str, dict[int, int]] = {}
        self.seconds = perf_counter() - start

    def under(self, config: LiftConfig) -> PreparedFrame:
        """Frame as prepared by another lifting; itself for its own."""
        if config == self.config:
            return self
        return PreparedFrame(self.frame, config, boxes=self.boxes, up_doubt=self.viewer.up_doubt)

    def numbers(self, detector: Detector, ids: np.ndarray | None = None) -> dict[int, int]:
        """Rank of each id among all listed detections, made once; empty for detectors of pictures.

        `ids`, (N,) int64: those of all detections, where they are known.
        """
        if not lists_things(detector):
            return {}
        fingerprint = detector.fingerprint()
        if fingerprint not in self._numbers:
            # In the order of the identities, as `all_objects` has them.
            listed = np.sort(detector.detect(self.frame, None).ids if ids is None else ids).tolist()
            self._numbers[fingerprint] = {number: place for place, number in enumerate(listed) if number >= 0}
        return self._numbers[fingerprint]

    def lift(self, proposals: Proposals, detector: Detector) -> tuple[SceneObject, ...]:
        """Lift proposals to 3D, each once."""
        fingerprint = detector.fingerprint()
        labels = [proposals.label(i) for i in range(len(proposals))]
        keys = [(fingerprint, int(n), is_thin(label)) for n, label in zip(proposals.ids, labels, strict=True)]
        # Without an identity each is lifted anew, at its own place in the list.
        places = [key if key[1] >= 0 else i for i, key in enumerate(keys)]
        known: dict[object, tuple[LiftedObject, PictureMask]] = {**self._lifted}
        fresh = {place: i for i, place in reversed([*enumerate(places)]) if place not in known}
        masks = [self._mask(proposals, i, detector.exact) for i in fresh.values()]
        lifted = lift(
            self.frame.depth,
            self.frame.camera,
            [mask.crop for mask, _ in masks],
            self.viewer,
            config=self.config,
            mask_source=[source for _, source in masks],
            edges=self.edges,
            boxes=self.boxes,
            thin=[keys[i][2] for i in fresh.values()],
        )
        for (place, i), (mask, _), item in zip(fresh.items(), masks, lifted, strict=True):
            known[place] = self._with_fixed_box(item, keys[i][1]) if detector.exact else item, mask
            if keys[i][1] >= 0:
                self._lifted[keys[i]] = known[place]
        wholes: Sequence[CompletedBox | None] = [None] * len(places)
        if self.boxes and self.config.boxes == "completed":
            # Only who asks for whole boxes imports what makes them.
            from pipeline.answering.whole_boxes import complete

            items = [known[place][0] for place in places]
            wholes = complete(items, labels, self.frame.depth, self.frame.camera)
        found = []
        for i, place in enumerate(places):
            own, mask = known[place]
            entry = SceneObject(
                keys[i][1], labels[i], float(proposals.scores[i]), proposals.boxes[i], _UNPAINTED, own, whole=wholes[i]
            )
            entry = LazyMask.held_by(entry, mask)
            # Imported boxes take the place of those that are made here.
            finished = getattr(detector, "finished", None)
            found.append(entry if finished is None else finished(entry, self))
        return tuple(found)

    def _with_fixed_box(self, lifted: LiftedObject, index: int) -> LiftedObject:
        """Annotated object with a fixed 3D box, if any, and its points moved along."""
        box = next((a.box for a in self.frame.annotations if a.index == index and a.fixed), None)
        return lifted if box is None else lifted.moved_to(box, self.viewer)

    def _mask(self, proposals: Proposals, i: int, exact: bool) -> tuple[PictureMask, MaskSource]:
        """Pixels of a proposal, and their source."""
        masked = proposals.masks is not None and (proposals.has_mask is None or bool(proposals.has_mask[i]))
        segmented = masked and proposals.segmented is not None and bool(proposals.segmented[i])
        if proposals.masks is not None and masked and not segmented:
            return _taken(proposals.masks, i), "annotation" if exact else "detector"
        mask = box_mask(proposals.boxes[i], self.frame.height, self.frame.width)
        if exact:
            box = next((a.box for a in self.frame.annotations if a.index == proposals.ids[i]), None)
            if box is not None:
                within = pixels_inside(box, mask, self.frame)
                if within.any():
                    # Before a segmenter's guess: in the demo the centre of what is lifted is more than
                    # 10 cm off for 7 % of the objects by these pixels, for 13 % by the depth segmenter's.
                    return PictureMask.of(within), "box3d"
        if proposals.masks is not None and segmented:
            return _taken(proposals.masks, i), "segmenter"
        return PictureMask.of(mask), "box"


def _taken(masks: np.ndarray | MaskStack, i: int) -> PictureMask:
    return masks.masks[i] if isinstance(masks, MaskStack) else PictureMask.of(masks[i])


def prepare_frame(
    dataset: Dataset, frame: Frame, config: LiftConfig | None = None, *, boxes: bool = True
) -> PreparedFrame:
    """Prepare a frame of a dataset: with a pose but no up vector of its own, its scene's is taken."""
    camera = resolved_camera(dataset, frame)
    doubt = "" if camera.untold else scene_doubt(dataset, frame, camera)
    return PreparedFrame(frame.by_camera(camera), config, boxes=boxes, up_doubt=doubt)


def pixels_inside(box: Box3D, mask: np.ndarray, frame: Frame, margin: float = BOX_MARGIN_M) -> np.ndarray:
    """(H, W) bool: pixels of a mask with points in a 3D box (camera frame) or at most `margin` m beyond."""
    v, u = np.nonzero(mask & (frame.depth > 0))
    points = backproject(frame.depth, frame.camera, v, u)
    inside = (np.abs((points - box.center) @ box.R) <= box.size / 2 + margin).all(axis=1)
    within = np.zeros_like(mask)
    within[v[inside], u[inside]] = True
    return within


def all_objects(context: PreparedFrame, detector: Detector) -> tuple[SceneObject, ...]:
    """Detect everything in the frame, in the order of identities."""
    proposals = detector.detect(context.frame, None)
    context.numbers(detector, proposals.ids)
    return context.lift(proposals.take(np.argsort(proposals.ids, kind="stable")), detector)


def same_object(objects: Sequence[SceneObject], exact: bool) -> np.ndarray:
    """Pairs of entries of the same object, seen by separate detector runs.

    Parameters
    ----------
    exact : bool
        The detector's identities are the truth, and only they count: a cushion may fill most of the chair it lies on.

    Returns
    -------
    (N, N) bool
        With a true diagonal.
    """
    same = np.eye(len(objects), dtype=np.bool_)
    if not objects:
        return same
    ids = np.array([o.id for o in objects])
    same |= (ids[:, None] == ids[None, :]) & (ids[:, None] >= 0)
    if exact:
        return same
    overlap = iou_2d(np.stack([o.bbox for o in objects]), np.stack([o.bbox for o in objects]))
    same |= overlap >= SAME_BOX_IOU
    if (overlap > 0).sum() > len(objects):
        # A filled 2D box is no mask; for it the stricter test of boxes stands.
        masked = [i for i, o in enumerate(objects) if o.lifted.quality.mask_source != "box"]
        same[np.ix_(masked, masked)] |= mask_iou([objects[i].mask for i in masked]) >= SAME_MASK_IOU
    return same


def mask_iou(masks: Sequence[np.ndarray]) -> np.ndarray:
    """(N, N) float64: intersection over union of (H, W) bool masks, on a grid of some 320 columns; 0 for empty ones.

    A coarse grid decides an overlap of a half as surely as every pixel.
    """
    found = np.zeros((len(masks), len(masks)))
    if not len(masks):
        return found
    step = max(1, masks[0].shape[1] // 320)
    coarse = [np.ascontiguousarray(m[::step, ::step]) for m in masks]
    x, y, w, h = np.array([cv2.boundingRect(m.view(np.uint8)) for m in coarse]).T
    area = np.array([np.count_nonzero(m) for m in coarse])
    left, top = np.maximum(x[:, None], x), np.maximum(y[:, None], y)
    right, bottom = (np.minimum(end[:, None], end) for end in (x + w, y + h))
    # Few of all pairs share any pixel: only where the rectangles around the masks meet.
    i, j = np.nonzero(np.triu((right > left) & (bottom > top)))
    for a, b in zip(i.tolist(), j.tolist(), strict=True):
        part = np.s_[top[a, b] : bottom[a, b], left[a, b] : right[a, b]]
        shared = np.count_nonzero(coarse[a][part] & coarse[b][part])
        found[a, b] = found[b, a] = shared / (area[a] + area[b] - shared)
    return found


def appearance_of(objects: Sequence[SceneObject], frame: Frame) -> Appearance:
    """Appearance of objects in the frame of their lifting."""
    bboxes = np.array([o.bbox for o in objects], np.float64).reshape(-1, 4)
    labels, ids = tuple(o.label for o in objects), tuple(o.id for o in objects)
    return Appearance(bboxes, labels, frame.width, frame.height, ids)
