"""Connections to PostgreSQL by pg8000, from a URL as libpq reads it (postgresql.org/docs/current/libpq-connect.html).

pg8000 is BSD-licensed and pure Python. What libpq does around the protocol is
done here: the environment's defaults, the password file, `sslmode`, sockets in
the file system, and a limit on how long a connection may take. Whether a server
answers is known once in a process, so that nobody waits again for one that does
not.
"""

from __future__ import annotations

import getpass
import os
import re
import socket
import ssl
import stat
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from copy import copy
from dataclasses import dataclass, field
from functools import cache, partial
from pathlib import Path
from typing import Any, TypeVar
from urllib.parse import parse_qsl, unquote

from pipeline.corrections.journal.chain import FORBIDDEN, Run, begin, made
from pipeline.system.errors import as_input_error, extra_module, needed, require

CONNECT_S = 5.0
PING_S = 3.0
"""A connection that says nothing for so long when it is taken up again is broken."""
BUSY_S = 60.0
"""How long a writer waits for its turn."""
SILENCE_S = 10.0
"""A server that has not answered a query for so long is taken to be away."""
TURN_S = 2.0
"""A writer's wait for its turn is answered by so late, and then asked for again: less than SILENCE_S."""
IDLE_S = 20.0
"""A writer that says nothing for so long loses its turn: nobody waits for one that the network has lost."""
OPTIONS = ("host", "port", "sslmode", "sslrootcert", "sslcert", "sslkey", "connect_timeout", "application_name")
SSL_MODES = ("disable", "allow", "prefer", "require", "verify-ca", "verify-full")
_SOCKETS = "/var/run/postgresql"
_GONE = ("57P", "08")
"""SQLSTATE classes of a server that shuts down or starts, and of a connection that broke."""
_LOCKED = "55P03"
"""SQLSTATE of a lock that was not given in time."""
_ADVISORY = 0x5350_4A4C
"""Key of the lock by which writers take turns: events are numbered in the order of their saving."""
KEPT = "events_before_chain"
_URL = re.compile(
    r"(?P<scheme>[\w+]+)://(?:(?P<user>[^:/@]*)(?::(?P<password>[^@]*))?@)?"
    r"(?P<place>(?:\[(?P<v6>[^/?]+)\]|(?P<host>[^/:?]+))?(?::(?P<port>\d*))?(?:/(?P<database>[^?]*))?)"
    r"(?:\?(?P<query>.*))?"
)
_FIELD = re.compile(r"((?:\\.|[^:\\])*)(?::|$)")
SLOW_S = 1.0
"""A server that fails after a longer time is not waited for again until it is known to answer."""
AGAIN_S = 2.0
"""How long after that it is asked once more, on a thread of its own."""
Answer = TypeVar("Answer")


@dataclass(frozen=True)
class Address:
    """Host (or socket folder), database and login; `ssl` as pg8000 takes it (None: where the server can)."""

    host: str
    port: int
    user: str
    database: str
    password: str | None = field(repr=False)
    ssl: ssl.SSLContext | bool | None
    connect_s: float = CONNECT_S
    application: str = "spatialviz"


class ServerError(OSError):
    """Driver error: the fields of a server's message (`state_of`), else a text."""


class PostgresStore:
    """`Store` at a URL "postgresql://..."; InputError for an unusable URL, MissingExtra without the driver."""

    server, selected, zone, writable = True, "{}::text", "+00", True

    def __init__(self, where: str) -> None:
        scheme = where.partition("://")[0]
        require(
            scheme in ("postgresql", "postgres", "postgresql+pg8000"),
            "no such kind of journal",
            got=scheme,
            expected="a path, or postgresql://...",
        )
        extra_module("pg8000", "a journal in PostgreSQL", "postgres")
        self.location = without_password(where)
        self._address = address_of(where)
        self._idle: list[Any] = []

    def settle(self) -> None:
        pass

    def _taken(self) -> Any:
        """Take an answering connection."""
        address = self._address
        with suppress(IndexError):
            link = self._idle.pop()
            try:
                server_at(address.host, address.port).ask(link.ping, lambda: _opened(address))
                return link
            except Exception:
                link.close()
                self.close()
        return _connect(address)

    @contextmanager
    def reading(self, fresh: bool = False) -> Iterator[Run]:
        link = self._taken()
        with self._given_back(link):
            self._run(link, "BEGIN ISOLATION LEVEL REPEATABLE READ READ ONLY")
            yield partial(self._run, link)
            self._commit(link)

    @contextmanager
    def writing(self) -> Iterator[Run]:
        link, until = self._taken(), time.monotonic() + BUSY_S
        with self._given_back(link):
            while not self._turn(link):
                if time.monotonic() > until:
                    raise TimeoutError("locked by another program, which goes on writing")
            yield partial(self._run, link)
            self._commit(link)

    def _turn(self, link: Any) -> bool:
        """Begin a transaction with the writers' lock; False where TURN_S passed.

        The settings are the transaction's (postgresql.org/docs/current/runtime-config-client.html), made in the same
        query, whose columns are computed from left to right.
        """
        waits = (
            f"'{name}', '{int(1000 * seconds)}'"
            for name, seconds in (("lock_timeout", TURN_S), ("idle_in_transaction_session_timeout", IDLE_S))
        )
        settings = ", ".join(f"set_config({wait}, true)" for wait in waits)
        self._run(link, "BEGIN")
        try:
            self._run(link, f"SELECT {settings}, pg_advisory_xact_lock({_ADVISORY})")
        except ServerError as error:
            if state_of(error).get("C") != _LOCKED:
                raise
            self._run(link, "ROLLBACK")
            return False
        return True

    def _run(self, link: Any, statement: str, *values: Any) -> list[Any]:
        import pg8000

        parts = statement.split("?")
        numbered = "".join(f"{part}${number}" for number, part in enumerate(parts[:-1], 1)) + parts[-1]
        try:
            return (
                link.execute_unnamed(numbered, vals=values) if values else link.execute_simple(statement)
            ).rows or []
        except pg8000.Error as error:
            raise ServerError(*error.args) from error
        except AttributeError as error:
            # The driver looks into a socket that it has let go of.
            raise ServerError("the connection is closed") from error

    def _commit(self, link: Any) -> None:
        self._run(link, "COMMIT")

    @contextmanager
    def _given_back(self, link: Any) -> Iterator[None]:
        """Return a connection at the end of the block, unless broken."""
        try:
            yield
        except BaseException as error:
            # A server that shut down, and a socket that failed, leave connections that cannot be used again.
            state = state_of(error).get("C", "")
            broken = (isinstance(error, OSError) and not state) or state.startswith(_GONE)
            try:
                if not broken:
                    self._run(link, "ROLLBACK")
            except OSError:
                broken = True
            if broken:
                link.close()
                self.close()
                raise
            self._idle.append(link)
            raise
        self._idle.append(link)

    def tables(self, run: Run) -> set[str]:
        return {name for (name,) in run("SELECT tablename FROM pg_tables WHERE schemaname = current_schema()")}

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

    def close(self) -> None:
        while self._idle:
            with suppress(IndexError):
                self._idle.pop().close()


def without_password(where: str | Path) -> str:
    """Address of a journal without secrets."""
    found = _URL.fullmatch(str(where))
    if found is None:
        return str(where).rpartition("@")[2].partition("?")[0] if "://" in str(where) else str(where)
    plain = [part for part in (found["query"] or "").split("&") if "password" not in part.partition("=")[0].lower()]
    user = "" if found["user"] is None else f"{found['user']}@"
    return f"{found['scheme']}://{user}{found['place']}{'?' if any(plain) else ''}{'&'.join(plain)}"


def address_of(where: str) -> Address:
    """Complete a URL from the environment and the password file, as libpq does; InputError for unknown options."""
    url = needed(_URL.fullmatch(where), "the journal's URL cannot be read", expected="postgresql://user@host/database")
    query = dict(parse_qsl(url["query"] or "", keep_blank_values=True))
    unknown = sorted(set(query) - set(OPTIONS))
    require(not unknown, "no such option in the journal's URL", got=", ".join(unknown), expected=" | ".join(OPTIONS))
    sockets = _SOCKETS if os.path.isdir(_SOCKETS) else "localhost"
    host = url["host"] or url["v6"] or query.get("host") or os.environ.get("PGHOST") or sockets
    require("," not in host, "a journal is in one database", got=host, expected="one host")
    port = _number("port", url["port"] or query.get("port") or os.environ.get("PGPORT") or "5432")
    user = unquote(url["user"] or "") or os.environ.get("PGUSER") or getpass.getuser()
    database = url["database"] or os.environ.get("PGDATABASE") or user
    password = unquote(url["password"] or "") or os.environ.get("PGPASSWORD")
    local = host.startswith("/")
    if password is None:
        password = password_in_file(("localhost" if local else host, str(port), database, user))
    limit = _number("connect_timeout", query["connect_timeout"]) if query.get("connect_timeout") else CONNECT_S
    mode = query.get("sslmode") or os.environ.get("PGSSLMODE") or "prefer"
    context = False if local else _ssl(mode, query)
    return Address(host, port, user, database, password, context, limit, query.get("application_name") or "spatialviz")


def password_in_file(wanted: tuple[str, str, str, str], path: Path | None = None) -> str | None:
    """Password for (host, port, database, user) in ~/.pgpass or $PGPASSFILE; None for none.

    As in libpq, a file that others may read is not used (postgresql.org/docs/current/libpq-pgpass.html).
    """
    path = path or Path(os.environ.get("PGPASSFILE") or "~/.pgpass").expanduser()
    try:
        if os.name == "posix" and path.stat().st_mode & (stat.S_IRWXG | stat.S_IRWXO):
            return None
        lines = path.read_text(encoding="utf-8").splitlines()
    except (OSError, UnicodeDecodeError):
        return None
    for raw in (_FIELD.findall(line)[:5] for line in lines if not line.startswith("#")):
        fields = [re.sub(r"\\(.)", r"\1", f) for f in raw]
        if len(raw) == 5 and all(r == "*" or f == w for r, f, w in zip(raw, fields, wanted, strict=False)):
            return fields[4]
    return None


def _number(name: str, value: str) -> int:
    require(value.isdecimal() and 0 < int(value) < 1 << 16, f"{name} in the journal's URL must be a number", got=value)
    return int(value)


def _ssl(mode: str, query: dict[str, str]) -> ssl.SSLContext | bool | None:
    require(mode in SSL_MODES, "no such sslmode", got=mode, expected=" | ".join(SSL_MODES))
    root, own = query.get("sslrootcert"), query.get("sslcert")
    if mode == "disable":
        return False
    if mode in ("allow", "prefer") and not own:
        return None
    with as_input_error("a certificate cannot be read", OSError, got=str, path=root or own):
        context = ssl.create_default_context(cafile=root)
        # With a root certificate "require" checks it, as libpq does.
        verified = mode.startswith("verify") or (mode == "require" and root is not None)
        context.check_hostname = mode == "verify-full"
        context.verify_mode = ssl.CERT_REQUIRED if verified else ssl.CERT_NONE
        if own:
            context.load_cert_chain(own, query.get("sslkey"))
    return context


def _connect(address: Address) -> Any:
    """Open a connection; any failure is a ServerError."""
    import pg8000

    opened = partial(_opened, address)
    try:
        return server_at(address.host, address.port).ask(opened, opened)
    except pg8000.Error as error:
        raise ServerError(*error.args) from error
    except Exception as error:
        message = (error.strerror if isinstance(error, OSError) else None) or str(error)
        raise ServerError(f"cannot connect to {address.host}:{address.port}: {message}") from None


def _opened(address: Address) -> Any:
    import pg8000

    class Connection(pg8000.Connection):
        def close(self) -> None:
            # One that broke says so a second time when it is let go of, and the pool would print it.
            with suppress(pg8000.Error, OSError):
                super().close()

        def limit(self, seconds: float) -> None:
            # With SSL this is another socket than the one that was given.
            if self._usock is not None:
                self._usock.settimeout(seconds)

        def ping(self) -> None:
            self.limit(PING_S)
            self.execute_simple("SELECT 1")
            self.limit(SILENCE_S)

    link = _socket(address)
    try:
        # Where a password is asked for and there is none, the driver fails in its own code: "" is refused instead.
        opened = Connection(
            address.user,
            host=address.host,
            database=address.database,
            port=address.port,
            password=address.password or "",
            ssl_context=address.ssl,
            application_name=address.application,
            sock=link,
        )
        opened.limit(SILENCE_S)
        return opened
    except BaseException:
        link.close()
        raise


def _socket(address: Address) -> socket.socket:
    if address.host.startswith("/"):
        link = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        link.settimeout(address.connect_s)
        try:
            link.connect(f"{address.host}/.s.PGSQL.{address.port}")
        except OSError:
            link.close()
            raise
    else:
        link = socket.create_connection((address.host, address.port), address.connect_s)
        link.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
        link.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    return link


def state_of(error: BaseException | None) -> dict[str, str]:
    """Fields of a server's message (postgresql.org/docs/current/protocol-error-fields.html); empty for other errors."""
    message = error.args[0] if error is not None and error.args else None
    return message if isinstance(message, dict) else {}


def has_answered(error: Exception) -> bool:
    """True for an error from a present server, such as a wrong password."""
    code = state_of(error).get("C", "")
    return bool(code) and not code.startswith(_GONE)


class Server:
    """Reachability of one server, shared by the threads of a process.

    While it is away `ask` fails at once, and a thread looks for it.
    """

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._asked: list[float] = []
        self._away: Exception | None = None
        self._again = 0.0
        """When it may be looked for."""

    def ask(self, question: Callable[[], Answer], connect: Callable[[], Any]) -> Answer:
        """Return the answer of `question`, or raise the error; TimeoutError while another thread waits.

        `connect` makes a connection, to find out whether the server is back.
        """
        began = time.monotonic()
        with self._lock:
            if self._away is not None:
                if began >= self._again:
                    self._again = float("inf")
                    threading.Thread(target=self._look, args=(connect,), daemon=True, name="journal-server").start()
                raise copy(self._away)
            if self._asked and began - self._asked[0] > SLOW_S:
                raise TimeoutError("it does not answer")
            self._asked.append(began)
        try:
            return question()
        except Exception as error:
            if time.monotonic() - began > SLOW_S and not has_answered(error):
                self.know(error)
            raise
        finally:
            with self._lock:
                self._asked.remove(began)

    def _look(self, connect: Callable[[], Any]) -> None:
        try:
            link = connect()
        except Exception as error:
            return self.know(None if has_answered(error) else error)
        self.know(None)
        with suppress(Exception):
            link.close()

    def know(self, away: Exception | None) -> None:
        """Note an answering or absent server."""
        with self._lock:
            self._away, self._again = away, time.monotonic() + AGAIN_S


@cache
def server_at(host: str, port: int) -> Server:
    """Reachability of the server at an address."""
    return Server()
