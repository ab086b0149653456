"""What followed from an edit: two states of a frame compared, and said in one line."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from pipeline.correcting.scene import labelled_box
from pipeline.counted import counted
from pipeline.journal.cells import object_cell
from pipeline.journal.effective_frame import EffectiveFrame
from pipeline.journal.frame_rows import NO_STATE
from pipeline.relations import PAIRWISE, PHRASE, letter

SAME_PLACE = 1e-3
"""A box that moves or grows by less, metres, is the same."""
SAID = 3
"""So many changed relations are told one by one."""


@dataclass(frozen=True)
class BoxChange:
    """A 3D box that is not what it was.

    Attributes
    ----------
    number : int
    name : str
        "mug·3".
    moved, grown : float or None
        Metres by which its centre moved; factor by which its volume grew. None where there was or is no box.
    gone : bool
        There is no box any more.
    """

    number: int
    name: str
    moved: float | None
    grown: float | None
    gone: bool = False

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
    """What is different in a frame after an edit.

    Attributes
    ----------
    appeared, gone : tuple of str
        Names of objects.
    unusable : tuple of str
        Objects that stand but are not asked for, and were before, with the reason.
    boxes : tuple of BoxChange
        Without those that a person placed.
    recomputed : int
        Relations that were judged anew; a relation and its mirror image are one.
    changed : tuple of RelationChange
        Those of objects that were there before that came out otherwise; what a person set is not among them.
    stale : bool
        Something could not be recomputed, because the dataset is not at hand.
    answers : tuple of str
        Texts of expressions with other answers.
    withdrawn, returned : tuple of str
        Texts of expressions that are left out now, or no longer.
    """

    appeared: tuple[str, ...] = ()
    gone: tuple[str, ...] = ()
    unusable: tuple[str, ...] = ()
    boxes: tuple[BoxChange, ...] = ()
    recomputed: int = 0
    changed: tuple[RelationChange, ...] = ()
    stale: bool = False
    answers: tuple[str, ...] = ()
    withdrawn: tuple[str, ...] = ()
    returned: tuple[str, ...] = ()

    def __str__(self) -> str:
        parts = [f"{name} added" for name in self.appeared] + [f"{name} left out" for name in self.gone]
        parts += [str(b) for b in self.boxes] + list(self.unusable)
        if self.recomputed or self.changed:
            count = f"{counted(self.recomputed, 'relation')} recomputed, " if self.recomputed else "relations: "
            told = "; ".join(map(str, self.changed[:SAID])) + (" ..." if len(self.changed) > SAID else "")
            parts.append(f"{count}{len(self.changed) or 'none'} changed" + (f": {told}" if told else ""))
        if self.answers:
            parts.append(f"{counted(len(self.answers), 'expression')} answered otherwise")
        if self.withdrawn:
            parts.append(f"{counted(len(self.withdrawn), 'expression')} withdrawn")
        if self.returned:
            parts.append(f"{counted(len(self.returned), 'expression')} back")
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
    told = before.origins.found
    renewed = {
        (key, column): origin.source
        for (table, key, column), (origin, _) in after.origins.found.items()
        if table == "relations"
        and origin.source in ("recomputed", "stale")
        and ((table, key, column) not in told or told[table, key, column][0].event != origin.event)
    }
    human = {
        (key, column)
        for (table, key, column), (origin, _) in after.origins.found.items()
        if table == "relations" and origin.source == "human"
    }
    mirrored = {_folded(after, *_ends(key), column) for key, column in renewed}
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
        if after.origin(object_cell(after.frame, n, "box")).source == "human":
            continue
        if now is None:
            if was is not None:
                yield BoxChange(n, _name(after, n), None, None, gone=True)
        elif was is None:
            yield BoxChange(n, _name(after, n), None, None)
        else:
            moved = float(np.linalg.norm(now.center - was.center))
            if moved >= SAME_PLACE or float(np.abs(now.corners - was.corners).max()) >= SAME_PLACE:
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
        states = [None if s == NO_STATE else int(s) for s in (was.states[i, j, k], now.states[i, j, k])]
        yield RelationChange(_name(after, a), _name(after, b), relation, *states)


def _folded(frame: EffectiveFrame, a: int, b: int, relation: str) -> tuple[int, int, str]:
    """One name for a relation and its mirror image."""
    inverse = frame.setting.inverse(relation)
    return (a, b, relation) if inverse is None else min((a, b, relation), (b, a, inverse))


def _ends(key: str) -> tuple[int, int]:
    a, b = key.split(",")
    return int(a), int(b)


def _name(frame: EffectiveFrame, number: int) -> str:
    return f"{frame.objects[number]['label']}·{number}"


def _texts(texts: dict[str, str], ids: Iterable[str]) -> tuple[str, ...]:
    return tuple(texts[i] for i in sorted(ids))

