"""The command that evaluates."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path

from tyro.conf import OmitArgPrefixes, Positional

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
        from pipeline.evaluation.job import evaluate_dataset
        from pipeline.evaluation.run import EvalSpec
        from spatialviz.printing import rate_bar
        from spatialviz.printing_eval import print_run, run_record

        spec = EvalSpec(self.dataset, str(self.labels), self.source.options())
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
