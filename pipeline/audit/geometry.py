"""What geometry says of an item's truth: by the viewer's left, right, front and behind, and by an object's own.

A rule of the labels judges each pair; how far beyond its threshold the pair lies, in metres, makes the weight. Of an
object with a front of its own ("left of the chair") nobody tells us which way it faces: all four ways are tried. A
truth that is right by one of them, and not by the viewer's sides, is in doubt for its frame of reference, and is not
simply wrong.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from pipeline.audit.suspicion import Evidence
from pipeline.labels.cases import FrameCases
from pipeline.language.counted import counted
from pipeline.language.naming import normal_form
from pipeline.language.relation_names import PHRASE
from pipeline.relations.pair_measures import AllMeasures, F, Profile, T, U, known_extents, measure_pairs
from pipeline.relations.relations import PREDICATES, pair_margins, pair_states

HOLDS, UNDECIDED = 0.02, 0.08
"""Weights where the rule says that the relation holds of what is right, or that it is too close to call."""
NARROWLY, FAR, SCALE_M = 0.3, 0.8, 0.06
"""Weights where it does not, by a hair and by far; the metres over which the one becomes the other."""
NOTHING_FITS = 0.25
"""Where a longer sentence is true of nothing in the frame: it may be misread, too."""
SEVERAL, SEVERAL_LONGER, SEVERAL_A = 0.7, 0.4, 0.1
"""Where other things are right as well: the sentence says “the” and is one relation of two names, says more (colours
and the like are judged by pixels), or says “a”."""
OWN_SIDES, TWO_FRAMES = 0.55, 0.1
"""Where the truth is right by the reference's own sides alone, and where these would make another thing right."""

FACING: dict[str, dict[str, str]] = {
    "towards the viewer": {"left": "right", "right": "left", "front": "front", "behind": "behind"},
    "away from the viewer": {"left": "left", "right": "right", "front": "behind", "behind": "front"},
    "to the viewer's right": {"front": "right", "behind": "left", "left": "behind", "right": "front"},
    "to the viewer's left": {"front": "left", "behind": "right", "left": "front", "right": "behind"},
}
"""Which of the viewer's relations is which of the object's own, by where the object faces."""
FRONTED = frozenset(
    {
        "chair",
        "armchair",
        "sofa",
        "couch",
        "loveseat",
        "bench",
        "stool",
        "bed",
        "desk",
        "dresser",
        "nightstand",
        "cabinet",
        "cupboard",
        "wardrobe",
        "closet",
        "bookshelf",
        "bookcase",
        "shelf",
        "drawer",
        "fridge",
        "refrigerator",
        "oven",
        "stove",
        "microwave",
        "dishwasher",
        "washer",
        "dryer",
        "sink",
        "toilet",
        "bathtub",
        "fireplace",
        "television",
        "tv",
        "monitor",
        "screen",
        "laptop",
        "computer",
        "printer",
        "scanner",
        "copier",
        "camera",
        "clock",
        "mirror",
        "piano",
        "door",
        "window",
        "car",
        "truck",
        "bus",
        "van",
        "bicycle",
        "motorcycle",
        "person",
        "man",
        "woman",
        "boy",
        "girl",
        "child",
        "dog",
        "cat",
        "horse",
        "robot",
        "doll",
    }
)
"""Heads of names of things with a front of their own, so that people may mean their sides."""


def has_front(name: str) -> bool:
    """Tell classes with a front side of their own, by the last word of the name."""
    return normal_form(name).split(" ")[-1] in FRONTED


def by_own_sides(truth: FrameCases) -> dict[str, FrameCases]:
    """Frames with relations by an object's own sides, keyed by where the object faces."""
    return {
        way: replace(truth, states={r: truth.states.get(sides.get(r, r), s) for r, s in truth.states.items()})
        for way, sides in FACING.items()
    }


def margins_of(truth: FrameCases, relation: str) -> np.ndarray:
    """(N, N) float64: distance of each pair from the rule's threshold, metres; positive where the relation holds,
    negative where not, NaN where extents do not tell."""
    lo, hi = truth.geometry["lo"], truth.geometry["hi"]
    known = known_extents(lo, hi)
    if relation not in PREDICATES or PREDICATES[relation].reads_points:
        return np.full(truth.judged.shape, np.nan)
    fill = known[:, None]
    measured = AllMeasures(measure_pairs(np.where(fill, lo, 0.0), np.where(fill, hi, 0.0), Profile()), Profile())
    found = pair_margins(measured, pair_states(measured, known, [relation]), [relation])[..., 0]
    return np.where(known[:, None] & known[None, :], found, np.nan)


@dataclass(frozen=True)
class Fit:
    """How a sentence fits the things of a frame."""

    states: np.ndarray
    """(N,) int8: T, U or F of each thing being what the sentence means."""
    margins: np.ndarray
    """(N,) float64: metres, of its best pair; NaN where nothing tells."""


def fit_of_triple(truth: FrameCases, targets: np.ndarray, relation: str, references: np.ndarray) -> Fit:
    """Fit of "TARGET RELATION REFERENCE"; (N,) bool each for the things of these names."""
    allowed = truth.judged & references[None, :] & ~np.eye(len(references), dtype=np.bool_)
    states = np.where(allowed, truth.states[relation], F)
    margins = margins_of(truth, relation)
    like_best = allowed & (states == states.max(axis=1, keepdims=True)) & ~np.isnan(margins)
    best = np.where(like_best, margins, -np.inf).max(axis=1, initial=-np.inf)
    return Fit(
        np.where(targets, states.max(axis=1, initial=F), F).astype(np.int8), np.where(np.isfinite(best), best, np.nan)
    )


def geometry_evidence(
    fit: Fit, right: np.ndarray, own: dict[str, Fit], definite: bool, words: tuple[str, str, str], names: list[str]
) -> list[Evidence]:
    """Evidence for and against the truth.

    `right` (K,) int64: the things that are said to be right. `own`: by the reference's own sides, by where it faces;
    empty where it has no front or its sides do not matter. `definite`: the sentence says "the" of its target. `words`:
    target, relation and reference; the last two are empty of other sentences.
    """
    sure = np.flatnonzero(fit.states == T)
    worst = int(right[np.lexsort((np.nan_to_num(fit.margins[right]), fit.states[right]))[0]])
    state, margin = int(fit.states[worst]), float(fit.margins[worst])
    figures = () if math.isnan(margin) else (("margin", margin),)
    others = [int(k) for k in np.setdiff1d(sure, right)]
    plain = words[1] in PHRASE
    relation = f"{PHRASE[words[1]]} the {words[2]}" if plain else "what the sentence says"
    beyond = "" if math.isnan(margin) or state == U else f" by {abs(margin) * 100:.1f} cm"
    if state == F:
        way = next((way for way, one in own.items() if (one.states[right] == T).all()), None)
        depth = 1 - math.exp(-(0.1 if math.isnan(margin) else abs(margin)) / SCALE_M)
        weight = NARROWLY + (FAR - NARROWLY) * depth if plain or len(sure) else NOTHING_FITS
        if way is not None:
            text = f"{names[worst]} is not {relation} for the viewer{beyond}, but is if the {words[2]} faces {way}"
            return [Evidence("frame", min(weight, OWN_SIDES), text, figures)]
        instead = f"; it holds of {', '.join(names[k] for k in sure)}" if len(sure) else "; it holds of nothing"
        return [Evidence("geometry", weight, f"{names[worst]} is not {relation}{beyond}{instead}", figures)]
    said = f"{names[worst]} is {relation}{beyond}" if state == T else f"{names[worst]} is nearly {relation}"
    found = [Evidence("geometry", HOLDS if state == T else UNDECIDED, said, figures)]
    if others and definite:
        # That it holds of what is right is no answer to this.
        found = []
    if others:
        weight = (SEVERAL if plain else SEVERAL_LONGER) if definite else SEVERAL_A
        text = (
            f"{counted(len(others), 'other thing')} fit as well: {', '.join(names[k] for k in others)}"
            f"{', and the sentence says “the”' if definite else ''}"
        )
        found.append(Evidence("several", weight, text, (("others", float(len(others))),)))
    for way, one in own.items():
        instead = np.setdiff1d(np.flatnonzero(one.states == T), right)
        if len(instead) and (one.states[right] == F).all():
            text = f"if the {words[2]} faces {way}, its own sides make {names[int(instead[0])]} right instead"
            return [*found, Evidence("frame", TWO_FRAMES, text)]
    return found
