"""The journal as a file: full disks, folders that cannot be written, files that are none."""

from __future__ import annotations

import os
import shutil
import sqlite3
import subprocess
import sys
import tempfile
from pathlib import Path

import pytest
from journal_checks import NAME, journal  # noqa: F401
from waiting import LONG_S

from pipeline.corrections import JOURNAL_FILE, Edit, Journal, NotSaved, Saved, object_ref, open_journal
from pipeline.corrections.journal.sqlite_file import network_file_system
from pipeline.system import InputError


def test_a_full_disk_is_told_and_hands_the_edit_back(journal: Journal) -> None:
    limited = open_journal(journal.location)
    # SQLite reports this limit as it does a disk without space: SQLITE_FULL. It is of a connection, which is kept.
    with limited.store.reading() as run:
        ((pages,),) = run("PRAGMA page_count")
        run(f"PRAGMA max_page_count = {pages}")

    def fill() -> None:
        for k in range(400):
            limited.append([Edit(object_ref("f", k, "label"), "mug", "cup", reason="x" * 1500)], "ann")

    with pytest.raises(NotSaved, match=r"could not be saved; got .*full.*free some space") as error:
        fill()
    (kept,) = error.value.edits
    assert "\n" not in str(error.value)
    before = len(journal.events())
    assert isinstance(journal.append([kept], "ann", group=error.value.group), Saved)
    assert len(journal.events()) == before + 1


def _append_without_rights(place: str) -> str:
    """In a child: as a user who may read the folder and not write to it."""
    program = f"""
import os
from pipeline.system.errors import InputError
from pipeline.corrections.journal.field_refs import object_ref
from pipeline.corrections.journal.events import Edit, NotSaved
from pipeline.corrections.journal.journal import open_journal
import sqlite3
if os.getuid() == 0:
    os.setgroups([]); os.setgid(65534); os.setuid(65534)
try:
    journal = open_journal({place!r})
    journal.append([Edit(object_ref("f", 1, "label"), "mug", "cup")], "ann")
    print("saved")
except NotSaved as error:
    print("NotSaved", len(error.edits), error)
except InputError as error:
    print("InputError", error)
"""
    done = subprocess.run(
        [sys.executable, "-c", program],
        capture_output=True,
        text=True,
        timeout=LONG_S,
        check=False,
        env={**os.environ, "PYTHONPATH": str(Path(__file__).resolve().parents[2])},
    )
    assert "Traceback" not in done.stderr, done.stderr
    return done.stdout.strip()


@pytest.mark.slow
@pytest.mark.skipif(os.name != "posix", reason="rights of POSIX")
def test_a_read_only_folder_is_told_in_one_line() -> None:
    folder = Path(tempfile.mkdtemp(prefix="spatialviz-"))
    try:
        os.chmod(folder, 0o555)
        said = _append_without_rights(str(folder / JOURNAL_FILE))
        assert said.startswith("InputError no journal can be made (the folder cannot be written)")
        os.chmod(folder, 0o755)
        open_journal(folder / JOURNAL_FILE).append([Edit(NAME, "mug", "cup")], "ann")
        os.chmod(folder / JOURNAL_FILE, 0o444)
        os.chmod(folder, 0o555)
        said = _append_without_rights(str(folder / JOURNAL_FILE))
        assert said.startswith("InputError" if "opened" in said else "NotSaved 1"), said
        assert len(said.splitlines()) == 1
        assert "readonly" in said or "unable to open" in said
    finally:
        os.chmod(folder, 0o755)
        shutil.rmtree(folder)


def test_a_journal_of_a_newer_release_and_other_files_are_refused(tmp_path: Path) -> None:
    journal = open_journal(tmp_path / JOURNAL_FILE)
    with sqlite3.connect(journal.location) as raw:
        raw.execute("UPDATE journal_head SET version = 3")
        raw.execute("PRAGMA user_version = 3")
    with pytest.raises(InputError, match="newer release"):
        open_journal(journal.location)
    (tmp_path / "text").write_text("no database, and long enough to be read as one " * 9)
    with pytest.raises(InputError, match="its first bytes are not those of a journal"):
        open_journal(tmp_path / "text")
    with sqlite3.connect(tmp_path / "other.sqlite") as raw:
        raw.execute("CREATE TABLE events (x)")
    with pytest.raises(InputError, match="something else"):
        open_journal(tmp_path / "other.sqlite")
    for where in (tmp_path, tmp_path / "nowhere" / "j.sqlite", "mysql://a@b/c", "postgresql://a@b:x/c"):
        with pytest.raises(InputError):
            open_journal(where)
    with pytest.raises(InputError, match="no journal here"):
        open_journal(tmp_path / "absent.sqlite", must_exist=True)
    assert not (tmp_path / "absent.sqlite").exists()


def test_saved_means_on_the_disk(journal: Journal) -> None:
    with journal.store.writing() as run:
        assert run("PRAGMA journal_mode") == [("wal",)]
        assert run("PRAGMA synchronous") == [(2,)]  # FULL


def test_network_file_systems_are_told_apart(tmp_path: Path) -> None:
    mounts = tmp_path / "mounts"
    mounts.write_text(
        "/dev/sda / ext4 rw 0 0\nserver:/x /mnt/team\\040share nfs4 rw 0 0\n"
        "/dev/sdb /mnt/team\\040share/disk xfs rw 0 0\n"
    )
    assert network_file_system("/mnt/team share/labels/journal.sqlite", mounts) == "nfs4"
    assert network_file_system("/mnt/team share/disk/journal.sqlite", mounts) is None
    assert network_file_system("/mnt/team shares/journal.sqlite", mounts) is None
    assert network_file_system("/mnt/x", tmp_path / "absent") is None


def test_a_new_journal_has_the_tables_of_earlier_ones(journal: Journal) -> None:
    """An older release opens it too; the statements that made them are hashed in the head."""
    kept = Path(__file__).parents[1] / "fixtures" / "2026-11-26" / "labels" / JOURNAL_FILE
    made = "SELECT name, sql FROM sqlite_master ORDER BY name"
    with sqlite3.connect(f"{kept.as_uri()}?immutable=1", uri=True) as old, journal.store.reading() as run:
        assert run(made) == old.execute(made).fetchall()
        tables = "SELECT tables, version FROM journal_head"
        assert run(tables) == old.execute(tables).fetchall()
