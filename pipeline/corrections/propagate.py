"""Corrections of one frame as proposed edits of the scene's other frames.

What a person set of an object (pixels, class, 3D box, status) is proposed for the object that stands at the same place
in another frame, or as a new object; never over what a person set there.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from pipeline.corrections.journal import edits as actions
from pipeline.corrections.journal.edits import Edits
from pipeline.corrections.journal.effective import Corrector
from pipeline.corrections.journal.effective_frame import EffectiveFrame, object_value
from pipeline.corrections.journal.events import Event
from pipeline.corrections.journal.field_refs import box_of, object_ref
from pipeline.corrections.journal.journal import Journal
from pipeline.datasets.base import Dataset
from pipeline.geometry.masks import MaskCrop
from pipeline.labels.by_hand import grows, seen_with
from pipeline.labels.reading import Labels
from pipeline.scenes.poses import Refinement, agreement, refine
from pipeline.scenes.propagation import LabelledObject, LabelledView, ProposedMask, propagate
from pipeline.scenes.views import PosedView, posed_frames
from pipeline.system.errors import needed, require
from pipeline.system.frozen import dataclass

SAME_IOU, EQUAL_IOU = 0.5, 0.9
"""A mask is of the object that it overlaps so far; and one that overlaps it so far changes nothing."""
CARRIED = "carried from "
"""Beginning of the reason of a carried edit: no person has looked at such a value in its own frame."""
FIELDS = ("label", "mask", "box", "status")


@dataclass(frozen=True, eq=False)
class CarriedObject:
    """An object of a frame carried to another frame, as edits that wait to be accepted."""

    frame: str  # The other frame
    number: int  # Object there, or the number of a new one
    new: bool
    label: str
    iou: float  # With the object there; 0 for a new one
    source_frame: str
    source_number: int
    mask: ProposedMask
    edits: Edits
    kept: tuple[str, ...]  # Fields that a person set there, which stay

    def record(self) -> dict[str, Any]:
        """JSON of `propagate --json`."""
        return {
            "frame": self.frame,
            "object": self.number,
            "new": self.new,
            "label": self.label,
            "iou": round(self.iou, 3),
            "from": {"frame": self.source_frame, "object": self.source_number},
            "area": self.mask.area,
            "seen": round(self.mask.seen, 3),
            "confidence": round(self.mask.confidence, 3),
            "doubtful": self.mask.doubtful,
            "fields": [e.ref.field for e in self.edits],
            "kept": list(self.kept),
        }


@dataclass(frozen=True, eq=False)
class FrameProposals:
    """Proposals for one frame, and the objects that are not seen in it."""

    frame: str
    proposals: tuple[CarriedObject, ...]
    unseen: tuple[int, ...]  # Numbers of the source frame
    agree: float | None  # Agreement of the two frames' surfaces under the poses used, 0..1; None: too little shared
    refinement: Refinement | None  # Of the frame's pose, where it was used
    size: tuple[int, int]  # Height and width of its picture

    def record(self) -> dict[str, Any]:
        """JSON of `propagate --json`, a frame a line."""
        moved = self.refinement
        return {
            "frame": self.frame,
            "proposals": [p.record() for p in self.proposals],
            "unseen": list(self.unseen),
            "agree": None if self.agree is None else round(self.agree, 3),
            "pose_moved_m": None if moved is None else round(moved.moved_m, 4),
            "pose_turned_deg": None if moved is None else round(moved.turned_deg, 3),
        }


def with_scene(labels: Labels, dataset: Dataset, frame: str, to: Sequence[str] | None = None) -> Labels:
    """Take the frames of a scene, or a frame and those of `to`, into labels begun by hand; others stay as they are."""
    if grows(labels):
        for name in dict.fromkeys((frame, *(to or posed_frames(dataset, frame)))):
            labels = seen_with(labels, dataset, name)
    return labels


def by_person(frame: EffectiveFrame, number: int, field: str) -> bool:
    """Tell a value of an object that a person set in this very frame."""
    if field == "status" and frame.statuses.get(object_ref(frame.frame, number, "status")) is None:
        return False
    origin = frame.origin(object_ref(frame.frame, number, field))
    return origin.source == "human" and not origin.reason.startswith(CARRIED)


def proposals(
    corrector: Corrector,
    journal: Journal | Sequence[Event],
    frame: str,
    numbers: Collection[int] | None = None,
    to: Sequence[str] | None = None,
    refined: bool = False,
    also: Sequence[str] = (),
) -> Iterator[FrameProposals]:
    """Propose what a person set in a frame for the scene's other labelled frames, one frame after the other.

    `numbers`: objects that are carried with pixels and class, whoever set them; by default all of which a person set
    something. `refined`: each frame's pose is refined against the source's surfaces, where they then agree better.
    `also`: further frames whose masks are right; what they see of the objects is carried, too.
    InputError for no such frame or object, nothing to carry, no dataset; FrameUnusable without poses.
    """
    dataset = needed(corrector.dataset, "masks are carried by the pictures' depth: the dataset is needed")
    source = _now(corrector, journal, frame)
    known = {*source.objects, *source.left_out}
    unknown = sorted(set(numbers or ()) - known)
    require(not unknown, f"frame {frame} has no such object", got=unknown[:5])
    wanted = {n: _fields(source, n, numbers is not None) for n in sorted(known if numbers is None else numbers)}
    wanted = {n: fields for n, fields in wanted.items() if fields}
    require(wanted, f"nobody has set anything in frame {frame} yet", expected="--object N carries one as it is")
    posed = posed_frames(dataset, frame)
    astray = [i for i in (frame, *also, *(to or ())) if i not in posed]
    require(not astray, f"no posed frames of the scene of {frame}", got=astray[:5])
    view = PosedView.of(dataset.load(frame))
    standing = _labelled(source, view, source.objects)
    gone = _labelled(source, view, wanted.keys() & source.left_out.keys())
    sources = [standing]
    for name in also:
        beside, there = PosedView.of(dataset.load(name)), _now(corrector, journal, name)
        sources.append(_alike(standing, _labelled(there, beside, there.objects)))
    sourced = {frame, *also}
    for other in [i for i in posed if i not in sourced and i in corrector.index.of_frame] if to is None else to:
        seen, refinement = PosedView.of(dataset.load(other)), None
        if refined and (found := refine(seen, [view])) is not None and found.better:
            seen, refinement = seen.moved(np.array(found.pose)), found
        masks = [*propagate(sources, seen), *(propagate([gone], seen) if gone.objects else ())]
        target = _now(corrector, journal, other)
        made = _of_frame(source, target, view, seen, masks, wanted)
        unseen = wanted.keys() - {m.object_id for m in masks}
        agree = agreement(view, seen).agree
        yield FrameProposals(other, tuple(made), tuple(sorted(unseen)), agree, refinement, target.size)


def _now(corrector: Corrector, journal: Journal | Sequence[Event], frame: str) -> EffectiveFrame:
    own = journal if isinstance(journal, Journal) else [e for e in journal if e.ref.frame == frame]
    return corrector.frame(frame, own)


def _fields(source: EffectiveFrame, number: int, named: bool) -> set[str]:
    fields = {field for field in FIELDS if by_person(source, number, field)}
    return fields | {"label", "mask"} if named and number in source.objects else fields


def _labelled(source: EffectiveFrame, view: PosedView, numbers: Collection[int]) -> LabelledView:
    masks = {n: MaskCrop.of(actions.pixels_of(source, n)) for n in sorted(numbers)}
    return LabelledView(view, tuple(LabelledObject(n, n, crop) for n, crop in masks.items() if crop.area))


def _alike(standing: LabelledView, other: LabelledView) -> LabelledView:
    """Give the objects of another view the numbers of the first one's where they stand; others get new ones."""
    there = {o.number: o.mask.of_picture(other.view.size) for o in other.objects}
    same = {n: number for number, (n, _) in _matched(propagate([standing], other.view), there).items()}
    lowest = 1 + max(o.object_id for o in standing.objects) if standing.objects else 0
    ids = {o.number: same.get(o.number, lowest + k) for k, o in enumerate(other.objects)}
    return replace(other, objects=tuple(replace(o, object_id=ids[o.number]) for o in other.objects))


def _of_frame(
    source: EffectiveFrame,
    target: EffectiveFrame,
    view: PosedView,
    seen: PosedView,
    masks: Sequence[ProposedMask],
    wanted: dict[int, set[str]],
) -> Iterator[CarriedObject]:
    there = {n: actions.pixels_of(target, n) for n in (*target.objects, *target.left_out)}
    matched = _matched(masks, there)
    chosen = [m for m in masks if m.object_id in wanted]
    fresh = iter(actions.new_numbers(target, len(chosen)))
    for mask in chosen:
        number, fields = mask.object_id, wanted[mask.object_id]
        match, iou = matched.get(number, (None, 0.0))
        row = source.objects.get(number) or source.left_out[number]
        reason = (
            f"{CARRIED}{source.frame}, object {number}: {mask.seen:.0%} of the mask seen there, "
            f"confidence {mask.confidence:.2f}"
        )
        box = None
        if "box" in fields and (value := object_value(row, "box")) is not None:
            box = box_of(value).transformed(np.linalg.inv(seen.T_world_camera) @ view.T_world_camera)
        made: Edits
        if match is None:
            # A status alone makes no object.
            if number in source.left_out or fields == {"status"}:
                continue
            match, kept = next(fresh), ()
            pixels = mask.mask.of_picture(target.size)
            made, new = (
                actions.add_object(
                    target, row["label"], mask=pixels, box=box, number=match, instance=row["instance"], reason=reason
                ),
                True,
            )
        else:
            kept, new = tuple(f for f in FIELDS if f in fields and by_person(target, match, f)), False
            if match in target.left_out:
                continue
            made = ()
            if "label" in fields and row["label"] != target.object(match)["label"]:  # pyright: ignore
                made += actions.set_class(target, match, row["label"], reason)
            if "mask" in fields and iou < EQUAL_IOU:
                made += actions.set_mask(target, match, mask.mask.of_picture(target.size), reason)
            if box is not None:
                made += actions.set_box(target, match, box, reason)
            if "status" in fields:
                status = source.statuses[object_ref(source.frame, number, "status")]
                made += actions.set_status(target, object_ref(target.frame, match, "status"), status, reason)
            made = tuple(e for e in made if e.ref.field not in kept and e.after != e.before)
        if made or kept:
            yield CarriedObject(target.frame, match, new, row["label"], iou, source.frame, number, mask, made, kept)


def _matched(masks: Sequence[ProposedMask], there: dict[int, np.ndarray]) -> dict[int, tuple[int, float]]:
    """Object of a frame that each mask overlaps most, with their IoU, by the source's number; each object once."""
    areas = {n: np.count_nonzero(pixels) for n, pixels in there.items()}
    pairs = []
    for order, mask in enumerate(masks):
        own = mask.mask.mask
        (h, w), y, x = own.shape, mask.mask.y, mask.mask.x
        for n, pixels in there.items():
            shared = np.count_nonzero(own & pixels[y : y + h, x : x + w])
            iou = shared / (mask.area + areas[n] - shared)
            if iou >= SAME_IOU:
                pairs.append((-iou, order, n, mask.object_id))
    found: dict[int, tuple[int, float]] = {}
    for iou, _, n, number in sorted(pairs):
        if number not in found and n not in {match for match, _ in found.values()}:
            found[number] = n, -iou
    return found
