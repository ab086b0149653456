"""The expressions of a frame after corrections: what people set and added, and what follows from its objects."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence

import numpy as np

from pipeline.corrections.journal.effective_frame import (
    EffectiveFrame,
    Pairs,
    Row,
    Withdrawn,
)
from pipeline.corrections.journal.events import Event, grouped
from pipeline.corrections.journal.field_refs import FieldRef
from pipeline.corrections.journal.replay import (
    Origin,
    all_gone,
    replay,
)
from pipeline.labels.wording import expression_text
from pipeline.language.noun_phrase import alone, same_names
from pipeline.language.relation_names import PAIRWISE
from pipeline.relations.pair_measures import T, U
from pipeline.system.errors import InputError

SETS = ("targets", "acceptable", "ambiguous")
OPEN_FIELDS = ("text", *SETS)
"""The columns that a person may set."""


class Answers:
    """What is true of the objects of a frame, by class: see `labels.expressions.candidate_expressions`.

    Parameters
    ----------
    pairs : Pairs
    labels : mapping of int to str
        Class names by number.
    """

    def __init__(self, pairs: Pairs, labels: Mapping[int, str]) -> None:
        self.pairs = pairs
        self.same = same_names([labels[int(n)] for n in pairs.numbers])
        self._satisfied: dict[tuple[str, int], np.ndarray] = {}

    def sets(self, target: int, relation: str, reference: int) -> tuple[list[int], list[int]] | None:
        """Numbers of the objects that an expression is true of beyond doubt, and with doubt; None where either of its
        own objects takes part in no relation."""
        i, j = self.pairs.index_of(target), self.pairs.index_of(reference)
        if i is None or j is None:
            return None
        k, kinds = PAIRWISE.index(relation), self.same.astype(np.int32)
        for least in (T, U):
            if (relation, least) not in self._satisfied:
                state = np.where(self.pairs.present, self.pairs.states[..., k], -1)
                self._satisfied[relation, least] = (state >= least).astype(np.int32) @ kinds > 0
        strict, likely = (self.same[i] & self._satisfied[relation, least][:, j] for least in (T, U))
        return self.pairs.numbers[strict].tolist(), self.pairs.numbers[likely].tolist()


def correct_expressions(frame: EffectiveFrame, refs: Mapping[FieldRef, Sequence[Event]], cause: Event | None) -> None:
    """Apply corrections of expressions, and let the others follow from objects and relations, which are corrected.

    `cause` is the newest correction of an object or a relation, from which answers are recomputed; None where none is.
    """
    auto, background = frame.auto, frame.setting.config.is_background
    by_id = grouped((ref for ref in refs if ref.kind == "expression"), lambda ref: ref.key)
    followed = None
    if cause is not None and (frame.related_anew or frame.renamed or frame.left_out):
        now = Answers(frame.pairs, {n: r["label"] for n, r in frame.objects.items()})
        related = (n for n, r in auto.objects.items() if not background(r["label"]))
        before = Answers(auto.pairs.of_objects(related), {n: r["label"] for n, r in auto.objects.items()})
        followed = before, now, cause
    for name, row in auto.expressions.items():
        if followed is None and name not in by_id:
            frame.expressions[name] = row
        else:
            _correct(frame, dict(row), {ref.field: refs[ref] for ref in by_id.get(name, ())}, followed)
    for name in sorted(by_id.keys() - auto.expressions.keys()):
        _add(frame, name, {ref.field: refs[ref] for ref in by_id[name]})


def _add(frame: EffectiveFrame, name: str, fields: dict[str, Sequence[Event]]) -> None:
    """An expression that a person added, with what was said of it since."""
    seeds = fields.pop("exists", ())
    seed = frame.note(seeds, replay(None, seeds)) if seeds else None
    if seed is None or seed.value is None or seed.event is None:
        for events in fields.values():
            frame.note(events, all_gone(None, events, "there is no such expression any more"))
        return
    frame.statuses[seeds[0].ref] = seed.value
    row, auto = {"frame": frame.frame, "frame_index": frame.auto.index, "id": name, **seed.value}, frame.auto.row
    i, j = (frame.pairs.index_of(row[end]) for end in ("target_object", "reference_object"))
    margin = np.nan if i is None or j is None else frame.pairs.margins[i, j, PAIRWISE.index(row["relation"])]
    row |= {
        "ambiguous": len(row["acceptable"]) > 1, "margin": float(margin) if np.isfinite(margin) else None,
        "judged_in": "viewer", "up_source": auto["up_source"] or "assumed", "profile": frame.setting.config.profile,
    }  # fmt: skip
    for column in row:
        frame.put("expressions", name, column, Origin.of("human", seed.event))
    gone = next((n for n in (row["target_object"], row["reference_object"]) if n not in frame.objects), None)
    _correct(frame, row, fields, None, None if gone is None else f"object {gone} is gone", {"targets"})


def _correct(
    frame: EffectiveFrame,
    row: Row,
    fields: Mapping[str, Sequence[Event]],
    followed: tuple[Answers, Answers, Event] | None,
    reason: str | None = None,
    human: Collection[str] = (),
) -> None:
    name, was, human = row["id"], dict(row), set(human)
    reason = reason if followed is None else _follow(frame, row, *followed)
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
    if reason is None:
        frame.expressions[name] = row
    else:
        frame.withdrawn += (Withdrawn(frame.frame, name, row["text"], reason, row),)


def _follow(frame: EffectiveFrame, row: Row, before: Answers, now: Answers, cause: Event) -> str | None:
    """Bring an expression's names, answers and margin up to date; the reason where it can no longer be said."""
    a, b, relation = row["target_object"], row["reference_object"], row["relation"]
    for number in (a, b):
        if number not in frame.objects:
            return f"object {number} was left out" if number in frame.left_out else f"object {number} is gone"
    problem = _reword(frame, row)
    if problem is not None:
        return problem
    name, pairs, sets = row["id"], frame.pairs, now.sets(a, relation, b)
    i, j, k = pairs.index_of(a), pairs.index_of(b), PAIRWISE.index(relation)
    if sets is None or i is None or j is None:
        return "one of its objects takes part in no relation now"
    after: Row = {}
    if sets != before.sets(a, relation, b):
        after = {"targets": sets[0], "acceptable": sets[1], "ambiguous": len(sets[1]) > 1}
    margin = float(pairs.margins[i, j, k])
    if np.isfinite(margin) and (row["margin"] is None or not np.isclose(margin, row["margin"], atol=1e-6)):
        after["margin"] = margin
    for column in [c for c in after if row[c] != after[c]]:
        frame.put("expressions", name, column, Origin.of("recomputed", cause), row[column])
        row[column] = after[column]
    if ((now.same[i] | now.same[j]) & frame.stale).any():
        for column in SETS:
            frame.put("expressions", name, column, Origin.of("stale", cause), row[column])
    if not pairs.present[i, j] or pairs.states[i, j, k] != T:
        return "it is no longer true of its own objects"
    for number, at in ((a, i), (b, j)):
        if not frame.objects[number]["usable"] and not frame.stale[at]:
            return f"object {number} may not be asked for: {frame.objects[number]['reason']}"
    return None


def _reword(frame: EffectiveFrame, row: Row) -> str | None:
    """Other class names bring another sentence; the reason where none can carry them."""
    ends = row["target_object"], row["reference_object"]
    labels = dict(zip(("target", "reference"), (frame.objects[n]["label"] for n in ends), strict=True))
    events = [frame.renamed[n] for n in ends if n in frame.renamed]
    if not events or all(row[role] == label for role, label in labels.items()):
        return None
    setting = frame.setting
    try:
        names = tuple(sorted({*setting.class_names, *labels.values()}))
        single = dict(zip(frame.objects, alone([r["label"] for r in frame.objects.values()]).tolist(), strict=True))
        text = expression_text(
            labels["target"], row["relation"], labels["reference"], int(row["id"], 16), style=setting.config.style,
            class_names=names, several=(not single[ends[0]], not single[ends[1]]),
        )  # fmt: skip
    except (InputError, ValueError):
        return "no sentence can carry the new class names"
    origin = Origin.of("recomputed", max(events, key=lambda e: e.id))
    for column, value in (*labels.items(), ("text", text)):
        if row[column] != value:
            frame.put("expressions", row["id"], column, origin, row[column])
            row[column] = value
    return None
