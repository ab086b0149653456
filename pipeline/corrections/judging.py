"""The verdict on an answer by what is known of its frame: labels as they were corrected, a run's, or annotations."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from pipeline.answering.ask import Trace
from pipeline.answering.objects import PreparedFrame
from pipeline.answering.pipeline import Pipeline
from pipeline.answering.ranking import RankConfig
from pipeline.corrections.journal.effective_frame import EffectiveFrame
from pipeline.corrections.scene import answered_case, effective_mark, effective_truth, withdrawn_by
from pipeline.diagnosis.asking import annotated_truth, judge_refused, judge_trace, labelled_case, labelled_truth
from pipeline.diagnosis.verdict import Diagnosis
from pipeline.diagnosis.whatif.answer_view import OtherAnswer
from pipeline.evaluation.run_folder import Run
from pipeline.labels.cases import FrameCases
from pipeline.labels.reading import Labels
from pipeline.system.errors import InputError


class Judge:
    """Judgement of answers about frames of named sources; the truth of the last frame is kept.

    `runs` and `labels` are by source, labels of a run first; `others` are runs to compare with; `corrected` gives a
    frame's corrected labels, or None.
    """

    def __init__(
        self,
        runs: Mapping[str, Run],
        labels: Mapping[str, Labels],
        others: Mapping[str, Run],
        corrected: Callable[[str, str], EffectiveFrame | None],
    ) -> None:
        self._runs, self._labels, self._others, self._corrected = runs, labels, others, corrected
        self._kept: tuple[tuple[str, str, bytes], EffectiveFrame | None, FrameCases | None] | None = None

    def labels(self, name: str) -> Labels | None:
        """Labels with the truth of a source."""
        return self._runs[name].labels if name in self._runs else self._labels.get(name)

    def truth(self, name: str, source: Pipeline, context: PreparedFrame) -> FrameCases | None:
        """Truth of a frame by corrected labels, else by annotations; None for neither; InputError for unreadable
        labels.
        """
        # Annotations are true under the up vector that is known now.
        key, frame = (name, context.frame.id, context.viewer.up.tobytes()), context.frame.id
        corrected, labels = self._corrected(name, frame), self.labels(name)
        if self._kept is None or self._kept[0] != key or self._kept[1] is not corrected:
            if corrected is not None:
                found = effective_truth(corrected)
            else:
                found = None if labels is None else labelled_truth(frame, source, labels)
            self._kept = key, corrected, annotated_truth(context, source) if found is None else found
        return self._kept[2]

    def labelled(self, name: str, source: Pipeline, context: PreparedFrame) -> FrameCases | None:
        """Truth of a frame by labels; None for no readable labels."""
        try:
            return self.truth(name, source, context) if self.labels(name) is not None else None
        except InputError:
            return None

    def judge(
        self,
        name: str,
        source: Pipeline,
        context: PreparedFrame,
        trace: Trace,
        expression: str | None = None,
        rank: RankConfig | None = None,
    ) -> Diagnosis | str | None:
        """Verdict on an answer, the reason why none is possible, or None without truth.

        `name` is the source of the truth, `source` what has answered, `expression` the id of the labelled one that was
        asked, `rank` the weights of an edited trace.
        """
        try:
            truth, corrected = self.truth(name, source, context), self._corrected(name, context.frame.id)
            if truth is None:
                return None
            rejected = None if corrected is None or expression is None else withdrawn_by(corrected, expression)
            if rejected is not None:
                return rejected
            known = self.known(name, context.frame.id, truth, expression)
            case = known["case"] or labelled_case(truth, trace.query.text)
            if corrected is not None and case is not None:
                known["case"] = answered_case(corrected, truth, case, trace)
            return judge_trace(trace, source, context, truth, rank=rank, **known)
        except InputError as error:
            return str(error)

    def judge_refused(
        self, name: str, source: Pipeline, context: PreparedFrame, problem: InputError, expression: str | None
    ) -> Diagnosis | str | None:
        """Verdict on a labelled expression beyond asking; None for any other."""
        try:
            truth = self.truth(name, source, context)
            known = self.known(name, context.frame.id, truth, expression)
            if truth is None or known["case"] is None:
                return None
            return judge_refused(source, context, truth, known.pop("case"), problem, **known)
        except InputError as error:
            return str(error)

    def known(self, name: str, frame: str, truth: FrameCases | None, expression: str | None) -> dict[str, Any]:
        """Case, mark and confidence of a labelled expression in a run, as arguments of `judge_trace`."""
        run, corrected = self._runs.get(name), self._corrected(name, frame)
        mark = None if run is None else run.spec.marks.get((frame, expression or ""))
        if corrected is not None and expression is not None:
            mark = effective_mark(corrected, expression, mark)
        return {
            "case": None if truth is None else next((c for c in truth.cases if c.id == expression), None),
            "mark": mark,
            "confidence": None if run is None else run.spec.confidence,
        }

    def other(self, name: str, context: PreparedFrame, text: str, expression: str | None = None) -> OtherAnswer | None:
        """Answer and verdict of the run to compare with, by the same truth; None for none."""
        run = self._others.get(name)
        if run is None:
            return None
        try:
            if run.source.config.lift != context.config:
                context = PreparedFrame(context.frame, run.source.config.lift)
            trace = run.source.ask(context, text)
        except InputError as error:
            return OtherAnswer(text, problem=str(error), name=run.name)
        found = self.judge(name, run.source, context, trace, expression)
        if isinstance(found, str):
            return OtherAnswer(text, trace, unjudged=found, name=run.name)
        return OtherAnswer(text, trace, diagnosis=found, name=run.name)
