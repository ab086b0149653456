"""Safe opening of files of others: datasets, labels, runs, cases and models.

A special file is refused before it is opened, a file outside the opened folder (by a link or "..") before it is read,
and a file above `limits` before it is decoded; each with one line. Errors of the system (a missing file) go through.
"""

from __future__ import annotations

import errno
import io
import json
import math
import os
import re
import stat
import sys
import zipfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from contextvars import ContextVar
from pathlib import Path, PurePosixPath
from typing import IO, Any, NamedTuple
from zipfile import ZipFile

import numpy as np

from pipeline.system.arrow import pq
from pipeline.system.errors import InputError, require
from pipeline.system.limits import LIMITS_OPTION, Limits, current_limits, within
from pipeline.system.picture_headers import array_header, header_size
from pipeline.system.remote import fetch


class _Root(NamedTuple):
    """Opened folder: its real path, and the limits changed by its own settings."""

    real: str
    limits: tuple[tuple[str, Any], ...]


_ROOTS: dict[str, _Root] = {}
_FLAGS = getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_NOCTTY", 0) | getattr(os, "O_BINARY", 0)
_OPENED = Path("/proc/self/fd")
_HAS_OPENED = _OPENED.is_dir()
_POINTER, _POINTER_BYTES = b"version https://git-lfs.github.com/spec/", 200
_LONGEST_LINE = 1 << 16
_LONGEST_MEMBER = 46 + 3 * 0xFFFF
"""Bytes of one member in the list of an archive: its name, extra field and comment have sixteen bits of length each."""
_KINDS = {stat.S_IFIFO: "a FIFO", stat.S_IFSOCK: "a socket", stat.S_IFCHR: "a device", stat.S_IFBLK: "a device"}


def enter(root: Path, limits: Mapping[str, Any] | None = None) -> Path:
    """Confine reading below this folder, or a file with all data inside, with links followed; returns the folder.

    `limits` are those raised by the folder's own `spatialviz.toml`; raises InputError as `Limits.changed`.
    """
    values = tuple((limits or {}).items())
    current_limits().changed(dict(values), own=True)
    _ROOTS[_absolute(root)] = _Root(os.path.realpath(_home(root)), values)
    return root


def _home(root: Path) -> Path:
    """Folder of a root's files: a hub's cache keeps the content of `snapshots/COMMIT` in `blobs` above."""
    real = Path(os.path.realpath(root))
    for folder in (real, *real.parents):
        if folder.parent.name == "snapshots" and (folder.parent.parent / "blobs").is_dir():
            return folder.parent.parent
    return real


def _absolute(path: Any) -> str:
    """Absolute path with ".." kept as written."""
    text = os.fspath(path)
    return text if os.path.isabs(text) else os.path.join(os.getcwd(), "" if text == "." else text).rstrip(os.sep)


def _roots(path: Any) -> Iterator[_Root]:
    """Opened folders above a path as written, the innermost first."""
    text = _absolute(path)
    while True:
        if text in _ROOTS:
            yield _ROOTS[text]
        above = os.path.dirname(text)
        if above == text:
            return
        text = above


def limits_of(path: Any) -> Limits:
    """Limits of a file: of this process, raised by the folder's own."""
    limits = current_limits()
    root = next(_roots(path), None)
    return limits if root is None or not root.limits else limits.changed(dict(root.limits), own=True)


_WATCHED: ContextVar[set[str] | None] = ContextVar("watched", default=None)


@contextmanager
def watched() -> Iterator[set[str]]:
    """Collect the paths of the files that are opened inside the block."""
    seen: set[str] = set()
    around = _WATCHED.get()
    token = _WATCHED.set(seen)
    try:
        yield seen
    finally:
        _WATCHED.reset(token)
        if around is not None:
            around |= seen


def without_use(path: Any) -> None:
    """Take a file that was opened, and holds nothing that is used, from those that are `watched`."""
    if (seen := _WATCHED.get()) is not None:
        seen.discard(os.fspath(path))


@contextmanager
def opened(path: Path, limit: str = "bytes") -> Iterator[IO[bytes]]:
    """Open a file to read, at the start; `limit` names the limit of size.

    Raises
    ------
    InputError
        No regular file, a link out of the folder that was opened, too large, or a pointer of Git LFS.
    OSError
        What the system says: missing, not to be read.
    """
    descriptor, size = _descriptor(path, limit)
    with open(descriptor, "rb") as file:
        if size < _POINTER_BYTES:
            _no_pointer(file.read(len(_POINTER)), path)
            file.seek(0)
        yield file


def _descriptor(path: Path, limit: str) -> tuple[int, int]:
    """Descriptor and bytes of a file that is opened to read; raises as `opened`."""
    state = os.stat(path)
    _check(path, state, limit)
    if (seen := _WATCHED.get()) is not None:
        seen.add(os.fspath(path))
    # Where nobody may write a file, it may be one of a URL that is not here yet.
    if not state.st_mode & stat.S_IWUSR:
        fetch(path, state, limit, limits_of(path))
    # What was a file a moment ago may be a FIFO now: opening must not wait.
    descriptor = os.open(path, os.O_RDONLY | _FLAGS)
    try:
        state = os.fstat(descriptor)
        _check(path, state, limit)
        _check_place(path, descriptor)
    except BaseException:
        os.close(descriptor)
        raise
    return descriptor, state.st_size


def _no_pointer(begin: bytes, path: Path) -> None:
    require(
        not begin.startswith(_POINTER),
        "a pointer of Git LFS stands in place of the file",
        expected="the file: git lfs pull",
        path=path,
    )


def checked_path(path: Path, limit: str = "bytes") -> Path:
    """Check a path for a library with an opener of its own; raises as `opened`."""
    with opened(path, limit):
        return path


class _BoundedReader(io.BufferedReader):
    """Reader of at most the limit `bytes` at a time, whatever length the file declares."""

    def __init__(self, path: Path) -> None:
        super().__init__(io.FileIO(path))
        self._path, self._most = path, limits_of(path)

    def read(self, size: int | None = -1, /) -> bytes:
        if size is None or size < 0 or size > self._most.bytes:
            left = os.fstat(self.fileno()).st_size - self.tell()
            wanted = left if size is None or size < 0 else size
            within(min(wanted, left), "bytes", "a part of a file", self._path, self._most)
        return super().read(size)

    def readline(self, size: int | None = -1, /) -> bytes:
        return super().readline(_LONGEST_LINE if size is None or size < 0 else size)


class BoundedPath(type(Path())):
    """Checked path for a library with its own `open` and trust in the file's lengths."""

    def open(self, mode: str = "r", *rest: Any, **options: Any) -> Any:
        if mode != "rb":
            return super().open(mode, *rest, **options)
        return _BoundedReader(checked_path(self, "unpacked"))


def open_archive(file: IO[bytes], path: Any) -> ZipFile:
    """Open an archive of an open file; InputError for too long a list of members, before reading the list."""
    # What zipfile itself goes by: the number of members, and how many bytes their list has.
    end = zipfile._EndRecData(file)  # pyright: ignore[reportAttributeAccessIssue]
    if end is not None:
        members, listed = end[zipfile._ECD_ENTRIES_TOTAL], end[zipfile._ECD_SIZE]  # pyright: ignore[reportAttributeAccessIssue]
        within(members, "members", "an archive", path, limits_of(path))
        within(listed, "text", "the list of an archive's members", path, limits_of(path))
        require(
            listed <= members * _LONGEST_MEMBER,
            "a damaged archive",
            got=f"a list of {members} members in {listed} bytes",
            path=path,
        )
    return ZipFile(file)


def _check(path: Path, state: os.stat_result, limit: str) -> None:
    if stat.S_ISDIR(state.st_mode):
        raise IsADirectoryError(errno.EISDIR, "Is a directory", os.fspath(path))
    if not stat.S_ISREG(state.st_mode):
        kind = _KINDS.get(stat.S_IFMT(state.st_mode), "something else")
        raise InputError("no regular file", got=kind, cause="such are never read", path=path)
    if state.st_size > getattr(current_limits(), limit):
        within(state.st_size, limit, "a file", path, limits_of(path))


def _check_place(path: Path, descriptor: int) -> None:
    """Raise InputError for a file outside of every opened folder above it as written."""
    above = tuple(_roots(path))
    if not above:
        return
    real = os.readlink(f"{_OPENED}/{descriptor}") if _HAS_OPENED else os.path.realpath(path)
    if not any(real == root.real or real.startswith(root.real.rstrip(os.sep) + os.sep) for root in above):
        require(
            current_limits().links,
            "a file outside the folder that was opened",
            got="a link that leads out, or a name with ..",
            expected=f"files in {above[-1].real}",
            cause=f"{LIMITS_OPTION} links=1 follows such links, if you trust whoever made them",
            path=path,
        )


def read_bytes(path: Path, limit: str = "bytes") -> bytes:
    """Read a whole file; raises as `opened`."""
    # Thousands of masks are read a minute: a file object costs as much as reading one.
    descriptor, size = _descriptor(path, limit)
    try:
        data = b"".join(iter(lambda: os.read(descriptor, max(size + 1, 1 << 12)), b""))
    finally:
        os.close(descriptor)
    if len(data) < _POINTER_BYTES:
        _no_pointer(data, path)
    return data


def read_text(path: Path, encoding: str = "utf-8") -> str:
    """Read a whole text, with "\\n" for ends of lines; raises as `opened`, and UnicodeDecodeError."""
    return read_bytes(path, "text").decode(encoding).replace("\r\n", "\n").replace("\r", "\n")


def read_json(path: Path, **options: Any) -> Any:
    """Read a JSON file; raises as `opened` and `parse_json`."""
    return parse_json(read_bytes(path, "text"), path, **options)


def parse_json(data: bytes | str, path: Any = None, **options: Any) -> Any:
    """Parse JSON; `options` are those of `json.loads`.

    Raises
    ------
    InputError
        Brackets inside brackets, more levels than the limit `depth`.
    ValueError
        No JSON (`json.JSONDecodeError`), or no UTF-8.
    """
    depth = current_limits().depth
    require(
        not _deeper(data.encode("utf-8", "replace") if isinstance(data, str) else data, depth),
        "malformed JSON: brackets inside brackets",
        got=f"more than {depth} levels",
        cause=f"meant to be so deep? {LIMITS_OPTION} depth={10 * depth}",
        path=path,
    )
    return json.loads(data if isinstance(data, str) else data.decode("utf-8-sig"), **options)


_STRING = re.compile(rb'"[^"\\]*(?:\\.[^"\\]*)*"', re.DOTALL)
_ALIKE = bytes.maketrans(b"{}", b"[]")
_NO_BRACKETS = bytes(set(range(256)) - set(b"[]{}"))


def _deeper(data: bytes, depth: int) -> bool:
    """Return True for brackets nested deeper than `depth` levels; pairs are removed level by level."""
    left = data.translate(_ALIKE, _NO_BRACKETS)
    for _ in range(depth):
        shorter = left.replace(b"[]", b"")
        if len(shorter) == len(left):
            break
        left = shorter
    if left and b'"' in data:
        # Strings may hold brackets: without them the count is exact.
        return _deeper(_STRING.sub(b"", data).replace(b'"', b""), depth)
    # What does not pair is no JSON; the parser says so, if it is not too deep to find out.
    return b"[]" in left or left.count(b"[") > depth


def check_pixels(data: bytes, path: Any) -> None:
    """Raise InputError for an encoded picture above the limit of pixels, or with a header without a size."""
    size = header_size(data)
    if size is None or min(size) < 0:
        raise InputError("a picture whose header tells no size", cause="is it cut off or damaged?", path=path)
    if size[0] * size[1] > current_limits().pixels:
        within(size[0] * size[1], "pixels", f"a picture of {size[0]}x{size[1]}", path, limits_of(path))


def read_picture(path: Path) -> np.ndarray | None:
    """Read a picture as stored, (H, W) or (H, W, C) in OpenCV's order; None if not decodable.

    Raises as `opened` and `check_pixels`.
    """
    import cv2

    data = read_bytes(path)
    if header_size(data) is None:
        return None
    check_pixels(data, path)
    return cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)


def load_arrays(source: bytes | IO[bytes], path: Any) -> Any:
    """Load the array of an NPY, or lazily by name the arrays of an NPZ, without unpickling.

    Raises
    ------
    InputError
        Larger than the limits, by the headers.
    Exception
        Damaged bytes fail in zipfile, zlib or NumPy, each with its own class.
    """
    file = io.BytesIO(source) if isinstance(source, bytes) else source
    packed = file.read(2) == b"PK"
    file.seek(0)
    if packed:
        archive = open_archive(file, path)
        check_members(archive, path)
        for member in archive.infolist():
            with archive.open(member) as array:
                _, size = array_header(array)
            within(size, "bytes", f"{member.filename[:80]} in an archive", path, limits_of(path))
    else:
        shape, _ = array_header(file)
        within(math.prod(shape), "pixels", f"an array of {'x'.join(map(str, shape))}", path, limits_of(path))
    file.seek(0)
    return np.load(file, allow_pickle=False)


def checked_texts(array: np.ndarray) -> np.ndarray:
    """An array as text, (...) of unicode; ValueError where a code point is no character.

    NumPy gives such a text to Python, which fails wherever it is first used.
    """
    texts = array.astype(np.str_)
    if texts.size and np.ascontiguousarray(texts).reshape(-1, 1).view(np.uint32).max(initial=0) > sys.maxunicode:
        raise ValueError("a text holds what is no character")
    return texts


@contextmanager
def opened_arrays(path: Path) -> Iterator[Any]:
    """Load arrays of a file; raises as `opened` and `load_arrays`."""
    with opened(path) as file, load_arrays(file, path) as arrays:
        yield arrays


def check_members(archive: ZipFile, path: Any) -> None:
    """Raise InputError for an archive with too many or too large members, or a name climbing out.

    No more is ever unpacked of a member than declared.
    """
    limits, members = limits_of(path), archive.infolist()
    within(len(members), "members", "an archive", path, limits)
    for member in members:
        name = PurePosixPath(member.filename.replace("\\", "/"))
        require(
            not name.is_absolute() and ".." not in name.parts,
            "a member of the archive that would lie outside it",
            got=repr(member.filename[:80]),
            path=path,
        )
        within(member.file_size, "bytes", f"{member.filename[:80]} in an archive", path, limits)
    within(sum(m.file_size for m in members), "unpacked", "an archive, unpacked,", path, limits)


def open_zip(path: Path) -> ZipFile:
    """Open an archive to read members in place; raises as `opened` (of size `unpacked`) and `check_members`."""
    with opened(path, "unpacked") as file:
        check_members(open_archive(file, path), path)
    return ZipFile(path)


def open_parquet(source: Any, path: Any = None, **options: Any) -> Any:
    """Open a `pyarrow.parquet.ParquetFile` of a path or an open file (named by `path`), with its `options`.

    Raises
    ------
    InputError
        As `opened` (of its size `unpacked`), or too many rows.
    pyarrow.ArrowException
        Damaged.
    """
    path = path or source
    if isinstance(source, Path):
        check_footer(source)
    file = pq.ParquetFile(source, **options)
    try:
        within(file.metadata.num_rows, "rows", "a table", path, limits_of(path))
    except InputError:
        file.close()
        raise
    return file


def parquet_columns(path: Path) -> list[str]:
    """Names of a table's columns; raises as `open_parquet`."""
    with open_parquet(path) as file:
        return file.schema_arrow.names


def check_footer(path: Path) -> None:
    """Raise InputError for a Parquet footer above the limit; raises as `opened`."""
    with opened(path, "unpacked") as file:
        size = os.fstat(file.fileno()).st_size
        if size > 8:
            file.seek(size - 8)
            # What names itself otherwise is no table, which pyarrow says by itself.
            length, mark = int.from_bytes(file.read(4), "little"), file.read(4)
            within(length if mark in (b"PAR1", b"PARE") else 0, "text", "the end of a table", path, limits_of(path))


def read_parquet(path: Path, columns: list[str] | None = None, filters: Any = None) -> Any:
    """Read a `pyarrow.Table`, whole or filtered by pyarrow's `filters`; raises as `open_parquet`."""
    if filters is not None:
        check_footer(path)
        return pq.read_table(path, columns=columns, filters=filters)
    with open_parquet(path) as file:
        return file.read(columns=columns)
