"""What a person reads of a score calibration."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from rich.table import Table
from rich.text import Text

from pipeline.proposals.score_calibration import ScoreCalibration
from spatialviz.printing import make_console


def print_calibration(calibration: ScoreCalibration, report: dict[str, Any], out: Path) -> None:
    """The sigmoid, and how well scores say how often they are right, before and after it."""
    console = make_console()
    console.print(
        f"{report['detections']} detections in {report['frames']} frames, {report['hits']} of them hits: "
        f"a = {calibration.a:.3f}, b = {calibration.b:+.3f}"
    )
    if not report["fitted"]:
        reason = f"scores stay as they are: a fit needs at least {report['fewest']} hits and as many misses"
        console.print(Text(reason + ", and must rise with the score", "yellow"))
    table = Table(box=None, pad_edge=False, header_style="dim")
    for column in ("", "Brier", "ECE", "log loss"):
        table.add_column(column, justify="right" if column else "left")
    for name in ("before", "after"):
        table.add_row(name, *(f"{report[name][k]:.4f}" for k in ("brier", "ece", "log_loss")))
    console.print(table)
    table = Table(box=None, pad_edge=False, header_style="dim")
    for column in ("score", "before: n", "mean score", "hits", "after: n", "mean score", "hits"):
        table.add_column(column, justify="right")
    bins = [{round(row["low"], 2): row for row in report[name]["reliability"]} for name in ("before", "after")]
    for low in sorted({low for side in bins for low in side}):
        cells = []
        for side in bins:
            row = side.get(low)
            cells += ["", "", ""] if row is None else [str(row["count"]), f"{row['score']:.3f}", f"{row['hits']:.3f}"]
        table.add_row(f"{low:.1f}-{low + 0.1:.1f}", *cells)
    console.print(table)
    console.print(Text("after: each half of the frames under the fit of the other half", "dim"))
    console.print(f"-> {out}")
