"""Disks that are full, read-only or gone: one clear error, the edit handed back, and saved once when it can be."""

from __future__ import annotations

import os
import shutil
import sqlite3
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

import pytest
from postgres_cluster import missing, started_cluster
from waiting import LONG_S

from pipeline.corrections import JOURNAL_FILE, Edit, Journal, NotSaved, Saved, object_ref, open_journal
from pipeline.corrections.journal import journal as journal_module
from pipeline.corrections.journal.chain import write_rows
from pipeline.system import InputError

LONG = "x" * 1500


@pytest.fixture
def disk() -> Iterator[Path]:
    """A file system of a megabyte and a half."""
    with tempfile.TemporaryDirectory(prefix="spatialviz-") as folder:
        _mount(folder, "size=1536k")
        try:
            yield Path(folder)
        finally:
            subprocess.run(["umount", "-l", folder], check=False)


def _mount(folder: str | Path, options: str) -> None:
    if shutil.which("mount") is None or os.name != "posix" or os.getuid() != 0:
        pytest.skip("only root can mount a small disk")
    done = subprocess.run(
        ["mount", "-t", "tmpfs", "-o", options, "tmpfs", str(folder)], capture_output=True, text=True, check=False
    )
    if done.returncode:
        pytest.skip(f"no small disk can be mounted here: {done.stderr.strip()}")


def _fill(folder: Path) -> Path:
    """A file that takes all the room that is left."""
    ballast = folder / "ballast"
    with open(ballast, "wb", buffering=0) as file:
        try:
            while True:
                file.write(b"x" * 4096)
        except OSError:
            return ballast


def _edits(number: int) -> list[Edit]:
    """Two edits of one action."""
    return [Edit(object_ref("f", 2 * number + k, "label"), "mug", "cup", reason=LONG) for k in range(2)]


def _until_refused(journal: Journal) -> tuple[int, NotSaved]:
    """How many actions were saved before one was not."""
    for number in range(2_000):
        try:
            assert isinstance(journal.append(_edits(number), "ann"), Saved)
        except NotSaved as error:
            return number, error
    raise AssertionError("the disk is never full")


def _check_refused(error: NotSaved, number: int, journal: Journal) -> None:
    assert list(error.edits) == _edits(number)
    assert len(str(error).splitlines()) == 1
    assert len(journal.events()) == 2 * number


def _save_again(journal: Journal, error: NotSaved, number: int) -> None:
    """With room: saved, once, also where it is asked for twice; and the file is whole."""
    done = journal.append(error.edits, "ann", group=error.group)
    assert isinstance(done, Saved)
    assert done.group == error.group
    assert journal.append(error.edits, "ann", group=error.group) == done
    assert isinstance(journal.append(_edits(number + 1), "ann"), Saved)
    events = journal.events()
    journal.close()
    assert len(events) == 2 * (number + 2)
    if "://" not in journal.location:
        with sqlite3.connect(journal.location) as raw:
            assert raw.execute("PRAGMA integrity_check").fetchall() == [("ok",)]
            busy, pages, moved = raw.execute("PRAGMA wal_checkpoint(TRUNCATE)").fetchone()
            assert (busy, pages) == (0, moved)
    with open_journal(journal.location) as again:
        assert again.events() == events


def test_a_full_disk(disk: Path) -> None:
    journal = open_journal(disk / JOURNAL_FILE)
    ballast = _fill(disk)
    number, error = _until_refused(journal)
    assert "the disk is full: free some space" in str(error)
    _check_refused(error, number, journal)
    with pytest.raises(NotSaved):
        journal.append(error.edits, "ann", group=error.group)
    ballast.unlink()
    _save_again(journal, error, number)


def test_a_full_disk_has_no_room_for_a_journal(disk: Path) -> None:
    ballast = _fill(disk)
    with pytest.raises(InputError, match=r"cannot be opened; got .*full") as error:
        open_journal(disk / JOURNAL_FILE)
    assert len(str(error.value).splitlines()) == 1
    ballast.unlink()
    with open_journal(disk / JOURNAL_FILE) as journal:
        assert isinstance(journal.append(_edits(0), "ann"), Saved)


def test_a_full_disk_is_told_as_one_where_a_journal_is_opened(disk: Path) -> None:
    with open_journal(disk / JOURNAL_FILE) as journal:
        assert isinstance(journal.append(_edits(0), "ann"), Saved)
    ballast = _fill(disk)
    # SQLite says "disk I/O error" where there is no room for the index of its log.
    with pytest.raises(InputError, match=r"cannot be opened; got .*disk is full.*free some space"):
        open_journal(disk / JOURNAL_FILE)
    ballast.unlink()
    with open_journal(disk / JOURNAL_FILE) as journal:
        assert journal.count() == 2


@pytest.mark.slow
def test_a_limit_on_the_size_of_files(tmp_path: Path) -> None:
    """As a quota: needs no root. In a child, for the limit is of a process."""
    pytest.importorskip("resource")
    program = f"""
import resource
from test_journal_disk import _check_refused, _save_again, _until_refused
from pipeline.corrections.journal.journal import open_journal
journal = open_journal({str(tmp_path / JOURNAL_FILE)!r})
hard = resource.getrlimit(resource.RLIMIT_FSIZE)[1]
resource.setrlimit(resource.RLIMIT_FSIZE, (400_000, hard))
number, error = _until_refused(journal)
_check_refused(error, number, journal)
resource.setrlimit(resource.RLIMIT_FSIZE, (hard, hard))
_save_again(journal, error, number)
print(number, error)
"""
    here = Path(__file__).resolve().parent
    done = subprocess.run(
        [sys.executable, "-c", program],
        capture_output=True,
        text=True,
        timeout=LONG_S,
        check=False,
        env={**os.environ, "PYTHONPATH": os.pathsep.join(map(str, (here, here.parent, here.parents[1])))},
    )
    assert done.returncode == 0, done.stdout + done.stderr
    assert "mend that and save again" in done.stdout
    assert int(done.stdout.split()[0]) > 5


def test_a_disk_that_becomes_read_only(disk: Path) -> None:
    journal = open_journal(disk / JOURNAL_FILE)
    assert isinstance(journal.append(_edits(0), "ann"), Saved)
    # A file that is open for writing keeps the kernel from it.
    journal.close()
    subprocess.run(["mount", "-o", "remount,ro", str(disk)], check=True)
    with pytest.raises(NotSaved, match="the folder cannot be written") as error:
        journal.append(_edits(1), "ann")
    assert list(error.value.edits) == _edits(1)
    assert len(str(error.value).splitlines()) == 1
    with pytest.raises(InputError):
        open_journal(disk / "other.sqlite")
    subprocess.run(["mount", "-o", "remount,rw", str(disk)], check=True)
    _save_again(journal, error.value, 1)


@pytest.mark.skipif(os.name != "posix", reason="open files cannot be removed elsewhere")
@pytest.mark.parametrize("how", ["moved", "removed", "replaced"])
def test_a_folder_that_goes_while_the_journal_is_open(tmp_path: Path, how: str) -> None:
    folder, kept = tmp_path / "labels", tmp_path / "kept"
    folder.mkdir()
    journal = open_journal(folder / JOURNAL_FILE)
    assert isinstance(journal.append(_edits(0), "ann"), Saved)
    if how == "moved":
        folder.rename(kept)
    else:
        with sqlite3.connect(journal.location) as raw:
            kept.mkdir()
            raw.execute("VACUUM INTO ?", (str(kept / JOURNAL_FILE),))
        raw.close()
        shutil.rmtree(folder)
    if how == "replaced":
        folder.mkdir()
    with pytest.raises(NotSaved, match="unable to open") as error:
        journal.append(_edits(1), "ann")
    assert list(error.value.edits) == _edits(1)
    with pytest.raises(InputError, match="cannot be read"):
        journal.events()
    assert not (folder / JOURNAL_FILE).exists(), "none is begun in its place"
    if how == "replaced":
        folder.rmdir()
    kept.rename(folder)
    _save_again(journal, error.value, 1)


def test_a_file_that_goes_while_an_edit_is_saved(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    journal = open_journal(tmp_path / JOURNAL_FILE)
    assert isinstance(journal.append(_edits(0), "ann"), Saved)
    names = [JOURNAL_FILE + suffix for suffix in ("", "-wal", "-shm")]

    def take(*_: object) -> None:
        for name in names:
            (tmp_path / name).rename(tmp_path / f"kept-{name}")

    monkeypatch.setattr(journal_module, "write_rows", lambda *given: (write_rows(*given), take())[0])
    with pytest.raises(NotSaved, match=r"the journal's file is gone.*put the journal back") as error:
        journal.append(_edits(1), "ann")
    monkeypatch.undo()
    for name in names:
        if (tmp_path / f"kept-{name}").exists():
            (tmp_path / f"kept-{name}").rename(tmp_path / name)
    _save_again(journal, error.value, 1)


@pytest.fixture(scope="module")
def _postgres() -> None:
    reason = missing()
    if reason is not None:
        if os.environ.get("SPATIALVIZ_REQUIRE_EXTRAS") == "1":
            pytest.fail(reason)
        pytest.skip(reason)


@pytest.mark.slow
@pytest.mark.usefixtures("_postgres")
def test_a_server_whose_disk_is_full_or_read_only() -> None:
    with tempfile.TemporaryDirectory(prefix="spatialviz-pg-") as folder:
        _mount(folder, "size=120m")
        try:
            with started_cluster(folder=Path(folder)) as cluster:
                journal = open_journal(cluster.url)
                ballast = _fill(Path(folder))
                number, error = _until_refused(journal)
                assert "the disk is full: free some space" in str(error)
                _check_refused(error, number, journal)
                ballast.unlink()
                _save_again(journal, error, number)
                with journal.store.writing() as run:
                    run("ALTER DATABASE postgres SET default_transaction_read_only = on")
                journal.close()
                with pytest.raises(NotSaved, match="the database takes no edits now") as refused:
                    journal.append(_edits(9_999), "ann")
                assert list(refused.value.edits) == _edits(9_999)
        finally:
            subprocess.run(["umount", "-l", folder], check=False)
