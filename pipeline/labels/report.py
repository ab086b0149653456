"""Statistics of labels in sentences and tables, for the shell and as a page in a folder of its own."""

from __future__ import annotations

from html import escape
from pathlib import Path
from typing import Any

from pipeline.labels.provenance import makers_of
from pipeline.labels.reading import Labels
from pipeline.language.counted import counted, listed, share_text, short
from pipeline.metrics.tables import Row, Table
from pipeline.system.whole_files import staged_folder, write_json

PAGE, NUMBERS = "index.html", "statistics.json"
"""Only a folder that holds the second is ever replaced."""
CLASSES_SHOWN = 25
STYLE = """
:root { color-scheme: light dark; }
body { max-width: 1000px; margin: 32px auto; padding: 0 24px; font: 15px/1.5 "Helvetica Neue", Arial, sans-serif;
  overflow-wrap: anywhere; }
table { border-collapse: collapse; font-size: 14px; font-variant-numeric: tabular-nums; }
th, td { text-align: right; padding: 4px 16px 4px 0; font-weight: normal; border-bottom: 1px solid #8884; }
th:first-child { text-align: left; }
"""


def summary_lines(labels: Labels, statistics: dict[str, Any]) -> list[str]:
    """Sentences on frames, objects, pairs and expressions, and on what made the labels."""
    counts, cells, text = statistics["counts"], statistics["cells"], statistics["text"]
    occlusion, ambiguity = statistics["occlusion"], statistics["ambiguity"]
    reasons = listed(counts["unusable"])
    others = f"; the others: {reasons}" if reasons else ""
    per_pair, candidates = cells["positives_per_pair"], counts["candidates"]
    held = "" if per_pair is None else f", {per_pair:.2f} relations hold of each on average"
    of = "" if candidates is None else f" of {counted(candidates, 'candidate')}"
    return [
        f"{counts['frames_usable']:,} of {counted(counts['frames'], 'frame')} usable, "
        f"{counted(counts['scenes'], 'scene')}, up {listed(statistics['up_source']) or 'unknown'}",
        f"{counts['objects_usable']:,} of {counted(counts['objects'], 'object')} can be asked for{others}",
        f"{share_text(occlusion['occluded_share'])} of them all are partly hidden, "
        f"{share_text(occlusion['touching_border_share'])} are cut by the border",
        f"{counted(counts['pairs'], 'pair')}{held}, {share_text(cells['pairs_without_T_share'])} have none; "
        f"{share_text(cells['u_share'])} of labels undecided",
        f"{counted(counts['expressions'], 'expression')}{of}, {counted(text['sentences'], 'sentence')} for "
        f"{counted(text['questions'], 'question')}; {share_text(ambiguity['share'])} have several right answers",
        *(f"{what}: {who}" for what, who in makers_of(labels.manifest).lines().items()),
    ]


def summary_tables(statistics: dict[str, Any]) -> tuple[Table, ...]:
    """Tables of relations, classes, distances, and numbers of right answers."""
    margins = {name: margin["T"] or {} for name, margin in statistics["margins"].items()}
    relations = [
        Row(
            name,
            (
                *(e[key] for key in ("T", "U", "F", "u_share", "T_per_pair", "expressions", "ambiguous_share")),
                *(margins[name].get(key) for key in ("p05", "p50")),
            ),
        )
        for name, e in statistics["relations"].items()
    ]
    of_class = "objects", "usable", "as_target", "as_reference"
    classes, rest = (
        list(statistics["classes"].items())[cut] for cut in (slice(CLASSES_SHOWN), slice(CLASSES_SHOWN, None))
    )
    rows = [Row(short(name), tuple(e[key] for key in of_class)) for name, e in classes]
    if rest:
        rows.append(Row(f"{len(rest):,} others", tuple(sum(e[key] for _, e in rest) for key in of_class)))
    distances = [
        Row(name if name == "unknown" else f"{name} m", (e["objects"], e["expressions"], e["u_share"]))
        for name, e in statistics["distance"].items()
    ]
    total, sizes = statistics["ambiguity"]["expressions"], statistics["ambiguity"]["set_sizes"]
    answers = [Row(size, (n, n / total)) for size, n in sizes.items()]
    heads = "T", "U", "F", "U %", "T %", "expressions", "ambiguous %", "5 % margin, cm", "median, cm"
    return (
        Table("relations", "Relations", heads, tuple(relations)),
        Table("classes", "Classes", ("objects", "usable", "target", "reference"), tuple(rows)),
        Table("distance", "Distance from the camera", ("objects", "targets", "U %"), tuple(distances)),
        Table("answers", "Right answers of an expression", ("expressions", "share %"), tuple(answers)),
    )


def write_report(labels: Labels, statistics: dict[str, Any], out: Path) -> list[Path]:
    """Write the statistics of labels as a page and as JSON; an earlier report in `out` is replaced as a whole.

    `statistics`: of the same labels, from `pipeline.labels.statistics.label_statistics`. Returns the files, the page
    first.

    Raises InputError: `out` holds something else.
    """
    out = Path(out).expanduser()
    title = escape(f"Labels of {labels.manifest.dataset.get('path', '')}")
    lines = "".join(f"{escape(line)}<br>\n" for line in summary_lines(labels, statistics))
    tables = "".join(map(_html, summary_tables(statistics)))
    page = (
        f'<!doctype html>\n<html lang="en"><head><meta charset="utf-8"><title>{title}</title><style>{STYLE}</style>'
        f"</head>\n<body><h1>{title}</h1>\n<p>{lines}</p>\n{tables}</body></html>\n"
    )
    with staged_folder(out, overwrite=True, mark=NUMBERS) as folder:
        write_json(folder / NUMBERS, statistics)
        (folder / PAGE).write_text(page, encoding="utf-8")
    return [out / PAGE, out / NUMBERS]


def _html(table: Table) -> str:
    heads = "".join(f'<th scope="col">{escape(name)}</th>' for name in ("", *table.columns))
    rows = "".join(
        f'<tr><th scope="row">{escape(row.name)}</th>{"".join(f"<td>{x}</td>" for x in table.shown(row))}</tr>\n'
        for row in table.rows
    )
    return f"<h2>{table.title}</h2>\n<table><thead><tr>{heads}</tr></thead>\n<tbody>{rows}</tbody></table>\n"
