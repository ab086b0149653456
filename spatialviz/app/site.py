"""HTTP server: the page at `/`, viser's client as its frame; and the open pages, each with a session, kept for a while
after a lost connection."""

from __future__ import annotations

import asyncio
import gzip
import http
import re
import time
from collections import OrderedDict
from collections.abc import Awaitable, Callable
from concurrent.futures import Future
from contextvars import ContextVar
from functools import cached_property
from importlib import resources
from pathlib import Path
from typing import TYPE_CHECKING, Any
from urllib.parse import SplitResult, parse_qs, quote, urlsplit

import viser
import websockets.exceptions
from websockets.http11 import Request, Response

from pipeline.language.counted import counted
from pipeline.system.errors import InputError, require
from pipeline.system.freed_memory import collect
from spatialviz.app.access import KINDS, Access, response
from spatialviz.app.channel import Hello, read
from spatialviz.app.kept_pictures import IMAGES
from spatialviz.app.viser_socket import SceneConnection, scene_page, subprotocol
from spatialviz.options import warn

if TYPE_CHECKING:
    from spatialviz.app.context import Shared
    from spatialviz.app.session import PageSession

PAGE_ID: ContextVar[str] = ContextVar("page_id")
"""Page of viser's socket during the handling of its connection."""
ID = re.compile(r"[0-9a-f]{32}")
REFUSED_SECONDS, MOST_WAITING = 1.0, 100
SCENE_POLICY = (
    "default-src 'none'; script-src 'self' 'unsafe-inline' 'wasm-unsafe-eval' blob:; worker-src blob:; "
    "style-src 'self' 'unsafe-inline'; img-src 'self' data: blob:; font-src data:; connect-src 'self' data: blob:; "
    "base-uri 'none'; form-action 'none'; frame-ancestors 'self'"
)
"""Content policy for viser's client: inline script and styles, blob workers."""
SCENE_STYLE = (
    "<style>#root :has(canvas) ~ :not(:has(canvas), canvas), .mantine-Notifications-root, body > [data-portal] "
    "{ display: none !important } :root { color-scheme: light !important } "
    ":root, body, #root, #root :has(canvas) { background: none !important }</style>"
)
"""Hides viser's panels in favour of the page's own; the page's ground shows through from the first byte. A frame of
another colour scheme than its element's would be opaque."""


MAX_CLIENTS = 24
"""Open pages, at most."""
KEPT_SECONDS = 45.0
"""Time to keep a disconnected page for a return."""
BURST, PER_SECOND = 200.0, 40.0
"""Messages of a page: burst, and per second."""
BACKLOG, BEHIND_SECONDS = 40, 0.05
"""Queued jobs pausing the reading of a page."""
FORGOTTEN_SECONDS = 2.0
"""Delay before freeing a closed page's memory."""
HELLO_SECONDS = 10.0
CAMERAS, CAMERAS_PER_SECOND = 400.0, 100.0
"""Messages of a scene: burst, and per second."""
GARBAGE = 5
"""Invalid messages closing a socket."""
SOCKETS, SOCKETS_PER_SECOND = 20.0, 1.0
"""Sockets of a page, with the scene's: burst, and per second."""
NEW_BURST, NEW_PER_SECOND = 20.0, 0.5
"""Pages that an address may open at once, beside as many as there may be, and in the long run: each costs what opening
a frame costs."""
GARBAGE_COSTS = 50.0
"""Cost of a socket closed for invalid messages, in sockets."""
REMEMBERED = 1000
SENT_WRONG = (1002, 1003, 1007, 1008, 1009)
"""Close codes for invalid messages."""
LOGGED_SECONDS = 60.0


class Pace:
    """Rate limit of a socket: fast senders wait, other people do not."""

    def __init__(self, burst: float = BURST, per_second: float = PER_SECOND) -> None:
        self._burst, self._per_second = burst, per_second
        self._allowed, self._last = burst, time.monotonic()

    @property
    def wait(self) -> float:
        """Seconds until the next message is allowed."""
        now = time.monotonic()
        self._allowed, self._last = min(self._burst, self._allowed + self._per_second * (now - self._last)), now
        return max(0.0, (1 - self._allowed) / self._per_second)

    def take(self, cost: float = 1.0) -> None:
        """Count a message, or the cost of several."""
        self._allowed -= cost

    async def keep(self) -> None:
        """Wait until the next message is allowed."""
        if (wait := self.wait) > 0:
            await asyncio.sleep(wait)
        self.take()


class Gate:
    """Rate limits on opening sockets; senders of invalid messages are blocked for a while.

    Open pages have a limit each, new pages a limit by address: garbage under ever new page names delays only new pages
    of that address.
    """

    def __init__(self, most_pages: int) -> None:
        self._burst = NEW_BURST + most_pages
        self._paces: OrderedDict[str, Pace] = OrderedDict()

    def opens(self, sender: str, page_id: str) -> bool:
        """True if a socket may be opened now; `page_id` is of an open page, or ""."""
        pace = self._pace(page_id or sender, not page_id)
        if pace.wait > 0:
            return False
        pace.take()
        return True

    def charge(self, page_id: str) -> None:
        """Penalize a page after an invalid message."""
        self._pace(page_id, False).take(GARBAGE_COSTS)

    def _pace(self, who: str, is_new: bool) -> Pace:
        made = (self._burst, NEW_PER_SECOND) if is_new else (SOCKETS, SOCKETS_PER_SECOND)
        pace = self._paces.get(who) or Pace(*made)
        self._paces[who] = pace
        self._paces.move_to_end(who)
        while len(self._paces) > REMEMBERED:
            self._paces.popitem(last=False)
        return pace


def new_session(page_id: str, shared: Shared) -> PageSession:
    """Session of a page. What pages are made of is a third of the program: a server listens before it is loaded."""
    from spatialviz.app.session import PageSession

    return PageSession(page_id, shared)


class Pages:
    """Sessions by the page ids chosen by the browsers."""

    def __init__(self, shared: Future[Shared], access: Access, max_clients: int) -> None:
        self._shared, self._access, self._most = shared, access, max_clients
        self._sessions: dict[str, PageSession] = {}
        self._scenes: dict[str, Any] = {}
        self._making = asyncio.Lock()
        self._gate = Gate(max_clients)
        self._logged = -LOGGED_SECONDS
        self._unsaid = 0

    async def shared(self) -> Shared:
        """What the pages show, once it is known."""
        return await asyncio.shield(asyncio.wrap_future(self._shared))

    def listen(self, server: viser.ViserServer) -> None:
        """Attach the scenes of viser's clients to the pages."""
        shown: dict[int, PageSession] = {}

        @server.on_client_connect
        async def _(client: viser.ClientHandle) -> None:
            session = self._sessions.get(PAGE_ID.get(""))
            if session is not None:
                shown[client.client_id] = session
                session.ctx.post(lambda: session.ctx.client.attach(client))

        @server.on_client_disconnect
        async def _(client: viser.ClientHandle) -> None:
            session = shown.pop(client.client_id, None)
            if session is not None:
                session.ctx.post(lambda: session.ctx.client.detach(client))

    async def scene(self, page_id: str, connection: Any, viser_handler: Callable[[Any], Awaitable[None]]) -> None:
        """Serve viser's socket of a page's scene; a later socket takes over."""
        before, self._scenes[page_id] = self._scenes.get(page_id), connection
        if before is not None:
            await before.close(1013, "shown elsewhere")
        # Failures in viser's own tasks are logged as briefly.
        asyncio.get_running_loop().set_exception_handler(
            lambda _, context: self.log(repr(context.get("exception") or context["message"]))
        )
        try:
            spoken = subprotocol()
            require(connection.subprotocol == spoken, "no scene", got=connection.subprotocol, expected=spoken)
            await viser_handler(SceneConnection(connection, Pace(CAMERAS, CAMERAS_PER_SECOND).keep))
        except Exception as error:
            # Messages unreadable by viser cost the sender the socket.
            self.log(f"{type(error).__name__}: {error}")
            await connection.close(1008, "not the messages of a scene")
        finally:
            if self._scenes.get(page_id) is connection:
                del self._scenes[page_id]

    def has(self, page_id: str) -> bool:
        """True for an open page, or a session kept for a return."""
        return page_id in self._sessions

    def opens(self, page_id: str, connection: Any, request: Any) -> bool:
        """True if a socket of a page may be opened now."""
        address = connection.remote_address
        sender = f"{address[0] if address else ''} {self._access.name(request) or ''}"
        return self._gate.opens(sender, page_id if self.has(page_id) else "")

    def closed(self, page_id: str, connection: Any) -> None:
        """Handle a closed socket; invalid messages delay the sender's next socket."""
        sent = connection.protocol.close_sent
        if sent is not None and sent.code in SENT_WRONG:
            self.log(sent.reason or f"closed by {sent.code}")
            self._gate.charge(page_id)

    async def socket(self, page_id: str, connection: Any) -> None:
        """Serve the socket of a page until the browser disconnects."""
        try:
            # Without a first message no page is taken.
            first = read(await asyncio.wait_for(connection.recv(), HELLO_SECONDS))
            require(isinstance(first, Hello), "a page says hello first", got=first.type)
        except (InputError, asyncio.TimeoutError, websockets.exceptions.ConnectionClosed) as error:
            self.log(str(error) or "nothing was said")
            await connection.close(1008, "not a page")
            return
        session = self._sessions.get(page_id) or await self._opened(page_id, connection)
        if session is None:
            return
        outgoing = session.ctx.channel.attach(connection)
        name = self._access.name(connection.request)
        if name:
            # The token's name is the only author of this browser's corrections.
            session.ctx.post(lambda: session.ctx.editors.sign_for_token(name))
        session.ctx.channel.receive(first)
        sending = asyncio.create_task(session.ctx.channel.serve(connection, outgoing))
        try:
            await self._listen_to(connection, session)
        except websockets.exceptions.ConnectionClosed:
            pass
        finally:
            session.ctx.channel.detach(outgoing)
            sending.cancel()
            await asyncio.gather(sending, return_exceptions=True)
            asyncio.get_running_loop().call_later(KEPT_SECONDS + 1, self._release)

    async def _opened(self, page_id: str, connection: Any) -> PageSession | None:
        """Session of a new page; None for a full server or a disconnected browser."""
        async with self._making:
            if page_id in self._sessions:
                return self._sessions[page_id]
            self._release(full=len(self._sessions) >= self._most)
            if len(self._sessions) >= self._most:
                many = f"The server is full: {counted(self._most, 'page')} at most (--max-clients)."
                await connection.close(1013, f"{many} Close another one; this one tries again.")
                return None
            if connection.close_code is not None:
                return None
            session = self._sessions[page_id] = await asyncio.to_thread(new_session, page_id, await self.shared())
            return session

    async def _listen_to(self, connection: Any, session: PageSession) -> None:
        pace, garbage = Pace(), 0
        async for text in connection:
            await pace.keep()
            while session.ctx.channel.behind > BACKLOG:
                # Unread messages wait at the sender.
                await asyncio.sleep(BEHIND_SECONDS)
            try:
                message = read(text)
                require(not isinstance(message, Hello), "a page says hello once")
                session.ctx.channel.receive(message)
            except InputError as error:
                garbage += 1
                self.log(str(error))
                if garbage >= GARBAGE:
                    await connection.close(1008, "not the messages of a page")
                    return

    def download(self, page_id: str, key: str) -> tuple[str, bytes] | None:
        """Name and content of a page's pending download, once."""
        session = self._sessions.get(page_id)
        return None if session is None else session.ctx.page.downloads.pop(key, None)

    def _release(self, full: bool = False) -> None:
        """Close the sessions of lost pages; at a full server, also the session lost first."""
        gone = sorted((s.ctx.channel.left, key) for key, s in self._sessions.items() if not s.ctx.channel.connected)
        late = time.monotonic() - KEPT_SECONDS
        over = [key for number, (left, key) in enumerate(gone) if left < late or (full and not number)]
        for key in over:
            self._sessions.pop(key).close()
        if over:
            if not self._sessions:
                self._shared.result().store.let_go()
                IMAGES.let_go()
            loop = asyncio.get_running_loop()
            loop.call_later(FORGOTTEN_SECONDS, loop.run_in_executor, None, collect)

    def log(self, problem: str) -> None:
        """Print a problem, at most a line a minute."""
        now, self._unsaid = time.monotonic(), self._unsaid + 1
        if now - self._logged >= LOGGED_SECONDS:
            more = "" if self._unsaid == 1 else f" ({self._unsaid} such messages)"
            warn(f"a message was not understood{more}: {problem[:200]}")
            self._logged, self._unsaid = now, 0


class Site:
    """Answers every request of a server."""

    def __init__(self, access: Access, pages: Pages, dark: bool | None) -> None:
        self._access, self._pages = access, pages
        self._waiting = 0
        static = resources.files("spatialviz.app") / "static"
        self._files = {f.name: f.read_bytes() for f in static.iterdir() if Path(f.name).suffix in KINDS}
        if dark is not None:
            given = b"dark" if dark else b"light"
            self._files["index.html"] = self._files["index.html"].replace(b'data-given=""', b'data-given="%s"' % given)
        self._scene_page = scene_page().replace("</title>", "</title>" + SCENE_STYLE, 1).encode()

    @cached_property
    def _scene(self) -> bytes:
        """Page of viser's client, compressed when it is first asked for."""
        return gzip.compress(self._scene_page, 6)

    def inside(self, target: str) -> str:
        return self._access.inside(target)

    async def answer(self, connection: Any, request: Request) -> Response | None:
        refused = self._access.refusal(request)
        if refused is not None:
            return refused
        parts = urlsplit(request.path)
        if request.headers.get("Upgrade", "").lower() == "websocket":
            page_id = self._page_of(parts)
            if not page_id:
                return response(http.HTTPStatus.NOT_FOUND, b"no such socket\n")
            return None if self._pages.opens(page_id, connection, request) else await self._later()
        entered = self._access.entered(request)
        if entered is not None:
            return entered
        if parts.path.startswith("/app/frame/"):
            picture = await (await self._pages.shared()).pictures.get(parts.path)
            if picture is None:
                return response(http.HTTPStatus.NOT_FOUND, b"no such picture\n")
            return response(http.HTTPStatus.OK, picture, ".jpg", {"Cache-Control": "private, max-age=600"})
        return self._file(parts.path, parse_qs(parts.query))

    def _page_of(self, parts: SplitResult) -> str:
        """Page of a socket; "" for none."""
        if parts.path != "/app/socket":
            return _scene_of(parts.path) if self._pages.has(_scene_of(parts.path)) else ""
        page_id = parse_qs(parts.query).get("id", [""])[0]
        return page_id if ID.fullmatch(page_id) else ""

    async def _later(self) -> Response:
        """Delayed refusal: repeated attempts wait, while few are waiting."""
        if self._waiting < MOST_WAITING:
            self._waiting += 1
            try:
                await asyncio.sleep(REFUSED_SECONDS)
            finally:
                self._waiting -= 1
        return response(http.HTTPStatus.TOO_MANY_REQUESTS, b"too many sockets, or not the messages of a page\n")

    def _file(self, path: str, query: dict[str, list[str]]) -> Response:
        folder, _, name = path.rpartition("/")
        data, kind, more = None, Path(name).suffix, dict[str, str]()
        match folder:
            case "" if not name:
                data, kind = self._files["index.html"], ".html"
            case "/app":
                data = self._files.get(name)
            case "/app/image":
                data, more = IMAGES.get(name), {"Cache-Control": "private, max-age=86400, immutable"}
            case "/app/file":
                given, data = self._pages.download(query.get("id", [""])[0], name) or ("", None)
                kind, more = "", {"Content-Disposition": f"attachment; filename*=UTF-8''{quote(given)}"}
            case _ if folder.startswith("/scene/") and not name and ID.fullmatch(_scene_of(folder)):
                data, kind = self._scene, ".html"
                more = {"Content-Security-Policy": SCENE_POLICY, "Content-Encoding": "gzip"}
        if data is None:
            return response(http.HTTPStatus.NOT_FOUND, b"not found\n")
        return response(http.HTTPStatus.OK, data, kind, more)

    async def socket(self, connection: Any, viser_handler: Callable[[Any], Awaitable[None]]) -> None:
        """Serve an open socket: the page's own, or viser's of its scene."""
        parts = urlsplit(connection.request.path)
        page_id = self._page_of(parts)
        try:
            if parts.path == "/app/socket":
                await self._pages.socket(page_id, connection)
            elif page_id:
                PAGE_ID.set(page_id)
                await self._pages.scene(page_id, connection, viser_handler)
        finally:
            self._pages.closed(page_id, connection)

    def log(self, problem: str) -> None:
        self._pages.log(problem)


def _scene_of(path: str) -> str:
    return path.removeprefix("/scene/").rstrip("/")
