"""Reliability of a detector's scores, before and after calibration."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from pipeline.evaluation.records import detector_scores, is_calibrated
from pipeline.labels.report.style import INK, QUIET, house_style
from pipeline.metrics.calibration_metrics import ECE_BINS, ReliabilityDiagram, reliability_diagram

if TYPE_CHECKING:
    import pyarrow as pa

BINS = ECE_BINS
TONES = {"raw scores": "#ee7733", "calibrated": "#0077bb"}

Diagrams = dict[str, dict[str, ReliabilityDiagram]]
"""By system, then by kind of score."""


def score_diagrams(systems: Mapping[str, pa.Table]) -> Diagrams:
    """Reliability by raw and by calibrated scores, of every system whose scores are calibrated."""
    found: Diagrams = {}
    for name, records in systems.items():
        if is_calibrated(records):
            scores = detector_scores(records)
            pairs = zip(TONES, (scores.raw, scores.calibrated), strict=True)
            found[name] = {kind: reliability_diagram(p, scores.hits, BINS) for kind, p in pairs}
    return found


def draw_reliability(diagrams: Diagrams, path: Path) -> Path:
    """One panel a system: the share of hits by score, and below how many detections have it."""
    import matplotlib.pyplot as plt

    with house_style():
        figure, axes = plt.subplots(
            2, len(diagrams), figsize=(4.2 * len(diagrams) + 0.6, 4.6), dpi=200, layout="constrained", squeeze=False,
            sharex=True, height_ratios=(3, 1),
        )  # fmt: skip
        for k, (system, kinds) in enumerate(diagrams.items()):
            upper, lower = axes[:, k]
            upper.plot([0, 1], [0, 100], color=QUIET, linewidth=0.8, linestyle=":", label="as likely as it says")
            for n, (kind, diagram) in enumerate(kinds.items()):
                there = diagram.count > 0
                said, happened = diagram.confidence[there], 100 * diagram.frequency[there]
                upper.plot(said, happened, marker="o", markersize=3.5, color=TONES[kind],
                           label=f"{kind}, ECE {diagram.ece:.3f}")  # fmt: skip
                middle = (diagram.edges[:-1] + diagram.edges[1:]) / 2 + (n - 0.5) * 0.4 / BINS
                lower.bar(middle, diagram.count, 0.36 / BINS, color=TONES[kind])
            upper.set_title(system, color=INK)
            upper.set_xlim(0, 1)
            upper.set_ylim(0, 105)
            upper.set_ylabel("hits, IoU of at least 0.5 (%)")
            upper.grid(axis="y")
            upper.legend(loc="lower right")
            lower.set_xlabel("score")
            lower.set_ylabel("detections")
        figure.savefig(path)
        plt.close(figure)
    return path


def reliability_figures(diagrams: Diagrams) -> list[Any]:
    """The same to move about in."""
    import plotly.graph_objects as go

    figures = []
    for system, kinds in diagrams.items():
        figure = go.Figure()
        figure.add_scatter(
            x=[0, 1], y=[0, 100], mode="lines", name="as likely as it says", line={"color": QUIET, "dash": "dot"}
        )
        for kind, diagram in kinds.items():
            there = diagram.count > 0
            figure.add_scatter(
                x=diagram.confidence[there], y=100 * diagram.frequency[there], name=f"{kind}, ECE {diagram.ece:.3f}",
                mode="lines+markers", line={"color": TONES[kind]}, customdata=np.array(diagram.count[there]),
                hovertemplate="score %{x:.3f}<br>hits %{y:.1f} %<br>%{customdata} detections",
            )  # fmt: skip
        figure.update_layout(
            title=f"Reliability of the detector's scores: {system}", xaxis_title="score",
            yaxis_title="hits, IoU of at least 0.5 (%)",
        )  # fmt: skip
        figures.append(figure)
    return figures
