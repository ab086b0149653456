"""Exports of labels, by the name of the format; and the two formats of the tables as they are.

JSON lines: one file a table, one row a line.
`frames.jsonl`, `objects.jsonl`, `relations.jsonl` and `expressions.jsonl` have
the columns of the tables as keys, and those of `pipeline.labels.exports.base`;
`schemas/` holds the JSON Schema of each.
A float32 column is written as the double of the same value, so that reading it
as float32 gives the same bits.

The hub: Parquet files and a dataset card.
`data/TABLE/train-00000-of-0000N.parquet`, `README.md` (the card, whose YAML
names the four tables as configs), `schemas/`. Beside its own,
every table has the columns of `pipeline.labels.exports.base`. Pictures, if
copied, are in `images/` by frame_index.
"""

from __future__ import annotations

import dataclasses
import shutil
from pathlib import Path
from types import NoneType
from typing import Any, Literal

from pipeline.datasets import Dataset
from pipeline.labels.exports import coco, kitti, scene_graph, vqa_questions
from pipeline.labels.exports.base import (
    ExportFormat,
    Job,
    Progress,
    Written,
    extended_json_schemas,
    extended_schema,
    iterate_frames,
    json_lines,
    open_provenance,
)
from pipeline.labels.frame_stream import table_batches
from pipeline.labels.reading import (
    MANIFEST_FILE,
    ROW_GROUP,
    Labels,
    arrow_schema,
    labelled_dataset,
)
from pipeline.labels.report import UNKNOWN_LICENCE, dataset_card
from pipeline.labels.schema import TABLES, write_schemas
from pipeline.system.arrow import pa, pq
from pipeline.system.errors import needed, require
from pipeline.system.frozen import dataclass
from pipeline.system.plugins import load_plugins
from pipeline.system.version import __version__
from pipeline.system.whole_files import staged_folder, text_file, write_json

ENTRY_POINT_GROUP = "spatialviz.exports"
"""Entry points of this group name an ExportFormat, and so add a format."""

MARK = "export.json"
"""Written into every export; only a folder that holds it is ever replaced."""


def export_labels(
    labels: Labels,
    format: str,
    out: str | Path,
    *,
    images: Literal["none", "copy"] = "none",
    dataset: Dataset | None = None,
    overwrite: bool = False,
    options: Any = None,
    progress: Progress | None = None,
) -> Written:
    """Write labels in another tool's format. Either the whole folder appears, or nothing does.

    Every format says of its rows where their values come from: see
    `pipeline.labels.exports.base`. Of labels that nobody corrected, all is the labeller's.

    `format`: a name of FORMATS, or a plugin's. `out`: a folder that does not exist yet or is empty. `images`: whether
    the colour images of the frames come too. `dataset`: where they come from, and the depth for what is measured; the
    dataset that the manifest names by default. `overwrite`: replace an earlier export in `out`; a folder of anything
    else is never replaced. `options`: the format's own options, such as `vqa.VqaConfig`.

    Raises InputError: an unknown format, a target that is not empty, damaged labels, or pictures that are not those of
    the labels.
    """
    chosen = _format(format)
    kind = chosen.options or NoneType
    require(kind is not NoneType or options is None, f"the format {format} has no options")
    options = kind() if options is None else options
    require(
        isinstance(options, kind), f"options of the format {format}", got=type(options).__name__, expected=kind.__name__
    )
    require(images in ("none", "copy"), "images", got=repr(images), expected="none | copy")
    out = Path(out).expanduser()
    target, root = out.resolve(), labels.root.resolve()
    require(
        target != root and target not in root.parents,
        "an export cannot replace the labels",
        expected="another folder",
        path=out,
    )

    def opened() -> Dataset:
        return dataset or labelled_dataset(labels.manifest)

    with staged_folder(out, overwrite=overwrite, mark=MARK) as folder:
        copy = opened() if images == "copy" else None
        provenance = open_provenance(labels)
        written = chosen.write(
            Job(labels, folder, copy, progress or (lambda done, of: None), options, provenance, opened)
        )
        shutil.copyfile(labels.root / MANIFEST_FILE, folder / MANIFEST_FILE)
        record = {
            "tool": "spatialviz",
            "version": __version__,
            "format": format,
            "files": written.files,
            "rows": written.rows,
            "notes": written.notes,
            "base": provenance.base,
            "made_by": provenance.made_by,
            "options": None if options is None else dataclasses.asdict(options),
        }
        write_json(folder / MARK, record)
    return dataclasses.replace(written, files=(*written.files, MANIFEST_FILE, MARK))


def _format(name: str) -> ExportFormat:
    formats = FORMATS
    if name not in FORMATS:
        formats = {**dict(load_plugins(ENTRY_POINT_GROUP, "export", ExportFormat)), **FORMATS}
    require(name in formats, "no such export format", got=repr(name), expected=" | ".join(formats))
    return formats[name]


ROWS_A_FILE = 1_000_000
GROUP_BYTES = 1 << 25
"""What is held of a row group before it is written: masks make some rows long."""


@dataclass(frozen=True)
class HubConfig:
    """Options of the export."""

    rows_a_file: int = ROWS_A_FILE
    licence: str = UNKNOWN_LICENCE
    """Of the source dataset, as the card states it."""

    def __post_init__(self) -> None:
        require(self.rows_a_file >= 1, "a file needs at least one row", got=self.rows_a_file)


def write_hub(job: Job) -> Written:
    """Write data, card, metadata and schemas."""
    options: HubConfig = job.options
    files = [path for name in TABLES for path in _write_table(job, name, options.rows_a_file)]
    rows = {name: job.labels.manifest.tables[name].rows for name in TABLES}
    write_schemas(job.folder / "schemas")
    extended_json_schemas(job.folder / "schemas")
    with text_file(job.folder / "README.md") as card:
        card.write(dataset_card(job.labels, licence=options.licence, files={n: f"data/{n}/*.parquet" for n in TABLES}))
    return Written(("README.md", *files, "schemas/", *copy_images(job)), rows)


def _write_table(job: Job, name: str, rows_a_file: int) -> list[str]:
    total = job.labels.manifest.tables[name].rows
    count = max(1, -(-total // rows_a_file))
    (job.folder / "data" / name).mkdir(parents=True)
    batches = table_batches(job.labels, name)
    waiting = arrow_schema(name).empty_table()
    found = []
    for number in range(count):
        path = job.folder / "data" / name / f"train-{number:05d}-of-{count:05d}.parquet"
        left = min(rows_a_file, total - number * rows_a_file)
        group: list[pa.Table] = []
        rows = size = 0
        with pq.ParquetWriter(path, extended_schema(name), compression="zstd") as writer:
            while left:
                if not waiting.num_rows:
                    what = f"the table {name} has fewer rows than its manifest says"
                    waiting = needed(next(batches, None), what, path=job.labels.root)
                taken = waiting.slice(0, left)
                waiting = waiting.slice(taken.num_rows)
                left -= taken.num_rows
                group.append(taken)
                rows, size = rows + taken.num_rows, size + taken.nbytes
                if not left or rows >= ROW_GROUP or size >= GROUP_BYTES:
                    writer.write_table(
                        job.provenance.extend(name, pa.concat_tables(group).combine_chunks()), row_group_size=ROW_GROUP
                    )
                    group.clear()
                    rows = size = 0
        found.append(path.relative_to(job.folder).as_posix())
    require(
        not waiting.num_rows and next(batches, None) is None,
        f"the table {name} has more rows than its manifest says",
        path=job.labels.root,
    )
    return found


BLOCK = 1 << 24
"""Bytes that are parsed at a time when JSON lines are read; no line may be longer."""


def write_jsonl(job: Job) -> Written:
    """Write the four files and their schemas."""
    rows: dict[str, int] = {}
    frames = job.labels.manifest.tables["frames"].rows
    for name in TABLES:
        rows[name] = 0
        with text_file(job.folder / f"{name}.jsonl") as file:
            for batch in table_batches(job.labels, name):
                file.writelines(
                    line[:-2] + end
                    for line, end in zip(json_lines(batch), job.provenance.line_ends(name, batch), strict=True)
                )
                rows[name] += batch.num_rows
                if name == "relations":  # By far the longest.
                    job.tell(min(batch.column("frame_index")[-1].as_py() + 1, frames), frames)
    write_schemas(job.folder / "schemas")
    extended_json_schemas(job.folder / "schemas")
    return Written((*(f"{name}.jsonl" for name in TABLES), "schemas/", *copy_images(job)), rows)


def copy_images(job: Job) -> tuple[str, ...]:
    """Copy pictures of usable frames to `images/` if wanted; returns the files."""
    if job.images is None:
        return ()
    for rows in iterate_frames(job.labels, job.tell):
        job.copy_picture(rows)
    return ("images/",)


FORMATS: dict[str, ExportFormat] = {
    "jsonl": ExportFormat(write_jsonl, description="JSON lines, one file a table; lossless"),
    "coco": coco.FORMAT,
    "kitti": kitti.FORMAT,
    "vqa": vqa_questions.FORMAT,
    "scene-graph": scene_graph.FORMAT,
    "parquet": ExportFormat(
        write_hub,
        description="Parquet with a dataset card, as the Hugging Face hub wants it; lossless",
        options=HubConfig,
    ),
}
"""The formats by name. A new one is one file and one line here."""
