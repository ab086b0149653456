"""Telling corrections from conflicts: what was exported, what the file says, what is there now."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

from pipeline.corrections.journal import edits as actions
from pipeline.corrections.journal.effective_frame import EffectiveFrame
from pipeline.corrections.journal.events import Edit, Event
from pipeline.corrections.journal.field_refs import FieldRef, box_of, same_value, shown_value
from pipeline.corrections.journal.incoming.claims import Claim, Claims
from pipeline.language.relation_names import PAIRWISE
from pipeline.system.errors import InputError

ANSWERS = ("targets", "acceptable", "ambiguous")


@dataclass(frozen=True)
class Contradiction:
    """A value that was corrected here since the file was exported, and that the file has otherwise.

    Attributes
    ----------
    where : str
    cell : FieldRef
    exported, wanted, now : JSON value
    event : Event or None
        The newest of the cell; None where `now` follows from something else.
    because : str
        Where it is not the value itself that is in the way.
    """

    where: str
    cell: FieldRef
    exported: Any
    wanted: Any
    now: Any
    event: Event | None
    because: str = ""

    def __str__(self) -> str:
        wanted = shown_value(self.cell, self.wanted)
        if self.because:
            return f"{self.where}: {self.cell}: wanted {wanted}, but {self.because}"
        by = "it was recomputed since"
        if self.event is not None:
            by = f"{self.event.author} corrected it at {self.event.time:%Y-%m-%d %H:%M:%S UTC}"
        was, now = shown_value(self.cell, self.exported), shown_value(self.cell, self.now)
        return f"{self.where}: {self.cell}: exported as {was}, wanted {wanted}, is {now} now: {by}"


@dataclass
class Settled:
    """What becomes of the claims of a file.

    Attributes
    ----------
    edits : dict of Cell to Edit
    contradictions : list of Contradiction
    agreed : int
        Claims that the labels fulfil by now.
    """

    edits: dict[FieldRef, Edit] = field(default_factory=dict)
    contradictions: list[Contradiction] = field(default_factory=list)
    agreed: int = 0


def settle(claims: Claims, reason: str) -> Settled:
    """Make edits of claims, and list those that somebody's later correction stands against.

    A claim that cannot be done becomes a problem of the file.
    """
    found = Settled()
    wanted: dict[FieldRef, str] = {}
    for group in _grouped(claims.found.values()):
        first = group[0]
        now = claims.states.frame_now(first.cell.frame, first.base)
        base = claims.base(first.cell.frame, first.base)
        gone = _gone(first.cell, base, now, claims)
        if gone is not None:
            found.contradictions += [
                Contradiction(c.where, c.cell, base.value(c.cell), c.value, None, *gone) for c in group
            ]
            continue
        try:
            made = _edits(group, base, now, reason)
        except InputError as error:
            claims.problem(first.where, error)
            continue
        made = [e for e in made if not same_value(e.before, e.after)]
        found.agreed += not made
        against = [e for e in made if not same_value(base.value(e.cell), now.value(e.cell))]
        if against:
            found.contradictions += [
                Contradiction(
                    first.where, e.cell, base.value(e.cell), e.after, e.before,
                    claims.states.newest(e.cell.frame, e.cell),
                )
                for e in against
            ]  # fmt: skip
            continue
        for edit in made:
            before = found.edits.setdefault(edit.cell, edit)
            if before is not edit and not same_value(before.after, edit.after):
                claims.problem(first.where, f"{edit.cell} cannot be as here and as {wanted[edit.cell]} has it")
            wanted.setdefault(edit.cell, first.where)
    return found


def _grouped(claims: Iterable[Claim]) -> list[list[Claim]]:
    """Claims that are one action together: the answers of an expression; in the order of their frames."""
    found: dict[Any, list[Claim]] = {}
    for claim in claims:
        cell = claim.cell
        answers = cell.kind == "expression" and cell.field in ANSWERS
        found.setdefault((cell.frame, cell.key, "answers") if answers else cell, []).append(claim)
    return sorted(found.values(), key=lambda group: group[0].cell.frame)


def _gone(
    cell: FieldRef, base: EffectiveFrame, now: EffectiveFrame, claims: Claims
) -> tuple[Event | None, str] | None:
    """Why there is nothing to correct any more, where it was taken away here since."""
    if cell.kind in ("object", "relation") and cell.field not in ("status", "exists"):
        for number in cell.numbers:
            if number in base.objects and number not in now.objects:
                by = claims.states.newest(cell.frame, FieldRef("object", cell.frame, str(number), "status"))
                return by, f"object {number} was rejected since" + (f" by {by.author}" if by is not None else "")
    if cell.kind == "relation" and any(
        base.pairs.place(n) is not None and now.pairs.place(n) is None for n in cell.numbers
    ):
        return None, "one of its objects takes part in no relation any more"
    if cell.kind == "expression" and cell.field not in ("status", "mark"):
        reasons = {w.id: w.reason for w in now.withdrawn}
        if cell.key in base.expressions and cell.key not in now.expressions:
            return None, f"it was withdrawn since: {reasons.get(cell.key, '')}"
    return None


def _edits(
    group: Sequence[Claim], base: EffectiveFrame, now: EffectiveFrame, reason: str
) -> tuple[Edit, ...]:
    cell, value = group[0].cell, group[0].value
    if cell.kind == "expression" and cell.field in ANSWERS:
        return _answers({c.cell.field: c.value for c in group}, cell.key, now, reason)
    if cell.kind == "relation" and cell.field in PAIRWISE:
        return actions.set_relation(now, *cell.numbers, cell.field, value, reason)  # pyright: ignore[reportCallIssue]
    if cell.field == "exists":
        # It was imported before, and may have been corrected or rejected since.
        if now.value(cell) is not None:
            return ()
        box = box_of(value["box"]) if "box" in value else None
        return actions.add_object(
            now, value["label"], mask=value.get("mask"), bbox=value.get("bbox"), box=box, number=cell.numbers[0],
            reason=reason,
        )  # fmt: skip
    if cell.kind == "object" and cell.field == "mask":
        return actions.set_mask(now, cell.numbers[0], value, reason)
    if cell.kind == "object" and cell.field == "bbox":
        return actions.set_bbox(now, cell.numbers[0], value, reason)
    return actions.set_value(now, cell, value, reason)


def _answers(said: dict[str, Any], name: str, now: EffectiveFrame, reason: str) -> tuple[Edit, ...]:
    """Targets are acceptable: where only one of the two lists was changed, the other follows."""
    if set(said) == {"ambiguous"}:
        return actions.set_ambiguous(now, name, said["ambiguous"], reason)
    row = now.expressions.get(name) or now.auto.expressions[name]
    targets = said.get("targets", row["targets"])
    acceptable = said.get("acceptable")
    if acceptable is None:
        acceptable = {*targets, *(set(row["acceptable"]) - set(row["targets"]))}
    elif not set(targets) <= set(acceptable):
        if "targets" in said:
            raise InputError("targets must be acceptable too", got=f"{targets} and {acceptable}")
        targets = [n for n in targets if n in acceptable]
    made = actions.set_answers(now, name, targets, acceptable, reason)
    if "ambiguous" in said:
        made = tuple(replace(e, after=said["ambiguous"]) if e.cell.field == "ambiguous" else e for e in made)
    return made
