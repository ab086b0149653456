"""JSON lines: one file a table, one row a line, every value in full. Lossless.

`frames.jsonl`, `objects.jsonl`, `relations.jsonl` and `expressions.jsonl` have
the columns of the tables as keys, and those of `pipeline.labels.exports.provenance`;
`schemas/` holds the JSON Schema of each.
A float32 column is written as the double of the same value, so that reading it
as float32 gives the same bits.
"""

from __future__ import annotations

from pathlib import Path

from pipeline.labels.exports.base import ExportFormat, Job, Written, image_name, iterate_frames, table_batches
from pipeline.labels.exports.provenance import extended_json_schemas, extended_schema, json_lines
from pipeline.labels.schema import TABLES, write_schemas
from pipeline.labels.tables import arrow_schema
from pipeline.system.arrow import pa, pj
from pipeline.system.errors import InputError, require
from pipeline.system.whole_files import text_file

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
        if rows.frame["ok"]:
            job.images.write(rows.frame, job.folder / image_name(rows.index))
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
    try:
        if path.stat().st_size == 0:
            return schema.empty_table()
        found = pj.read_json(
            path,
            read_options=pj.ReadOptions(block_size=BLOCK),
            parse_options=pj.ParseOptions(
                explicit_schema=extended_schema(name).remove_metadata(), unexpected_field_behavior="error"
            ),
        )
    except FileNotFoundError as error:
        raise InputError(f"the table {name} is missing", path=path) from error
    except (pa.ArrowInvalid, pa.ArrowTypeError, OSError) as error:
        raise InputError(f"not rows of {name}", got=str(error).split("\n")[0], path=path) from error
    for field in schema:
        require(
            not (not field.nullable and found.column(field.name).null_count),
            f"a row of {name} lacks {field.name!r}",
            path=path,
        )
    return pa.Table.from_arrays([found.column(n) for n in schema.names], schema=schema)


FORMAT = ExportFormat(write_jsonl, read_jsonl, "JSON lines, one file a table; lossless")
