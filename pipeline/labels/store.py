"""Where labels are kept: a local folder, or any place that fsspec reaches. Parts appear whole or not at all."""

from __future__ import annotations

import hashlib
import json
import os
import shutil
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from pipeline.labels.reading import read_table
from pipeline.system.arrow import pa, pq
from pipeline.system.errors import InputError, as_input_error, extra_module, first_line, require
from pipeline.system.safe_files import opened, parse_json, read_text
from pipeline.system.whole_files import clear_abandoned, sha256_of, temporary_folder, temporary_sibling, write_synced

PARTS = "parts"
PLAN_FILE = "plan.json"
DONE_FILE = "part.json"
"""Written last: a part without it does not count."""


class LabelStore:
    """A labels folder.

    A part is written under a hidden name of its own, synced, and renamed into
    place; where the place cannot rename folders (object stores), its files come
    first and `part.json` last. Either way a part that is there is whole.

    `where`: a path, or a URL such as "s3://bucket/labels" (extra: cluster).
    """

    def __init__(self, where: str | Path) -> None:
        self.where = str(where)
        self.remote = "://" in self.where
        if self.remote:
            fsspec = extra_module("fsspec", f"writing to {self.where}", "cluster")
            with as_input_error(
                "this kind of URL cannot be written to", ImportError, ValueError, got=first_line, path=self.where
            ):
                self._fs, self._root = fsspec.core.url_to_fs(self.where)
        else:
            self.folder = Path(self.where).expanduser()

    def prepare(self) -> None:
        """Make the folder.

        Raises InputError: it cannot be made or written.
        """
        if self.remote:
            self._fs.makedirs(f"{self._root}/{PARTS}", exist_ok=True)
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
        if self.remote:
            return not self._fs.exists(self._root) or not self._fs.ls(self._root)
        return not self.folder.exists() or (self.folder.is_dir() and not any(self.folder.iterdir()))

    def holds_something_else(self) -> bool:
        """Tell folders of other files, without a plan."""
        if self.remote or not self.folder.is_dir():
            return False
        names = {entry.name for entry in self.folder.iterdir()}
        return PLAN_FILE not in names and any(n != PARTS and not n.startswith(".") for n in names)

    def clear_unfinished(self) -> None:
        """Remove leftovers of killed runs, but no running process's files."""
        if self.remote:
            return
        clear_abandoned(self.folder / PARTS)
        clear_abandoned(self.folder)

    def read_text(self, name: str) -> str | None:
        """Read a small file; None if missing."""
        try:
            return self._fs.cat_file(f"{self._root}/{name}").decode() if self.remote else read_text(self.folder / name)
        except FileNotFoundError:
            return None
        except UnicodeDecodeError as error:
            raise InputError("not a text file", path=self._address(name)) from error

    def _address(self, name: str) -> str:
        return f"{self.where.rstrip('/')}/{name}"

    def write_text(self, name: str, text: str) -> None:
        """Write a small file whole; an existing file stays, by whatever writer."""
        if self.remote:
            self._fs.pipe_file(f"{self._root}/{name}", text.encode())
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
        return self._fs.exists(f"{self._root}/{path}") if self.remote else (self.folder / path).is_file()

    def write_part(self, name: str, tables: Mapping[str, pa.Table], record: dict[str, Any]) -> None:
        """Write the tables of a part, with a record of row counts and hashes."""
        if self.has_part(name):
            return
        contents = {f"{table}.parquet": parquet_bytes(rows) for table, rows in tables.items()}
        files = {
            table: {"rows": rows.num_rows, "sha256": hashlib.sha256(contents[f"{table}.parquet"]).hexdigest()}
            for table, rows in tables.items()
        }
        contents[DONE_FILE] = json.dumps({**record, "files": files}).encode()
        if self.remote:
            self._fs.makedirs(f"{self._root}/{PARTS}/{name}", exist_ok=True)
            for file, data in contents.items():
                self._fs.pipe_file(f"{self._root}/{PARTS}/{name}/{file}", data)
            return
        final = self.folder / PARTS / name
        with temporary_folder(final) as temporary:
            for file, data in contents.items():
                write_synced(temporary / file, data)
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
        path = f"{PARTS}/{name}/{table}.parquet"
        if not self.remote:
            return read_table(self.folder / path, table, columns)
        with self._open_part(path) as file:
            return read_table(file, table, columns, path=self._address(path))

    def part_record(self, name: str) -> dict[str, Any]:
        """The record of a finished part.

        Raises InputError: it is damaged.
        """
        try:
            record = parse_json(self.read_text(f"{PARTS}/{name}/{DONE_FILE}") or "")
            return {**record, "files": {table: dict(entry) for table, entry in record["files"].items()}}
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
                with self._open_part(f"{PARTS}/{name}/{table}.parquet") as file:
                    sha256 = sha256_of(file)
            except FileNotFoundError as error:
                raise self._damaged(name, f"no {table}.parquet") from error
            if sha256 != entry.get("sha256"):
                raise self._damaged(name, f"another content of {table}.parquet")

    def _open_part(self, path: str) -> Any:
        return self._fs.open(f"{self._root}/{path}", "rb") if self.remote else opened(self.folder / path, "unpacked")

    def _damaged(self, name: str, got: str) -> InputError:
        return InputError(
            "a finished shard is damaged",
            got=got,
            cause="remove its folder, and run label again with --resume",
            path=self._address(f"{PARTS}/{name}"),
        )


def parquet_bytes(table: pa.Table) -> bytes:
    """A table as the bytes of a Parquet file."""
    sink = pa.BufferOutputStream()
    pq.write_table(table, sink, compression="zstd")
    return sink.getvalue().to_pybytes()
