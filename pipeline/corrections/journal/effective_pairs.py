"""The relations of a frame after corrections: what people set stands, and what follows from new geometry follows."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from pipeline.corrections.journal.effective_objects import CorrectedObjects
from pipeline.corrections.journal.events import Event
from pipeline.corrections.journal.field_refs import FieldRef
from pipeline.corrections.journal.frame_rows import NO_STATE, FrameRows, Pairs, Setting
from pipeline.corrections.journal.replay import (
    Corrected,
    Origin,
    Origins,
    all_gone,
    is_another,
    replay,
    standing,
)
from pipeline.labels.check.relations import OPPOSITES
from pipeline.language.relation_names import PAIRWISE
from pipeline.relations.relations import F, T

OPPOSITE = {one: other for pair in OPPOSITES for one, other in (pair, pair[::-1])}


@dataclass(kw_only=True)
class CorrectedPairs(Corrected):
    """What became of a frame's relations.

    Attributes
    ----------
    pairs : Pairs
        Of the objects that stand and take part in relations.
    human : (N, N, 9) bool
        Cells that people set.
    stale : (N,) bool
        Objects whose relations do not follow from their geometry yet.
    changed : bool
        Anything differs from the automatic labels.
    """

    pairs: Pairs
    human: np.ndarray
    stale: np.ndarray
    changed: bool = False


def correct_pairs(
    auto: FrameRows,
    objects: CorrectedObjects,
    relifted: Pairs | None,
    cells: Mapping[FieldRef, Sequence[Event]],
    setting: Setting,
    origins: Origins,
) -> CorrectedPairs:
    """Apply corrections of relations, and those of objects as far as relations follow from them.

    Parameters
    ----------
    relifted : Pairs or None
        The relations of all standing objects judged anew, where the dataset was at hand.
    """
    related = [n for n, row in objects.rows.items() if not setting.config.is_background(row["label"])]
    pairs = auto.pairs.of_objects(related).copy()
    n = len(pairs.numbers)
    human, stale = np.zeros((n, n, len(PAIRWISE)), np.bool_), np.zeros(n, np.bool_)
    found = CorrectedPairs(pairs=pairs, human=human, stale=stale)
    found.changed = list(pairs.numbers) != list(auto.pairs.of_objects(auto.objects).numbers)
    _follow(found, auto, objects, relifted, setting, origins)
    judged = {cell: events for cell, events in cells.items() if cell.kind == "relation"}
    said: list[tuple[int, int, str, Event]] = []
    for cell in sorted(judged, key=lambda c: (c.key, c.field)):
        ruled_out = _ruled_out_before(cell, judged)
        _correct(found, cell, judged[cell], auto, objects, setting, origins, said, ruled_out)
    for i, j, relation, event in said:
        _exclude(found, i, j, relation, event, setting, origins)
    return found


def _follow(
    found: CorrectedPairs,
    auto: FrameRows,
    objects: CorrectedObjects,
    relifted: Pairs | None,
    setting: Setting,
    origins: Origins,
) -> None:
    """Relations of objects with another geometry, and of those that were background before."""
    pairs = found.pairs
    causes = dict(objects.geometry)
    for number, event in objects.renamed.items():
        was = auto.objects.get(number)
        if number not in causes and was is not None and setting.config.is_background(was["label"]):
            causes[number] = event
    moved = np.isin(pairs.numbers, list(causes))
    if not moved.any():
        return
    found.changed = True
    touched = (moved[:, None] | moved[None, :]) & ~np.eye(len(moved), dtype=np.bool_)
    before = pairs.copy()
    if relifted is not None:
        anew = relifted.of_objects(pairs.numbers)
        for name in ("present", "states", "margins", "distance", "doubted"):
            getattr(pairs, name)[touched] = getattr(anew, name)[touched]
    else:
        found.stale |= moved
    source = "stale" if relifted is None else "recomputed"
    columns = [k for k, r in enumerate(PAIRWISE) if r in setting.relations]
    for i, j in zip(*np.nonzero(touched & (pairs.present | before.present)), strict=True):
        a, b = int(pairs.numbers[i]), int(pairs.numbers[j])
        event = max((causes[x] for x in (a, b) if x in causes), key=lambda e: e.id)
        origin, key = Origin.of(source, event), f"{a},{b}"
        for k in columns:
            was = before.states[i, j, k]
            origins.put("relations", key, PAIRWISE[k], origin, None if was == NO_STATE else int(was))


def _correct(
    found: CorrectedPairs,
    cell: FieldRef,
    events: Sequence[Event],
    auto: FrameRows,
    objects: CorrectedObjects,
    setting: Setting,
    origins: Origins,
    said: list[tuple[int, int, str, Event]],
    ruled_out: bool,
) -> None:
    a, b = cell.numbers
    i, j = found.pairs.place(a), found.pairs.place(b)
    relation = cell.field.removesuffix(".status")
    reason = None
    if relation not in setting.relations:
        reason = f"the labels do not hold {relation!r}"
    elif i is None or j is None or a == b:
        gone = next((x for x, at in ((a, i), (b, j)) if at is None), a)
        known = gone in objects.left_out or gone in objects.rows
        reason = f"object {gone} takes part in no relation" if known else f"there is no object {gone} any more"
    elif any(is_another(e.anchor, x, auto.objects[x]["bbox"]) for e in events for x in (a, b) if x in auto.objects):
        reason = "one of the two objects is another thing now"
    if reason is not None or i is None or j is None:
        found.note(cell, all_gone(None, events, str(reason)))
        return
    if cell.field != relation:
        after = found.note(cell, replay(None, events))
        if after.value is not None and after.event is not None:
            found.statuses[cell] = after.value
            origins.put("relations", cell.key, cell.field, Origin.of("human", after.event))
        return
    k = PAIRWISE.index(relation)
    was = found.pairs.state(a, b, relation)
    # Who saw F where another correction ruled out the labeller's T, did not see the automatic label.
    trusted = a in objects.geometry or b in objects.geometry or (ruled_out and was == T)
    after = found.note(cell, replay(was, events, trusted=trusted))
    if after.event is None:
        return
    _settle(found, i, j, k, after.value)
    found.human[i, j, k] = True
    said.append((i, j, relation, after.event))
    automatic = auto.pairs.state(a, b, relation)
    origins.put("relations", cell.key, relation, Origin.of("human", after.event), automatic)


def _ruled_out_before(cell: FieldRef, judged: Mapping[FieldRef, Sequence[Event]]) -> bool:
    """Whether a person had said what rules the cell's relation out (see `_exclude`) when it was corrected."""
    stands = standing(judged[cell])
    if cell.field not in OPPOSITE or not stands:
        return False
    (a, b), first = cell.numbers, stands[0]
    others = (FieldRef("relation", cell.frame, cell.key, OPPOSITE[cell.field]), replace(cell, key=f"{b},{a}"))
    return first.before == F and any(e.after == T and e.id < first.id for c in others for e in judged.get(c, ()))


def _settle(found: CorrectedPairs, i: int, j: int, k: int, state: int | None) -> None:
    """Set a cell. A margin whose sign says otherwise becomes 0: by geometry it is no better than undecided."""
    pairs = found.pairs
    found.changed |= pairs.states[i, j, k] != (NO_STATE if state is None else state)
    pairs.present[i, j] = True
    pairs.states[i, j, k] = NO_STATE if state is None else state
    margin = pairs.margins[i, j, k]
    agrees = (state == T and margin > 0) or (state == F and margin < 0)
    pairs.margins[i, j, k] = np.nan if state is None else margin if agrees else 0.0
    pairs.doubted[i, j] &= ~(1 << k)


def _exclude(
    found: CorrectedPairs, i: int, j: int, relation: str, event: Event, setting: Setting, origins: Origins
) -> None:
    """What a person said to hold rules out its opposite, and itself the other way round."""
    k, opposite = PAIRWISE.index(relation), OPPOSITE.get(relation)
    if found.pairs.states[i, j, k] != T or opposite is None:
        return
    for a, b, name in ((i, j, opposite), (j, i, relation)):
        at = PAIRWISE.index(name)
        if name not in setting.relations or found.human[a, b, at] or found.pairs.states[a, b, at] != T:
            continue
        _settle(found, a, b, at, F)
        key = f"{found.pairs.numbers[a]},{found.pairs.numbers[b]}"
        origins.put("relations", key, name, Origin.of("recomputed", event), T)
