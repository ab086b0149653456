"""Files that appear whole or not at all (written under a hidden name, synced, renamed into place), and their hashes."""

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
_ABANDONED_S = 86_400
"""A temporary name of another machine counts as left behind when it is as old as this."""


def temporary_sibling(path: Path) -> Path:
    """A hidden name beside a file or folder that is this writer's alone, also where machines share the folder."""
    host = socket.gethostname().replace(".", "-")
    return path.with_name(f".{path.name}.{host}.{os.getpid()}.{uuid4().hex[:8]}.tmp")


def clear_abandoned(folder: Path, ours: bool = True) -> None:
    """Remove what killed writers left in a folder; what another process is writing stays.

    In a folder that is not `ours` only what bears the number of a process of this machine is known to be left.
    """
    for left in folder.glob(".*.tmp"):
        if not (ours or _of_this_machine(left)) or not is_abandoned(left):
            continue
        if left.is_dir() and not left.is_symlink():
            shutil.rmtree(left, ignore_errors=True)
        else:
            with suppress(OSError):
                left.unlink(missing_ok=True)


def _of_this_machine(temporary: Path) -> re.Match[str] | None:
    found = _TEMPORARY.fullmatch(temporary.name)
    return found if found is not None and found["host"] == socket.gethostname().replace(".", "-") else None


def is_abandoned(temporary: Path) -> bool:
    """Whether nobody writes under this temporary name any more: its process is gone, or it is a day old."""
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
    """Nobody else, of any process of this machine, changes the files of a folder meanwhile; it is made if missing.

    On Windows only nobody else of this process: of others the last writer wins.
    """
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
    """Write a file and wait until it is on the disk."""
    with open(path, "wb") as file:
        file.write(data)
        file.flush()
        os.fsync(file.fileno())


@contextmanager
def whole_file(path: Path, what: str, make_folder: bool = True) -> Iterator[Path]:
    """Hidden name beside a new file, which takes the file's name when the block ends well, and is removed if not.

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
            yield temporary
            os.replace(temporary, path)
        finally:
            with suppress(OSError):
                temporary.unlink(missing_ok=True)


def take_places(made: Path, out: Path) -> None:
    """Move all files of a folder beside `out`, and `made`, which is one of them, to `out` itself.

    It comes last, and one that was there goes first: whichever is there has what belongs to it, also after a kill.
    """
    files = [*(file for file in made.parent.iterdir() if file.is_file() and file != made), made]
    for file in files:
        with open(file, "rb") as written:
            os.fsync(written.fileno())
    out.unlink(missing_ok=True)
    for file in files:
        os.replace(file, out if file == made else out.with_name(file.name))


@contextmanager
def scratch_folder() -> Iterator[Path]:
    """A new folder of one's own where the system keeps temporary files; what killed processes left there is removed."""
    place = Path(tempfile.gettempdir()) / "spatialviz"
    clear_abandoned(place.parent, ours=False)
    with temporary_folder(place, 0o700) as folder:
        yield folder


@contextmanager
def temporary_folder(path: Path, mode: int = 0o777) -> Iterator[Path]:
    """A new folder under a hidden name beside `path`; what is left of it at the end of the block is removed."""
    folder = temporary_sibling(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    folder.mkdir(mode)
    try:
        yield folder
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def sha256_of(source: Path | IO[bytes]) -> str:
    """Of a file's content, by its path or open for reading, in hexadecimal."""
    digest = hashlib.sha256()
    with opened(source, "unpacked") if isinstance(source, Path) else nullcontext(source) as file:
        while block := file.read(1 << 20):
            digest.update(block)
    return digest.hexdigest()


def keep_whole(path: Path, write: Callable[[Any], object]) -> None:
    """Keep in the cache what `write` writes into an open binary file, whole; nothing where the folder is read-only."""
    with (
        suppress(InputError),
        whole_file(path, "the cache") as temporary,
        open(temporary, "wb", opener=lambda name, flags: os.open(name, flags, 0o600)) as file,
    ):
        write(file)


@contextmanager
def staged_folder(out: Path, *, overwrite: bool, mark: str) -> Iterator[Path]:
    """A hidden folder beside `out` that takes its name when the block ends well, and is removed when it does not.

    Raises
    ------
    InputError
        `out` is a file, is not empty, or cannot be written. With `overwrite`, what
        an earlier run wrote is replaced (told by the file `mark`), and a folder of
        anything else still refused.
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
    """What a kill left while a folder was replaced: the folder as it was is there again, or goes where there is one."""
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
    """A new UTF-8 file with "\\n" line ends, on the disk when the block ends."""
    with open(path, "w", encoding="utf-8", newline="\n") as file:
        yield file
        file.flush()
        os.fsync(file.fileno())


def write_json(path: Path, content: object) -> None:
    """A small JSON file, indented."""
    with text_file(path) as file:
        file.write(json.dumps(content, indent=1, ensure_ascii=False, allow_nan=False) + "\n")
