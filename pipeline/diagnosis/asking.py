"""Questions on frames with the verdict on each answer, where the truth of the frame is known."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

from pipeline.answering.ask import Trace
from pipeline.answering.json_records import trace_record, why_no_answer
from pipeline.answering.objects import PreparedFrame, SceneObject
from pipeline.answering.opening import FrameUnusable, Pipeline, Skipped, contexts, skip_or_raise
from pipeline.answering.pair_table import ScoredPair
from pipeline.answering.ranking import RankConfig
from pipeline.answering.told_answer import holds, told
from pipeline.diagnosis.live import Judgement, annotated_truth, judge_trace, judgement_record, labelled_truth
from pipeline.labels.cases import FrameCases
from pipeline.labels.reading import Labels
from pipeline.language.lexicon import wording
from pipeline.system.errors import InputError


class Origin(Protocol):
    """What answered: it can answer under edits, and may have a screen."""

    def what_if(self, answer: Answer, edits: Mapping[str, Any]) -> Answer: ...

    def view(self, what: Any, **options: Any) -> Any: ...


@dataclass(frozen=True)
class Answer:
    """An answer, with what is known of it; positions in `pairs` are those in `objects`.

    Attributes
    ----------
    trace : Trace
        Every stage's input and output.
    judgement : Judgement or None
        None where there is no verdict.
    unjudged : str or None
        Why there is a truth and no verdict on this answer; None also where no truth is known at all.
    origin : Origin or None
        What answered it, where one is asked from Python: edits and the page need it.
    edits : mapping or None
        What it was answered under, as JSON; None for none.
    """

    trace: Trace
    judgement: Judgement | None = None
    unjudged: str | None = None
    origin: Origin | None = None
    edits: Mapping[str, Any] | None = None

    def __repr__(self) -> str:
        return f"<Answer {self.text!r} on {self.trace.frame.id!r}: {self.sentence}; {self.verdict or 'no verdict'}>"

    @property
    def text(self) -> str:
        """The expression as it was asked."""
        return self.trace.query.text

    @property
    def objects(self) -> tuple[SceneObject, ...]:
        """All that was detected for the names of the expression, lifted."""
        return self.trace.objects

    @property
    def pairs(self) -> tuple[ScoredPair, ...]:
        """All candidate pairs, the best first; empty where a name was not found."""
        return () if self.trace.ranking is None or self.trace.ranking.degenerate else self.trace.ranking.pairs

    @property
    def target(self) -> SceneObject | None:
        """What the answer is; None where there is none."""
        return self.objects[self.pairs[0].target] if self.pairs else None

    @property
    def reference(self) -> SceneObject | None:
        """What it stands in relation to; of "between" the first end."""
        number = self.pairs[0].reference if self.pairs else None
        return None if number is None else self.objects[number]

    @property
    def holds(self) -> bool:
        """There is an answer, and it stands in every relation that was asked."""
        return holds(self.trace)

    @property
    def relation_probability(self) -> float | None:
        """That the best pair stands in what was asked, of several relations in the weakest; None without a pair."""
        return self.pairs[0].relation_probability if self.pairs else None

    @property
    def sentence(self) -> str:
        """The answer in words, or why there is none."""
        if not self.pairs:
            return why_no_answer(self.trace) or "no answer"
        best, asked = self.pairs[0], self.trace.asked
        ends = " and ".join(self.trace.name(k) for k in (best.reference, best.second_reference) if k is not None)
        phrase = wording(asked.relation, inverse=asked.inverse)
        return told(self.trace, self.trace.name).sentence(f"{self.trace.name(best.target)} {phrase} {ends}")

    @property
    def verdict(self) -> str | None:
        """CORRECT, or the module that failed; None where nothing says what is true."""
        return None if self.judgement is None else self.judgement.diagnosis.verdict

    @property
    def why(self) -> str | None:
        """The verdict in words with the smallest change that would mend it; else why there is none, if it is known."""
        return self.unjudged if self.judgement is None else self.judgement.said

    def record(self) -> dict[str, Any]:
        """The whole of `ask --json` as plain values."""
        return judged_record(self)

    def what_if(self, edits: Mapping[str, Any]) -> Answer:
        """The answer under edits, written as for `whatif --edits`; its verdict is by the same truth.

        Raises
        ------
        InputError
            Edits that cannot be read, or an answer of another origin than `open`.
        """
        return self._origin().what_if(self, edits)

    def show(self, **options: Any) -> Any:
        """Open this answer in the page; `options` as for `spatialviz.show`."""
        return self._origin().view(self, **options)

    def _origin(self) -> Origin:
        if self.origin is None:
            raise InputError("this answer does not know what answered it", expected="one that `ask` of `open` gave")
        return self.origin


def known_truth(source: Pipeline, context: PreparedFrame, labels: Labels | None = None) -> FrameCases | None:
    """What is true of a frame: by labels where they are given, else by its annotations; None without annotations.

    Raises
    ------
    InputError
        The labels say nothing of the frame or are of another picture, or its annotations cannot be labelled.
    """
    if labels is None:
        return annotated_truth(context, source)
    truth = labelled_truth(context.frame.id, source, labels)
    if truth is None:
        raise InputError(f"the labels say nothing of frame {context.frame.id}", path=labels.root)
    truth.check_picture(context.frame)
    return truth


def ask_and_judge(
    source: Pipeline,
    key: str | int,
    expressions: Sequence[str],
    labels: Labels | None = None,
    skipped: Skipped | None = None,
) -> Iterator[Answer]:
    """Every expression on every frame that `key` means, with verdicts; the truth of a frame is worked out once.

    Parameters
    ----------
    source : Pipeline
    key : str or int
        As for `pipeline.answering.opening.ask_frames`.
    expressions : sequence of str
    labels : Labels, optional
        What says what is true. By default the frame's annotations do.
    skipped : callable, optional
        Told of each broken frame among all frames.

    Raises
    ------
    InputError
        As `pipeline.answering.opening.ask_frames`.
    """
    source.needed_detector()
    for context in contexts(source, key, skipped):
        truth: FrameCases | str | None = None
        try:
            for n, text in enumerate(expressions):
                trace = source.ask(context, text)
                if n == 0:
                    truth = truth_or_reason(source, context, labels)
                yield judged(trace, source, context, truth)
        except FrameUnusable as error:
            skip_or_raise(error, key, context.frame.id, skipped)


def truth_or_reason(source: Pipeline, context: PreparedFrame, labels: Labels | None) -> FrameCases | str | None:
    """`known_truth`, or why it cannot be had."""
    try:
        return known_truth(source, context, labels)
    except InputError as error:
        return str(error)


def judged(
    trace: Trace,
    source: Pipeline,
    context: PreparedFrame,
    truth: FrameCases | str | None,
    rank: RankConfig | None = None,
) -> Answer:
    """A trace as an answer with its verdict, or the reason for none; `rank` are the weights of an edited one."""
    if truth is None:
        return Answer(trace)
    if isinstance(truth, str):
        return Answer(trace, unjudged=truth)
    try:
        judged = judge_trace(trace, source, context, truth, rank=rank)
    except InputError as error:
        judged = str(error)
    return Answer(trace, unjudged=judged) if isinstance(judged, str) else Answer(trace, judged)


def edited_verdicts(
    source: Pipeline,
    context: PreparedFrame,
    before: Trace,
    after: Trace,
    rank: RankConfig,
    labels: Labels | None = None,
) -> tuple[str | None, str | None]:
    """The verdicts on an answer without and with edits, by one truth; None where there is none.

    Parameters
    ----------
    rank : RankConfig
        The weights that `after` was ranked with.
    """
    truth = truth_or_reason(source, context, labels)
    if truth is None or isinstance(truth, str):
        return None, None
    first = judged(before, source, context, truth)
    last = judged(after, source, context, truth, rank)
    return _verdict(first), _verdict(last)


def _verdict(answer: Answer) -> str | None:
    return None if answer.judgement is None else answer.judgement.diagnosis.verdict


def judged_record(answer: Answer) -> dict[str, Any]:
    """The whole of `ask --json`: `trace_record`, and where truth is known "verdict", or null with "verdict_reason"."""
    record = trace_record(answer.trace)
    if answer.judgement is not None:
        record["verdict"] = judgement_record(answer.judgement)
    elif answer.unjudged is not None:
        record |= {"verdict": None, "verdict_reason": answer.unjudged}
    return record
