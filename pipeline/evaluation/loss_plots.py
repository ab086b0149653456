"""Pictures of a diagnosis: verdicts, what each module costs, slices, confusions; and one page with all of them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from pipeline.diagnosis.oracles import shown_oracle
from pipeline.diagnosis.verdict import VERDICTS, shown_verdicts
from pipeline.evaluation.confusion import Confusion
from pipeline.evaluation.costs import Deltas
from pipeline.evaluation.plots import Page, interval, tip
from pipeline.evaluation.slices import Slices
from pipeline.evaluation.summary import RunSummary, Share, residual_words, untold_words
from pipeline.labels.report.style import FULL, INK, QUIET, short
from pipeline.language.relation_names import PHRASE
from pipeline.metrics.intervals import Estimate

SHOWN = ("relation", "class", "distance", "size", "occlusion", "same_class", "label_margin")
MOST_SHOWN = 12
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
_NONE = Share(0, Estimate(0.0, 0.0, 0.0, 0, 0))


def draw_diagnosis(
    summaries: Mapping[str, RunSummary],
    slices: Sequence[Slices],
    confusions: Sequence[Confusion],
    out: Path,
    caveats: str = "",
    caveat: str = "",
) -> None:
    """Write `verdicts.png`, `oracles.png`, `slices.png`, `confusion….png` and `diagnosis.html`.

    Pictures are of the first system; the page has those of all, and every slice. Without verdicts, only confusions are
    drawn.

    Parameters
    ----------
    out : Path
        A folder, made where it is missing.
    caveats : str
        HTML that stands above all.
    caveat : str
        What the figures are where truth and systems have a maker in common: before what stands below each title.
    """
    out.mkdir(parents=True, exist_ok=True)
    page = Page(out, caveat)
    if summaries:
        _verdicts(page, summaries)
    for k, (name, summary) in enumerate(summaries.items()):
        if (costs := summary.deltas) is not None:
            _oracles(page, "" if k else "oracles", name, summary, costs)
        _slices(page, "" if k else "slices", name, [s for s in slices if s.dimension.name in SHOWN])
        _slices(page, "", name, [s for s in slices if s.dimension.name not in SHOWN])
    for found in confusions:
        _confusion(page, found)
    page.write("diagnosis.html", "Diagnosis", caveats)


def _verdicts(page: Page, summaries: Mapping[str, RunSummary]) -> None:
    kinds = shown_verdicts({v for s in summaries.values() for v in s.verdicts})
    note = (
        "Share of expressions, which sums to 100 %, with 95 % intervals. CORRECT is the labelled target; LABEL is "
        "mostly another right answer."
    )
    size = (FULL, 90 + 34 * len(kinds) * len(summaries))
    with page.picture("verdicts", size, "Verdicts on every expression", note) as figure:
        axes = figure.add_subplot()
        height = 0.8 / len(summaries)
        y = np.arange(len(kinds))
        for k, (name, summary) in enumerate(summaries.items()):
            at = y + (k - (len(summaries) - 1) / 2) * height
            for where, verdict in zip(at, kinds, strict=True):
                share = summary.verdicts.get(verdict, _NONE)
                value, reach = 100 * share.estimate.value, interval(share.estimate)
                told = tip(name, f"{verdict}: {value:.1f} %", f"{share.count} expressions", f"search verdict:{verdict}")
                color, alpha = VERDICT_COLORS[verdict], 1 - 0.5 * (k > 0)
                axes.barh(where, value, height * 0.9, color=color, alpha=alpha, gid=told)
                axes.errorbar(value, where, xerr=[[r] for r in reach], fmt="none", ecolor=INK, elinewidth=0.8)
                text = f"{short(name)}: {share.count}" if len(summaries) > 1 else f"{share.count}"
                axes.text(value + reach[1] + 0.8, where, text, va="center", fontsize=8.5, color=QUIET)
        axes.set_yticks(y, kinds)
        axes.invert_yaxis()
        axes.set(xlim=(0, 105), xlabel="share of expressions (%)")
        axes.grid(axis="x")


def _oracles(page: Page, file: str, name: str, summary: RunSummary, costs: Deltas) -> None:
    left = residual_words(summary)
    note = f"{ADDS_UP} {left[0].upper()}{left[1:]}. {untold_words(summary)}".strip()
    with page.picture(file, (FULL, 380), f"What each module costs: {name}", note) as figure:
        axes = figure.add_subplot()
        base, begin, least, ticks = 100 * float(costs.value[0]), 0.0, 100.0, list[str]()
        for x, (key, estimate) in enumerate(summary.loss.items()):
            ticks.append("as answered" if key == "accuracy" else _named(key).replace(", ", "\n"))
            sign = key not in ("accuracy", "residual", "unknown")
            _cost(axes, x - 0.18, 0.36, begin, estimate, key, estimate.formatted(signed=sign), color=LOSS_COLORS[key])
            end = begin + 100 * estimate.value
            if (single := costs.single.get(key)) is not None:
                hollow = {"fill": False, "edgecolor": LOSS_COLORS[key], "linewidth": 1.4}
                _cost(axes, x + 0.2, 0.3, base, single, key, f"alone {single.formatted(signed=True)}", **hollow)
                least = min(least, base + 100 * single.value)
            least, begin = min(least, end, begin if x else end), end
        start = max(0.0, least - 10)
        axes.set_xticks(range(len(ticks)), ticks)
        axes.set(ylim=(start, 104), ylabel=f"set-valued accuracy (%){f', from {start:.0f} on' if start else ''}")
        axes.grid(axis="y")


def _cost(axes: Any, x: float, width: float, base: float, e: Estimate, key: str, said: str, **look: Any) -> None:
    """Draw a bar of the costs with its interval and its figure."""
    below, above = interval(e)
    axes.bar(x, 100 * e.value, width, base, gid=tip(f"{_named(key)}: {said}"), **look)
    axes.errorbar(x, base + 100 * e.value, [[below], [above]], ecolor=INK, elinewidth=0.8, fmt="none")
    top = base + 100 * max(e.value, 0) + above + 0.4
    axes.text(x, top, said.split(" [")[0], ha="center", va="bottom", fontsize=8.5, color=QUIET)


def _named(key: str) -> str:
    """Name of a bar of the costs."""
    return {"unknown": "not worked out", "accuracy": "accuracy"}.get(key) or shown_oracle(key)


def _slices(page: Page, file: str, system: str, chosen: Sequence[Slices]) -> None:
    lines = (len(chosen) + 1) // 2
    note = (
        "Shares of each part sum to 100 %. The number of expressions stands beside its bar; LABEL is mostly another "
        "right answer."
    )
    with page.picture(file, (FULL, 300 * lines), f"Verdicts by part of the run: {system}", note) as figure:
        seen: dict[str, Any] = {}
        for index, cut in enumerate(chosen):
            axes = figure.add_subplot(lines, 2, index + 1)
            rows = [s for s in cut.slices if s.system == system][:MOST_SHOWN]
            for k, row in enumerate(rows):
                left = 0.0
                for verdict in (v for v in VERDICTS if v in row.verdicts):
                    share = 100 * row.verdicts[verdict].value
                    search = "–" if row.query is None else f"{row.query} verdict:{verdict}".strip()
                    told = tip(f"{row.name}: {share:.1f} % {verdict}", f"{row.counts[verdict]} of {row.n} expressions",
                               f"set-valued accuracy {row.set_correct.formatted()}", f"search {search}")  # fmt: skip
                    if share:
                        seen[verdict] = axes.barh(k, share, 0.78, left, color=VERDICT_COLORS[verdict], gid=told)
                    left += share
                axes.text(101, k, str(row.n), va="center", fontsize=8, color=QUIET)
            axes.set_yticks(range(len(rows)), [short(s.name, 18) for s in rows])
            axes.invert_yaxis()
            axes.set(xticks=[0, 25, 50, 75, 100], xlim=(0, 110), title=cut.dimension.title)
        ordered = [v for v in VERDICTS if v in seen]
        figure.legend([seen[v] for v in ordered], ordered, loc="outside lower center", ncols=len(ordered))


def _confusion(page: Page, found: Confusion) -> None:
    total = found.counts.sum(axis=1, keepdims=True)
    shares = np.divide(found.counts, total, out=np.zeros(found.counts.shape), where=total > 0)
    rows, columns = ([PHRASE.get(name, name) for name in names] for names in (found.rows, found.columns))
    with page.picture(found.key, (FULL, 90 + 36 * len(rows)), found.title, found.note) as figure:
        axes = figure.add_subplot()
        axes.imshow(shares, cmap="Blues", vmin=0, vmax=1, aspect="auto")
        for i, j in zip(*np.nonzero(found.counts), strict=True):
            told = tip(f"{rows[i]} → {columns[j]}: {found.counts[i, j]}", f"{shares[i, j]:.1%}")
            look = {"ha": "center", "va": "center", "fontsize": 8.5, "color": "white" if shares[i, j] > 0.5 else INK}
            axes.text(j, i, str(found.counts[i, j]), gid=told, **look)
        axes.set_xticks(range(len(columns)), columns, rotation=30, ha="right")
        axes.set_yticks(range(len(rows)), rows)
        axes.spines[:].set_visible(False)
