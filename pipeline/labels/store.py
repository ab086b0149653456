"""Where labels are kept: a local folder, or any place that fsspec reaches. Parts appear whole or not at all."""

from __future__ import annotations

import hashlib
import json
import os
import shutil
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pipeline.errors import InputError, MissingExtra

if TYPE_CHECKING:
    import pyarrow as pa

PARTS = "parts"
DONE_FILE = "part.json"
"""Written last: a part without it does not count."""


class Store:
    """A labels folder.

    A part is written under a hidden name of its own, synced, and renamed into
    place; where the place cannot rename folders (object stores), its files come
    first and `part.json` last. Either way a part that is there is whole.

    Parameters
    ----------
    where : str
        A path, or a URL such as "s3://bucket/labels" (extra: cluster).
    """

    def __init__(self, where: str | Path) -> None:
        self.where = str(where)
        self.remote = "://" in self.where
        if self.remote:
            try:
                import fsspec
            except ImportError as error:
                raise MissingExtra(f"writing to {self.where}", "cluster") from error
            self._fs, self._root = fsspec.core.url_to_fs(self.where)
        else:
            self.folder = Path(self.where).expanduser()

    def prepare(self) -> None:
        """Make the folder.

        Raises
        ------
        InputError
            It cannot be made or written.
        """
        if self.remote:
            self._fs.makedirs(f"{self._root}/{PARTS}", exist_ok=True)
            return
        try:
            (self.folder / PARTS).mkdir(parents=True, exist_ok=True)
        except (FileExistsError, NotADirectoryError) as error:
            raise InputError("labels go into a folder", got="a file", path=self.folder) from error
        except OSError as error:
            raise InputError("the folder cannot be made", got=error.strerror, path=self.folder) from error
        if not os.access(self.folder, os.W_OK):
            raise InputError("the folder cannot be written", path=self.folder)

    def is_empty(self) -> bool:
        """Whether nothing is there yet."""
        if self.remote:
            return not self._fs.exists(self._root) or not self._fs.ls(self._root)
        return not self.folder.exists() or (self.folder.is_dir() and not any(self.folder.iterdir()))

    def clear_unfinished(self) -> None:
        """Remove what killed runs left behind; must not run beside another writer."""
        if not self.remote and (self.folder / PARTS).is_dir():
            for left in (self.folder / PARTS).glob(".*.tmp"):
                shutil.rmtree(left, ignore_errors=True)

    def read_text(self, name: str) -> str | None:
        """A small file, or None where it is missing."""
        try:
            if self.remote:
                with self._fs.open(f"{self._root}/{name}", "rb") as file:
                    return file.read().decode()
            return (self.folder / name).read_text(encoding="utf-8")
        except FileNotFoundError:
            return None

    def write_text(self, name: str, text: str) -> None:
        """Write a small file whole."""
        if self.remote:
            with self._fs.open(f"{self._root}/{name}", "wb") as file:
                file.write(text.encode())
            return
        write_whole(self.folder / name, text.encode())

    def has_part(self, name: str) -> bool:
        """Whether a finished part is there."""
        place = f"{PARTS}/{name}/{DONE_FILE}"
        return self._fs.exists(f"{self._root}/{place}") if self.remote else (self.folder / place).is_file()

    def write_part(self, name: str, tables: Mapping[str, pa.Table], record: dict[str, Any]) -> None:
        """Write the tables of a part, and its record with the row counts and hashes of its files."""
        if self.has_part(name):
            return
        if self.remote:
            self._write_remote(name, tables, record)
            return
        final = self.folder / PARTS / name
        temporary = self.folder / PARTS / f".{name}.{os.getpid()}.tmp"
        shutil.rmtree(temporary, ignore_errors=True)
        temporary.mkdir(parents=True)
        try:
            files = {}
            for table, rows in tables.items():
                data = parquet_bytes(rows)
                _write_synced(temporary / f"{table}.parquet", data)
                files[table] = {"rows": rows.num_rows, "sha256": hashlib.sha256(data).hexdigest()}
            _write_synced(temporary / DONE_FILE, json.dumps({**record, "files": files}).encode())
            try:
                os.rename(temporary, final)
            except OSError:
                if not self.has_part(name):
                    # A folder of that name without its record can only be debris.
                    shutil.rmtree(final, ignore_errors=True)
                    os.rename(temporary, final)
        finally:
            shutil.rmtree(temporary, ignore_errors=True)

    def _write_remote(self, name: str, tables: Mapping[str, pa.Table], record: dict[str, Any]) -> None:
        files = {}
        folder = f"{self._root}/{PARTS}/{name}"
        self._fs.makedirs(folder, exist_ok=True)
        for table, rows in tables.items():
            data = parquet_bytes(rows)
            with self._fs.open(f"{folder}/{table}.parquet", "wb") as file:
                file.write(data)
            files[table] = {"rows": rows.num_rows, "sha256": hashlib.sha256(data).hexdigest()}
        with self._fs.open(f"{folder}/{DONE_FILE}", "wb") as file:
            file.write(json.dumps({**record, "files": files}).encode())

    def read_part(self, name: str, table: str, columns: list[str] | None = None) -> pa.Table:
        """A table of a finished part.

        Raises
        ------
        InputError
            The file is missing or damaged.
        """
        from pipeline.labels.tables import read_table

        place = f"{PARTS}/{name}/{table}.parquet"
        if not self.remote:
            return read_table(self.folder / place, table, columns)
        import pyarrow.parquet as pq

        with self._fs.open(f"{self._root}/{place}", "rb") as file:
            return pq.read_table(file, columns=columns)

    def part_record(self, name: str) -> dict[str, Any]:
        """The record of a finished part."""
        return json.loads(self.read_text(f"{PARTS}/{name}/{DONE_FILE}") or "{}")


def parquet_bytes(table: pa.Table) -> bytes:
    """A table as the bytes of a Parquet file."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    sink = pa.BufferOutputStream()
    pq.write_table(table, sink, compression="zstd")
    return sink.getvalue().to_pybytes()


def write_whole(path: Path, data: bytes) -> None:
    """Write a file under a temporary name, sync it, and rename it into place."""
    temporary = path.with_name(f".{path.name}.{os.getpid()}.tmp")
    try:
        _write_synced(temporary, data)
        os.replace(temporary, path)
    finally:
        temporary.unlink(missing_ok=True)


def _write_synced(path: Path, data: bytes) -> None:
    with open(path, "wb") as file:
        file.write(data)
        file.flush()
        os.fsync(file.fileno())
