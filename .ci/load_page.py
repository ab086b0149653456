"""Many pages at once, by their protocol: how soon each is answered, what is sent, and what the server keeps.

python .ci/load_page.py --minutes 10 --clients 20
python .ci/load_page.py --minutes 1 --clients 8 --garbage 3
"""

import argparse
import asyncio
import json
import multiprocessing
import os
import subprocess
import sys
import time
import urllib.request
from collections import defaultdict
from contextlib import suppress
from itertools import cycle, islice
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import viser
from websockets.asyncio.client import connect
from websockets.typing import Subprotocol

from spatialviz.bench_page import Client

PORT = 8233
SERVED_WITHIN = 60.0
MOST_FRAME, MOST_FIRST, MOST_SELECTION = 2_800_000, 800_000, 4_000
"""Bytes."""


def steps(number: int):
    """Kinds and commands of one page, again and again."""
    asked = cycle(("mug left of the laptop", "book on the desk", "lamp behind the desk", "plant near the shelf"))
    frame = number
    while True:
        frame += 1
        yield "frame", f"frame:{frame % 12}"
        yield "question", f"ask:{next(asked)}"
        yield "selection", "next-pair:1"
        yield "edit", f"edit:set:k:{3 + frame % 5}"
        yield "selection", f"object:{frame % 7}"
        yield "question", f"ask:{next(asked)}"
        yield "edit", f"edit:set:k:{4 + frame % 5}"
        yield "selection", f"object:{(frame + 3) % 7}"


def resident_mb(pid: int) -> float:
    lines = Path(f"/proc/{pid}/status").read_text().splitlines()
    return next(int(line.split()[1]) / 1024 for line in lines if line.startswith("VmRSS"))


class Figures:
    """What was measured."""

    def __init__(self) -> None:
        self.seconds: dict[str, list[float]] = defaultdict(list)
        self.page: dict[str, list[int]] = defaultdict(list)
        self.scene: dict[str, list[int]] = defaultdict(list)
        self.first: list[int] = []
        self.lost = 0
        self.memory: list[tuple[float, float]] = []

    def say(self) -> None:
        load = ", ".join(f"{v:.1f}" for v in os.getloadavg())
        print(f"load average {load} on {os.cpu_count()} cores; {self.lost} replies lost")
        for kind, values in self.seconds.items():
            p50, p95, most = np.percentile(values, [50, 95, 100]) * 1000
            sent = f"page {_kb(self.page[kind])}, scene {_kb(self.scene[kind])}"
            print(f"{kind:10} {len(values):5} times  p50 {p50:5.0f}  p95 {p95:5.0f}  worst {most:5.0f} ms  {sent}")
        if self.first:
            print(f"first cloud: {_kb(self.first)}")
        if self.memory:
            warm = self.memory[len(self.memory) // 3 :]
            shown = [f"{at:.0f} s {mb:.0f}" for at, mb in self.memory[:: max(1, len(self.memory) // 8)]]
            print(f"memory, MB: {', '.join(shown)}; after warm-up {warm[0][1]:.0f}, at the end {warm[-1][1]:.0f}")


def _kb(values: list[int]) -> str:
    return f"{np.median(values) / 1000:.1f} (most {max(values) / 1000:.1f}) kB" if values else "-"


async def one(client: Client, number: int, until: float, period: float, figures: Figures) -> None:
    """What one person does."""
    await asyncio.sleep(period * number / 20)
    # Not all of them change the frame at once.
    for kind, command in islice(steps(number), number % 8, None):
        if time.monotonic() >= until:
            return
        start, (page, scene) = time.monotonic(), client.taken
        seconds = await client.act(command)
        if seconds is None:
            figures.lost += 1
        else:
            figures.seconds[kind].append(seconds)
        await client.quiet(cloud=kind == "frame")
        await asyncio.sleep(max(0.0, period - (time.monotonic() - start)))
        after = client.taken
        figures.page[kind].append(after[0] - page)
        figures.scene[kind].append(after[1] - scene)
        firsts = [size for name, size in client.cloud.items() if name.startswith("/cloud/first")]
        if kind == "frame" and firsts:
            figures.first.append(sum(firsts))


async def run(port: int, pid: int, clients: int, seconds: float, period: float, garbage: int = 0) -> Figures:
    """Measure so many pages for so long, beside so many senders of garbage, who come when the pages are open."""
    figures, pages = Figures(), [Client(port) for _ in range(clients)]
    for page in pages:
        await page.open()
    senders = [multiprocessing.Process(target=garble, args=(port,), daemon=True) for _ in range(garbage)]
    for sender in senders:
        sender.start()
    start = time.monotonic()

    async def watch() -> None:
        while True:
            figures.memory.append((time.monotonic() - start, resident_mb(pid)))
            await asyncio.sleep(max(1.0, seconds / 60))

    watching = asyncio.create_task(watch())
    await asyncio.gather(*(one(p, k, start + seconds, period, figures) for k, p in enumerate(pages)))
    watching.cancel()
    for sender in senders:
        sender.terminate()
    figures.memory.append((time.monotonic() - start, resident_mb(pid)))
    for page in pages:
        await page.close()
    return figures


GARBAGE = (
    "{" * 200,
    "x" * 2**20,
    os.urandom(4_000),
    "[" * 100_000,
    '{"type": "fly"}',
    '{"type": "hello"}',
    json.dumps({"type": "command", "name": "nothing", "arguments": ["x" * 15_000]}),
    json.dumps({"type": "command", "name": "frame", "arguments": ["9" * 400_000]}),
)
"""What is no message of a page, or a command that there is not; the flood of each is as long as is taken."""
SCENE_GARBAGE = (
    "{}",
    b"",
    os.urandom(4_000),
    b"\x91" * 50_000,
    os.urandom(2**20),
    msgspec.msgpack.encode({"type": "NoMessage"}),
    msgspec.msgpack.encode({"type": "GuiUpdateMessage", "uuid": "x", "updates": {"value": "x" * 30_000}}),
)
FLOOD = 500


def garble(port: int) -> None:
    """Send a server what it cannot understand, by one page after the other, as fast as it is taken."""
    os.nice(10)

    async def send(address: str, garbage: str | bytes, *first: str, **options: Any) -> None:
        # A connection that is cut off fails in many ways.
        with suppress(Exception):
            async with connect(address, origin=f"http://127.0.0.1:{port}", **options) as connection:
                for message in (*first, *[garbage] * FLOOD):
                    await connection.send(message)

    async def forever() -> None:
        spoken = [Subprotocol(f"viser-v{viser.__version__}")]
        for number, (words, data) in enumerate(zip(cycle(GARBAGE), cycle(SCENE_GARBAGE), strict=False)):
            # A name is used for some time: the server knows it, and then another one.
            page_id = f"{os.getpid():x}{number // 4:x}".rjust(32, "0")
            await send(f"ws://127.0.0.1:{port}/app/socket?id={page_id}", words, '{"type": "hello"}')
            await send(f"ws://127.0.0.1:{port}/scene/{page_id}", data, subprotocols=spoken, compression=None)

    asyncio.run(forever())


def served(port: int, *words: str) -> "subprocess.Popen[str]":
    """A server that answers already."""
    command = [sys.executable, "-m", "spatialviz", "view", "--port", str(port), "--no-open-browser", *words]
    server = subprocess.Popen(command, stderr=subprocess.PIPE, stdout=subprocess.DEVNULL, text=True)
    end = time.monotonic() + SERVED_WITHIN
    while time.monotonic() < end:
        try:
            with urllib.request.urlopen(f"http://127.0.0.1:{port}", timeout=1):
                return server
        except OSError:
            time.sleep(0.1)
    server.kill()
    raise SystemExit("the page was not served")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--minutes", type=float, default=10)
    parser.add_argument("--clients", type=int, default=20)
    parser.add_argument("--period", type=float, default=5, help="seconds between what one page does")
    parser.add_argument("--port", type=int, default=PORT)
    parser.add_argument("--check", action="store_true", help="fail where more is sent, kept or lost than may be")
    parser.add_argument("--garbage", type=int, default=0, help="senders beside that say what no page says")
    given = parser.parse_args()
    server = served(given.port)
    try:
        seconds = given.minutes * 60
        figures = asyncio.run(run(given.port, server.pid, given.clients, seconds, given.period, given.garbage))
    finally:
        server.terminate()
        server.wait(30)
    lines = server.stderr.read().splitlines() if server.stderr else []
    figures.say()
    print(f"{len(lines)} lines in the server's log: {lines[:1]}")
    if given.check:
        assert not figures.lost, figures.lost
        most = {k: max(p + s for p, s in zip(figures.page[k], figures.scene[k], strict=True)) for k in figures.page}
        assert most["selection"] < MOST_SELECTION, most
        assert most["frame"] < MOST_FRAME, most
        assert figures.first
        assert max(figures.first) < MOST_FIRST, figures.first
        assert figures.memory[-1][1] < 1500, figures.memory[-1]


if __name__ == "__main__":
    main()
