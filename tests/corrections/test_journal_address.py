"""URLs of PostgreSQL as libpq reads them, logins, and what the driver says when something is wrong."""

from __future__ import annotations

import os
import signal
import socket
import ssl
import threading
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
from pipeline.corrections.journal import postgres
from pipeline.corrections.journal.connection import likely_cause, reason_of
from pipeline.corrections.journal.postgres import PostgresStore, address_of, password_in_file, without_password
from pipeline.system import InputError

NAME = object_ref("f", 1, "label")
SECRET = "it's: a\\secret %40"


@pytest.fixture(autouse=True)
def _plain(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    for name in [n for n in os.environ if n.startswith("PG")]:
        monkeypatch.delenv(name)
    monkeypatch.setenv("PGPASSFILE", str(tmp_path / "none"))


def test_a_url_and_what_it_leaves_open(monkeypatch: pytest.MonkeyPatch) -> None:
    found = address_of("postgresql://ann:a%2Fb@db.lab:6000/labels?sslmode=disable&application_name=x")
    assert (found.host, found.port, found.user, found.database) == ("db.lab", 6000, "ann", "labels")
    assert (found.password, found.ssl, found.application) == ("a/b", False, "x")
    assert "a/b" not in repr(found)
    monkeypatch.setenv("PGUSER", "bob")
    monkeypatch.setenv("PGPASSWORD", "hidden")
    monkeypatch.setenv("PGPORT", "7000")
    found = address_of("postgresql://db.lab")
    assert (found.port, found.user, found.database, found.password, found.ssl) == (7000, "bob", "bob", "hidden", None)
    socket = address_of("postgresql:///labels?host=/run/pg&sslmode=verify-full")
    assert (socket.host, socket.ssl) == ("/run/pg", False)


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
    ("mode", "checks", "names"),
    [
        ("require", ssl.CERT_NONE, False),
        ("verify-ca", ssl.CERT_REQUIRED, False),
        ("verify-full", ssl.CERT_REQUIRED, True),
    ],
)
def test_modes_of_encryption(mode: str, checks: ssl.VerifyMode, names: bool) -> None:
    found = address_of(f"postgresql://a@b/c?sslmode={mode}").ssl
    assert isinstance(found, ssl.SSLContext)
    assert (found.verify_mode, found.check_hostname) == (checks, names)


@pytest.mark.parametrize(
    "where",
    [
        "postgresql://a@b/c?password=x",
        "postgresql://a@b/c?sslmode=maybe",
        "postgresql://a@b,c/d",
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


def test_the_password_file(tmp_path: Path) -> None:
    path = tmp_path / "pgpass"
    path.write_text("# db:5432:*:ann:no\n\nshort:1\nother:5432:*:ann:no\ndb:*:a\\:b:ann:one\\:two\\\\\n*:*:*:*:last\n")
    path.chmod(0o600)
    assert password_in_file(("db", "5432", "a:b", "ann"), path) == "one:two\\"
    assert password_in_file(("db", "5432", "c", "ann"), path) == "last"
    path.chmod(0o644)
    if os.name == "posix":
        assert password_in_file(("db", "5432", "c", "ann"), path) is None
    assert password_in_file(("db", "5432", "c", "ann"), tmp_path / "nowhere") is None


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
    with pytest.raises(InputError, match="Server refuses SSL"):
        open_journal(locked.url + "?sslmode=require")


@pytest.mark.slow
def test_a_late_refusal_of_one_user_keeps_nobody_else_out(locked: Cluster, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(postgres, "SLOW_S", -1.0)
    with pytest.raises(InputError, match="password"):
        open_journal(locked.url.replace("postgres@", "postgres:wrong@"))
    monkeypatch.setenv("PGPASSWORD", SECRET)
    with open_journal(locked.url, project="late") as journal:
        assert journal.events() == ()


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

    def lost(store: PostgresStore, link: Any) -> None:
        commit(store, link)
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


def wait_no_longer_than(seconds: float, monkeypatch: pytest.MonkeyPatch) -> None:
    """For a server's answer. A loaded machine needs long where one is to come."""
    for module, name, share in ((postgres, "SLOW_S", 0.5), (postgres, "CONNECT_S", 1.0), (postgres, "PING_S", 1.0)):
        monkeypatch.setattr(module, name, share * seconds)


@pytest.fixture
def impatient(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Nobody waits long, and nothing is known of any server."""
    pytest.importorskip("pg8000")
    wait_no_longer_than(0.1, monkeypatch)
    monkeypatch.setattr(postgres, "AGAIN_S", 0.0)
    postgres.server_at.cache_clear()
    yield
    postgres.server_at.cache_clear()


def test_a_server_that_never_answers_is_waited_for_once(impatient: None, monkeypatch: pytest.MonkeyPatch) -> None:
    tried, real = [], postgres._socket

    def counted(address: postgres.Address) -> socket.socket:
        tried.append(threading.current_thread())
        return real(address)

    monkeypatch.setattr(postgres, "_socket", counted)
    monkeypatch.setattr(postgres, "AGAIN_S", 60.0)
    with socket.create_server(("127.0.0.1", 0)) as silent:
        where = f"postgresql://ann@127.0.0.1:{silent.getsockname()[1]}/labels"
        for _ in range(3):
            with pytest.raises(InputError, match=r"cannot be opened; got cannot connect to .*timed out"):
                open_journal(where)
        assert tried == [threading.current_thread()]


def test_who_comes_while_another_waits_does_not(impatient: None, monkeypatch: pytest.MonkeyPatch) -> None:
    known, waiting, over = postgres.Server(), threading.Event(), threading.Event()

    def slow() -> None:
        waiting.set()
        over.wait(LONG_S)

    def refused() -> Any:
        raise ConnectionRefusedError

    first = threading.Thread(target=known.ask, args=(slow, refused))
    first.start()
    assert waiting.wait(LONG_S)
    time.sleep(0.06)
    with pytest.raises(TimeoutError, match="does not answer"):
        known.ask(lambda: 1, refused)
    over.set()
    first.join()
    wait_no_longer_than(LONG_S, monkeypatch)
    # It was slow, but it answered. What fails at once is asked each time.
    for _ in range(2):
        with pytest.raises(ConnectionRefusedError):
            known.ask(refused, refused)
    assert known.ask(lambda: 1, refused) == 1
    # One that left a query without an answer is asked nothing until it is found again.
    known.know(TimeoutError("timed out"))
    with pytest.raises(TimeoutError, match="timed out"):
        known.ask(lambda: 1, refused)


def test_a_server_that_falls_silent_is_left_alone_until_it_answers(
    locked: Cluster, impatient: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("PGPASSWORD", SECRET)
    wait_no_longer_than(LONG_S, monkeypatch)
    with open_journal(locked.url, project="silence") as journal:
        assert isinstance(journal.append([Edit(NAME, None, "cup")], "ann"), Saved)
        master = int((locked.folder / "data/postmaster.pid").read_text().split()[0])
        children = Path(f"/proc/{master}/task/{master}/children")
        if not children.exists():
            pytest.skip("the server's processes are not listed here")
        of_it = [master, *map(int, children.read_text().split())]
        for process in of_it:
            os.kill(process, signal.SIGSTOP)
        wait_no_longer_than(0.1, monkeypatch)
        try:
            with pytest.raises(InputError, match="cannot be read"):
                journal.events()
            with pytest.raises(NotSaved, match="cannot be reached") as error:
                journal.append([Edit(NAME, "cup", "mug", 1)], "ann")
        finally:
            for process in of_it:
                os.kill(process, signal.SIGCONT)
        wait_no_longer_than(LONG_S, monkeypatch)
        done: list[object] = []

        def saved() -> bool:
            with suppress(NotSaved):
                done.append(journal.append(error.value.edits, "ann", group=error.value.group))
            return bool(done)

        assert wait_until(saved)
        assert isinstance(done[0], Saved)
        assert [e.after for e in journal.events()] == ["cup", "mug"]
