"""The verdict on an answer by what is known of its frame: labels as they were corrected, a run's, or annotations."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from pipeline.answering.ask import Trace
from pipeline.answering.objects import PreparedFrame
from pipeline.answering.opening import Pipeline
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
    """Judges answers about frames of named sources; the truth of the last frame is kept.

    Parameters
    ----------
    runs, labels : mapping of str to Run, to Labels
        What says what is true, by the names of the sources: the labels of a run before others.
    others : mapping of str to Run
        Runs to compare with, by the same names.
    corrected : callable
        Gives the corrected labels of a frame of a source; None where nobody has corrected any.
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
        """Those that say what is true in a source."""
        return self._runs[name].labels if name in self._runs else self._labels.get(name)

    def truth(self, name: str, source: Pipeline, context: PreparedFrame) -> FrameCases | None:
        """What is true in a frame: by the labels of its source as they were corrected by now, else by its annotations.

        None where nothing is known of it.

        Raises
        ------
        InputError
            The labels cannot be read.
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
        """What labels say of a frame; None where there are none, or none that can be read."""
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
        """The verdict on an answer, why there can be none, or None where nothing is known of its frame.

        Parameters
        ----------
        name : str
            Of the source by whose truth it is judged.
        source : Pipeline
            What has answered: the source, or a run to compare with.
        context : PreparedFrame
        trace : Trace
        expression : str, optional
            The id of the labelled expression that was asked.
        rank : RankConfig, optional
            The weights of an edited trace.
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
        """`judge` of a labelled expression that could not be asked, and why it could not; None of any other one."""
        try:
            truth = self.truth(name, source, context)
            known = self.known(name, context.frame.id, truth, expression)
            if truth is None or known["case"] is None:
                return None
            return judge_refused(source, context, truth, known.pop("case"), problem, **known)
        except InputError as error:
            return str(error)

    def known(self, name: str, frame: str, truth: FrameCases | None, expression: str | None) -> dict[str, Any]:
        """What a run knows of a labelled expression: its case, mark and confidence, as arguments of `judge_trace`."""
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
        """What the run to compare with answers now, with its verdict by the same truth; None where there is none."""
        run = self._others.get(name)
        if run is None:
            return None
        try:
            if run.source.config.lift != context.config:
                context = PreparedFrame(context.frame, run.source.config.lift)
            trace = run.source.ask(context, text)
        except InputError as error:
            return OtherAnswer(run.name, None, error=str(error))
        return OtherAnswer(run.name, trace, self.judge(name, run.source, context, trace, expression))
