"""The verdict on what a client asks, where the truth of its frame is known. The core computes; this only remembers."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from pipeline.answering.ask import Trace
from pipeline.answering.objects import PreparedFrame
from pipeline.answering.opening import Pipeline
from pipeline.answering.ranking import RankConfig
from pipeline.corrections.journal.effective_frame import EffectiveFrame
from pipeline.corrections.scene import answered_case, effective_mark, effective_truth, withdrawn_by
from pipeline.diagnosis.asking import annotated_truth, judge_trace, labelled_case, labelled_truth
from pipeline.diagnosis.verdict import Diagnosis
from pipeline.labels.cases import FrameCases
from pipeline.labels.reading import Labels
from pipeline.system.errors import InputError
from spatialviz.app.context import Shared
from spatialviz.app.state import OtherAnswer


class Judge:
    """Judges traces of one client; the truth of the frame it looked at last is kept.

    Parameters
    ----------
    shared : Shared
    corrected : callable
        Gives the corrected labels of a frame of a source; None where nobody has corrected any.
    """

    def __init__(self, shared: Shared, corrected: Callable[[str, str], EffectiveFrame | None]) -> None:
        self._shared, self._corrected = shared, corrected
        self._kept: tuple[tuple[str, str, bytes], EffectiveFrame | None, FrameCases | None] | None = None

    def labels(self, name: str) -> Labels | None:
        """Those that say what is true in a source: the run's, or those that were named."""
        run = self._shared.runs.get(name)
        return self._shared.labels.get(name) if run is None else run.labels

    def truth(self, name: str, source: Pipeline, context: PreparedFrame) -> FrameCases | None:
        """What is true in a frame: by the run's labels or those that were named, else by the frame's annotations.

        Labels count as they were corrected by now.

        None where nothing is known of it.

        Raises
        ------
        InputError
            The labels cannot be read.
        """
        # Annotations are true under the up vector that is known now.
        key = (name, context.frame.id, context.viewer.up.tobytes())
        corrected = self._corrected(name, context.frame.id)
        if self._kept is None or self._kept[0] != key or self._kept[1] is not corrected:
            labels = self.labels(name)
            if corrected is not None:
                found = effective_truth(corrected)
            else:
                found = None if labels is None else labelled_truth(context.frame.id, source, labels)
            self._kept = key, corrected, annotated_truth(context, source) if found is None else found
        return self._kept[2]

    def judge(
        self,
        name: str,
        source: Pipeline,
        context: PreparedFrame,
        trace: Trace,
        expression: str | None = None,
        rank: RankConfig | None = None,
    ) -> Diagnosis | str | None:
        """The verdict, why there can be none, or None where nothing is known of the frame.

        `expression` is the id of the labelled expression that was asked, `rank` the weights of an edited trace.
        """
        try:
            truth = self.truth(name, source, context)
            if truth is None:
                return None
            corrected = self._corrected(name, context.frame.id)
            rejected = None if corrected is None or expression is None else withdrawn_by(corrected, expression)
            if rejected is not None:
                return rejected
            known = self.known(name, context, truth, expression)
            case = known["case"] or labelled_case(truth, trace.query.text)
            if corrected is not None and case is not None:
                known["case"] = answered_case(corrected, truth, case, trace)
            return judge_trace(trace, source, context, truth, rank=rank, **known)
        except InputError as error:
            return str(error)

    def known(
        self, name: str, context: PreparedFrame, truth: FrameCases | None, expression: str | None
    ) -> dict[str, Any]:
        """What a run knows of a labelled expression: its case, mark and confidence, as arguments of `judge_trace`."""
        run, corrected = self._shared.runs.get(name), self._corrected(name, context.frame.id)
        mark = None if run is None else run.spec.marks.get((context.frame.id, expression or ""))
        if corrected is not None and expression is not None:
            mark = effective_mark(corrected, expression, mark)
        return {
            "case": None if truth is None else next((c for c in truth.cases if c.id == expression), None),
            "mark": mark,
            "confidence": None if run is None else run.spec.confidence,
        }

    def other(self, name: str, context: PreparedFrame, text: str, expression: str | None) -> OtherAnswer | None:
        """What the run to compare with answers now, with its verdict by the same truth; None where there is none."""
        run = self._shared.others.get(name)
        if run is None:
            return None
        try:
            source = run.source
            own = context if source.config.lift == context.config else PreparedFrame(context.frame, source.config.lift)
            trace = source.ask(own, text)
        except InputError as error:
            return OtherAnswer(run.name, None, error=str(error))
        return OtherAnswer(run.name, trace, self.judge(name, source, own, trace, expression))
