"""The oracles: each replaces what one module gave by the truth, and nothing else.

RECALL
    Every labelled object of an asked class that no candidate overlaps by half
    joins the candidates, with its own pixels lifted and with the median
    confidence of the run's right detections.
LIFT
    Every candidate that is an object gets that object's true geometry; the
    relation scorer then scores it anew. Two of them that are different objects
    no longer count as one thing because their masks are alike, only because
    their 2D boxes are. What is no object stays as it is.
SRM
    The relation of two candidates that are both objects is .99, .50 or .01, as
    the label says T, U or F. Where one is no object, or the pair was not
    judged, it stays.
CONF
    A candidate that is an object of the asked class is given .99, every other one .01.
"""

from __future__ import annotations

ORACLES = ("RECALL", "LIFT", "SRM", "CONF")
RECALL, LIFT, SRM, CONF = (1 << k for k in range(4))
SUBSETS = 16
STATE_PROBABILITY = {1: 0.99, 0: 0.50, -1: 0.01}
RIGHT_SCORE, WRONG_SCORE = 0.99, 0.01


def names_of(subset: int) -> tuple[str, ...]:
    """The oracles of a subset, which is a number with one bit for each."""
    return tuple(name for k, name in enumerate(ORACLES) if subset >> k & 1)


def size(subset: int) -> int:
    """How many oracles a subset holds."""
    return subset.bit_count()
