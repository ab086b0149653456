"""Pictures of a diagnosis: verdicts, what each module costs, slices, confusions; and one page with all of them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from html import escape
from pathlib import Path
from typing import Any

import numpy as np

from pipeline.diagnosis.oracles import shown_oracle
from pipeline.diagnosis.verdict import VERDICTS, shown_verdicts
from pipeline.evaluation.confusion import Confusion
from pipeline.evaluation.costs import Deltas
from pipeline.evaluation.plots import (
    ADDS_UP,
    LOSS_COLORS,
    VERDICT_COLORS,
    interval,
    moving_figure,
    plain,
    shares_of_rows,
    waterfall,
    write_figures,
)
from pipeline.evaluation.slices import Slices
from pipeline.evaluation.summary import RunSummary, Share, residual_words, untold_words
from pipeline.labels.report.style import FULL, INK, QUIET, house_style, new_figure, save_figure, short
from pipeline.language.relation_names import PHRASE
from pipeline.metrics.intervals import Estimate

_STYLE = "<style>body{font-family:Arial,sans-serif;max-width:1100px;margin:auto}p{color:#5b6470;font-size:13px}</style>"

SHOWN = ("relation", "class", "distance", "size", "occlusion", "same_class", "label_margin")
MOST_SHOWN = 12


def draw_diagnosis(
    summaries: Mapping[str, RunSummary],
    slices: Sequence[Slices],
    confusions: Sequence[Confusion],
    out: Path,
    caveats: str = "",
    caveat: str = "",
) -> None:
    """Write `verdicts.png`, `oracles.png`, `slices.png`, `confusion….png` and `diagnosis.html`.

    Without verdicts, only confusions are drawn.

    Parameters
    ----------
    summaries : mapping of str to RunSummary
    slices : sequence of Slices
    confusions : sequence of Confusion
    out : Path
        A folder, made where it is missing.
    caveats : str
        HTML that stands above all.
    caveat : str
        What the figures are where truth and systems have a maker in common: before what stands below each title.
    """
    out.mkdir(parents=True, exist_ok=True)
    above = f"{caveat[0].upper()}{caveat[1:]}. " if caveat else ""
    with house_style():
        if summaries:
            first = next(iter(summaries))
            _verdicts(summaries, above, out / "verdicts.png")
            if (costs := summaries[first].deltas) is not None:
                _oracles(first, summaries[first], costs, above, out / "oracles.png")
            _slices(first, slices, above, out / "slices.png")
        for found in confusions:
            _confusion(found, above, out / f"{found.key}.png")
    write_page(summaries, slices, confusions, out / "diagnosis.html", caveats)


_NONE = Share(0, Estimate(0.0, 0.0, 0.0, 0, 0))


def _verdicts(summaries: Mapping[str, RunSummary], above: str, path: Path) -> None:
    kinds = shown_verdicts({v for s in summaries.values() for v in s.verdicts})
    figure = new_figure(
        FULL, 90 + 34 * len(kinds) * len(summaries),
        "Verdicts on every expression",
        f"{above}Share of expressions, which sums to 100 %, with 95 % intervals. CORRECT is the labelled target; "
        "LABEL is mostly another right answer.",
    )  # fmt: skip
    axes = figure.add_subplot()
    height = 0.8 / len(summaries)
    y = np.arange(len(kinds))
    for k, (name, summary) in enumerate(summaries.items()):
        shares = [summary.verdicts.get(v, _NONE) for v in kinds]
        value = np.array([100 * s.estimate.value for s in shares])
        at = y + (k - (len(summaries) - 1) / 2) * height
        axes.barh(at, value, height * 0.9, color=[VERDICT_COLORS[v] for v in kinds], alpha=1 - 0.5 * (k > 0))
        axes.errorbar(
            value, at, xerr=np.array([interval(s.estimate) for s in shares]).T, fmt="none", ecolor=INK, elinewidth=0.8
        )
        for index, share in zip(at, shares, strict=True):
            text = f"{short(name)}: {share.count}" if len(summaries) > 1 else f"{share.count}"
            end = 100 * share.estimate.value + interval(share.estimate)[1]
            axes.text(end + 0.8, index, text, va="center", fontsize=8.5, color=QUIET)
    axes.set_yticks(y, kinds)
    axes.invert_yaxis()
    axes.set(xlim=(0, 105), xlabel="share of expressions (%)")
    axes.grid(axis="x")
    save_figure(figure, path)


def _oracles(name: str, summary: RunSummary, costs: Deltas, caveat: str, path: Path) -> None:
    figure = new_figure(FULL, 380, f"What each module costs: {name}", caveat + ADDS_UP)
    axes = figure.add_subplot()
    bars = waterfall(summary)
    for x, (key, start, estimate) in enumerate(bars):
        axes.bar(x - 0.18, 100 * estimate.value, 0.36, 100 * start, color=LOSS_COLORS[key])
        below, above = interval(estimate)
        end = 100 * (start + estimate.value)
        axes.errorbar(x - 0.18, end, [[below], [above]], ecolor=INK, elinewidth=0.8, fmt="none")
        sign = key not in ("accuracy", "residual", "unknown")
        axes.text(
            x - 0.18, max(end, 100 * start) + above + 0.4, estimate.formatted(signed=sign).split(" [")[0],
            ha="center", va="bottom", fontsize=9,
        )  # fmt: skip
        single = costs.single.get(key)
        if single is not None:
            base = 100 * float(costs.value[0])
            axes.bar(x + 0.2, 100 * single.value, 0.3, base, fill=False, edgecolor=LOSS_COLORS[key], linewidth=1.4)
            low, high = interval(single)
            axes.errorbar(x + 0.2, base + 100 * single.value, [[low], [high]], ecolor=QUIET, elinewidth=0.8, fmt="none")
            axes.text(
                x + 0.2, base + 100 * max(single.value, 0) + high + 0.4,
                f"alone {single.formatted(signed=True).split(' [')[0]}", ha="center", va="bottom", fontsize=8,
                color=QUIET,
            )  # fmt: skip
    least = min(100 * min(s, s + e.value) for _, s, e in bars[1:])
    alone = min((100 * (costs.value[0] + e.value) for e in costs.single.values()), default=least)
    start = max(0.0, min(least, alone) - 10)
    axes.set_xticks(range(len(bars)), ["as answered", *(_named(k).replace(", ", "\n") for k, _, _ in bars[1:])])
    axes.set(ylim=(start, 104), ylabel=f"set-valued accuracy (%){f', from {start:.0f} on' if start else ''}")
    axes.grid(axis="y")
    save_figure(figure, path)


def _named(key: str) -> str:
    """What a bar of the costs is called."""
    return "not worked out" if key == "unknown" else shown_oracle(key)


def _slices(system: str, slices: Sequence[Slices], above: str, path: Path) -> None:
    chosen = [s for s in slices if s.dimension.name in SHOWN]
    figure = new_figure(
        FULL, 300 * ((len(chosen) + 1) // 2),
        f"Verdicts by part of the run: {system}",
        f"{above}Shares of each part sum to 100 %. The number of expressions stands beside its bar; LABEL is mostly "
        "another right answer.",
    )  # fmt: skip
    seen: dict[str, Any] = {}
    for index, cut in enumerate(chosen):
        axes = figure.add_subplot((len(chosen) + 1) // 2, 2, index + 1)
        rows = [s for s in cut.slices if s.system == system][:MOST_SHOWN]
        left = np.zeros(len(rows))
        for verdict in VERDICTS:
            share = np.array([100 * s.verdicts[verdict].value if verdict in s.verdicts else 0.0 for s in rows])
            if share.any():
                seen[verdict] = axes.barh(range(len(rows)), share, 0.78, left, color=VERDICT_COLORS[verdict])
            left += share
        for k, row in enumerate(rows):
            axes.text(101, k, str(row.n), va="center", fontsize=8, color=QUIET)
        axes.set_yticks(range(len(rows)), [short(s.name, 18) for s in rows])
        axes.invert_yaxis()
        axes.set(xticks=[0, 25, 50, 75, 100], xlim=(0, 110), title=cut.dimension.title)
    ordered = [v for v in VERDICTS if v in seen]
    figure.legend([seen[v] for v in ordered], ordered, loc="outside lower center", ncols=len(ordered))
    save_figure(figure, path)


def _confusion(found: Confusion, above: str, path: Path) -> None:
    figure = new_figure(FULL, 90 + 36 * len(found.rows), found.title, above + found.note)
    axes = figure.add_subplot()
    shares = shares_of_rows(found)
    axes.imshow(shares, cmap="Blues", vmin=0, vmax=1, aspect="auto")
    for i, j in zip(*np.nonzero(found.counts), strict=True):
        axes.text(
            j, i, str(found.counts[i, j]), ha="center", va="center", fontsize=8.5,
            color="white" if shares[i, j] > 0.5 else INK,
        )  # fmt: skip
    axes.set_xticks(range(len(found.columns)), [PHRASE.get(c, c) for c in found.columns], rotation=30, ha="right")
    axes.set_yticks(range(len(found.rows)), [PHRASE.get(r, r) for r in found.rows])
    axes.spines[:].set_visible(False)
    save_figure(figure, path)


def write_page(
    summaries: Mapping[str, RunSummary],
    slices: Sequence[Slices],
    confusions: Sequence[Confusion],
    path: Path,
    caveats: str = "",
) -> None:
    """Write `diagnosis.html`, the `caveats` at its top; every bar says the search that finds its expressions."""
    parts: list[Any] = []
    if summaries:
        parts.append(_verdicts_figure(summaries))
        for name, summary in summaries.items():
            if (costs := summary.deltas) is not None:
                words = f"{ADDS_UP} {name}: {residual_words(summary)}. {untold_words(summary)}"
                parts += [_oracles_figure(name, summary, costs), _paragraph(words)]
    for cut in slices:
        parts += [_slices_figure(system, cut) for system in dict.fromkeys(s.system for s in cut.slices if s.verdicts)]
    for found in confusions:
        parts += [_confusion_figure(found), _paragraph(found.note)]
    write_figures(parts, "Diagnosis", path, caveats, _STYLE)


def _paragraph(text: str) -> str:
    return f"<p>{escape(text)}</p>"


def _errors(estimates: Sequence[Estimate]) -> dict[str, Any]:
    reach = [interval(e) for e in estimates]
    return {"type": "data", "array": [above for _, above in reach], "arrayminus": [below for below, _ in reach]}


def _verdicts_figure(summaries: Mapping[str, RunSummary]) -> Any:
    figure = moving_figure()
    for name, summary in summaries.items():
        kinds, shares = list(summary.verdicts), list(summary.verdicts.values())
        figure.add_bar(
            x=kinds, y=[100 * s.estimate.value for s in shares], name=plain(name),
            marker_color=[VERDICT_COLORS[v] for v in kinds], error_y=_errors([s.estimate for s in shares]),
            customdata=[[s.count, f"verdict:{v}"] for v, s in zip(kinds, shares, strict=True)],
            hovertemplate="%{x}: %{y:.1f} %<br>%{customdata[0]} expressions<br>search: %{customdata[1]}",
        )  # fmt: skip
    return figure.update_layout(
        title="Verdicts", yaxis_title="share of expressions (%)", barmode="group", showlegend=False
    )


def _oracles_figure(name: str, summary: RunSummary, costs: Deltas) -> Any:
    bars = waterfall(summary)
    figure = moving_figure()
    figure.add_bar(
        x=[_named(k) for k, _, _ in bars], y=[100 * e.value for _, _, e in bars], base=[100 * s for _, s, _ in bars],
        marker_color=[LOSS_COLORS[k] for k, _, _ in bars], error_y=_errors([e for _, _, e in bars]),
        name="Shapley: adds up", offsetgroup="0", customdata=[e.formatted() for _, _, e in bars],
        hovertemplate="%{x}: %{customdata}",
    )  # fmt: skip
    single = costs.single
    figure.add_bar(
        x=[_named(k) for k in single], y=[100 * e.value for e in single.values()], base=100 * float(costs.value[0]),
        marker={"color": "rgba(0,0,0,0)", "line": {"color": [LOSS_COLORS[k] for k in single], "width": 2}},
        error_y=_errors(list(single.values())), name="alone: does not add up", offsetgroup="1",
        customdata=[e.formatted(signed=True) for e in single.values()], hovertemplate="%{x} alone: %{customdata}",
    )  # fmt: skip
    return figure.update_layout(
        title=f"What each module costs: {plain(name)}", yaxis_title="set-valued accuracy (%)", barmode="group"
    )


def _slices_figure(system: str, cut: Slices) -> Any:
    rows = [s for s in cut.slices if s.system == system]
    figure = moving_figure()
    for verdict in VERDICTS:
        if not any(s.counts.get(verdict) for s in rows):
            continue
        search = [
            "–" if s.query is None else " ".join([*([s.query] if s.query else []), f"verdict:{verdict}"]) for s in rows
        ]
        figure.add_bar(
            x=[plain(s.name) for s in rows], y=[100 * s.verdicts[verdict].value for s in rows], name=verdict,
            marker_color=VERDICT_COLORS[verdict],
            customdata=[
                [s.counts[verdict], s.n, plain(q), s.set_correct.formatted()]
                for s, q in zip(rows, search, strict=True)
            ],
            hovertemplate="%{x}: %{y:.1f} % " + verdict + "<br>%{customdata[0]} of %{customdata[1]} expressions"
            "<br>set-valued accuracy %{customdata[3]}<br>search: %{customdata[2]}",
        )  # fmt: skip
    return figure.update_layout(
        title=f"Verdicts by {cut.dimension.title}: {plain(system)}", yaxis_title="share (%)", barmode="stack",
        xaxis={"type": "category"},
    )  # fmt: skip


def _confusion_figure(found: Confusion) -> Any:
    figure = moving_figure()
    figure.add_heatmap(
        z=100 * shares_of_rows(found), x=[PHRASE.get(c, c) for c in found.columns],
        y=[PHRASE.get(r, r) for r in found.rows], text=found.counts, texttemplate="%{text}", colorscale="Blues",
        zmin=0, zmax=100, hovertemplate="%{y} → %{x}: %{text} (%{z:.1f} %)<extra></extra>",
    )  # fmt: skip
    return figure.update_layout(title=plain(found.title), yaxis={"autorange": "reversed"})
