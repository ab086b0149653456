"""Commands as processes of their own: run, killed at some moment, and what they said."""

from __future__ import annotations

import contextlib
import os
import random
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

from promises import promise

LONGEST = 180.0
"""Seconds; what takes longer hangs."""
STATUSES = (0, 1, 2)


@dataclass(frozen=True)
class Done:
    """A command that has ended."""

    words: tuple[str, ...]
    status: int
    out: str
    err: str

    def well(self, *statuses: int) -> Done:
        """Itself, where it ended as a command may: a status that is meant, a line where it failed, no traceback."""
        line = f"{' '.join(self.words)} -> {self.status}: {self.err[-1500:]}"
        promise("Traceback" not in self.out + self.err, "a traceback", line)
        promise("internal error" not in self.err, "an internal error", line)
        promise(self.status in (statuses or STATUSES), f"an exit status of {statuses or STATUSES}", line)
        if self.status == 2:
            errors = [text for text in self.err.splitlines() if text.startswith("spatialviz: error:")]
            promise(len(errors) == 1, "one clear line", line)
        return self


class Commands:
    """Starts commands with an environment of its own: temporary files, cache and what people keep stand in `home`."""

    def __init__(self, home: Path) -> None:
        self.home = home
        self.tmp = home / "tmp"
        self.tmp.mkdir(parents=True, exist_ok=True)
        self.env = {name: value for name, value in os.environ.items() if not name.startswith("SPATIALVIZ_")}
        self.env |= {"TMPDIR": str(self.tmp), "XDG_DATA_HOME": str(home / "data"), "PYTHONFAULTHANDLER": ""}
        self.env |= {"SPATIALVIZ_CACHE": str(home / "cache")}

    def start(
        self, *words: object, env: Mapping[str, str] | None = None, before: Callable[[], None] | None = None
    ) -> subprocess.Popen[str]:
        return subprocess.Popen(
            [sys.executable, "-m", "spatialviz", *map(str, words)],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            errors="replace",
            env={**self.env, **(env or {})},
            start_new_session=True,
            preexec_fn=before,
        )

    def run(
        self, *words: object, env: Mapping[str, str] | None = None, before: Callable[[], None] | None = None
    ) -> Done:
        """Run a command to its end; `Broken` where it hangs."""
        return self.ended(self.start(*words, env=env, before=before), words)

    def ended(self, process: subprocess.Popen[str], words: tuple[object, ...]) -> Done:
        try:
            out, err = process.communicate(timeout=LONGEST)
        except subprocess.TimeoutExpired:
            end_session(process.pid)
            process.communicate()
            promise(False, f"an end within {LONGEST} s", " ".join(map(str, words)))
            raise
        return Done(tuple(map(str, words)), process.returncode, out, err)

    def killed(
        self, rng: random.Random, lasts: float, *words: object, appears: Callable[[], bool] | None = None
    ) -> bool:
        """Start a command and kill it at some moment; whether the kill hit it.

        `lasts`: seconds that it takes. Half of the kills wait until something of its result `appears`; half of
        them kill the first process alone, whose children must then go by themselves.
        """
        process = self.start(*words)
        late = appears is not None and rng.random() < 0.6
        if late and appears is not None:
            until = time.monotonic() + 3 * lasts
            while process.poll() is None and not appears() and time.monotonic() < until:
                time.sleep(0.002)
            time.sleep(rng.uniform(0, 0.25 * lasts) * rng.random())
        else:
            time.sleep(rng.uniform(0.0, 1.1 * lasts))
        hit = process.poll() is None
        if rng.random() < 0.5:
            process.kill()
            # The pipes end when the last of its children has gone.
            with contextlib.suppress(subprocess.TimeoutExpired):
                process.communicate(timeout=30)
            left = session_of(process.pid)
            end_session(process.pid)
            promise(not left, "workers end with the process that was killed", (words, left))
        else:
            end_session(process.pid)
        process.communicate()
        return hit


def session_of(pid: int) -> list[int]:
    """Living processes of the session that a process began."""
    found = []
    for entry in Path("/proc").iterdir():
        if entry.name.isdigit():
            with contextlib.suppress(OSError, IndexError, ValueError):
                fields = (entry / "stat").read_text().rpartition(")")[2].split()
                if int(fields[3]) == pid and fields[0] not in "ZX":
                    found.append(int(entry.name))
    return found


def end_session(pid: int) -> None:
    """Kill every process of the session that a process began."""
    with contextlib.suppress(ProcessLookupError):
        os.killpg(pid, signal.SIGKILL)
    for one in session_of(pid):
        with contextlib.suppress(ProcessLookupError):
            os.kill(one, signal.SIGKILL)
