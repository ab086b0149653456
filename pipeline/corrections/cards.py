"""What is known of a pair of labelled objects, relation by relation, and where it comes from."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from pipeline.corrections.journal.effective_frame import EffectiveFrame
from pipeline.corrections.journal.field_refs import relation_cell
from pipeline.corrections.journal.origins import Origin
from pipeline.language.relation_names import PAIRWISE
from pipeline.relations.relations import U, letter
from pipeline.system.errors import InputError

ASKED_BEYOND_M = 0.1
"""A judgement that geometry contradicts by more metres than this is asked about before it is saved."""


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
        if number not in frame.objects:
            raise InputError(f"frame {frame.frame} has no object {number}")
    if a == b:
        raise InputError("an object has no relation to itself", got=a)
    names = frame.objects[a]["label"], frame.objects[b]["label"]
    pairs = frame.pairs
    i, j = pairs.place(a), pairs.place(b)
    if i is None or j is None:
        gone = a if i is None else b
        row = frame.objects[gone]
        return PairCard(frame.frame, a, b, names, None, (), f"{row['label']}·{gone}: {row['reason'] or 'not usable'}")
    lines = []
    for relation in frame.setting.relations:
        cell = relation_cell(frame.frame, a, b, relation)
        status = relation_cell(frame.frame, a, b, f"{relation}.status")
        k = PAIRWISE.index(relation)
        lines.append(
            RelationLine(
                relation, pairs.state(a, b, relation), _number(pairs.margins[i, j, k]), frame.origin(cell),
                frame.statuses.get(status), frame.version(cell),
            )
        )  # fmt: skip
    return PairCard(frame.frame, a, b, names, _number(pairs.distance[i, j]), tuple(lines))


def _number(value: Any) -> float | None:
    found = float(value)
    return found if found == found else None
