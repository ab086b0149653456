"""The plots of a diagnosis as one page to move about in, which needs no network."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from pipeline.diagnosis.verdict import VERDICTS
from pipeline.evaluation.confusion import Confusion
from pipeline.evaluation.plot_parts import ADDS_UP, LOSS_COLORS, VERDICT_COLORS, interval, shares_of_rows, waterfall
from pipeline.evaluation.slices import Slices
from pipeline.evaluation.summary import RunSummary, residual_words
from pipeline.language.relation_names import PHRASE
from pipeline.metrics.intervals import Estimate


def write_page(
    summaries: Mapping[str, RunSummary],
    slices: Sequence[Slices],
    confusions: Sequence[Confusion],
    path: Path,
    caveats: str = "",
) -> Path:
    """Write `diagnosis.html`, the `caveats` at its top; every bar says the search that finds its expressions."""
    from plotly.offline import get_plotlyjs

    parts = []
    if summaries:
        parts.append(_html(_verdicts(summaries)))
        for name, summary in summaries.items():
            parts.append(_html(_oracles(name, summary)))
            parts.append(_paragraph(f"{ADDS_UP} {name}: {residual_words(summary)}."))
    for cut in slices:
        for system in dict.fromkeys(s.system for s in cut.slices if s.verdicts):
            parts.append(_html(_slices(system, cut)))
    for found in confusions:
        parts.append(_html(_confusion(found)))
        parts.append(_paragraph(found.note))
    path.write_text(
        "<!doctype html><html><head><meta charset='utf-8'><title>Diagnosis</title>"
        "<style>body{font-family:Arial,sans-serif;max-width:1100px;margin:auto}p{color:#5b6470;font-size:13px}</style>"
        f"<script>{get_plotlyjs()}</script></head><body>{caveats}{''.join(parts)}</body></html>",
        encoding="utf-8",
    )
    return path


def _html(figure: Any) -> str:
    figure.update_layout(template="plotly_white", font={"family": "Arial, sans-serif", "size": 13})
    return figure.to_html(full_html=False, include_plotlyjs=False)


def _paragraph(text: str) -> str:
    from html import escape

    return f"<p>{escape(text)}</p>"


def _plain(text: str) -> str:
    """Plotly reads some HTML in names."""
    from html import escape

    return escape(text, quote=False)


def _errors(estimates: Sequence[Estimate]) -> dict[str, Any]:
    reach = [interval(e) for e in estimates]
    return {"type": "data", "array": [above for _, above in reach], "arrayminus": [below for below, _ in reach]}


def _verdicts(summaries: Mapping[str, RunSummary]) -> Any:
    import plotly.graph_objects as go

    figure = go.Figure()
    for name, summary in summaries.items():
        shares = [summary.verdicts[v] for v in VERDICTS]
        figure.add_bar(
            x=list(VERDICTS), y=[100 * s.estimate.value for s in shares], name=_plain(name),
            marker_color=[VERDICT_COLORS[v] for v in VERDICTS], error_y=_errors([s.estimate for s in shares]),
            customdata=[[s.count, f"verdict:{v}"] for v, s in zip(VERDICTS, shares, strict=True)],
            hovertemplate="%{x}: %{y:.1f} %<br>%{customdata[0]} expressions<br>search: %{customdata[1]}",
        )  # fmt: skip
    figure.update_layout(title="Verdicts", yaxis_title="share of expressions (%)", barmode="group", showlegend=False)
    return figure


def _oracles(name: str, summary: RunSummary) -> Any:
    import plotly.graph_objects as go

    bars = waterfall(summary)
    figure = go.Figure()
    figure.add_bar(
        x=[k for k, _, _ in bars], y=[100 * e.value for _, _, e in bars], base=[100 * s for _, s, _ in bars],
        marker_color=[LOSS_COLORS[k] for k, _, _ in bars], error_y=_errors([e for _, _, e in bars]),
        name="Shapley: adds up", offsetgroup="0", customdata=[e.formatted() for _, _, e in bars],
        hovertemplate="%{x}: %{customdata}",
    )  # fmt: skip
    single = summary.deltas.single
    figure.add_bar(
        x=list(single), y=[100 * e.value for e in single.values()], base=100 * float(summary.deltas.value[0]),
        marker={"color": "rgba(0,0,0,0)", "line": {"color": [LOSS_COLORS[k] for k in single], "width": 2}},
        error_y=_errors(list(single.values())), name="alone: does not add up", offsetgroup="1",
        customdata=[e.formatted(signed=True) for e in single.values()], hovertemplate="%{x} alone: %{customdata}",
    )  # fmt: skip
    figure.update_layout(
        title=f"What each module costs: {_plain(name)}", yaxis_title="set-valued accuracy (%)", barmode="group"
    )
    return figure


def _slices(system: str, cut: Slices) -> Any:
    import plotly.graph_objects as go

    rows = [s for s in cut.slices if s.system == system]
    figure = go.Figure()
    for verdict in VERDICTS:
        if not any(s.counts[verdict] for s in rows):
            continue
        search = [
            "–" if s.query is None else " ".join([*([s.query] if s.query else []), f"verdict:{verdict}"]) for s in rows
        ]
        figure.add_bar(
            x=[_plain(s.name) for s in rows], y=[100 * s.verdicts[verdict].value for s in rows], name=verdict,
            marker_color=VERDICT_COLORS[verdict],
            customdata=[
                [s.counts[verdict], s.n, _plain(q), s.set_correct.formatted()]
                for s, q in zip(rows, search, strict=True)
            ],
            hovertemplate="%{x}: %{y:.1f} % " + verdict + "<br>%{customdata[0]} of %{customdata[1]} expressions"
            "<br>set-valued accuracy %{customdata[3]}<br>search: %{customdata[2]}",
        )  # fmt: skip
    figure.update_layout(
        title=f"Verdicts by {cut.dimension.title}: {_plain(system)}", yaxis_title="share (%)", barmode="stack",
        xaxis={"type": "category"},
    )  # fmt: skip
    return figure


def _confusion(found: Confusion) -> Any:
    import plotly.graph_objects as go

    figure = go.Figure(
        go.Heatmap(
            z=100 * shares_of_rows(found), x=[PHRASE.get(c, c) for c in found.columns],
            y=[PHRASE.get(r, r) for r in found.rows], text=found.counts, texttemplate="%{text}", colorscale="Blues",
            zmin=0, zmax=100, hovertemplate="%{y} → %{x}: %{text} (%{z:.1f} %)<extra></extra>",
        )
    )  # fmt: skip
    figure.update_layout(title=_plain(found.title), yaxis={"autorange": "reversed"})
    return figure
