"""The verdict on what a client asks, where the truth of its frame is known. The core computes; this only remembers."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from pipeline.ask import Trace
from pipeline.diagnosis.live import Judgement, annotated_truth, judge_trace, labelled_truth
from pipeline.errors import InputError
from pipeline.evaluation.cases import FrameCases
from pipeline.evaluation.run_folder import Run
from pipeline.jobs import Source
from pipeline.labels.reading import Labels
from pipeline.objects import FrameContext
from pipeline.ranking import RankConfig
from spatialviz.app.state import OtherAnswer


class Judge:
    """Judges traces of one client; the truth of the frame it looked at last is kept.

    Parameters
    ----------
    runs : mapping of str to Run
        By name of the source that the run was made with.
    others : mapping of str to Run
        Runs to compare with, by the same names.
    labels : mapping of str to Labels, optional
        What is true where there is no run, by name of the source.
    """

    def __init__(
        self, runs: Mapping[str, Run], others: Mapping[str, Run], labels: Mapping[str, Labels] | None = None
    ) -> None:
        self._runs, self._others, self._labels = runs, others, labels or {}
        self._kept: tuple[tuple[str, str], FrameCases | None] | None = None

    def truth(self, name: str, source: Source, context: FrameContext) -> FrameCases | None:
        """What is true in a frame: by the run's labels or those that were named, else by the frame's annotations.

        None where nothing is known of it.

        Raises
        ------
        InputError
            The labels cannot be read.
        """
        key = (name, context.frame.id)
        if self._kept is None or self._kept[0] != key:
            run = self._runs.get(name)
            labels = self._labels.get(name) if run is None else run.labels
            found = None if labels is None else labelled_truth(context.frame.id, source, labels)
            self._kept = key, annotated_truth(context, source) if found is None else found
        return self._kept[1]

    def judge(
        self,
        name: str,
        source: Source,
        context: FrameContext,
        trace: Trace,
        expression: str | None = None,
        rank: RankConfig | None = None,
    ) -> Judgement | str | None:
        """The verdict, why there can be none, or None where nothing is known of the frame.

        `expression` is the id of the labelled expression that was asked, `rank` the weights of an edited trace.
        """
        try:
            truth = self.truth(name, source, context)
            if truth is None:
                return None
            known = self.known(name, context, truth, expression)
            return judge_trace(trace, source, context, truth, rank=rank, **known)
        except InputError as error:
            return str(error)

    def known(
        self, name: str, context: FrameContext, truth: FrameCases | None, expression: str | None
    ) -> dict[str, Any]:
        """What a run knows of a labelled expression: its case, mark and confidence, as arguments of `judge_trace`."""
        run = self._runs.get(name)
        return {
            "case": None if truth is None else next((c for c in truth.cases if c.id == expression), None),
            "mark": None if run is None else run.spec.marks.get((context.frame.id, expression or "")),
            "confidence": None if run is None else run.spec.confidence,
        }

    def other(self, name: str, context: FrameContext, text: str, expression: str | None) -> OtherAnswer | None:
        """What the run to compare with answers now, with its verdict by the same truth; None where there is none."""
        run = self._others.get(name)
        if run is None:
            return None
        try:
            source = run.source
            own = context if source.config.lift == context.config else FrameContext(context.frame, source.config.lift)
            trace = source.ask(own, text)
        except InputError as error:
            return OtherAnswer(run.name, None, error=str(error))
        return OtherAnswer(run.name, trace, self.judge(name, source, own, trace, expression))
