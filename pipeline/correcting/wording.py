"""Corrections in words, with the names of the objects."""

from __future__ import annotations

from collections.abc import Sequence

from pipeline.journal.cells import judged_item, shown_value
from pipeline.journal.effective_frame import EffectiveFrame
from pipeline.journal.events import Conflict, Event, Rival
from pipeline.relations import INVERSE, PHRASE, letter


def object_name(frame: EffectiveFrame, number: int) -> str:
    """ "mug·3": the class and the number of an object that stands, was left out, or is not known."""
    row = frame.objects.get(number) or frame.left_out.get(number) or frame.auto.objects.get(number)
    return f"{'object' if row is None else row['label']}·{number}"


def event_said(event: Event, frame: EffectiveFrame) -> str:
    """One event of a frame in words."""
    cell = event.cell
    before, after = (shown_value(cell, value) for value in (event.before, event.after))
    if cell.kind == "review":
        return _judged(event, frame)
    if cell.kind == "relation":
        a, b = (object_name(frame, n) for n in cell.numbers)
        relation, _, status = cell.field.partition(".")
        said = f"{a} {PHRASE[relation]} {b}"
        return f"{said}: {after}" if status else f"{said}: {before} → {after}"
    if cell.kind == "object":
        name = object_name(frame, cell.numbers[0])
        if cell.field == "exists":
            return f"{name} added" if event.after is not None else f"{name} taken away"
        if cell.field == "label":
            return f"object {cell.key}: {before} → {after}"
        if cell.field == "status":
            return f"{name}: {after if event.after is not None else 'not reviewed'}"
        what = {"mask": "pixels", "bbox": "2D box", "box": "3D box"}[cell.field]
        return f"{what} of {name}" + ("" if event.after is not None else ": automatic again")
    if cell.kind == "expression":
        row = frame.expressions.get(cell.key) or frame.auto.expressions.get(cell.key)
        text = cell.key if row is None else f"“{row['text']}”"
        if cell.field in ("targets", "acceptable"):
            numbers = event.after or []
            after = ", ".join(object_name(frame, n) for n in numbers) or "none"
        return f"{cell.field} of {text}: {after}"
    return f"{cell.field} of the frame: {after}"


def _judged(event: Event, frame: EffectiveFrame) -> str:
    _, kind, a, b, what = judged_item(event.cell.key)
    if kind == "relation":
        said = f"{object_name(frame, a)} {PHRASE[what]} {object_name(frame, int(b or 0))}"
    elif kind == "object":
        said = object_name(frame, a) if a >= 0 else "nothing is missing there"
    else:
        row = frame.expressions.get(what) or frame.auto.expressions.get(what)
        said = what if row is None else f"“{row['text']}”"
    if event.after is None:
        return f"{said}: judgement withdrawn"
    value = event.after.get("value")
    state = "" if value is None else f" is {letter(value)}"
    return f"{said}{state}: {event.after['status']}"


def action_said(events: Sequence[Event], frame: EffectiveFrame) -> str:
    """An action in words: its first event, and how much more there is; the mirror of a relation is not counted."""
    if not events:
        return ""
    first, rest = events[0], [e for e in events[1:] if not _mirrors(events[0], e)]
    more = f" (and {len(rest)} more)" if rest else ""
    return event_said(first, frame) + more


def conflict_said(conflict: Conflict, frame: EffectiveFrame) -> str:
    """What stands in the way of an action, in words."""
    return "; ".join(rival_said(rival, frame) for rival in conflict.rivals)


def rival_said(rival: Rival, frame: EffectiveFrame) -> str:
    """Who was faster, with what."""
    if rival.event is None:
        return str(rival)
    return f"{rival.event.author} at {rival.event.time:%H:%M:%S}: {event_said(rival.event, frame)}"


def _mirrors(one: Event, other: Event) -> bool:
    """Whether an event says of "b ... a" what another says of "a ... b"."""
    first, second = _pair(one), _pair(other)
    if first is None or second is None:
        return False
    (a, b, relation), (c, d, mirrored) = first, second
    return (a, b) == (d, c) and mirrored == ("near" if relation == "near" else INVERSE.get(relation))


def _pair(event: Event) -> tuple[int, int, str] | None:
    if event.cell.kind == "relation":
        a, b = event.cell.numbers
        return a, b, event.cell.field
    if event.cell.kind == "review":
        _, kind, a, b, what = judged_item(event.cell.key)
        if kind == "relation" and b is not None:
            return a, b, what
    return None
