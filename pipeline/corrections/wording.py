"""Corrections in words, and what followed from them, with the classes of the objects instead of bare numbers."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from pipeline.corrections.journal.effective_frame import EffectiveFrame
from pipeline.corrections.journal.events import Conflict, Event, Saved
from pipeline.corrections.journal.field_refs import FieldRef, box_of, judged_item, object_ref, relation_ref, shown_value
from pipeline.corrections.scene import labelled_box
from pipeline.corrections.unsaved import Waiting
from pipeline.geometry.boxes import Box3D
from pipeline.language.counted import counted
from pipeline.language.relation_names import MIRRORED, PAIRWISE, PHRASE
from pipeline.relations.pair_measures import NOT_JUDGED
from pipeline.relations.relations import letter

FIELDS = {
    "targets": "sure answers",
    "acceptable": "answers",
    "label": "class",
    "bbox": "2D box",
    "box": "3D box",
    "mask": "pixels",
    "exists": "presence",
}
LONGEST = 48
SMALLEST_MOVE = 5e-4
"""Metres: less is not told of a box."""
SMALLEST_TURN = 0.05
"""Degrees."""
SAME_POSITION = 1e-3
"""A box that moves or grows by less, metres, is the same."""
MOST_SHOWN = 3
"""So many changed relations are told one by one."""


def object_text(number: int, frame: EffectiveFrame | None) -> str:
    """ "mug·3"; "object·3" where nothing is known of it."""
    row = None if frame is None else frame.object(number) or frame.auto.objects.get(number)
    return f"{'object' if row is None else row['label']}·{number}"


def sentence_text(name: str, frame: EffectiveFrame | None) -> str:
    """Words of an expression in quotes; the id for an unknown expression."""
    row = None if frame is None else frame.expression(name)
    if row is None:
        return f"expression {name}"
    text = row["text"]
    return f"“{text if len(text) <= LONGEST else f'{text[: LONGEST - 1]}…'}”"


def ref_text(ref: FieldRef, frame: EffectiveFrame | None) -> str:
    """A field in words."""
    field = FIELDS.get(ref.field, ref.field)
    if ref.kind == "review":
        return f"judgement of {_judged(ref, frame)}"
    if ref.kind == "relation":
        a, b = (object_text(n, frame) for n in ref.numbers)
        relation, _, status = ref.field.partition(".")
        return f"{status and 'status of '}{a} {PHRASE.get(relation, relation)} {b}"
    if ref.kind == "frame":
        return f"{field} of the {ref.kind}"
    named = object_text(ref.numbers[0], frame) if ref.kind == "object" else sentence_text(ref.key, frame)
    return f"{field} of {named}"


def value_text(ref: FieldRef, value: Any, frame: EffectiveFrame | None) -> str:
    """A value in words."""
    if ref.kind == "expression" and isinstance(value, list):
        return ", ".join(object_text(n, frame) for n in value) or "nothing"
    if isinstance(value, bool):
        return "yes" if value else "no"
    if ref.kind == "object" and ref.field == "box":
        return "as its points make it" if value is None else "placed by hand"
    return shown_value(ref, value)


def event_text(event: Event, frame: EffectiveFrame | None) -> str:
    """Change of an event in words."""
    ref = event.ref
    if ref.kind == "review":
        if event.after is None:
            return f"{_judged(ref, frame)}: judgement withdrawn"
        value = event.after.get("value")
        state = "" if value is None else f" is {letter(value)}"
        return f"{_judged(ref, frame)}{state}: {event.after['status']}"
    if ref.kind == "object" and ref.field == "box" and event.before is not None and event.after is not None:
        return f"{ref_text(ref, frame)}: {_box_change(box_of(event.before), box_of(event.after))}"
    if ref.field == "exists" and event.before is None and event.after is not None:
        return shown_value(ref, event.after)
    before, after = (value_text(ref, value, frame) for value in (event.before, event.after))
    return f"{ref_text(ref, frame)}: {before} → {after}"


def _box_change(before: Box3D, after: Box3D) -> str:
    """Change of a box in words."""
    moved = float(np.linalg.norm(after.center - before.center))
    angle = np.rad2deg(np.arccos(np.clip((np.trace(before.R.T @ after.R) - 1) / 2, -1, 1)))
    parts = [f"moved {100 * moved:.1f} cm"] if moved >= SMALLEST_MOVE else []
    if np.abs(after.size - before.size).max() >= SMALLEST_MOVE:
        parts.append(" → ".join(" × ".join(f"{x:.3f}" for x in box.size) for box in (before, after)) + " m")
    if angle >= SMALLEST_TURN:
        parts.append(f"turned {angle:.1f}°")
    return ", ".join(parts) or "less than a millimetre"


def events_text(events: Sequence[Event], frame: EffectiveFrame | None) -> str:
    """Summary of an action: the first change in words, and the number of further changes.

    What follows for "b ... a" from what was said of "a ... b" is not counted.
    """
    changes = [e for e in events if e.before != e.after] or list(events)
    if not changes:
        return ""
    more = sum(not _mirrors(changes[0], e) for e in changes[1:])
    return event_text(changes[0], frame) + (f" (and {more} more)" if more else "")


def outcome_text(
    outcome: Saved | Conflict | Waiting | None, verb: str, frame: EffectiveFrame | None = None
) -> tuple[str, bool]:
    """Result of an action in words, and True where not done."""
    if isinstance(outcome, Saved):
        return f"{verb}: {events_text(outcome.events, frame)}", False
    if isinstance(outcome, Conflict):
        rival = outcome.rivals[0]
        who = "somebody" if rival.event is None else rival.event.author
        return f"not saved, {who} was faster: {ref_text(rival.edit.ref, frame)}", True
    if isinstance(outcome, Waiting) and verb == "taken back":
        return "taken back before it was saved", False
    if isinstance(outcome, Waiting):
        return "not saved yet: it is kept here, and saved as soon as the journal can be written", True
    return "", False


def _judged(ref: FieldRef, frame: EffectiveFrame | None) -> str:
    _, kind, a, b, what = judged_item(ref.key)
    if kind == "relation":
        return f"{object_text(a, frame)} {PHRASE.get(what, what)} {object_text(int(b or 0), frame)}"
    if kind == "object":
        return object_text(a, frame) if a >= 0 else "a place without a label"
    return sentence_text(what, frame)


def _mirrors(one: Event, other: Event) -> bool:
    first, second = _pair(one.ref), _pair(other.ref)
    return second is not None and first == (second[1], second[0], MIRRORED.get(second[2]))


def _pair(ref: FieldRef) -> tuple[int, int, str] | None:
    if ref.kind == "relation":
        return (*ref.numbers, ref.field)  # pyright: ignore[reportReturnType]
    _, kind, a, b, what = judged_item(ref.key) if ref.kind == "review" else ("", "", 0, None, "")
    return None if b is None or kind != "relation" else (a, b, what)


def consequences(before: EffectiveFrame, after: EffectiveFrame) -> str:
    """What is different in a frame after an edit, in one line; "" for nothing."""
    old, new = before.objects, after.objects
    parts = [f"{_name(after, n)} added" for n in sorted(new.keys() - old.keys())]
    parts += [f"{_name(before, n)} left out" for n in sorted(old.keys() - new.keys())]
    changed_rows = [n for n in sorted(new) if new[n] is not old.get(n)]
    parts += [text for n in changed_rows if (text := _box_followed(before, after, n))]
    parts += [
        f"{_name(after, n)} is not asked for: {new[n]['reason']}"
        for n in sorted(new)
        if not new[n]["usable"] and (n not in old or old[n]["usable"]) and new[n]["reason"]
    ]
    renewed = {
        (*map(int, key.split(",")), column): origin.source
        for (table, key, column), (origin, _) in after.all_origins().items()
        if table == "relations"
        and origin.source in ("recomputed", "stale")
        and before.noted("relations", key, column) != origin
    }
    judged = {_folded(after, a, b, relation) for a, b, relation in renewed}
    changed = _relations_followed(before, after)
    if judged or changed:
        count = f"{counted(len(judged), 'relation')} recomputed, " if judged else "relations: "
        told = "; ".join(changed[:MOST_SHOWN]) + (" ..." if len(changed) > MOST_SHOWN else "")
        parts.append(f"{count}{len(changed) or 'none'} changed" + (f": {told}" if told else ""))
    was, now = before.expressions, after.expressions
    kept = was.keys() & now.keys()
    answered = [i for i in kept if any(was[i][name] != now[i][name] for name in ("targets", "acceptable"))]
    texts = {"answered otherwise": answered, "withdrawn": was.keys() - kept, "back": now.keys() - kept}
    parts += [f"{counted(len(found), 'expression')} {what}" for what, found in texts.items() if found]
    if "stale" in renewed.values():
        parts.append("what follows is stale: the dataset is not at hand")
    return " · ".join(parts)


def _box_followed(before: EffectiveFrame, after: EffectiveFrame, number: int) -> str:
    """Change of a box that no person placed, in words; "" for none."""
    if after.origin(object_ref(after.frame, number, "box")).source == "human":
        return ""
    was = labelled_box(before.objects[number]) if number in before.objects else None
    now, name = labelled_box(after.objects[number]), _name(after, number)
    if now is None:
        return "" if was is None else f"{name} has no 3D box any more"
    if was is None:
        return f"3D box of {name} fitted"
    if float(np.abs(now.corners - was.corners).max()) < SAME_POSITION:
        return ""
    moved, grown = float(np.linalg.norm(now.center - was.center)), float(now.volume / max(was.volume, 1e-12)) - 1
    percent = f", {100 * grown:+.0f} % volume" if abs(grown) >= 0.005 else ""
    return f"3D box of {name} recomputed: moved {100 * moved:.1f} cm{percent}"


def _relations_followed(before: EffectiveFrame, after: EffectiveFrame) -> list[str]:
    """Relations with another state that no person set, in words; one for each and its mirror image."""
    both = sorted(before.objects.keys() & after.objects.keys())
    was, now = before.pairs.of_objects(both).states, after.pairs.of_objects(both).states
    found: dict[tuple[int, int, str], str] = {}
    for i, j, k in np.argwhere(was != now):
        a, b, relation = both[i], both[j], PAIRWISE[k]
        if after.origin(relation_ref(after.frame, a, b, relation)).source != "human":
            states = "→".join("none" if s == NOT_JUDGED else letter(int(s)) for s in (was[i, j, k], now[i, j, k]))
            text = f"{_name(after, a)} {PHRASE[relation]} {_name(after, b)} {states}"
            found.setdefault(_folded(after, a, b, relation), text)
    return list(found.values())


def _folded(frame: EffectiveFrame, a: int, b: int, relation: str) -> tuple[int, int, str]:
    """Common name of a relation and the mirror image."""
    inverse = frame.setting.inverse(relation)
    return (a, b, relation) if inverse is None else min((a, b, relation), (b, a, inverse))


def _name(frame: EffectiveFrame, number: int) -> str:
    return f"{frame.objects[number]['label']}·{number}"
