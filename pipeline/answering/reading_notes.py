"""Notes on assumptions about the words of a question: comparisons among several, sizes of seen parts."""

from __future__ import annotations

from collections.abc import Iterator

from pipeline.answering.ask import Trace
from pipeline.language.choices import compares
from pipeline.language.tree import Node
from pipeline.relations.attributes import SIZES

_HEIGHTS = ("high", "low")
_FIRST = {
    "closest": "closest", "farthest": "farthest", "near": "nearest", "far": "farthest", "high": "highest",
    "low": "lowest", "left": "leftmost", "right": "rightmost", "wide": "widest", "big": "biggest", "thin": "thinnest",
}  # fmt: skip
"""The superlatives of orders and relations that do not end in -est."""


def reading_notes(trace: Trace) -> tuple[str, ...]:
    """Notes for an answer, a line each, without repeats.

    A comparison decides between two; of more the first in order is taken, with their number told. Sizes and heights are
    those of the part of each object seen by the camera.
    """
    return tuple(dict.fromkeys(note for node in trace.root.walk() for note in _of_node(trace, node)))


def _of_node(trace: Trace, node: Node) -> Iterator[str]:
    found = trace.candidates.get(node.label)
    things = [] if found is None else [trace.objects[int(i)] for i in dict.fromkeys(found.index.tolist())]
    if len(things) < 2:
        return
    compared = [(c.text, c.order) for c in node.choices if c.rank == 1 and compares(c.text)]
    compared += [
        (a.phrase, a.relation)
        for a in node.attachments
        if a.relation in ("closest", "farthest") and not a.negated and compares(a.phrase)
    ]
    if len(things) > 2:
        for text, order in dict.fromkeys(compared):
            first = _FIRST.get(order, f"{order}est")
            several = f"{len(things)} things are called '{node.name}'"
            yield f"'{text}' compares two, and {several}: of those that fit, the {first} is taken"
    sizes = [c.text for c in node.choices if c.order in SIZES]
    sizes += [str(a) for a in node.attributes if a.kind == "size"]
    heights = [c.text for c in node.choices if c.order in _HEIGHTS]
    lifted = [thing for thing in things if thing.lifted.quality.points]
    cut = sum(thing.lifted.quality.touches_border for thing in lifted)
    border = f"; {cut} of {len(things)} are cut by the border of the picture" if cut else ""
    for text in dict.fromkeys((*sizes, *heights)) if lifted else ():
        yield f"'{text}' goes by the part of each thing that is seen, not by the whole{border}"
