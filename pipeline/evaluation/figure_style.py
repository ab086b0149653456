"""Style of plots: one width grid, quiet axes, a sentence on top."""

from __future__ import annotations

import textwrap
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pipeline.system.errors import extra_module

if TYPE_CHECKING:
    from matplotlib.figure import Figure

FULL = 1200
"""Width in pixels of a page; the files have twice as many, for sharp screens."""
DPI = 100
INK, QUIET, LINE, PALE = "#1f2630", "#5b6470", "#c8ccd2", "#e6e9ed"

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


def need_matplotlib() -> None:
    """Raise MissingExtra where the plots cannot be drawn."""
    extra_module("matplotlib", "a report with pictures", "report")


@contextmanager
def house_style() -> Iterator[None]:
    """Style of matplotlib for all figures of a report."""
    import matplotlib as mpl
    from matplotlib.font_manager import get_font_names

    installed = set(get_font_names())
    settings: dict[Any, Any] = {
        "font.family": [name for name in (*LATIN, *OTHER_SCRIPTS) if name in installed],
        "font.size": 9.5,
        "text.color": INK,
        # A class may be called "$x$".
        "text.parse_math": False,
        "axes.edgecolor": LINE,
        "axes.labelcolor": QUIET,
        "axes.linewidth": 0.8,
        "axes.spines.top": False,
        "axes.spines.right": False,
        "axes.titlelocation": "left",
        "axes.titlesize": 10,
        "axes.titleweight": "bold",
        "axes.titlecolor": INK,
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
        "hatch.linewidth": 0.6,
        "figure.dpi": DPI,
        "figure.facecolor": "white",
        "savefig.dpi": 2 * DPI,
        "svg.fonttype": "none",
        "svg.hashsalt": "spatialviz",
    }
    with mpl.rc_context(settings), warnings.catch_warnings():
        # A script that no font here knows shows as boxes, in the picture alone.
        warnings.filterwarnings("ignore", message="Glyph .* missing from", category=UserWarning)
        yield


def new_figure(width: int, height: int, title: str, subtitle: str) -> Figure:
    """New figure of this many pixels with a title sentence and a quieter line on reading."""
    from matplotlib.figure import Figure

    title = textwrap.fill(title, width // 9)
    subtitle = textwrap.fill(subtitle, round((width - 28) / 5.6))
    lines, more = title.count("\n") + 1, subtitle.count("\n") + 1
    top = 12 + 20 * lines + 4
    head = top + 15 * more + 10
    height += head
    figure = Figure(figsize=(width / DPI, height / DPI), dpi=DPI, layout="constrained")
    figure.get_layout_engine().set(rect=(0.012, 0.01, 0.976, 1 - head / height), w_pad=0.06, h_pad=0.06)  # pyright: ignore
    left = 14 / width
    figure.text(left, 1 - 12 / height, title, fontsize=12.5, fontweight="bold", va="top", linespacing=1.2)
    figure.text(left, 1 - top / height, subtitle, fontsize=9, color=QUIET, va="top", linespacing=1.25)
    return figure


def save_figure(figure: Figure, path: Path) -> None:
    """Write PNG; equal figures give equal bytes."""
    # A third less time than the usual level 6 takes, for a file that is one per cent larger.
    figure.savefig(path, metadata={"Software": None}, pil_kwargs={"compress_level": 4})
