"""What happens beside a command: a clock that jumps, a dataset that changes, memory that is short."""

from __future__ import annotations

import contextlib
import os
import random
import shutil
import subprocess
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

from commands import Done
from kills import JOBS, WHOLE, content_of, differing, first_edit
from promises import Kind, NotRun, promise
from world import EVAL, FRAME, World, leftovers

if os.name == "posix":
    import resource

HERE = Path(__file__).parent
FAKE = (
    "/usr/lib/x86_64-linux-gnu/faketime/libfaketimeMT.so.1",
    "/usr/lib/aarch64-linux-gnu/faketime/libfaketimeMT.so.1",
)
JUMPS = ("-400d", "+400d", "-1h", "+3h", "@1970-01-01 00:00:10", "@2000-02-29 23:59:58", "@2037-12-31 23:59:58", "+0")
"""What libfaketime makes of the time."""


def fake_clock(file: Path) -> dict[str, str]:
    """Environment in which the time is what a file says, read anew each time; `NotRun` without libfaketime."""
    library = next((name for name in FAKE if Path(name).exists()), None)
    if library is None:
        raise NotRun("libfaketime is not installed (apt-get install faketime)")
    told = {"FAKETIME_TIMESTAMP_FILE": str(file), "FAKETIME_NO_CACHE": "1", "NO_FAKE_STAT": "1"}
    return {"LD_PRELOAD": library, "DONT_FAKE_MONOTONIC": "1", "FAKETIME_DONT_FAKE_MONOTONIC": "1", **told}


SECONDS = ("-3e7", "3e7", "-3600", "1e4", "-1.79e9", "0")
"""The same for `clock/sitecustomize.py`."""


def moved_clock(file: Path) -> dict[str, str]:
    """Environment in which Python's own time is what a file says."""
    return {"CLOCK_FILE": str(file), "PYTHONPATH": os.pathsep.join([str(HERE / "clock"), str(HERE.parents[1])])}


@contextlib.contextmanager
def jumping(file: Path, rng: random.Random, jumps: Sequence[str] = JUMPS) -> Iterator[None]:
    """Let the clock jump several times a second while the block runs."""
    ended = threading.Event()

    def jump() -> None:
        while not ended.wait(rng.uniform(0.05, 0.4)):
            file.write_text(rng.choice(jumps) + "\n")

    file.write_text("+0\n")
    thread = threading.Thread(target=jump)
    thread.start()
    try:
        yield
    finally:
        ended.set()
        thread.join()


def clock_journal(world: World, rng: random.Random, kind: Kind) -> None:
    """Correct, undo and list while the clock jumps: the order is that of saving, and nothing is lost or refused."""
    labels, file = world.labels_of_its_own(), world.home / "clock"
    env = fake_clock(file)
    with jumping(file, rng):
        for number in range(3):
            edits = labels.parent / "edits.json"
            edits.write_text(f'[{{"edit": "class", "frame": "{FRAME}", "object": {number}, "to": "of {number}"}}]')
            world.commands.run("correct", labels, "--edits", edits, "--author", "ann", env=env).well(0)
        world.commands.run("undo", labels, "--author", "ann", env=env).well(0)
        world.commands.run("journal", labels, env=env).well(0)
    kind.times += 1
    events = world.events(labels)
    promise([e["after"] for e in events[:3]] == ["of 0", "of 1", "of 2"], "the order is that of saving", events)
    promise(len(events) == 4 and events[3]["undo_of"], "the newest is taken back", events)
    world.commands.run("correct", labels, "--edits", first_edit(world), "--author", "ben").well(0)
    shutil.rmtree(labels.parent)


def clock_job(world: World, rng: random.Random, kind: Kind) -> None:
    """Run a job while the clock jumps: its result is the same, and no cache or lock keeps the next one from it."""
    name = rng.choice(("label", "eval", "export-run", "detect", "save-case", "map"))
    job, file, out = JOBS[name], world.home / "clock", world.folder("clock") / JOBS[name].name
    whole, _ = WHOLE.of(world, name)
    env = fake_clock(file)
    with jumping(file, rng):
        world.commands.run(*job.words(world, out), env=env).well(0)
    kind.times += 1
    promise(content_of(job, out) == whole, f"{name}: the same result", differing(content_of(job, out), whole))
    left = leftovers(out.parent, world.commands.tmp)
    promise(not left, f"{name}: nothing is left", left)
    shutil.rmtree(out.parent)


def _harm(file: Path, spare: Path, rng: random.Random) -> None:
    """One change of a file, or of its folder, as a sync, a careless script or a failing disk makes it."""
    how = rng.randrange(8)
    with contextlib.suppress(OSError):
        if how == 0:
            file.unlink()
        elif how == 1:
            os.truncate(file, rng.randrange(max(1, file.stat().st_size)))
        elif how == 2:
            os.truncate(file, 0)
        elif how == 3:
            file.write_bytes(rng.randbytes(rng.choice((1, 500, 70_000))))
        elif how == 4:
            others = sorted(one for one in spare.rglob(f"*{file.suffix}") if one.is_file())
            shutil.copy(rng.choice(others), file)
        elif how == 5:
            file.unlink()
            file.mkdir()
        elif how == 6:
            file.unlink()
            os.mkfifo(file)
        else:
            data = bytearray(file.read_bytes())
            for _ in range(8):
                data[rng.randrange(len(data))] = rng.randrange(256)
            file.write_bytes(data)


@contextlib.contextmanager
def changing(dataset: Path, spare: Path, rng: random.Random, pause: float = 0.3) -> Iterator[None]:
    """Change files of a dataset while the block runs, and put all of them back at its end."""
    ended = threading.Event()

    def change() -> None:
        while not ended.wait(rng.uniform(0.02, pause)):
            files = [file for file in sorted(dataset.rglob("*")) if file.is_file() and file.parent != dataset]
            if files:
                _harm(rng.choice(files), spare, rng)

    thread = threading.Thread(target=change)
    thread.start()
    try:
        yield
    finally:
        ended.set()
        thread.join()
        shutil.rmtree(dataset)
        shutil.copytree(spare, dataset)


def changing_job(world: World, rng: random.Random, kind: Kind) -> None:
    """Work on a dataset that changes: an end in a line or a result that opens; then, put back, as ever."""
    dataset = world.copy_of_dataset(world.folder("changing") / "dataset")
    out = dataset.parent / "out"
    name = rng.choice(("label", "eval", "detect", "frames", "ask", "doctor"))
    words = {
        "label": ("label", dataset, "--limit", 4, "--out", out),
        "eval": ("eval", dataset, "--labels", world.labels, *EVAL, "--out", out),
        "detect": ("detect", dataset, "--detector", "simulated", "--out", out),
        "frames": ("frames", dataset),
        "ask": ("ask", dataset, rng.randrange(4), "mug left of the laptop"),
        "doctor": ("doctor", dataset),
    }[name]
    with changing(dataset, world.dataset, rng):
        done = world.commands.run(*words).well()
    kind.times += 1
    kind.counts[f"{name}: {'refused' if done.status == 2 else 'done'}"] += 1
    if name == "label" and (out / "manifest.json").exists():
        world.commands.run("check", out).well()
    if name == "eval" and out.exists():
        world.commands.run("failures", out, "--json").well(0)
    shutil.rmtree(out, ignore_errors=True)
    world.commands.run(*words).well(0, 1)
    if name in ("label", "eval"):
        whole, _ = WHOLE.of(world, name)
        found = content_of(JOBS[name], out)
        found = {key: value for key, value in found.items() if key.startswith("out/")}
        promise(found == whole, f"{name}: put back, it is the same", differing(found, whole))
    shutil.rmtree(dataset.parent)


def little_memory(world: World, rng: random.Random, kind: Kind) -> None:
    """Commands under a limit of memory, as `ulimit -v`: done, or a line that says so; no crash."""
    every = [
        ("frames", world.dataset),
        ("ask", world.dataset, 0, "mug left of the laptop"),
        ("check", world.labels),
        ("query", world.run, "select count(*) from records"),
        ("failures", world.run),
        ("export", world.labels, "--format", "coco", "--out", world.folder("memory") / "out"),
    ]
    words, most = rng.choice(every), rng.choice((250, 400, 600, 900, 1500)) * 1_000_000

    def bounded() -> None:
        resource.setrlimit(resource.RLIMIT_AS, (most, most))

    done: Done = world.commands.run(*words, before=bounded)
    kind.times += 1
    if done.status == 1 and "Traceback" in done.err and "spatialviz/__main__.py" not in done.err:
        raise NotRun("Python itself does not start in so little memory")
    done.well()
    kind.counts["refused" if done.status == 2 else "done"] += 1


def closed_output(world: World, rng: random.Random, kind: Kind) -> None:
    """Commands whose reader goes away, as `| true` and `| head -n 1`, or whose output is a full disk."""
    words = rng.choice((("--help",), ("frames", world.dataset, "--json"), ("failures", world.run), ("--version",)))
    line = " ".join(map(str, ("python", "-m", "spatialviz", *words)))
    end = rng.choice(("| true", "| head -n 1", "> /dev/full", ">&-"))
    env = {**world.commands.env, "PYTHONUNBUFFERED": rng.choice(("", "1"))}
    shell = ["bash", "-c", f"{line} {end}"]
    done = subprocess.run(shell, env=env, capture_output=True, text=True, check=False, timeout=120)
    kind.times += 1
    said = done.stderr.splitlines()
    promise(len(said) <= 1 and "Traceback" not in done.stderr, f"a line at most: {line} {end}", done.stderr)


def copied_twice(world: World, rng: random.Random, kind: Kind) -> None:
    """The same command twice gives the same bytes, also seconds apart."""
    name = rng.choice(("save-case", "export", "export-run", "detect", "map"))
    whole, _ = WHOLE.of(world, name)
    out = world.folder("twice") / JOBS[name].name
    time.sleep(1.1)
    world.commands.run(*JOBS[name].words(world, out)).well(0)
    kind.times += 1
    promise(
        content_of(JOBS[name], out) == whole, f"{name}: the same bytes", differing(content_of(JOBS[name], out), whole)
    )
    shutil.rmtree(out.parent)


SCENARIOS: dict[str, Callable[[World, random.Random, Kind], None]] = {
    "clock-journal": clock_journal,
    "clock-job": clock_job,
    "changing-dataset": changing_job,
    "little-memory": little_memory,
    "closed-output": closed_output,
    "same-bytes": copied_twice,
}
