"""Plots of relations alone: whether probabilities mean what they say, and F1 relation by relation."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from pipeline.evaluation.plots import TONES
from pipeline.evaluation.relation_report import SystemFigures
from pipeline.evaluation.tables import Table, caveats_html
from pipeline.labels.report.style import house_style, with_caveat
from pipeline.relations import PAIRWISE, PHRASE

DIAGONAL = "#b4bdca"


def draw_relations(
    figures: Sequence[SystemFigures], tables: Sequence[Table], out: Path, caveat: str = ""
) -> list[Path]:
    """Write `srm_reliability.png`, `srm_relations.png` and `srm.html` into a folder, which is made if it is missing.

    What the tables of the same figures warn of stands on the page too; `caveat`, what the figures are where truth and
    scorers have a maker in common, below the titles.
    """
    out.mkdir(parents=True, exist_ok=True)
    return [
        _draw_reliability(figures, caveat, out / "srm_reliability.png"),
        _draw_bars(figures, caveat, out / "srm_relations.png"),
        _page(figures, caveats_html(tables), out / "srm.html"),
    ]


def reliability_lines(figures: Sequence[SystemFigures]) -> dict[str, tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """By scorer: mean probability, frequency and number of cells of the bins that are not empty."""
    found = {}
    for system in figures:
        diagram = system.calibration.pooled
        some = diagram.count > 0
        found[system.title] = (diagram.confidence[some], diagram.frequency[some], diagram.count[some])
    return found


def _relations(figures: Sequence[SystemFigures]) -> list[str]:
    return [r for r in PAIRWISE if any(r in f.metrics.relations for f in figures)]


def _f1(system: SystemFigures, relations: Sequence[str]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Value, low and high in percent; NaN where the scorer does not judge a relation."""
    own = dict(zip(system.metrics.relations, system.estimates.f1, strict=True))
    rows = [[getattr(own[r], k) if r in own else np.nan for r in relations] for k in ("value", "low", "high")]
    value, low, high = 100 * np.array(rows, np.float64)
    return value, low, high


def _draw_reliability(figures: Sequence[SystemFigures], caveat: str, path: Path) -> Path:
    import matplotlib.pyplot as plt

    with house_style():
        figure, axes = plt.subplots(figsize=(5, 5), dpi=200, layout="constrained")
        axes.plot([0, 100], [0, 100], color=DIAGONAL, linestyle="--", linewidth=1)
        for k, (title, (confidence, frequency, _)) in enumerate(reliability_lines(figures).items()):
            ece = 100 * figures[k].calibration.pooled_ece
            axes.plot(
                100 * confidence, 100 * frequency, color=TONES[k % len(TONES)], marker=".",
                label=f"{title} (ECE {ece:.1f})",
            )  # fmt: skip
        axes.set_xlim(0, 100)
        axes.set_ylim(0, 100)
        axes.set_aspect("equal")
        axes.set_xlabel("probability that is given (%)")
        axes.set_ylabel("share that holds (%)")
        axes.set_title(with_caveat("Do probabilities of relations mean what they say?", caveat))
        axes.grid()
        axes.legend(loc="upper center", bbox_to_anchor=(0.5, -0.12), ncols=1)
        figure.savefig(path)
        plt.close(figure)
    return path


def _draw_bars(figures: Sequence[SystemFigures], caveat: str, path: Path) -> Path:
    import matplotlib.pyplot as plt

    relations = _relations(figures)
    width = 0.8 / max(len(figures), 1)
    with house_style():
        figure, axes = plt.subplots(figsize=(8, 3.6), dpi=200, layout="constrained")
        for k, system in enumerate(figures):
            x = np.arange(len(relations)) + (k - (len(figures) - 1) / 2) * width
            value, low, high = _f1(system, relations)
            axes.bar(x, value, width * 0.92, label=system.title, color=TONES[k % len(TONES)])
            known = np.isfinite(low)
            if known.any():
                error = np.stack([value - low, high - value])[:, known].clip(0)
                axes.errorbar(x[known], value[known], error, fmt="none", ecolor="#1f2630", elinewidth=0.8)
        axes.set_xticks(np.arange(len(relations)), [PHRASE[r] for r in relations])
        axes.set_ylim(0, 105)
        axes.set_ylabel("F1 (%)")
        axes.set_title(with_caveat("F1 of each relation, with 95 % intervals", caveat))
        axes.grid(axis="y")
        axes.legend(loc="upper center", bbox_to_anchor=(0.5, -0.1), ncols=2)
        figure.savefig(path)
        plt.close(figure)
    return path


def _page(figures: Sequence[SystemFigures], caveats: str, path: Path) -> Path:
    """One page that needs no network: the library stands in it."""
    import plotly.graph_objects as go
    from plotly.offline import get_plotlyjs

    relations = _relations(figures)
    curves: Any = go.Figure()
    curves.add_scatter(x=[0, 100], y=[0, 100], name="exact", line={"color": DIAGONAL, "dash": "dash"})
    for k, (title, (confidence, frequency, count)) in enumerate(reliability_lines(figures).items()):
        curves.add_scatter(
            x=100 * confidence, y=100 * frequency, name=_plain(title), mode="lines+markers",
            line={"color": TONES[k % len(TONES)]}, customdata=count,
            hovertemplate="given %{x:.1f} %, holds %{y:.1f} %, %{customdata} cells",
        )  # fmt: skip
    curves.update_layout(
        title="Do probabilities of relations mean what they say?", xaxis_title="probability that is given (%)",
        yaxis_title="share that holds (%)", width=760, height=700,
    )  # fmt: skip
    bars: Any = go.Figure()
    for k, system in enumerate(figures):
        value, low, high = _f1(system, relations)
        bars.add_bar(
            x=[PHRASE[r] for r in relations], y=value, name=_plain(system.title),
            marker_color=TONES[k % len(TONES)],
            error_y={"type": "data", "array": high - value, "arrayminus": value - low},
        )  # fmt: skip
    bars.update_layout(title="F1 of each relation, with 95 % intervals", yaxis_title="F1 (%)", barmode="group")
    parts = []
    for figure in (curves, bars):
        figure.update_layout(template="plotly_white", font={"family": "Arial, sans-serif", "size": 13})
        parts.append(figure.to_html(full_html=False, include_plotlyjs=False))
    path.write_text(
        "<!doctype html><html><head><meta charset='utf-8'><title>Relations alone</title>"
        f"<script>{get_plotlyjs()}</script></head><body>{caveats}{''.join(parts)}</body></html>",
        encoding="utf-8",
    )
    return path


def _plain(title: str) -> str:
    """A name of a file may hold what plotly takes for markup."""
    return title.replace("<", "‹").replace(">", "›")
