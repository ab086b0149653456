"""Plots of a run: pictures for papers, and one page with the same plots to move about in."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from html import escape
from pathlib import Path
from typing import Any

import numpy as np

from pipeline.evaluation.confusion import Confusion
from pipeline.evaluation.grounding_tables import OPM_ONLY, column, has_opm
from pipeline.evaluation.records import detector_scores, is_calibrated
from pipeline.evaluation.relation_report import SystemFigures
from pipeline.evaluation.summary import RunSummary
from pipeline.labels.report.style import INK, QUIET, house_style, need_matplotlib, with_caveat
from pipeline.language.relation_names import PAIRWISE, PHRASE
from pipeline.metrics.calibration_metrics import ECE_BINS, ReliabilityDiagram, reliability_diagram
from pipeline.metrics.intervals import Estimate
from pipeline.metrics.tables import Table, caveats_html
from pipeline.system.arrow import pa
from pipeline.system.errors import MissingExtra

SCORE_TONES = {"raw scores": "#ee7733", "calibrated": "#0077bb"}
Diagrams = dict[str, dict[str, ReliabilityDiagram]]
"""By system, then by kind of score."""

Lines = tuple[np.ndarray, dict[str, np.ndarray]]
"""x, and curves by name."""

SWEEP = np.linspace(0.05, 0.95, 19)
TONES = ("#0077bb", "#ee7733", "#009988", "#cc3311", "#33bbee", "#ee3377")
"""Paul Tol's vibrant scheme, which people with any colour vision can tell apart."""
PALE_TONE = "#b4bdca"
ACCURACY = "set-valued accuracy (%)"


def need_plots() -> None:
    """Raise MissingExtra where plots cannot be drawn."""
    need_matplotlib()
    try:
        import plotly  # noqa: F401
    except ImportError as error:
        raise MissingExtra("interactive plots", "report") from error


def draw(systems: Mapping[str, pa.Table], tables: Sequence[Table], out: Path, caveat: str = "") -> None:
    """Write `relations.png`, `overlap.png`, `classes.png`, `plots.html`, and `calibration.png` where scores are.

    Parameters
    ----------
    systems : mapping of str to pyarrow.Table
        Records by system.
    tables : sequence of Table
        Those of the run: the relation table gives the bars their intervals.
    out : Path
        A folder to make.
    caveat : str
        What the figures are where truth and systems have a maker in common: below each title.
    """
    out.mkdir(parents=True)
    bars = relation_bars(next(t for t in tables if t.key == "relations"))
    sweeps = {name: overlap_sweep(records) for name, records in systems.items()}
    rivals = {name: by_rivals(records) for name, records in systems.items()}
    tones = _tones(bars[1])
    diagrams = score_diagrams(systems)
    title = "Accuracy by relation"
    shown = with_caveat(f"{title}, with 95 % intervals", caveat)
    draw_bars(bars, tones, shown, ACCURACY, out / "relations.png", 3.4)
    figures = [bar_figure(bars, tones, title, ACCURACY)]
    for curves, title, x_label, file in (
        (sweeps, "Accuracy by the overlap that is asked for", "overlap (IoU)", "overlap.png"),
        (rivals, "Accuracy by how many objects share the target's class", "objects of the class", "classes.png"),
    ):
        _draw_lines(curves, with_caveat(title, caveat), x_label, out / file)
        figures.append(_line_figure(curves, title, x_label))
    if diagrams:
        draw_reliability(diagrams, caveat, out / "calibration.png")
    figures += reliability_figures(diagrams)
    write_figures(figures, "Evaluation", out / "plots.html", caveats_html(tables))


def relation_bars(table: Table) -> Bars:
    """The relation table as bars."""
    found = {row.name: [c for c in row.cells if isinstance(c, Estimate)] for row in table.rows}
    return table.columns, {
        name: 100 * np.array([[getattr(c, end) for c in cells] for end in ("value", "low", "high")])
        for name, cells in found.items()
        if cells
    }


def overlap_sweep(records: pa.Table) -> Lines:
    """Share of expressions whose answer overlaps an acceptable target by at least x."""
    names = {"pipeline": "set_iou", "OPM only": "opm_set_iou"} if has_opm(records) else {"whole expression": "set_iou"}
    columns = {label: column(records, name) for label, name in names.items()}
    return SWEEP, {label: (own[None] >= SWEEP[:, None]).mean(axis=1) for label, own in columns.items()}


def by_rivals(records: pa.Table) -> Lines:
    """Accuracy by the number of labelled objects of the target's class; 6 stands for 6 and more."""
    number = np.minimum(column(records, "same_class").astype(int), 6)
    x = np.unique(number)
    answers = {"pipeline" if has_opm(records) else "whole expression": column(records, "set_correct")}
    if has_opm(records):
        answers["OPM only"] = (column(records, "opm_set_iou") >= 0.5).astype(float)
    curves = {label: np.array([right[number == k].mean() for k in x]) for label, right in answers.items()}
    return x.astype(float), curves


def _tones(rows: Mapping[str, Any]) -> dict[str, str]:
    """A colour for each row of the relation table: the detector alone is pale, each system has its own."""
    systems = [name for name in rows if not name.endswith(OPM_ONLY)]
    own = {name: TONES[k % len(TONES)] for k, name in enumerate(systems)}
    return {name: own.get(name, PALE_TONE) for name in rows}


def _draw_lines(curves: Mapping[str, Lines], title: str, x_label: str, path: Path) -> None:
    with drawing(path, figsize=(6, 3.4)) as axes:
        for k, (system, (x, lines)) in enumerate(curves.items()):
            for label, y in lines.items():
                style = "--" if label == "OPM only" else "-"
                axes.plot(x, 100 * y, style, color=TONES[k % len(TONES)], label=f"{system}, {label}", marker=".")
        axes.set(ylim=(0, 105), xlabel=x_label, ylabel=ACCURACY, title=title)
        axes.grid(axis="y")
        axes.legend(loc="upper center", bbox_to_anchor=(0.5, -0.18), ncols=2)


def _line_figure(curves: Mapping[str, Lines], title: str, x_label: str) -> Any:
    figure = moving_figure()
    for k, (system, (x, lines)) in enumerate(curves.items()):
        for label, y in lines.items():
            line = {"color": TONES[k % len(TONES)], "dash": "dash" if label == "OPM only" else "solid"}
            figure.add_scatter(x=x, y=100 * y, name=plain(f"{system}, {label}"), line=line)
    return figure.update_layout(title=title, xaxis_title=x_label, yaxis_title=ACCURACY)


def draw_relations(figures: Sequence[SystemFigures], tables: Sequence[Table], out: Path, caveat: str = "") -> None:
    """Write `srm_reliability.png`, `srm_relations.png` and `srm.html` into a folder, which is made if it is missing.

    What the tables of the same figures warn of stands on the page too; `caveat`, what the figures are where truth and
    scorers have a maker in common, below the titles.
    """
    out.mkdir(parents=True, exist_ok=True)
    bars, title = _f1_bars(figures), "F1 of each relation, with 95 % intervals"
    tones = {f.title: TONES[k % len(TONES)] for k, f in enumerate(figures)}
    parts = [_curves(figures), bar_figure(bars, tones, title, "F1 (%)")]
    _draw_reliability(figures, caveat, out / "srm_reliability.png")
    draw_bars(bars, tones, with_caveat(title, caveat), "F1 (%)", out / "srm_relations.png")
    write_figures(parts, "Relations alone", out / "srm.html", caveats_html(tables))


def reliability_lines(figures: Sequence[SystemFigures]) -> dict[str, tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """By scorer: mean probability, frequency and number of cells of the bins that are not empty."""
    found = {}
    for system in figures:
        diagram = system.calibration.pooled
        some = diagram.count > 0
        found[system.title] = (diagram.confidence[some], diagram.frequency[some], diagram.count[some])
    return found


def _f1_bars(figures: Sequence[SystemFigures]) -> Bars:
    """NaN where a scorer does not judge a relation."""
    relations = [r for r in PAIRWISE if any(r in f.metrics.relations for f in figures)]
    rows = {}
    for system in figures:
        own = dict(zip(system.metrics.relations, system.estimates.f1, strict=True))
        ends = [[getattr(own[r], k) if r in own else np.nan for r in relations] for k in ("value", "low", "high")]
        rows[system.title] = 100 * np.array(ends, np.float64)
    return [PHRASE[r] for r in relations], rows


def _draw_reliability(figures: Sequence[SystemFigures], caveat: str, path: Path) -> None:
    with drawing(path, figsize=(5, 5)) as axes:
        axes.plot([0, 100], [0, 100], color=PALE_TONE, linestyle="--", linewidth=1)
        for k, (title, (confidence, frequency, _)) in enumerate(reliability_lines(figures).items()):
            ece = 100 * figures[k].calibration.pooled_ece
            axes.plot(
                100 * confidence, 100 * frequency, color=TONES[k % len(TONES)], marker=".",
                label=f"{title} (ECE {ece:.1f})",
            )  # fmt: skip
        axes.set(
            xlim=(0, 100), ylim=(0, 100), aspect="equal",
            xlabel="probability that is given (%)", ylabel="share that holds (%)",
            title=with_caveat("Do probabilities of relations mean what they say?", caveat),
        )  # fmt: skip
        axes.grid()
        axes.legend(loc="upper center", bbox_to_anchor=(0.5, -0.12), ncols=1)


def _curves(figures: Sequence[SystemFigures]) -> Any:
    curves = moving_figure()
    curves.add_scatter(x=[0, 100], y=[0, 100], name="exact", line={"color": PALE_TONE, "dash": "dash"})
    for k, (title, (confidence, frequency, count)) in enumerate(reliability_lines(figures).items()):
        curves.add_scatter(
            x=100 * confidence, y=100 * frequency, name=plain(title), mode="lines+markers",
            line={"color": TONES[k % len(TONES)]}, customdata=count,
            hovertemplate="given %{x:.1f} %, holds %{y:.1f} %, %{customdata} cells",
        )  # fmt: skip
    return curves.update_layout(
        title="Do probabilities of relations mean what they say?", xaxis_title="probability that is given (%)",
        yaxis_title="share that holds (%)", width=760, height=700,
    )  # fmt: skip


def score_diagrams(systems: Mapping[str, pa.Table]) -> Diagrams:
    """Reliability by raw and by calibrated scores, of every system whose scores are calibrated."""
    found: Diagrams = {}
    for name, records in systems.items():
        if is_calibrated(records):
            scores = detector_scores(records)
            pairs = zip(SCORE_TONES, (scores.raw, scores.calibrated), strict=True)
            found[name] = {kind: reliability_diagram(p, scores.hits, ECE_BINS) for kind, p in pairs}
    return found


def draw_reliability(diagrams: Diagrams, caveat: str, path: Path) -> None:
    """One panel a system: the share of hits by score, and below how many detections have it."""
    wide = 4.2 * len(diagrams) + 0.6
    with drawing(
        path, nrows=2, ncols=len(diagrams), figsize=(wide, 4.6), squeeze=False, sharex=True, height_ratios=(3, 1)
    ) as axes:
        for k, (system, kinds) in enumerate(diagrams.items()):
            upper, lower = axes[:, k]
            upper.plot([0, 1], [0, 100], color=QUIET, linewidth=0.8, linestyle=":", label="as likely as it says")
            for n, (kind, diagram) in enumerate(kinds.items()):
                there = diagram.count > 0
                text, happened = diagram.confidence[there], 100 * diagram.frequency[there]
                upper.plot(text, happened, marker="o", markersize=3.5, color=SCORE_TONES[kind],
                           label=f"{kind}, ECE {diagram.ece:.3f}")  # fmt: skip
                middle = (diagram.edges[:-1] + diagram.edges[1:]) / 2 + (n - 0.5) * 0.4 / ECE_BINS
                lower.bar(middle, diagram.count, 0.36 / ECE_BINS, color=SCORE_TONES[kind])
            upper.set_title(system, color=INK)
            upper.set(xlim=(0, 1), ylim=(0, 105), ylabel="hits, IoU of at least 0.5 (%)")
            upper.grid(axis="y")
            upper.legend(loc="lower right")
            lower.set(xlabel="score", ylabel="detections")
        if caveat:
            title = with_caveat("Reliability of the detector's scores", caveat)
            axes[0, 0].figure.suptitle(title, fontsize=9, color=INK)


def reliability_figures(diagrams: Diagrams) -> list[Any]:
    """The same to move about in."""
    figures = []
    for system, kinds in diagrams.items():
        figure = moving_figure()
        figure.add_scatter(
            x=[0, 1], y=[0, 100], mode="lines", name="as likely as it says", line={"color": QUIET, "dash": "dot"}
        )
        for kind, diagram in kinds.items():
            there = diagram.count > 0
            figure.add_scatter(
                x=diagram.confidence[there], y=100 * diagram.frequency[there], name=f"{kind}, ECE {diagram.ece:.3f}",
                mode="lines+markers", line={"color": SCORE_TONES[kind]}, customdata=np.array(diagram.count[there]),
                hovertemplate="score %{x:.3f}<br>hits %{y:.1f} %<br>%{customdata} detections",
            )  # fmt: skip
        title = f"Reliability of the detector's scores: {system}"
        labels = {"xaxis_title": "score", "yaxis_title": "hits, IoU of at least 0.5 (%)"}
        figures.append(figure.update_layout(title=title, **labels))
    return figures


VERDICT_COLORS = {
    "CORRECT": "#009988", "PARSE": "#aa3377", "LABEL": "#b4bdca", "OPM-TARGET": "#cc3311", "OPM-REF": "#ee7733",
    "LIFT": "#0077bb", "ATTRIBUTE": "#999933", "SRM": "#33bbee", "OPM-CONF": "#ddaa33", "PRM": "#ee3377",
    "COMPOUND": "#46536a", "UNEXPLAINED": "#8a8f98",
}  # fmt: skip
LOSS_COLORS = {
    "accuracy": VERDICT_COLORS["CORRECT"], "PARSE": VERDICT_COLORS["PARSE"], "RECALL": VERDICT_COLORS["OPM-TARGET"],
    "LIFT": VERDICT_COLORS["LIFT"], "SRM": VERDICT_COLORS["SRM"], "CONF": VERDICT_COLORS["OPM-CONF"],
    "ATTRIBUTE": VERDICT_COLORS["ATTRIBUTE"], "residual": VERDICT_COLORS["COMPOUND"],
    "unknown": VERDICT_COLORS["UNEXPLAINED"],
}  # fmt: skip
ADDS_UP = (
    "Full bars add up from the accuracy to 100: what the gold parse gains (PARSE), the Shapley value of each oracle, "
    "its fair share over all orders of replacing, and the residual. Hollow bars are one oracle alone: they do not add "
    "up, and one below 0 says that the module made up for an error of another."
)


def waterfall(summary: RunSummary) -> list[tuple[str, float, Estimate]]:
    """(name, where its bar begins, estimate) of what adds up to one."""
    found, at = [], 0.0
    for name, estimate in summary.loss.items():
        found.append((name, at, estimate))
        at += estimate.value
    return found


def interval(e: Estimate) -> tuple[float, float]:
    """How far an interval reaches below and above its value, in points; 0 without one."""
    if not (np.isfinite(e.low) and np.isfinite(e.high)):
        return 0.0, 0.0
    return max(0.0, 100 * (e.value - e.low)), max(0.0, 100 * (e.high - e.value))


def shares_of_rows(found: Confusion) -> np.ndarray:
    """(R, C) counts as shares of their row; 0 in an empty row."""
    total = found.counts.sum(axis=1, keepdims=True)
    return np.divide(found.counts, total, out=np.zeros(found.counts.shape), where=total > 0)


Bars = tuple[Sequence[str], dict[str, np.ndarray]]
"""What bars stand for, and by name (3, K) float64: values, lows and highs in percent; NaN for none."""


@contextmanager
def drawing(path: Path, **options: Any) -> Iterator[Any]:
    """Axes of a new picture, as `plt.subplots` gives them, which is written when the block ends."""
    import matplotlib.pyplot as plt

    with house_style():
        figure, axes = plt.subplots(dpi=200, layout="constrained", **options)
        yield axes
        figure.savefig(path)
        plt.close(figure)


def moving_figure() -> Any:
    """An empty figure of plotly's."""
    import plotly.graph_objects as go

    return go.Figure()


def draw_bars(bars: Bars, tones: Mapping[str, str], title: str, y_label: str, path: Path, height: float = 3.6) -> None:
    """Bars beside each other, with their intervals."""
    ticks, rows = bars
    width = 0.8 / max(len(rows), 1)
    with drawing(path, figsize=(8, height)) as axes:
        for k, (name, (value, low, high)) in enumerate(rows.items()):
            x = np.arange(len(ticks)) + (k - (len(rows) - 1) / 2) * width
            axes.bar(x, value, width * 0.92, label=name, color=tones[name])
            known = np.isfinite(low)
            if known.any():
                error = np.stack([value - low, high - value])[:, known].clip(0)
                axes.errorbar(x[known], value[known], error, fmt="none", ecolor=INK, elinewidth=0.8)
        axes.set_xticks(np.arange(len(ticks)), ticks)
        axes.set(ylim=(0, 105), ylabel=y_label, title=title)
        axes.grid(axis="y")
        axes.legend(loc="upper center", bbox_to_anchor=(0.5, -0.1), ncols=2)


def bar_figure(bars: Bars, tones: Mapping[str, str], title: str, y_label: str) -> Any:
    """The same to move about in."""
    ticks, rows = bars
    figure = moving_figure()
    for name, (value, low, high) in rows.items():
        figure.add_bar(
            x=list(ticks), y=value, name=plain(name), marker_color=tones[name],
            error_y={"type": "data", "array": high - value, "arrayminus": value - low},
        )  # fmt: skip
    return figure.update_layout(title=title, yaxis_title=y_label, barmode="group")


def plain(text: str) -> str:
    """A name that plotly, which reads some HTML in names, shows as it is."""
    return escape(text, quote=False)


def write_figures(parts: Iterable[Any], title: str, path: Path, caveats: str = "", style: str = "") -> None:
    """One page that needs no network, as the library stands in it: figures, and HTML between them; `caveats` on top."""
    from plotly.offline import get_plotlyjs

    def shown(part: Any) -> str:
        if isinstance(part, str):
            return part
        part.update_layout(template="plotly_white", font={"family": "Arial, sans-serif", "size": 13})
        return part.to_html(full_html=False, include_plotlyjs=False)

    path.write_text(
        f"<!doctype html><html><head><meta charset='utf-8'><title>{title}</title>{style}"
        f"<script>{get_plotlyjs()}</script></head><body>{caveats}{''.join(map(shown, parts))}</body></html>",
        encoding="utf-8",
    )
