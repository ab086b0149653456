"""What a full disk or a kill interrupts leaves no half of a file, and what is left of it goes at the next start."""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

import pytest

from pipeline.answering.predictions import Header, Prediction, write_predictions
from pipeline.system import InputError
from pipeline.system.whole_files import (
    clear_abandoned,
    file_with_companions,
    scratch_folder,
    staged_folder,
    temporary_folder,
    temporary_sibling,
    text_file,
    whole_file,
    write_whole,
)

if sys.platform != "win32":
    import resource
    import signal

LINES = [Prediction(frame=str(k), text="mug left of the laptop" * 40) for k in range(2000)]


@pytest.fixture
def small_disk() -> Iterator[None]:
    """No file grows beyond 100 kB."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    told = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_FSIZE, (100_000, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
        signal.signal(signal.SIGXFSZ, told)


def in_folder(path: Path) -> None:
    with staged_folder(path, overwrite=False, mark="x") as folder, text_file(folder / "x") as file:
        file.write("x" * 10**6)


def in_file(path: Path) -> None:
    with whole_file(path, "it") as temporary:
        temporary.write_bytes(bytes(10**6))


WRITERS: tuple[Callable[[Path], Any], ...] = (
    lambda path: write_predictions(path, Header(system="x"), LINES),
    lambda path: write_whole(path, bytes(10**6), "it"),
    in_folder,
    in_file,
)


@pytest.mark.skipif(sys.platform == "win32", reason="the size of files is bounded on POSIX")
@pytest.mark.usefixtures("small_disk")
@pytest.mark.parametrize("write", WRITERS)
def test_a_full_disk_leaves_nothing(write: Callable[[Path], Any], tmp_path: Path) -> None:
    with pytest.raises(InputError, match="cannot be written"):
        write(tmp_path / "out")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("moves", range(4))
def test_a_kill_never_leaves_a_network_beside_another_ones_card(
    moves: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    names = ("srm.onnx", "srm.json", "srm.vectors.npz")
    out = tmp_path / names[0]
    for file in names:
        (tmp_path / file).write_text("old")
    left, move = [None] * moves, os.replace

    def killed_after(source: Path, target: Path) -> None:
        if not left:
            raise KeyboardInterrupt
        left.pop()
        move(source, target)

    monkeypatch.setattr(os, "replace", killed_after)
    with suppress(KeyboardInterrupt), file_with_companions(out) as made:
        for file in names:
            (made.parent / file).write_text("new")
    assert out.exists() == (moves == len(names))
    if out.exists():
        assert {(tmp_path / name).read_text() for name in names} == {"new"}


@pytest.mark.skipif(sys.platform == "win32", reason="whether a process is there is asked on POSIX")
@pytest.mark.parametrize("moves", [1, 2])
def test_a_folder_that_a_kill_took_away_is_there_again(moves: int, tmp_path: Path) -> None:
    """The folder as it was, or as it was to be; without its second move the next writer would see none."""
    code = (
        "import os, pathlib, shutil, sys; from pipeline.system import whole_files\n"
        "path, left, move = pathlib.Path(sys.argv[1]), int(sys.argv[2]), os.rename\n"
        "def killed_after(a, b):\n"
        "    global left; move(a, b); left -= 1; left or os.kill(os.getpid(), 9)\n"
        "for text in ('old', 'new'):\n"
        "    os.rename = killed_after if text == 'new' else move\n"
        "    with whole_files.staged_folder(path, overwrite=True, mark='x') as folder: (folder / 'x').write_text(text)"
    )
    out = tmp_path / "run"
    killed = subprocess.run([sys.executable, "-c", code, out, str(moves)], check=False)
    assert killed.returncode == -9
    with pytest.raises(InputError, match="not empty"), staged_folder(out, overwrite=False, mark="x"):
        pass
    assert (out / "x").read_text() == ("old" if moves == 1 else "new")
    assert not list(tmp_path.glob(".*.old"))


@pytest.mark.skipif(sys.platform == "win32", reason="whether a process is there is asked on POSIX")
def test_what_a_killed_process_left_goes_at_the_next_start(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    monkeypatch.setattr(tempfile, "tempdir", None)
    code = (
        "import time; from pathlib import Path; from pipeline.system.whole_files import scratch_folder\n"
        "with scratch_folder() as folder:\n"
        "    (folder / 'x').write_text('x'); print(folder, flush=True); time.sleep(60)"
    )
    others = tmp_path / ".of-another-program.tmp"
    others.write_text("")
    with subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True) as running:
        assert running.stdout is not None
        left = Path(running.stdout.readline().strip())
        with scratch_folder() as folder:
            assert left.is_dir(), "what runs keeps its folder"
            assert folder.stat().st_mode & 0o077 == 0
        running.kill()
    assert left.is_dir()
    with scratch_folder():
        assert not left.exists()
    assert list(tmp_path.iterdir()) == [others]


@pytest.mark.skipif(sys.platform == "win32", reason="whether a process is there is asked on POSIX")
@pytest.mark.parametrize("write", [in_file, lambda path: temporary_folder(path).__enter__()])
def test_what_a_killed_writer_left_goes_with_the_next_one(write: Callable[[Path], Any], tmp_path: Path) -> None:
    code = (
        "import os, sys; from pathlib import Path\n"
        "from pipeline.system.whole_files import temporary_folder, whole_file\n"
        "with whole_file(Path(sys.argv[1]), 'it') as file, temporary_folder(Path(sys.argv[1])):\n"
        "    file.write_text('half'); os.kill(os.getpid(), 9)"
    )
    assert subprocess.run([sys.executable, "-c", code, tmp_path / "out"], check=False).returncode == -9
    left = set(tmp_path.iterdir())
    assert len(left) == 2
    write(tmp_path / "out")
    assert not left & set(tmp_path.iterdir())


def test_in_a_folder_of_others_only_what_is_known_to_be_left_goes(tmp_path: Path) -> None:
    old = tmp_path / ".notes.tmp"
    old.write_text("")
    own = temporary_sibling(tmp_path / "run")
    own.mkdir()
    long_ago = time.time() - 10 * 86_400
    os.utime(old, (long_ago, long_ago))
    clear_abandoned(tmp_path, ours=False)
    assert old.exists()
    assert own.exists()
    clear_abandoned(tmp_path)
    assert not old.exists()
