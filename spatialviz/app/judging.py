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
from pipeline.system.errors import InputError, needed
from spatialviz.app.context import Context, Part
from spatialviz.app.state import OtherAnswer


class Judge(Part):
    """Judges traces of the frame that a client looks at; the truth of the last one is kept.

    Parameters
    ----------
    ctx : Context
    corrected : callable
        Gives the corrected labels of a frame of a source; None where nobody has corrected any.
    """

    def __init__(self, ctx: Context, corrected: Callable[[str, str], EffectiveFrame | None]) -> None:
        super().__init__(ctx)
        self._corrections = corrected
        self._kept: tuple[tuple[str, str, bytes], EffectiveFrame | None, FrameCases | None] | None = None

    @property
    def labels(self) -> Labels | None:
        """Those that say what is true in the source: the run's, or those that were named."""
        run = self.ctx.run
        return self.ctx.shared.labels.get(self.state.source) if run is None else run.labels

    @property
    def _corrected(self) -> EffectiveFrame | None:
        return self._corrections(self.state.source, self.state.frame_id)

    def truth(self, source: Pipeline, context: PreparedFrame) -> FrameCases | None:
        """What is true in the frame: by the run's labels or those that were named, else by the frame's annotations.

        Labels count as they were corrected by now.

        None where nothing is known of it.

        Raises
        ------
        InputError
            The labels cannot be read.
        """
        # Annotations are true under the up vector that is known now.
        key = (self.state.source, context.frame.id, context.viewer.up.tobytes())
        corrected, labels = self._corrected, self.labels
        if self._kept is None or self._kept[0] != key or self._kept[1] is not corrected:
            if corrected is not None:
                found = effective_truth(corrected)
            else:
                found = None if labels is None else labelled_truth(context.frame.id, source, labels)
            self._kept = key, corrected, annotated_truth(context, source) if found is None else found
        return self._kept[2]

    @property
    def _context(self) -> PreparedFrame:
        return needed(self.state.loaded, "the frame cannot be shown").context

    def judge(
        self,
        trace: Trace,
        rank: RankConfig | None = None,
        source: Pipeline | None = None,
        context: PreparedFrame | None = None,
    ) -> Diagnosis | str | None:
        """The verdict, why there can be none, or None where nothing is known of the frame.

        `rank` are the weights of an edited trace, `source` and `context` those of another run.
        """
        source, context = source or self.ctx.source, context or self._context
        expression = self.state.expression_id(trace.query.text)
        try:
            truth, corrected = self.truth(source, context), self._corrected
            if truth is None:
                return None
            rejected = None if corrected is None or expression is None else withdrawn_by(corrected, expression)
            if rejected is not None:
                return rejected
            known = self.known(truth, expression)
            case = known["case"] or labelled_case(truth, trace.query.text)
            if corrected is not None and case is not None:
                known["case"] = answered_case(corrected, truth, case, trace)
            return judge_trace(trace, source, context, truth, rank=rank, **known)
        except InputError as error:
            return str(error)

    def known(self, truth: FrameCases | None, expression: str | None) -> dict[str, Any]:
        """What a run knows of a labelled expression: its case, mark and confidence, as arguments of `judge_trace`."""
        run, corrected = self.ctx.run, self._corrected
        mark = None if run is None else run.spec.marks.get((self.state.frame_id, expression or ""))
        if corrected is not None and expression is not None:
            mark = effective_mark(corrected, expression, mark)
        return {
            "case": None if truth is None else next((c for c in truth.cases if c.id == expression), None),
            "mark": mark,
            "confidence": None if run is None else run.spec.confidence,
        }

    def other(self, text: str) -> OtherAnswer | None:
        """What the run to compare with answers now, with its verdict by the same truth; None where there is none."""
        run, own = self.ctx.shared.others.get(self.state.source), self._context
        if run is None:
            return None
        try:
            if run.source.config.lift != own.config:
                own = PreparedFrame(own.frame, run.source.config.lift)
            trace = run.source.ask(own, text)
        except InputError as error:
            return OtherAnswer(run.name, None, error=str(error))
        return OtherAnswer(run.name, trace, self.judge(trace, None, run.source, own))
