"""Auditing sentences that come with what is right: against the geometry of the annotated frame, and against systems.

A rule of the labels judges each pair; how far beyond its threshold the pair lies, in metres, makes the weight. Of an
object with a front of its own ("left of the chair") nobody tells us which way it faces: all four ways are tried. A
truth that is right by one of them, and not by the viewer's sides, is in doubt for its frame of reference, and is not
simply wrong.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from pipeline.answering.ask import Trace
from pipeline.answering.objects import PreparedFrame
from pipeline.answering.pipeline import Pipeline
from pipeline.audit.suspicion import PRIOR, AuditItem, Evidence, SystemAnswers, system_evidence
from pipeline.diagnosis.asking import annotated_truth
from pipeline.diagnosis.sentence_truth import sentence_case
from pipeline.evaluation.sentence_files import Sentence, SentenceFile
from pipeline.labels.cases import FrameCases
from pipeline.labels.check.expressions import says_the
from pipeline.language.counted import counted
from pipeline.language.naming import match, normal_form
from pipeline.language.relation_names import HORIZONTAL, PHRASE
from pipeline.relations.pair_measures import AllMeasures, F, Profile, T, U, known_extents, measure_pairs
from pipeline.relations.relations import PREDICATES, pair_margins, pair_states
from pipeline.system.errors import InputError

HOLDS, UNDECIDED = 0.02, 0.08
"""Weights where the rule says that the relation holds of what is right, or that it is too close to call."""
NARROWLY, FAR, SCALE_M = 0.3, 0.8, 0.06
"""Weights where it does not, by a hair and by far; the metres over which the one becomes the other."""
NOTHING_FITS = 0.25
"""Where a longer sentence is true of nothing in the frame: it may be misread, too."""
SEVERAL, SEVERAL_LONGER, SEVERAL_A = 0.7, 0.4, 0.1
"""Where other things are right as well: the sentence says “the” and is one relation of two names, says more (colours
and the like are judged by pixels), or says “a”."""
OTHER_CLASS = 0.9
"""The weight of an annotation whose name is not what the sentence asks for."""
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
        try:
            context = source.prepare(frame)
            truth: FrameCases | str | None = annotated_truth(context, source)
        except InputError as error:
            context, truth = None, str(error)
        for sentence in sentences:
            yield audited(sentence, source, context, truth, systems)
            done += 1
            if progress is not None:
                progress(done, len(asked.sentences))


def audited(
    sentence: Sentence,
    source: Pipeline,
    context: PreparedFrame | None,
    known: FrameCases | str | None,
    systems: Sequence[SystemAnswers] = (),
) -> AuditItem:
    """Audit one sentence; `known` are the frame's annotations, or the reason for their absence."""
    truth = known if isinstance(known, FrameCases) else None
    numbered = () if truth is None else zip(truth.labels, truth.numbers, strict=True)
    names = [f"{label}·{number}" for label, number in numbered]
    right = np.zeros(0, np.int64) if truth is None else sentence.among(truth)
    said = ", ".join(names[k] for k in right) or ("nothing" if sentence.nothing else _places(sentence))
    evidence: list[Evidence] = []
    seems = unjudged = None
    if truth is None or context is None:
        unjudged = known if isinstance(known, str) else "the frame has no annotations"
    elif not len(right) and not sentence.nothing:
        unjudged = "no annotated object is what is right"
    else:
        try:
            evidence, seems = _geometry(sentence, source, context, truth, right, names)
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
    sentence: Sentence, source: Pipeline, context: PreparedFrame, truth: FrameCases, right: np.ndarray, names: list[str]
) -> tuple[list[Evidence], str | None]:
    trace = source.ask(context, sentence.text)
    root, top = trace.root, trace.root.pairwise
    targets = of_name(truth, root.name, source) if not root.anything else np.ones(len(truth.labels), np.bool_)
    reference = top.nodes[0].name if top is not None and top.nodes else ""
    sided = top is not None and top.relation in HORIZONTAL and has_front(reference)
    own = {way: _fit(trace, source, context, one, targets) for way, one in by_own_sides(truth).items()} if sided else {}
    fit = _fit(trace, source, context, truth, targets)
    sure = np.flatnonzero(fit.states == T)
    if sentence.nothing:
        text = f"nothing is said to be right, and it holds of {', '.join(names[k] for k in sure)}"
        return ([Evidence("geometry", NOTHING_RIGHT, text)] if len(sure) else []), _listed(sure, names)
    strange = right[~targets[right]]
    if len(strange):
        text = f"the sentence asks for a {root.name}, and what is right is annotated as {names[int(strange[0])]}"
        return [Evidence("class", OTHER_CLASS, text)], _listed(sure, names)
    words = (root.name, trace.relation if trace.query.default.root.triple is not None else "", reference)
    definite = says_the(sentence.text, [root.label])[0]
    evidence = geometry_evidence(fit, right, own, definite, words, names)
    wrong = any(e.kind in ("geometry", "several") and e.weight > PRIOR for e in evidence)
    return evidence, _listed(sure, names) if wrong else None


def _listed(chosen: np.ndarray, names: list[str]) -> str | None:
    return ", ".join(names[int(k)] for k in chosen) or None


def of_name(truth: FrameCases, name: str, source: Pipeline) -> np.ndarray:
    """(N,) bool: annotated things with this name."""
    known = tuple(dict.fromkeys([*truth.labels, *source.dataset.class_names]))
    return np.isin(truth.labels, match(name, known, source.synonyms))


def _fit(trace: Trace, source: Pipeline, context: PreparedFrame, truth: FrameCases, targets: np.ndarray) -> Fit:
    e = trace.query.expression
    plain = len(trace.query.readings) == 1 and trace.query.default.root.triple is not None
    if e is not None and plain and not e.second_reference and not e.inverse and e.relation in truth.states:
        return fit_of_triple(truth, targets, e.relation, of_name(truth, e.reference, source))
    case = sentence_case(truth, trace, source, context)
    states = np.full(len(targets), F, np.int8)
    if not isinstance(case, str):
        states[case.acceptable] = U
        states[case.strict] = T
    elif "true of nothing" not in case:
        raise InputError(case)
    return Fit(states, np.full(len(targets), np.nan))
