"""What the plots of a run share: colours, bars and shares, still and moving, and the page of the moving ones."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from html import escape
from pathlib import Path
from typing import Any

import numpy as np

from pipeline.evaluation.confusion import Confusion
from pipeline.evaluation.summary import RunSummary
from pipeline.labels.report.style import INK, house_style
from pipeline.metrics.intervals import Estimate

VERDICT_COLORS = {
    "CORRECT": "#009988", "PARSE": "#aa3377", "LABEL": "#b4bdca", "OPM-TARGET": "#cc3311", "OPM-REF": "#ee7733",
    "LIFT": "#0077bb", "SRM": "#33bbee", "OPM-CONF": "#ddaa33", "PRM": "#ee3377", "COMPOUND": "#46536a",
}  # fmt: skip
LOSS_COLORS = {
    "accuracy": VERDICT_COLORS["CORRECT"], "PARSE": VERDICT_COLORS["PARSE"], "RECALL": VERDICT_COLORS["OPM-TARGET"],
    "LIFT": VERDICT_COLORS["LIFT"], "SRM": VERDICT_COLORS["SRM"], "CONF": VERDICT_COLORS["OPM-CONF"],
    "residual": VERDICT_COLORS["COMPOUND"],
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


def draw_bars(
    bars: Bars, tones: Mapping[str, str], title: str, y_label: str, path: Path, height: float = 3.6
) -> Path:
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
        axes.set_ylim(0, 105)
        axes.set_ylabel(y_label)
        axes.set_title(title)
        axes.grid(axis="y")
        axes.legend(loc="upper center", bbox_to_anchor=(0.5, -0.1), ncols=2)
    return path


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


def write_figures(parts: Iterable[Any], title: str, path: Path, caveats: str = "", style: str = "") -> Path:
    """One page that needs no network, as the library stands in it: figures, and HTML between them; `caveats` on top."""
    from plotly.offline import get_plotlyjs

    shown = []
    for part in parts:
        if not isinstance(part, str):
            part.update_layout(template="plotly_white", font={"family": "Arial, sans-serif", "size": 13})
            part = part.to_html(full_html=False, include_plotlyjs=False)
        shown.append(part)
    path.write_text(
        f"<!doctype html><html><head><meta charset='utf-8'><title>{title}</title>{style}"
        f"<script>{get_plotlyjs()}</script></head><body>{caveats}{''.join(shown)}</body></html>",
        encoding="utf-8",
    )
    return path
