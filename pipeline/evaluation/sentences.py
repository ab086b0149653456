"""Sentences that people wrote, each with what is right: answered one by one and judged, without labels."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, FiniteFloat, NonNegativeInt, model_validator

from pipeline.answering.answer_words import best_pair, holds, pair_words, told, why_no_answer
from pipeline.answering.ask import Trace
from pipeline.answering.json_records import expression_record, present
from pipeline.answering.objects import PreparedFrame, SceneObject
from pipeline.answering.opening import Pipeline
from pipeline.datasets.base import resolve_frame
from pipeline.diagnosis.answer import diagnosis_record
from pipeline.diagnosis.asking import judge_sentence, truth_or_reason
from pipeline.diagnosis.verdict import Diagnosis
from pipeline.evaluation.published import SUFFIXES, acc_iou, published_sentences
from pipeline.geometry.boxes import iou_2d
from pipeline.labels.cases import HIT, FrameCases
from pipeline.language.unreadable import why_unread, why_unused
from pipeline.system.errors import InputError, ServerError, require
from pipeline.system.reading import checked
from pipeline.system.safe_files import read_bytes

UNSORTED = "unsorted"
"""The kind of a sentence that names none."""
Outcome = Literal["CORRECT", "PARSE", "REFUSED", "WRONG"]
Point = tuple[FiniteFloat, FiniteFloat]
Corners = tuple[FiniteFloat, FiniteFloat, FiniteFloat, FiniteFloat]


class _Line(BaseModel):
    """A line of the file; further keys are let be."""

    model_config = ConfigDict(strict=True, extra="ignore")
    frame: str | NonNegativeInt
    sentence: Annotated[str, Field(pattern=r"\S")]
    kind: str | None = None
    dataset: str | None = None
    targets: tuple[NonNegativeInt, ...] | None = None
    points: tuple[Point, ...] | None = None
    point: Point | None = None
    boxes: tuple[Corners, ...] | None = None

    @model_validator(mode="after")
    def _one_truth(self) -> _Line:
        given = [name for name in ("targets", "points", "point", "boxes") if getattr(self, name) is not None]
        if len(given) != 1:
            raise ValueError(
                f"one of targets, points and boxes says what is right, not {' and '.join(given) or 'none'}"
            )
        if any(x1 <= x0 or y1 <= y0 for x0, y0, x1, y1 in self.boxes or ()):
            raise ValueError("a box is x0, y0, x1, y1 with x0 < x1 and y0 < y1")
        return self


@dataclass(frozen=True)
class Sentence:
    """A sentence with what is right. Of the last three one is given; empty, it says that nothing is right.

    Attributes
    ----------
    line : int
        Of the file, from 1.
    frame : str
        Id of the frame.
    text, kind : str
    targets : tuple of int or None
        Indices of the acceptable annotations.
    points : tuple of (u, v) or None
        Pixels; a box that holds one is right.
    boxes : tuple of (x0, y0, x1, y1) or None
        Pixels; a box that overlaps one by half is right.
    id : str
        Its own in a published benchmark; else empty.
    """

    line: int
    frame: str
    text: str
    kind: str
    targets: tuple[int, ...] | None = None
    points: tuple[Point, ...] | None = None
    boxes: tuple[Corners, ...] | None = None
    id: str = ""

    @property
    def nothing(self) -> bool:
        """Whether nothing is right, so that a refusal is."""
        return not (self.targets or self.points or self.boxes)

    def accepts(self, entry: SceneObject, truth: np.ndarray, exact: bool) -> bool:
        """Whether an object is a right answer.

        Parameters
        ----------
        entry : SceneObject
        truth : (T, 4) float
            Boxes of the acceptable annotations, pixels.
        exact : bool
            The objects are the annotations themselves.
        """
        if self.points is not None:
            x0, y0, x1, y1 = entry.bbox
            return any(bool(x0 <= u < x1 and y0 <= v < y1) for u, v in self.points)
        if self.targets is not None and exact:
            return entry.id in self.targets
        right = truth if self.boxes is None else np.array(self.boxes, np.float64).reshape(-1, 4)
        return bool((iou_2d(entry.bbox[None], right) >= HIT).any())

    def among(self, truth: FrameCases) -> np.ndarray:
        """(K,) int64: indices of the annotated objects that are right; of several under a point the smallest."""
        if self.targets is not None:
            return np.flatnonzero(np.isin(truth.numbers, self.targets))
        if self.boxes is not None:
            right = np.array(self.boxes, np.float64).reshape(-1, 4)
            return np.flatnonzero((iou_2d(truth.boxes, right) >= HIT).any(axis=1))
        x0, y0, x1, y1 = truth.boxes.T
        area = (x1 - x0) * (y1 - y0)
        under = [(x0 <= u) & (u < x1) & (y0 <= v) & (v < y1) for u, v in self.points or ()]
        return np.unique([int(np.where(hit, area, np.inf).argmin()) for hit in under if hit.any()]).astype(np.int64)


@dataclass(frozen=True)
class SentenceFile:
    """The sentences of a file on one dataset, in their order; `skipped` counts those on each other dataset.

    `published` says that it is a benchmark in its own form, which has its own metric.
    """

    path: Path
    sentences: tuple[Sentence, ...]
    skipped: dict[str, int]
    published: bool = False


def read_sentence_file(path: Path, source: Pipeline, name: str | None = None) -> SentenceFile:
    """The sentences of a file of JSON lines that are about a dataset: those that name it, and those that name none; or
    of a benchmark as it is published (`pipeline.evaluation.published`), told by its ending.

    Parameters
    ----------
    path : Path
    source : Pipeline
    name : str, optional
        The dataset's name; by default that of its folder.

    Raises
    ------
    InputError
        The file or a line of it cannot be read, a frame is not there, or no sentence is about this dataset.
    """
    if path.suffix in SUFFIXES:
        rows, left_out = published_sentences(path, source.dataset)
        sentences = tuple(
            Sentence(r.line, r.frame, r.text, r.kind, None if r.target is None else (r.target,), None,
                     None if r.box is None else (r.box,), r.id) for r in rows
        )  # fmt: skip
        return SentenceFile(path, sentences, left_out, published=True)
    name = name or source.dataset.root.resolve().name
    try:
        lines = read_bytes(path, "text").removeprefix(b"\xef\xbb\xbf").split(b"\n")
    except OSError as error:
        raise InputError("the sentences cannot be read", got=error.strerror, path=path) from error
    found: list[Sentence] = []
    skipped: Counter[str] = Counter()
    for number, text in enumerate(lines, start=1):
        if not text.strip():
            continue
        line = checked(_Line.model_validate_json, text, f"line {number} cannot be used, at {{}}", path)
        if line.dataset is not None and line.dataset != name:
            skipped[line.dataset] += 1
            continue
        try:
            frame = resolve_frame(source.dataset, line.frame)
        except InputError as error:
            raise _of_line(number, error, path) from error
        points = line.points if line.point is None else (line.point,)
        text_of, kind = line.sentence.strip(), (line.kind or "").strip() or UNSORTED
        found.append(Sentence(number, frame, text_of, kind, line.targets, points, line.boxes))
    others = ", ".join(f"{n} of {other!r}" for other, n in skipped.items())
    require(found, "the file has no sentence of this dataset", got=others or None, expected=repr(name), path=path)
    return SentenceFile(path, tuple(found), dict(skipped))


def _of_line(number: int, error: InputError, path: Path) -> InputError:
    return InputError(f"line {number}: {error}", path=path)


@dataclass(frozen=True)
class Judged:
    """What became of a sentence.

    Attributes
    ----------
    sentence : Sentence
    outcome : str
        CORRECT: the right object, several that fit equally well and are all right, or a refusal where nothing is
        right. PARSE: not read as it is. REFUSED: read, and yet no answer. WRONG: an answer that is not right.
    detail : str or None
        Of PARSE WORDS, GRAMMAR, UNSUPPORTED; of REFUSED MISSING (a name was not found), TIED (several things fit),
        DEGENERATE (too few different objects); of WRONG OBJECT, or NOTHING where a refusal would have been right.
    answered : bool
        An object was given. The nearest one that is told with "no such pair" counts, save where nothing is right.
    reason : str or None
        Why there was no answer.
    text : str or None
        The answer in words.
    entry : SceneObject or None
        The object that answers.
    trace : Trace or None
        None where it could not be asked.
    diagnosis : Diagnosis or None
        Which module failed, by the frame's annotations and what is right; None where that cannot be told.
    unjudged : str or None
        Why it cannot.
    iou_3d : float or None
        Of a published benchmark: of the answer's 3D box with that of the annotation that is right, by `acc_iou`.
    """

    sentence: Sentence
    outcome: Outcome
    detail: str | None
    answered: bool
    reason: str | None = None
    text: str | None = None
    entry: SceneObject | None = None
    trace: Trace | None = None
    diagnosis: Diagnosis | None = None
    unjudged: str | None = None
    iou_3d: float | None = None

    @property
    def verdict(self) -> str | None:
        """PARSE where it was not read, else that of the diagnosis."""
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
        """A line of `sentences.jsonl`; "answer" is the object that was given, or told as the nearest."""
        s, entry = self.sentence, self.entry
        answer = None if entry is None else {
            "label": entry.label, "object": entry.id if entry.id >= 0 else None, "score": round(float(entry.score), 6),
            "bbox": np.round(entry.bbox.astype(float), 2).tolist(), "text": self.text,
            "holds": self.trace is not None and holds(self.trace),
        }  # fmt: skip
        return {
            "line": s.line, "frame": s.frame, "sentence": s.text, "kind": s.kind,
            **present(targets=s.targets, points=s.points, boxes=s.boxes),
            "read": self.read, "answered": self.answered, "right": self.right, "outcome": self.outcome,
            "detail": self.detail, "reason": self.reason, "answer": answer,
            "expression": None if self.trace is None else expression_record(self.trace.query),
            "verdict": None if self.diagnosis is None else diagnosis_record(self.diagnosis),
            **present(verdict_reason=self.unjudged, id=s.id or None, iou_3d=self.iou_3d),
        }  # fmt: skip


def judge_sentences(
    source: Pipeline, asked: SentenceFile, progress: Callable[[int, int], None] | None = None
) -> tuple[Judged, ...]:
    """Every sentence answered and judged, in the order of the file; `progress` is told (done, in all).

    Raises
    ------
    InputError
        A frame cannot be used, or has no annotation of an index that a sentence names.
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
            raise _of_line(sentences[0].line, error, asked.path) from error
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
    entry, answer = trace.objects[best.target], told(trace, trace.name)
    text = answer.sentence(pair_words(trace, best, trace.name))
    if sentence.nothing and not best.holds:
        return Judged(sentence, "CORRECT", None, False, text, text, entry, trace)
    correct = sentence.accepts(entry, right, trace.exact)
    detail = None if correct else "NOTHING" if sentence.nothing else "OBJECT"
    return Judged(sentence, "CORRECT" if correct else "WRONG", detail, True, None, text, entry, trace)


def _published_iou(one: Judged, context: PreparedFrame) -> float | None:
    """None where what is right has no 3D box."""
    right = [a.box for a in context.frame.annotations if a.index in (one.sentence.targets or ()) and a.box is not None]
    return acc_iou(None if one.entry is None else one.entry.box, right, context.viewer) if right else None


def _diagnosed(one: Judged, source: Pipeline, context: PreparedFrame, truth: FrameCases | str | None) -> Judged:
    """With which module failed, where the sentence was read and there is something right."""
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
    """(T, 4) float64: boxes of the acceptable annotations; InputError where there is none of an index."""
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
