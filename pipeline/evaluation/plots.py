"""Plots of a run and of its diagnosis: pictures for papers, and pages that hold them, whose parts say their figures."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from html import escape
from io import StringIO
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from pipeline.diagnosis.oracles import shown_oracle
from pipeline.diagnosis.verdict import VERDICTS, shown_verdicts
from pipeline.evaluation.confusion import Confusion
from pipeline.evaluation.costs import Deltas
from pipeline.evaluation.figure_style import FULL, INK, QUIET, house_style, new_figure, save_figure
from pipeline.evaluation.grounding_tables import OPM_ONLY, column, has_opm
from pipeline.evaluation.records import detector_scores, is_calibrated
from pipeline.evaluation.relation_report import SystemFigures
from pipeline.evaluation.slices import Slices
from pipeline.evaluation.summary import RunSummary, Share, residual_words, untold_words
from pipeline.geometry.palette import VERDICTS as VERDICT_RGB
from pipeline.geometry.palette import hex_color
from pipeline.language.counted import short
from pipeline.language.relation_names import PAIRWISE, PHRASE
from pipeline.metrics.calibration_metrics import ECE_BINS, ReliabilityDiagram, reliability_diagram
from pipeline.metrics.intervals import Estimate
from pipeline.metrics.tables import Table, caveats_html
from pipeline.system.arrow import pa

if TYPE_CHECKING:
    from matplotlib.figure import Figure


SCORE_TONES = {"raw scores": "#ee7733", "calibrated": "#0077bb"}
SWEEP = np.linspace(0.05, 0.95, 19)
TONES = ("#0077bb", "#ee7733", "#009988", "#cc3311", "#33bbee", "#ee3377")
"""Paul Tol's vibrant scheme, which people with any colour vision can tell apart."""
PALE_TONE = "#b4bdca"
ACCURACY = "set-valued accuracy (%)"
Bars = tuple[Sequence[str], dict[str, np.ndarray]]
"""Names below the bars, and by row (3, K) float64: values, lows and highs in percent; NaN for none."""
Curve = tuple[str, np.ndarray, np.ndarray, str, str]
"""Name, x, y in percent, colour, and style of the line."""
TIP = "tip:"
"""Begins the id of what tells its figures where the pointer is on it."""


class Page:
    """Pictures of one kind: a PNG each, and a page that holds them as SVG and needs no network.

    `above`: caveat that stands before what is said below each title.
    """

    def __init__(self, folder: Path, above: str = "") -> None:
        self.folder = folder
        self.above = f"{above[0].upper()}{above[1:]}. " if above else ""
        self.parts: list[str] = []

    @contextmanager
    def picture(self, name: str, size: tuple[int, int], title: str, note: str = "") -> Iterator[Figure]:
        """Figure of pixels, written when the block ends; without a `name` on the page alone."""
        with house_style():
            figure = new_figure(*size, title, self.above + note)
            yield figure
            if name:
                save_figure(figure, self.folder / f"{name}.png")
            text = StringIO()
            figure.savefig(text, format="svg", metadata={"Date": None})
            svg = f"<svg{text.getvalue().partition('<svg')[2]}"
            self.parts.append(re.sub(rf'<g id="{TIP}([^"]*)">', r"<g><title>\1</title>", svg))

    def write(self, name: str, title: str, caveats: str = "") -> None:
        """Write the page; `caveats`, HTML, stand on top."""
        style = "body{font-family:Arial,sans-serif;max-width:1240px;margin:auto}svg{width:100%;height:auto}"
        text = f"<!doctype html><html><head><meta charset='utf-8'><title>{escape(title)}</title><style>{style}</style>"
        text += f"</head><body>{caveats}{''.join(self.parts)}</body></html>"
        (self.folder / name).write_text(text, encoding="utf-8")


def tip(*lines: object) -> str:
    """Id of a part of a picture with figures."""
    return TIP + "; ".join(map(str, lines))


def interval(e: Estimate) -> tuple[float, float]:
    """Reach of an interval below and above the value, in points; 0 without an interval."""
    if not (np.isfinite(e.low) and np.isfinite(e.high)):
        return 0.0, 0.0
    return max(0.0, 100 * (e.value - e.low)), max(0.0, 100 * (e.high - e.value))


def draw(systems: Mapping[str, pa.Table], tables: Sequence[Table], out: Path, caveat: str = "") -> None:
    """Write `relations.png`, `overlap.png`, `classes.png`, `plots.html`, and `calibration.png` where scores are.

    `systems`: records by system. `tables`: those of the run: the relation table gives the bars their intervals.
    `caveat`: what the figures are where truth and systems have a maker in common: below each title.
    """
    out.mkdir(parents=True)
    page = Page(out, caveat)
    bars = relation_bars(next(t for t in tables if t.key == "relations"))
    _bars(page, "relations", bars, _tones(bars[1]), "Accuracy by relation", ACCURACY)
    for name, title, label, curves in (
        ("overlap", "Accuracy by the overlap that is asked for", "overlap (IoU)", overlap_curves),
        ("classes", "Accuracy by how many objects share the target's class", "objects of the class", class_curves),
    ):
        found = [
            (f"{system}, {kind}", x, y, TONES[k % len(TONES)], "--" if kind == "OPM only" else "-")
            for k, (system, records) in enumerate(systems.items())
            for kind, x, y in curves(records)
        ]
        with page.picture(name, (FULL, 400), title) as figure:
            _lines(figure.add_subplot(), found, xlabel=label, ylabel=ACCURACY, ylim=(0, 105))
    diagrams = score_diagrams(systems)
    if diagrams:
        _calibration(page, diagrams)
    page.write("plots.html", "Evaluation", caveats_html(tables))


def draw_relations(figures: Sequence[SystemFigures], tables: Sequence[Table], out: Path, caveat: str = "") -> None:
    """Write `srm_reliability.png`, `srm_relations.png` and `srm.html` into a folder, made where missing.

    What the tables of the same figures warn of stands on the page too; `caveat`, what the figures are where truth and
    scorers have a maker in common, below the titles.
    """
    out.mkdir(parents=True, exist_ok=True)
    page = Page(out, caveat)
    tones = {f.title: TONES[k % len(TONES)] for k, f in enumerate(figures)}
    curves = [("exact", np.array([0, 100.0]), np.array([0, 100.0]), PALE_TONE, "--")]
    for system in figures:
        some = (diagram := system.calibration.diagram).count > 0
        name = f"{system.title} (ECE {100 * diagram.ece:.1f})"
        x, y = 100 * diagram.confidence[some], 100 * diagram.frequency[some]
        curves.append((name, x, y, tones[system.title], "-"))
    title = "Do probabilities of relations mean what they say?"
    with page.picture("srm_reliability", (760, 760), title) as figure:
        axes = figure.add_subplot()
        labels = {"xlabel": "probability that is given (%)", "ylabel": "share that holds (%)"}
        _lines(axes, curves, xlim=(0, 100), ylim=(0, 100), aspect="equal", **labels)
    relations = [r for r in PAIRWISE if any(r in f.metrics.relations for f in figures)]
    rows = {}
    for system in figures:
        own = dict(zip(system.metrics.relations, system.estimates.f1, strict=True))
        rows[system.title] = _ends([own.get(r) for r in relations])
    _bars(page, "srm_relations", ([PHRASE[r] for r in relations], rows), tones, "F1 of each relation", "F1 (%)")
    page.write("srm.html", "Relations alone", caveats_html(tables))


def _ends(cells: Sequence[Estimate | None]) -> np.ndarray:
    """(3, K) percent: values, lows and highs; NaN for none."""
    ends = [[getattr(c, end, np.nan) for c in cells] for end in ("value", "low", "high")]
    return 100 * np.array(ends, np.float64)


def relation_bars(table: Table) -> Bars:
    """The relation table as bars."""
    found = {row.name: [c for c in row.cells if isinstance(c, Estimate)] for row in table.rows}
    return table.columns, {name: _ends(cells) for name, cells in found.items() if cells}


def overlap_curves(records: pa.Table) -> Iterator[tuple[str, np.ndarray, np.ndarray]]:
    """Percent of expressions whose answer overlaps an acceptable target by at least x, by kind of answer."""
    names = {"pipeline": "set_iou", "OPM only": "opm_set_iou"} if has_opm(records) else {"whole expression": "set_iou"}
    for kind, name in names.items():
        yield kind, SWEEP, 100 * (column(records, name)[None] >= SWEEP[:, None]).mean(axis=1)


def class_curves(records: pa.Table) -> Iterator[tuple[str, np.ndarray, np.ndarray]]:
    """Accuracy by the number of labelled objects of the target's class; 6 stands for 6 and more."""
    number = np.minimum(column(records, "same_class").astype(int), 6)
    x = np.unique(number)
    answers = {"pipeline" if has_opm(records) else "whole expression": column(records, "set_correct")}
    if has_opm(records):
        answers["OPM only"] = (column(records, "opm_set_iou") >= 0.5).astype(float)
    for kind, right in answers.items():
        yield kind, x.astype(float), 100 * np.array([right[number == k].mean() for k in x])


def score_diagrams(systems: Mapping[str, pa.Table]) -> dict[str, dict[str, ReliabilityDiagram]]:
    """Reliability by raw and by calibrated scores, of every system with calibrated scores."""
    found = {}
    for name, records in systems.items():
        if is_calibrated(records):
            scores = detector_scores(records)
            pairs = zip(SCORE_TONES, (scores.raw, scores.calibrated), strict=True)
            found[name] = {kind: reliability_diagram(p, scores.hits, ECE_BINS) for kind, p in pairs}
    return found


def _tones(rows: Mapping[str, Any]) -> dict[str, str]:
    """Colour of each row of the relation table: the detector alone is pale, each system has a colour."""
    systems = [name for name in rows if not name.endswith(OPM_ONLY)]
    own = {name: TONES[k % len(TONES)] for k, name in enumerate(systems)}
    return {name: own.get(name, PALE_TONE) for name in rows}


def _bars(page: Page, name: str, bars: Bars, tones: Mapping[str, str], title: str, label: str) -> None:
    """Bars beside each other, with their intervals."""
    ticks, rows = bars
    width = 0.8 / max(len(rows), 1)
    with page.picture(name, (FULL, 400), f"{title}, with 95 % intervals") as figure:
        axes = figure.add_subplot()
        for k, (row, (value, low, high)) in enumerate(rows.items()):
            x = np.arange(len(ticks)) + (k - (len(rows) - 1) / 2) * width
            patches = axes.bar(x, value, width * 0.92, label=row, color=tones[row])
            for patch, tick, ends in zip(patches, ticks, zip(value, low, high, strict=True), strict=True):
                patch.set_gid(tip(row, f"{tick}: {ends[0]:.1f} % [{ends[1]:.1f}, {ends[2]:.1f}]"))
            known = np.isfinite(low)
            if known.any():
                error = np.stack([value - low, high - value])[:, known].clip(0)
                axes.errorbar(x[known], value[known], error, fmt="none", ecolor=INK, elinewidth=0.8)
        axes.set_xticks(np.arange(len(ticks)), ticks)
        axes.set(ylim=(0, 105), ylabel=label)
        axes.grid(axis="y")
        axes.legend(loc="upper center", bbox_to_anchor=(0.5, -0.1), ncols=2)


def _lines(axes: Any, curves: Sequence[Curve], **settings: Any) -> None:
    """Draw curves through points with their figures."""
    for name, x, y, color, style in curves:
        axes.plot(x, y, style, color=color, label=name)
        for point in zip(x.tolist(), y.tolist(), strict=True):
            axes.plot(*point, marker=".", color=color, gid=tip(name, f"{point[0]:.3g}: {point[1]:.1f} %"))
    axes.set(**settings)
    axes.grid(axis="y")
    axes.legend(loc="upper center", bbox_to_anchor=(0.5, -0.12), ncols=2)


def _calibration(page: Page, diagrams: Mapping[str, Mapping[str, ReliabilityDiagram]]) -> None:
    """Draw a panel for each system: the share of hits by score, and below the number of detections."""
    size = (420 * len(diagrams) + 60, 460)
    with page.picture("calibration", size, "Reliability of the detector's scores") as figure:
        axes = figure.subplots(2, len(diagrams), squeeze=False, sharex=True, height_ratios=(3, 1))
        for (upper, lower), (system, kinds) in zip(axes.T, diagrams.items(), strict=True):
            curves = [("as likely as it says", np.array([0, 1.0]), np.array([0, 100.0]), QUIET, ":")]
            for n, (kind, diagram) in enumerate(kinds.items()):
                some = diagram.count > 0
                x, y = diagram.confidence[some], 100 * diagram.frequency[some]
                curves.append((f"{kind}, ECE {diagram.ece:.3f}", x, y, SCORE_TONES[kind], "-"))
                middle = (diagram.edges[:-1] + diagram.edges[1:]) / 2 + (n - 0.5) * 0.4 / ECE_BINS
                lower.bar(middle, diagram.count, 0.36 / ECE_BINS, color=SCORE_TONES[kind])
            _lines(upper, curves, title=system, xlim=(0, 1), ylim=(0, 105), ylabel="hits, IoU of at least 0.5 (%)")
            upper.legend(loc="lower right")
            lower.set(xlabel="score", ylabel="detections")


SHOWN = ("relation", "class", "distance", "size", "occlusion", "same_class", "label_margin")
MOST_SHOWN = 12
VERDICT_COLORS = {verdict: hex_color(color) for verdict, color in VERDICT_RGB.items()}
LOSS_COLORS = {
    "accuracy": VERDICT_COLORS["CORRECT"],
    "PARSE": VERDICT_COLORS["PARSE"],
    "RECALL": VERDICT_COLORS["OPM-TARGET"],
    "LIFT": VERDICT_COLORS["LIFT"],
    "SRM": VERDICT_COLORS["SRM"],
    "CONF": VERDICT_COLORS["OPM-CONF"],
    "ATTRIBUTE": VERDICT_COLORS["ATTRIBUTE"],
    "residual": VERDICT_COLORS["COMPOUND"],
    "unknown": VERDICT_COLORS["UNEXPLAINED"],
}
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

    `out`: a folder, made where it is missing. `caveats`: HTML that stands above all. `caveat`: what the figures are
    where truth and systems have a maker in common: before what stands below each title.
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
                text = f"{short(name, 24)}: {share.count}" if len(summaries) > 1 else f"{share.count}"
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
    """Draw a bar of the costs with interval and figure."""
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
                    told = tip(
                        f"{row.name}: {share:.1f} % {verdict}",
                        f"{row.counts[verdict]} of {row.n} expressions",
                        f"set-valued accuracy {row.set_correct.formatted()}",
                        f"search {search}",
                    )
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
