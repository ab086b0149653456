"""Writing a report: pictures, page and numbers, in a folder that appears whole or not at all."""

from __future__ import annotations

import json
import os
import shutil
import tempfile
from pathlib import Path
from typing import Any

from pipeline.labels.database import open_database
from pipeline.labels.reading import Labels
from pipeline.labels.report.counts import (
    CLASSES_SHOWN,
    draw_ambiguity,
    draw_classes,
    draw_distance,
    draw_heat_map,
    draw_states,
)
from pipeline.labels.report.distributions import Distributions, distributions
from pipeline.labels.report.geometry import draw_margins, draw_sizes, draw_targets
from pipeline.labels.report.page import GENERATOR, Picture, report_page
from pipeline.labels.report.style import DPI, house_style, need_matplotlib, save_figure
from pipeline.system.errors import InputError, MissingExtra

PAGE = "index.html"
NUMBERS = "statistics.json"
PICTURES = ("states", "ambiguity", "targets", "margins", "distance", "classes", "sizes", "classes-by-relation")
FILES = (PAGE, NUMBERS, *(f"{name}.png" for name in PICTURES))


def write_report(labels: Labels, statistics: dict[str, Any], out: Path) -> list[Path]:
    """Write the statistics of labels as pictures and a page.

    The folder holds `index.html`, its pictures as PNG (without matplotlib there are none), and `statistics.json`.
    An earlier report there is replaced as a whole.

    Parameters
    ----------
    labels : Labels
    statistics : dict
        Of the same labels, from `pipeline.labels.statistics.label_statistics`.
    out : Path

    Returns
    -------
    list of Path
        The files, the page first.

    Raises
    ------
    InputError
        `out` holds something else, or the labels cannot be read.
    """
    out = Path(out).expanduser()
    check_report_folder(out)
    shown = list(statistics["classes"])[:CLASSES_SHOWN]
    out.parent.mkdir(parents=True, exist_ok=True)
    partial = Path(tempfile.mkdtemp(prefix=f".{out.name}.", suffix=".partial", dir=out.parent))
    try:
        pictures: list[Picture] = []
        if not MissingExtra.missing(need_matplotlib):
            with open_database(labels) as database:
                found = distributions(database, labels.relation_names, statistics["counts"]["frames"], shown)
            pictures = _draw(statistics, found, partial)
        numbers = json.dumps(statistics, indent=1, ensure_ascii=False, allow_nan=False)
        (partial / NUMBERS).write_text(numbers + "\n", encoding="utf-8")
        (partial / PAGE).write_text(report_page(labels.manifest, statistics, pictures), encoding="utf-8")
        # mkdtemp makes folders that only their owner can read.
        partial.chmod(0o777 & ~_umask())
        _move_into_place(partial, out)
    finally:
        shutil.rmtree(partial, ignore_errors=True)
    return [out / name for name in (PAGE, NUMBERS, *(picture.file for picture in pictures))]


def _draw(statistics: dict[str, Any], found: Distributions, folder: Path) -> list[Picture]:
    """Draw all pictures into a folder."""
    pictures = []
    with house_style():
        drawn = (
            draw_states(statistics),
            draw_ambiguity(statistics),
            draw_targets(found),
            draw_margins(found),
            draw_distance(statistics, found),
            draw_classes(statistics),
            draw_sizes(found, statistics),
            draw_heat_map(statistics, found),
        )
        for name, figure in zip(PICTURES, drawn, strict=True):
            save_figure(figure, folder / f"{name}.png")
            width, height = (round(float(inches) * DPI) for inches in figure.get_size_inches())
            words = " ".join(" ".join(text.get_text() for text in figure.texts).split())
            pictures.append(Picture(f"{name}.png", words, width, height))
    return pictures


def check_report_folder(out: Path) -> None:
    """Whether a report can go there: to be asked before long work.

    Raises
    ------
    InputError
        It is a file, or a folder with anything that is not of a report.
    """
    out = Path(out).expanduser()
    if out.is_symlink() or (out.exists() and not out.is_dir()):
        raise InputError("a report goes into a folder", got="a link" if out.is_symlink() else "a file", path=out)
    there = sorted(p.name for p in out.iterdir()) if out.exists() else []
    foreign = [name for name in there if name not in FILES]
    if foreign:
        raise InputError(
            "the folder for the report holds other files", got=foreign[0], expected="a new or empty folder", path=out
        )
    if there and not (PAGE in there and GENERATOR in (out / PAGE).read_text(encoding="utf-8", errors="replace")[:500]):
        raise InputError(f"the {PAGE} there is not of a report", expected="a new or empty folder", path=out)


def _move_into_place(partial: Path, out: Path) -> None:
    if not out.exists():
        os.rename(partial, out)
        return
    old = Path(tempfile.mkdtemp(prefix=f".{out.name}.", suffix=".old", dir=out.parent))
    os.rename(out, old / out.name)
    try:
        os.rename(partial, out)
    except OSError:
        os.rename(old / out.name, out)
        old.rmdir()
        raise
    shutil.rmtree(old, ignore_errors=True)


def _umask() -> int:
    current = os.umask(0)
    os.umask(current)
    return current
