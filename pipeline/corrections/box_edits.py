"""Edits of an object's 3D box that the picture decides: fitted to its points, snapped to what it stands on."""

from __future__ import annotations

from pipeline.answering.objects import pixels_inside
from pipeline.corrections.journal.edits import Edits, set_box
from pipeline.corrections.journal.effective import Corrector
from pipeline.corrections.journal.effective_frame import EffectiveFrame
from pipeline.corrections.journal.field_refs import object_cell
from pipeline.corrections.journal.relifting import Relifter
from pipeline.corrections.scene import labelled_box, labelled_objects
from pipeline.corrections.support import Support, Way, find_support, gap_below, snapped
from pipeline.geometry.boxes import Box3D
from pipeline.geometry.lifting import lift
from pipeline.system.errors import InputError

SAME_M = 0.0005
"""A box that would be moved by less is where it should be."""


def fit_to_points(frame: EffectiveFrame, number: int, corrector: Corrector, reason: str = "") -> Edits:
    """The box that the object's cleaned points make, by the labels' own estimator; the one that a person set goes.

    An object that somebody added as a 3D box is fitted to the points inside of it.

    Raises
    ------
    InputError
        There is no such object, its box is the one of its points already, or the dataset is needed and not at hand.
    """
    reason = reason or "fitted to its points"
    row = _standing(frame, number)
    made_of_box = number not in frame.auto.objects and row["mask_source"] == "box3d"
    if not made_of_box:
        cell = object_cell(frame.frame, number, "box")
        if frame.version(cell) == 0 or frame.origin(cell).source != "human":
            raise InputError(f"the box of object {number} is the one of its points already")
        return set_box(frame, number, None, reason)
    box, context = _box(frame, number), _relifter(corrector).context(frame.frame)
    (mask,) = (o.mask for o in labelled_objects(frame) if o.id == number)
    inside = pixels_inside(box, mask, context.frame)
    (lifted,) = lift(
        context.frame.depth, context.frame.camera, [inside], context.viewer, config=context.config, edges=context.edges
    )
    if lifted.box is None:
        raise InputError("no point with a depth lies in the box")
    return set_box(frame, number, lifted.box, reason)


def support_of(frame: EffectiveFrame, number: int, corrector: Corrector) -> tuple[Support, float]:
    """What an object stands on, and how far its box ends above that, metres; raises as `find_support`."""
    context, box = _relifter(corrector).context(frame.frame), _box(frame, number)
    support = find_support(context, box, labelled_objects(frame), number)
    return support, gap_below(box, support, context.viewer)


def snap_to_support(
    frame: EffectiveFrame, number: int, corrector: Corrector, way: Way = "extend", reason: str = ""
) -> Edits:
    """The box brought down (or up) to the level surface that the object stands on.

    Raises
    ------
    InputError
        As `find_support`; there is no such object, it has no box, it stands there already, or there is no dataset.
    """
    support, gap = support_of(frame, number, corrector)
    on = support_name(frame, support)
    if abs(gap) < SAME_M:
        raise InputError(f"object {number} stands on {on} already")
    box = snapped(_box(frame, number), support, _relifter(corrector).context(frame.frame).viewer, way)
    return set_box(frame, number, box, reason or f"{'extended' if way == 'extend' else 'moved'} to {on}")


def support_name(frame: EffectiveFrame, support: Support) -> str:
    """What carries, in words."""
    row = None if support.number is None else frame.objects.get(support.number)
    return "the level surface below" if row is None else f"{row['label']}·{support.number}"


def _standing(frame: EffectiveFrame, number: int) -> dict:
    if number not in frame.objects:
        raise InputError(f"frame {frame.frame} has no object {number} that stands")
    return frame.objects[number]


def _box(frame: EffectiveFrame, number: int) -> Box3D:
    box = labelled_box(_standing(frame, number))
    if box is None:
        raise InputError(f"object {number} has no 3D box: there is no depth in its pixels")
    return box


def _relifter(corrector: Corrector) -> Relifter:
    if corrector.relifter is None:
        raise InputError("this needs the dataset's depth, and the dataset is not at hand")
    return corrector.relifter
