"""A server of pages, by its sockets: who sends garbage, floods or leaves costs itself only."""

import asyncio
import json
import threading
import time
from collections.abc import Coroutine, Iterator
from typing import Any

import pytest
import viser
from websockets.asyncio.client import ClientConnection, connect
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.typing import Subprotocol

from pipeline.answering.pipeline import open_pipeline
from spatialviz.app import site as pages
from spatialviz.app.channel import end_all
from spatialviz.app.server import start
from spatialviz.app.site import Gate

HELLO = json.dumps({"type": "hello"})
SPOKEN = Subprotocol(f"viser-v{viser.__version__}")
MOST = 3
WORST = 2.0
"""Seconds in which a page is answered beside garbage, on a machine that is busy."""


@pytest.fixture
def port() -> Iterator[int]:
    server = start({"demo": open_pipeline("demo")}, port=0, max_clients=MOST)
    yield server.get_port()
    end_all(10)
    server.stop()


def socket(port: int, number: int, path: str = "/app/socket?id=", **options: Any) -> connect:
    address = f"ws://127.0.0.1:{port}{path}{number:032x}"
    return connect(address, origin=f"http://127.0.0.1:{port}", max_size=None, **options)  # pyright: ignore


async def opened(port: int, number: int) -> ClientConnection:
    connection = await socket(port, number)
    await connection.send(HELLO)
    await answered(connection, "opened")
    return connection


async def answered(connection: ClientConnection, typed: str) -> float:
    """Seconds until what was typed is answered, which comes after all else."""
    begun = time.monotonic()
    await connection.send(json.dumps({"type": "command", "name": "ask-typed", "arguments": [typed]}))
    while True:
        message = json.loads(await asyncio.wait_for(connection.recv(), 60))
        if message["type"] == "call" and message["name"] == "asking" and message["data"]["typed"] == typed:
            return time.monotonic() - begun


async def closed_by(connection: ClientConnection, *messages: str | bytes) -> int | None:
    """The code by which a socket is closed where it is sent these."""
    try:
        for message in messages:
            await connection.send(message)
        while True:
            await asyncio.wait_for(connection.recv(), 10)
    except ConnectionClosed as error:
        # Until the server has taken leave, too.
        await asyncio.sleep(0.3)
        return None if error.rcvd is None else error.rcvd.code


def run(steps: Coroutine[Any, Any, None]) -> None:
    asyncio.run(asyncio.wait_for(steps, 120))


@pytest.mark.parametrize(
    ("garbage", "code"),
    [
        ("{" * 200, 1008),
        (b"\xff\xfe\x00", 1008),
        ("[" * 100_000, 1008),
        ('{"type": "fly"}', 1008),
        (HELLO, 1008),
        (json.dumps({"type": "command", "name": "frame", "arguments": ["9" * 30_000]}), 1008),
        ("x" * 2**20, 1009),
    ],
)
def test_what_is_no_message_closes_its_socket_and_keeps_it_closed(
    port: int, garbage: str | bytes, code: int, capfd: pytest.CaptureFixture[str]
) -> None:
    async def steps() -> None:
        honest, sender = await opened(port, 1), await opened(port, 2)
        assert await closed_by(sender, *[garbage] * pages.GARBAGE) == code
        with pytest.raises(InvalidStatus, match="429"):
            await socket(port, 2)
        assert await answered(honest, "still there") < WORST
        # What was only closed comes back at once, and so does another page.
        await honest.close()
        await (await opened(port, 1)).close()
        await (await opened(port, 3)).close()

    run(steps())
    assert capfd.readouterr().err.count("\n") == 1


@pytest.mark.parametrize("garbage", ["{}", b"", b"\x91" * 50_000, b"\x00" * 2**20])
def test_what_is_no_message_of_a_scene_closes_its_socket(
    port: int, garbage: str | bytes, capfd: pytest.CaptureFixture[str]
) -> None:
    async def steps() -> None:
        page = await opened(port, 1)
        for protocols in ([SPOKEN], None):
            # The second one speaks no version of viser at all.
            scene = await socket(port, 1, "/scene/", subprotocols=protocols, compression=None)
            code = await closed_by(scene, garbage)
            assert code in (1008, 1009)
            if protocols:
                with pytest.raises(InvalidStatus, match="429"):
                    await socket(port, 1, "/scene/", subprotocols=protocols, compression=None)
                return
        await page.close()

    run(steps())
    told = capfd.readouterr()
    assert told.err.count("\n") == 1
    assert not told.out


def test_a_flood_of_commands_that_there_are_not_leaves_others_alone(port: int) -> None:
    async def steps() -> None:
        honest, sender = await opened(port, 1), await opened(port, 2)
        flood = json.dumps({"type": "command", "name": "nothing", "arguments": ["x" * 10_000]})
        sending = asyncio.create_task(closed_by(sender, *[flood] * 1000))
        times = [await answered(honest, f"during {number}") for number in range(20)]
        assert sorted(times)[10] < WORST / 4, times
        sending.cancel()

    run(steps())


def test_pages_are_as_many_as_may_be_and_one_that_has_gone_gives_way(port: int) -> None:
    async def steps() -> None:
        connections = [await opened(port, number) for number in range(MOST)]
        late = await socket(port, 9)
        assert await closed_by(late, HELLO) == 1013
        await connections[1].close()
        await asyncio.sleep(0.2)
        assert await answered(await opened(port, 9), "now") < WORST * 5
        await answered(connections[0], "the others stay")

    run(steps())


def test_a_page_that_has_gone_is_forgotten(port: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(pages, "KEPT_SECONDS", 0.5)

    def threads() -> int:
        return sum(thread.name.startswith("page-") for thread in threading.enumerate())

    async def steps() -> None:
        before = threads()
        connection = await opened(port, 1)
        assert threads() == before + 1
        await connection.close()
        end = time.monotonic() + 20
        while threads() > before and time.monotonic() < end:
            await asyncio.sleep(0.1)
        assert threads() == before

    run(steps())


def test_the_gate_holds_up_whoever_comes_all_the_time(monkeypatch: pytest.MonkeyPatch) -> None:
    now = 1000.0
    monkeypatch.setattr(pages.time, "monotonic", lambda: now)
    gate = Gate(5)
    # New pages of one address, not those of another, nor a page that is open.
    assert [gate.opens("a", "") for _ in range(40)].count(True) == pages.NEW_BURST + 5
    assert gate.opens("b", "")
    assert gate.opens("a", "page")
    gate.charge("page")
    assert not gate.opens("a", "page")
    assert gate.opens("b", "other")
    now += 2 * pages.GARBAGE_COSTS / pages.SOCKETS_PER_SECOND
    assert gate.opens("a", "page")
    assert gate.opens("a", "")
