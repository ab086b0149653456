"""A folder that appears whole or not at all, and the text files in it."""

from __future__ import annotations

import json
import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TextIO

from pipeline.system.errors import InputError, require


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
    check_target(out, overwrite=overwrite, mark=mark)
    final = out.absolute()
    staging = final.with_name(f".{final.name}.{os.getpid()}.tmp")
    try:
        final.parent.mkdir(parents=True, exist_ok=True)
        shutil.rmtree(staging, ignore_errors=True)
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
    old = final.with_name(f".{final.name}.{os.getpid()}.old")
    shutil.rmtree(old, ignore_errors=True)
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
