"""Plots of a run: pictures for papers, and one page with the same plots to move about in."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from pipeline.errors import MissingExtra
from pipeline.evaluation.calibration_plots import draw_reliability, reliability_figures, score_diagrams
from pipeline.evaluation.grounding_tables import OPM_ONLY, column, has_opm
from pipeline.evaluation.intervals import Estimate
from pipeline.evaluation.tables import Table, caveats_html
from pipeline.labels.report.style import house_style, need_matplotlib, with_caveat

if TYPE_CHECKING:
    import pyarrow as pa

SWEEP = np.linspace(0.05, 0.95, 19)
TONES = ("#0077bb", "#ee7733", "#009988", "#cc3311", "#33bbee", "#ee3377")
"""Paul Tol's vibrant scheme, which people with any colour vision can tell apart."""
PALE_TONE = "#b4bdca"


def need_plots() -> None:
    """Raise MissingExtra where plots cannot be drawn."""
    need_matplotlib()
    try:
        import plotly  # noqa: F401
    except ImportError as error:
        raise MissingExtra("interactive plots", "report") from error


def draw(systems: Mapping[str, pa.Table], tables: Sequence[Table], out: Path, caveat: str = "") -> list[Path]:
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
    written = [
        _draw_bars(bars, caveat, out / "relations.png"),
        _draw_lines(
            sweeps, with_caveat("Accuracy by the overlap that is asked for", caveat),
            "overlap (IoU)", "set-valued accuracy (%)", out / "overlap.png",
        ),
        _draw_lines(
            rivals, with_caveat("Accuracy by how many objects share the target's class", caveat),
            "objects of the class", "set-valued accuracy (%)", out / "classes.png",
        ),
    ]  # fmt: skip
    diagrams = score_diagrams(systems)
    if diagrams:
        written.append(draw_reliability(diagrams, caveat, out / "calibration.png"))
    written.append(_page(bars, sweeps, rivals, reliability_figures(diagrams), caveats_html(tables), out / "plots.html"))
    return written


Bars = tuple[tuple[str, ...], dict[str, list[Estimate]]]
"""Relations, and each system's figures of them."""
Lines = tuple[np.ndarray, dict[str, np.ndarray]]
"""x, and curves by name."""


def relation_bars(table: Table) -> Bars:
    """The relation table as bars."""
    found = {row.name: [c for c in row.cells if isinstance(c, Estimate)] for row in table.rows}
    return table.columns, {name: cells for name, cells in found.items() if cells}


def overlap_sweep(records: pa.Table) -> Lines:
    """Share of expressions whose answer overlaps an acceptable target by at least x."""
    curves = {}
    names = {"pipeline": "set_iou", "OPM only": "opm_set_iou"} if has_opm(records) else {"whole expression": "set_iou"}
    for label, name in names.items():
        curves[label] = (column(records, name)[None] >= SWEEP[:, None]).mean(axis=1)
    return SWEEP, curves


def by_rivals(records: pa.Table) -> Lines:
    """Accuracy by the number of labelled objects of the target's class; 6 stands for 6 and more."""
    number = np.minimum(column(records, "same_class").astype(int), 6)
    x = np.unique(number)
    curves = {}
    answers = {"pipeline" if has_opm(records) else "whole expression": column(records, "set_correct")}
    if has_opm(records):
        answers["OPM only"] = (column(records, "opm_set_iou") >= 0.5).astype(float)
    for label, right in answers.items():
        curves[label] = np.array([right[number == k].mean() for k in x])
    return x.astype(float), curves


def _tones(rows: Mapping[str, Any]) -> dict[str, str]:
    """A colour for each row of the relation table: the detector alone is pale, each system has its own."""
    systems = [name for name in rows if not name.endswith(OPM_ONLY)]
    own = {name: TONES[k % len(TONES)] for k, name in enumerate(systems)}
    return {name: own.get(name, PALE_TONE) for name in rows}


def _draw_bars(bars: Bars, caveat: str, path: Path) -> Path:
    import matplotlib.pyplot as plt

    relations, systems = bars
    with house_style():
        figure, axes = plt.subplots(figsize=(8, 3.4), dpi=200, layout="constrained")
        width = 0.8 / max(len(systems), 1)
        tones = _tones(systems)
        for k, (name, cells) in enumerate(systems.items()):
            x = np.arange(len(relations)) + (k - (len(systems) - 1) / 2) * width
            value = np.array([100 * c.value for c in cells])
            axes.bar(x, value, width * 0.92, label=name, color=tones[name])
            low, high = (np.array([100 * getattr(c, n) for c in cells]) for n in ("low", "high"))
            known = np.isfinite(low)
            if known.any():
                error = np.stack([value - low, high - value])[:, known].clip(0)
                axes.errorbar(x[known], value[known], error, fmt="none", ecolor="#1f2630", elinewidth=0.8)
        axes.set_xticks(np.arange(len(relations)), relations)
        axes.set_ylim(0, 105)
        axes.set_ylabel("set-valued accuracy (%)")
        axes.set_title(with_caveat("Accuracy by relation, with 95 % intervals", caveat))
        axes.grid(axis="y")
        axes.legend(loc="upper center", bbox_to_anchor=(0.5, -0.1), ncols=2)
        figure.savefig(path)
        plt.close(figure)
    return path


def _draw_lines(curves: Mapping[str, Lines], title: str, x_label: str, y_label: str, path: Path) -> Path:
    import matplotlib.pyplot as plt

    with house_style():
        figure, axes = plt.subplots(figsize=(6, 3.4), dpi=200, layout="constrained")
        for k, (system, (x, lines)) in enumerate(curves.items()):
            for label, y in lines.items():
                style = "--" if label == "OPM only" else "-"
                axes.plot(x, 100 * y, style, color=TONES[k % len(TONES)], label=f"{system}, {label}", marker=".")
        axes.set_ylim(0, 105)
        axes.set_xlabel(x_label)
        axes.set_ylabel(y_label)
        axes.set_title(title)
        axes.grid(axis="y")
        axes.legend(loc="upper center", bbox_to_anchor=(0.5, -0.18), ncols=2)
        figure.savefig(path)
        plt.close(figure)
    return path


def _page(
    bars: Bars,
    sweeps: Mapping[str, Lines],
    rivals: Mapping[str, Lines],
    more: Sequence[Any],
    caveats: str,
    path: Path,
) -> Path:
    """One page that needs no network: the library stands in it."""
    import plotly.graph_objects as go
    from plotly.offline import get_plotlyjs

    relations, systems = bars
    figures: list[Any] = [go.Figure()]
    tones = _tones(systems)
    for name, cells in systems.items():
        value = [100 * c.value for c in cells]
        figures[0].add_bar(
            x=list(relations), y=value, name=name,
            marker_color=tones[name],
            error_y={"type": "data", "array": [100 * c.high - v for c, v in zip(cells, value, strict=True)],
                     "arrayminus": [v - 100 * c.low for c, v in zip(cells, value, strict=True)]},
        )  # fmt: skip
    figures[0].update_layout(title="Accuracy by relation", yaxis_title="set-valued accuracy (%)", barmode="group")
    for curves, title, x_label in (
        (sweeps, "Accuracy by the overlap that is asked for", "overlap (IoU)"),
        (rivals, "Accuracy by how many objects share the target's class", "objects of the class"),
    ):
        figure = go.Figure()
        for k, (system, (x, lines)) in enumerate(curves.items()):
            for label, y in lines.items():
                dash = "dash" if label == "OPM only" else "solid"
                figure.add_scatter(
                    x=x, y=100 * y, name=f"{system}, {label}", line={"color": TONES[k % len(TONES)], "dash": dash}
                )
        figure.update_layout(title=title, xaxis_title=x_label, yaxis_title="set-valued accuracy (%)")
        figures.append(figure)
    figures += more
    parts = []
    for figure in figures:
        figure.update_layout(template="plotly_white", font={"family": "Arial, sans-serif", "size": 13})
        parts.append(figure.to_html(full_html=False, include_plotlyjs=False))
    path.write_text(
        "<!doctype html><html><head><meta charset='utf-8'><title>Evaluation</title>"
        f"<script>{get_plotlyjs()}</script></head><body>{caveats}{''.join(parts)}</body></html>",
        encoding="utf-8",
    )
    return path
