"""Sentences that people wrote, each with what is right: answered one by one and judged, without labels."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np

from pipeline.answering.answer_words import best_pair, holds, pair_words, why_no_answer, words_of_answer
from pipeline.answering.ask import Trace
from pipeline.answering.json_records import expression_record, present
from pipeline.answering.objects import PreparedFrame, SceneObject
from pipeline.answering.pipeline import Pipeline
from pipeline.diagnosis.answer import diagnosis_record
from pipeline.diagnosis.asking import judge_sentence, truth_or_reason
from pipeline.diagnosis.verdict import Diagnosis
from pipeline.evaluation.sentence_files import Sentence, SentenceFile, of_line
from pipeline.geometry.boxes import Box3D
from pipeline.geometry.viewer import ViewerAxes
from pipeline.labels.cases import FrameCases
from pipeline.language.unreadable import why_unread, why_unused
from pipeline.system.errors import InputError, ServerError, require

Outcome = Literal["CORRECT", "PARSE", "REFUSED", "WRONG"]


@dataclass(frozen=True)
class Judged:
    """What became of a sentence."""

    sentence: Sentence
    # outcome: CORRECT: the right object, several that fit equally well and are all right, or a refusal where nothing is
    # right. PARSE: not read as it is. REFUSED: read, and yet no answer. WRONG: an answer that is not right.
    outcome: Outcome
    # detail: of PARSE WORDS, GRAMMAR, UNSUPPORTED; of REFUSED MISSING (a name was not found), TIED (several things
    # fit), DEGENERATE (too few different objects); of WRONG OBJECT, or NOTHING where a refusal would have been right
    detail: str | None
    # answered: an object was given. The nearest one that is told with "no such pair" counts, save where nothing is
    # right.
    answered: bool
    reason: str | None = None  # why there was no answer
    text: str | None = None  # the answer in words
    entry: SceneObject | None = None  # the object that answers
    trace: Trace | None = None  # None where it could not be asked
    # diagnosis: which module failed, by the frame's annotations and what is right; None where that cannot be told
    diagnosis: Diagnosis | None = None
    unjudged: str | None = None  # why it cannot
    # iou_3d: of a published benchmark: of the answer's 3D box with that of the annotation that is right, by `acc_iou`
    iou_3d: float | None = None

    @property
    def verdict(self) -> str | None:
        """Verdict of the diagnosis; PARSE for an unread sentence."""
        if self.outcome == "PARSE":
            return "PARSE"
        return None if self.diagnosis is None else self.diagnosis.verdict

    @property
    def read(self) -> bool:
        """The sentence was read, or rightly refused."""
        return self.outcome != "PARSE"

    @property
    def right(self) -> bool:
        return self.outcome == "CORRECT"

    def record(self) -> dict[str, Any]:
        """Line of `sentences.jsonl`; "answer" is the given object, or the nearest."""
        s, entry = self.sentence, self.entry
        answer = (
            None
            if entry is None
            else {
                "label": entry.label,
                "object": entry.id if entry.id >= 0 else None,
                "score": round(float(entry.score), 6),
                "bbox": np.round(entry.bbox.astype(float), 2).tolist(),
                "text": self.text,
                "holds": self.trace is not None and holds(self.trace),
            }
        )
        return {
            "line": s.line,
            "frame": s.frame,
            "sentence": s.text,
            "kind": s.kind,
            **present(targets=s.targets, points=s.points, boxes=s.boxes),
            "read": self.read,
            "answered": self.answered,
            "right": self.right,
            "outcome": self.outcome,
            "detail": self.detail,
            "reason": self.reason,
            "answer": answer,
            "expression": None if self.trace is None else expression_record(self.trace.query),
            "verdict": None if self.diagnosis is None else diagnosis_record(self.diagnosis),
            **present(verdict_reason=self.unjudged, id=s.id or None, iou_3d=self.iou_3d),
        }


def judge_sentences(
    source: Pipeline, asked: SentenceFile, progress: Callable[[int, int], None] | None = None
) -> tuple[Judged, ...]:
    """Every sentence answered and judged, in the order of the file; `progress` is told (done, in all).

    Raises InputError: a frame cannot be used, or has no annotation of an index that a sentence names.
    """
    source.needed_detector()
    found: list[Judged] = []
    by_frame: dict[str, list[Sentence]] = {}
    for sentence in asked.sentences:
        by_frame.setdefault(sentence.frame, []).append(sentence)
    for frame, sentences in by_frame.items():
        try:
            context = source.prepare(frame)
        except InputError as error:
            raise of_line(sentences[0].line, error, asked.path) from error
        truth: FrameCases | str | None = None
        for n, sentence in enumerate(sentences):
            one = _judged(source, context, sentence, asked.path)
            if n == 0:
                truth = truth_or_reason(source, context, None)
            if asked.published:
                one = replace(one, iou_3d=_published_iou(one, context))
            found.append(_diagnosed(one, source, context, truth))
            if progress is not None:
                progress(len(found), len(asked.sentences))
    return tuple(sorted(found, key=lambda j: j.sentence.line))


def _judged(source: Pipeline, context: PreparedFrame, sentence: Sentence, path: Path) -> Judged:
    right = _right_boxes(context, sentence, path)
    try:
        trace = source.ask(context, sentence.text)
    except ServerError:
        raise
    except InputError as error:
        return _refused(sentence, str(error), "PARSE", why_unread(error))
    best = best_pair(trace)
    if best is None:
        reason, unused = why_no_answer(trace), why_unused(trace.query)
        tied = [trace.objects[k] for k in trace.tied]
        if tied and not sentence.nothing and all(sentence.accepts(o, right, trace.exact) for o in tied):
            # "A chair": whichever of those that are named is meant, it is right.
            return Judged(sentence, "CORRECT", None, True, None, reason, tied[0], trace)
        if trace.missing:
            outcome, detail = "REFUSED", "MISSING"
        elif unused is not None:
            outcome, detail = "PARSE", unused
        else:
            outcome, detail = "REFUSED", "TIED" if len(trace.tied) > 1 else "DEGENERATE"
        return _refused(sentence, reason, outcome, detail, trace)
    entry, answer = trace.objects[best.target], words_of_answer(trace, trace.name)
    text = answer.sentence(pair_words(trace, best, trace.name))
    if sentence.nothing and not best.holds:
        return Judged(sentence, "CORRECT", None, False, text, text, entry, trace)
    correct = sentence.accepts(entry, right, trace.exact)
    detail = None if correct else "NOTHING" if sentence.nothing else "OBJECT"
    return Judged(sentence, "CORRECT" if correct else "WRONG", detail, True, None, text, entry, trace)


def acc_iou(answer: Box3D | None, right: Sequence[Box3D], viewer: ViewerAxes) -> float:
    """Best IoU of a box with the right boxes, all upright along the viewer's axes; 0 without an answer."""
    if answer is None or not right:
        return 0.0
    corners = [box.corners @ viewer.R_level_camera.T for box in (answer, *right)]
    lo, hi = (np.array([f(c, axis=0) for c in corners]) for f in (np.min, np.max))
    both = np.prod(np.maximum(np.minimum(hi[0], hi[1:]) - np.maximum(lo[0], lo[1:]), 0), axis=1)
    volumes = np.prod(hi - lo, axis=1)
    return float((both / np.maximum(volumes[0] + volumes[1:] - both, 1e-12)).max())


def _published_iou(one: Judged, context: PreparedFrame) -> float | None:
    """IoU of the published metric; None without a right 3D box."""
    right = [a.box for a in context.frame.annotations if a.index in (one.sentence.targets or ()) and a.box is not None]
    return acc_iou(None if one.entry is None else one.entry.box, right, context.viewer) if right else None


def _diagnosed(one: Judged, source: Pipeline, context: PreparedFrame, truth: FrameCases | str | None) -> Judged:
    """Add the failed module, if the sentence was read and something is right."""
    if one.trace is None or one.outcome == "PARSE" or one.sentence.nothing:
        return one
    if not isinstance(truth, FrameCases):
        return replace(one, unjudged=truth or "the frame has no annotations")
    if one.detail == "TIED":
        return replace(one, unjudged="several things fit equally well, and none was answered")
    right = one.sentence.among(truth)
    if not len(right):
        return replace(one, unjudged="no annotated object is what is right")
    try:
        found = judge_sentence(one.trace, source, context, truth, right)
    except InputError as error:
        found = str(error)
    if isinstance(found, str):
        return replace(one, unjudged=found)
    if found.correct != one.right:
        # A point in a box that overlaps no annotation by half, or the other way round.
        return replace(one, unjudged="by the annotations the answer is judged otherwise than by what the file says")
    return replace(one, diagnosis=found)


def _refused(
    sentence: Sentence, reason: str | None, outcome: Outcome, detail: str, trace: Trace | None = None
) -> Judged:
    if sentence.nothing:
        return Judged(sentence, "CORRECT", None, False, reason, trace=trace)
    return Judged(sentence, outcome, detail, False, reason, trace=trace)


def _right_boxes(context: PreparedFrame, sentence: Sentence, path: Path) -> np.ndarray:
    """(T, 4) float64: boxes of the acceptable annotations; InputError for an unknown index."""
    boxes = {a.index: a.bbox for a in context.frame.annotations}
    missing = [k for k in sentence.targets or () if k not in boxes]
    require(
        not missing,
        f"line {sentence.line}: frame {sentence.frame} has no annotation of this index",
        got=missing[:1],
        expected=f"one of {', '.join(map(str, sorted(boxes)))}" if boxes else "points or boxes: it has none at all",
        path=path,
    )
    return np.array([boxes[k] for k in sentence.targets or ()], np.float64).reshape(-1, 4)
