"""The command that evaluates."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from tyro.conf import OmitArgPrefixes, Positional

from pipeline.errors import InputError
from spatialviz.exits import FINE
from spatialviz.options import print_json
from spatialviz.source_options import SourceOptions


@dataclass(frozen=True)
class Eval:
    """Answer every expression of labels, and write tables with intervals, plots and records."""

    dataset: Positional[str]
    """Dataset folder, or "demo"."""
    labels: Path
    """Labels folder."""
    out: Path
    """Run folder to write."""
    source: OmitArgPrefixes[SourceOptions] = SourceOptions()
    system: Literal["pipeline", "referring", "vlm"] = "pipeline"
    """pipeline | referring: the detector fed the whole expression | vlm: a vision-language model."""
    vlm_url: str | None = None
    """OpenAI-compatible server, such as http://localhost:8000/v1 (vLLM, Ollama, llama.cpp). Key: SPATIALVIZ_VLM_KEY."""
    vlm_model: str | None = None
    """The model's name on that server."""
    vlm_rate: float | None = None
    """Requests a minute at most."""
    marks: Path | None = None
    """JSON of labels that a person found wrong: [{"frame", "id", "mark": "BAD_LABEL" | "BAD_BOX"}]."""
    limit: int | None = None
    """Only so many expressions, spread evenly."""
    name: str | None = None
    """Of the system in the tables. Default: detector and relation scorer."""
    others: tuple[Path, ...] = ()
    """Runs on the same labels whose systems become rows too."""
    compare: Path | None = None
    """A run to compare with: what was fixed, what was broken, what is right for another reason."""
    workers: int = os.cpu_count() or 1
    """Processes at once. The figures do not depend on it."""
    plots: bool = True
    """Draw plots (extra: report)."""
    overwrite: bool = False
    """Replace an earlier run."""
    show: int = 5
    """Expressions shown of each kind with --compare."""
    json: bool = False
    """Print one JSON object."""

    def run(self) -> int:
        from pipeline.diagnosis.marks import read_marks
        from pipeline.evaluation.job import evaluate_dataset
        from pipeline.evaluation.run import EvalSpec
        from pipeline.evaluation.whole_expression import VlmOptions
        from spatialviz.printing import rate_bar
        from spatialviz.printing_eval import print_run, run_record

        vlm = None
        if self.system == "vlm":
            if self.vlm_url is None or self.vlm_model is None:
                raise InputError("--system vlm needs a server and a model", expected="--vlm-url URL --vlm-model NAME")
            vlm = VlmOptions(self.vlm_url, self.vlm_model, self.vlm_rate)
        marks = {} if self.marks is None else read_marks(self.marks)
        options = self.source.options()
        spec = EvalSpec(self.dataset, str(self.labels), options, self.system, vlm, self.limit, marks=marks)
        with rate_bar("evaluating", "expressions") as advance:
            report = evaluate_dataset(
                spec,
                self.out,
                name=self.name,
                workers=self.workers,
                others=self.others,
                against=self.compare,
                plots=self.plots,
                overwrite=self.overwrite,
                progress=advance,
            )
        if self.json:
            print_json(run_record(report))
        else:
            print_run(report, self.show)
        return FINE
