"""Speed of the page by its sockets, without a browser: a part of `spatialviz bench`; and a client for load tests."""

from __future__ import annotations

import asyncio
import json
import os
import socket
import subprocess
import sys
import time
import urllib.request
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from importlib.metadata import version
from pathlib import Path
from secrets import token_hex
from typing import Any

import msgspec
import numpy as np
import zstandard
from websockets.asyncio.client import ClientConnection, connect
from websockets.exceptions import ConnectionClosed
from websockets.typing import Origin, Subprotocol

from pipeline.answering.objects import all_objects
from pipeline.answering.pipeline import open_pipeline
from pipeline.bench.clock import ONE_THREAD, Figure, Setup, least, synced_row
from pipeline.bench.start_part import BARE_IMPORTS
from pipeline.system.whole_files import scratch_folder

ANSWERED_WITHIN, SERVED_WITHIN = 60.0, 60.0
QUIET_SECONDS = 0.5
"""Nothing more comes after so long."""
FAR = (6, 3, 9, 1, 7, 4, 10, 2, 8, 5, 11, 0)
"""Frames of the demo in an order in which none is made ready as a neighbour."""
CLASSES = ("vase", "mug", "book")
CAMERA = {
    "type": "ViewerCameraMessage", "wxyz": [1.0, 0.0, 0.0, 0.0], "position": [1.0, 1.0, 1.0], "fov": 0.8,
    "near": 0.01, "far": 100.0, "image_height": 600, "image_width": 800, "look_at": [0.0, 0.0, 0.0],
    "up_direction": [0.0, 0.0, 1.0],
}  # fmt: skip


class Counted(ClientConnection):
    """A connection that counts what comes over the wire."""

    taken = 0

    def data_received(self, data: bytes) -> None:
        self.taken += len(data)
        super().data_received(data)


class Client:
    """A page without a browser: its own socket, and viser's of its scene."""

    def __init__(self, port: int) -> None:
        self.port, self.id = port, token_hex(16)
        self.page: Any = None
        self.scene: Any = None
        self.first = self.last = self.drawn = 0.0
        self.cloud: Counter[str] = Counter()
        """Bytes of points and colours by node of the scene, since the last command."""
        self.toasts: list[dict[str, Any]] = []
        self._heard = asyncio.Event()
        self._typed = ""
        self._tasks: list[asyncio.Task[None]] = []

    @property
    def taken(self) -> tuple[int, int]:
        """Bytes of the page and of its scene so far."""
        return (self.page.taken if self.page else 0), (self.scene.taken if self.scene else 0)

    async def open(self, scene: bool = True) -> None:
        """Show the page, and its scene."""
        address = f"ws://127.0.0.1:{self.port}"
        self.page = await connect(
            f"{address}/app/socket?id={self.id}", max_size=None, create_connection=Counted, origin=Origin(self._origin)
        )
        self._tasks.append(asyncio.create_task(self._hear()))
        await self.page.send(json.dumps({"type": "hello"}))
        await self.fence()
        if scene:
            self.scene = await connect(
                f"{address}/scene/{self.id}",
                max_size=None,
                create_connection=Counted,
                compression=None,
                subprotocols=[Subprotocol(f"viser-v{version('viser')}")],
                origin=Origin(self._origin),
            )
            await self.scene.send(msgspec.msgpack.encode(CAMERA))
            self._tasks.append(asyncio.create_task(self._look()))
            await self.quiet(cloud=True)

    @property
    def _origin(self):
        return f"http://127.0.0.1:{self.port}"

    async def close(self) -> None:
        for connection in (self.scene, self.page):
            if connection is not None:
                await connection.close()
        for task in self._tasks:
            task.cancel()
        for end in await asyncio.gather(*self._tasks, return_exceptions=True):
            assert end is None or isinstance(end, asyncio.CancelledError), end

    async def _hear(self) -> None:
        assert self.page is not None
        with suppress(ConnectionClosed):
            async for text in self.page:
                message = json.loads(text)
                if message["type"] == "patch":
                    self.first = self.first or time.monotonic()
                elif message["type"] == "call" and message["name"] == "toast":
                    self.toasts.append(message["data"])
                elif message["type"] == "call" and message["name"] == "asking":
                    self._typed = message["data"]["typed"]
                    self._heard.set()
                self.last = time.monotonic()

    async def _look(self) -> None:
        assert self.scene is not None
        with suppress(ConnectionClosed):
            async for data in self.scene:
                assert isinstance(data, bytes)
                size = int.from_bytes(data[8:16], "little")
                window = msgspec.msgpack.decode(zstandard.decompress(data[16 : 16 + size]))
                for message in window["messages"]:
                    for name, value in message.get("props", {}).items():
                        if message["type"] == "PointCloudMessage" and name in ("points", "colors"):
                            self.drawn = self.drawn or time.monotonic()
                            self.cloud[message["name"]] += window["binaryBufferLengths"][value["__binary_index"]]
                self.last = time.monotonic()

    async def send(self, command: str) -> None:
        assert self.page is not None
        name, _, argument = command.partition(":")
        await self.page.send(json.dumps({"type": "command", "name": name, "arguments": [argument]}))

    async def fence(self) -> bool:
        """Wait until everything that was sent is answered: offers for what nobody types come last."""
        nonce = token_hex(8)
        await self.send(f"ask-typed:{nonce}")
        try:
            while self._typed != nonce:
                self._heard.clear()
                await asyncio.wait_for(self._heard.wait(), ANSWERED_WITHIN)
        except asyncio.TimeoutError:
            return False
        return True

    async def act(self, command: str) -> float | None:
        """Seconds from a command to the first thing that changes in the page; None where nothing answers."""
        self.first, start = 0.0, time.monotonic()
        self.cloud.clear()
        await self.send(command)
        if not await self.fence():
            return None
        return (self.first or time.monotonic()) - start

    async def quiet(self, cloud: bool = False, most: float = 10.0) -> None:
        """Wait until nothing more comes, and, where a `cloud` does, not before the rest of it."""
        self.last = time.monotonic()
        end = self.last + most
        while time.monotonic() < min(end, self.last + QUIET_SECONDS) or (
            cloud and time.monotonic() < end and not any("/rest" in name for name in self.cloud)
        ):
            await asyncio.sleep(0.05)


def measure(setup: Setup) -> Iterator[Figure]:
    """Measure a server of the demo that is started for it."""
    with scratch_folder() as folder:
        bare = min(_wall([sys.executable, *BARE_IMPORTS]) for _ in range(setup.times(3)))
        starts = [asyncio.run(_start(folder / f"{k}.sqlite")) for k in range(setup.times(5) + 1)]
        # The first one writes bytecode.
        first_byte, first_points = np.min(starts[1:], axis=0).tolist()
        yield "page.first_byte", first_byte, bare
        yield "page.first_points", first_points, bare
        with _served(folder / "journal.sqlite") as (port, pid):
            rows = np.array(asyncio.run(_frames(port, setup.times(12, 4))))
            core, points = _core(setup)
            seconds, first, every = np.median(rows, axis=0).tolist()
            yield "page.frame", seconds * 1000, core * 1000
            yield "page.first_cloud", first / 1e6, points * 15 / 1e6
            yield "page.cloud", every / 1e6, points * 15 / 1e6
            label = asyncio.run(_label(port, pid, setup.times(15, 4)))
            floor = synced_row(folder)
            yield "page.label", label * 1000, least(lambda: next(floor), 20) * 1000


def _wall(command: list[str]) -> float:
    start = time.monotonic()
    subprocess.run(command, check=True)
    return time.monotonic() - start


@contextmanager
def _served(journal: Path) -> Iterator[tuple[int, int]]:
    """Port and process of a server that answers."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    words = ["view", "demo", "--journal", str(journal), "--port", str(port), "--no-open-browser"]
    # As a user starts it: with as many threads as it takes.
    env = {name: value for name, value in os.environ.items() if name not in ONE_THREAD}
    server = subprocess.Popen([sys.executable, "-m", "spatialviz", *words], stdout=sys.stderr, env=env)
    try:
        end = time.monotonic() + SERVED_WITHIN
        while time.monotonic() < end and server.poll() is None:
            with suppress(OSError), urllib.request.urlopen(f"http://127.0.0.1:{port}", timeout=5) as answer:
                answer.read(1)
                yield port, server.pid
                return
            time.sleep(0.01)
        raise TimeoutError("the page was not served")
    finally:
        server.terminate()
        server.wait(30)


async def _start(journal: Path) -> tuple[float, float]:
    """Seconds from the start of the program to its first byte, and to the first points."""
    start = time.monotonic()
    with _served(journal) as (port, _):
        served, client = time.monotonic() - start, Client(port)
        await client.open()
        await client.close()
        return served, client.drawn - start


async def _frames(port: int, times: int) -> list[tuple[float, int, int]]:
    """Of far frames: seconds until the first points, bytes of those, bytes of all."""
    client, found = Client(port), []
    await client.open()
    for k in range(times):
        client.drawn = 0.0
        start = time.monotonic()
        await client.act(f"frame:{FAR[k % len(FAR)]}")
        await client.quiet(cloud=True)
        first = sum(size for name, size in client.cloud.items() if name.startswith("/cloud/first"))
        found.append((client.drawn - start, first, sum(client.cloud.values())))
    await client.close()
    return found


async def _label(port: int, pid: int, times: int) -> float:
    """Least processor seconds of the server, from a class that is set until all that follows is done."""
    client, found = Client(port), []
    await client.open()
    for command in ("task:label", f"frame:{FAR[1]}", "object:3"):
        await client.act(command)
    await _idle(client, pid)
    for k in range(times):
        before = _processor(pid)
        await client.act(f"class:{CLASSES[k % len(CLASSES)]}")
        await _idle(client, pid)
        found.append(_processor(pid) - before)
    await client.close()
    return min(found[1:])


async def _idle(client: Client, pid: int, most: float = 30.0) -> None:
    """Wait until nothing comes and the server computes nothing."""
    end, before = time.monotonic() + most, _processor(pid)
    while time.monotonic() < end:
        await asyncio.sleep(QUIET_SECONDS / 2)
        now = _processor(pid)
        if now - before < 0.004 and time.monotonic() > client.last + QUIET_SECONDS / 2:
            return
        before = now


def _processor(pid: int) -> float:
    """Processor seconds of all threads so far."""
    tasks = Path(f"/proc/{pid}/task").iterdir()
    return sum(int((task / "schedstat").read_text().split()[0]) for task in tasks) / 1e9


def _core(setup: Setup) -> tuple[float, int]:
    """Seconds of reading and lifting a frame, the median of several; pixels with depth."""
    source, seconds, points = open_pipeline("demo"), [], []
    for frame in FAR[: setup.times(12, 4)]:
        start = time.monotonic()
        context = source.prepare(frame)
        all_objects(context, source.needed_detector())
        seconds.append(time.monotonic() - start)
        points.append(int(np.count_nonzero(context.frame.depth > 0)))
    return float(np.median(seconds)), int(np.median(points))
