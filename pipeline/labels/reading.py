"""Labels as Arrow tables, and the folder that holds them.

Tables: the schema from the models, building, writing whole or not at all, and hashing rows. Merged labels: opening
them, each table checked when it is read, and the dataset that they were made from.
"""

from __future__ import annotations

import hashlib
import os
import types
import typing
from collections.abc import Collection, Iterable, Mapping, Sequence
from functools import cached_property, lru_cache
from pathlib import Path
from typing import IO, Any

import numpy as np

from pipeline.datasets import Dataset, open_dataset
from pipeline.datasets.demo import found_by_name
from pipeline.labels.schema import ADDED_COLUMNS, SCHEMA_VERSION, TABLES, Manifest
from pipeline.language.relation_names import PAIRWISE
from pipeline.system.arrow import Repeated, pa, pc, pq, typed
from pipeline.system.errors import InputError, Shown, as_input_error, first_line, needed, require
from pipeline.system.frozen import dataclass
from pipeline.system.reading import checked
from pipeline.system.remote import local_path, named_before, url_of
from pipeline.system.safe_files import enter, open_parquet, read_json, read_parquet
from pipeline.system.whole_files import temporary_sibling

VERSION_KEY = b"spatialviz.schema_version"
TABLE_KEY = b"spatialviz.table"
ROW_GROUP = 122_880

Columns = dict[str, Any]
"""A table as columns by name, each a sequence or an array of one length."""


CANDIDATES = "candidates"
"""The table of a shard: expressions before some of them are chosen and put into words. `same_class` counts the
objects of the frame that are of the target's class."""
PART_TABLES = ("frames", "objects", "relations", CANDIDATES)
SENTENCES = "sentences"
"""The table of a shard that was asked for further sentences: the kind of each, and its line of SENTENCES_FILE."""
SENTENCES_FILE = "sentences.jsonl"


@lru_cache
def arrow_schema(table: str) -> pa.Schema:
    """The Arrow schema of a table, with the schema's version in its metadata."""
    if table == SENTENCES:
        metadata = {VERSION_KEY: SCHEMA_VERSION.encode(), TABLE_KEY: SENTENCES.encode()}
        return pa.schema([pa.field(name, pa.string(), False) for name in ("kind", "line")], metadata=metadata)
    if table == CANDIDATES:
        worded = arrow_schema("expressions")
        metadata = {**worded.metadata, TABLE_KEY: CANDIDATES.encode()}
        bare = worded.remove(worded.get_field_index("text"))
        return bare.append(pa.field("same_class", pa.int32(), False)).with_metadata(metadata)
    fields = []
    for name, info in TABLES[table].model_fields.items():
        options = typing.get_args(info.annotation)
        nullable = types.NoneType in options
        kind = next(k for k in options if k is not types.NoneType) if nullable else info.annotation
        if typing.get_origin(kind) is typing.Annotated:
            kind = typing.get_args(kind)[0]
        if typing.get_origin(kind) is list:
            (inner,) = typing.get_args(kind)
            stored = pa.list_(pa.type_for_alias("int32" if inner is int else _STORED.get(inner, "string")))
        else:
            hint = info.json_schema_extra if isinstance(info.json_schema_extra, dict) else {}
            stored = pa.type_for_alias(str(hint.get("arrow") or _STORED.get(kind, "string")))
        fields.append(pa.field(name, stored, nullable))
    return pa.schema(fields, metadata={VERSION_KEY: SCHEMA_VERSION.encode(), TABLE_KEY: table.encode()})


_STORED: dict[Any, str] = {str: "string", bool: "bool", int: "int64", float: "float64"}


def build_table(table: str, columns: Columns) -> pa.Table:
    """Build an Arrow table of the schema; absent columns are null throughout."""
    schema = arrow_schema(table)
    unknown = min(set(columns) - set(schema.names), default=None)
    require(unknown is None, f"table {table} has no column {unknown!r}")
    length = len(next(iter(columns.values()))) if columns else 0
    values = (columns.get(name) for name in schema.names)
    arrays = [
        pa.nulls(length, of)
        if v is None
        else v.array(of)
        if isinstance(v, Repeated)
        else pa.array(v, of, from_pandas=isinstance(v, np.ndarray))
        for v, of in zip(values, schema.types, strict=True)
    ]
    return pa.Table.from_arrays(arrays, schema=schema)


def table_of_rows(table: str, rows: Collection[Mapping[str, Any]]) -> pa.Table:
    """Rows with a value for each column, as an Arrow table."""
    return build_table(table, {column: [row[column] for row in rows] for column in arrow_schema(table).names})


def write_table(table: pa.Table, path: Path) -> None:
    """Write Parquet under a temporary name, sync, and rename."""
    temporary = temporary_sibling(path)
    try:
        pq.write_table(table, temporary, compression="zstd", row_group_size=ROW_GROUP)
        with open(temporary, "rb") as written:
            os.fsync(written.fileno())
        os.replace(temporary, path)
    finally:
        temporary.unlink(missing_ok=True)


def read_table(
    source: Path | IO[bytes], table: str, columns: Sequence[str] | None = None, *, path: str | Path | None = None
) -> pa.Table:
    """A table of the labels, from a path or an open file (then `path` names it in messages).

    Raises InputError: the file is missing, damaged, of another table, or of a newer schema.
    """
    path = source if isinstance(source, Path) else path or "an open file"
    with (
        as_input_error(
            "not a readable Parquet file", pa.ArrowInvalid, pa.ArrowTypeError, OSError, got=first_line, path=path
        ),
        as_input_error(f"the table {table} is missing", FileNotFoundError, cause="are these labels merged?", path=path),
        open_parquet(source, path) as file,
    ):
        schema = file.schema_arrow
        check_version(schema.metadata or {}, table, path)
        read = file.read(columns=None if columns is None else [n for n in columns if n in schema.names])
        # Text of a damaged file may be no UTF-8, which would be met only where a row is made.
        read.validate(full=True)
        return read if columns is not None and not columns else sound_rows(read, table, columns, path=path)


def sound_rows(
    rows: pa.Table, table: str, columns: Sequence[str] | None = None, *, path: str | Path | None = None
) -> pa.Table:
    """Check rows of a file: the wanted columns, with the right types.

    The file may be older than the columns in ADDED_COLUMNS: those are null, in their place.

    Raises InputError: a column is missing, of another type, or lacks values that it must have.
    """
    schema = arrow_schema(table)
    wanted = columns or schema.names
    missing = [n for n in wanted if n not in rows.column_names]
    lost = next((n for n in missing if n not in ADDED_COLUMNS), None)
    require(lost is None, f"table {table} lacks the column {lost!r}", path=path)
    for name in missing:
        rows = rows.append_column(schema.field(name), pa.nulls(rows.num_rows, schema.field(name).type))
    rows = typed(rows, schema, f"table {table}", path)
    return rows.select(wanted) if missing else rows


def check_version(metadata: dict[bytes, bytes], table: str, path: str | Path) -> None:
    """Refuse a file of another table or of a schema with another major version."""
    found, of = (metadata.get(key, b"").decode() for key in (VERSION_KEY, TABLE_KEY))
    require(found, "not a table of labels", cause="it carries no schema version", path=path)
    require(
        found.split(".")[0] == SCHEMA_VERSION.split(".")[0],
        "labels of another schema",
        got=found,
        expected=SCHEMA_VERSION,
        cause="made by another release?",
        path=path,
    )
    require(of == table, "another table", got=of, expected=table, path=path)


class RowHash:
    """Hash of a table's rows in order, whatever the chunks they come in.

    Each column is hashed on its own, and of each column apart: which values are
    null, the lengths of lists and strings, and the values. A column that came to
    the schema later counts where it has a value: older rows keep their hash.
    """

    def __init__(self, table: str) -> None:
        self._names = arrow_schema(table).names
        self._digests: dict[tuple[str, int], Any] = {}
        self._held = {name for name in self._names if name not in ADDED_COLUMNS}
        self.rows = 0

    def update(self, table: pa.Table) -> None:
        """Add rows."""
        self.rows += table.num_rows
        for name in self._names:
            if name in ADDED_COLUMNS and name not in table.column_names:
                continue
            if table.column(name).null_count < table.num_rows:
                self._held.add(name)
            for chunk in table.column(name).chunks:
                for k, part in enumerate(_plain_bytes(chunk)):
                    self._digests.setdefault((name, k), hashlib.sha256()).update(part)

    def hexdigest(self) -> str:
        """64 hexadecimal digits."""
        whole = hashlib.sha256(str(self.rows).encode())
        for (name, k), digest in sorted(self._digests.items()):
            if name in self._held:
                whole.update(f"{name}.{k}".encode() + digest.digest())
        return whole.hexdigest()


def _plain_bytes(array: Any) -> Iterable[bytes]:
    yield np.asarray(pc.is_valid(array)).astype(np.uint8).tobytes()  # pyright: ignore[reportAttributeAccessIssue]
    if pa.types.is_dictionary(array.type):
        array = array.dictionary_decode()
    if pa.types.is_list(array.type):
        lengths = pc.fill_null(pc.list_value_length(array), 0)  # pyright: ignore[reportAttributeAccessIssue]
        yield np.asarray(lengths).astype(np.int64).tobytes()
        yield from _plain_bytes(array.drop_null().flatten())
    elif pa.types.is_string(array.type) or pa.types.is_large_string(array.type):
        texts = [t.encode() for t in array.drop_null().to_pylist()]
        yield np.array([len(t) for t in texts], np.int64).tobytes()
        yield b"".join(texts)
    elif pa.types.is_boolean(array.type):
        yield np.asarray(array.drop_null()).astype(np.uint8).tobytes()
    else:
        yield np.ascontiguousarray(array.drop_null().to_numpy(zero_copy_only=False)).tobytes()


def content_hash(table: pa.Table, name: str) -> str:
    """Hash of all rows of a table; see `RowHash`."""
    digest = RowHash(name)
    digest.update(table)
    return digest.hexdigest()


MANIFEST_FILE = "manifest.json"


@dataclass(frozen=True)
class Labels:
    """Merged labels of a dataset; tables are read when first asked for.

    >>> from pipeline.datasets.demo import demo_labels
    >>> labels = open_labels(demo_labels())
    >>> labels
    <Labels labels: 12 frames, 346 objects, 9822 relations, 1800 expressions>
    >>> labels.expressions.column("text")[0].as_py()
    'which potted plant is on the left side of a shelf?'
    """

    root: Path  # The labels folder
    manifest: Manifest  # What made them

    def __repr__(self) -> str:
        counts = ", ".join(f"{self.manifest.tables[name].rows} {name}" for name in TABLES)
        return f"<Labels {self.root.name}: {counts}>"

    def table(self, name: str) -> pa.Table:
        """Table "frames", "objects", "relations" or "expressions", in canonical order."""
        return read_table(self.root / f"{name}.parquet", name)

    @cached_property
    def frames(self) -> pa.Table:
        """One row a frame; the columns of each table stand in `pipeline.labels.schema`."""
        return self.table("frames")

    @cached_property
    def objects(self) -> pa.Table:
        """One row an object."""
        return self.table("objects")

    @cached_property
    def relations(self) -> pa.Table:
        """One row an ordered pair of objects of a frame."""
        return self.table("relations")

    @cached_property
    def expressions(self) -> pa.Table:
        """One row a sentence."""
        return self.table("expressions")

    @property
    def relation_names(self) -> tuple[str, ...]:
        """Labelled relations, in the order of PAIRWISE."""
        return tuple(self.manifest.config["relations"])


def open_labels(path: str | Path) -> Labels:
    """Open a finished labels folder, or labels at a URL: then its tables are fetched as they are read.

    Raises InputError: no labels there, unmerged ones, or ones of another schema.

    >>> from pipeline.datasets.demo import demo_labels
    >>> open_labels(demo_labels()).relation_names
    ('left', 'right', 'above', 'below', 'front', 'behind')
    """
    root = enter(local_path(path, without="parts"))
    file = root / MANIFEST_FILE
    if not file.is_file():
        where = url_of(root) or root
        unmerged = (root / "parts").is_dir() or (root / "plan.json").is_file()
        raise InputError(
            "these labels are not merged yet" if unmerged else "no labels here",
            expected=f"a folder with {MANIFEST_FILE}",
            cause=f"run: spatialviz label --merge {where}" if unmerged else "did `spatialviz label` finish?",
            path=where,
        )
    with as_input_error("the manifest is damaged", ValueError, AttributeError, got=str, path=file):
        content = read_json(file)
        version = str(content.get("schema_version", ""))
        require(
            version.split(".")[0] == SCHEMA_VERSION.split(".")[0],
            "labels of another schema",
            got=version,
            expected=SCHEMA_VERSION,
            path=file,
        )
        manifest = checked(Manifest.model_validate, content, "the manifest is damaged at {}", file)
    relations = manifest.config.get("relations")
    require(
        isinstance(relations, list),
        "the manifest is damaged at config.relations",
        got="nothing" if relations is None else Shown(relations),
        expected="a list of relations",
        path=file,
    )
    for relation in manifest.config["relations"]:
        require(
            relation in PAIRWISE,
            "these labels hold a relation that is not declared here",
            got=repr(relation),
            expected=", ".join(PAIRWISE),
            cause="made with a relation of somebody's own?",
            path=file,
        )
    for path in (root / f"{name}.parquet" for name in TABLES):
        require(path.is_file(), f"the table {path.stem} is missing", path=path)
    return Labels(root, manifest)


PROVENANCE_FILE = "provenance.parquet"
MARKS_FILE = "marks.json"
STATUSES_FILE = "statuses.json"
"""What reviewers said of frames, objects, relations and expressions, and notes: kind, frame, key, field, value."""


def provenance_rows(root: Path) -> list[dict[str, Any]]:
    """Origins of the values of a labels folder that are not the labeller's; none of labels without corrections.

    Raises InputError: the file is damaged.
    """
    path = root / PROVENANCE_FILE
    if not path.exists():
        return []
    columns = ["table", "frame", "key", "column", "origin", "author", "time", "event", "reason", "was"]
    with as_input_error(
        "the provenance of the labels is damaged", pa.ArrowException, OSError, ValueError, got=first_line, path=path
    ):
        return read_parquet(path, columns).to_pylist()


def labelled_dataset(manifest: Manifest, path: str | None = None, **options: Any) -> Dataset:
    """Open the dataset of labels, at the place then or now, with the declared camera.

    `path`: where it is now. `options`: arguments of `open_dataset` that say what the camera is, instead of what was
    declared then: intrinsics, depth_scale, up, level_at, depth_model, poses, registration.

    Raises InputError: the labels do not name it, or it cannot be opened.
    """
    record = manifest.dataset
    where = path or named_before(needed(record.get("path") or None, "the labels do not say which dataset they are of"))
    declared = record.get("options") or {}
    known = {name: declared[name] for name in ("depth_model", "poses") if declared.get(name)}
    for name, count in (("intrinsics", 4), ("registration", 7), ("depth_scale", 1)):
        if declared.get(name) and options.get(name) is None:
            known[name] = _numbers(declared[name], count, name)
    given = {name: value for name, value in options.items() if value is not None}
    return open_dataset(found_by_name(where), **labelled_up(manifest, {**known, **given}))


def labelled_up(manifest: Manifest, options: Mapping[str, Any]) -> dict[str, Any]:
    """Arguments of `open_dataset`, with the up vector of when the labels were made where none is given."""
    declared = manifest.dataset.get("options") or {}
    known = {n: str(declared[n]) for n in ("up", "level_at") if declared.get(n) is not None}
    return dict(options) if any(options.get(n) is not None for n in ("up", "level_at")) else {**options, **known}


def _numbers(value: Any, count: int, name: str) -> float | tuple[float, ...]:
    """So many numbers, of a list or of its text; of one the number itself."""
    with as_input_error(f"the labels name no {name} of numbers", ValueError, got=Shown(value), expected=count):
        numbers = tuple(float(n) for n in str(value).strip("()[] ").split(","))
        if len(numbers) != count:
            raise ValueError(f"{len(numbers)} numbers")
    return numbers[0] if count == 1 else numbers
