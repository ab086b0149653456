"""What only a process of its own shows of the command line: exit statuses, Ctrl-C, pipes and the start."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import sysconfig
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any

import pytest
from waiting import wait_until

from spatialviz.options import INTERRUPTED, UNREAD

PROGRAM = (str(Path(sysconfig.get_path("scripts")) / "spatialviz"),)
MODULE = (sys.executable, "-m", "spatialviz")
HEAVY = {"torch", "open3d", "viser", "onnxruntime", "scipy", "cv2", "pyarrow", "pydantic", "matplotlib"}
AT_THE_END = {name: value for name, value in os.environ.items() if name != "PYTHONUNBUFFERED"}
"""As in a shell, where short output to a pipe is written at the end."""
AT_ONCE = {**AT_THE_END, "PYTHONUNBUFFERED": "1"}
"""As where a log is followed: each line is written when it is printed."""


def started(
    *words: str, program: Sequence[str] = PROGRAM, env: dict[str, str] = AT_THE_END, **more: Any
) -> subprocess.Popen[str]:
    """The program with its streams in pipes, as a context that waits for its end."""
    streams = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, **more}
    # A job that a script starts with & ignores Ctrl-C, and so does whatever it starts.
    heard = partial(signal.signal, signal.SIGINT, signal.SIG_DFL)
    return subprocess.Popen([*program, *words], env=env, text=True, preexec_fn=heard, **streams)


def first_line(process: subprocess.Popen[str]) -> tuple[str, str]:
    """The first line of the output, of which no more is read, and all that is told beside it."""
    assert process.stdout is not None
    assert process.stderr is not None
    line = process.stdout.readline()
    process.stdout.close()
    return line, process.stderr.read()


@pytest.mark.parametrize(
    ("frame", "text", "status", "errors"),
    [("0", "mug behind the laptop", 1, 0), ("9999", "mug left of the laptop", 2, 1)],
)
def test_the_status_is_that_of_the_process(frame: str, text: str, status: int, errors: int) -> None:
    with started("ask", "demo", frame, text) as process:
        _, err = process.communicate()
    assert process.returncode == status
    assert len(err.splitlines()) == errors


def test_the_first_line_of_the_help_is_there_at_once() -> None:
    """Nothing heavy is imported for it, and a reader that leaves then (`| head -n 1`) is told nothing."""
    with started("--help", env={**AT_THE_END, "PYTHONPROFILEIMPORTTIME": "1"}) as process:
        line, err = first_line(process)
    assert process.returncode == 0
    assert line.startswith("usage: spatialviz")
    told = err.splitlines()
    assert not [line for line in told if not line.startswith("import time:")]
    assert not HEAVY & {line.rpartition("|")[2].strip() for line in told}


def test_ctrl_c_ends_the_workers_too_and_is_told_in_a_word(tmp_path: Path) -> None:
    words = ["render", str(tmp_path / "rooms"), "--rooms", "60", "--views", "4", "--workers", "2"]
    with started(*words, start_new_session=True) as process:
        children = Path(f"/proc/{process.pid}/task/{process.pid}/children")

        def a_worker_imports() -> bool:
            return any("numpy" in Path(f"/proc/{child}/maps").read_text() for child in children.read_text().split())

        assert wait_until(a_worker_imports)
        # As a terminal does: the workers, too.
        os.killpg(process.pid, signal.SIGINT)
        out, err = process.communicate()
    assert (process.returncode, out, err) == (INTERRUPTED, "", "spatialviz: stopped\n")
    assert not list(tmp_path.iterdir())


def test_a_reader_that_leaves_in_the_middle_ends_the_command_quietly() -> None:
    """Like `frames demo --json | head -n 1`."""
    with started("frames", "demo", "--json", env=AT_ONCE) as process:
        line, err = first_line(process)
    assert json.loads(line)["ok"]
    assert (process.returncode, err) == (UNREAD, "")


@pytest.mark.parametrize(("program", "env"), [(PROGRAM, AT_ONCE), (MODULE, AT_THE_END)], ids=["at once", "at the end"])
def test_a_reader_that_never_was_is_no_reason_for_a_traceback(program: Sequence[str], env: dict[str, str]) -> None:
    """Like `--help | true`; what is written at the end is written by the interpreter, and told by it."""
    reading, writing = os.pipe()
    os.close(reading)
    with started("--help", program=program, env=env, stdout=writing) as process:
        os.close(writing)
        assert process.communicate()[1] == ""
    assert process.returncode == UNREAD


def test_closed_streams_are_no_reason_not_to_work(tmp_path: Path) -> None:
    words = f'label demo --out "{tmp_path / "labels"}" --limit 1 --workers 1'
    closed = ["bash", "-c", f'exec "{PROGRAM[0]}" {words} >&- 2>&-']
    assert subprocess.run(closed, env=AT_THE_END, check=False).returncode == 0
    assert (tmp_path / "labels" / "manifest.json").stat().st_size > 0
