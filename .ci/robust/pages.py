"""Faults of the page's server, by its own protocol: kills, clients that do not read, strangers, many at once, idle."""

from __future__ import annotations

import asyncio
import contextlib
import json
import multiprocessing
import random
import shutil
import socket
import subprocess
import threading
import time
import urllib.error
import urllib.request
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

import load_page
from disturbed import SECONDS, changing, jumping, moved_clock
from promises import Kind, promise
from servers import Server
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import connect
from world import FRAME, World

from spatialviz.bench_page import Client

ANSWERED = 60.0
BACK_WITHIN = 0.2
"""Share of its memory at the start by which a server may be larger after its clients have gone."""
FORGOTTEN, PATIENCE = 55.0, 120.0
"""Seconds after which a page that has gone is forgotten, and in which memory is given back."""


@contextlib.contextmanager
def served(*words: object, env: dict[str, str] | None = None) -> Iterator[Server]:
    """A server that must end quietly, unless it was killed."""
    # Where faults are looked for, the program lets libraries print what it keeps back else.
    with Server(*words, env={"PYTHONFAULTHANDLER": "", **(env or {})}) as server:
        yield server
        killed = server.process.poll() is not None
        said = [] if killed else server.end()
    odd = [line for line in said if not line.startswith(("spatialviz:", "(viser) Server stopped", "  "))]
    promise(not odd, "the server says nothing but its own plain lines", odd[:5])


CLASSES = ("vase", "book", "mug")


async def _edit(port: int, acknowledged: list[str]) -> None:
    """Rename objects one after the other; a name is acknowledged when the page says that it is saved."""
    client = Client(port)
    with contextlib.suppress(ConnectionClosed, OSError):
        await client.open(scene=False)
        for command in ("task:label", f"open:{FRAME}"):
            await client.act(command)
        for number in range(10_000):
            client.toasts.clear()
            await client.act(f"object:{number % 6}")
            answered = await client.act(f"class:{CLASSES[number // 6 % 3]}")
            acknowledged += [
                t["text"].rpartition("→ ")[2].partition(" · ")[0] for t in client.toasts if t["title"] == "Saved"
            ]
            if answered is None or client.page.state.name != "OPEN":
                return


def killed_edits(world: World, rng: random.Random, kind: Kind) -> None:
    """Kill the server while a page edits: acknowledged edits are in the journal, in order; the next server goes on."""
    labels = world.labels_of_its_own()
    acknowledged: list[str] = []
    words = (world.dataset, "--labels", labels, "--author", "ann")
    with served(*words) as server:

        def kill() -> None:
            until = time.monotonic() + ANSWERED
            while not acknowledged and time.monotonic() < until:
                time.sleep(0.01)
            time.sleep(rng.uniform(0.0, 1.5))
            server.process.kill()

        killer = threading.Thread(target=kill)
        killer.start()
        asyncio.run(asyncio.wait_for(_edit(server.port, acknowledged), 3 * ANSWERED))
        killer.join()
    kind.times += 1
    kind.counts["acknowledged edits"] += len(acknowledged)
    promise(acknowledged, "a page can edit")
    saved = [e["after"] for e in world.events(labels) if e["field"] == "label"]
    promise(saved[: len(acknowledged)] == acknowledged, "acknowledged edits are there", (acknowledged[-3:], saved[-3:]))
    promise(len(saved) <= len(acknowledged) + 1, "nothing that nobody asked for is there", saved[-3:])
    again: list[str] = []
    with served(*words) as server:

        async def some() -> None:
            editing = asyncio.create_task(_edit(server.port, again))
            while len(again) < 2 and not editing.done():
                await asyncio.sleep(0.05)
            editing.cancel()

        asyncio.run(some())
    promise(len(world.events(labels)) >= len(saved) + 2, "the next server goes on")
    shutil.rmtree(labels.parent)


def _never_reads(port: int, commands: int, halt: threading.Event, slowly: bool) -> None:
    """A page that asks for much and reads nothing, or a few bytes a second."""
    with contextlib.suppress(OSError, ConnectionClosed, InvalidStatus, TimeoutError):
        plain = socket.create_connection(("127.0.0.1", port), 10)
        plain.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        address = f"ws://127.0.0.1:{port}/app/socket?id={random.randbytes(16).hex()}"
        with connect(address, sock=plain, origin=f"http://127.0.0.1:{port}") as page:  # type: ignore[arg-type]
            page.send(json.dumps({"type": "hello"}))
            # From here on nobody takes anything from the socket: its own thread is stopped by a queue that is full.
            for number in range(commands):
                if halt.is_set():
                    break
                page.send(json.dumps({"type": "command", "name": "frame", "arguments": [str(number % 4)]}))
                page.send(json.dumps({"type": "command", "name": "next-pair", "arguments": ["1"]}))
                if slowly:
                    page.recv(timeout=5)
                time.sleep(0.05)
            halt.wait(20)


def _half_requests(port: int, halt: threading.Event) -> None:
    """Requests that never end, and connections that say nothing."""
    opened = []
    for number in range(60):
        with contextlib.suppress(OSError):
            one = socket.create_connection(("127.0.0.1", port), 5)
            one.sendall(
                b"" if number % 3 == 0 else b"GET / HTTP/1.1\r\nHost: 127.0.0.1\r\nX-A: " + b"b" * (number * 100)
            )
            opened.append(one)
    halt.wait(30)
    for one in opened:
        one.close()


async def _answered(port: int, rounds: int, kind: Kind) -> None:
    """A page as any other, beside the disturbed ones: every command is answered."""
    client = Client(port)
    await client.open(scene=False)
    for number in range(rounds):
        begun = time.monotonic()
        promise(
            await client.act(f"frame:{number % 4}") is not None, f"another page is answered within {ANSWERED:.0f} s"
        )
        promise(await client.act("ask:mug left of the laptop") is not None, "another page is answered")
        kind.most("slowest answer s", time.monotonic() - begun)
    await client.close()


def unread(world: World, rng: random.Random, kind: Kind) -> None:
    """Clients that never read, read slowly, or never end their request: others are answered, memory stays."""
    with served("demo") as server:
        asyncio.run(_answered(server.port, 2, kind))
        start, halt = load_page.resident_mb(server.process.pid), threading.Event()
        bad: list[Callable[[], None]] = [
            partial(_never_reads, server.port, 200, halt, slow) for slow in (False, True)
        ] * 3
        threads = [threading.Thread(target=one) for one in (*bad, partial(_half_requests, server.port, halt))]
        for thread in threads:
            thread.start()
        try:
            asyncio.run(_answered(server.port, 6, kind))
            kind.most("MB more meanwhile", load_page.resident_mb(server.process.pid) - start)
        finally:
            halt.set()
            for thread in threads:
                thread.join()
        kind.times += len(threads)
        asyncio.run(_answered(server.port, 2, kind))
        promise(kind.figures["MB more meanwhile"] < 400, "unread clients take little memory", kind.figures)


def garbage(world: World, rng: random.Random, kind: Kind) -> None:
    """Senders of what no page says, beside a page that must be answered."""
    with served("demo") as server:
        senders = [multiprocessing.Process(target=load_page.garble, args=(server.port,), daemon=True) for _ in range(2)]
        for sender in senders:
            sender.start()
        try:
            asyncio.run(_answered(server.port, 8, kind))
        finally:
            for sender in senders:
                sender.kill()
                sender.join()
        kind.times += len(senders)
        asyncio.run(_answered(server.port, 1, kind))


STRANGE: tuple[tuple[str, dict[str, str]], ...] = (
    ("/", {"Host": "evil.example"}),
    ("/", {"Host": "127.0.0.1.evil.example"}),
    ("/", {"Origin": "http://evil.example"}),
    ("/", {"Origin": "null"}),
    ("/app/socket?id=" + "a" * 32, {"Origin": "http://evil.example", "Upgrade": "websocket", "Connection": "Upgrade"}),
    ("/scene/" + "a" * 32 + "/", {"Origin": "http://evil.example"}),
    ("/", {"Sec-Fetch-Site": "cross-site", "Sec-Fetch-Mode": "no-cors"}),
)
PATHS = ("/app/../../pyproject.toml", "/app/%2e%2e/%2e%2e/etc/passwd", "//etc/passwd", "/app/image/../x", "/app/\x00")
TOKENS = ("", "?token=", "?token=" + "a" * 32, "?token=%00", "?token[]=x")


def _asked(port: int, path: str, headers: dict[str, str]) -> int:
    """Status of an answer; 0 where the connection was closed without one."""
    lines = {"Host": f"127.0.0.1:{port}", **headers}
    text = f"GET {path} HTTP/1.1\r\n" + "".join(f"{k}: {v}\r\n" for k, v in lines.items()) + "\r\n"
    with contextlib.suppress(OSError), socket.create_connection(("127.0.0.1", port), 10) as one:
        one.sendall(text.encode("latin-1"))
        words = one.recv(200).split()
        return int(words[1]) if len(words) > 1 else 0
    return 0


def strangers(world: World, rng: random.Random, kind: Kind) -> None:
    """Foreign names, foreign pages, wrong tokens and paths that climb are refused; the page itself is served."""
    with served("demo") as server:
        for path, headers in STRANGE:
            status = _asked(server.port, path, headers)
            promise(status in (0, 400, 403, 421), f"{path} with {headers} is refused", status)
        for path in PATHS:
            status = _asked(server.port, path, {})
            promise(status in (0, 400, 403, 404), f"{path!r} is refused", status)
        promise(_asked(server.port, "/", {}) == 200, "the page itself is served")
        with urllib.request.urlopen(f"{server.address}/app/index.html", timeout=20) as answer:
            promise("default-src 'none'" in answer.headers.get("Content-Security-Policy", ""), "a content policy")
    with served("demo", "--host", "0.0.0.0") as server:
        for token in TOKENS:
            for path in ("/", "/app/index.html", "/app/page.css"):
                status = _asked(server.port, path + token, {})
                promise(status in (0, 302, 400, 401, 403), f"{path}{token} without the token is refused", status)
    kind.times += len(STRANGE) + len(PATHS) + 3 * len(TOKENS)


def clients(world: World, rng: random.Random, kind: Kind) -> None:
    """Many pages at once: no reply is lost, and the server's memory is back when they have gone."""
    count = rng.choice((6, 12, 20))
    with served() as server:
        pid = server.process.pid
        # The first page loads what every page needs: the start is when it has gone and is forgotten.
        asyncio.run(load_page.run(server.port, pid, 1, 12.0, 1.0))
        time.sleep(FORGOTTEN)
        start = load_page.resident_mb(pid)
        figures = asyncio.run(load_page.run(server.port, pid, count, 25.0, 2.0))
        most, now, until = max(mb for _, mb in figures.memory), 0.0, time.monotonic() + PATIENCE
        while time.monotonic() < until:
            now = load_page.resident_mb(pid)
            if now <= start * (1 + BACK_WITHIN):
                break
            time.sleep(1)
    kind.times += count
    kind.most("clients", count)
    kind.most("MB at the start", start)
    kind.most("MB at most", most)
    kind.most("MB afterwards / start", now / start)
    promise(not figures.lost, "no reply is lost", figures.lost)
    promise(
        now <= start * (1 + BACK_WITHIN), "memory is back within 20 %", f"{start:.0f} -> {most:.0f} -> {now:.0f} MB"
    )


def changing_view(world: World, rng: random.Random, kind: Kind) -> None:
    """The dataset changes under a page: every command is answered, and put back, frames are shown again."""
    dataset = world.copy_of_dataset(world.folder("viewed") / "dataset")
    with served(dataset) as server:
        with changing(dataset, world.dataset, rng):
            asyncio.run(_answered(server.port, 8, kind))
        asyncio.run(_answered(server.port, 4, kind))
        kind.times += 1
    shutil.rmtree(dataset.parent)


def jumping_view(world: World, rng: random.Random, kind: Kind) -> None:
    """The clock jumps under a page that edits: every edit is saved, in order."""
    file, labels, acknowledged = world.home / "page-clock", world.labels_of_its_own(), list[str]()
    file.write_text("+0\n")
    with served(world.dataset, "--labels", labels, "--author", "ann", env=moved_clock(file)) as server:

        async def some() -> None:
            editing = asyncio.create_task(_edit(server.port, acknowledged))
            until = time.monotonic() + ANSWERED
            while len(acknowledged) < 8 and not editing.done() and time.monotonic() < until:
                await asyncio.sleep(0.05)
            editing.cancel()

        with jumping(file, rng, SECONDS):
            asyncio.run(some())
    kind.times += 1
    saved = [e["after"] for e in world.events(labels) if e["field"] == "label"]
    promise(len(acknowledged) >= 8, "a page can edit", acknowledged)
    promise(saved[: len(acknowledged)] == acknowledged, "acknowledged edits are there, in order", saved)
    shutil.rmtree(labels.parent)


class Idle:
    """A server with an open page that nobody touches while everything else runs; looked at in the end."""

    def __init__(self) -> None:
        self._server = Server("demo")
        self._loop = asyncio.new_event_loop()
        self._thread = threading.Thread(target=self._loop.run_forever, daemon=True)
        self._thread.start()
        self._server.served(120)
        self._client = Client(self._server.port)
        self._do(self._client.open())
        self._since, self._cpu = time.monotonic(), self._processor()
        self._memory = load_page.resident_mb(self._server.process.pid)

    def _do(self, work: Any) -> Any:
        return asyncio.run_coroutine_threadsafe(work, self._loop).result(3 * ANSWERED)

    def _processor(self) -> float:
        fields = Path(f"/proc/{self._server.process.pid}/stat").read_text().rpartition(")")[2].split()
        return (int(fields[11]) + int(fields[12])) / 100

    def look(self, kind: Kind) -> None:
        """The page is connected and answers; the server has done next to nothing and has not grown."""
        kind.times += 1
        seconds = time.monotonic() - self._since
        worked = self._processor() - self._cpu
        grown = load_page.resident_mb(self._server.process.pid) / self._memory
        kind.most("idle s", seconds)
        kind.most("processor % of one core", 100 * worked / seconds)
        kind.most("memory / start", grown)
        try:
            promise(self._do(self._client.act("frame:3")) is not None, "an idle page answers")
            promise(
                worked < 0.05 * seconds + 2, "an idle server does next to nothing", f"{worked:.1f} s of {seconds:.0f}"
            )
            promise(grown <= 1 + BACK_WITHIN, "an idle server does not grow", grown)
        finally:
            self.end()

    def end(self) -> None:
        if not self._loop.is_running():
            return
        with contextlib.suppress(Exception):
            self._do(self._client.close())
        with contextlib.suppress(subprocess.TimeoutExpired, AssertionError):
            self._server.end()
        self._loop.call_soon_threadsafe(self._loop.stop)
        self._thread.join()


SCENARIOS: dict[str, Callable[[World, random.Random, Kind], None]] = {
    "page-kill-edits": killed_edits,
    "page-unread": unread,
    "page-garbage": garbage,
    "page-strangers": strangers,
    "page-clients": clients,
    "page-changing": changing_view,
    "page-clock": jumping_view,
}
