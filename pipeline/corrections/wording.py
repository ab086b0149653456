"""Corrections in words, and what followed from them, with the classes of the objects instead of bare numbers."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from pipeline.corrections.journal.effective_frame import EffectiveFrame
from pipeline.corrections.journal.events import Conflict, Event, Saved
from pipeline.corrections.journal.field_refs import FieldRef, box_of, judged_item, object_ref, shown_value
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


@dataclass(frozen=True)
class BoxChange:
    """A 3D box that is not what it was."""

    number: int
    name: str  # "mug·3"
    # moved, grown: metres by which its centre moved; factor by which its volume grew. None where there was or is no
    # box.
    moved: float | None
    grown: float | None
    gone: bool = False  # there is no box any more

    def __str__(self) -> str:
        if self.gone:
            return f"{self.name} has no 3D box any more"
        if self.moved is None or self.grown is None:
            return f"3D box of {self.name} fitted"
        percent = f", {100 * (self.grown - 1):+.0f} % volume" if abs(self.grown - 1) >= 0.005 else ""
        return f"3D box of {self.name} recomputed: moved {100 * self.moved:.1f} cm{percent}"


@dataclass(frozen=True)
class RelationChange:
    """A relation whose state is not what it was; None is no state."""

    a: str
    b: str
    relation: str
    before: int | None
    after: int | None

    def __str__(self) -> str:
        was, now = ("none" if s is None else letter(s) for s in (self.before, self.after))
        return f"{self.a} {PHRASE[self.relation]} {self.b} {was}→{now}"


@dataclass(frozen=True)
class Consequences:
    """What is different in a frame after an edit."""

    # appeared, gone: names of objects
    appeared: tuple[str, ...] = ()
    gone: tuple[str, ...] = ()
    unusable: tuple[str, ...] = ()  # objects that stand but are not asked for, and were before, with the reason
    boxes: tuple[BoxChange, ...] = ()  # without those that a person placed
    recomputed: int = 0  # relations that were judged anew; a relation and its mirror image are one
    # changed: those of objects that were there before that came out otherwise; what a person set is not among them
    changed: tuple[RelationChange, ...] = ()
    stale: bool = False  # something could not be recomputed, because the dataset is not at hand
    answers: tuple[str, ...] = ()  # texts of expressions with other answers
    # withdrawn, returned: texts of expressions that are left out now, or no longer
    withdrawn: tuple[str, ...] = ()
    returned: tuple[str, ...] = ()

    def __str__(self) -> str:
        parts = [f"{name} added" for name in self.appeared] + [f"{name} left out" for name in self.gone]
        parts += [str(b) for b in self.boxes] + list(self.unusable)
        if self.recomputed or self.changed:
            count = f"{counted(self.recomputed, 'relation')} recomputed, " if self.recomputed else "relations: "
            told = "; ".join(map(str, self.changed[:MOST_SHOWN])) + (" ..." if len(self.changed) > MOST_SHOWN else "")
            parts.append(f"{count}{len(self.changed) or 'none'} changed" + (f": {told}" if told else ""))
        texts = {"answered otherwise": self.answers, "withdrawn": self.withdrawn, "back": self.returned}
        parts += [f"{counted(len(found), 'expression')} {what}" for what, found in texts.items() if found]
        if self.stale:
            parts.append("what follows is stale: the dataset is not at hand")
        return " · ".join(parts)


def consequences(before: EffectiveFrame, after: EffectiveFrame) -> Consequences:
    """Compare two states of one frame."""
    old, new = before.objects, after.objects
    both = sorted(old.keys() & new.keys())
    unusable = tuple(
        f"{_name(after, n)} is not asked for: {new[n]['reason']}"
        for n in sorted(new)
        if not new[n]["usable"] and (n not in old or old[n]["usable"]) and new[n]["reason"]
    )
    told = before.origins
    renewed = {
        (key, column): origin.source
        for (table, key, column), (origin, _) in after.origins.items()
        if table == "relations"
        and origin.source in ("recomputed", "stale")
        and ((table, key, column) not in told or told[table, key, column][0].event != origin.event)
    }
    human = {
        (key, column)
        for (table, key, column), (origin, _) in after.origins.items()
        if table == "relations" and origin.source == "human"
    }
    pairs = ((*map(int, key.split(",")), column) for key, column in renewed)
    mirrored = {_folded(after, a, b, column) for a, b, column in pairs}
    texts = {i: row["text"] for i, row in (*after.expressions.items(), *before.expressions.items())}
    kept = before.expressions.keys() & after.expressions.keys()
    sets = ("targets", "acceptable")
    return Consequences(
        tuple(_name(after, n) for n in sorted(new.keys() - old.keys())),
        tuple(_name(before, n) for n in sorted(old.keys() - new.keys())),
        unusable,
        tuple(_box_changes(before, after, both)),
        len(mirrored),
        tuple(_relation_changes(before, after, both, human)),
        "stale" in renewed.values(),
        _texts(texts, (i for i in kept if any(before.expressions[i][s] != after.expressions[i][s] for s in sets))),
        _texts(texts, before.expressions.keys() - kept),
        _texts(texts, after.expressions.keys() - kept),
    )


def _box_changes(before: EffectiveFrame, after: EffectiveFrame, both: Iterable[int]) -> Iterable[BoxChange]:
    for n in sorted({*both, *(after.objects.keys() - before.objects.keys())}):
        was = labelled_box(before.objects[n]) if n in before.objects else None
        now = labelled_box(after.objects[n])
        if after.origin(object_ref(after.frame, n, "box")).source == "human":
            continue
        if now is None or was is None:
            if now is not was:
                yield BoxChange(n, _name(after, n), None, None, gone=now is None)
        else:
            moved = float(np.linalg.norm(now.center - was.center))
            if moved >= SAME_POSITION or float(np.abs(now.corners - was.corners).max()) >= SAME_POSITION:
                yield BoxChange(n, _name(after, n), moved, float(now.volume / max(was.volume, 1e-12)))


def _relation_changes(
    before: EffectiveFrame, after: EffectiveFrame, both: list[int], human: set[tuple[str, str]]
) -> Iterable[RelationChange]:
    was, now = before.pairs.of_objects(both), after.pairs.of_objects(both)
    seen: set[tuple[int, int, str]] = set()
    for i, j, k in np.argwhere(was.states != now.states):
        a, b, relation = both[i], both[j], PAIRWISE[k]
        if (f"{a},{b}", relation) in human or (folded := _folded(after, a, b, relation)) in seen:
            continue
        seen.add(folded)
        states = [None if s == NOT_JUDGED else int(s) for s in (was.states[i, j, k], now.states[i, j, k])]
        yield RelationChange(_name(after, a), _name(after, b), relation, *states)


def _folded(frame: EffectiveFrame, a: int, b: int, relation: str) -> tuple[int, int, str]:
    """Common name of a relation and the mirror image."""
    inverse = frame.setting.inverse(relation)
    return (a, b, relation) if inverse is None else min((a, b, relation), (b, a, inverse))


def _name(frame: EffectiveFrame, number: int) -> str:
    return f"{frame.objects[number]['label']}·{number}"


def _texts(texts: dict[str, str], ids: Iterable[str]) -> tuple[str, ...]:
    return tuple(texts[i] for i in sorted(ids))
