"""The dataset card of labels, and their Croissant metadata: what they are, how they were made, how far to trust them.

Both need the merged tables and the manifest, and read only the columns that they count.
"""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import PurePosixPath
from typing import Any

from pipeline.labels.makers import makers_of
from pipeline.labels.reading import Labels
from pipeline.labels.schema import SCHEMA_VERSION, TABLES, Manifest
from pipeline.labels.tables import arrow_schema
from pipeline.system.arrow import pa, pc, pq

UNKNOWN_LICENCE = "unknown: ask the dataset's owner"
_HUB_LICENCE = re.compile(r"[a-z0-9][a-z0-9.+-]*")
_SIZES = (("n<1K", 10**3), ("1K<n<10K", 10**4), ("10K<n<100K", 10**5), ("100K<n<1M", 10**6), ("1M<n<10M", 10**7),
          ("10M<n<100M", 10**8), ("100M<n<1B", 10**9), ("1B<n<10B", 10**10))  # fmt: skip

CONTEXT: dict[str, Any] = {
    "@language": "en",
    "@vocab": "https://schema.org/",
    "data": {"@id": "cr:data", "@type": "@json"},
    "dataType": {"@id": "cr:dataType", "@type": "@vocab"},
    "examples": {"@id": "cr:examples", "@type": "@json"},
    "cr": "http://mlcommons.org/croissant/",
    "rai": "http://mlcommons.org/croissant/RAI/",
    "dct": "http://purl.org/dc/terms/",
    "sc": "https://schema.org/",
    "conformsTo": "dct:conformsTo",
    **{
        name: f"cr:{name}"
        for name in (
            "citeAs", "column", "equivalentProperty", "extract", "field", "fileProperty", "fileObject", "fileSet",
            "format", "includes", "isLiveDataset", "jsonPath", "key", "md5", "parentField", "path", "recordSet",
            "references", "regex", "repeated", "replace", "samplingRate", "separator", "source", "subField",
            "transform",
        )
    },
}  # fmt: skip
"""The JSON-LD context of Croissant 1.0, docs.mlcommons.org/croissant/docs/croissant-spec.html."""


@dataclass(frozen=True)
class DataFile:
    """A Parquet file of a table: path below the folder, rows, sha256."""

    path: str
    rows: int
    sha256: str


@dataclass(frozen=True)
class Counts:
    """What the card counts.

    Attributes
    ----------
    states : dict of str to (int, int, int)
        By relation, pairs that are T, U and F.
    expressions : dict of str to int
        By relation.
    ambiguous : int
        Expressions that more than one object satisfies.
    usable, boxed : int
        Objects that are asked for, and those with a 3D box.
    """

    states: dict[str, tuple[int, int, int]]
    expressions: dict[str, int]
    ambiguous: int
    usable: int
    boxed: int

    @property
    def doubtful_share(self) -> float:
        """Share of U among all judged (pair, relation)."""
        judged = sum(map(sum, self.states.values()))
        return sum(u for _, u, _ in self.states.values()) / judged if judged else 0.0


def count_labels(labels: Labels) -> Counts:
    """Count states, expressions and objects, a batch at a time."""
    states = {name: [0, 0, 0] for name in labels.relation_names}
    for batch in _columns(labels, "relations", tuple(states)):
        for name, found in states.items():
            for entry in pc.value_counts(batch.column(name)).to_pylist():  # pyright: ignore[reportAttributeAccessIssue]
                if entry["values"] is not None:
                    found[1 - entry["values"]] += entry["counts"]
    expressions = dict.fromkeys(labels.relation_names, 0)
    ambiguous = usable = boxed = 0
    for batch in _columns(labels, "expressions", ("relation", "ambiguous")):
        for entry in pc.value_counts(batch.column("relation")).to_pylist():  # pyright: ignore[reportAttributeAccessIssue]
            expressions[entry["values"]] = expressions.get(entry["values"], 0) + entry["counts"]
        ambiguous += _true(batch.column("ambiguous"))
    for batch in _columns(labels, "objects", ("usable", "center")):
        usable += _true(batch.column("usable"))
        boxed += batch.num_rows - batch.column("center").null_count
    return Counts({n: (t, u, f) for n, (t, u, f) in states.items()}, expressions, ambiguous, usable, boxed)


def _columns(labels: Labels, name: str, columns: Sequence[str]) -> Iterator[pa.RecordBatch]:
    with pq.ParquetFile(labels.root / f"{name}.parquet") as file:
        yield from file.iter_batches(columns=list(columns))


def _true(column: Any) -> int:
    return pc.sum(column).as_py() or 0  # pyright: ignore[reportAttributeAccessIssue]


def dataset_name(labels: Labels) -> str:
    """The source dataset by its last folder: a card must not tell where somebody keeps it."""
    return PurePosixPath(str(labels.manifest.dataset.get("path", "")).replace("\\", "/")).name or "dataset"


def dataset_card(labels: Labels, *, licence: str = UNKNOWN_LICENCE, files: Mapping[str, str] | None = None) -> str:
    """The README.md of labels: Hugging Face's YAML, then a page for people.

    Parameters
    ----------
    labels : Labels
    licence : str
        Of the source dataset.
    files : mapping of str to str, optional
        Path or pattern of each table's files below the folder; by default those of a labels folder.
    """
    manifest, counts, name = labels.manifest, count_labels(labels), dataset_name(labels)
    paths = dict(files) if files is not None else {table: manifest.tables[table].file for table in TABLES}
    return "\n".join((*_yaml(labels, name, licence, paths), "", *_page(labels, counts, name, licence))) + "\n"


def _yaml(labels: Labels, name: str, licence: str, paths: Mapping[str, str]) -> Iterator[str]:
    def text(value: str) -> str:
        # A JSON string is a YAML string, whatever is in it.
        return json.dumps(value, ensure_ascii=False)

    yield "---"
    if licence == UNKNOWN_LICENCE:
        yield "license: unknown"
    elif _HUB_LICENCE.fullmatch(licence):
        yield f"license: {text(licence)}"
    else:
        yield "license: other"
        yield f"license_name: {text(licence)}"
    yield f"pretty_name: {text(f'Spatial relations of {name}')}"
    yield from ("language:", "- en", "annotations_creators:", "- machine-generated")
    yield from ("task_categories:", "- object-detection", "- visual-question-answering")
    yield from ("tags:", "- rgb-d", "- spatial-reasoning", "- referring-expressions", "- 3d-boxes", "- pseudo-labels")
    largest = max(labels.manifest.tables[table].rows for table in TABLES)
    yield f"size_categories:\n- {next((size for size, below in _SIZES if largest < below), 'n>1T')}"
    yield "configs:"
    for table in TABLES:
        default = "\n  default: true" if table == "expressions" else ""
        yield f"- config_name: {table}{default}\n  data_files:\n  - split: train\n    path: {text(paths[table])}"
    yield "---"


def _page(labels: Labels, counts: Counts, name: str, licence: str) -> Iterator[str]:
    manifest = labels.manifest
    total = {table: manifest.tables[table].rows for table in TABLES}
    ambiguity = counts.ambiguous / total["expressions"] if total["expressions"] else 0.0
    yield f"# Spatial relations of {_plain(name)}"
    yield ""
    yield (
        f"Pseudo-labels of {total['frames']} RGB-D frames ({manifest.counts.get('frames_usable', 0)} usable): "
        f"{total['objects']} objects with 2D and 3D boxes, {total['relations']} ordered pairs with their spatial "
        f"relations, and {total['expressions']} referring expressions. {_checked(manifest)}"
    )
    yield "\n## How they were made\n"
    yield f"* Tool: {manifest.tool} {manifest.version}, schema {manifest.schema_version}, {manifest.created}."
    yield f"* Source: `{_plain(name)}`, format {_plain(str(manifest.dataset.get('format')))}."
    yield (
        "* Each object's mask and depth give its points; stray pixels are removed and an oriented box is fitted. "
        f"The rule profile `{manifest.profile.get('name')}` judges every ordered pair from extents along the viewer's "
        "level right, up and forward: T (1) it holds, F (-1) it does not, U (0) too close to call."
    )
    yield f"* Profile hash `{manifest.profile_hash}`."
    yield from (f"* {what.capitalize()}: {_plain(who)}." for what, who in makers_of(manifest).lines().items())
    yield f"* Configuration hash `{manifest.config_hash}`, seed {manifest.seed}."
    yield "\n## What is in them\n"
    yield f"* Objects that are asked for: {counts.usable} of {total['objects']}; with a 3D box: {counts.boxed}."
    yield f"* Too close to call (U): {counts.doubtful_share:.1%} of all judged relations of pairs."
    yield f"* Ambiguous expressions, with more than one acceptable answer: {counts.ambiguous} ({ambiguity:.1%})."
    yield "\n| relation | T | U | F | expressions |\n|---|---:|---:|---:|---:|"
    for relation, (t, u, f) in counts.states.items():
        yield f"| {relation} | {t} | {u} | {f} | {counts.expressions.get(relation, 0)} |"
    yield "\n| table | rows | content hash |\n|---|---:|---|"
    for table in TABLES:
        yield f"| {table} | {total[table]} | `{manifest.tables[table].content_hash}` |"
    yield "\n## Intended use\n"
    yield (
        "Training and debugging models of spatial relations and visual grounding. Leave U out of training and of "
        "scores, or treat it as a class of its own. Split by `scene`, never by frame: frames of one scene show the "
        "same objects."
    )
    yield "\n## Limits\n"
    yield "* All relations are the viewer's; nothing here knows an object's own front."
    yield "* Boxes are fitted to what one camera sees: an occluded or cut-off object is larger than its box."
    yield "* Errors of masks, class names and depth go into the labels; `occluded`, `kept`, `depth_missing` and "
    yield "  `touches_border` say where to expect them. `up_source` says how gravity was known."
    yield "* Numbers from these labels compare models against rules, not against people. Who shares a maker with them"
    yield "  (the detector, the rule, the second opinion) is measured by its own work: that is agreement, not accuracy."
    yield "\n## Licence\n"
    yield f"Of the source dataset: {_plain(licence)}. The labels are derived from it."


def _checked(manifest: Manifest) -> str:
    said = manifest.corrections
    if said is None:
        return "No person has checked them."
    return (
        f"People corrected {said.get('human', 0)} values, from which {said.get('recomputed', 0)} others were recomputed"
        f" ({said.get('stale', 0)} are stale); all others nobody has corrected. In exports, `provenance` of each row "
        "says which."
    )


def _plain(text: str) -> str:
    """Text from outside, on one line and without Markdown's marks."""
    return re.sub(r"[`|<>*\[\]]", "", " ".join(text.split()))


def croissant(
    labels: Labels,
    *,
    licence: str = UNKNOWN_LICENCE,
    files: Mapping[str, Sequence[DataFile]] | None = None,
    schema: Callable[[str], pa.Schema] = arrow_schema,
) -> dict[str, Any]:
    """Croissant 1.0 metadata as JSON-LD.

    Parameters
    ----------
    labels : Labels
    licence : str
    files : mapping of str to sequence of DataFile, optional
        The files of each table; by default those of a labels folder.
    schema : callable
        The Arrow schema of a table in those files, by name.
    """
    manifest, name = labels.manifest, dataset_name(labels)
    found: Mapping[str, Sequence[DataFile]] = files or {
        table: [DataFile(t.file, t.rows, t.sha256)] for table, t in manifest.tables.items()
    }
    distribution: list[dict[str, Any]] = []
    records: list[dict[str, Any]] = []
    for table in TABLES:
        distribution += _distribution(table, found[table])
        records.append(_record_set(table, schema(table), single=len(found[table]) == 1))
    return {
        "@context": CONTEXT,
        "@type": "sc:Dataset",
        "conformsTo": "http://mlcommons.org/croissant/1.0",
        "name": re.sub(r"[^A-Za-z0-9_.-]+", "-", f"spatial-relations-{name}").strip("-"),
        "description": (
            f"Pseudo-labels of RGB-D frames: objects, spatial relations of every ordered pair, referring expressions. "
            f"Rule profile {manifest.profile.get('name')} ({manifest.profile_hash})."
        ),
        "license": licence,
        "version": SCHEMA_VERSION,
        "datePublished": manifest.created,
        "creator": {"@type": "sc:Organization", "name": f"{manifest.tool} {manifest.version}"},
        "keywords": ["RGB-D", "spatial relations", "referring expressions", "pseudo-labels"],
        "isLiveDataset": False,
        "distribution": distribution,
        "recordSet": records,
    }


def _distribution(table: str, files: Sequence[DataFile]) -> Iterator[dict[str, Any]]:
    single = len(files) == 1
    for number, file in enumerate(files):
        yield {
            "@type": "cr:FileObject",
            "@id": table if single else f"{table}-{number:05d}",
            "name": PurePosixPath(file.path).name,
            "contentUrl": file.path,
            "encodingFormat": "application/x-parquet",
            "sha256": file.sha256,
        }
    if not single:
        yield {
            "@type": "cr:FileSet",
            "@id": table,
            "name": table,
            "containedIn": [{"@id": f"{table}-{number:05d}"} for number in range(len(files))],
            "encodingFormat": "application/x-parquet",
            "includes": str(PurePosixPath(files[0].path).with_name("*.parquet")),
        }


def _record_set(table: str, schema: pa.Schema, *, single: bool) -> dict[str, Any]:
    def data_type(kind: pa.DataType) -> str:
        if pa.types.is_boolean(kind):
            return "sc:Boolean"
        if pa.types.is_integer(kind):
            return "sc:Integer"
        return "sc:Float" if pa.types.is_floating(kind) else "sc:Text"

    fields = []
    for field in schema:
        listed = pa.types.is_list(field.type)
        if listed and pa.types.is_struct(field.type.value_type):
            # Records within records: readers of Croissant do not agree on them, and the card tells of them.
            continue
        fields.append(
            {
                "@type": "cr:Field",
                "@id": f"{table}/{field.name}",
                "name": field.name,
                "dataType": data_type(field.type.value_type if listed else field.type),
                **({"repeated": True} if listed else {}),
                "source": {("fileObject" if single else "fileSet"): {"@id": table}, "extract": {"column": field.name}},
            }
        )
    description = (TABLES[table].__doc__ or "").strip().split("\n")[0]
    # A record set may not share its id with the file it is read from.
    return {"@type": "cr:RecordSet", "@id": f"{table}-rows", "name": table, "description": description, "field": fields}
