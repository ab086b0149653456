"""Folders at a URL to write into (s3://, gs://, ...; extra: remote): each file is put whole, as object stores do.

Whose account and which server is for fsspec's own settings to say: environment, profiles, `~/.config/fsspec`.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import IO, Any

from pipeline.system.errors import as_input_error, kind_and_text
from pipeline.system.remote import connected

_WITHOUT_FOLDERS = frozenset(("s3", "s3a", "gs", "gcs", "abfs", "abfss", "az", "oss", "oci"))
"""File systems where a name makes its folders, and making one could make a bucket, which nobody asked for."""
_SETTINGS = "account and server are those of fsspec's own settings: environment variables, profiles, ~/.config/fsspec"


class RemoteFolder:
    """Folder at a URL.

    Raises
    ------
    InputError
        From every method, in one line: no such bucket, no credentials, no connection.
    MissingExtra
        fsspec is not installed.
    """

    def __init__(self, url: str) -> None:
        self.url = url.rstrip("/")
        self._system, self._root = connected(self.url)
        protocol = self._system.protocol
        self._has_folders = _WITHOUT_FOLDERS.isdisjoint((protocol,) if isinstance(protocol, str) else protocol)

    def names(self) -> set[str]:
        """Names of the files and folders in it; none of a missing folder."""
        with self._said(), suppress(FileNotFoundError):
            found = self._fresh().ls(self._root, detail=False)
            return {str(path).rstrip("/").rpartition("/")[2] for path in found} - {""}
        return set()

    def names_below(self, folder: str) -> set[str]:
        """Names of all files below a folder of it, at any depth, relative to it."""
        with self._said(folder), suppress(FileNotFoundError):
            found = self._fresh().find(self._at(folder))
            return {str(path).partition(self._at(folder))[2].strip("/") for path in found}
        return set()

    def exists(self, name: str) -> bool:
        """Tell a file that is there now."""
        with self._said(name):
            return bool(self._fresh().exists(self._at(name)))

    def read(self, name: str) -> bytes:
        """Read a file whole; raises FileNotFoundError."""
        with self._said(name, missing=True):
            return self._system.cat_file(self._at(name))

    def open(self, name: str) -> IO[bytes]:
        """Open a file to read; raises FileNotFoundError."""
        with self._said(name, missing=True):
            return self._system.open(self._at(name), "rb")

    def put(self, name: str, data: bytes) -> None:
        """Write a file whole."""
        with self._said(name):
            self._make_folder(name)
            self._system.pipe_file(self._at(name), data)

    def put_file(self, name: str, path: Path) -> None:
        """Write a file of this machine whole."""
        with self._said(name):
            self._make_folder(name)
            self._system.put_file(str(path), self._at(name))

    def fetch(self, wanted: Mapping[str, Path]) -> None:
        """Fetch files by name, each to a path, many at once."""
        with self._said():
            self._system.get([self._at(name) for name in wanted], [str(path) for path in wanted.values()])

    def remove(self, name: str) -> None:
        """Remove a file, if it is there."""
        with self._said(name), suppress(FileNotFoundError):
            self._system.rm_file(self._at(name))

    def _fresh(self) -> Any:
        # Others write here too: what was listed before does not count.
        self._system.invalidate_cache()
        return self._system

    def _at(self, name: str) -> str:
        return f"{self._root}/{name}"

    def _make_folder(self, name: str) -> None:
        if self._has_folders:
            self._system.makedirs(self._at(name).rpartition("/")[0], exist_ok=True)

    @contextmanager
    def _said(self, name: str = "", missing: bool = False) -> Iterator[None]:
        where = f"{self.url}/{name}".rstrip("/")
        lost: FileNotFoundError | None = None
        with as_input_error("the URL cannot be reached", Exception, got=kind_and_text, cause=_SETTINGS, path=where):
            try:
                yield
            except FileNotFoundError as error:
                if not missing:
                    raise
                lost = error
        if lost is not None:
            raise lost
