"""A server of the page is there soon, ends quietly, and one that comes back finds the pages where they were."""

import ctypes
import signal
from pathlib import Path

from browser import OpenTab
from servers import Server

SERVED_WITHIN = 10.0
MOST_MEMORY = 1500
"""Megabytes that a server keeps with one page open."""


def memory_mb(pid: int) -> float:
    lines = Path(f"/proc/{pid}/status").read_text().splitlines()
    return next(int(line.split()[1]) / 1024 for line in lines if line.startswith("VmRSS"))


def test_it_is_served_soon_and_ends_quietly(open_tab: OpenTab) -> None:
    """Stopped while a client still searches, the server says nothing but its own lines."""
    with Server() as server:
        served = server.served(SERVED_WITHIN)
        tab = open_tab(server.address).drawn()
        assert served < SERVED_WITHIN, served
        assert memory_mb(server.process.pid) < MOST_MEMORY
        tab.click("task:evaluate")
        search = tab.see("#search input")
        search.fill("said:left margin<1 sort:margin")
        search.press("Enter")
        said = server.end()
    assert all(line.startswith("spatialviz:") for line in said), said
    # What the page says of its server that is gone is no problem here.
    tab.problems.clear()


def test_a_signal_given_to_another_thread_ends_it() -> None:
    """The system chooses the thread that takes a signal: the main thread, asleep, may not be woken by it."""
    with Server() as server:
        process = server.process
        assert process.stdout is not None
        assert b"stops" in process.stdout.readline()
        threads = [int(task.name) for task in Path(f"/proc/{process.pid}/task").iterdir()]
        ctypes.CDLL(None).tgkill(process.pid, max(threads), signal.SIGTERM)
        assert process.wait(15) == 128 + signal.SIGTERM
        server.end()


def test_a_server_that_is_lost_and_comes_back(lost: Server, open_tab: OpenTab) -> None:
    """A server that ends is told of; one that comes back finds the page where it was."""
    tab = open_tab(lost.address)
    first = tab.frame
    tab.press("n")
    moved = tab.other_frame(first)
    tab.poll("moved => location.search.includes(moved)", moved)
    lost.end()
    tab.see("#lost", "does not answer")
    with Server("demo", port=lost.port) as second:
        tab.poll("!document.body.classList.contains('lost')")
        tab.see("#answer .panel")
        assert tab.frame == moved, (tab.frame, moved)
        tab.drawn()
        tab.press("p")
        tab.other_frame(moved)
        assert second.process.poll() is None
    tab.problems.clear()
