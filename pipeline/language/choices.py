"""Words that choose among several things of one kind: extremes, ordinals, comparisons and sides, as data."""

from __future__ import annotations

import re

from pipeline.language.lexicon import SCENE


def _table(text: str) -> dict[str, str]:
    """Map words to orders, from "left: a, b; right: c"."""
    return {
        word.strip(): order.strip()
        for order, words in (line.split(":") for line in text.split(";"))
        for word in words.split(",")
    }


EXTREMES = _table(
    "left: leftmost, leftest, left most, most left, far left, farthest left, furthest left, extreme left, very left;"
    "right: rightmost, rightest, right most, most right, far right, farthest right, furthest right, extreme right,"
    "very right;"
    "high: topmost, top most, uppermost, very top, highest, higher, highest up, higher up;"
    "low: lowest, bottommost, bottom most, very bottom, lowermost, lower most, lower, lowest down, lower down;"
    "near: closest, nearest, closer, nearer, frontmost, front most, foremost, very front, closest by, nearest by;"
    "far: farthest, furthest, farther, further, backmost, back most, very back, rearmost, most distant, farthest away,"
    "furthest away, farther away, further away, farthest back, furthest back, further back, farther back;"
    "tall: tallest, taller; short: shortest, shorter;"
    "big: biggest, bigger, largest, larger, greatest;"
    "small: smallest, smaller, tiniest, tinier, littlest, littler;"
    "wide: widest, wider, broadest, broader; narrow: narrowest, narrower, slimmest, slimmer;"
    "long: longest, longer; thin: thinnest, thinner; thick: thickest, thicker"
)
"""Superlatives and comparatives before a noun, by the order of which they are the first."""

COMPARATIVES = frozenset(w for phrase in EXTREMES for w in phrase.split() if w.endswith("er") and len(w) > 4)
"""Words that compare two things; of more they are read as the superlative, which `compares` lets be told."""


def compares(text: str) -> bool:
    """Test if words of a choice or of a relation compare two things: `the closer of the two`, `closer to`."""
    return text.startswith("more ") or not COMPARATIVES.isdisjoint(text.split())


SIDES = _table(
    "left: left, left hand, lefthand; right: right, right hand, righthand; top: top, upper; bottom: bottom, lower;"
    "near: front, foreground; far: back, rear, background, distance, far; middle: middle, center, centre, central, mid"
)
"""Words of sides before a noun or after `on the`, by the order of which they are the beginning."""

ORDINALS = {
    w: n
    for n, words in enumerate(
        (
            "first 1st",
            "second 2nd",
            "third 3rd",
            "fourth 4th",
            "fifth 5th",
            "sixth 6th",
            "seventh 7th",
            "eighth 8th",
            "ninth 9th",
            "tenth 10th",
        ),
        start=1,
    )
    for w in words.split()
} | {"last": -1}
NUMBERS = {w: n for n, w in enumerate(("two", "three", "four", "five", "six", "seven", "eight", "nine", "ten"), 2)}
NUMBERS |= {str(n): n for n in range(2, 11)}
FROM_LAST = re.compile(
    r"(?:next to(?: the)? last|penultimate|last but one"
    r"|(?P<rank>second|third|fourth|2nd|3rd) (?:to|from)(?: the)? last)(?= |$)"
)
"""`second to last`, which counts from the end."""
OPPOSITE = {
    "left": "right",
    "right": "left",
    "top": "bottom",
    "bottom": "top",
    "near": "far",
    "far": "near",
    "high": "low",
    "low": "high",
    "tall": "short",
    "short": "tall",
    "big": "small",
    "small": "big",
}

_SIDE = "|".join(sorted(SIDES, key=len, reverse=True))
_THE = r"(?:(?:the|your|my|our|its|their|this|that) )?"
_SCENE = rf"(?: (?:of|in) {_THE}(?:{'|'.join(sorted(SCENE))}))?"
_PART = r"(?:side|corner|end|edge|part|half|hand|area|section|portion|region|position|row|most)"
AT_SIDE = re.compile(
    rf"(?:on|at|in|to|toward|towards|from) {_THE}(?P<far>(?:(?:very|far|farthest|furthest|extreme|most) (?={_SIDE})))?"
    rf"(?P<side>(?:{_SIDE})(?: (?:{_SIDE}))?)(?P<most> ?most)?(?P<part>(?: {_PART})*){_SCENE}(?= |$)(?! of )"
)
"""A side after the noun: `on the left`, `at the bottom right corner of the picture`, `to your far left`."""

REGION_OF = re.compile(
    rf"(?P<preposition>on|at|in|to|toward|towards|near|by) {_THE}(?:(?:very|far|extreme|outer|inner) )?"
    rf"(?:(?P<side>(?:{_SIDE})(?: (?:{_SIDE}))?) )?(?:hand )?(?P<part>side|corner|end|edge|part|half|area|section|"
    rf"portion|region|position|foot|head|base|front|back|right|left|top|bottom) of(?= )"
)
"""A part of a thing: `on the right end of the couch`, `at the edge of the table`."""
REGION_RELATION = {"in": "in", "on": "on"}
"""What a part of a thing says of it, by the preposition; else `near`."""

SIDE_OR_PLACE = re.compile(r"(?:on|at|in) the (?P<side>left|right|front|back|left hand|right hand)(?: side)? of")
"""Phrases of relations that may also say a place on a thing: `the plate on the left side of the table`."""

FROM_SIDE = re.compile(
    rf"(?:from|starting from|counting from|counted from|on|to|at|in) {_THE}(?:far )?(?P<side>{_SIDE})"
    rf"(?: (?:hand )?(?:side|end|edge))?{_SCENE}(?= |$)(?! of )"
)
"""Where an ordinal begins to count: `second from the left`."""

BARE_SIDE = re.compile(
    rf"(?:(?P<far>far|very|extreme) (?P<only>left|right|back)|(?P<away>far) (?:away|off)"
    rf"|(?P<side>(?:{_SIDE})(?: (?:left|right))?)"
    rf"(?P<part>(?: {_PART})+)|(?P<two>(?:top|bottom|upper|lower|front|back) (?:left|right)"
    rf"|(?:left|right) (?:top|bottom|front|back))|(?P<last>left|right|middle|cent(?:er|re))(?= *$)){_SCENE}(?= |$)"
    rf"(?! of )"
)
"""A side after the noun, without a preposition: `plant far left`, `mug, right side`, `box bottom left`, `mug left`."""

EXTREME_AT_SIDE = re.compile(
    rf"(?:farthest|furthest|most|more|further|farther|closest|nearest|all the way)(?: away)? ?(?:to|on|at|towards?)? "
    rf"{_THE}(?P<side>left|right|top|bottom|front|back)(?: (?:hand )?(?:side|end|edge))?{_SCENE}(?= |$)(?! of )"
)
"""`furthest to the left`, `farthest left`."""


def orders_of(words: str) -> tuple[str, ...]:
    """Orders named by words of sides: both of `bottom left`."""
    if words in SIDES:
        return (SIDES[words],)
    several = [w for w in words.split() if w not in ("hand", "most")]
    return tuple(dict.fromkeys(SIDES[w] for w in several)) if all(w in SIDES for w in several) else ()


OF_THE_SCENE = frozenset({"left", "right", "front", "behind", "between", "above", "below", "on", "in"})
"""Relations that name a side or say nothing where their reference is the scene: `on the left side of the room`."""
