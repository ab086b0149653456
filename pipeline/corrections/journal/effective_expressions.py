"""The expressions of a frame after corrections: what people set and added, and what follows from its objects."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from pipeline.corrections.journal.effective_frame import EffectiveFrame, Withdrawn
from pipeline.corrections.journal.events import Event
from pipeline.corrections.journal.field_refs import FieldRef
from pipeline.corrections.journal.frame_rows import AT, Answered, Asked, Row
from pipeline.corrections.journal.replay import Origin, all_gone, replay
from pipeline.labels.wording import expression_text
from pipeline.language.noun_phrase import alone
from pipeline.system.errors import InputError

_alone = lru_cache(maxsize=64)(alone)
_text = lru_cache(maxsize=4_096)(expression_text)
"""Names and sentences of a frame come again with every object that is corrected in it."""
SETS = ("targets", "acceptable", "ambiguous")
OPEN_FIELDS = ("text", *SETS)
"""The columns that a person may set."""


def correct_expressions(
    frame: EffectiveFrame,
    said: Mapping[FieldRef, Sequence[Event]],
    before: EffectiveFrame | None,
    came: Sequence[Event],
) -> None:
    """Apply the events of expressions, and update consequences of objects and relations.

    `before` is the frame without the newest events, `came`: what they do not touch stands as it was.
    """
    expressions, asked = frame.auto.expressions, frame.asked
    fields: dict[str, dict[str, Sequence[Event]]] = {}
    for ref, events in said.items():
        fields.setdefault(ref.key, {})[ref.field] = events
    again = {e.ref.key for e in came if e.ref.kind == "expression"}
    if before is None or before.pairs is not frame.pairs:
        frame.answers = _answered(frame)
        # What a person added takes its margin from the pair.
        again |= fields.keys() - expressions.keys()
    answers: _Answers | None = frame.answers
    if before is None:
        frame.outcomes = dict(expressions)
        again |= {*fields, *_changed(asked, answers, None)}
    elif answers is not before.answers:
        again |= {*_changed(asked, answers, before.answers), *_changed(asked, before.answers, answers)}
        _name_cause(frame, answers, before.answers)
    frame.forget("expressions", again)
    for name in again:
        frame.outcomes.pop(name, None)
        frame.marks.pop(name, None)
        for column in ("status", "exists"):
            frame.statuses.pop(FieldRef("expression", frame.frame, name, column), None)
    fields = {name: fields.get(name, {}) for name in again}
    for name in sorted(fields, key=lambda n: (asked.index.get(n, len(asked.ids)), n)):
        row = expressions.get(name)
        if row is None:
            _add(frame, name, fields[name])
        else:
            follows = answers if answers is not None and answers.now.changed[asked.index[name]] else None
            _correct(frame, dict(row), fields[name], follows)
    added = sorted(frame.outcomes.keys() - expressions.keys())
    frame.outcomes = {name: frame.outcomes[name] for name in (*expressions, *added)}
    frame.expressions = {name: found for name, found in frame.outcomes.items() if found.__class__ is dict}  # pyright: ignore
    frame.withdrawn = tuple([found for found in frame.outcomes.values() if found.__class__ is Withdrawn])  # pyright: ignore


class _Answers(NamedTuple):
    """Answers of the automatic expressions now, and the origins of what follows from them."""

    now: Answered
    recomputed: Origin
    stale: Origin


def _changed(asked: Asked, answers: _Answers | None, before: _Answers | None) -> list[str]:
    """Ids of expressions that may follow from the answers, but for those with the same answer `before`."""
    if answers is None:
        return []
    changed, now = answers.now.changed, answers.now
    if before is not None:
        was = before.now
        margins = (now.margins == was.margins) | (np.isnan(now.margins) & np.isnan(was.margins))
        changed = changed & (now.differs(was) | ~margins | (now.holds != was.holds) | (changed != was.changed))
    return [asked.ids[at] for at in np.flatnonzero(changed).tolist()]


def _name_cause(frame: EffectiveFrame, answers: _Answers | None, before: _Answers | None) -> None:
    """Name the newest correction as the cause of what follows from the answers."""
    if answers is not None and before is not None:
        newest = {id(before.recomputed): answers.recomputed, id(before.stale): answers.stale}
        frame.origins = {at: (newest.get(id(found), found), was) for at, (found, was) in frame.origins.items()}


def _answered(frame: EffectiveFrame) -> _Answers | None:
    """Answer all expressions by the pairs; None where no correction can change an answer."""
    auto, pairs, asked = frame.auto, frame.pairs, frame.asked
    anew = (
        pairs.numbers.tolist() != sorted(auto.objects)
        or bool(np.isin(pairs.numbers, list(frame.moved)).any())
        or bool((pairs.states != frame.related.states).any())
    )
    if frame.cause is None or not (anew or frame.renamed or frame.left_out):
        return None
    rows = [frame.objects[n] for n in pairs.numbers.tolist()]
    now = Answered.of(asked, pairs, tuple([row["label"] for row in rows]))
    usable = np.array([row["usable"] for row in rows], np.bool_) | frame.stale
    unusable = np.isin(asked.ends, pairs.numbers[~usable]).any(axis=1)
    margins = np.isfinite(now.margins) & ~np.isclose(now.margins, asked.margins, atol=1e-6)
    stale = (now.kin & frame.stale).any(axis=1)
    renamed = np.isin(asked.ends, list(frame.renamed)).any(axis=1)
    changed = ~now.related | now.differs(asked.before) | margins | stale | renamed | ~now.holds | unusable
    origins = Origin.of("recomputed", frame.cause), Origin.of("stale", frame.cause)
    return _Answers(replace(now, changed=changed), *origins)


def _add(frame: EffectiveFrame, name: str, fields: dict[str, Sequence[Event]]) -> None:
    """Apply the events of an added expression."""
    seeds = fields.pop("exists", [])
    seed = frame.note(seeds, replay(None, seeds)) if seeds else None
    if seed is None or seed.value is None or seed.event is None:
        for events in fields.values():
            frame.note(events, all_gone(None, events, "there is no such expression any more"))
        return
    frame.statuses[seeds[0].ref] = seed.value
    row, auto = {"frame": frame.frame, "frame_index": frame.auto.index, "id": name, **seed.value}, frame.auto.row
    i, j = (frame.pairs.index_of(row[end]) for end in ("target_object", "reference_object"))
    margin = np.nan if i is None or j is None else frame.pairs.margins[i, j, AT[row["relation"]]]
    row |= {
        "ambiguous": len(row["acceptable"]) > 1,
        "margin": float(margin) if np.isfinite(margin) else None,
        "judged_in": "viewer",
        "up_source": auto["up_source"] or "assumed",
        "profile": frame.setting.config.profile,
    }
    for column in row:
        frame.put("expressions", name, column, Origin.of("human", seed.event))
    gone = next((n for n in (row["target_object"], row["reference_object"]) if n not in frame.objects), None)
    _correct(frame, row, fields, None, None if gone is None else f"object {gone} is gone", {"targets"})


def _correct(
    frame: EffectiveFrame,
    row: Row,
    fields: Mapping[str, Sequence[Event]],
    answers: _Answers | None,
    reason: str | None = None,
    human: Collection[str] = (),
) -> None:
    """Apply the events of an expression, after the pairs' answers."""
    name, was, human = row["id"], dict(row), set(human)
    reason = reason if answers is None else _follow(frame, row, answers)
    for column in sorted(fields):
        events, is_open = fields[column], column in OPEN_FIELDS
        trusted = is_open and row[column] != was[column]
        after = frame.note(events, replay(was[column] if is_open else None, events, trusted=trusted))
        if after.event is None:
            continue
        if is_open:
            row[column] = after.value
            human.add(column)
        elif after.value is not None and column == "mark":
            frame.marks[name] = after.value
        elif after.value is not None:
            frame.statuses[events[0].ref] = after.value
        if after.value is not None:
            frame.put("expressions", name, column, Origin.of("human", after.event), was.get(column))
    if human & {"acceptable", "targets"}:
        row["ambiguous"] = row["ambiguous"] if "ambiguous" in human else len(row["acceptable"]) > 1
        reason = None if reason is not None and reason.startswith("it is no longer true") else reason
        missing = [n for n in {*row["targets"], *row["acceptable"]} if n not in frame.objects]
        if missing:
            reason = f"its answers name object {missing[0]}, which there is no more"
        elif not row["acceptable"]:
            reason = "it has no answer"
    if frame.statuses.get(FieldRef("expression", frame.frame, name, "status")) == "rejected":
        reason = "rejected"
    frame.outcomes[name] = row if reason is None else Withdrawn(frame.frame, name, row["text"], reason, row)


def _follow(frame: EffectiveFrame, row: Row, answers: _Answers) -> str | None:
    """Update an expression's names, answers and margin; the reason where withdrawn."""
    now, ends, at = answers.now, (row["target_object"], row["reference_object"]), frame.asked.index[row["id"]]
    for number in ends:
        if number not in frame.objects:
            return f"object {number} was left out" if number in frame.left_out else f"object {number} is gone"
    problem = _reword(frame, row)
    if problem is not None:
        return problem
    if not now.related[at]:
        return "one of its objects takes part in no relation now"
    name, numbers, before = row["id"], now.numbers, frame.asked.before
    sure, likely = (numbers[found].tolist() for found in now.sets[at])
    was = [before.numbers[found].tolist() for found in before.sets[at]] if before.related[at] else None
    after: Row = {}
    if [sure, likely] != was:
        after = {"targets": sure, "acceptable": likely, "ambiguous": len(likely) > 1}
    margin = float(now.margins[at])
    if np.isfinite(margin) and not np.isclose(margin, frame.asked.margins[at], atol=1e-6):
        after["margin"] = margin
    for column in [c for c in after if row[c] != after[c]]:
        frame.put("expressions", name, column, answers.recomputed, row[column])
        row[column] = after[column]
    if (now.kin[at] & frame.stale).any():
        for column in SETS:
            frame.put("expressions", name, column, answers.stale, row[column])
    if not now.holds[at]:
        return "it is no longer true of its own objects"
    for number in ends:
        if not frame.objects[number]["usable"] and not frame.stale[frame.pairs.index_of(number)]:
            return f"object {number} may not be asked for: {frame.objects[number]['reason']}"
    return None


def _reword(frame: EffectiveFrame, row: Row) -> str | None:
    """Make the sentence of new class names; the reason where none can carry them."""
    ends = row["target_object"], row["reference_object"]
    labels = dict(zip(("target", "reference"), (frame.objects[n]["label"] for n in ends), strict=True))
    events = [frame.renamed[n] for n in ends if n in frame.renamed]
    if not events or all(row[role] == label for role, label in labels.items()):
        return None
    names = tuple(sorted({*frame.setting.class_names, *labels.values()}))
    single = _alone(tuple([r["label"] for r in frame.objects.values()]))
    of_setting = {"style": frame.setting.config.style, "class_names": names}
    several = tuple([not single[list(frame.objects).index(n)] for n in ends])
    spoken = labels["target"], row["relation"], labels["reference"], int(row["id"], 16)
    try:
        text = _text(*spoken, **of_setting, several=several)
    except (InputError, ValueError):
        return "no sentence can carry the new class names"
    origin = Origin.of("recomputed", max(events, key=lambda e: e.id))
    for column, value in (*labels.items(), ("text", text)):
        if row[column] != value:
            frame.put("expressions", row["id"], column, origin, row[column])
            row[column] = value
    return None
