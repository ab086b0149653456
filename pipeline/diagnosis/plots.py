"""Pictures of a diagnosis: verdicts, what each module costs, slices, confusions; and one page with all of them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from pipeline.diagnosis.confusion import Confusion
from pipeline.diagnosis.slices import Slices
from pipeline.diagnosis.summary import RunSummary
from pipeline.diagnosis.verdict import VERDICTS
from pipeline.evaluation.intervals import Estimate
from pipeline.labels.report.style import FULL, INK, QUIET, new_figure, save_figure, short
from pipeline.relations import PHRASE

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
SHOWN = ("relation", "class", "distance", "size", "occlusion", "same_class", "label_margin")
MOST_SHOWN = 12


def draw_diagnosis(
    summaries: Mapping[str, RunSummary],
    slices: Sequence[Slices],
    confusions: Sequence[Confusion],
    out: Path,
    caveats: str = "",
    caveat: str = "",
) -> list[Path]:
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
    from pipeline.diagnosis.plots_page import write_page
    from pipeline.labels.report.style import house_style

    out.mkdir(parents=True, exist_ok=True)
    written = []
    above = f"{caveat[0].upper()}{caveat[1:]}. " if caveat else ""
    with house_style():
        if summaries:
            first = next(iter(summaries))
            written += [
                _verdicts(summaries, above, out / "verdicts.png"),
                _oracles(first, summaries[first], above, out / "oracles.png"),
                _slices(first, slices, above, out / "slices.png"),
            ]
        written += [_confusion(c, above, out / f"{c.key}.png") for c in confusions]
    written.append(write_page(summaries, slices, confusions, out / "diagnosis.html", caveats))
    return written


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


def _verdicts(summaries: Mapping[str, RunSummary], above: str, path: Path) -> Path:
    figure = new_figure(
        FULL, 90 + 34 * len(VERDICTS) * len(summaries),
        "Verdicts on every expression",
        f"{above}Share of expressions, which sums to 100 %, with 95 % intervals. CORRECT is the labelled target; "
        "LABEL is mostly another right answer.",
    )  # fmt: skip
    axes = figure.add_subplot()
    height = 0.8 / len(summaries)
    y = np.arange(len(VERDICTS))
    for k, (name, summary) in enumerate(summaries.items()):
        shares = [summary.verdicts[v] for v in VERDICTS]
        value = np.array([100 * s.estimate.value for s in shares])
        at = y + (k - (len(summaries) - 1) / 2) * height
        axes.barh(at, value, height * 0.9, color=[VERDICT_COLORS[v] for v in VERDICTS], alpha=1 - 0.5 * (k > 0))
        axes.errorbar(
            value, at, xerr=np.array([interval(s.estimate) for s in shares]).T, fmt="none", ecolor=INK, elinewidth=0.8
        )
        for place, share in zip(at, shares, strict=True):
            said = f"{short(name)}: {share.count}" if len(summaries) > 1 else f"{share.count}"
            end = 100 * share.estimate.value + interval(share.estimate)[1]
            axes.text(end + 0.8, place, said, va="center", fontsize=8.5, color=QUIET)
    axes.set_yticks(y, VERDICTS)
    axes.invert_yaxis()
    axes.set_xlim(0, 105)
    axes.set_xlabel("share of expressions (%)")
    axes.grid(axis="x")
    save_figure(figure, path)
    return path


def _oracles(name: str, summary: RunSummary, caveat: str, path: Path) -> Path:
    figure = new_figure(FULL, 380, f"What each module costs: {name}", caveat + ADDS_UP)
    axes = figure.add_subplot()
    bars = waterfall(summary)
    for x, (key, start, estimate) in enumerate(bars):
        axes.bar(x - 0.18, 100 * estimate.value, 0.36, 100 * start, color=LOSS_COLORS[key])
        below, above = interval(estimate)
        end = 100 * (start + estimate.value)
        axes.errorbar(x - 0.18, end, [[below], [above]], ecolor=INK, elinewidth=0.8, fmt="none")
        sign = key not in ("accuracy", "residual")
        axes.text(
            x - 0.18, max(end, 100 * start) + above + 0.4, estimate.formatted(signed=sign).split(" [")[0],
            ha="center", va="bottom", fontsize=9,
        )  # fmt: skip
        single = summary.deltas.single.get(key)
        if single is not None:
            base = 100 * float(summary.deltas.value[0])
            axes.bar(x + 0.2, 100 * single.value, 0.3, base, fill=False, edgecolor=LOSS_COLORS[key], linewidth=1.4)
            low, high = interval(single)
            axes.errorbar(x + 0.2, base + 100 * single.value, [[low], [high]], ecolor=QUIET, elinewidth=0.8, fmt="none")
            axes.text(
                x + 0.2, base + 100 * max(single.value, 0) + high + 0.4,
                f"alone {single.formatted(signed=True).split(' [')[0]}", ha="center", va="bottom", fontsize=8,
                color=QUIET,
            )  # fmt: skip
    least = min(100 * min(s, s + e.value) for _, s, e in bars[1:])
    alone = min((100 * (summary.deltas.value[0] + e.value) for e in summary.deltas.single.values()), default=least)
    start = max(0.0, min(least, alone) - 10)
    axes.set_ylim(start, 104)
    axes.set_xticks(range(len(bars)), ["as answered", *(k for k, _, _ in bars[1:])])
    axes.set_ylabel(f"set-valued accuracy (%){f', from {start:.0f} on' if start else ''}")
    axes.grid(axis="y")
    save_figure(figure, path)
    return path


def _slices(system: str, slices: Sequence[Slices], above: str, path: Path) -> Path:
    chosen = [s for s in slices if s.dimension.name in SHOWN]
    figure = new_figure(
        FULL, 300 * ((len(chosen) + 1) // 2),
        f"Verdicts by part of the run: {system}",
        f"{above}Shares of each part sum to 100 %. The number of expressions stands beside its bar; LABEL is mostly "
        "another right answer.",
    )  # fmt: skip
    seen: dict[str, Any] = {}
    for place, cut in enumerate(chosen):
        axes = figure.add_subplot((len(chosen) + 1) // 2, 2, place + 1)
        rows = [s for s in cut.slices if s.system == system][:MOST_SHOWN]
        left = np.zeros(len(rows))
        for verdict in VERDICTS:
            share = np.array([100 * s.verdicts[verdict].value if s.verdicts else 0.0 for s in rows])
            if share.any():
                seen[verdict] = axes.barh(range(len(rows)), share, 0.78, left, color=VERDICT_COLORS[verdict])
            left += share
        for k, row in enumerate(rows):
            axes.text(101, k, str(row.n), va="center", fontsize=8, color=QUIET)
        axes.set_yticks(range(len(rows)), [short(s.name, 18) for s in rows])
        axes.invert_yaxis()
        axes.set_xlim(0, 110)
        axes.set_xticks([0, 25, 50, 75, 100])
        axes.set_title(cut.dimension.title)
    ordered = [v for v in VERDICTS if v in seen]
    figure.legend([seen[v] for v in ordered], ordered, loc="outside lower center", ncols=len(ordered))
    save_figure(figure, path)
    return path


def shares_of_rows(found: Confusion) -> np.ndarray:
    """(R, C) counts as shares of their row; 0 in an empty row."""
    total = found.counts.sum(axis=1, keepdims=True)
    return np.divide(found.counts, total, out=np.zeros(found.counts.shape), where=total > 0)


def _confusion(found: Confusion, above: str, path: Path) -> Path:
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
    return path
