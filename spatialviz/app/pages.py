"""The pages that are open: each has its session, which outlives a lost connection by a while."""

from __future__ import annotations

import asyncio
import sys
import threading
import time
from typing import Any

import viser
import websockets.exceptions

from pipeline.system.errors import InputError
from spatialviz.app.access import Access
from spatialviz.app.messages import read
from spatialviz.app.session import Session
from spatialviz.app.shared import Shared
from spatialviz.app.site import PAGE_ID

MAX_CLIENTS = 24
"""Pages that may be open at once."""
KEPT_SECONDS = 45.0
"""A page whose browser has gone is kept so long: it may come back."""
BURST, PER_SECOND = 200.0, 40.0
"""Messages that a page may send at once, and in the long run."""
GARBAGE = 5
"""Messages that are none, after which a socket is closed."""
LOGGED_SECONDS = 60.0


class Pages:
    """Sessions by the ids that the browsers have chosen for their pages.

    Parameters
    ----------
    shared : Shared
    access : Access
    max_clients : int
    """

    def __init__(self, shared: Shared, access: Access, max_clients: int) -> None:
        self._shared, self._access, self._most = shared, access, max_clients
        self._sessions: dict[str, Session] = {}
        self._lock = threading.Lock()
        self._logged = -LOGGED_SECONDS
        self._unsaid = 0

    def listen(self, server: viser.ViserServer) -> None:
        """Give the scenes of viser's clients to the pages whose frames they are."""
        shown: dict[int, Session] = {}

        @server.on_client_connect
        async def _(client: viser.ClientHandle) -> None:
            session = self._sessions.get(PAGE_ID.get(""))
            if session is not None:
                shown[client.client_id] = session
                session.attach(client)

        @server.on_client_disconnect
        async def _(client: viser.ClientHandle) -> None:
            session = shown.pop(client.client_id, None)
            if session is not None:
                session.detach(client)

    async def socket(self, page_id: str, connection: Any) -> None:
        """Serve the socket of a page until its browser goes away."""
        self._release()
        session = self._sessions.get(page_id)
        if session is None:
            if len(self._sessions) >= self._most:
                await connection.close(1013, f"{self._most} pages are open already (--max-clients)")
                return
            session = await asyncio.to_thread(Session, page_id, self._shared)
            with self._lock:
                session = self._sessions.setdefault(page_id, session)
        name = self._access.name(connection.request)
        if name:
            session.signed_as(name)
        sending = asyncio.create_task(session.channel.serve(connection, session.channel.attach()))
        try:
            await self._listen_to(connection, session)
        except websockets.exceptions.ConnectionClosed:
            pass
        finally:
            sending.cancel()
            await asyncio.gather(sending, return_exceptions=True)
            asyncio.get_running_loop().call_later(KEPT_SECONDS + 1, self._release)

    async def _listen_to(self, connection: Any, session: Session) -> None:
        allowed, last, garbage = BURST, time.monotonic(), 0
        async for text in connection:
            now = time.monotonic()
            allowed, last = min(BURST, allowed + PER_SECOND * (now - last)), now
            if allowed < 1:
                # Who sends faster is read more slowly; nobody else waits.
                await asyncio.sleep((1 - allowed) / PER_SECOND)
            allowed -= 1
            try:
                session.channel.receive(read(text))
            except InputError as error:
                garbage += 1
                self._log(str(error))
                if garbage >= GARBAGE:
                    await connection.close(1008, "not the messages of a page")
                    return

    def download(self, page_id: str, key: str) -> tuple[str, bytes] | None:
        """Name and content of a file that a page was told to fetch, once."""
        session = self._sessions.get(page_id)
        return None if session is None else session.page.downloads.pop(key, None)

    def _release(self) -> None:
        """Close the sessions of pages that did not come back."""
        now = time.monotonic()
        with self._lock:
            gone = [
                k for k, s in self._sessions.items() if not s.channel.connected and now - s.channel.left > KEPT_SECONDS
            ]
            for key in gone:
                self._sessions.pop(key).close()

    def _log(self, problem: str) -> None:
        """One line a minute, whatever is sent."""
        now, self._unsaid = time.monotonic(), self._unsaid + 1
        if now - self._logged >= LOGGED_SECONDS:
            more = "" if self._unsaid == 1 else f" ({self._unsaid} such messages)"
            print(f"spatialviz: a message was not understood{more}: {problem[:200]}", file=sys.stderr)
            self._logged, self._unsaid = now, 0
