"""What two people have changed at the same time, and how the second decides: field by field, nothing by accident."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, replace
from typing import Any

from pipeline.corrections.journal.effective_expressions import SETS
from pipeline.corrections.journal.effective_frame import EffectiveFrame
from pipeline.corrections.journal.events import Conflict, Edit, Rival
from pipeline.corrections.journal.field_refs import FieldRef, shown_value
from pipeline.corrections.journal.setting import Setting
from pipeline.language.relation_names import PAIRWISE


@dataclass(frozen=True)
class Dispute:
    """A field that somebody else was faster to change, with the fields of one's action that stand or fall with it.

    Attributes
    ----------
    edits : tuple of Edit
        What one wanted.
    rivals : tuple of Rival
        At least one.
    """

    edits: tuple[Edit, ...]
    rivals: tuple[Rival, ...]

    @property
    def cell(self) -> FieldRef:
        """The field that it is told by."""
        return self.rivals[0].edit.cell

    def record(self) -> dict[str, Any]:
        """As JSON: `theirs`, `by` and `time` are null where one has seen more than there is."""
        first = self.rivals[0]
        event, cell = first.event, first.edit.cell
        return {
            "kind": cell.kind,
            "frame": cell.frame,
            "key": cell.key,
            "field": cell.field,
            "seen": shown_value(cell, first.edit.before),
            "mine": shown_value(cell, first.edit.after),
            "theirs": None if event is None else shown_value(cell, event.after),
            "by": None if event is None else event.author,
            "time": None if event is None else event.time.isoformat(),
            "reason": None if event is None else event.reason or None,
        }


def disputes(conflict: Conflict, setting: Setting) -> tuple[Dispute, ...]:
    """The disputed fields of an action: a relation with its inverse is one, and so are the answers of an expression."""
    groups: dict[Any, list[Edit]] = {}
    for edit in conflict.edits or tuple(r.edit for r in conflict.rivals):
        groups.setdefault(_together(edit.cell, setting), []).append(edit)
    found = []
    for members in groups.values():
        cells = {e.cell for e in members}
        rivals = tuple(r for r in conflict.rivals if r.edit.cell in cells)
        if rivals:
            found.append(Dispute(tuple(members), rivals))
    return tuple(found)


def decided(conflict: Conflict, frame: EffectiveFrame, mine: Collection[int]) -> tuple[Edit, ...]:
    """The edits that a person saves after all: what nobody disputes, and of the disputes those that `mine` numbers.

    They are made on what the person was shown: who changes it again meanwhile
    is in conflict again, and overwritten by nobody.

    Parameters
    ----------
    conflict : Conflict
    frame : EffectiveFrame
        As it is now.
    mine : collection of int
        Places in `disputes`.
    """
    found = disputes(conflict, frame.setting)
    disputed = {e.cell for d in found for e in d.edits}
    kept = [e for e in conflict.edits if e.cell not in disputed]
    for k, dispute in enumerate(found):
        if k in mine:
            rivals = {r.edit.cell: r for r in dispute.rivals}
            kept += [_instead(e, rivals.get(e.cell), frame) for e in dispute.edits]
    return tuple(kept)


def _instead(edit: Edit, rival: Rival | None, frame: EffectiveFrame) -> Edit:
    if rival is None:
        return edit
    event, version = rival.event, 0 if rival.event is None else rival.event.version
    before = frame.value(edit.cell)
    if event is not None and version != frame.version(edit.cell):
        before = event.after
    over = "" if event is None else f"instead of {event.author}'s {shown_value(edit.cell, event.after)}"
    return replace(edit, before=before, base=version, reason="; ".join(filter(None, (edit.reason, over))))


def _together(cell: FieldRef, setting: Setting) -> Any:
    if cell.kind == "expression" and cell.field in SETS:
        return cell.kind, cell.key, SETS
    if cell.kind == "relation" and cell.field in PAIRWISE:
        a, b = cell.numbers
        inverse = setting.inverse(cell.field)
        return cell.kind, min((a, b, cell.field), (b, a, inverse or cell.field))
    return cell
