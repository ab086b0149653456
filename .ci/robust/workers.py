"""A process that reads hostile inputs one after the other, bounded and watched; what becomes of each."""

from __future__ import annotations

import contextlib
import gc
import io
import multiprocessing
import os
import random
import shutil
import socket
import sys
import time
import traceback
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from fuzz_kinds import FileKind, TextKind, harmed_copy, scratch

from pipeline.system.errors import InputError, MissingExtra
from spatialviz.cli import main

if sys.platform == "linux":
    import resource

MEMORY = 1_500_000_000
"""Bytes that an input may take beyond what the process has."""
LARGEST = 800
"""MB by which it may grow."""
SECONDS = 60.0
"""Of the processor, and four times as many by the clock."""
WRITING = os.O_WRONLY | os.O_RDWR | os.O_CREAT | os.O_TRUNC | os.O_APPEND
RENAMING = ("os.remove", "os.rename", "os.mkdir", "os.rmdir", "os.symlink", "os.link", "os.truncate", "shutil.rmtree")
RUNNING = ("os.system", "os.exec", "os.posix_spawn", "pty.spawn")


@dataclass(frozen=True)
class Verdict:
    """What became of an input: "refused", "read", or what was broken."""

    result: str
    broken: str = ""
    grown_mb: float = 0.0
    seconds: float = 0.0
    words: tuple[str, ...] = ()


class Watch:
    """What a process does beside reading: writes outside its folders, programs, connections."""

    def __init__(self, allowed: tuple[str, ...]) -> None:
        self._allowed = allowed
        self.seen: list[str] = []
        self.on = False
        sys.addaudithook(self._hear)

    def _inside(self, path: object) -> bool:
        if not isinstance(path, str | bytes | os.PathLike):
            return True
        real = os.path.realpath(os.fsdecode(os.fspath(path)))
        return real.startswith(self._allowed)

    def _hear(self, event: str, arguments: tuple[Any, ...]) -> None:
        if not self.on:
            return
        if event == "open":
            path, mode, flags = arguments
            writes = (isinstance(mode, str) and any(c in mode for c in "wax+")) or (flags or 0) & WRITING
            if writes and not self._inside(path):
                self.seen.append(f"writes {path!r}")
        elif event in RENAMING:
            # What `shutil.rmtree` removes stands in a folder that it has opened, and which is told itself.
            opened = any(isinstance(a, int) and a >= 0 for a in arguments[1:]) and event in ("os.remove", "os.rmdir")
            if not opened and not all(self._inside(path) for path in arguments[:2]):
                self.seen.append(f"{event} {arguments[:2]!r}")
        elif event in RUNNING or (event == "subprocess.Popen" and arguments[0] != sys.executable):
            self.seen.append(f"{event} {arguments[:2]!r}")
        elif event == "socket.connect" and arguments[0].family in (socket.AF_INET, socket.AF_INET6):
            self.seen.append(f"{event} {arguments[1]!r}")


def _high_water() -> float:
    lines = Path("/proc/self/status").read_text().splitlines()
    return next(int(line.split()[1]) / 1024 for line in lines if line.startswith("VmHWM"))


def _command(words: list[str]) -> tuple[str, str]:
    """Run a command in this process: its result, and what was broken."""
    out, err = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        try:
            status: Any = main(words)
        except SystemExit as left:
            status = left.code
    said = err.getvalue()
    told = said[-1500:]
    if "Traceback" in said + out.getvalue():
        return "broken", f"a traceback: {told}"
    if "internal error" in said:
        return "broken", f"an internal error: {told}"
    if "not enough memory" in said:
        return "broken", f"more memory than {MEMORY:,} bytes: {told}"
    if status not in (0, 1, 2):
        return "broken", f"exit status {status}: {told}"
    errors = sum(line.startswith("spatialviz: error:") for line in said.splitlines())
    # What the parser of options refuses is told by its own box; `replay` prints a line for each case.
    if status == 2 and errors != 1 and "For full helptext" not in said and not (words[0] == "replay" and not said):
        return "broken", f"{errors} lines of error in place of one: {told}"
    raw = [c for c in out.getvalue() + said if c in "\x1b\x7f\u009b\u202e\u2028" or (ord(c) < 32 and c not in "\n\t")]
    if raw:
        return "broken", f"control codes reach the terminal: {raw[:5]!r}: {told}"
    return ("refused" if status == 2 else "read"), ""


def _call(function: Any, argument: object) -> tuple[str, str]:
    try:
        function(argument)
    except (InputError, MissingExtra) as error:
        if "\n" in str(error):
            return "broken", f"more than a line: {error}"
        return "refused", ""
    except Exception as error:
        return "broken", f"{type(error).__name__}: {error}\n{traceback.format_exc()[-1500:]}"
    return "read", ""


def read_one(kind: FileKind | TextKind, rng: random.Random, folder: Path, watch: Watch) -> Verdict:
    """Make an input of a kind, read it, and judge what happened."""
    words: list[str] = []
    if isinstance(kind, FileKind):
        harmed_copy(kind, folder, rng)
        call, argument = kind.call, folder
        if kind.commands:
            words = [word.replace("{}", str(folder)) for word in rng.choice(kind.commands)]
    else:
        argument = kind.change(rng.choice(kind.texts), rng)
        folder.mkdir()
        (folder / "text").write_text(argument, "utf-8", "surrogatepass")
        call = kind.call
        words = [word.replace("{}", argument) for word in kind.command]
    # Nothing of before is counted as this one's.
    gc.collect()
    with contextlib.suppress(OSError):
        Path("/proc/self/clear_refs").write_text("5")
    before, begun, watch.on = _high_water(), time.process_time(), True
    watch.seen.clear()
    try:
        result, broken = _command(words) if words else _call(call, argument)
    finally:
        watch.on = False
    seconds, grown = time.process_time() - begun, _high_water() - before
    if not broken and watch.seen:
        result, broken = "broken", f"it {'; '.join(watch.seen[:3])}"
    if not broken and grown > LARGEST:
        result, broken = "broken", f"{grown:.0f} MB more"
    if not broken and seconds > SECONDS:
        result, broken = "broken", f"{seconds:.0f} s of the processor"
    return Verdict(result, broken, grown, seconds, tuple(words))


def _work(kinds: dict[str, FileKind | TextKind], home: Path, allowed: tuple[str, ...], pipe: Any, theirs: Any) -> None:
    # Else the end of the runner would not be heard here.
    theirs.close()
    with open(os.devnull, "w") as nowhere:
        os.dup2(nowhere.fileno(), 2)
    if sys.platform == "linux":
        held = next(
            int(line.split()[1]) * 1024
            for line in Path("/proc/self/status").read_text().splitlines()
            if line.startswith("VmData")
        )
        resource.setrlimit(resource.RLIMIT_DATA, (held + MEMORY, held + MEMORY))
    watch = Watch(allowed)
    while True:
        try:
            name, seed = pipe.recv()
        except EOFError:
            return
        folder = scratch(home)
        pipe.send(folder)
        try:
            pipe.send(read_one(kinds[name], random.Random(seed), folder, watch))
        except Exception as error:  # Of the maker of inputs, which is no promise of the program.
            pipe.send(Verdict("broken", f"the runner failed: {error!r}\n{traceback.format_exc()}"))


class Worker:
    """A process that reads inputs, and is started again after one that ended or held it up."""

    def __init__(self, kinds: dict[str, FileKind | TextKind], home: Path, allowed: tuple[str, ...]) -> None:
        self._given = kinds, home, allowed
        self._process: Any = None
        self._read = 0

    def _start(self) -> None:
        context = multiprocessing.get_context("fork")
        self._pipe, theirs = context.Pipe()
        self._process, self._read = (
            context.Process(target=_work, args=(*self._given, theirs, self._pipe), daemon=True),
            0,
        )
        self._process.start()
        theirs.close()

    def judge(self, name: str, seed: str) -> tuple[Verdict, Path]:
        """Verdict of an input, and the folder where it stands."""
        if self._process is None:
            self._start()
        self._pipe.send((name, seed))
        folder = self._pipe.recv()
        try:
            if not self._pipe.poll(4 * SECONDS):
                self.end()
                return Verdict("broken", f"no end within {4 * SECONDS:.0f} s"), folder
            verdict = self._pipe.recv()
        except (EOFError, ConnectionResetError):
            self._process.join()
            code = self._process.exitcode
            self.end()
            return Verdict("broken", f"the process ended ({code})"), folder
        self._read += 1
        if self._read >= 300:
            # Libraries keep memory: a fresh process measures better.
            self.end()
        return verdict, folder

    def end(self) -> None:
        if self._process is not None:
            self._process.kill()
            self._process.join()
            self._pipe.close()
            self._process = None


def keep(folder: Path, name: str, verdict: Verdict, kept: Path, number: int) -> Path:
    """Keep an input that broke something, under a name of its own."""
    place = kept / f"{name}-{number}"
    shutil.rmtree(place, ignore_errors=True)
    place.parent.mkdir(parents=True, exist_ok=True)
    if folder.exists():
        shutil.copytree(folder, place, symlinks=True)
    else:
        place.mkdir()
    (place / "broken.txt").write_text(f"{verdict.broken}\n{' '.join(verdict.words)}\n", "utf-8", "replace")
    return place
