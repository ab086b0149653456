"""Whole-file writing (under a hidden name, synced, renamed into place), and hashes of files."""

from __future__ import annotations

import hashlib
import json
import os
import re
import shutil
import socket
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext, suppress
from glob import escape
from pathlib import Path
from threading import Lock
from typing import IO, Any, TextIO
from uuid import uuid4

from pipeline.system.errors import InputError, as_input_error, require
from pipeline.system.safe_files import opened

if sys.platform != "win32":
    import fcntl

_ALONE = Lock()
_TEMPORARY = re.compile(r"\..*\.(?P<host>[^.]*)\.(?P<pid>\d+)\.[0-9a-f]{8}\.tmp")
_CLEARED: set[Path] = set()
_ABANDONED_S = 86_400
"""A temporary name of another machine counts as left behind when it is as old as this."""


def temporary_sibling(path: Path) -> Path:
    """Hidden name beside a file or folder for this writer alone, also in folders shared by machines."""
    host = socket.gethostname().replace(".", "-")
    return path.with_name(f".{path.name}.{host}.{os.getpid()}.{uuid4().hex[:8]}.tmp")


def clear_abandoned(folder: Path, ours: bool = True) -> None:
    """Remove leftovers of killed writers from a folder, without the files of living ones.

    In a folder that is not `ours` only numbers of this machine's processes tell a leftover.
    """
    for left in folder.glob(".*.tmp"):
        if not (ours or _of_this_machine(left)) or not is_abandoned(left):
            continue
        if left.is_dir() and not left.is_symlink():
            shutil.rmtree(left, ignore_errors=True)
        else:
            with suppress(OSError):
                left.unlink(missing_ok=True)


def _clear_once(folder: Path) -> None:
    """Remove leftovers of killed writers, once for each folder: listing a large one takes its time."""
    if folder not in _CLEARED:
        _CLEARED.add(folder)
        clear_abandoned(folder, ours=False)


def _of_this_machine(temporary: Path) -> re.Match[str] | None:
    found = _TEMPORARY.fullmatch(temporary.name)
    return found if found is not None and found["host"] == socket.gethostname().replace(".", "-") else None


def is_abandoned(temporary: Path) -> bool:
    """Return True for a temporary name of a dead process, or a day old."""
    found = _of_this_machine(temporary)
    # On Windows os.kill would end the process instead of asking for it.
    if os.name == "posix" and found is not None:
        try:
            os.kill(int(found["pid"]), 0)
        except ProcessLookupError:
            return True
        except OSError:
            return False
        return False
    try:
        return time.time() - temporary.stat().st_mtime > _ABANDONED_S
    except OSError:
        return False


@contextmanager
def alone(folder: Path) -> Iterator[None]:
    """Lock a folder, made if missing, against other processes of this machine; on Windows of this process only."""
    folder.mkdir(parents=True, exist_ok=True)
    with _ALONE, open(folder / ".lock", "w") as lock:
        if sys.platform != "win32":
            fcntl.flock(lock, fcntl.LOCK_EX)
        yield


def write_whole(path: Path, data: bytes, what: str, make_folder: bool = True) -> None:
    """Write a file whole or not at all; raises as `whole_file`."""
    with whole_file(path, what, make_folder) as temporary:
        write_synced(temporary, data)


def write_synced(path: Path, data: bytes) -> None:
    """Write a file and sync to the disk."""
    with open(path, "wb") as file:
        file.write(data)
        file.flush()
        os.fsync(file.fileno())


@contextmanager
def whole_file(path: Path, what: str, make_folder: bool = True) -> Iterator[Path]:
    """Hidden name beside a new file, renamed at the good end of the block, else removed.

    Raises
    ------
    InputError
        `what` cannot be written.
    """
    temporary = temporary_sibling(path)
    with as_input_error(f"{what} cannot be written", OSError, got=lambda error: error.strerror, path=path):
        try:
            if make_folder:
                path.parent.mkdir(parents=True, exist_ok=True)
            _clear_once(path.parent)
            yield temporary
            os.replace(temporary, path)
        finally:
            with suppress(OSError):
                temporary.unlink(missing_ok=True)


@contextmanager
def file_with_companions(out: Path) -> Iterator[Path]:
    """Path in a hidden folder to write a file at; at the good end of the block all files there move beside `out`.

    The file itself comes last, and an earlier one goes first: either has its companions, also after a kill.
    """
    with temporary_folder(out) as folder:
        yield folder / out.name
        files = sorted((file for file in folder.iterdir() if file.is_file()), key=lambda file: file.name == out.name)
        for file in files:
            with open(file, "rb") as written:
                os.fsync(written.fileno())
        out.unlink(missing_ok=True)
        for file in files:
            os.replace(file, out.with_name(file.name))


@contextmanager
def scratch_folder() -> Iterator[Path]:
    """Make a private folder among the system's temporary files; leftovers of killed processes go."""
    place = Path(tempfile.gettempdir()) / "spatialviz"
    clear_abandoned(place.parent, ours=False)
    with temporary_folder(place, 0o700) as folder:
        yield folder


@contextmanager
def temporary_folder(path: Path, mode: int = 0o777) -> Iterator[Path]:
    """Make a folder under a hidden name beside `path`, removed at the end of the block."""
    folder = temporary_sibling(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    _clear_once(path.parent)
    folder.mkdir(mode)
    try:
        yield folder
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def sha256_of(source: Path | IO[bytes]) -> str:
    """SHA-256 of a file, by path or open for reading, in hexadecimal."""
    digest = hashlib.sha256()
    with opened(source, "unpacked") if isinstance(source, Path) else nullcontext(source) as file:
        while block := file.read(1 << 20):
            digest.update(block)
    return digest.hexdigest()


def keep_whole(path: Path, write: Callable[[Any], object]) -> None:
    """Keep a result of `write` (into an open binary file) in the cache, whole, or not at all in a read-only folder."""
    with (
        suppress(InputError),
        whole_file(path, "the cache") as temporary,
        open(temporary, "wb", opener=lambda name, flags: os.open(name, flags, 0o600)) as file,
    ):
        write(file)


@contextmanager
def staged_folder(out: Path, *, overwrite: bool, mark: str) -> Iterator[Path]:
    """Hidden folder beside `out`, renamed at the good end of the block, else removed.

    Raises
    ------
    InputError
        `out` is a file, is not empty, or cannot be written. With `overwrite`, the folder of an earlier run (told by the
        file `mark`) is replaced, and one of anything else still refused.
    """
    final = out.absolute()
    _bring_back(final)
    check_target(out, overwrite=overwrite, mark=mark)
    staging = temporary_sibling(final)
    try:
        final.parent.mkdir(parents=True, exist_ok=True)
        clear_abandoned(final.parent, ours=False)
        staging.mkdir()
    except OSError as error:
        raise InputError("the folder cannot be made", got=error.strerror, path=out) from error
    try:
        yield staging
        _take_name(staging, final, overwrite=overwrite, mark=mark)
    except OSError as error:
        raise InputError("the folder cannot be written", got=error.strerror or str(error), path=out) from error
    finally:
        shutil.rmtree(staging, ignore_errors=True)


def _bring_back(final: Path) -> None:
    """Mend a folder's replacement after a kill: the old folder returns, or goes beside a new folder."""
    for old in final.parent.glob(f".{escape(final.name)}.*.old"):
        if not is_abandoned(old.with_suffix(".tmp")):
            continue
        if final.exists():
            shutil.rmtree(old, ignore_errors=True)
        else:
            with suppress(OSError):
                os.rename(old, final)


def check_target(out: Path, *, overwrite: bool, mark: str) -> None:
    """Refuse a target that would be harmed; see `staged_folder`."""
    if not out.exists():
        return
    require(out.is_dir(), "what is written is a folder", got="a file", path=out)
    if not any(out.iterdir()):
        return
    require(
        (out / mark).is_file(),
        "the folder is not empty, and holds nothing that may be replaced",
        expected="a new or empty folder",
        path=out,
    )
    require(overwrite, "the folder is not empty", expected="another folder, or to overwrite it", path=out)


def _take_name(staging: Path, final: Path, *, overwrite: bool, mark: str) -> None:
    # Somebody may have filled the folder since.
    check_target(final, overwrite=overwrite, mark=mark)
    if not final.exists():
        os.rename(staging, final)
        return
    old = staging.with_suffix(".old")
    os.rename(final, old)
    try:
        os.rename(staging, final)
    except BaseException:
        with suppress(OSError):
            os.rename(old, final)
        raise
    shutil.rmtree(old, ignore_errors=True)


@contextmanager
def text_file(path: Path) -> Iterator[TextIO]:
    """Open a new UTF-8 file with "\\n" line ends, synced at the end of the block."""
    with open(path, "w", encoding="utf-8", newline="\n") as file:
        yield file
        file.flush()
        os.fsync(file.fileno())


def write_json(path: Path, content: object) -> None:
    """Write a small JSON file, indented."""
    with text_file(path) as file:
        file.write(json.dumps(content, indent=1, ensure_ascii=False, allow_nan=False) + "\n")
