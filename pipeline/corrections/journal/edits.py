"""What a person can do to labels: each action as the edits that it comes down to, made on what the person sees.

Every function takes the frame as it is now (`EffectiveFrame`) and gives the
edits of one action, for `Journal.append`. What follows from them (answers,
relations of a new geometry) is no edit: see `effective_frame`.
"""

from __future__ import annotations

import random
from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np

from pipeline.corrections.journal.effective_frame import EffectiveFrame
from pipeline.corrections.journal.events import Edit
from pipeline.corrections.journal.field_refs import (
    FIRST_NEW_OBJECT,
    OF_ALL,
    FieldRef,
    box_value,
    checked,
    object_ref,
    relation_ref,
)
from pipeline.corrections.journal.replay import judgement_ref
from pipeline.geometry.boxes import Box3D
from pipeline.geometry.masks import decode_run_length, encode_run_length
from pipeline.labels.labelling import row_hash
from pipeline.language.noun_phrase import same_names
from pipeline.language.relation_names import PAIRWISE
from pipeline.proposals.annotations import box_mask
from pipeline.relations.pair_measures import NOT_JUDGED, T, U
from pipeline.system.errors import InputError, listed, needed, require

Edits = tuple[Edit, ...]
Rectangle = Sequence[float] | np.ndarray


def set_class(frame: EffectiveFrame, number: int, label: str, reason: str = "") -> Edits:
    """Set the class name."""
    return (_object_edit(frame, number, "label", label, reason),)


def set_status(
    frame: EffectiveFrame, ref: FieldRef, status: str | None, reason: str = "", author: str | None = None
) -> Edits:
    """Accept or reject an object, expression, frame, or relation of a pair ("left.status"): see `STATUSES`.

    With an author the status is that person's judgement (`corrections.journal.replay`); only a rejection of an object
    or expression, or the return of one rejected by the same person, is set for all.
    """
    if author is not None:
        own, out = judge(frame, ref, status, author, reason), frame.statuses.get(ref) == "rejected"
        for_all = not out if status == "rejected" else out and frame.origin(ref).author == author
        if ref.kind not in ("object", "expression") or not for_all:
            return own
        return (*own, *set_status(frame, ref, status if status == "rejected" else None, reason))
    require(ref.field.endswith("status"), "not a status", got=ref.field)
    return (_edit(frame, ref, status, reason),)


def set_mask(frame: EffectiveFrame, number: int, mask: np.ndarray | str | None, reason: str = "") -> Edits:
    """Set the pixels: (H, W) bool, or COCO's compressed run-length code; None for the whole 2D box."""
    return (_object_edit(frame, number, "mask", None if mask is None else _code(frame, mask), reason),)


def set_bbox(frame: EffectiveFrame, number: int, bbox: Rectangle, reason: str = "") -> Edits:
    """Set the 2D box: x0, y0, x1, y1, pixels."""
    return (_object_edit(frame, number, "bbox", _within(frame, bbox), reason),)


def set_box(frame: EffectiveFrame, number: int, box: Box3D | None, reason: str = "") -> Edits:
    """Set the 3D box (camera frame), with the object's points; None for the fitted box."""
    return (_object_edit(frame, number, "box", None if box is None else box_value(box), reason),)


def new_numbers(frame: EffectiveFrame, count: int) -> list[int]:
    """Draw random five-digit numbers of new objects, so two people at once rarely meet."""
    taken = {*frame.objects, *frame.left_out}
    free = [n for n in range(FIRST_NEW_OBJECT, 10 * FIRST_NEW_OBJECT) if n not in taken]
    return random.SystemRandom().sample(free, count)


def add_object(
    frame: EffectiveFrame,
    label: str,
    *,
    mask: np.ndarray | str | None = None,
    bbox: Rectangle | None = None,
    box: Box3D | None = None,
    number: int | None = None,
    instance: int | None = None,
    reason: str = "",
) -> Edits:
    """Add an object from pixels, a 2D box, a 3D box, or several; `number` is from FIRST_NEW_OBJECT on.

    `instance`: its id in the scene, where it is known.
    """
    if number is None:
        (number,) = new_numbers(frame, 1)
    require(
        number >= FIRST_NEW_OBJECT,
        "the number of a new object is too small",
        got=number,
        expected=f"from {FIRST_NEW_OBJECT} on",
    )
    pixels = {} if mask is None else {"mask": _code(frame, mask)}
    flat = {} if bbox is None else {"bbox": _within(frame, bbox)}
    seed = {"label": label, **pixels, **flat, **({} if box is None else {"box": box_value(box)})}
    seed |= {} if instance is None else {"instance": instance}
    return (_edit(frame, object_ref(frame.frame, number, "exists"), seed, reason),)


def merge_objects(frame: EffectiveFrame, numbers: Iterable[int], reason: str = "") -> Edits:
    """Merge objects: the first gets the pixels of all, the others are rejected."""
    ids = list(dict.fromkeys(numbers))
    require(len(ids) >= 2, "a merge needs two objects", got=ids)
    mask = np.logical_or.reduce([pixels_of(frame, n) for n in ids])
    note = reason or f"merged into object {ids[0]}"
    first = _object_edit(
        frame, ids[0], "mask", _code(frame, mask), reason or f"merged with {', '.join(map(str, ids[1:]))}"
    )
    return (first, *(_object_edit(frame, n, "status", "rejected", note) for n in ids[1:]))


def split_object(frame: EffectiveFrame, number: int, masks: Sequence[np.ndarray | str], reason: str = "") -> Edits:
    """Split an object by masks: the first mask stays, each other mask makes a new object of the class."""
    require(len(masks) >= 2, "a split needs two masks", got=len(masks))
    label = _row(frame, number)["label"]
    note = reason or f"split off object {number}"
    first = _object_edit(frame, number, "mask", _code(frame, masks[0]), reason or f"split in {len(masks)}")
    made = zip(masks[1:], new_numbers(frame, len(masks) - 1), strict=True)
    return (first, *(e for m, n in made for e in add_object(frame, label, mask=m, number=n, reason=note)))


def set_relation(frame: EffectiveFrame, a: int, b: int, relation: str, state: int | None, reason: str = "") -> Edits:
    """Set T (1), U (0) or F (-1) of "a RELATION b", and of "b INVERSE a"; InputError for no such pair or state."""
    return tuple(
        _edit(frame, ref, state, reason) for ref in _both_ways(frame, relation_ref(frame.frame, a, b, relation))
    )


def judge(frame: EffectiveFrame, ref: FieldRef, status: str | None, author: str, reason: str = "") -> Edits:
    """Judge an item for a single person, changing no label; None takes the judgement back.

    `ref` is a status of an object, expression or relation ("left.status"); "accepted" of a relation keeps its state
    now.
    """
    _check_judged(frame, ref)
    state = frame.value(state_ref(ref)) if ref.kind == "relation" and status == "accepted" else None
    return (_judgement(frame, ref, status, state, author, reason),)


def judge_relation(
    frame: EffectiveFrame, a: int, b: int, relation: str, state: int, author: str, reason: str = ""
) -> Edits:
    """Judge a relation T (1), U (0) or F (-1) for one person, and its inverse: "accepted" or "corrected", no label
    changes.
    """
    refs = _both_ways(frame, relation_ref(frame.frame, a, b, f"{relation}.status"))
    _check_judged(frame, refs[0])
    return tuple(
        _judgement(frame, c, "accepted" if frame.value(state_ref(c)) == state else "corrected", state, author, reason)
        for c in refs
    )


def judge_both_ways(frame: EffectiveFrame, ref: FieldRef, status: str | None, author: str, reason: str = "") -> Edits:
    """Judge a relation and its inverse, unless the labels contradict the inverse."""
    _check_judged(frame, ref)
    now = frame.value(state_ref(ref))
    refs = [c for c in _both_ways(frame, ref) if frame.value(state_ref(c)) == now]
    return tuple(e for c in refs for e in judge(frame, c, status, author, reason))


def settle(frame: EffectiveFrame, ref: FieldRef, status: str, reason: str = "", state: int | None = None) -> Edits:
    """Settle an item of differing judgements, for all reviewers.

    `state` (T, U, F) is for a relation: the labels follow; by default unchanged.
    """
    _check_judged(frame, ref)
    made: Edits = ()
    if ref.kind == "relation":
        now = frame.value(state_ref(ref))
        state = now if state is None else state
        if state != now:
            made = set_relation(frame, *ref.numbers, state_ref(ref).field, state, reason)  # pyright: ignore
    elif (status == "rejected") != (frame.statuses.get(ref) == "rejected"):
        made = set_status(frame, ref, status, reason)
    return (*made, _judgement(frame, ref, status, state, OF_ALL, reason))


def _both_ways(frame: EffectiveFrame, ref: FieldRef) -> list[FieldRef]:
    """Relation (or status) cell, with the inverse where the profile has any."""
    relation, status = state_ref(ref).field, ".status" if ref.field.endswith(".status") else ""
    inverse, (a, b) = frame.setting.inverse(relation), ref.numbers
    return [ref] if inverse is None else [ref, relation_ref(frame.frame, b, a, f"{inverse}{status}")]


def state_ref(ref: FieldRef) -> FieldRef:
    """Relation cell of a status."""
    return FieldRef(ref.kind, ref.frame, ref.key, ref.field.removesuffix(".status"))


def _check_judged(frame: EffectiveFrame, ref: FieldRef) -> None:
    require(
        ref.kind in ("object", "relation", "expression") and ref.field.endswith("status"),
        "only objects, relations and expressions are judged",
        got=str(ref),
    )
    _check(frame, ref)


def _judgement(
    frame: EffectiveFrame, ref: FieldRef, status: str | None, state: int | None, author: str, reason: str
) -> Edit:
    a, b = (*ref.numbers, None, None)[:2]
    what = {"object": "", "relation": ref.field.removesuffix(".status")}.get(ref.kind, ref.key)
    own = judgement_ref(frame.frame, ref.kind, -1 if a is None else a, b, what, author)
    return _edit(frame, own, None if status is None else {"status": status, "value": state}, reason)


def add_sentence(
    frame: EffectiveFrame,
    text: str,
    words: tuple[str, str, str],
    a: int,
    b: int,
    reason: str = "",
) -> Edits:
    """Add a true expression "a RELATION b" in a person's words, with all true answers.

    `words` are target, relation and reference as the text names them. Contradicting relations are corrected with it.
    InputError for no such pair or relation, or where the labels say so already.
    """
    target, relation, reference = words
    now = frame.value(relation_ref(frame.frame, a, b, relation))
    made = () if now == T else set_relation(frame, a, b, relation, T, reason or f"“{text}” is true")
    pairs, k = frame.pairs, PAIRWISE.index(relation)
    same = same_names([frame.objects[int(n)]["label"] for n in pairs.numbers])
    i, j = needed(pairs.index_of(a), "no such pair"), needed(pairs.index_of(b), "no such pair")
    states = np.where(pairs.present, pairs.states[..., k], NOT_JUDGED)[:, same[j]]
    sure, likely = ([a, *pairs.numbers[same[i] & (states >= least).any(axis=1)].tolist()] for least in (T, U))
    seed = {
        "text": text,
        "target": target,
        "relation": relation,
        "reference": reference,
        "target_object": a,
        "reference_object": b,
        "targets": sure,
        "acceptable": likely,
    }
    spoken = " ".join(text.casefold().split())
    name = f"{row_hash(frame.setting.config.seed, frame.frame, 'by hand', spoken):016x}"
    ref = FieldRef("expression", frame.frame, name, "exists")
    known = [r["id"] for r in frame.expressions.values() if " ".join(r["text"].casefold().split()) == spoken]
    if known and known[0] != ref.key:
        row = frame.expressions[known[0]]
        return (*made, *set_answers(frame, known[0], {*row["targets"], a}, {*row["acceptable"], a}, reason))
    require(frame.value(ref) != checked(ref, seed) or made, "the labels say so already", got=text)
    return (*made, _edit(frame, ref, seed, reason))


def set_text(frame: EffectiveFrame, expression: str, text: str, reason: str = "") -> Edits:
    """Set the sentence of an expression."""
    return (_expression_edit(frame, expression, "text", text, reason),)


def set_answers(
    frame: EffectiveFrame,
    expression: str,
    targets: Iterable[int],
    acceptable: Iterable[int] | None = None,
    reason: str = "",
) -> Edits:
    """Set the answers of an expression beyond doubt, and with doubt (by default none more).

    InputError for no answer, no such expression or object, or a target that is not acceptable.
    """
    sure = sorted(set(targets))
    likely = sorted({*sure, *acceptable}) if acceptable is not None else sure
    require(likely, "an expression needs an answer", cause='is it wrong? then mark it "BAD_LABEL"')
    for number in likely:
        _row(frame, number)
    return (
        _expression_edit(frame, expression, "targets", sure, reason),
        _expression_edit(frame, expression, "acceptable", likely, reason),
        _expression_edit(frame, expression, "ambiguous", len(likely) > 1, reason),
    )


def set_ambiguous(frame: EffectiveFrame, expression: str, ambiguous: bool, reason: str = "") -> Edits:
    """Set whether several objects are acceptable."""
    return (_expression_edit(frame, expression, "ambiguous", ambiguous, reason),)


def set_mark(frame: EffectiveFrame, expression: str, mark: str | None, reason: str = "") -> Edits:
    """Mark a wrong label or box: BAD_LABEL, BAD_BOX, None to take the mark off."""
    return (_expression_edit(frame, expression, "mark", mark, reason),)


def set_note(frame: EffectiveFrame, note: str | None, reason: str = "") -> Edits:
    """Set the frame's note."""
    return (_edit(frame, FieldRef("frame", frame.frame, "", "note"), note, reason),)


def set_value(frame: EffectiveFrame, ref: FieldRef, value: Any, reason: str = "") -> Edits:
    """Set any cell as kept, and nothing else."""
    return (_edit(frame, ref, value, reason),)


def _edit(frame: EffectiveFrame, ref: FieldRef, after: Any, reason: str) -> Edit:
    _check(frame, ref)
    require(ref.frame == frame.frame, "an edit of another frame", got=ref.frame, expected=frame.frame)
    boxes = frame.auto.objects
    anchor = {str(n): [float(x) for x in boxes[n]["bbox"]] for n in ref.numbers if n in boxes}
    return Edit(ref, frame.value(ref), checked(ref, after), frame.version(ref), reason, anchor)


def _object_edit(frame: EffectiveFrame, number: int, field: str, after: Any, reason: str) -> Edit:
    return _edit(frame, object_ref(frame.frame, number, field), after, reason)


def _expression_edit(frame: EffectiveFrame, expression: str, field: str, after: Any, reason: str) -> Edit:
    return _edit(frame, FieldRef("expression", frame.frame, expression, field), after, reason)


def _row(frame: EffectiveFrame, number: int) -> dict[str, Any]:
    expected = ", ".join(map(str, sorted(frame.objects)[:20]))
    return needed(frame.object(number), f"frame {frame.frame} has no object {number}", expected=expected)


def _check(frame: EffectiveFrame, ref: FieldRef) -> None:
    """Refuse a cell of no object, expression or pair of the frame."""
    if ref.kind == "object" and ref.field != "exists":
        _row(frame, ref.numbers[0])
    require(
        ref.kind != "expression" or ref.field == "exists" or ref.key in frame.sentences,
        f"frame {frame.frame} has no such expression",
        got=repr(ref.key),
    )
    if ref.kind != "relation":
        return
    relation = ref.field.removesuffix(".status")
    if relation not in frame.setting.relations:
        expected = listed(frame.setting.relations)
        raise InputError("the labels hold no such relation", got=repr(relation), expected=expected)
    a, b = ref.numbers
    require(a != b, "an object has no relation to itself", got=a)
    for number in (a, b):
        _row(frame, number)
        require(
            frame.pairs.index_of(number) is not None,
            f"object {number} takes part in no relation",
            cause="is it background, or rejected?",
        )


def _code(frame: EffectiveFrame, mask: np.ndarray | str) -> str:
    size = frame.size
    pixels = decode_run_length(size, mask) if isinstance(mask, str) else mask
    require(
        pixels.dtype == np.bool_ and pixels.shape == size,
        f"a mask must be bool {size}",
        got=f"{pixels.dtype} {pixels.shape}",
    )
    require(pixels.any(), "the mask is empty")
    return mask if isinstance(mask, str) else encode_run_length(pixels)


def pixels_of(frame: EffectiveFrame, number: int) -> np.ndarray:
    """Mask (H, W) bool of an object, or the filled 2D box; InputError for no such object."""
    row = _row(frame, number)
    return (
        box_mask(np.array(row["bbox"], np.float32), *frame.size)
        if row["mask"] is None
        else decode_run_length(frame.size, row["mask"], f"object {number}")
    )


def _within(frame: EffectiveFrame, bbox: Rectangle) -> list[float]:
    x0, y0, x1, y1 = checked(object_ref(frame.frame, 0, "bbox"), [float(x) for x in bbox])
    height, width = map(float, frame.size)
    inside = [max(x0, 0.0), max(y0, 0.0), min(x1, width), min(y1, height)]
    require(
        inside[2] > inside[0] and inside[3] > inside[1],
        "the 2D box is outside the picture",
        got=[x0, y0, x1, y1],
        expected=f"{width:g}x{height:g}",
    )
    return inside
