"""HTTP requests, many at once: the server's reply, or why there is none and whether asking again may help.

`urllib` is enough: an answer takes seconds, so that a connection kept open would save nothing.
"""

from __future__ import annotations

import http.client
import ipaddress
import queue
import re
import socket
import ssl
import threading
import urllib.error
import urllib.request
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from email.utils import parsedate_to_datetime
from time import monotonic
from typing import Any, TypeVar
from urllib.parse import urlsplit

from pipeline.system.errors import InputError, require

MAX_BYTES = 16 << 20
"""No answer to a question is longer."""

_CHUNK = 1 << 16


class Failure(Exception):
    """A request that brought no answer.

    Attributes
    ----------
    what : str
        What happened, in a short clause.
    status : int or None
        HTTP status; None where there was no reply.
    detail : str or None
        The server's own words, one line.
    cause : str or None
        The likely cause, phrased as help.
    again : bool
        Whether the same request may do better.
    wait_s : float or None
        How long the server asks to wait before it.
    everywhere : bool
        Whether every other question would fail in the same way.
    """

    def __init__(
        self,
        what: str,
        *,
        status: int | None = None,
        detail: str | None = None,
        cause: str | None = None,
        again: bool = False,
        wait_s: float | None = None,
        everywhere: bool = False,
    ) -> None:
        super().__init__(what)
        self.what, self.status, self.detail, self.cause = what, status, detail, cause
        self.again, self.wait_s, self.everywhere = again, wait_s, everywhere


@dataclass(frozen=True)
class Reply:
    """What a server sent back.

    Attributes
    ----------
    status : int
    headers : dict of str to str
        Names in lower case.
    body : bytes
    """

    status: int
    headers: dict[str, str]
    body: bytes


def checked_base(url: str) -> str:
    """The base address of a server, without a slash or `/chat/completions` at its end.

    Raises
    ------
    InputError
        It is no http address, or carries a user name or a query.
    """
    expected = "an address such as http://localhost:8000/v1"
    try:
        parts = urlsplit(url.strip())
        host, _ = parts.hostname, parts.port
    except ValueError as error:
        raise InputError("the address of the server cannot be read", got=error, expected=expected) from None
    require(
        parts.scheme in ("http", "https") and host and not re.search(r"[\s\x00-\x1f\x7f]", url.strip()),
        "the address of the server cannot be used",
        got=repr(url)[:120],
        expected=expected,
    )
    require("@" not in parts.netloc, "a key does not belong into the address of the server", expected=expected)
    require(
        not parts.query and not parts.fragment,
        "the address of the server ends too late",
        got=repr(url)[:120],
        expected=expected,
    )
    path = parts.path.rstrip("/").removesuffix("/chat/completions").rstrip("/")
    return f"{parts.scheme}://{parts.netloc}{path}"


class _NoRedirect(urllib.request.HTTPRedirectHandler):
    """A redirect would turn the question into a GET, and carry the key to another host."""

    def redirect_request(self, req: Any, fp: Any, code: Any, msg: Any, headers: Any, newurl: Any) -> None:
        return None


def send(url: str, body: bytes | None, headers: Mapping[str, str], timeout_s: float) -> Reply:
    """Make one request: POST where there is a body, else GET.

    Parameters
    ----------
    timeout_s : float
        Seconds without a byte; a reply that trickles in is cut off after as many.

    Raises
    ------
    Failure
        There is no whole reply. A reply of any status is a reply.
    """
    handlers: list[urllib.request.BaseHandler] = [_NoRedirect()]
    if _is_here(urlsplit(url).hostname or ""):
        # Proxies of the environment are for other machines; a server on this one is not behind them.
        handlers.append(urllib.request.ProxyHandler({}))
    opener = urllib.request.build_opener(*handlers)
    request = urllib.request.Request(url, data=body, headers=dict(headers))
    deadline = monotonic() + timeout_s
    try:
        try:
            response = opener.open(request, timeout=timeout_s)
        except urllib.error.HTTPError as error:
            response = error
        with response:
            found = {name.lower(): value for name, value in response.headers.items()}
            return Reply(int(response.status or 0), found, _read(response, found, deadline, timeout_s))
    except Failure:
        raise
    except (OSError, http.client.HTTPException) as error:
        raise _failure(error, timeout_s) from error


def _read(response: Any, headers: Mapping[str, str], deadline: float, timeout_s: float) -> bytes:
    parts: list[bytes] = []
    size = 0
    while part := response.read1(_CHUNK):
        parts.append(part)
        size += len(part)
        if size > MAX_BYTES:
            raise Failure("the reply does not end", detail=f"more than {MAX_BYTES >> 20} MB", everywhere=True)
        if monotonic() > deadline:
            raise _late(timeout_s)
    length = headers.get("content-length", "")
    # `read1` takes an early end of the stream for the end of the reply.
    if length.isdecimal() and "transfer-encoding" not in headers and size < int(length):
        raise Failure("the connection was closed midway", detail=f"{size} of {length} bytes came", again=True)
    return b"".join(parts)


def _failure(error: BaseException, timeout_s: float) -> Failure:
    reason = getattr(error, "reason", None)
    inner = reason if isinstance(error, urllib.error.URLError) and isinstance(reason, BaseException) else error
    text = " ".join(str(inner).split())[:200] or type(inner).__name__
    closed = (http.client.RemoteDisconnected, http.client.IncompleteRead, ConnectionError)
    kinds: tuple[tuple[type | tuple[type, ...], Failure], ...] = (
        (TimeoutError, _late(timeout_s)),
        (
            ConnectionRefusedError,
            Failure("no server listens there", cause="is it running, on this port?", again=True, everywhere=True),
        ),
        (socket.gaierror, Failure("the host is not known", detail=text, everywhere=True)),
        (
            ssl.SSLCertVerificationError,
            Failure("the server's certificate is not trusted", detail=text, everywhere=True),
        ),
        (ssl.SSLError, Failure("no secure connection", detail=text, cause="is it http, not https?", everywhere=True)),
        (closed, Failure("the connection was closed midway", again=True)),
        (
            http.client.HTTPException,
            Failure("what answers there speaks no HTTP", detail=type(inner).__name__, everywhere=True),
        ),
        (BaseException, Failure("the connection failed", detail=text, again=True)),
    )
    return next(failure for kind, failure in kinds if isinstance(inner, kind))


def _late(timeout_s: float) -> Failure:
    return Failure(f"no whole reply within {timeout_s:g} s", cause="a longer timeout may help", again=True)


def _is_here(host: str) -> bool:
    if host == "localhost" or host.endswith(".localhost"):
        return True
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False


def wait_asked(headers: Mapping[str, str]) -> float | None:
    """Seconds of a Retry-After header (RFC 9110, 10.2.3), a number or a date; None without a readable one."""
    value = headers.get("retry-after", "").strip()
    if re.fullmatch(r"\d{1,9}(\.\d*)?", value):
        return float(value)
    try:
        # Both by the server's clock, which may not be ours.
        return max((parsedate_to_datetime(value) - parsedate_to_datetime(headers["date"])).total_seconds(), 0.0)
    except (ValueError, TypeError, KeyError):
        return None


Item = TypeVar("Item")
Result = TypeVar("Result")


def map_ordered(
    function: Callable[[Item, threading.Event], Result],
    items: Iterable[Item],
    workers: int,
    done: Callable[[int], None] = lambda _: None,
) -> list[Result]:
    """function(item, stop) of every item, in the order of the items.

    The threads are daemons, which the interpreter does not wait for when it ends: those of `concurrent.futures` would
    hold Ctrl-C up until the last answer comes.

    Parameters
    ----------
    function : callable
        Its second argument is set once nobody waits for results any more.
    items : iterable
        Taken one by one as workers come free, by one thread at a time.
    done : callable
        Called in the calling thread with the number of results so far.

    Raises
    ------
    Exception
        The first that a function, or the iteration, raises; what is not begun by then is not begun.
    """
    source, lock, stop = enumerate(items), threading.Lock(), threading.Event()
    results: queue.SimpleQueue[tuple[int, Result] | BaseException | None] = queue.SimpleQueue()

    def work() -> None:
        try:
            while not stop.is_set():
                with lock:
                    index, item = next(source, (-1, None))
                if index < 0:
                    break
                results.put((index, function(item, stop)))  # type: ignore[arg-type]
        except BaseException as error:
            results.put(error)
        else:
            results.put(None)

    found: dict[int, Result] = {}
    running = workers
    try:
        for _ in range(workers):
            threading.Thread(target=work, daemon=True).start()
        while running:
            try:
                # A wait without an end cannot be interrupted everywhere.
                result = results.get(timeout=0.5)
            except queue.Empty:
                continue
            if result is None:
                running -= 1
            elif isinstance(result, BaseException):
                raise result
            else:
                found[result[0]] = result[1]
                done(len(found))
    finally:
        stop.set()
    return [found[index] for index in range(len(found))]
