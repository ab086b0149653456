"""What is done with a journal as a whole: it is checked, copied, or what is intact of it is written into a new one."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

from pipeline.corrections.journal.chain import VERSION, version_of
from pipeline.corrections.journal.connection import (
    DATABASE_ERRORS,
    copy_whole,
    examined_server,
    is_url,
    location_of,
    opened,
    prepare,
    reading,
    reason_of,
    write_rows,
    writing,
)
from pipeline.corrections.journal.examining import Examined, empty_file, examine, is_empty
from pipeline.system.errors import InputError, as_input_error, require


def check_journal(where: str | Path) -> Examined:
    """Examine a journal in full, and change nothing.

    Parameters
    ----------
    where : str or Path
        As `open_journal` takes it.

    Raises
    ------
    InputError
        There is none, or it cannot be opened.
    """
    if is_url(where):
        with opened(where) as engine, reading(engine) as connection:
            version = version_of(connection)
            if version is not None and 0 < version <= VERSION:
                return examined_server(connection, location_of(engine), chain=version == VERSION)
        return Examined(location_of(engine), version, None, (), ()).believe()
    path = Path(where).expanduser()
    require(path.is_file(), "no journal here", path=path)
    if is_empty(path):
        raise empty_file(path)
    return examine(path)


def back_up(where: str | Path, to: Path) -> Examined:
    """Write a copy of a journal, with what is in its log, and examine it; others may save meanwhile.

    Raises
    ------
    InputError
        It is in a server, the copy's name is taken, or it cannot be written.
    DamagedJournal
        The journal is damaged.
    """
    path = _file(where, to, "pg_dump copies it")
    check_journal(path).believe()
    return _written(to, lambda: copy_whole(path, to))


def recover(where: str | Path, to: Path) -> tuple[Examined, Examined]:
    """Write what is intact of a journal into a new one; the damaged one is not changed.

    An undo or redo is left out where what it takes back is.

    Returns
    -------
    damaged, made : Examined

    Raises
    ------
    InputError
        It is in a server, nothing is intact, the new name is taken, or it cannot be written.
    """
    path = _file(where, to, "its own backups hold it")
    found = check_journal(path)
    rows = found.standing
    if not rows:
        what = "those of its events that are intact take back others, which are not" if found.intact else found.summary
        raise InputError(f"nothing of the journal can be recovered: {what}", cause="a backup may have it", path=path)

    def write() -> None:
        part = Path(f"{to}.part")
        try:
            with opened(part) as engine:
                prepare(engine)
                with writing(engine) as connection:
                    write_rows(connection, rows)
            os.replace(part, to)
        finally:
            for end in ("", "-wal", "-shm"):
                Path(f"{part}{end}").unlink(missing_ok=True)

    return found, _written(to, write)


def _file(where: str | Path, to: Path, instead: str) -> Path:
    require(not is_url(where), "a journal in a server is not copied into a file", cause=instead)
    what = "there is a file of this name" if to.exists() else "the folder is not there"
    require(not to.exists() and to.parent.is_dir(), f"no journal can be written: {what}", path=to)
    return Path(where).expanduser()


def _written(to: Path, write: Callable[[], None]) -> Examined:
    with as_input_error("the copy cannot be written", *DATABASE_ERRORS, got=lambda e: reason_of(e, str(to)), path=to):
        write()
    return examine(to).believe()


def examined_record(found: Examined) -> dict[str, Any]:
    """`journal --check --json`: "events" were saved (null where unknown), "ranges" of ids are intact."""
    return {
        "journal": found.location,
        "sound": not found.damage,
        "chained": found.chained,
        "events": found.events,
        "intact": len(found.intact),
        "ranges": [list(run) for run in found.ranges],
        "damage": list(found.damage),
        "help": found.help,
    }


def written_record(found: Examined, made: Examined) -> dict[str, Any]:
    """`journal --backup --json` and `--recover --json`: the file that was made, and its events."""
    return {"journal": found.location, "written": made.location, "events": len(made.intact), "of": found.events}
