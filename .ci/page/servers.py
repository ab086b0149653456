"""Servers of the page: one for each kind of data that checks look at, and how each is made."""

import contextlib
import os
import signal
import socket
import subprocess
import sys
import tempfile
import threading
import time
import urllib.error
import urllib.request
from collections.abc import Callable, Iterable
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path

from recordings import LABELS, RUN, large_run, long_recording, markup_in_names, one_frame, second_run, write_recording

ENDS_WITHIN = 30.0


def free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


class Server:
    """`spatialviz view` with these words, on a port of its own unless one is given; it ends with its block.

    Attributes
    ----------
    folder : Path
        Where its data stand, and what the page writes about them.
    """

    def __init__(self, *words: object, port: int = 0, folder: Path = Path(), env: dict[str, str] | None = None) -> None:
        self.folder = folder
        self.port = port or free_port()
        self.address = f"http://127.0.0.1:{self.port}"
        command = [sys.executable, "-m", "spatialviz", "view", *map(str, words)]
        command += ["--port", str(self.port), "--no-open-browser"]
        # What was corrected in the demo before is not what a check begins with, and what it corrects is nobody's.
        self._home = tempfile.TemporaryDirectory()
        own = {**os.environ, "XDG_DATA_HOME": self._home.name, "PYTHONFAULTHANDLER": "1", **(env or {})}
        self.started = time.monotonic()
        self.process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, env=own)

    @property
    def journal(self) -> Path:
        """The journal of the kinds of data that are corrected."""
        return self.folder / "journal.sqlite"

    def served(self, within: float = 30.0) -> float:
        """Seconds until it answered."""
        while time.monotonic() - self.started < within and self.process.poll() is None:
            try:
                with urllib.request.urlopen(self.address, timeout=1):
                    return time.monotonic() - self.started
            except urllib.error.HTTPError:
                return time.monotonic() - self.started
            except OSError:
                time.sleep(0.05)
        raise AssertionError(f"the page was not served within {within} s, or its server has ended")

    def end(self) -> list[str]:
        """Stop it; the lines that it has said since they were last asked for."""
        assert self.process.stdout is not None
        if self.process.stdout.closed:
            return []
        if self.process.poll() is None:
            self.process.terminate()
        with contextlib.suppress(subprocess.TimeoutExpired):
            return self.process.communicate(timeout=ENDS_WITHIN)[0].decode().splitlines()
        # What holds it up is said by the fault handler.
        self.process.send_signal(signal.SIGABRT)
        said = self.process.communicate(timeout=ENDS_WITHIN)[0].decode()
        raise AssertionError(f"the page did not end within {ENDS_WITHIN} s:\n{said}")

    def __enter__(self) -> "Server":
        self.served(90)
        return self

    def __exit__(self, *_: object) -> None:
        if self.process.poll() is None:
            self.end()


def _compared(folder: Path) -> list[object]:
    return ["--run", RUN, "--compare", second_run(folder / "second"), "--journal", folder / "journal.sqlite"]


def _mapped(folder: Path) -> list[object]:
    """Labels that know which objects of a scene's frames are one."""
    maps, labels = folder / "maps", folder / "labels"
    for words in (["map", "demo", "000001/000000", "--out", maps], ["label", "demo", "--out", labels, "--map", maps]):
        subprocess.run([sys.executable, "-m", "spatialviz", *map(str, words)], check=True, capture_output=True)
    return ["demo", "--labels", labels, "--journal", folder / "journal.sqlite"]


def _bare(folder: Path) -> list[object]:
    recording = folder / "rec"
    return [recording, "--detector", "recorded", "--model", write_recording(recording)]


FLAT = ("--intrinsics", "60,60,32,24", "--depth-scale", "1000")
"""Of recordings that are made of two small pictures."""
KINDS: dict[str, Callable[[Path], Iterable[object]]] = {
    "demo": lambda _: [],
    "lost": lambda _: ["demo"],
    "guarded": lambda _: ["demo", "--host", "0.0.0.0"],
    "mapped": _mapped,
    "reviewed": lambda folder: ["demo", "--journal", folder / "journal.sqlite"],
    "corrected": lambda folder: [
        "demo",
        "--labels",
        LABELS,
        "--journal",
        folder / "journal.sqlite",
        "--author",
        "ann",
    ],
    "shared": lambda folder: ["demo", "--labels", LABELS, "--journal", folder / "journal.sqlite"],
    "compared": _compared,
    "large": lambda folder: ["--run", large_run(folder / "large"), "demo"],
    "bare": _bare,
    "long": lambda folder: [long_recording(folder / "long"), *FLAT],
    "single": lambda folder: [one_frame(folder / "single"), *FLAT],
    "hostile": lambda folder: [markup_in_names(folder)],
}
"""The words after `spatialviz view` for each kind of data, which is made in a folder of its own."""


class Servers:
    """The servers of a session, each started once: when it is asked for, or ahead of that."""

    def __init__(self) -> None:
        self._home = tempfile.TemporaryDirectory()
        self._begun: dict[str, Future[Server]] = {}
        self._lock = threading.Lock()
        # Two at a time, in the order in which they are needed.
        self._pool = ThreadPoolExecutor(2)

    def begin(self, kind: str) -> "Future[Server]":
        """Have a server of a kind of data started, and do not wait for it."""
        with self._lock:
            if kind not in self._begun:
                self._begun[kind] = self._pool.submit(self._start, kind)
            return self._begun[kind]

    def _start(self, kind: str) -> Server:
        folder = Path(self._home.name) / kind
        folder.mkdir()
        server = Server(*KINDS[kind](folder), folder=folder)
        try:
            server.served(120)
        except AssertionError as error:
            raise AssertionError("\n".join([str(error), *server.end()])) from None
        return server

    def get(self, kind: str) -> Server:
        """The server of a kind of data, which answers already."""
        return self.begin(kind).result()

    def end(self) -> dict[str, list[str]]:
        """Stop all of them, and delete their data; the lines of each that are not its own plain ones."""
        self._pool.shutdown(cancel_futures=True)
        made = {kind: f.result() for kind, f in self._begun.items() if not f.cancelled() and f.exception() is None}
        for server in made.values():
            if server.process.poll() is None:
                server.process.terminate()
        said = {kind: server.end() for kind, server in made.items()}
        self._home.cleanup()
        # viser says that it has stopped where that takes it longer than it is waited for.
        own = ("spatialviz:", "(viser) Server stopped")
        odd = {kind: [line for line in lines if not line.startswith(own)] for kind, lines in said.items()}
        return {kind: lines for kind, lines in odd.items() if lines}
