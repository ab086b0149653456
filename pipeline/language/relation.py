"""The relations, each declared once: names, readings, wordings, columns and colours follow from `DECLARED`.

How a relation is judged is said by its predicate, in `pipeline.relations.relations`. `docs/adding-a-relation.md`
shows how one is added.
"""

from __future__ import annotations

from typing import Literal

from pipeline.system.frozen import dataclass


@dataclass(frozen=True)
class Relation:
    """A relation "TARGET name REFERENCE", apart from its geometric rule."""

    name: str  # Canonical name; of labels, records and networks
    phrase: str  # Wording between two nouns
    reads: tuple[str, ...]  # The phrases that are read as it: lower-case words with single spaces, `phrase` among them
    # The phrases of automatic sentences, which claim no more than the relation: `under` and `over` would, `at the back
    # of` may mean a part. Empty for `phrase` alone
    says: tuple[str, ...] = ()
    which: str = ""  # Wording in "Which object is ... the laptop?"; "" for `phrase`
    swapped_phrase: str = ""  # Wording of "a name b" from b's side where no relation is its inverse; "" for none
    swapped_reads: tuple[str, ...] = ()  # The phrases of that, of REFERENCE to TARGET
    # The relation that b has to a where a has this one to b; its own name where it is symmetric
    inverse: str | None = None
    # Of a direction: its axis among the viewer's (right, up, forward), and on which side (-1, 1)
    # the target lies
    axis: tuple[int, Literal[-1, 1]] | None = None
    viewer_dependent: bool = False  # It depends on where the camera stands
    pairwise: bool = True  # It has a state for every ordered pair of objects; otherwise it needs more of them
    # The vocabularies that it is in, besides "all" (every pairwise one) and SEMANTIC_ABSTRACTION
    vocabularies: tuple[str, ...] = ()
    coarser: str | None = None  # Stand-in in a vocabulary that lacks it
    color: tuple[int, int, int] = (110, 110, 110)  # Colour in pictures of statistics
    since: str = "1.0.0"  # The version of the labels' schema that brought its columns; labels of an older one have none


def _side(side: str) -> tuple[str, ...]:
    ways = (side, f"{side} side", f"{side} hand side")
    led = [f"{p} {the}{s} of" for p in ("to", "on", "at", "in") for the in ("the ", "") for s in ways]
    compared = [f"{more} {to}{side} than" for more in ("further", "farther", "more") for to in ("", "to the ")]
    # Who learns English says `from` where it has `of`.
    learned = [f"{phrase[:-3]} from" for phrase in (*(f"{s} of" for s in ways), *led)]
    return (*(f"{s} of" for s in ways), *led, f"{side} to", *compared, *learned)


def _learned(*prepositions: str) -> tuple[str, ...]:
    """Phrases of English learners: `near of` and `near from`."""
    return tuple(f"{word} {of}" for word in prepositions for of in ("of", "from"))


DECLARED: tuple[Relation, ...] = (
    Relation(
        "left",
        "left of",
        _side("left"),
        says=("left of", "to the left of", "on the left of", "on the left side of"),
        which="to the left of",
        inverse="right",
        axis=(0, -1),
        viewer_dependent=True,
        vocabularies=("avd",),
        color=(51, 34, 136),
    ),
    Relation(
        "right",
        "right of",
        _side("right"),
        says=("right of", "to the right of", "on the right of", "on the right side of"),
        which="to the right of",
        inverse="left",
        axis=(0, 1),
        viewer_dependent=True,
        vocabularies=("avd",),
        color=(136, 204, 238),
    ),
    Relation(
        "above",
        "above",
        ("above", "over", "higher than", "up above", "higher up than", "over top of", *_learned("above", "over")),
        says=("above", "higher than"),
        inverse="below",
        axis=(1, 1),
        vocabularies=("avd",),
        color=(17, 119, 51),
    ),
    Relation(
        "below",
        "below",
        (
            "below",
            "under",
            "underneath",
            "beneath",
            "lower than",
            "down below",
            "underneath of",
            *_learned("below", "under", "beneath"),
        ),
        says=("below", "lower than"),
        inverse="above",
        axis=(1, -1),
        vocabularies=("avd",),
        color=(68, 170, 153),
    ),
    Relation(
        "front",
        "in front of",
        (
            "in front of",
            "in the front of",
            "at the front of",
            "on the front of",
            "to the front of",
            "front of",
            "infront of",
            "in front",
            "ahead of",
            "closer than",
            "nearer than",
            "closer to me than",
            "nearer to me than",
            "closer to the camera than",
            "nearer to the camera than",
            "further forward than",
            "in front from",
        ),
        inverse="behind",
        axis=(2, -1),
        viewer_dependent=True,
        vocabularies=("avd",),
        color=(136, 34, 85),
    ),
    Relation(
        "behind",
        "behind",
        (
            "behind",
            "in the back of",
            "at the back of",
            "on the back of",
            "to the back of",
            "in back of",
            "behind of",
            "farther than",
            "further than",
            "farther away than",
            "further away than",
            "further back than",
            "farther back than",
            "farther from me than",
            "further from me than",
            "farther from the camera than",
            "further from the camera than",
            "behind from",
        ),
        inverse="front",
        axis=(2, 1),
        viewer_dependent=True,
        vocabularies=("avd",),
        color=(204, 102, 119),
    ),
    Relation(
        "on",
        "on",
        (
            "on",
            "on top of",
            "on the top of",
            "on top",
            "on the top",
            "top of",
            "atop",
            "atop of",
            "upon",
            "onto",
            "on the surface of",
            "resting on",
            "lying on",
            "sitting on",
            "standing on",
            "placed on",
            "laying on",
            "supported by",
        ),
        says=("on", "on top of", "resting on", "sitting on"),
        swapped_phrase="supporting",
        swapped_reads=("supporting", "supports", "holding", "holds", "carrying", "carries"),
        coarser="above",
        color=(153, 153, 51),
    ),
    Relation(
        "in",
        "in",
        (
            "in",
            "inside",
            "inside of",
            "within",
            "contained in",
            "contained by",
            "contained within",
            "enclosed in",
            "enclosed by",
            "in the inside of",
        ),
        says=("in", "inside", "inside of", "within"),
        swapped_phrase="containing",
        swapped_reads=("containing", "contains", "enclosing", "encloses"),
        color=(221, 204, 119),
    ),
    Relation(
        "near",
        "near",
        (
            "near",
            "near to",
            "nearby",
            "next to",
            "beside",
            "besides",
            "by",
            "close to",
            "close by",
            "by the side of",
            "adjacent to",
            "alongside",
            "alongside of",
            "in the vicinity of",
            "over by",
            "over near",
            "over next to",
            "next of",
            *_learned("near", "beside", "adjacent", "close"),
        ),
        says=("near", "next to", "close to", "beside"),
        inverse="near",
        color=(170, 68, 153),
    ),
    Relation(
        "between",
        "between",
        (
            "between",
            "in between",
            "in the middle of",
            "in the center of",
            "in the centre of",
            "in middle of",
            "between of",
        ),
        pairwise=False,
    ),
    Relation(
        "closest",
        "closest to",
        ("closest to", "closest", "nearest to", "nearest", "closer to", "nearer to"),
        pairwise=False,
    ),
    Relation(
        "farthest",
        "farthest from",
        (
            "farthest from",
            "furthest from",
            "farthest away from",
            "furthest away from",
            "farther from",
            "further from",
            "farther away from",
            "further away from",
            "most distant from",
            "farthest",
            "furthest",
            "most distant",
        ),
        pairwise=False,
    ),
)
"""The relations in the order in which they are always shown and stored: a new one stands last.

The first nine colours are those of Paul Tol's scheme "muted" (SRON/EPS/TN/09-002), which stay apart under all common
colour-vision deficiencies; opposites are of one hue, dark and light."""

SEMANTIC_ABSTRACTION = {
    "behind": "behind",
    "left": "on the left of",
    "right": "on the right of",
    "front": "in front of",
    "on": "on",
    "in": "in",
}
"""The vocabulary of Semantic Abstraction (Ha and Song, CoRL 2022) with its own words, in the order of its networks."""
