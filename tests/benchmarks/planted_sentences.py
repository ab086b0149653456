"""Planted faults in sentences with attributes: one module is broken at a time, and the verdict has to name it.

The sentences are made of what is labelled ("the red mug", "the big chair left of the table"), the clean pipeline is
that of `planted`, and so are the faults of all modules but ATTRIBUTE:

repainted    the right things have another colour in the picture that the pipeline sees
impostor     the other things of the class have the asked colour there
opposite     the model of attributes says the opposite
"""

from __future__ import annotations

import copy
from collections.abc import Iterator
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, replace
from typing import Any
from unittest.mock import patch

import numpy as np

from pipeline.answering import evidence
from pipeline.answering.ask import Trace
from pipeline.answering.objects import PreparedFrame, prepare_frame
from pipeline.answering.pipeline import Pipeline
from pipeline.diagnosis.asking import annotated_truth, judge_sentence, judge_trace
from pipeline.diagnosis.sentence_truth import sentence_case
from pipeline.diagnosis.verdict import Diagnosis
from pipeline.geometry.boxes import iou_2d
from pipeline.labels.cases import HIT, Case, FrameCases
from pipeline.language.relation_names import PHRASE
from pipeline.system.errors import InputError

from .planted import clean_source, plant
from .planted_parts import share

COLORS = {
    "red": (190, 30, 35), "blue": (40, 70, 180), "green": (50, 130, 60), "yellow": (235, 205, 45),
    "white": (240, 240, 238), "black": (20, 20, 22), "brown": (105, 65, 35), "gray": (128, 128, 128),
    "orange": (240, 130, 30),
}  # fmt: skip
OTHER = {"blue": "yellow", "black": "yellow", "gray": "yellow", "green": "red"}
"""What a thing of a colour is repainted in; blue where nothing is said."""
SIZES = ("big", "small", "tall")
RELATIONS = ("left", "right", "behind", "front", "near")
KINDS = {
    "ATTRIBUTE": ("repainted", "impostor", "opposite"),
    "SRM": ("opposite",),
    "LIFT": ("shift",),
    "OPM-TARGET": ("absent", "localisation"),
    "OPM-REF": ("absent",),
    "PRM": ("scores",),
}


@dataclass(frozen=True)
class AskedSentence:
    """A sentence that the clean pipeline answers rightly, with its truth by the clean picture."""

    text: str
    attribute: str
    case: Case
    trace: Trace


@dataclass(frozen=True)
class SentenceOutcome:
    """A fault that caused a failure.

    Attributes
    ----------
    module, kind : str
        As in KINDS.
    text : str
    typed, given : Diagnosis
        With the attributes known by the clean picture, and with only the right answers known.
    """

    module: str
    kind: str
    text: str
    typed: Diagnosis
    given: Diagnosis


def sentences(
    source: Pipeline, context: PreparedFrame, truth: FrameCases, every: int, every_bare: int = 1
) -> Iterator[AskedSentence]:
    """Each so-manieth sentence with an attribute that tells things of one class apart, where it is answered rightly.

    `every_bare` is for those without a relation, of which there are few.
    """
    classes = sorted(set(truth.labels))
    several = [c for c in classes if truth.labels.count(c) > 1]
    ends = [c for c in classes if truth.labels.count(c) == 1]
    for name in several:
        for word in (*COLORS, *SIZES):
            phrases = [f"the {word} {name}"]
            phrases += [f"the {word} {name} {PHRASE[r]} the {end}" for r in RELATIONS for end in ends]
            for text in phrases:
                if share(truth.frame, text) * (every_bare if text == phrases[0] else every) >= 1:
                    continue
                try:
                    trace = source.ask(context, text)
                except InputError:
                    continue
                case = sentence_case(truth, trace, source, context)
                if isinstance(case, str) or len(case.acceptable) == truth.labels.count(name):
                    continue
                if answers_right(trace, truth, case):
                    yield AskedSentence(text, word, case, trace)


def answers_right(trace: Trace, truth: FrameCases, case: Case) -> bool:
    """An acceptable object is answered."""
    if trace.ranking is None:
        return False
    box = trace.objects[trace.ranking.pairs[0].target].bbox
    return bool((iou_2d(box[None], truth.boxes[case.acceptable]) >= HIT).any())


def broken(
    module: str, kind: str, source: Pipeline, context: PreparedFrame, truth: FrameCases, asked: AskedSentence, seed: int
) -> tuple[Pipeline, PreparedFrame, AbstractContextManager[Any]] | None:
    """The pipeline and the frame with one fault, and what has to be patched; None where there is nothing to break."""
    case = asked.case
    if module == "ATTRIBUTE":
        if kind == "opposite":
            return source, context, patch.object(evidence, "attribute_probabilities", _opposite)
        if asked.attribute not in COLORS:
            return None
        others = truth.alike[case.target_object] & ~np.isin(np.arange(len(truth.labels)), case.acceptable)
        color = OTHER.get(asked.attribute, "blue") if kind == "repainted" else asked.attribute
        chosen = case.acceptable if kind == "repainted" else np.flatnonzero(others)
        return source, painted(context, truth.numbers[chosen], COLORS[color]), nullcontext()
    if module in ("SRM", "OPM-REF") and not case.relation:
        return None
    bare = replace(case, target=truth.labels[case.target_object])
    found = plant(module, kind, source, context, truth, bare, seed)
    return None if found is None else (found.source, found.context, nullcontext())


def painted(context: PreparedFrame, ids: np.ndarray, color: tuple[int, int, int]) -> PreparedFrame:
    """The same frame with some annotated things in one colour, shaded as they are."""
    rgb = context.frame.rgb.copy()
    for annotation in context.frame.annotations:
        if annotation.index in ids and annotation.mask is not None:
            light = rgb[annotation.mask].max(axis=1, keepdims=True) / max(int(rgb[annotation.mask].max()), 1)
            rgb[annotation.mask] = np.clip(np.array(color) * (0.5 + 0.5 * light), 0, 255).astype(np.uint8)
    found = copy.copy(context)
    found.frame = replace(context.frame, rgb=rgb)
    return found


def _opposite(*arguments: Any, **options: Any) -> np.ndarray | None:
    found = _told(*arguments, **options)
    return None if found is None else 1 - found


_told = evidence.attribute_probabilities


def planted_sentence_failures(
    source: Pipeline,
    *,
    kinds: dict[str, tuple[str, ...]] | None = None,
    frames: slice = slice(None),
    every: int = 20,
    every_bare: int = 1,
    seed: int = 0,
) -> Iterator[SentenceOutcome]:
    """Plant every fault (of KINDS) in the sentences of some frames, and give those that cause a failure."""
    clean = clean_source(source, seed)
    for frame_id in clean.dataset.frame_ids[frames]:
        context = prepare_frame(clean.dataset, clean.dataset.load(frame_id), clean.config.lift)
        truth = annotated_truth(context, clean)
        assert truth is not None
        for asked in sentences(clean, context, truth, every, every_bare):
            for module, ways in (KINDS if kinds is None else kinds).items():
                for kind in ways:
                    found = broken(module, kind, clean, context, truth, asked, seed)
                    if found is None:
                        continue
                    own, view, patched = found
                    with patched:
                        trace = own.ask(view, asked.text)
                        if answers_right(trace, truth, asked.case):
                            continue
                        typed = judge_trace(trace, own, view, truth, case=asked.case)
                        given = judge_sentence(trace, own, view, truth, asked.case.acceptable)
                    assert isinstance(typed, Diagnosis)
                    assert isinstance(given, Diagnosis)
                    yield SentenceOutcome(module, kind, asked.text, typed, given)
