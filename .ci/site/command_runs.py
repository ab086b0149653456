"""Commands run in a folder of their own: in forks of this process, which has loaded the program once."""

from __future__ import annotations

import io
import os
import re
import select
import signal
import subprocess
import sys
import tempfile
import time
import traceback
import urllib.request
from collections.abc import Callable, Mapping
from contextlib import redirect_stderr, redirect_stdout, suppress
from dataclasses import dataclass
from importlib import import_module
from multiprocessing import Pipe, get_context
from multiprocessing.connection import Connection
from pathlib import Path
from types import SimpleNamespace
from typing import Any

ROOT = Path(__file__).resolve().parents[2]
LONGEST_S = 240
"""Seconds after which a command hangs."""
WRITES = re.compile(r"[wax+]")
ELSEWHERE = ("/dev/", "/proc/")
HOMES = ("HOME", "TMPDIR", "XDG_CACHE_HOME", "XDG_CONFIG_HOME", "XDG_DATA_HOME", "XDG_STATE_HOME", "SPATIALVIZ_CACHE")


@dataclass(frozen=True)
class Ran:
    """What a command printed, the status with which it ended, and what is wrong with that."""

    status: int
    out: str
    err: str
    wrong: str = ""


def load_program() -> None:
    """Load all that commands use, once for every fork."""
    from spatialviz.cli import COMMANDS

    for options, runner in set(COMMANDS.values()):
        import_module(f"spatialviz.{options}")
        import_module(f"spatialviz.{runner}")
    import_module("spatialviz.view_opening")
    import_module("spatialviz.app.session")
    # A script's background job ignores Ctrl-C, and what it starts would, too.
    signal.signal(signal.SIGINT, signal.default_int_handler)


def home_of(folder: Path) -> Path:
    """The folder of homes and caches that belongs to a folder."""
    return folder.with_name(folder.name + ".home")


def enter(folder: Path) -> None:
    """Make this process live in a folder: homes and caches lie in it, and Python writes nothing outside of it."""
    home = home_of(folder)
    for name in HOMES:
        (home / name.lower()).mkdir(parents=True, exist_ok=True)
        os.environ[name] = str(home / name.lower())
    os.environ["PYTHONPATH"] = str(ROOT)
    os.environ["PATH"] = f"{Path(sys.executable).parent}:{os.environ['PATH']}"
    os.environ["PYTHONDONTWRITEBYTECODE"] = "1"
    os.environ["COLUMNS"] = "120"
    sys.dont_write_bytecode = True
    tempfile.tempdir = None
    os.chdir(folder)
    kept = (str(folder) + "/", str(home) + "/", *ELSEWHERE)

    def stay(event: str, args: tuple[Any, ...]) -> None:
        if event == "open":
            path = args[0] if isinstance(args[1], str) and WRITES.search(args[1]) else None
        else:
            path = args[0] if event in ("os.mkdir", "os.rename", "os.remove", "os.rmdir", "sqlite3.connect") else None
        if isinstance(path, (str, bytes, os.PathLike)) and not str(path).startswith(":"):
            whole = os.path.abspath(os.fsdecode(path).removeprefix("file:").partition("?")[0])
            if not whole.startswith(kept) and "mode=ro" not in os.fsdecode(path):
                raise PermissionError(f"a command of a document writes outside its folder: {whole}")

    sys.addaudithook(stay)


def started(work: Callable[[], object], files: Path) -> int:
    """Begin work in a fork whose output goes to `files` with .out and .err; its process id."""
    for end in (".out", ".err"):
        Path(f"{files}{end}").write_bytes(b"")
    sys.stdout.flush()
    sys.stderr.flush()
    process = os.fork()
    if process:
        return process
    status: object = 70
    try:
        os.setpgid(0, 0)
        for number, target in enumerate((os.devnull, f"{files}.out", f"{files}.err")):
            os.dup2(os.open(target, os.O_RDWR), number)
        status = work()
    except SystemExit as left:
        status = left.code
    except BaseException:
        traceback.print_exc()
    finally:
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(status if isinstance(status, int) else 0 if status is None else 1)


def ended(process: int, files: Path, seconds: float = LONGEST_S) -> Ran:
    """Wait for a fork; one that hangs is killed with its children."""
    limit, wrong = time.monotonic() + seconds, ""
    while True:
        done, code = os.waitpid(process, os.WNOHANG)
        if done:
            break
        if time.monotonic() > limit:
            os.killpg(process, signal.SIGKILL)
            wrong, limit = f"does not end in {seconds:.0f} s", limit + 60
        time.sleep(0.02)
    out, err = (Path(f"{files}{end}").read_text("utf-8", "replace") for end in (".out", ".err"))
    if "Traceback (most recent" in out + err:
        wrong = wrong or "prints a traceback"
    return Ran(os.waitstatus_to_exitcode(code), out, err, wrong)


def command(words: list[str], files: Path) -> Ran:
    """Run a command of spatialviz."""
    from spatialviz.cli import main

    return ended(started(lambda: main(words), files), files)


def parsed(words: list[str], files: Path) -> Ran:
    """Have a command's words parsed, and nothing done."""
    from spatialviz import cli

    class Nothing(SimpleNamespace):
        def __getattr__(self, name: str) -> Callable[[object], int]:
            return lambda command: 0

    def without_work() -> int:
        own = cli.import_module
        cli.import_module = lambda name: Nothing() if name.startswith("spatialviz.run_") else own(name)  # pyright: ignore
        return cli.main(words)

    return ended(started(without_work, files), files)


def shell(text: str, files: Path) -> Ran:
    """Run what needs a shell."""
    return ended(started(lambda: subprocess.run(["bash", "-euc", text]).returncode, files), files)


def page_server(words: list[str], files: Path) -> Ran:
    """Start the page, fetch it once, and stop it as Ctrl-C does."""
    from spatialviz.cli import main

    free = [w for w in ("--no-open-browser", "--port=0") if w.partition("=")[0] not in words]
    process = started(lambda: main([*(words or ["view"]), *free]), files)
    limit, address, status = time.monotonic() + LONGEST_S, None, 0
    while address is None and time.monotonic() < limit:
        time.sleep(0.05)
        # A token's address is in the second line.
        address = re.search(r"https?://\S+\?token=\S+|https?://\S+(?= \()", Path(f"{files}.out").read_text("utf-8"))
        if os.waitid(os.P_PID, process, os.WEXITED | os.WNOHANG | os.WNOWAIT):
            return ended(process, files)
    if address:
        with suppress(OSError), urllib.request.urlopen(address[0], timeout=60) as page:
            status = page.status
    os.kill(process, signal.SIGINT)
    ran = ended(process, files, 60)
    wrong = ran.wrong or ("" if status == 200 else "does not show its page")
    return Ran(0 if ran.status in (0, 130) else ran.status, ran.out, ran.err, wrong)


def agents_server(words: list[str], files: Path) -> Ran:
    """Start the server of agents, and ask what it can."""
    asked = (
        '{"jsonrpc":"2.0","id":1,"method":"initialize","params":{"protocolVersion":"2025-06-18","capabilities":{},'
        '"clientInfo":{"name":"documents","version":"1"}}}\n'
    )
    with subprocess.Popen(
        [sys.executable, "-m", "spatialviz", *words], stdin=-1, stdout=-1, stderr=-1, text=True, process_group=0
    ) as server:
        assert server.stdin
        assert server.stdout
        server.stdin.write(asked)
        server.stdin.flush()
        ready, _, _ = select.select([server.stdout], [], [], LONGEST_S)
        line = server.stdout.readline() if ready else ""
        server.kill()
        _, err = server.communicate()
    wrong = "" if '"serverInfo"' in line else "does not answer an agent"
    return Ran(0, line, err, wrong or ("prints a traceback" if "Traceback (most recent" in err else ""))


def _programs(names: Mapping[str, Any], asked: Connection) -> None:
    while True:
        text, at = asked.recv()
        out = io.StringIO()
        try:
            with redirect_stdout(out), redirect_stderr(out):
                exec(compile(text, at, "exec"), names)  # pyright: ignore[reportArgumentType]
            asked.send(Ran(0, out.getvalue(), ""))
        except BaseException:
            asked.send(Ran(1, out.getvalue(), traceback.format_exc()))


class Interpreter:
    """Python in a process of its own, which keeps the names of one snippet for the next."""

    def __init__(self, names: Callable[[], Mapping[str, Any]]) -> None:
        self._ask, asked = Pipe()
        self._process = get_context("fork").Process(target=lambda: _programs(names(), asked), daemon=True)
        self._process.start()

    def run(self, text: str, at: str) -> Ran:
        """Run a snippet."""
        self._ask.send((text, at))
        return self._ask.recv() if self._ask.poll(LONGEST_S) else Ran(1, "", "", f"does not end in {LONGEST_S} s")
