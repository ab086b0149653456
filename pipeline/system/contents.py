"""Hashes of datasets by content: the same on every machine, wherever the files are and whenever they were written.

Of a text the whole counts; of any other file above 12 KiB its size and 4 KiB each of its beginning, middle and end:
PNG, ZIP, NPZ and Parquet keep checksums of the rest there. Files at a URL are not fetched for it: their versions count.
"""

from __future__ import annotations

import hashlib
import os
import stat
from collections.abc import Iterable, Iterator
from contextlib import suppress
from pathlib import Path

import xxhash

from pipeline.system.limits import current_limits
from pipeline.system.paths import cache_folder
from pipeline.system.remote import url_of
from pipeline.system.whole_files import keep_whole

PIECE = 4096
Found = Iterator[tuple[str, str, os.stat_result]]


def contents_hash(root: Path, leave_out: Path | None = None) -> str:
    """Hash of all files below a folder by relative path and content, or of a file by content: 64 hexadecimal digits.

    Hidden files and the folder `leave_out` do not count, a link to a folder counts by where it points. A second time
    no file of this machine is read whose size, place on the disk and times are the same.
    """
    if url_of(root) is not None:
        # A copy's times stand for the versions there.
        return _sum(
            f"{name}\0{state.st_size}\0{state.st_mtime_ns}".encode() for name, _, state in walk(root, leave_out)
        )
    seen = _sum(_stamp(*found) for found in walk(root, leave_out))
    kept = cache_folder() / "contents" / hashlib.sha256(f"{os.path.abspath(root)}\0{seen}".encode()).hexdigest()
    with suppress(OSError, UnicodeDecodeError):
        if len(known := kept.read_text()) == len(seen):
            return known
    found = _sum(os.fsencode(name) + b"\0" + _content(path, state) for name, path, state in walk(root, leave_out))
    keep_whole(kept, lambda file: file.write(found.encode()))
    return found


def walk(root: Path, leave_out: Path | None = None) -> Found:
    """Visible files below a folder, or a file itself: relative name ("" of itself), path and state, in any order."""
    if root.is_file():
        yield "", str(root), root.stat()
        return
    yield from _below(root, "", None if leave_out is None else leave_out.resolve())


def _below(folder: Path, prefix: str, leave_out: Path | None) -> Found:
    inner = []
    with os.scandir(folder) as entries:
        for entry in entries:
            if entry.name.startswith("."):
                continue
            if not entry.is_dir(follow_symlinks=False):
                yield prefix + entry.name, entry.path, entry.stat(follow_symlinks=False)
            elif leave_out is None or entry.name != leave_out.name or Path(entry.path).resolve() != leave_out:
                inner.append(entry.name)
    for name in inner:
        yield from _below(folder / name, f"{prefix}{name}/", leave_out)


def _sum(parts: Iterable[bytes]) -> str:
    """Hash of parts in any order: file systems list names in different ones, and sorting would hold them all."""
    total = count = 0
    for part in parts:
        total += xxhash.xxh3_128_intdigest(part)
        count += 1
    return hashlib.sha256(f"{count} {total % (1 << 128):032x}".encode()).hexdigest()


def _stamp(name: str, path: str, state: os.stat_result) -> bytes:
    state, link = _followed(path, state)
    times = f"{state.st_size} {state.st_mtime_ns} {state.st_ctime_ns} {state.st_ino} {link}"
    return os.fsencode(f"{name}\0{times}")


def _followed(path: str, state: os.stat_result) -> tuple[os.stat_result, str]:
    """State of what a link to a file leads to; of another link itself, with where it points."""
    if stat.S_ISLNK(state.st_mode):
        if not os.path.isfile(path):
            return state, os.readlink(path)
        state = os.stat(path)
    return state, ""


def _content(path: str, state: os.stat_result) -> bytes:
    state, link = _followed(path, state)
    if not stat.S_ISREG(state.st_mode):
        return os.fsencode(link) or b"no regular file"
    digest = xxhash.xxh3_128(str(state.st_size).encode())
    try:
        # What was a file a moment ago may be a FIFO now: opening must not wait.
        number = os.open(path, os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0))
    except OSError:
        return b"unreadable"
    with open(number, "rb", buffering=0) as file:
        first = file.read(PIECE)
        digest.update(first)
        if state.st_size <= 3 * PIECE or (b"\0" not in first and state.st_size <= current_limits().text):
            while block := file.read(1 << 20):
                digest.update(block)
            return digest.digest()
        for start in (state.st_size // 2, state.st_size - PIECE):
            file.seek(start)
            digest.update(file.read(PIECE))
    return digest.digest()
