"""Writing a report: pictures, page and numbers, in a folder that appears whole or not at all.

The page has key figures, the pictures, and what made the labels; all strings of the dataset are escaped.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from html import escape
from pathlib import Path
from typing import Any

from pipeline.labels.provenance import makers_of
from pipeline.labels.reading import Labels
from pipeline.labels.report.distributions import Distributions, distributions
from pipeline.labels.report.pictures import (
    CLASSES_SHOWN,
    draw_ambiguity,
    draw_classes,
    draw_distance,
    draw_heat_map,
    draw_margins,
    draw_sizes,
    draw_states,
    draw_targets,
)
from pipeline.labels.report.style import (
    DPI,
    FULL,
    house_style,
    need_matplotlib,
    percent,
    relation_color,
    save_figure,
    thousands,
)
from pipeline.labels.schema import Manifest
from pipeline.labels.statistics import open_database
from pipeline.system.errors import MissingExtra, require
from pipeline.system.safe_files import read_bytes
from pipeline.system.whole_files import staged_folder, write_json

PAGE = "index.html"
NUMBERS = "statistics.json"
PICTURES = ("states", "ambiguity", "targets", "margins", "distance", "classes", "sizes", "classes-by-relation")
FILES = (PAGE, NUMBERS, *(f"{name}.png" for name in PICTURES))


def write_report(labels: Labels, statistics: dict[str, Any], out: Path) -> list[Path]:
    """Write the statistics of labels as pictures and a page.

    The folder holds `index.html`, its pictures as PNG (without matplotlib there are none), and `statistics.json`.
    An earlier report there is replaced as a whole.

    `statistics`: of the same labels, from `pipeline.labels.statistics.label_statistics`. Returns the files, the page
    first.

    Raises InputError: `out` holds something else, or the labels cannot be read.
    """
    out = Path(out).expanduser()
    check_report_folder(out)
    shown = list(statistics["classes"])[:CLASSES_SHOWN]
    with staged_folder(out, overwrite=True, mark=PAGE) as folder:
        pictures: list[Picture] = []
        if not MissingExtra.missing(need_matplotlib):
            with open_database(labels) as database:
                found = distributions(database, labels.relation_names, statistics["counts"]["frames"], shown)
            pictures = _draw(statistics, found, folder)
        write_json(folder / NUMBERS, statistics)
        (folder / PAGE).write_text(report_page(labels.manifest, statistics, pictures), encoding="utf-8")
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
    """Check the folder of a report, before long work.

    Raises InputError: it is a file, or a folder with anything that is not of a report.
    """
    out = Path(out).expanduser()
    require(
        not out.is_symlink() and (not out.exists() or out.is_dir()),
        "a report goes into a folder",
        got="a link" if out.is_symlink() else "a file",
        path=out,
    )
    there = sorted(p.name for p in out.iterdir()) if out.exists() else []
    foreign = next((name for name in there if name not in FILES), None)
    require(
        foreign is None,
        "the folder for the report holds other files",
        got=foreign,
        expected="a new or empty folder",
        path=out,
    )
    require(
        not (
            there
            and not (PAGE in there and GENERATOR in read_bytes(out / PAGE)[:2000].decode("utf-8", "replace")[:500])
        ),
        f"the {PAGE} there is not of a report",
        expected="a new or empty folder",
        path=out,
    )


GENERATOR = "spatialviz report of labels"
"""Stands in the page, so that a report is known as one."""
STYLE = f"""
:root {{ color-scheme: light dark;
  --page: #f4f5f7; --card: #ffffff; --ink: #1f2630; --quiet: #5b6470; --line: #dde1e6; }}
@media (prefers-color-scheme: dark) {{
  :root {{ --page: #14171c; --card: #1d2128; --ink: #e8ebef; --quiet: #9aa3af; --line: #313741; }}
  figure {{ filter: brightness(.92); }}
}}
* {{ box-sizing: border-box; }}
body {{ margin: 0; background: var(--page); color: var(--ink);
  font: 15px/1.5 "Helvetica Neue", Helvetica, Arial, "Liberation Sans", system-ui, sans-serif; }}
main {{ max-width: {FULL + 80}px; margin: 0 auto; padding: 32px 24px 48px; }}
h1 {{ font-size: 26px; line-height: 1.2; margin: 0; overflow-wrap: anywhere; }}
h2 {{ font-size: 18px; margin: 32px 0 12px; }}
p {{ margin: 4px 0 0; color: var(--quiet); overflow-wrap: anywhere; }}
dl.figures {{ display: grid; grid-template-columns: repeat(6, 1fr); gap: 1px; margin: 20px 0 0;
  background: var(--line); border: 1px solid var(--line); border-radius: 8px; overflow: hidden; }}
dl.figures div {{ background: var(--card); padding: 12px 16px; display: flex; flex-direction: column-reverse;
  justify-content: flex-end; }}
dl.figures dd {{ margin: 0; font-size: 24px; line-height: 1.25; font-weight: 600; font-variant-numeric: tabular-nums; }}
dl.figures dt {{ color: var(--quiet); font-size: 13px; line-height: 1.35; }}
.scroll {{ overflow-x: auto; background: var(--card); border: 1px solid var(--line); border-radius: 8px; }}
table {{ border-collapse: collapse; width: 100%; font-variant-numeric: tabular-nums; font-size: 14px; }}
th, td {{ text-align: right; padding: 6px 16px; white-space: nowrap; }}
th {{ color: var(--quiet); font-weight: 500; }}
thead th {{ border-bottom: 1px solid var(--line); }}
tbody tr + tr > * {{ border-top: 1px solid var(--line); }}
th:first-child, td:first-child {{ text-align: left; }}
tbody th {{ color: var(--ink); font-weight: 600; }}
i {{ display: inline-block; width: 10px; height: 10px; border-radius: 3px; margin-right: 8px;
  outline: 1px solid var(--line); }}
.grid {{ display: grid; grid-template-columns: repeat(2, minmax(0, 1fr)); gap: 20px; margin-top: 20px; }}
figure {{ margin: 0; background: #fff; border: 1px solid var(--line); border-radius: 8px; padding: 8px; }}
figure.full {{ grid-column: 1 / -1; }}
figure img {{ display: block; width: 100%; height: auto; }}
dl.made {{ display: grid; grid-template-columns: max-content 1fr; gap: 2px 20px; margin: 0; font-size: 13px; }}
dl.made dt {{ color: var(--quiet); }}
dl.made dd {{ margin: 0; overflow-wrap: anywhere; }}
@media (max-width: 900px) {{
  .grid {{ grid-template-columns: minmax(0, 1fr); }}
  dl.figures {{ grid-template-columns: repeat(3, 1fr); }}
}}
@media (max-width: 520px) {{ dl.figures {{ grid-template-columns: repeat(2, 1fr); }} }}
"""


@dataclass(frozen=True)
class Picture:
    """A picture of the page: its file, what it shows in words, its size on the page in pixels."""

    file: str
    words: str
    width: int
    height: int


def report_page(manifest: Manifest, statistics: dict[str, Any], pictures: Sequence[Picture]) -> str:
    """Build the HTML page; pictures are separate files."""
    dataset = str(manifest.dataset.get("path", "")).rstrip("/\\")
    name = dataset.replace("\\", "/").rsplit("/", 1)[-1] or dataset
    figures = "".join(
        f"<div><dt>{escape(what)}</dt><dd>{escape(value)}</dd></div>" for what, value in key_figures(statistics)
    )
    made = "".join(f"<dt>{escape(k)}</dt><dd>{escape(v)}</dd>" for k, v in _provenance(manifest))
    return (
        "<!doctype html>\n"
        f'<html lang="en"><head><meta charset="utf-8"><meta name="generator" content="{GENERATOR}">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        f"<title>Labels of {escape(name)}</title>\n<style>{STYLE}</style></head>\n"
        f"<body><main>\n<header><h1>Labels of {escape(name)}</h1>\n"
        f"<p>{escape(dataset)}</p></header>\n"
        f'<dl class="figures">{figures}</dl>\n'
        f"<h2>Relations</h2>\n{_relation_table(statistics)}\n"
        f'<div class="grid">\n{"".join(_figure(p) for p in pictures)}</div>\n'
        f'<h2>How they were made</h2>\n<dl class="made">{made}</dl>\n'
        "</main></body></html>\n"
    )


def key_figures(statistics: dict[str, Any]) -> list[tuple[str, str]]:
    """The figures on top of a report: (what, value)."""
    counts, cells, ambiguity = statistics["counts"], statistics["cells"], statistics["ambiguity"]
    text, occlusion = statistics["text"], statistics["occlusion"]
    candidates = counts["candidates"]
    per_pair = cells["positives_per_pair"]
    return [
        (f"of {thousands(counts['frames'])} frames usable", thousands(counts["frames_usable"])),
        ("scene" if counts["scenes"] == 1 else "scenes", thousands(counts["scenes"])),
        (f"of {thousands(counts['objects'])} objects can be asked for", thousands(counts["objects_usable"])),
        ("ordered pairs", thousands(counts["pairs"])),
        (
            "expressions" if candidates is None else f"expressions of {thousands(candidates)} candidates",
            thousands(counts["expressions"]),
        ),
        (f"distinct sentences for {thousands(text['questions'])} questions", thousands(text["sentences"])),
        ("relations that hold of a pair (mean)", "–" if per_pair is None else f"{per_pair:.2f}"),
        ("of pairs have no relation that holds", percent(cells["pairs_without_T_share"])),
        ("of relation labels in doubt", percent(cells["u_share"])),
        ("of expressions have several right answers", percent(ambiguity["share"])),
        ("of objects are partly hidden", percent(occlusion["occluded_share"])),
        ("of objects are cut by the border", percent(occlusion["touching_border_share"])),
    ]


def _relation_table(statistics: dict[str, Any]) -> str:
    head = (
        "relation",
        "holds",
        "in doubt",
        "does not hold",
        "share that holds",
        "share in doubt",
        "expressions",
        "of them ambiguous",
        "median margin",
    )
    rows = []
    for name, entry in statistics["relations"].items():
        margin = statistics["margins"][name]["T"]
        cells = (
            thousands(entry["T"]),
            thousands(entry["U"]),
            thousands(entry["F"]),
            percent(entry["T_per_pair"]),
            percent(entry["u_share"]),
            thousands(entry["expressions"]),
            percent(entry["ambiguous_share"]),
            "–" if margin is None else f"{100 * margin['p50']:.1f} cm",
        )
        color = f'<i style="background:{relation_color(name)}"></i>'
        rows.append(f'<tr><th scope="row">{color}{escape(name)}</th>{"".join(f"<td>{c}</td>" for c in cells)}</tr>')
    titles = "".join(f'<th scope="col">{title}</th>' for title in head)
    return f'<div class="scroll"><table><thead><tr>{titles}</tr></thead><tbody>{"".join(rows)}</tbody></table></div>'


def _figure(picture: Picture) -> str:
    kind = ' class="full"' if picture.width >= FULL else ""
    return (
        f'<figure{kind}><img src="{escape(picture.file)}" alt="{escape(picture.words)}" '
        f'width="{picture.width}" height="{picture.height}"></figure>\n'
    )


def _provenance(manifest: Manifest) -> list[tuple[str, str]]:
    config = manifest.config
    return [
        ("tool", f"{manifest.tool} {manifest.version}, schema {manifest.schema_version}, {manifest.created}"),
        *makers_of(manifest).lines().items(),
        (
            "configuration",
            f"vocabulary {config.get('vocabulary')}, style {config.get('style')}, "
            f"seed {manifest.seed}, {manifest.config_hash[:16]}",
        ),
        ("dataset", f"{manifest.dataset.get('format')}, input {str(manifest.dataset.get('input_hash'))[:16]}"),
        ("expressions", f"content {manifest.tables['expressions'].content_hash[:16]}"),
    ]
