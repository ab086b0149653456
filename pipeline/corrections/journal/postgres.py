"""Journals in PostgreSQL by psycopg: URLs, logins and certificates as libpq reads them.

psycopg is under LGPL-3 (extra: postgres). A server that does not answer is asked again after a while, so that nobody
waits for it at each click.
"""

from __future__ import annotations

import re
import socket
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from threading import Timer
from typing import Any

from pipeline.corrections.journal.chain import FORBIDDEN, Run, Store, begin, made
from pipeline.system.errors import InputError, extra_module, require

CONNECT_S = 3
PING_S = 2.0
"""A connection that says nothing for so long when it is taken up again is broken."""
BUSY_S = 60.0
"""How long a writer waits for its turn."""
IDLE_S = 20.0
"""A writer that says nothing for so long loses its turn: nobody waits for one that the network has lost."""
AGAIN_S = 10.0
"""How long a server that did not answer is not asked again."""
KEPT = "events_before_chain"
_ADVISORY = 0x5350_4A4C
"""Key of the lock by which writers take turns: events are numbered in the order of their saving."""
_DEFAULTS = {
    "connect_timeout": CONNECT_S,
    "fallback_application_name": "spatialviz",
    # A peer that the network has lost is noticed (postgresql.org/docs/current/libpq-connect.html).
    "keepalives_idle": 10,
    "keepalives_interval": 5,
    "keepalives_count": 3,
    "tcp_user_timeout": 10_000,
}
_PASSWORD = re.compile(r"(?<=://)([^:/@]*):.*@")
_SECRETS = re.compile(r"(?<=[?&])[^&=]*password[^&]*&?", re.IGNORECASE)
_away: dict[str, float] = {}
"""Servers that did not answer, by location, until when they are not asked."""


class ServerError(OSError):
    """Error of a server or on the way to it, with its SQLSTATE where it has one."""

    def __init__(self, error: Exception) -> None:
        super().__init__(str(error).rpartition("FATAL:  ")[2])
        self.state: str = getattr(error, "sqlstate", None) or ""


class PostgresStore(Store):
    """`Store` at a URL "postgresql://..."; InputError for an unusable URL, MissingExtra without the driver."""

    server, selected, zone = True, "{}::text", "+00"
    table_names = "SELECT tablename FROM pg_tables WHERE schemaname = current_schema()"

    def __init__(self, where: str) -> None:
        scheme = where.partition("://")[0]
        known = scheme in ("postgresql", "postgres")
        require(known, "no such kind of journal", got=scheme, expected="a path, or postgresql://...")
        self._driver = extra_module("psycopg", "a journal in PostgreSQL", "postgres")
        super().__init__(without_password(where))
        try:
            self._login = {**_DEFAULTS, **self._driver.conninfo.conninfo_to_dict(where)}
        except self._driver.Error:
            # The driver's message may hold the password.
            raise InputError("the journal's URL cannot be read", expected="postgresql://user@host/database") from None

    def _taken(self) -> Any:
        """Take an answering connection."""
        with suppress(IndexError):
            while True:
                link = self._idle.pop()
                silent = Timer(PING_S, _cut, [link])
                silent.start()
                try:
                    self._run(link, "SELECT 1")
                    return link
                except self._driver.Error:
                    link.close()
                finally:
                    silent.cancel()
        if time.monotonic() < _away.get(self.location, 0.0):
            raise TimeoutError("cannot connect: the server does not answer")
        try:
            return self._driver.connect(**self._login, autocommit=True, prepare_threshold=None)
        except self._driver.errors.ConnectionTimeout:
            _away[self.location] = time.monotonic() + AGAIN_S
            raise

    @contextmanager
    def _transaction(self, write: bool, fresh: bool = False) -> Iterator[Run]:
        try:
            with super()._transaction(write, fresh) as run:
                yield run
        except self._driver.Error as error:
            raise ServerError(error) from error

    def _begin(self, link: Any, write: bool, fresh: bool) -> None:
        if not write:
            self._run(link, "BEGIN ISOLATION LEVEL REPEATABLE READ READ ONLY")
            return
        # The settings are the transaction's (postgresql.org/docs/current/runtime-config-client.html).
        self._run(link, "BEGIN")
        self._run(link, f"SET LOCAL lock_timeout = {int(1000 * BUSY_S)}")
        self._run(link, f"SET LOCAL idle_in_transaction_session_timeout = {int(1000 * IDLE_S)}")
        self._run(link, f"SELECT pg_advisory_xact_lock({_ADVISORY})")

    def _run(self, link: Any, statement: str, *values: Any) -> list[Any]:
        return super()._run(link, statement.replace("?", "%s"), *values)

    def _usable(self, link: Any) -> bool:
        return not link.closed

    def create(self, run: Run, first: str) -> None:
        for statement in made("BIGINT", "TIMESTAMP WITH TIME ZONE"):
            run(statement)
        refused = f"$$ BEGIN RAISE EXCEPTION '{FORBIDDEN}'; END $$"
        run(f"CREATE OR REPLACE FUNCTION refuse_change() RETURNS trigger LANGUAGE plpgsql AS {refused}")
        run(
            "CREATE TRIGGER events_only_grow BEFORE UPDATE OR DELETE OR TRUNCATE ON events "
            "FOR EACH STATEMENT EXECUTE FUNCTION refuse_change()"
        )
        begin(run, first)

    def keep(self, run: Run) -> str:
        run(f"CREATE TABLE IF NOT EXISTS {KEPT} AS TABLE events")
        return KEPT


def _cut(link: Any) -> None:
    """End a connection under a thread that waits for it."""
    with suppress(OSError, ValueError), socket.socket(fileno=link.fileno()) as shared:
        shared.shutdown(socket.SHUT_RDWR)
        shared.detach()


def without_password(where: str | Path) -> str:
    """Address of a journal without secrets."""
    text = str(where)
    return _SECRETS.sub("", _PASSWORD.sub(r"\1@", text)).rstrip("?&") if "://" in text else text
