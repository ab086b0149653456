"""Pictures of a run for papers, with intervals: accuracy and F1 by relation, verdicts, and what each module costs."""

from __future__ import annotations

import textwrap
import warnings
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from itertools import cycle
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from pipeline.diagnosis.oracles import shown_oracle
from pipeline.diagnosis.verdict import shown_verdicts
from pipeline.evaluation.grounding_tables import OPM_ONLY
from pipeline.evaluation.relation_report import SystemFigures
from pipeline.evaluation.summary import Deltas, RunSummary, Share, residual_words, untold_words
from pipeline.geometry.palette import VERDICTS, hex_color
from pipeline.language.counted import short
from pipeline.language.relation_names import PAIRWISE, PHRASE
from pipeline.metrics.intervals import Estimate
from pipeline.metrics.tables import Table
from pipeline.system.errors import extra_module

if TYPE_CHECKING:
    from matplotlib.figure import Figure

FULL = 1200
"""Width in pixels; the files have twice as many, for sharp screens."""
DPI = 100
INK, QUIET, LINE, PALE = "#1f2630", "#5b6470", "#c8ccd2", "#e6e9ed"
TONES = ("#0077bb", "#ee7733", "#009988", "#cc3311", "#33bbee", "#ee3377")
"""Paul Tol's vibrant scheme, which people with any colour vision can tell apart."""
PALE_TONE = "#b4bdca"
"""Of the detector alone."""
ACCURACY = "set-valued accuracy (%)"
LOSS_COLORS = {
    name: hex_color(VERDICTS[verdict])
    for name, verdict in (
        ("accuracy", "CORRECT"),
        ("PARSE", "PARSE"),
        ("RECALL", "OPM-TARGET"),
        ("LIFT", "LIFT"),
        ("SRM", "SRM"),
        ("CONF", "OPM-CONF"),
        ("ATTRIBUTE", "ATTRIBUTE"),
        ("residual", "COMPOUND"),
        ("unknown", "UNEXPLAINED"),
    )
}
ADDS_UP = (
    "Full bars add up from the accuracy to 100: what the gold parse gains (PARSE), the Shapley value of each oracle, "
    "its fair share over all orders of replacing, and the residual. Hollow bars are one oracle alone: they do not add "
    "up, and one below 0 says that the module made up for an error of another."
)
_NONE = Share(0, Estimate(0.0, 0.0, 0.0, 0, 0))
# Of one width, so that texts fit alike; then fonts that know other scripts.
LATIN = ("Liberation Sans", "Arial", "Helvetica", "DejaVu Sans")
OTHER_SCRIPTS = (
    "Noto Sans CJK SC",
    "Noto Sans CJK JP",
    "Noto Sans CJK KR",
    "WenQuanYi Zen Hei",
    "Microsoft YaHei",
    "PingFang SC",
    "Hiragino Sans",
    "Noto Sans Arabic",
    "Noto Sans Devanagari",
    "Arial Unicode MS",
)
STYLE: dict[Any, Any] = {
    "font.size": 9.5,
    "text.color": INK,
    # A class may be called "$x$".
    "text.parse_math": False,
    "axes.edgecolor": LINE,
    "axes.labelcolor": QUIET,
    "axes.linewidth": 0.8,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.axisbelow": True,
    "grid.color": PALE,
    "grid.linewidth": 0.8,
    "xtick.color": LINE,
    "ytick.color": LINE,
    "xtick.labelcolor": QUIET,
    "ytick.labelcolor": INK,
    "xtick.labelsize": 9,
    "ytick.labelsize": 9,
    "legend.frameon": False,
    "legend.fontsize": 9,
    "figure.facecolor": "white",
}


def need_matplotlib() -> None:
    """Raise MissingExtra where the plots cannot be drawn."""
    extra_module("matplotlib", "a picture of a run", "report")


@contextmanager
def picture(path: Path, size: tuple[int, int], title: str, *notes: str) -> Iterator[Figure]:
    """Figure of this many pixels with a title and quieter notes, written as PNG when the block ends.

    Equal figures give equal bytes. The folder is made where it is missing.
    """
    import matplotlib as mpl
    from matplotlib.figure import Figure
    from matplotlib.font_manager import get_font_names

    installed = set(get_font_names())
    fonts = [name for name in (*LATIN, *OTHER_SCRIPTS) if name in installed]
    width, height = size
    title = textwrap.fill(title, width // 9)
    note = " ".join(f"{n[0].upper()}{n[1:].removesuffix('.')}." for n in notes if n)
    note = textwrap.fill(note, round((width - 28) / 6.3))
    top = 16 + 20 * (title.count("\n") + 1)
    head = top + 15 * (note.count("\n") + 1) + 10
    height += head
    with mpl.rc_context({**STYLE, "font.family": fonts}), warnings.catch_warnings():
        # A script that no font here knows shows as boxes, in the picture alone.
        warnings.filterwarnings("ignore", message="Glyph .* missing from", category=UserWarning)
        figure = Figure(figsize=(width / DPI, height / DPI), dpi=DPI, layout="constrained")
        figure.get_layout_engine().set(rect=(0.012, 0.01, 0.976, 1 - head / height), w_pad=0.06, h_pad=0.06)  # pyright: ignore
        figure.text(14 / width, 1 - 12 / height, title, fontsize=12.5, fontweight="bold", va="top", linespacing=1.2)
        figure.text(14 / width, 1 - top / height, note, fontsize=9, color=QUIET, va="top", linespacing=1.25)
        yield figure
        path.parent.mkdir(parents=True, exist_ok=True)
        # A third less time than the usual level 6 takes, for a file that is one per cent larger.
        figure.savefig(path, dpi=2 * DPI, metadata={"Software": None}, pil_kwargs={"compress_level": 4})


def draw_accuracy(table: Table, out: Path, caveat: str = "") -> None:
    """Write `relations.png` into a folder: the table of accuracy by relation as bars.

    `caveat`: what the figures are where truth and systems have a maker in common; it stands below the title.
    """
    rows = {row.name: [c for c in row.cells if isinstance(c, Estimate)] for row in table.rows}
    shown = {name: cells for name, cells in rows.items() if cells}
    _bars(out / "relations.png", table.columns, shown, "Accuracy by relation", ACCURACY, caveat)


def draw_relations(figures: Sequence[SystemFigures], out: Path, caveat: str = "") -> None:
    """Write `srm_relations.png` into a folder: F1 of each relation; `caveat` as in `draw_accuracy`."""
    relations = [r for r in PAIRWISE if any(r in f.metrics.relations for f in figures)]
    by_name = {f.title: dict(zip(f.metrics.relations, f.estimates.f1, strict=True)) for f in figures}
    rows = {name: [own.get(r) for r in relations] for name, own in by_name.items()}
    _bars(out / "srm_relations.png", [PHRASE[r] for r in relations], rows, "F1 of each relation", "F1 (%)", caveat)


def _bars(
    path: Path, ticks: Sequence[str], rows: Mapping[str, Sequence[Estimate | None]], title: str, label: str, caveat: str
) -> None:
    """Draw bars beside each other, with intervals."""
    width, tones = 0.8 / max(len(rows), 1), cycle(TONES)
    with picture(path, (FULL, 400), f"{title}, with 95 % intervals", caveat) as figure:
        axes = figure.add_subplot()
        for k, (row, cells) in enumerate(rows.items()):
            x = np.arange(len(ticks)) + (k - (len(rows) - 1) / 2) * width
            values = [np.nan if e is None else 100 * e.value for e in cells]
            color = PALE_TONE if row.endswith(OPM_ONLY) else next(tones)
            axes.bar(x, values, width * 0.92, label=row, color=color)
            reach = np.transpose([_reach(e) for e in cells])
            axes.errorbar(x, values, reach, fmt="none", ecolor=INK, elinewidth=0.8)
        axes.set_xticks(np.arange(len(ticks)), ticks)
        axes.set(ylim=(0, 105), ylabel=label)
        axes.grid(axis="y")
        axes.legend(loc="upper center", bbox_to_anchor=(0.5, -0.1), ncols=2)


def _reach(e: Estimate | None) -> tuple[float, float]:
    """Reach of an interval below and above the value, in points; 0 without an interval."""
    if e is None or not (np.isfinite(e.low) and np.isfinite(e.high)):
        return 0.0, 0.0
    return max(0.0, 100 * (e.value - e.low)), max(0.0, 100 * (e.high - e.value))


def draw_diagnosis(summaries: Mapping[str, RunSummary], out: Path, caveat: str = "") -> None:
    """Write `verdicts.png` of all systems and `oracles.png` of the first; `caveat` as in `draw_accuracy`."""
    if not summaries:
        return
    _verdicts(summaries, out / "verdicts.png", caveat)
    name, summary = next(iter(summaries.items()))
    if summary.deltas is not None:
        _costs(name, summary, summary.deltas, out / "oracles.png", caveat)


def _verdicts(summaries: Mapping[str, RunSummary], path: Path, caveat: str) -> None:
    kinds = shown_verdicts({v for s in summaries.values() for v in s.verdicts})
    note = (
        "Share of expressions, which sums to 100 %, with 95 % intervals. CORRECT is the labelled target; LABEL is "
        "mostly another correct answer."
    )
    size, height = (FULL, 90 + 34 * len(kinds) * len(summaries)), 0.8 / len(summaries)
    with picture(path, size, "Verdicts on every expression", caveat, note) as figure:
        axes = figure.add_subplot()
        for k, (name, summary) in enumerate(summaries.items()):
            at = np.arange(len(kinds)) + (k - (len(summaries) - 1) / 2) * height
            for where, verdict in zip(at, kinds, strict=True):
                share = summary.verdicts.get(verdict, _NONE)
                value, reach = 100 * share.estimate.value, _reach(share.estimate)
                color, alpha = hex_color(VERDICTS[verdict]), 1 - 0.5 * (k > 0)
                axes.barh(where, value, height * 0.9, color=color, alpha=alpha)
                axes.errorbar(value, where, xerr=[[r] for r in reach], fmt="none", ecolor=INK, elinewidth=0.8)
                text = f"{short(name)}: {share.count}" if len(summaries) > 1 else f"{share.count}"
                axes.text(value + reach[1] + 0.8, where, text, va="center", fontsize=8.5, color=QUIET)
        axes.set_yticks(np.arange(len(kinds)), kinds)
        axes.invert_yaxis()
        axes.set(xlim=(0, 105), xlabel="share of expressions (%)")
        axes.grid(axis="x")


def _costs(name: str, summary: RunSummary, costs: Deltas, path: Path, caveat: str) -> None:
    notes = (caveat, ADDS_UP, residual_words(summary), untold_words(summary))
    with picture(path, (FULL, 380), f"What each module costs: {name}", *notes) as figure:
        axes = figure.add_subplot()
        base, begin, least = 100 * float(costs.value[0]), 0.0, 100.0
        for x, (key, estimate) in enumerate(summary.loss.items()):
            signed = key not in ("accuracy", "residual", "unknown")
            _cost(axes, x - 0.18, 0.36, begin, estimate, signed, color=LOSS_COLORS[key])
            end = begin + 100 * estimate.value
            if (single := costs.single.get(key)) is not None:
                hollow = {"fill": False, "edgecolor": LOSS_COLORS[key], "linewidth": 1.4}
                _cost(axes, x + 0.2, 0.3, base, single, True, **hollow)
                least = min(least, base + 100 * single.value)
            least, begin = min(least, end, begin if x else end), end
        start = max(0.0, least - 10)
        named = {"accuracy": "as answered", "unknown": "not worked out"}
        ticks = [named.get(key) or shown_oracle(key).replace(", ", "\n") for key in summary.loss]
        axes.set_xticks(range(len(ticks)), ticks)
        axes.set(ylim=(start, 104), ylabel=f"{ACCURACY}{f', from {start:.0f} on' if start else ''}")
        axes.grid(axis="y")


def _cost(axes: Any, x: float, width: float, base: float, e: Estimate, signed: bool, **look: Any) -> None:
    """Draw a bar of the costs with interval and figure."""
    below, above = _reach(e)
    axes.bar(x, 100 * e.value, width, base, **look)
    axes.errorbar(x, base + 100 * e.value, [[below], [above]], ecolor=INK, elinewidth=0.8, fmt="none")
    top, text = base + 100 * max(e.value, 0) + above + 0.4, e.formatted(signed=signed).split(" [")[0]
    axes.text(x, top, text, ha="center", va="bottom", fontsize=8.5, color=QUIET)
