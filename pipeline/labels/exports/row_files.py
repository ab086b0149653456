"""The tables row by row and in full, lossless: JSON lines, and the layout of the Hugging Face hub.

JSON lines: one file a table, one row a line.
`frames.jsonl`, `objects.jsonl`, `relations.jsonl` and `expressions.jsonl` have
the columns of the tables as keys, and those of `pipeline.labels.exports.provenance`;
`schemas/` holds the JSON Schema of each.
A float32 column is written as the double of the same value, so that reading it
as float32 gives the same bits.

The hub: Parquet files, a dataset card and Croissant metadata.
`data/TABLE/train-00000-of-0000N.parquet`, `README.md` (the card, whose YAML
names the four tables as configs), `croissant.json`, `schemas/`. Beside its own,
every table has the columns of `pipeline.labels.exports.provenance`. Pictures, if
copied, are in `images/` by frame_index.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from pipeline.labels.card import UNKNOWN_LICENCE, DataFile, croissant, dataset_card
from pipeline.labels.exports.base import ExportFormat, Job, Written, iterate_frames, table_batches
from pipeline.labels.exports.provenance import extended_json_schemas, extended_schema, json_lines
from pipeline.labels.reading import ROW_GROUP, arrow_schema, read_table
from pipeline.labels.schema import TABLES, write_schemas
from pipeline.system.arrow import pa, pj, pq
from pipeline.system.errors import as_input_error, first_line, present, require
from pipeline.system.staging import text_file, write_json
from pipeline.system.whole_files import sha256_of

ROWS_A_FILE = 1_000_000
GROUP_BYTES = 1 << 25
"""What is held of a row group before it is written: masks make some rows long."""


@dataclass(frozen=True)
class HubConfig:
    """Options of the export.

    Attributes
    ----------
    rows_a_file : int
    licence : str
        Of the source dataset, as the card states it.
    """

    rows_a_file: int = ROWS_A_FILE
    licence: str = UNKNOWN_LICENCE

    def __post_init__(self) -> None:
        require(self.rows_a_file >= 1, "a file needs at least one row", got=self.rows_a_file)


def write_hub(job: Job) -> Written:
    """Write data, card, metadata and schemas."""
    options: HubConfig = job.options
    files = {name: _write_table(job, name, options.rows_a_file) for name in TABLES}
    rows = {name: sum(file.rows for file in found) for name, found in files.items()}
    write_schemas(job.folder / "schemas")
    extended_json_schemas(job.folder / "schemas")
    with text_file(job.folder / "README.md") as card:
        card.write(dataset_card(job.labels, licence=options.licence, files={n: f"data/{n}/*.parquet" for n in TABLES}))
    write_json(
        job.folder / "croissant.json",
        croissant(job.labels, licence=options.licence, files=files, schema=extended_schema),
    )
    data = (file.path for found in files.values() for file in found)
    return Written(("README.md", "croissant.json", *data, "schemas/", *copy_images(job)), rows)


def _write_table(job: Job, name: str, rows_a_file: int) -> list[DataFile]:
    """One table, cut into files of `rows_a_file` rows; of an empty one an empty file."""
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
                    waiting = present(next(batches, None), what, path=job.labels.root)
                taken = waiting.slice(0, left)
                waiting = waiting.slice(taken.num_rows)
                left -= taken.num_rows
                group.append(taken)
                rows, size = rows + taken.num_rows, size + taken.nbytes
                if not left or rows >= ROW_GROUP or size >= GROUP_BYTES:
                    whole = job.provenance.extend(name, pa.concat_tables(group).combine_chunks())
                    writer.write_table(whole, row_group_size=ROW_GROUP)
                    group.clear()
                    rows = size = 0
        relative = path.relative_to(job.folder).as_posix()
        found.append(DataFile(relative, min(rows_a_file, total - number * rows_a_file), sha256_of(path)))
    require(
        not waiting.num_rows and next(batches, None) is None,
        f"the table {name} has more rows than its manifest says",
        path=job.labels.root,
    )
    return found


def read_hub(root: Path) -> dict[str, pa.Table]:
    """The four tables, their files joined in order.

    Raises
    ------
    InputError
        Files are missing or damaged.
    """
    tables = {}
    for name in TABLES:
        paths = sorted((root / "data" / name).glob("train-*-of-*.parquet"))
        require(
            paths and paths[0].name.endswith(f"-of-{len(paths):05d}.parquet"),
            f"files of the table {name} are missing",
            path=root / "data" / name,
        )
        tables[name] = pa.concat_tables([read_table(path, name, arrow_schema(name).names) for path in paths])
    return tables


PARQUET = ExportFormat(
    write_hub, read_hub, "Parquet with a dataset card and Croissant, as the Hugging Face hub wants it; lossless",
    options=HubConfig,
)  # fmt: skip


BLOCK = 1 << 24
"""Bytes that are parsed at a time; no line may be longer."""


def write_jsonl(job: Job) -> Written:
    """Write the four files and their schemas."""
    rows: dict[str, int] = {}
    frames = job.labels.manifest.tables["frames"].rows
    for name in TABLES:
        rows[name] = 0
        with text_file(job.folder / f"{name}.jsonl") as file:
            for batch in table_batches(job.labels, name):
                ends = job.provenance.line_ends(name, batch)
                file.writelines(line[:-2] + end for line, end in zip(json_lines(batch), ends, strict=True))
                rows[name] += batch.num_rows
                if name == "relations":  # By far the longest.
                    job.tell(min(batch.column("frame_index")[-1].as_py() + 1, frames), frames)
    write_schemas(job.folder / "schemas")
    extended_json_schemas(job.folder / "schemas")
    return Written((*(f"{name}.jsonl" for name in TABLES), "schemas/", *copy_images(job)), rows)


def copy_images(job: Job) -> tuple[str, ...]:
    """Copy the pictures of all usable frames to `images/`, where they are wanted; what was written."""
    if job.images is None:
        return ()
    for rows in iterate_frames(job.labels, job.tell):
        job.copy_picture(rows)
    return ("images/",)


def read_jsonl(root: Path) -> dict[str, pa.Table]:
    """The four tables."""
    return {name: read_rows(root / f"{name}.jsonl", name) for name in TABLES}


def read_rows(path: Path, name: str) -> pa.Table:
    """One table from its file of JSON lines.

    Raises
    ------
    InputError
        The file is missing, or a line of it is no row of that table.
    """
    schema = arrow_schema(name)
    with (
        as_input_error(f"not rows of {name}", pa.ArrowInvalid, pa.ArrowTypeError, OSError, got=first_line, path=path),
        as_input_error(f"the table {name} is missing", FileNotFoundError, path=path),
    ):
        if path.stat().st_size == 0:
            return schema.empty_table()
        found = pj.read_json(
            path,
            read_options=pj.ReadOptions(block_size=BLOCK),
            parse_options=pj.ParseOptions(
                explicit_schema=extended_schema(name).remove_metadata(), unexpected_field_behavior="error"
            ),
        )
    for field in schema:
        require(
            not (not field.nullable and found.column(field.name).null_count),
            f"a row of {name} lacks {field.name!r}",
            path=path,
        )
    return pa.Table.from_arrays([found.column(n) for n in schema.names], schema=schema)


JSONL = ExportFormat(write_jsonl, read_jsonl, "JSON lines, one file a table; lossless")
