"""Sentences that people wrote, each with what is right: answered one by one and judged without labels, and what became
of them: shares with intervals by kind, classes of failure, a line for each."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cached_property
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np

from pipeline.answering.answer_words import best_pair, holds, pair_words, why_no_answer, words_of_answer
from pipeline.answering.ask import Trace
from pipeline.answering.json_records import expression_record, present
from pipeline.answering.objects import PreparedFrame, SceneObject
from pipeline.answering.pipeline import Pipeline
from pipeline.diagnosis.answer import diagnosis_record
from pipeline.diagnosis.asking import judge_sentence, truth_or_reason
from pipeline.diagnosis.oracles import shown_oracle
from pipeline.diagnosis.verdict import VERDICTS, Diagnosis
from pipeline.evaluation.sentence_files import ACC_AT, Sentence, SentenceFile, of_line, read_sentence_file
from pipeline.evaluation.summary import Deltas, oracle_deltas
from pipeline.geometry.boxes import Box3D
from pipeline.geometry.viewer import ViewerAxes
from pipeline.labels.cases import FrameCases
from pipeline.language.chain import why_unread, why_unused
from pipeline.metrics.intervals import Estimate, share_estimate
from pipeline.metrics.tables import Cell, Row, Table
from pipeline.system.errors import InputError, ServerError, require
from pipeline.system.frozen import dataclass
from pipeline.system.whole_files import check_target, staged_folder, text_file

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
    return acc_iou(None if one.entry is None else one.entry.size_box, right, context.viewer) if right else None


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


FILE = "sentences.jsonl"
ACC_NOTE = (
    "The share of answers whose 3D box overlaps the right one's by more than that, both upright along the viewer's "
    "axes; refusals count as wrong. Sentences whose right object has no 3D box are left out."
)


SHARES = {
    "read": "read",
    "answered": "answered",
    "right": "right",
    "refused_rightly": "refused rightly",
    "told": "refused of not right",
}
"""Shares and their columns in the table: of all sentences; `refused_rightly` of those where nothing is right; `told`,
refused with a reason, of those that are not right."""
Shares = dict[str, "Estimate | int"]
"""How many `sentences`, and each of SHARES."""


@dataclass(frozen=True)
class SentenceReport:
    """A judged file."""

    asked: SentenceFile
    judged: tuple[Judged, ...]

    @cached_property
    def overall(self) -> Shares:
        """Shares of all sentences."""
        return _shares(self.judged)

    @cached_property
    def kinds(self) -> dict[str, Shares]:
        """Shares by kind, in the order in which the kinds first stand in the file."""
        kinds = dict.fromkeys(j.sentence.kind for j in self.judged)
        return {kind: _shares([j for j in self.judged if j.sentence.kind == kind]) for kind in kinds}

    @cached_property
    def failures(self) -> dict[tuple[str, str | None], int]:
        """Count failures by (outcome, detail), in the order of Outcome, the most frequent first."""
        found = Counter((j.outcome, j.detail) for j in self.judged if not j.right)
        return dict(sorted(found.items(), key=lambda f: (get_args(Outcome).index(f[0][0]), -f[1], str(f[0][1]))))

    @property
    def verdicts(self) -> dict[str, int]:
        """Count sentences by verdict, in the order of VERDICTS; verdicts without any are left out."""
        counts = Counter(j.verdict for j in self.judged)
        return {name: counts[name] for name in VERDICTS if counts[name]}

    @cached_property
    def deltas(self) -> Deltas | None:
        """Costs of modules over the diagnosed sentences, ATTRIBUTE where any has attributes; None without any."""
        found = [(d, d.right_with, j.sentence.frame) for j in self.judged if (d := j.diagnosis) is not None]
        if not found:
            return None
        oracles = max((d.oracles for d, *_ in found), key=len)
        # Without attributes the oracle of attributes changes nothing.
        right = [
            with_ | (with_ << len(d.margins) if len(d.oracles) < len(oracles) else 0)
            for d, with_, _ in found
            if with_ is not None
        ]
        frames = [frame for _, with_, frame in found if with_ is not None]
        return oracle_deltas(np.array(right, np.int64), np.array(frames), oracles=oracles)

    @property
    def tables(self) -> tuple[Table, ...]:
        """Shares by kind and over all, failures, verdicts, costs of each module (possibly empty); for a published
        benchmark also the benchmark's metric."""
        note = (
            "In percent, with Wilson's 95 % intervals, each sentence for itself. Read: also what was refused rightly. "
        )
        note += "Refused rightly: of the sentences for which nothing is right."
        rows = [Row(name, tuple(shares.values())) for name, shares in (*self.kinds.items(), ("all", self.overall))]
        total = len(self.judged)
        failed = [Row(": ".join(filter(None, name)), (count, count / total)) for name, count in self.failures.items()]
        judged, costs = sum(self.verdicts.values()), self.deltas
        verdicts = [Row(name, (count, count / judged)) for name, count in self.verdicts.items()]
        unjudged = f"{total - judged} have none: nothing is right, several things tie, or no truth is to be had."
        shapley = (
            "Points gained with a module replaced by the truth, over the sentences that were diagnosed: by it alone, "
            "and its fair share over all orders of replacing. The second column adds up to 100."
        )
        modules = () if costs is None else _costs(costs)
        metric = tuple(Row(name, cells) for name, cells in self.published.items())
        columns = ("sentences", *(f"Acc@{at:g}" for at in ACC_AT))
        return (
            Table("sentences", "Sentences", ("sentences", *SHARES.values()), tuple(rows), note),
            Table("failures", "Failures", ("sentences", "share"), tuple(failed)),
            Table("verdicts", "Verdicts", ("sentences", "share"), tuple(verdicts), unjudged),
            Table("oracles", "What each module costs", ("alone", "Shapley"), modules, shapley),
            *([Table("published", "As the benchmark publishes it", columns, metric, ACC_NOTE)] if metric else []),
        )

    @cached_property
    def published(self) -> dict[str, tuple[Any, ...]]:
        """Acc@IoU at each of ACC_AT and the number of right 3D boxes, by kind and "all", of a published benchmark."""
        rows = [(j.sentence.kind, j.iou_3d) for j in self.judged if j.iou_3d is not None]
        found = {}
        for kind in dict.fromkeys([k for k, _ in rows] + ["all"] * bool(rows)):
            iou = np.array([v for k, v in rows if kind in (k, "all")])
            found[kind] = len(iou), *(share_estimate(iou > at, np.arange(len(iou))) for at in ACC_AT)
        return found

    def record(self) -> dict[str, Any]:
        """Convert to JSON: `eval --sentences --json`."""
        return {
            "file": str(self.asked.path),
            "skipped": self.asked.skipped,
            "all": _record(self.overall),
            "kinds": {kind: _record(shares) for kind, shares in self.kinds.items()},
            "verdicts": self.verdicts,
            "oracles": None if self.deltas is None else self.deltas.record(),
            "published": {
                kind: {"sentences": n, **{f"acc@{at:g}": c.record() for at, c in zip(ACC_AT, cells, strict=True)}}
                for kind, (n, *cells) in self.published.items()
            },
            "failures": [
                {"outcome": outcome, "detail": detail, "count": n, "share": n / len(self.judged)}
                for (outcome, detail), n in self.failures.items()
            ],
        }


def _costs(found: Deltas) -> tuple[Row, ...]:
    lines: list[tuple[str, tuple[Cell, Cell]]] = [("as answered", (None, float(found.value[0])))]
    lines += [(shown_oracle(name), (found.single[name], found.shapley[name])) for name in found.single]
    lines.append(("residual", (None, float(1 - found.value[-1]))))
    return tuple(Row(name, cells) for name, cells in lines)


def _record(shares: Shares) -> dict[str, Any]:
    return {name: value if isinstance(value, int) else value.record() for name, value in shares.items()}


def _shares(judged: Sequence[Judged]) -> Shares:
    def share(holds: Callable[[Judged], bool], of: Callable[[Judged], bool] = lambda j: True) -> Estimate:
        counted = [j for j in judged if of(j)]
        return share_estimate(np.array([holds(j) for j in counted], np.bool_), [j.sentence.frame for j in counted])

    return {
        "sentences": len(judged),
        "read": share(lambda j: j.read),
        "answered": share(lambda j: j.answered),
        "right": share(lambda j: j.right),
        "refused_rightly": share(lambda j: j.right, lambda j: j.sentence.nothing),
        "told": share(lambda j: not j.answered, lambda j: not j.right),
    }


def evaluate_sentences(
    path: Path,
    source: Pipeline,
    *,
    name: str | None = None,
    out: Path | None = None,
    overwrite: bool = False,
    progress: Callable[[int, int], None] | None = None,
) -> SentenceReport:
    """Judge the sentences of a file; with `out`, a folder with a line for each sentence in `sentences.jsonl`.

    Raises InputError: as `read_sentence_file` and `judge_sentences`; or the folder cannot be written. Nothing is left
    of it then.
    """
    if out is not None:
        check_target(out, overwrite=overwrite, mark=FILE)
    asked = read_sentence_file(path, source, name)
    report = SentenceReport(asked, judge_sentences(source, asked, progress))
    if out is not None:
        with staged_folder(out, overwrite=overwrite, mark=FILE) as folder, text_file(folder / FILE) as file:
            file.writelines(json.dumps(j.record(), ensure_ascii=False, allow_nan=False) + "\n" for j in report.judged)
    return report
