"""Disks that are full or read-only under a command: one line, nothing half, and the same result with room."""

from __future__ import annotations

import contextlib
import json
import os
import random
import shutil
import signal
import subprocess
from collections.abc import Callable, Iterator
from pathlib import Path

from kills import JOBS, WHOLE, content_of, differing, first_edit
from promises import Kind, NotRun, promise
from world import FRAME, World, leftovers

if os.name == "posix":
    import resource

FILLED = ("label", "eval", "export", "export-run", "save-case", "detect", "detect-folder", "render", "map", "check")


@contextlib.contextmanager
def small_disk(folder: Path, kilobytes: int) -> Iterator[Callable[[str], None]]:
    """A file system of so many kilobytes at a folder; gives what mounts it again with other options.

    Raises `NotRun`: it cannot be mounted here.
    """

    def mount(options: str) -> None:
        words = ["mount", "-t", "tmpfs", "-o", options, "tmpfs", str(folder)]
        done = subprocess.run(words, capture_output=True, text=True, check=False)
        if done.returncode:
            raise NotRun(f"no small disk can be mounted here: {done.stderr.strip()}")

    mount(f"size={kilobytes}k")
    try:
        yield lambda options: mount(f"remount,{options}")
    finally:
        subprocess.run(["umount", "-l", str(folder)], check=False)


def _size(path: Path) -> int:
    return sum(file.stat().st_size for file in path.rglob("*") if file.is_file())


def full_disk(name: str, world: World, rng: random.Random, kind: Kind) -> None:
    """Run a job on a disk that is too small for it, then with room."""
    job = JOBS[name]
    whole, _ = WHOLE.of(world, name)
    need = max(8, _size(WHOLE.folder(name)) // 1024)
    place = world.folder(f"disk-{name}")
    with small_disk(place, max(4, int(need * rng.uniform(0.02, 0.9)))) as again:
        out = place / job.name
        words = job.words(world, out)
        done = world.commands.run(*words)
        kind.times += 1
        kind.counts["too large a disk"] += done.status == 0
        if done.status != 0:
            done.well(2)
            told = any(word in done.err for word in ("No space", "disk is full", "not enough", "cannot be written"))
            promise(told, "the line says why", done.err)
            if not job.again:
                promise(not content_of(job, out), "nothing half remains", list(place.rglob("*")))
            again(f"size={10 * need + 20_000}k")
            world.commands.run(*words, *(job.again if out.exists() else ())).well(0, 1)
            promise(content_of(job, out) == whole, "with room it is the same", differing(content_of(job, out), whole))
            promise(not leftovers(place, world.commands.tmp), "nothing is left behind", leftovers(place))
    shutil.rmtree(place)


def small_files(name: str, world: World, rng: random.Random, kind: Kind) -> None:
    """The same by a limit on the size of a file, which is met in the middle of it and needs no root."""
    job = JOBS[name]
    whole, _ = WHOLE.of(world, name)
    largest = max((f.stat().st_size for f in WHOLE.folder(name).rglob("*") if f.is_file()), default=1)
    out = world.folder(f"quota-{name}") / job.name
    most = max(1, int(largest * rng.uniform(0.05, 0.95)))

    def bounded() -> None:
        signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
        resource.setrlimit(resource.RLIMIT_FSIZE, (most, most))

    done = world.commands.run(*job.words(world, out), before=bounded)
    kind.times += 1
    if done.status != 0:
        done.well(2)
        promise(job.again or not content_of(job, out), "nothing half remains", list(out.parent.rglob("*")))
        world.commands.run(*job.words(world, out), *(job.again if out.exists() else ())).well(0, 1)
        promise(content_of(job, out) == whole, "with room it is the same", differing(content_of(job, out), whole))
    shutil.rmtree(out.parent)


def full_disk_correct(world: World, rng: random.Random, kind: Kind) -> None:
    """Correct labels until the disk is full: what was acknowledged is there, and the rest once there is room."""
    place = world.folder("disk-correct")
    with small_disk(place, _size(world.labels) // 1024 + 250 + rng.randrange(300)) as again:
        labels = place / "labels"
        shutil.copytree(world.labels, labels)
        acknowledged = 0
        edits = world.home / "long.json"
        for number in range(40):
            to = {"to": f"name {number}", "reason": "x" * 900}
            made = [{"edit": "class", "frame": FRAME, "object": k, **to} for k in range(6)]
            edits.write_text(json.dumps(made))
            done = world.commands.run("correct", labels, "--edits", edits, "--author", "ann")
            if done.status != 0:
                done.well(2)
                break
            acknowledged += 1
        kind.times += 1
        kind.counts["acknowledged"] += acknowledged
        again("size=200m")
        groups = {event["group"] for event in world.events(labels)}
        promise(len(groups) == acknowledged, "what was acknowledged is there, and no more", (len(groups), acknowledged))
        world.commands.run("correct", labels, "--edits", edits, "--author", "ann").well(0)
    shutil.rmtree(place)


def read_only(world: World, rng: random.Random, kind: Kind) -> None:
    """Everything that only reads works in a folder that cannot be written; what writes says so in one line."""
    place = world.folder("read-only")
    with small_disk(place, 50_000) as again:
        labels, run, dataset = place / "labels", place / "run", place / "dataset"
        shutil.copytree(world.labels, labels)
        shutil.copytree(world.run, run)
        world.copy_of_dataset(dataset)
        world.commands.run("correct", labels, "--edits", world.edits, "--author", "ann").well(0)
        again("ro")
        reads = [
            ("frames", dataset),
            ("ask", dataset, 0, "mug left of the laptop"),
            ("check", labels),
            ("journal", labels, "--json"),
            ("failures", run, "--json"),
            ("show", labels, FRAME),
            ("query", run, "select count(*) from records"),
        ]
        writes = [
            ("correct", labels, "--edits", first_edit(world), "--author", "ben"),
            ("label", dataset, "--out", place / "new", "--limit", 1),
            ("eval", dataset, "--labels", labels, "--detector", "simulated", "--no-plots", "--out", place / "other"),
            ("export", labels, "--format", "coco", "--out", place / "coco"),
            ("export-run", run, "--out", place / "run.jsonl"),
            ("save-case", dataset, 0, "mug left of the laptop", "--out", place / "case"),
        ]
        for words in rng.sample(reads, 3):
            world.commands.run(*words).well(0, 1)
            kind.times += 1
        for words in rng.sample(writes, 3):
            world.commands.run(*words).well(2)
            kind.times += 1
    shutil.rmtree(place)


def scenarios() -> dict[str, Callable[[World, random.Random, Kind], None]]:
    """By the names that `--only` takes."""

    def of(run: Callable[..., None], name: str) -> Callable[[World, random.Random, Kind], None]:
        return lambda world, rng, kind: run(name, world, rng, kind)

    return {
        **{f"disk-{name}": of(full_disk, name) for name in FILLED},
        "disk-correct": full_disk_correct,
        "disk-quota": lambda world, rng, kind: small_files(rng.choice(FILLED), world, rng, kind),
        "read-only": read_only,
    }
