"""Words on labels: statistics in sentences and tables, for the shell and as a page, and the dataset card."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from functools import partial
from html import escape
from pathlib import Path, PurePosixPath
from typing import Any

from pipeline.labels.provenance import makers_of
from pipeline.labels.reading import SENTENCES_FILE, Labels
from pipeline.labels.schema import TABLES, Manifest
from pipeline.labels.statistics import open_database, relation_counts
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
        f"{counted(text['questions'], 'question')}; {share_text(ambiguity['share'])} have several correct answers",
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
    classes = statistics["classes"]
    rows = [Row(short(name), tuple(classes[name][key] for key in of_class)) for name in list(classes)[:CLASSES_SHOWN]]
    if rest := list(classes.values())[CLASSES_SHOWN:]:
        rows.append(Row(f"{len(rest):,} others", tuple(sum(e[key] for e in rest) for key in of_class)))
    distances = [
        Row(name if name == "unknown" else f"{name} m", (e["objects"], e["expressions"], e["u_share"]))
        for name, e in statistics["distance"].items()
    ]
    total, sizes = statistics["ambiguity"]["expressions"], statistics["ambiguity"]["set_sizes"]
    answers = [Row(size, (n, n / total)) for size, n in sizes.items()]
    # A table shows what lies between 0 and 1 in hundredths: shares in percent, metres in centimetres.
    heads = "T", "U", "F", "U %", "T %", "expressions", "ambiguous %", "5 % margin, cm", "median, cm"
    return (
        Table("relations", "Relations", heads, tuple(relations)),
        Table("classes", "Classes", ("objects", "usable", "target", "reference"), tuple(rows)),
        Table("distance", "Distance from the camera", ("objects", "targets", "U %"), tuple(distances)),
        Table("answers", "Correct answers of an expression", ("expressions", "share %"), tuple(answers)),
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


UNKNOWN_LICENCE = "unknown: ask the dataset's owner"
_HUB_LICENCE = re.compile(r"[a-z0-9][a-z0-9.+-]*")
_SIZES = (("n<1K", 10**3), ("1K<n<10K", 10**4), ("10K<n<100K", 10**5), ("100K<n<1M", 10**6), ("1M<n<10M", 10**7),
          ("10M<n<100M", 10**8), ("100M<n<1B", 10**9), ("1B<n<10B", 10**10))  # fmt: skip


def dataset_name(labels: Labels) -> str:
    """Last folder of the source dataset: a card must not tell where somebody keeps it."""
    return PurePosixPath(str(labels.manifest.dataset.get("path", "")).replace("\\", "/")).name or "dataset"


def dataset_card(labels: Labels, *, licence: str = UNKNOWN_LICENCE, files: Mapping[str, str] | None = None) -> str:
    """The README.md of labels: Hugging Face's YAML, then a page for people.

    `files`: path or pattern of each table's files below the folder; by default those of a labels folder.
    """
    paths = files or {table: labels.manifest.tables[table].file for table in TABLES}
    # The sentences stand in a labels folder, and in no export.
    sentences = "" if files else _sentences(labels.manifest)
    return f"{_yaml(labels, licence, paths)}\n{_page(labels, licence, sentences)}"


def _sentences(manifest: Manifest) -> str:
    if not manifest.sentences:
        return ""
    rows = "".join(f"| {kind} | {count} |\n" for kind, count in manifest.sentences.items())
    return f"""\
Besides the expressions, `{SENTENCES_FILE}` has sentences for `spatialviz eval --sentences`, each with all its correct \
answers among the labelled objects. What the labels leave undecided is in none of them.

| kind of sentence | sentences |
|---|---:|
{rows}
"""


def _yaml(labels: Labels, licence: str, paths: Mapping[str, str]) -> str:
    # A JSON string is a YAML string, whatever is in it.
    text = partial(json.dumps, ensure_ascii=False)
    declared = f"license: other\nlicense_name: {text(licence)}"
    if licence == UNKNOWN_LICENCE:
        declared = "license: unknown"
    elif _HUB_LICENCE.fullmatch(licence):
        declared = f"license: {text(licence)}"
    largest = max(labels.manifest.tables[table].rows for table in TABLES)
    configs = "\n".join(
        f"- config_name: {table}"
        + ("\n  default: true" if table == "expressions" else "")
        + f"\n  data_files:\n  - split: train\n    path: {text(paths[table])}"
        for table in TABLES
    )
    return f"""\
---
{declared}
pretty_name: {text(f"Spatial relations of {dataset_name(labels)}")}
language:
- en
annotations_creators:
- machine-generated
task_categories:
- object-detection
- visual-question-answering
tags:
- rgb-d
- spatial-reasoning
- referring-expressions
- 3d-boxes
- pseudo-labels
size_categories:
- {next((size for size, below in _SIZES if largest < below), "n>1T")}
configs:
{configs}
---
"""


def _page(labels: Labels, licence: str, sentences: str) -> str:
    manifest, name = labels.manifest, _plain(dataset_name(labels))
    total = {table: manifest.tables[table].rows for table in TABLES}
    with open_database(labels) as database:
        relations, cells = relation_counts(database, labels.relation_names)
        ((ambiguous,),) = database.rows("SELECT count(*) FILTER (ambiguous) FROM expressions")
        ((usable, boxed),) = database.rows("SELECT count(*) FILTER (usable), count(center) FROM objects")
    ambiguity = ambiguous / total["expressions"] if total["expressions"] else 0.0
    undecided = cells["U"] / max(cells["T"] + cells["U"] + cells["F"], 1)
    makers = "\n".join(f"* {what.capitalize()}: {_plain(who)}." for what, who in makers_of(manifest).lines().items())
    states = "".join(
        f"| {relation} | {n['T']} | {n['U']} | {n['F']} | {n['expressions']} |\n" for relation, n in relations.items()
    )
    tables = "".join(f"| {t} | {total[t]} | `{manifest.tables[t].content_hash}` |\n" for t in TABLES)
    return f"""\
# Spatial relations of {name}

Pseudo-labels of {total["frames"]} RGB-D frames ({manifest.counts.get("frames_usable", 0)} usable): \
{total["objects"]} objects with 2D and 3D boxes, {total["relations"]} ordered pairs with their spatial \
relations, and {total["expressions"]} referring expressions. {_checked(manifest)}

## How they were made

* Tool: {manifest.tool} {manifest.version}, schema {manifest.schema_version}, {manifest.created}.
* Source: `{name}`, format {_plain(str(manifest.dataset.get("format")))}.
* Each object's mask and depth give its points; stray pixels are removed and an oriented box is fitted. \
The rule profile `{manifest.profile.get("name")}` judges every ordered pair from extents along the viewer's \
level right, up and forward: T (1) it holds, F (-1) it does not, U (0) too close to call.
* Profile hash `{manifest.profile_hash}`.
{makers}
* Configuration hash `{manifest.config_hash}`, seed {manifest.seed}.

## What is in them

* Objects that are asked for: {usable} of {total["objects"]}; with a 3D box: {boxed}.
* Too close to call (U): {undecided:.1%} of all judged relations of pairs.
* Ambiguous expressions, with more than one acceptable answer: {ambiguous} ({ambiguity:.1%}).

| relation | T | U | F | expressions |
|---|---:|---:|---:|---:|
{states}
{sentences}| table | rows | content hash |
|---|---:|---|
{tables}
## Intended use

Training and debugging models of spatial relations and visual grounding. Leave U out of training and of \
scores, or treat it as a class of its own. Split by `scene`, never by frame: frames of one scene show the \
same objects.

## Limits

* All relations are the viewer's; nothing here knows an object's own front.
* Boxes are fitted to what one camera sees: an occluded or cut-off object is larger than its box.
* Errors of masks, class names and depth go into the labels; `occluded`, `kept`, `depth_missing` and \

  `touches_border` say where to expect them. `up_source` says how gravity was known.
* Numbers from these labels compare models against rules, not against people. Who shares a maker with them
  (the detector, the rule, the second opinion) is measured by its own work: that is agreement, not accuracy.

## Licence

Of the source dataset: {_plain(licence)}. The labels are derived from it.
"""


def _checked(manifest: Manifest) -> str:
    made = manifest.corrections
    if made is None:
        return "No person has checked them."
    return (
        f"People corrected {made.get('human', 0)} values, from which {made.get('recomputed', 0)} others were recomputed"
        f" ({made.get('stale', 0)} are stale); all others nobody has corrected. In exports, `provenance` of each row "
        "says which."
    )


def _plain(text: str) -> str:
    """Text from outside, on one line and without Markdown's marks."""
    return re.sub(r"[`|<>*\[\]]", "", " ".join(text.split()))
