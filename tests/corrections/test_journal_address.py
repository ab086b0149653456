"""URLs of PostgreSQL, logins, and what the driver says when something is wrong."""

from __future__ import annotations

import os
import signal
import socket
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest
from postgres_cluster import Cluster, missing, started_cluster
from waiting import LONG_S, wait_until

from pipeline.corrections import Edit, Journal, NotSaved, Saved, object_ref, open_journal, redo, undo
from pipeline.corrections.journal import connection
from pipeline.corrections.journal.connection import PostgresStore, likely_cause, reason_of, without_password
from pipeline.system import InputError

NAME = object_ref("f", 1, "label")
SECRET = "it's: a\\secret %40"


@pytest.fixture(autouse=True)
def _plain(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    for name in [n for n in os.environ if n.startswith("PG")]:
        monkeypatch.delenv(name)
    monkeypatch.setenv("PGPASSFILE", str(tmp_path / "none"))


@pytest.mark.parametrize(
    ("where", "shown"),
    [
        (
            "postgresql://ann:a%2Fb@db.lab:6000/labels?sslmode=disable",
            "postgresql://ann@db.lab:6000/labels?sslmode=disable",
        ),
        ("postgresql://ann:a/b?c@db", "postgresql://ann@db"),
        ("postgresql:///x?password=a&port=3", "postgresql:///x?port=3"),
        ("postgresql://[::1]:6/x?sslpassword=a", "postgresql://[::1]:6/x"),
        ("/a/b:c@d?e.sqlite", "/a/b:c@d?e.sqlite"),
    ],
)
def test_a_password_is_never_shown(where: str, shown: str) -> None:
    assert without_password(where) == shown


@pytest.mark.parametrize(
    "where",
    [
        "postgresql://a@b/c?sslmode=maybe",
        "postgresql://a@b/c?nothing=x",
        "postgresql://a@b:x/c",
        "postgresql://a@b/c?sslmode=verify-ca&sslrootcert=/nowhere",
        "postgresql://a@b/c?connect_timeout=soon",
        "postgresql+psycopg://a@b/c",
        "mysql://a@b/c",
    ],
)
def test_what_cannot_be_used_is_refused_in_one_line(where: str) -> None:
    with pytest.raises(InputError) as error:
        open_journal(where)
    assert len(str(error.value).splitlines()) == 1


def test_a_url_of_an_earlier_version_names_the_same_journal() -> None:
    pytest.importorskip("psycopg")
    shown = [PostgresStore(f"postgresql{driver}://ann:x@db/labels").location for driver in ("", "+pg8000")]
    assert shown == ["postgresql://ann@db/labels"] * 2


@pytest.fixture(scope="module")
def locked() -> Iterator[Cluster]:
    """A server that asks for a password."""
    reason = missing()
    if reason is not None:
        if os.environ.get("SPATIALVIZ_REQUIRE_EXTRAS") == "1":
            pytest.fail(reason)
        pytest.skip(reason)
    with started_cluster(SECRET) as cluster:
        yield cluster


@pytest.mark.slow
def test_logins(locked: Cluster, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for where in (locked.url, locked.url.replace("postgres@", "postgres:wrong@")):
        with pytest.raises(InputError, match=r"cannot be opened; got .*(password|authentication)") as error:
            open_journal(where)
        assert "wrong" not in str(error.value)
    passwords = tmp_path / "pgpass"
    passwords.write_text("127.0.0.1:*:postgres:postgres:" + SECRET.replace("\\", "\\\\").replace(":", "\\:") + "\n")
    passwords.chmod(0o600)
    monkeypatch.setenv("PGPASSFILE", str(passwords))
    with open_journal(locked.url) as journal:
        assert isinstance(journal.append([Edit(NAME, "mug", "cup 椅 %s 100%")], "ann"), Saved)
        assert journal.events()[0].after == "cup 椅 %s 100%"
    monkeypatch.setenv("PGPASSFILE", str(tmp_path / "none"))
    monkeypatch.setenv("PGPASSWORD", SECRET)
    sockets = f"postgresql://postgres@/postgres?host={locked.folder}&port={locked.url.split(':')[-1].split('/')[0]}"
    with open_journal(sockets) as journal:
        assert len(journal.events()) == 1
    with pytest.raises(InputError, match="does not support SSL"):
        open_journal(locked.url + "?sslmode=require")


@pytest.mark.slow
def test_a_taken_back_action_whose_answer_was_lost_is_taken_back_once(
    locked: Cluster, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("PGPASSWORD", SECRET)
    with open_journal(locked.url, project="undo") as journal:
        names = ("mug", "cup", "bowl", "vase")
        for number, (before, after) in enumerate(pairwise(names)):
            journal.append([Edit(NAME, before, after, number)], "ann")
        for take_back in (undo, redo, undo):
            count = len(journal.events())
            with pytest.raises(NotSaved, match="cannot be reached") as error:
                _cut_after_commit(journal, locked, lambda step=take_back: step(journal, "ann"))
            done = take_back(journal, "ann", again=error.value.group)
            assert isinstance(done, Saved)
            assert done.group == error.value.group
            assert len(journal.events()) == count + 1
        assert [e.after for e in journal.events()] == ["cup", "bowl", "vase", "bowl", "vase", "bowl"]


def _cut_after_commit(journal: Journal, cluster: Cluster, action: Callable[[], object]) -> None:
    """The server commits what the action writes, and dies before it has said so."""
    commit, run, writes = PostgresStore._commit, PostgresStore._run, []

    def lost(store: PostgresStore, link: Any, write: bool) -> None:
        commit(store, link, write)
        if writes:
            cluster.crash()
            run(store, link, "SELECT 1")

    def watch(store: PostgresStore, link: Any, statement: str, *values: Any) -> list[Any]:
        writes.extend([statement] if statement.startswith("INSERT") else [])
        return run(store, link, statement, *values)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(PostgresStore, "_commit", lost)
        patch.setattr(PostgresStore, "_run", watch)
        try:
            action()
        finally:
            if writes:
                cluster.start()


@pytest.mark.slow
def test_a_server_that_restarts_takes_the_next_edit(locked: Cluster, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PGPASSWORD", SECRET)
    with open_journal(locked.url, project="restart") as journal:
        assert isinstance(journal.append([Edit(NAME, None, "cup")], "ann"), Saved)
        locked.crash()
        group, edits = None, (Edit(NAME, "cup", "mug", 1),)
        for _ in range(2):
            with pytest.raises(NotSaved, match="the database cannot be reached: save again when it can") as error:
                journal.append(edits, "ann", group=group)
            group, edits = error.value.group, error.value.edits
            assert len(str(error.value).splitlines()) == 1
            assert SECRET not in str(error.value)
        locked.start()
        again = journal.append(edits, "ann", group=group)
        assert isinstance(again, Saved)
        assert [e.after for e in journal.events()] == ["cup", "mug"]


def test_a_broken_socket_is_an_error_of_the_database() -> None:
    assert likely_cause(reason_of(ConnectionResetError(104, "Connection reset by peer"))) is not None
    assert likely_cause(reason_of(TimeoutError("timed out"))) is not None


def test_a_server_that_never_answers_is_waited_for_once(monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("psycopg")
    with socket.create_server(("127.0.0.1", 0)) as silent:
        where = f"postgresql://ann@127.0.0.1:{silent.getsockname()[1]}/labels?connect_timeout=2"
        with pytest.raises(InputError, match=r"cannot be opened; got connection timeout expired.*cannot be reached"):
            open_journal(where)
        began = time.monotonic()
        with pytest.raises(InputError, match=r"the server does not answer.*cannot be reached"):
            open_journal(where)
        assert time.monotonic() - began < 1.0
        monkeypatch.setattr(connection, "_away", {})
        with pytest.raises(InputError, match=r"connection timeout expired"):
            open_journal(where)


def test_a_server_that_falls_silent_is_left_alone_until_it_answers(
    locked: Cluster, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("PGPASSWORD", SECRET)
    monkeypatch.setattr(connection, "PING_S", LONG_S)
    monkeypatch.setattr(connection, "AGAIN_S", 1.0)
    with open_journal(locked.url, project="silence") as journal:
        assert isinstance(journal.append([Edit(NAME, None, "cup")], "ann"), Saved)
        master = int((locked.folder / "data/postmaster.pid").read_text().split()[0])
        children = Path(f"/proc/{master}/task/{master}/children")
        if not children.exists():
            pytest.skip("the server's processes are not listed here")
        of_it = [master, *map(int, children.read_text().split())]
        for process in of_it:
            os.kill(process, signal.SIGSTOP)
        monkeypatch.setattr(connection, "PING_S", 0.1)
        try:
            with pytest.raises(InputError, match="cannot be read"):
                journal.events()
            with pytest.raises(NotSaved, match="cannot be reached") as error:
                journal.append([Edit(NAME, "cup", "mug", 1)], "ann")
        finally:
            for process in of_it:
                os.kill(process, signal.SIGCONT)
        monkeypatch.setattr(connection, "PING_S", LONG_S)
        done: list[object] = []

        def saved() -> bool:
            with suppress(NotSaved):
                done.append(journal.append(error.value.edits, "ann", group=error.value.group))
            return bool(done)

        assert wait_until(saved)
        assert isinstance(done[0], Saved)
        assert [e.after for e in journal.events()] == ["cup", "mug"]
