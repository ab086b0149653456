"""What is known of a pair of labelled objects, relation by relation, where from, also while a box is moved."""

from __future__ import annotations

from dataclasses import dataclass, replace
from time import perf_counter
from typing import Any

import numpy as np

from pipeline.answering.objects import SceneObject
from pipeline.corrections.journal.effective import Corrector
from pipeline.corrections.journal.effective_frame import EffectiveFrame
from pipeline.corrections.journal.field_refs import box_value, object_ref, relation_ref
from pipeline.corrections.journal.replay import Origin
from pipeline.geometry.boxes import Box3D
from pipeline.labels.labelling import judge_list
from pipeline.language.relation_names import INVERSE, PAIRWISE
from pipeline.relations.pair_measures import NOT_JUDGED
from pipeline.relations.relations import F, T, U, letter
from pipeline.system.errors import require

ASKED_BEYOND_M = 0.1
"""A judgement that geometry contradicts by more metres than this is asked about before it is saved."""
MOVED = Origin("recomputed", reason="the box is being moved")


@dataclass(frozen=True)
class RelationLine:
    """One relation of a pair.

    Attributes
    ----------
    relation : str
    state : int or None
        T (1), U (0), F (-1); None where the pair has no label.
    margin : float or None
        Slack of the rule's gate, metres: the sign says which side.
    origin : Origin
    status : str or None
        What a reviewer said of it.
    version : int
        How many events it has.
    """

    relation: str
    state: int | None
    margin: float | None
    origin: Origin
    status: str | None
    version: int

    def against(self, state: int) -> float:
        """By how many metres the rule's margin contradicts T or F; 0 where it does not, and for U."""
        return 0.0 if self.margin is None or state == U else max(0.0, -state * self.margin)

    def record(self) -> dict[str, Any]:
        """As JSON."""
        return {
            "relation": self.relation,
            "state": None if self.state is None else letter(self.state),
            "margin": self.margin,
            "origin": self.origin.source,
            "from": str(self.origin),
            "status": self.status,
            "version": self.version,
        }


@dataclass(frozen=True)
class PairCard:
    """An ordered pair: "a RELATION b".

    Attributes
    ----------
    frame : str
    a, b : int
        Numbers of the objects.
    names : tuple of str
        Their classes.
    distance : float or None
        Metres.
    lines : tuple of RelationLine
        The labelled relations, in the order of PAIRWISE.
    why_none : str
        Why the pair takes part in no relation; "" where it does.
    """

    frame: str
    a: int
    b: int
    names: tuple[str, str]
    distance: float | None
    lines: tuple[RelationLine, ...]
    why_none: str = ""

    def record(self) -> dict[str, Any]:
        """As JSON."""
        return {
            "frame": self.frame,
            "a": {"object": self.a, "label": self.names[0]},
            "b": {"object": self.b, "label": self.names[1]},
            "distance": self.distance,
            "relations": [line.record() for line in self.lines],
            "why_none": self.why_none or None,
        }


def pair_card(frame: EffectiveFrame, a: int, b: int) -> PairCard:
    """What the labels say of two objects.

    Raises
    ------
    InputError
        There is no such object, or both are the same.
    """
    for number in (a, b):
        require(number in frame.objects, f"frame {frame.frame} has no object {number}")
    require(a != b, "an object has no relation to itself", got=a)
    names = frame.objects[a]["label"], frame.objects[b]["label"]
    pairs = frame.pairs
    i, j = pairs.index_of(a), pairs.index_of(b)
    if i is None or j is None:
        gone = a if i is None else b
        row = frame.objects[gone]
        return PairCard(frame.frame, a, b, names, None, (), f"{row['label']}·{gone}: {row['reason'] or 'not usable'}")
    refs = {relation: relation_ref(frame.frame, a, b, relation) for relation in frame.setting.relations}
    lines = tuple(
        RelationLine(
            relation, pairs.state(a, b, relation), _number(pairs.margins[i, j, PAIRWISE.index(relation)]),
            frame.origin(ref), frame.statuses.get(replace(ref, field=f"{relation}.status")), frame.version(ref),
        )
        for relation, ref in refs.items()
    )  # fmt: skip
    return PairCard(frame.frame, a, b, names, _number(pairs.distance[i, j]), lines)


def _number(value: Any) -> float | None:
    return None if np.isnan(value) else float(value)


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
        require(number in frame.objects, f"frame {frame.frame} has no object {number} that stands")
        if pair is None or number not in pair or self._relifter is None:
            return
        card = pair_card(frame, *pair)
        if card.why_none:
            return
        self._card = card
        refs = {n: object_ref(frame.frame, n, "box") for n in pair}
        by_hand = {n: frame.value(ref) for n, ref in refs.items() if frame.origin(ref).source == "human"}
        self._lifted = {n: self._lift(n, by_hand.get(n)) for n in pair}

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
        objects = {**self._lifted, self.number: self._lift(self.number, box_value(box))}
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
        human = line.origin.source == "human"
        ruled_out = not human and state == T and self._ruled_out(line.relation)
        now = line.state if human else F if ruled_out else None if state == NOT_JUDGED else state
        if (human or ruled_out) and not ((now == T and margin > 0) or (now == F and margin < 0)):
            margin = 0.0
        return replace(line, state=now, margin=None if now is None else margin, origin=line.origin if human else MOVED)

    def _ruled_out(self, relation: str) -> bool:
        """Whether a person said that the opposite holds, or the same the other way round."""
        assert self._card is not None
        opposite, frame = INVERSE.get(relation), self.frame
        if opposite is None:
            return False
        a, b = self._card.a, self._card.b
        cells = [(a, b, opposite), (b, a, relation)]
        return any(
            frame.pairs.state(*ref) == T and frame.origin(relation_ref(frame.frame, *ref)).source == "human"
            for ref in cells
        )
