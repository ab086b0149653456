"""The expressions of a frame after corrections: their answers follow from the relations, unless a person set them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from pipeline.corrections.journal.effective_objects import CorrectedObjects, CorrectedPairs
from pipeline.corrections.journal.events import Event
from pipeline.corrections.journal.field_refs import FieldRef
from pipeline.corrections.journal.frame_rows import FrameRows, Pairs, Setting
from pipeline.corrections.journal.replay import Corrected, Origin, Origins, all_gone, replay
from pipeline.labels.wording import expression_text
from pipeline.language.noun_phrase import alone, same_names
from pipeline.language.relation_names import PAIRWISE
from pipeline.relations.relations import T, U
from pipeline.system.errors import InputError

Row = dict[str, Any]
SETS = ("targets", "acceptable", "ambiguous")
OPEN_FIELDS = ("text", *SETS)
"""The columns that a person may set."""


@dataclass(frozen=True)
class Withdrawn:
    """An expression that is left out of the effective labels.

    Attributes
    ----------
    frame, id, text : str
    reason : str
    row : dict
        As it would stand, with what people set.
    """

    frame: str
    id: str
    text: str
    reason: str
    row: Row = field(default_factory=dict, compare=False, repr=False)


@dataclass(kw_only=True)
class CorrectedExpressions(Corrected):
    """What became of a frame's expressions.

    Attributes
    ----------
    rows : dict of str to dict
        Those that stand, by id.
    withdrawn : list of Withdrawn
    marks : dict of str to str
        BAD_LABEL or BAD_BOX by id, of expressions that stand or not.
    """

    rows: dict[str, Row] = field(default_factory=dict)
    withdrawn: list[Withdrawn] = field(default_factory=list)
    marks: dict[str, str] = field(default_factory=dict)


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


def correct_expressions(
    auto: FrameRows,
    objects: CorrectedObjects,
    pairs: CorrectedPairs,
    refs: Mapping[FieldRef, Sequence[Event]],
    setting: Setting,
    origins: Origins,
    cause: Event | None,
) -> CorrectedExpressions:
    """Apply corrections of expressions, and let the others follow from objects and relations.

    Parameters
    ----------
    cause : Event or None
        The newest correction of an object or a relation, None where there is none: from it answers are recomputed.
    """
    found = CorrectedExpressions()
    by_id: dict[str, dict[str, Sequence[Event]]] = {}
    for ref, events in refs.items():
        if ref.kind == "expression":
            by_id.setdefault(ref.key, {})[ref.field] = events
    followed = None
    if cause is not None and (pairs.changed or objects.renamed or objects.left_out):
        now = Answers(pairs.pairs, {n: r["label"] for n, r in objects.rows.items()})
        related = (n for n, r in auto.objects.items() if not setting.config.is_background(r["label"]))
        before = Answers(auto.pairs.of_objects(related), {n: r["label"] for n, r in auto.objects.items()})
        followed = before, now, cause
    for name, row in auto.expressions.items():
        if followed is None and name not in by_id:
            found.rows[name] = row
        else:
            _correct(dict(row), by_id.get(name, {}), auto, objects, pairs, setting, origins, followed, found)
    for name in by_id.keys() - auto.expressions.keys():
        for column, events in by_id[name].items():
            gone = all_gone(None, events, "there is no such expression any more")
            found.note(FieldRef("expression", auto.frame, name, column), gone)
    return found


def _correct(
    row: Row,
    fields: Mapping[str, Sequence[Event]],
    auto: FrameRows,
    objects: CorrectedObjects,
    pairs: CorrectedPairs,
    setting: Setting,
    origins: Origins,
    followed: tuple[Answers, Answers, Event] | None,
    found: CorrectedExpressions,
) -> None:
    name, was = row["id"], dict(row)
    reason = None
    if followed is not None:
        reason = _follow(row, objects, pairs, setting, origins, followed)
    human: set[str] = set()
    for column in sorted(fields):
        events, ref = fields[column], FieldRef("expression", auto.frame, name, column)
        trusted = column in OPEN_FIELDS and row[column] != was[column]
        after = found.note(ref, replay(was[column] if column in OPEN_FIELDS else None, events, trusted=trusted))
        if after.event is None:
            continue
        if column in OPEN_FIELDS:
            row[column] = after.value
            human.add(column)
        elif after.value is not None and column == "mark":
            found.marks[name] = after.value
        elif after.value is not None:
            found.statuses[ref] = after.value
        if after.value is not None:
            origins.put("expressions", name, column, Origin.of("human", after.event), was.get(column))
    if "ambiguous" not in human and human & {"acceptable", "targets"}:
        row["ambiguous"] = len(row["acceptable"]) > 1
    if human & {"acceptable", "targets"}:
        reason = None if reason is not None and reason.startswith("it is no longer true") else reason
        missing = [n for n in {*row["targets"], *row["acceptable"]} if n not in objects.rows]
        if missing:
            reason = f"its answers name object {missing[0]}, which there is no more"
        elif not row["acceptable"]:
            reason = "it has no answer"
    if found.statuses.get(FieldRef("expression", auto.frame, name, "status")) == "rejected":
        reason = "rejected"
    if reason is None:
        found.rows[name] = row
    else:
        found.withdrawn.append(Withdrawn(auto.frame, name, row["text"], reason, row))


def _follow(
    row: Row,
    objects: CorrectedObjects,
    pairs: CorrectedPairs,
    setting: Setting,
    origins: Origins,
    followed: tuple[Answers, Answers, Event],
) -> str | None:
    """Bring an expression's names, answers and margin up to date; the reason where it can no longer be said."""
    before, now, cause = followed
    a, b, relation = row["target_object"], row["reference_object"], row["relation"]
    for number in (a, b):
        if number not in objects.rows:
            return f"object {number} was left out" if number in objects.left_out else f"object {number} is gone"
    name, origin = row["id"], Origin.of("recomputed", cause)
    problem = _reword(row, objects, setting, origins)
    if problem is not None:
        return problem
    sets = now.sets(a, relation, b)
    if sets is None:
        return "one of its objects takes part in no relation now"
    if sets != before.sets(a, relation, b):
        after = {"targets": sets[0], "acceptable": sets[1], "ambiguous": len(sets[1]) > 1}
        for column in SETS:
            if row[column] != after[column]:
                origins.put("expressions", name, column, origin, row[column])
                row[column] = after[column]
    i, j, k = pairs.pairs.index_of(a), pairs.pairs.index_of(b), PAIRWISE.index(relation)
    assert i is not None
    assert j is not None
    involved = (now.same[i] | now.same[j]) & pairs.stale
    if involved.any():
        for column in SETS:
            origins.put("expressions", name, column, Origin.of("stale", cause), row[column])
    margin = float(pairs.pairs.margins[i, j, k])
    if np.isfinite(margin) and (row["margin"] is None or not np.isclose(margin, row["margin"], atol=1e-6)):
        origins.put("expressions", name, "margin", origin, row["margin"])
        row["margin"] = margin
    if not pairs.pairs.present[i, j] or pairs.pairs.states[i, j, k] != T:
        return "it is no longer true of its own objects"
    for number in (a, b):
        if not objects.rows[number]["usable"] and not pairs.stale[pairs.pairs.index_of(number) or 0]:
            return f"object {number} may not be asked for: {objects.rows[number]['reason']}"
    return None


def _reword(row: Row, objects: CorrectedObjects, setting: Setting, origins: Origins) -> str | None:
    """Other class names bring another sentence; the reason where none can carry them."""
    labels = {role: objects.rows[row[f"{role}_object"]]["label"] for role in ("target", "reference")}
    if all(row[role] == label for role, label in labels.items()):
        return None
    events = [objects.renamed[n] for n in (row["target_object"], row["reference_object"]) if n in objects.renamed]
    if not events:
        return None
    origin = Origin.of("recomputed", max(events, key=lambda e: e.id))
    try:
        names = tuple(sorted({*setting.class_names, *labels.values()}))
        single = dict(zip(objects.rows, alone([r["label"] for r in objects.rows.values()]).tolist(), strict=True))
        text = expression_text(
            labels["target"], row["relation"], labels["reference"], int(row["id"], 16), style=setting.config.style,
            class_names=names, several=(not single[row["target_object"]], not single[row["reference_object"]]),
        )  # fmt: skip
    except (InputError, ValueError):
        return "no sentence can carry the new class names"
    for column, value in (*labels.items(), ("text", text)):
        if row[column] != value:
            origins.put("expressions", row["id"], column, origin, row[column])
            row[column] = value
    return None
