"""Files that appear whole or not at all (written under a hidden name, synced, renamed into place), and their hashes."""

from __future__ import annotations

import hashlib
import os
import re
import shutil
import socket
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext, suppress
from pathlib import Path
from typing import IO, Any
from uuid import uuid4

from pipeline.system.errors import InputError

_TEMPORARY = re.compile(r"\..*\.(?P<host>[^.]*)\.(?P<pid>\d+)\.[0-9a-f]{8}\.tmp")
_ABANDONED_S = 86_400
"""A temporary name of another machine counts as left behind when it is as old as this."""


def temporary_beside(path: Path) -> Path:
    """A hidden name beside a file or folder that is this writer's alone, also where machines share the folder."""
    host = socket.gethostname().replace(".", "-")
    return path.with_name(f".{path.name}.{host}.{os.getpid()}.{uuid4().hex[:8]}.tmp")


def clear_abandoned(folder: Path) -> None:
    """Remove what killed writers left in a folder; what another process is writing stays."""
    for left in folder.glob(".*.tmp"):
        if not is_abandoned(left):
            continue
        if left.is_dir():
            shutil.rmtree(left, ignore_errors=True)
        else:
            left.unlink(missing_ok=True)


def is_abandoned(temporary: Path) -> bool:
    """Whether nobody writes under this temporary name any more: its process is gone, or it is a day old."""
    found = _TEMPORARY.fullmatch(temporary.name)
    # On Windows os.kill would end the process instead of asking for it.
    if os.name == "posix" and found is not None and found["host"] == socket.gethostname().replace(".", "-"):
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


def write_whole(path: Path, data: bytes, what: str, make_folder: bool = True) -> None:
    """Write a file whole or not at all; its folder is made where it is missing, unless that is an error.

    Raises
    ------
    InputError
        `what` cannot be written.
    """
    temporary = temporary_beside(path)
    try:
        if make_folder:
            path.parent.mkdir(parents=True, exist_ok=True)
        write_synced(temporary, data)
        os.replace(temporary, path)
    except OSError as error:
        raise InputError(f"{what} cannot be written", got=error.strerror, path=path) from error
    finally:
        with suppress(OSError):
            temporary.unlink(missing_ok=True)


def write_synced(path: Path, data: bytes) -> None:
    """Write a file and wait until it is on the disk."""
    with open(path, "wb") as file:
        file.write(data)
        file.flush()
        os.fsync(file.fileno())


@contextmanager
def temporary_folder(path: Path) -> Iterator[Path]:
    """A new folder under a hidden name beside `path`; what is left of it at the end of the block is removed."""
    folder = temporary_beside(path)
    folder.mkdir(parents=True)
    try:
        yield folder
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def sha256_of(source: Path | IO[bytes]) -> str:
    """Of a file's content, by its path or open for reading, in hexadecimal."""
    digest = hashlib.sha256()
    with source.open("rb") if isinstance(source, Path) else nullcontext(source) as file:
        while block := file.read(1 << 20):
            digest.update(block)
    return digest.hexdigest()


def keep_whole(path: Path, write: Callable[[Any], object]) -> None:
    """Keep what was computed, whole or not at all; a folder that cannot be written only means that nothing is kept.

    Parameters
    ----------
    path : Path
    write : callable
        Writes into the open binary file that it gets.
    """
    temporary: Path | None = None
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.NamedTemporaryFile(dir=path.parent, suffix=".tmp", delete=False) as file:
            temporary = Path(file.name)
            write(file)
        os.replace(temporary, path)
    except OSError:
        if temporary is not None:
            temporary.unlink(missing_ok=True)
