"""An object whose 3D box is being moved: what its relations would be, as fast as the hand that moves it."""

from __future__ import annotations

from dataclasses import dataclass, replace
from time import perf_counter
from typing import Any

import numpy as np

from pipeline.answering.objects import SceneObject
from pipeline.corrections.cards import PairCard, RelationLine, pair_card
from pipeline.corrections.journal.effective import Corrector
from pipeline.corrections.journal.effective_frame import EffectiveFrame
from pipeline.corrections.journal.field_refs import box_value, object_cell, relation_cell
from pipeline.corrections.journal.frame_rows import NO_STATE
from pipeline.corrections.journal.origins import Origin
from pipeline.geometry.boxes import Box3D
from pipeline.labels.labelling import judge_list
from pipeline.language.relation_names import INVERSE, PAIRWISE
from pipeline.relations.relations import F, T
from pipeline.system.errors import InputError

MOVED = Origin("recomputed", reason="the box is being moved")


@dataclass(frozen=True)
class Moved:
    """What follows from another box of one object of a pair.

    Attributes
    ----------
    number : int
        Of the object that is moved.
    box : Box3D
        Camera frame.
    card : PairCard or None
        Of the chosen pair as it would be; None where the object is in none.
    changed : tuple of str
        Relations of that pair that would have another state.
    seconds : float
        What it cost.
    """

    number: int
    box: Box3D
    card: PairCard | None
    changed: tuple[str, ...]
    seconds: float

    def record(self) -> dict[str, Any]:
        """As JSON."""
        return {
            "object": self.number,
            "pair": None if self.card is None else self.card.record(),
            "changed": list(self.changed),
            "ms": self.seconds * 1000,
        }


class MovingBox:
    """Keeps what does not change while one object of a pair is moved.

    Parameters
    ----------
    frame : EffectiveFrame
    corrector : Corrector
        With its dataset: without one nothing can be judged, and `moved` has no card.
    number : int
        The object that is moved.
    pair : tuple of int, optional
        The chosen pair: "a RELATION b".
    """

    def __init__(
        self, frame: EffectiveFrame, corrector: Corrector, number: int, pair: tuple[int, int] | None = None
    ) -> None:
        self.frame, self.number, self.pair = frame, number, pair
        self._relifter = corrector.relifter
        self._card = None
        self._lifted: dict[int, SceneObject] = {}
        if number not in frame.objects:
            raise InputError(f"frame {frame.frame} has no object {number} that stands")
        if pair is None or number not in pair or self._relifter is None:
            return
        card = pair_card(frame, *pair)
        if card.why_none:
            return
        self._card = card
        for n in pair:
            box = frame.value(object_cell(frame.frame, n, "box"))
            self._lifted[n] = self._lift(n, box if self._is_set(n) else None)

    def _is_set(self, number: int) -> bool:
        """Whether a person placed the box of an object."""
        return self.frame.origin(object_cell(self.frame.frame, number, "box")).source == "human"

    def _lift(self, number: int, box: Any) -> SceneObject:
        assert self._relifter is not None
        row = self.frame.objects[number]
        if number not in self.frame.auto.objects and row["mask_source"] == "box3d":
            # Its pixels are those in the box, wherever that is.
            row = {**row, "mask": None}
        return self._relifter.lifted(self.frame.frame, row, box)

    def moved(self, box: Box3D) -> Moved:
        """What follows from another box (camera frame) of the object: for the pair, just what saving it makes."""
        start = perf_counter()
        card = self._card
        if card is None or self._relifter is None:
            return Moved(self.number, box, None, (), perf_counter() - start)
        objects = dict(self._lifted)
        objects[self.number] = self._lift(self.number, box_value(box))
        numbers = sorted(objects)
        context, config = self._relifter.context(self.frame.frame), self._relifter.setting.config
        judged = judge_list(context, [objects[n] for n in numbers], config, self._relifter.network)
        i, j = (numbers.index(n) for n in (card.a, card.b))
        lines = tuple(
            self._line(line, int(judged.states[i, j, k]), float(judged.margins[i, j, k]))
            for line in card.lines
            for k in (PAIRWISE.index(line.relation),)
        )
        changed = tuple(new.relation for new, old in zip(lines, card.lines, strict=True) if new.state != old.state)
        distance = float(judged.distance[i, j])
        card = replace(card, lines=lines, distance=distance if np.isfinite(distance) else None)
        return Moved(self.number, box, card, changed, perf_counter() - start)

    def _line(self, line: RelationLine, state: int, margin: float) -> RelationLine:
        """A relation judged anew: what a person said of it stands, and what that rules out."""
        if line.origin.source == "human":
            state, fixed = (NO_STATE if line.state is None else line.state), True
        else:
            fixed = state == T and self._ruled_out(line.relation)
            state = F if fixed else state
        if fixed and not ((state == T and margin > 0) or (state == F and margin < 0)):
            margin = 0.0
        return replace(
            line,
            state=None if state == NO_STATE else state,
            margin=None if state == NO_STATE else margin,
            origin=line.origin if line.origin.source == "human" else MOVED,
        )

    def _ruled_out(self, relation: str) -> bool:
        """Whether a person said that the opposite holds, or the same the other way round."""
        assert self._card is not None
        opposite, frame = INVERSE.get(relation), self.frame
        if opposite is None:
            return False
        a, b = self._card.a, self._card.b
        cells = [(a, b, opposite), (b, a, relation)]
        return any(
            frame.pairs.state(*cell) == T and frame.origin(relation_cell(frame.frame, *cell)).source == "human"
            for cell in cells
        )
