"""Where labels are kept: a local folder, or any place that fsspec reaches. Parts appear whole or not at all."""

from __future__ import annotations

import hashlib
import json
import os
import shutil
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path, PurePosixPath
from types import MappingProxyType
from typing import Any

from pipeline.labels.reading import read_table
from pipeline.system.arrow import pa, pq
from pipeline.system.errors import InputError, as_input_error, require
from pipeline.system.remote import is_elsewhere, local_path
from pipeline.system.remote_folder import RemoteFolder
from pipeline.system.safe_files import opened, parse_json, read_text
from pipeline.system.whole_files import (
    clear_abandoned,
    scratch_folder,
    sha256_of,
    temporary_folder,
    temporary_sibling,
    write_synced,
)

PARTS = "parts"
PLAN_FILE = "plan.json"
DONE_FILE = "part.json"
"""Written last: a part without it does not count."""


class LabelStore:
    """A labels folder.

    A part is written under a hidden name of its own, synced, and renamed into
    place. At a URL its tables are put first, each under a name of its content, and
    `part.json` last. Either way a part that is there is whole, whoever else writes it.

    `where`: a path, or a URL such as "s3://bucket/labels" (extra: remote). `folder`: what is at the URL, fetched there.
    """

    def __init__(self, where: str | Path, folder: Path | None = None) -> None:
        self.where = str(where)
        self.there = RemoteFolder(self.where) if folder is None and is_elsewhere(where) else None
        self.folder = folder or (Path() if self.there is not None else local_path(where))

    @contextmanager
    def nearby(self, parts: Sequence[str]) -> Iterator[LabelStore]:
        """Give this store; of one at a URL a copy of these finished parts among the system's temporary files."""
        if self.there is None:
            yield self
            return
        with scratch_folder() as folder:
            copy = LabelStore(self.where, folder)
            at = {name: folder / PARTS / name for name in parts}
            self.there.fetch({f"{PARTS}/{name}/{DONE_FILE}": path / DONE_FILE for name, path in at.items()})
            tables = ((name, table, e) for name in parts for table, e in copy.part_record(name)["files"].items())
            self.there.fetch({_address_of(*found): at[found[0]] / f"{found[1]}.parquet" for found in tables})
            yield copy

    def prepare(self) -> None:
        """Make the folder.

        Raises InputError: it cannot be made or written.
        """
        if self.there is not None:
            return
        with (
            as_input_error("the folder cannot be made", OSError, got=lambda e: e.strerror, path=self.folder),
            as_input_error(
                "labels go into a folder", FileExistsError, NotADirectoryError, got="a file", path=self.folder
            ),
        ):
            (self.folder / PARTS).mkdir(parents=True, exist_ok=True)
        require(os.access(self.folder, os.W_OK), "the folder cannot be written", path=self.folder)

    def is_empty(self) -> bool:
        """Tell an empty or missing place."""
        return not self._names()

    def holds_something_else(self) -> bool:
        """Tell folders of other files, without a plan."""
        names = self._names()
        return PLAN_FILE not in names and any(n != PARTS and not n.startswith(".") for n in names)

    def _names(self) -> set[str]:
        if self.there is not None:
            return self.there.names()
        return {entry.name for entry in self.folder.iterdir()} if self.folder.is_dir() else set()

    def clear_unfinished(self) -> None:
        """Remove leftovers of killed runs, but no running process's files."""
        if self.there is not None:
            return
        clear_abandoned(self.folder / PARTS)
        clear_abandoned(self.folder)

    def read_text(self, name: str) -> str | None:
        """Read a small file; None if missing."""
        try:
            return read_text(self.folder / name) if self.there is None else self.there.read(name).decode()
        except (FileNotFoundError, NotADirectoryError):
            return None
        except UnicodeDecodeError as error:
            raise InputError("not a text file", path=self._address(name)) from error

    def _address(self, name: str) -> str:
        return f"{self.where.rstrip('/')}/{name}"

    def write_text(self, name: str, text: str) -> None:
        """Write a small file whole; an existing file stays, by whatever writer."""
        if self.there is not None:
            self.there.put(name, text.encode())
            return
        temporary = temporary_sibling(self.folder / name)
        try:
            write_synced(temporary, text.encode())
            try:
                os.link(temporary, self.folder / name)
            except FileExistsError:
                return
            except OSError:
                # A place without hard links: the last writer wins.
                os.replace(temporary, self.folder / name)
        finally:
            temporary.unlink(missing_ok=True)

    def has_part(self, name: str) -> bool:
        """Tell finished parts."""
        path = f"{PARTS}/{name}/{DONE_FILE}"
        return (self.folder / path).is_file() if self.there is None else self.there.exists(path)

    def unfinished(self, parts: Sequence[str]) -> set[str]:
        """Those of many parts that are not finished; at a URL by one listing."""
        if self.there is None:
            return {name for name in parts if not self.has_part(name)}
        there = self.there.names_below(PARTS)
        return {name for name in parts if f"{name}/{DONE_FILE}" not in there}

    def write_part(self, name: str, tables: Mapping[str, pa.Table], record: dict[str, Any]) -> None:
        """Write the tables of a part, with a record of row counts and hashes."""
        if self.has_part(name):
            return
        contents = {table: parquet_bytes(rows) for table, rows in tables.items()}
        files: dict[str, dict[str, Any]] = {
            table: {"rows": rows.num_rows, "sha256": hashlib.sha256(contents[table]).hexdigest()}
            for table, rows in tables.items()
        }
        if self.there is not None:
            for table, entry in files.items():
                # Of another task at the same part, with another Parquet writer, no file is overwritten.
                entry["file"] = f"{table}-{entry['sha256'][:16]}.parquet"
                self.there.put(_address_of(name, table, entry), contents[table])
            self.there.put(f"{PARTS}/{name}/{DONE_FILE}", json.dumps({**record, "files": files}).encode())
            return
        final = self.folder / PARTS / name
        with temporary_folder(final) as temporary:
            for table, data in contents.items():
                write_synced(temporary / f"{table}.parquet", data)
            write_synced(temporary / DONE_FILE, json.dumps({**record, "files": files}).encode())
            try:
                os.rename(temporary, final)
            except OSError:
                if not self.has_part(name):
                    # A folder of that name without its record can only be debris.
                    shutil.rmtree(final, ignore_errors=True)
                    os.rename(temporary, final)

    def read_part(self, name: str, table: str, columns: list[str] | None = None) -> pa.Table:
        """A table of a finished part.

        Raises InputError: the file is missing or damaged.
        """
        if self.there is None:
            return read_table(self.folder / _address_of(name, table), table, columns)
        with self._open_table(name, table, self.part_record(name)["files"].get(table, {})) as file:
            return read_table(file, table, columns, path=self._address(_address_of(name, table)))

    def part_record(self, name: str) -> dict[str, Any]:
        """The record of a finished part.

        Raises InputError: it is damaged.
        """
        try:
            record = parse_json(self.read_text(f"{PARTS}/{name}/{DONE_FILE}") or "")
            files = {table: dict(entry) for table, entry in record["files"].items() if table.isidentifier()}
            return {**record, "files": files}
        except (ValueError, KeyError, TypeError, AttributeError) as error:
            raise self._damaged(name, f"an unreadable {DONE_FILE}") from error

    def check_part(self, name: str, key: str) -> None:
        """Check key and file hashes of a part.

        Raises InputError: of another key, a file is missing, or its content has changed.
        """
        record = self.part_record(name)
        if record.get("key") != key:
            raise self._damaged(name, "the rows of another shard")
        for table, entry in record["files"].items():
            try:
                with self._open_table(name, table, entry) as file:
                    sha256 = sha256_of(file)
            except FileNotFoundError as error:
                raise self._damaged(name, f"no {table}.parquet") from error
            if sha256 != entry.get("sha256"):
                raise self._damaged(name, f"another content of {table}.parquet")

    def _open_table(self, part: str, table: str, entry: Mapping[str, Any]) -> Any:
        if self.there is None:
            return opened(self.folder / _address_of(part, table), "unpacked")
        return self.there.open(_address_of(part, table, entry))

    def _damaged(self, name: str, got: str) -> InputError:
        return InputError(
            "a finished shard is damaged",
            got=got,
            cause="remove its folder, and run label again with --resume",
            path=self._address(f"{PARTS}/{name}"),
        )


def _address_of(part: str, table: str, entry: Mapping[str, Any] = MappingProxyType({})) -> str:
    return f"{PARTS}/{part}/{PurePosixPath(str(entry.get('file', f'{table}.parquet'))).name}"


def parquet_bytes(table: pa.Table) -> bytes:
    """A table as the bytes of a Parquet file."""
    sink = pa.BufferOutputStream()
    pq.write_table(table, sink, compression="zstd")
    return sink.getvalue().to_pybytes()
