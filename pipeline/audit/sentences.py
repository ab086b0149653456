"""Auditing sentences that come with what is right: against the geometry of the annotated frame, and against systems.

A rule of the labels judges each pair; how far beyond its threshold the pair lies, in metres, makes the weight. Of an
object with a front of its own ("left of the chair") nobody tells us which way it faces: all four ways are tried. A
truth that is right by one of them, and not by the viewer's sides, is in doubt for its frame of reference, and is not
simply wrong.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence

import numpy as np

from pipeline.answering.detector_prompts import unused_words, whole_names
from pipeline.answering.pipeline import Pipeline
from pipeline.audit.seen import MISREAD, NameRead, SeenTruth, margins_of
from pipeline.audit.suspicion import (
    PRIOR,
    AuditItem,
    Evidence,
    SystemAnswers,
    logit,
    system_evidence,
    wrong_probability,
)
from pipeline.diagnosis.asking import annotated_truth
from pipeline.evaluation.sentence_files import Sentence, SentenceFile
from pipeline.labels.tree_truth import states_of
from pipeline.language.chain import NOT_EXACT
from pipeline.language.counted import counted
from pipeline.language.naming import normal_form
from pipeline.language.relation_names import HORIZONTAL
from pipeline.language.tree import Node, Query
from pipeline.relations.relations import F, T, U
from pipeline.system.errors import InputError
from pipeline.system.frozen import dataclass

HOLDS, UNDECIDED = 0.015, 0.1
"""Weights where the rule says that the relation holds of what is right, or that it is too close to call."""
NARROWLY, FAR, SCALE_M = 0.3, 0.8, 0.06
"""Weights where it does not, by a hair and by far; the metres over which the one becomes the other."""
OTHERS_FIT, NOTHING_FITS = 0.75, 0.5
"""Where a longer sentence is not true of what is right, but surely of other things, or of none."""
FITS = 0.6
"""The degree from which on a thing that is too close to call fits the more probably."""
LEANING, FITS_LESS, AT_MOST, CLEARLY = 1.2, 1.2, 0.6, 0.3
"""How much the odds go with the degree where it is too close to call, and with how much more another thing has; the
highest weight of these; and how much more is told."""
SEVERAL, SEVERAL_LONGER, SEVERAL_UNREAD, SEVERAL_A = 0.7, 0.4, 0.2, 0.1
"""Where other things are right as well: the sentence is one relation of two names, says more (colours and the like are
judged by pixels), was not read whole or misread, or says “a”."""
INDEFINITE = frozenset({"a", "an", "any", "some", "another", "one", "every", "each"})
NOTHING_RIGHT = 0.6
"""The weight where nothing is said to be right, and something is."""
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


@dataclass(frozen=True)
class Fit:
    """Fit of a reading of a sentence to the things of a frame."""

    root: Node
    degrees: np.ndarray
    """(N,) float64: from -1, which is F, to 1, which is T, of each thing being what the sentence means."""
    parts: list[tuple[str, np.ndarray]]
    """What is said of it beyond its name, in words, each with its (N,) degrees."""
    margins: np.ndarray
    """(N,) float64: metres, of its best pair under the relation of a plain triple; NaN where nothing tells."""

    @property
    def states(self) -> np.ndarray:
        """(N,) int8: T, U or F."""
        return states_of(self.degrees)

    @property
    def judged(self) -> bool:
        """Test whether anything that is said can be told."""
        return not self.parts or any(degree.any() for _, degree in self.parts)


def fit_of(seen: SeenTruth, root: Node, named: np.ndarray, facing: dict[str, str] | None = None) -> Fit:
    """Fit of a reading, of which `named` (N,) int8 are the things of its name; `facing` as in FACING."""
    top = root.triple
    margins = np.full(len(named), np.nan)
    if top is not None and top.relation in seen.truth.states and not top.inverse and not top.negated:
        ends = seen.means(top.nodes[0]) >= U
        relation = top.relation if facing is None else facing.get(top.relation, top.relation)
        allowed = seen.truth.judged & ends[None, :] & ~np.eye(len(ends), dtype=np.bool_)
        states, found = np.where(allowed, seen.truth.states[relation], F), margins_of(seen.truth, relation)
        if facing is not None:
            held = states.max(axis=1, initial=F)
            return Fit(root, np.minimum(named, held), [], margins)
        like_best = allowed & (states == states.max(axis=1, keepdims=True)) & ~np.isnan(found)
        best = np.where(like_best, found, -np.inf).max(axis=1, initial=-np.inf)
        margins = np.where(np.isfinite(best), best, np.nan)
    parts = seen.parts(root, named)
    return Fit(root, seen.joined(named, [degree for _, degree in parts]), parts, margins)


@dataclass(frozen=True)
class Wording:
    """What the words of a sentence say beside its parts."""

    definite: bool
    """Of its target it does not say "a" or the like."""
    whole: bool
    """All of it was read, and can be judged."""
    notes: tuple[str, ...]
    """What was read otherwise than it is written."""


def evidence_of(
    fit: Fit, right: np.ndarray, own: dict[str, Fit], said: Wording, names: list[str], reference: str
) -> list[Evidence]:
    """Evidence for and against the truth.

    `right` (K,) int64: the things that are said to be right. `own`: by the reference's own sides, by where it faces;
    empty where it has no front or its sides do not matter.
    """
    sure = np.flatnonzero(fit.states == T)
    worst = int(right[np.lexsort((np.nan_to_num(fit.margins[right]), fit.degrees[right]))[0]])
    state, margin, degree = int(fit.states[worst]), float(fit.margins[worst]), float(fit.degrees[worst])
    rival = float(np.delete(fit.degrees, right).max(initial=F)) if said.definite else F
    figures = () if math.isnan(margin) else (("margin", margin),)
    others = [int(k) for k in np.setdiff1d(sure, right)]
    plain = fit.root.triple is not None
    loose = plain and fit.root.attachments[0].relation == "near"  # Nobody means a number of centimetres
    open_ones = [words for words, degrees in fit.parts if degrees[worst] < T and degrees.any()]
    failing = [words for words, degrees in fit.parts if degrees[worst] == F] or open_ones
    relation = " and ".join(failing or [words for words, _ in fit.parts]) or "what the sentence says"
    beyond = "" if math.isnan(margin) or state == U else f" by {abs(margin) * 100:.1f} cm"
    told = "".join(f"; {note}" for note in said.notes)
    if state == F:
        depth = 1 - math.exp(-abs(margin) / SCALE_M)
        weight = NOTHING_FITS + (OTHERS_FIT - NOTHING_FITS) * (rival + 1) / 2
        weight = weight if math.isnan(margin) or loose else NARROWLY + (FAR - NARROWLY) * depth
        weight = min(weight, MISREAD) if said.notes else weight
        way = next((way for way, one in own.items() if (one.states[right] == T).all()), None)
        if way is not None:
            text = (
                f"{names[worst]} is not {relation} for the viewer{beyond}, but is if the {reference} faces {way}{told}"
            )
            return [Evidence("frame", min(weight, OWN_SIDES), text, figures)]
        instead = f"; it holds of {', '.join(names[k] for k in sure)}" if len(sure) else "; it holds of nothing"
        return [Evidence("geometry", weight, f"{names[worst]} is not {relation}{beyond}{instead}{told}", figures)]
    words = f"{names[worst]} is {'' if state == T else 'nearly '}{relation}{beyond}{told}"
    if state == U:
        odds = logit(UNDECIDED) - LEANING * degree + FITS_LESS * max(rival - degree, 0)
        better = np.flatnonzero(fit.degrees > max(degree, 0) + CLEARLY) if said.definite else right[:0]
        instead = f"; {', '.join(names[k] for k in better)} rather is" if len(better) else ""
        weight = min(1 / (1 + math.exp(-odds)), MISREAD if said.notes else AT_MOST)
        found = [Evidence("geometry", weight, f"{words}{instead}", figures)]
        alike = [int(k) for k in np.setdiff1d(np.flatnonzero(fit.degrees >= FITS), right)]
        if degree < FITS or not alike or not (said.definite and said.whole) or said.notes:
            return found
        text = f"{counted(len(alike), 'other thing')} may fit as well: {', '.join(names[k] for k in alike)}"
        return [*found, Evidence("several", SEVERAL_LONGER, text, (("others", float(len(alike))),))]
    found = [Evidence("geometry", HOLDS, words, figures)]
    if others:
        # That it holds of what is right is no answer to this.
        found = [] if said.definite and said.whole else found
        weight = (SEVERAL if plain else SEVERAL_LONGER) if said.whole and not said.notes else SEVERAL_UNREAD
        weight = weight if said.definite else SEVERAL_A
        listed = f"{counted(len(others), 'other thing')} fit as well: {', '.join(names[k] for k in others)}"
        unread = "" if said.whole else ", by what was read of the sentence"
        found.append(Evidence("several", weight, f"{listed}{unread}{told}", (("others", float(len(others))),)))
    for way, one in own.items():
        instead = np.setdiff1d(np.flatnonzero(one.states == T), right)
        if len(instead) and (one.states[right] == F).all():
            text = f"if the {reference} faces {way}, its own sides make {names[int(instead[0])]} right instead"
            return [*found, Evidence("frame", TWO_FRAMES, text)]
    return found


def audit_sentences(
    source: Pipeline,
    asked: SentenceFile,
    systems: Sequence[SystemAnswers] = (),
    progress: Callable[[int, int], None] | None = None,
) -> Iterator[AuditItem]:
    """Audit every sentence in the order of frames; `progress` is told (done, in all).

    `source`: the dataset with its own annotations as the detector.
    """
    by_frame: dict[str, list[Sentence]] = {}
    for sentence in asked.sentences:
        by_frame.setdefault(sentence.frame, []).append(sentence)
    done = 0
    for frame, sentences in by_frame.items():
        seen: SeenTruth | str
        try:
            context = source.prepare(frame)
            truth = annotated_truth(context, source)
            seen = "the frame has no annotations" if truth is None else SeenTruth(context, truth, source)
        except InputError as error:
            seen = str(error)
        for sentence in sentences:
            yield audited(sentence, source, seen, systems)
            done += 1
            if progress is not None:
                progress(done, len(asked.sentences))


def audited(
    sentence: Sentence, source: Pipeline, seen: SeenTruth | str, systems: Sequence[SystemAnswers] = ()
) -> AuditItem:
    """Audit one sentence; `seen` are the frame's annotations, or the reason for their absence."""
    truth = None if isinstance(seen, str) else seen.truth
    numbered = () if truth is None else zip(truth.labels, truth.numbers, strict=True)
    names = [f"{label}·{number}" for label, number in numbered]
    right = np.zeros(0, np.int64) if truth is None else sentence.among(truth)
    said = ", ".join(names[k] for k in right) or ("nothing" if sentence.nothing else _places(sentence))
    evidence: list[Evidence] = []
    seems = unjudged = None
    if isinstance(seen, str):
        unjudged = seen
    elif not len(right) and not sentence.nothing:
        unjudged = "no annotated object is what is right"
    else:
        try:
            evidence, seems = _geometry(sentence, source, seen, right, names)
        except InputError as error:
            unjudged = str(error)
    boxes = np.array(sentence.boxes or (), np.float64).reshape(-1, 4) if truth is None else truth.boxes[right]
    if len(boxes) and systems:
        labelled = [] if truth is None else list(zip(names, truth.boxes, strict=True))
        told = system_evidence(systems, (sentence.frame, sentence.text), boxes, labelled)
        if told is not None:
            evidence.append(told[0])
            seems = seems or told[1]
    item_id = sentence.id or str(sentence.line)
    return AuditItem(item_id, sentence.frame, sentence.text, said, seems, tuple(evidence), unjudged)


def _places(sentence: Sentence) -> str:
    given = ((name, getattr(sentence, name)) for name in ("targets", "points", "boxes"))
    return "; ".join(f"{name} {list(value)}" for name, value in given if value)


def _geometry(
    sentence: Sentence, source: Pipeline, seen: SeenTruth, right: np.ndarray, names: list[str]
) -> tuple[list[Evidence], str | None]:
    query = whole_names(source.read(sentence.text), source.needed_detector(), source.synonyms)
    root = query.default.root
    name = NameRead(np.full(len(names), T, np.int8)) if root.anything else seen.read(root.name)
    if sentence.nothing:
        sure = np.flatnonzero(fit_of(seen, root, name.states).states == T)
        text = f"nothing is said to be right, and it holds of {', '.join(names[k] for k in sure)}"
        return ([Evidence("geometry", NOTHING_RIGHT, text)] if len(sure) else []), _listed(sure, names)
    strange = right[name.states[right] == F]
    if len(strange):
        sure = np.flatnonzero(fit_of(seen, root, name.states).states == T)
        text = f"the sentence asks for a {root.name}, and what is right is annotated as {names[int(strange[0])]}"
        note = f"; {name.note}" if name.note else ""
        return [Evidence("class", name.weight, text + note)], _listed(sure, names)
    # Who calls what is right so, may call the like of it so.
    labels = np.array(seen.truth.labels)
    named = np.where(np.isin(labels, labels[right]) & (name.states == U), T, name.states).astype(np.int8)
    fits = [fit_of(seen, reading.root, named) for reading in query.readings]
    notes = [f"“{a}” is read as “{b}”" for a, b in query.mended]
    notes += [read.note for n in query.nodes if n.name in seen.names and (read := seen.names[n.name]).note]
    fits = [fit for fit in fits if fit.judged]
    if not fits:
        raise InputError("nothing that the sentence says can be told" + "".join(f"; {note}" for note in notes))
    unread = any(note != NOT_EXACT for _, note in unused_words(query))
    said = Wording(_definite(query), not unread, tuple(dict.fromkeys(notes)))
    told = [evidence_of(fit, right, _own(seen, fit, named), said, names, _reference(fit.root)) for fit in fits]
    # Where it can be read in several ways, the one that speaks least against the truth is meant.
    best = min(range(len(told)), key=lambda k: wrong_probability(told[k]))
    sure = np.flatnonzero(fits[best].states == T)
    wrong = any(e.kind in ("geometry", "several") and e.weight > PRIOR for e in told[best])
    return told[best], _listed(sure, names) if wrong else None


def _reference(root: Node) -> str:
    top = root.pairwise
    return top.nodes[0].name if top is not None and top.nodes else ""


def _own(seen: SeenTruth, fit: Fit, named: np.ndarray) -> dict[str, Fit]:
    """Fits by the reference's own sides, keyed by where it faces; none where it has no front."""
    top = fit.root.triple
    sided = top is not None and top.relation in HORIZONTAL and has_front(_reference(fit.root))
    return {way: fit_of(seen, fit.root, named, sides) for way, sides in FACING.items()} if sided else {}


def _definite(query: Query) -> bool:
    """Test for a target that is one: with "the", or without an article, as in headlines; not for "a"."""
    at = next((s.start for s in query.spans if s.role == "target" and s.index == 0), 0)
    before = query.text[:at].lower().split()[-3:]
    return not INDEFINITE.intersection(before[-1:]) and "of" not in before[-2:]


def _listed(chosen: np.ndarray, names: list[str]) -> str | None:
    return ", ".join(names[int(k)] for k in chosen) or None
